//! Running times of direct and fast reconstruction at the size of the paper: 1001 frequencies, 255 microphones, 100 × 100
//! pixels.
//!
//! All run on one thread, with columns at the pitch of the microphones, so that pixels and microphones share a lattice. The
//! paper's factor of 15 compares with a sum that computes a sine and a cosine per term. Compared with a sum that advances
//! its phasors from frequency to frequency it is much smaller; both are reported.

use super::CASES;
use super::scene::{PIXELS, cube};
use crate::acquisition::{DataCube, Instrument, PropagationModel::Exact};
use crate::error::{Error, Result};
use crate::grid::{Axis, Grid};
use crate::progress::{Observer, advance, stage};
use crate::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use num_complex::{Complex32, Complex64};
use serde::Serialize;
use std::f64::consts::TAU;
use std::time::Instant;

/// The running time of one method for Eq. 13.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Timing {
    /// The method and its settings.
    pub(super) method: &'static str,
    /// Seconds on one thread for all pixels.
    pub(super) seconds: f64,
    /// The fraction of the pixels that was timed, from which the seconds are extrapolated.
    pub(super) share: f64,
    /// Maximum difference from the literal sum, relative to the maximum amplitude.
    pub(super) error: f64,
    /// Seconds in the paper, in Matlab on a 2.8 GHz Core i7 of 2014.
    pub(super) paper: Option<f64>,
}

/// All running times, and their ratios.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Timings {
    /// Direct with sine and cosine per term; direct by recurrence; Eq. 16 at every frequency; Eq. 16 at skeleton frequencies.
    pub(super) methods: Vec<Timing>,
    /// Number of terms of Eq. 13.
    pub(super) terms: u64,
    /// Sine and cosine per term relative to Eq. 16 at every frequency: 15 in the paper.
    pub(super) gain: f64,
    /// Recurrence relative to Eq. 16 at every frequency.
    pub(super) gain_over_recurrence: f64,
    /// Recurrence relative to Eq. 16 at skeleton frequencies.
    pub(super) gain_of_skeletons: f64,
    /// 185 s / 12 s.
    pub(super) paper_gain: f64,
}

/// Seconds of the paper's direct and fast sums.
const PAPER: [f64; 2] = [185.0, 12.0];

/// Rows of pixels that are summed with a sine and a cosine per term; all would take most of a minute.
const ROWS: usize = 2;

/// How often each method is timed; the shortest time counts, since other programs use the computer too.
const REPEATS: usize = 3;

/// Some rows of the paper's pixels, with columns on the microphones' lattice.
fn lattice_grid(cube: &DataCube, rows: std::ops::Range<usize>) -> Grid {
    let pitch = cube.instrument.array.lattice().map_or(1.0, |lattice| lattice.x.pitch);
    Grid {
        x: Axis { first: 0.0, pitch, count: PIXELS },
        y: Axis { first: 0.0, pitch: 1.0, count: 1 },
        z: Axis { first: 0.05 * rows.start as f64, pitch: 0.05, count: rows.len() },
    }
}

/// Times the four methods.
pub(super) fn measure(observer: &dyn Observer) -> Result<Timings> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .map_err(|e| Error::io("threads", format!("one cannot be started: {e}")))?;
    stage(observer, "timing", 4, || pool.install(|| all(observer)))
}

/// The shortest time of some work in seconds, and its result.
fn fastest<T>(work: impl Fn() -> Result<T>) -> Result<(f64, T)> {
    let timed = || {
        let start = Instant::now();
        work().map(|result| (start.elapsed().as_secs_f64(), result))
    };
    (1..REPEATS)
        .try_fold(timed()?, |(best, _), _| timed().map(|(seconds, result)| (best.min(seconds), result)))
}

fn all(observer: &dyn Observer) -> Result<Timings> {
    let case = CASES[2];
    let cube = cube(&case, Exact)?;
    let grid = lattice_grid(&cube, 0..PIXELS);
    // The middle rows, where the lines are.
    let rows = (PIXELS * 3 / 5)..(PIXELS * 3 / 5 + ROWS);
    let share = ROWS as f64 / PIXELS as f64;
    let literal_grid = lattice_grid(&cube, rows.clone());
    let (seconds, literal) = fastest(|| Ok(sine_and_cosine(&cube, &literal_grid)))?;
    advance(observer, 1)?;
    let peak = literal.iter().map(|a| a.norm()).fold(0.0, f64::max);
    let mut methods = vec![Timing {
        method: "direct, sine and cosine per term",
        seconds: seconds / share,
        share,
        error: 0.0,
        paper: Some(PAPER[0]),
    }];
    for (name, method, tolerance, paper) in [
        ("direct, phasors by recurrence", Method::Direct, 0.0, None),
        ("Eq. 16 by FFT, every frequency", Method::Convolution, 0.0, Some(PAPER[1])),
        ("Eq. 16 by FFT, skeleton frequencies to 1e-4", Method::Convolution, 1e-4, None),
    ] {
        let mut options = ReconstructOptions::new(method, Window::None);
        options.tolerance = tolerance;
        let (seconds, image) = fastest(|| reconstruct(&cube, &grid, &options))?;
        let samples = image.volume.samples;
        let error = difference(&samples[rows.start * PIXELS..rows.end * PIXELS], &literal) / peak;
        methods.push(Timing { method: name, seconds, share: 1.0, error, paper });
        advance(observer, 1)?;
    }
    let ratio = |a: usize, b: usize| methods[a].seconds / methods[b].seconds;
    Ok(Timings {
        terms: (cube.instrument.sweep.len() * cube.instrument.array.len() * PIXELS * PIXELS) as u64,
        gain: ratio(0, 2),
        gain_over_recurrence: ratio(1, 2),
        gain_of_skeletons: ratio(1, 3),
        paper_gain: PAPER[0] / PAPER[1],
        methods,
    })
}

/// Eq. 13 literally, with a sine and a cosine for every pixel, microphone and frequency, in f64.
fn sine_and_cosine(cube: &DataCube, grid: &Grid) -> Vec<Complex64> {
    let Instrument { sweep, array, geometry, detection, sound_speed, .. } = &cube.instrument;
    let n_mic = array.len();
    let scale = detection.weight() / (n_mic * sweep.len()) as f64;
    (0..grid.z.count * grid.x.count)
        .map(|pixel| {
            let p = grid.position(pixel % grid.x.count, 0, pixel / grid.x.count);
            let mut sum = Complex64::ZERO;
            for (j, r) in array.positions().iter().enumerate() {
                let turns = TAU * geometry.path_length(p, *r) / sound_speed;
                for (q, f) in sweep.frequencies().iter().enumerate() {
                    let (sin, cos) = (turns * f).sin_cos();
                    let m = f64::from(cube.samples[q * n_mic + j].re);
                    sum += Complex64::new(m * cos, -m * sin);
                }
            }
            sum * scale
        })
        .collect()
}

/// Maximum difference of two rows of pixels.
fn difference(a: &[Complex32], b: &[Complex64]) -> f64 {
    let of = |(a, b): (&Complex32, &Complex64)| (Complex64::new(f64::from(a.re), f64::from(a.im)) - b).norm();
    a.iter().zip(b).map(of).fold(0.0, f64::max)
}
