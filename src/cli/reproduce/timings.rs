//! Direct against fast reconstruction, at the size the paper timed: 1001 frequencies, 255 microphones, 100 × 100 pixels.
//!
//! All on one thread, on columns as far apart as the microphones, so that pixels and microphones share a lattice. The
//! paper's 15 is the gain over a sum that takes a sine and a cosine per term. Over one that steps its phasors from
//! frequency to frequency it is much less, and both are reported.

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

/// One way of summing Eq. 13, timed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Timing {
    /// What was summed how.
    pub(super) method: &'static str,
    /// Seconds on one thread for all pixels.
    pub(super) seconds: f64,
    /// The share of the pixels that was timed; the seconds are scaled up from it.
    pub(super) share: f64,
    /// Greatest difference from the sum as written, against the greatest amplitude.
    pub(super) error: f64,
    /// Seconds in the paper, on a 2.8 GHz Core i7 of 2014 in Matlab.
    pub(super) paper: Option<f64>,
}

/// The comparison.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Timings {
    /// Direct with sine and cosine per term; direct by recurrence; Eq. 16 at every frequency; Eq. 16 at skeleton ones.
    pub(super) methods: Vec<Timing>,
    /// Terms of Eq. 13.
    pub(super) terms: u64,
    /// Sine and cosine per term against Eq. 16 at every frequency: the paper's 15.
    pub(super) gain: f64,
    /// Recurrence against Eq. 16 at every frequency.
    pub(super) gain_over_recurrence: f64,
    /// Recurrence against Eq. 16 at skeleton frequencies.
    pub(super) gain_of_skeletons: f64,
    /// 185 s / 12 s.
    pub(super) paper_gain: f64,
}

/// Seconds of the paper's direct and fast sums.
const PAPER: [f64; 2] = [185.0, 12.0];

/// Rows of pixels that are summed with a sine and a cosine per term; all of them would take most of a minute.
const ROWS: usize = 2;

/// Each is timed so often and the shortest counts, since others use the machine too.
const REPEATS: usize = 3;

/// The paper's pixels with columns on the microphones' lattice, some of their rows.
fn lattice_grid(cube: &DataCube, rows: std::ops::Range<usize>) -> Grid {
    let pitch = cube.instrument.array.lattice().map_or(1.0, |lattice| lattice.x.pitch);
    Grid {
        x: Axis { first: 0.0, pitch, count: PIXELS },
        y: Axis { first: 0.0, pitch: 1.0, count: 1 },
        z: Axis { first: 0.05 * rows.start as f64, pitch: 0.05, count: rows.len() },
    }
}

/// Times the four ways.
pub(super) fn measure(observer: &dyn Observer) -> Result<Timings> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .map_err(|e| Error::io("threads", format!("one cannot be started: {e}")))?;
    stage(observer, "timing", 4, || pool.install(|| all(observer)))
}

fn all(observer: &dyn Observer) -> Result<Timings> {
    let case = CASES[2];
    let cube = cube(&case, Exact)?;
    let grid = lattice_grid(&cube, 0..PIXELS);
    // The middle rows, where the lines are.
    let rows = (PIXELS * 3 / 5)..(PIXELS * 3 / 5 + ROWS);
    let share = ROWS as f64 / PIXELS as f64;
    let (mut literal_seconds, mut literal) = (f64::INFINITY, Vec::new());
    for _ in 0..REPEATS {
        let begun = Instant::now();
        literal = sine_and_cosine(&cube, &lattice_grid(&cube, rows.clone()));
        literal_seconds = literal_seconds.min(begun.elapsed().as_secs_f64() / share);
    }
    advance(observer, 1)?;
    let peak = literal.iter().map(|a| a.norm()).fold(0.0, f64::max);
    let mut methods = vec![Timing {
        method: "direct, sine and cosine per term",
        seconds: literal_seconds,
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
        let (mut seconds, mut samples) = (f64::INFINITY, Vec::new());
        for _ in 0..REPEATS {
            let begun = Instant::now();
            samples = reconstruct(&cube, &grid, &options)?.volume.samples;
            seconds = seconds.min(begun.elapsed().as_secs_f64());
        }
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

/// Eq. 13 as it is written, a sine and a cosine for every pixel, microphone and frequency, in f64.
fn sine_and_cosine(cube: &DataCube, grid: &Grid) -> Vec<Complex64> {
    let Instrument { sweep, array, geometry, detection, sound_speed } = &cube.instrument;
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

/// Greatest difference of two rows of pixels.
fn difference(a: &[Complex32], b: &[Complex64]) -> f64 {
    let of = |(a, b): (&Complex32, &Complex64)| (Complex64::new(f64::from(a.re), f64::from(a.im)) - b).norm();
    a.iter().zip(b).map(of).fold(0.0, f64::max)
}
