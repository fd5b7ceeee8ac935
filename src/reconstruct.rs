//! Data cube to volume: Eq. 13, literally or by convolution.
//!
//! `Â(p) = w / (Σ_f w_f · Σ_r w_r) · Σ_f Σ_r w_f w_r m(f, r) e^{−i2πf·path(p, r)/c}`
//!
//! with w = 1 for quadrature, 2 for in-phase data and window weights `w_f`, `w_r` (all 1 without a window), so a
//! unit reflector on a voxel peaks at 1. [`direct`](Method::Direct) sums this as written, on any grid and for any
//! microphones: it is the oracle. [`convolution`](Method::Convolution) is Eq. 16, for voxels on the microphones'
//! lattice. This module cannot see the scene, so it cannot know the answer.

mod convolution;
mod direct;
mod fft2;
pub mod skeleton;
mod window;

pub use window::Window;

use crate::acquisition::DataCube;
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume};
use crate::progress::Observer;
use num_complex::Complex32;
use serde::{Deserialize, Serialize};

/// How the sums of Eq. 13 are carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Convolution where the lattices fit, else direct.
    #[default]
    Auto,
    /// Eq. 16 by padded 2-D FFTs; the voxel pitch must be the microphone pitch divided by a whole number.
    Convolution,
    /// Eq. 13 as written.
    Direct,
}

/// Parameters of [`reconstruct`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct ReconstructOptions {
    /// How to sum.
    pub method: Method,
    /// Weights over x, y and f.
    pub window: Window,
}

impl ReconstructOptions {
    /// Options of a given method and window.
    pub fn new(method: Method, window: Window) -> Self {
        Self { method, window }
    }
}

/// Above this many terms `direct` must be asked for by name; it would run for many minutes.
pub const MOST_DIRECT_TERMS: u64 = 100_000_000_000;

/// The terms of Eq. 13: voxels × microphones × frequencies.
pub fn direct_terms(cube: &DataCube, grid: &Grid) -> u64 {
    grid.voxel_count().saturating_mul(cube.array.len() as u64).saturating_mul(cube.sweep.len() as u64)
}

/// The method that `options` come to for this cube and grid, and a warning if `auto` had to take the slow one.
///
/// # Errors
/// `convolution` asked for on lattices that do not fit, or `auto` left with over 10¹¹ direct terms.
pub fn resolve_method(cube: &DataCube, grid: &Grid, method: Method) -> Result<(Method, Option<String>)> {
    let (choice, warning) = choose(cube, grid, method)?;
    let method = match choice {
        Choice::Direct => Method::Direct,
        Choice::Convolution(_) => Method::Convolution,
    };
    Ok((method, warning))
}

/// A method with what it has found out about the lattices.
#[derive(Debug)]
enum Choice {
    Direct,
    Convolution(convolution::Fit),
}

fn choose(cube: &DataCube, grid: &Grid, method: Method) -> Result<(Choice, Option<String>)> {
    let misfit = match (method, convolution::Fit::find(cube, grid)) {
        (Method::Direct, _) => return Ok((Choice::Direct, None)),
        (_, Ok(fit)) => return Ok((Choice::Convolution(fit), None)),
        (_, Err(misfit)) => misfit,
    };
    if method == Method::Convolution {
        return Err(Error::input(
            "reconstruct.method",
            format!(
                "\"convolution\" needs voxels on the microphones' lattice, but {misfit}; or use method = \"direct\""
            ),
        ));
    }
    let terms = direct_terms(cube, grid);
    if terms > MOST_DIRECT_TERMS {
        return Err(Error::input(
            "grid.pitch",
            format!(
                "{misfit}. Without it the direct sum of Eq. 13 is left, {terms:.1e} terms here: many minutes. \
                 Change the pitch, make the grid smaller, or ask for it by name with [reconstruct] method = \"direct\""
            ),
        ));
    }
    Ok((Choice::Direct, Some(format!("{misfit}; summing Eq. 13 directly instead, which is slower"))))
}

/// Reconstructs the volume that a cube shows on a grid.
///
/// - Shapes: the cube is `[n_f, n_mic]`, the volume `[n_z, n_y, n_x]`.
/// - Cost: `direct` is voxels × microphones × frequencies phasors; `convolution` two padded 2-D FFTs per frequency,
///   depth and sub-lattice.
/// - The bytes do not depend on the number of threads.
///
/// # Errors
/// What [`resolve_method`] refuses; a grid with voxels behind the array; [`Error::Environment`] when the volume
/// does not fit in memory; [`Error::Interrupted`].
pub fn reconstruct(
    cube: &DataCube,
    grid: &Grid,
    options: &ReconstructOptions,
    observer: &dyn Observer,
) -> Result<Volume> {
    if grid.z.first < 0.0 {
        return Err(Error::input(
            "grid.z",
            format!("begins at {} m, behind the array; depths start at z >= 0", grid.z.first),
        ));
    }
    let (plan, warning) = choose(cube, grid, options.method)?;
    if let Some(warning) = warning {
        observer.warn(&warning);
    }
    let weights = Weights::new(cube, options.window);
    let mut samples = Vec::new();
    usize::try_from(grid.voxel_count())
        .ok()
        .and_then(|n| samples.try_reserve_exact(n).ok().map(|()| samples.resize(n, Complex32::ZERO)))
        .ok_or_else(|| {
            Error::environment(
                "memory",
                format!(
                    "a volume of {} voxels does not fit; use a smaller grid or a larger pitch",
                    grid.voxel_count()
                ),
            )
        })?;
    let mut volume = Volume::new(*grid, samples);
    match plan {
        Choice::Direct => direct::direct(cube, &weights, &mut volume, observer)?,
        Choice::Convolution(fit) => {
            convolution::convolution(cube, &weights, &fit, &mut volume, observer)?;
        }
    }
    Ok(volume)
}

/// The factors that turn `m(f, r)` into the summands of Eq. 13.
#[derive(Debug, Clone)]
struct Weights {
    /// Per frequency; holds the normalisation and w as well.
    frequency: Vec<f32>,
    /// Per microphone, mean 1.
    microphone: Vec<f32>,
}

impl Weights {
    fn new(cube: &DataCube, window: Window) -> Self {
        let frequency = window.over_sweep(&cube.sweep);
        let microphone = window.over_array(&cube.array);
        let (sum_f, sum_r) = (frequency.iter().sum::<f64>(), microphone.iter().sum::<f64>());
        let mean_r = sum_r / microphone.len() as f64;
        let scale = cube.detection.weight() / (sum_f * microphone.len() as f64);
        Self {
            frequency: frequency.iter().map(|w| (w * scale) as f32).collect(),
            microphone: microphone.iter().map(|w| (w / mean_r) as f32).collect(),
        }
    }

    /// The weighted samples of one frequency, `[n_mic]`.
    fn weighted<'a>(&'a self, cube: &'a DataCube, f: usize) -> impl Iterator<Item = Complex32> + 'a {
        cube.frequency(f).iter().zip(&self.microphone).map(move |(m, w)| m * (w * self.frequency[f]))
    }
}
