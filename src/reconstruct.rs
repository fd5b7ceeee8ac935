//! Data cube to volume: Eq. 13, literally or by convolution.
//!
//! `Â(p) = w / (Σ_f w_f · Σ_r w_r) · Σ_f Σ_r w_f w_r m(f, r) e^{−i2πf·path(p, r)/c}`
//!
//! with w = 1 for quadrature, 2 for in-phase data and window weights `w_f`, `w_r` (all 1 without a window), so a
//! unit reflector on a voxel peaks at 1. [`Method::Direct`] sums this as written, on any grid and for any
//! microphones: it is the oracle. [`Method::Convolution`] is Eq. 16 over [`skeleton`] frequencies, for microphones in
//! a plane of constant z. This module cannot see the scene, so it cannot know the answer.

mod circle;
mod convolution;
mod direct;
mod focus;
mod lanes;
mod lattice;
mod layout;
mod line;
mod plane;
mod product;
pub mod skeleton;
mod spread;
mod tones;
mod window;

pub use window::Window;

use crate::acquisition::DataCube;
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume, zeros};
use crate::progress::Observer;
use num_complex::Complex32;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How the sums of Eq. 13 are carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Convolution where the microphones lie in a plane, else direct.
    #[default]
    Auto,
    /// Eq. 16 by padded 2-D FFTs, for any planar array and any voxel pitch.
    Convolution,
    /// Eq. 13 as written.
    Direct,
}

/// Parameters of [`reconstruct`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ReconstructOptions {
    /// How to sum.
    pub method: Method,
    /// Weights over x, y and f.
    pub window: Window,
    /// Error allowed to `Convolution`, relative to `Σ|w m| / Σw`; 0 sums every frequency on a lattice that fits.
    pub tolerance: f64,
}

impl Default for ReconstructOptions {
    fn default() -> Self {
        Self::new(Method::Auto, Window::Taylor)
    }
}

impl ReconstructOptions {
    /// Options of a given method and window, with the default tolerance of 10⁻⁴.
    pub fn new(method: Method, window: Window) -> Self {
        Self { method, window, tolerance: 1e-4 }
    }
}

/// A volume and how it was come by.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Reconstruction {
    /// The volume.
    pub volume: Volume,
    /// The method that was used; never [`Method::Auto`].
    pub method: Method,
    /// A bound on the error of any voxel against Eq. 13, f32 rounding aside, in the volume's own units: the measured
    /// relative error of skeletons and spreading times `Σ|w m| / Σw`.
    pub error_bound: f64,
}

/// Above this many terms `direct` must be asked for by name; it would run for many minutes.
pub const MOST_DIRECT_TERMS: u64 = 100_000_000_000;

/// The terms of Eq. 13: voxels × microphones × frequencies.
pub fn direct_terms(cube: &DataCube, grid: &Grid) -> u64 {
    grid.voxel_count().saturating_mul(cube.array.len() as u64).saturating_mul(cube.sweep.len() as u64)
}

/// What is to be done, with what was found out about the lattices.
#[derive(Debug)]
enum Choice {
    Direct,
    Convolution(Box<lattice::SharedLattice>),
}

/// The method that the options come to for this cube and grid, and a warning if `auto` had to take the slow one.
fn choose(cube: &DataCube, grid: &Grid, options: &ReconstructOptions) -> Result<(Choice, Option<String>)> {
    if options.method == Method::Direct {
        return Ok((Choice::Direct, None));
    }
    // Spreading and skeletons share the tolerance.
    let misfit = match lattice::SharedLattice::find(cube, grid, 0.5 * options.tolerance) {
        Ok(lattice) => return Ok((Choice::Convolution(Box::new(lattice)), None)),
        Err(misfit) => misfit,
    };
    if options.method == Method::Convolution {
        return Err(Error::input(
            "reconstruct.method",
            format!("\"convolution\" is not possible here: {misfit}; mend that, or use method = \"direct\""),
        ));
    }
    let terms = direct_terms(cube, grid);
    if terms > MOST_DIRECT_TERMS {
        return Err(Error::input(
            "reconstruct.method",
            format!(
                "{misfit}. That leaves the direct sum of Eq. 13, {:.1e} terms here: many minutes. Make the grid \
                 smaller or its pitch larger, or ask for it by name with [reconstruct] method = \"direct\"",
                terms as f64
            ),
        ));
    }
    Ok((Choice::Direct, Some(format!("{misfit}; summing Eq. 13 directly instead, which is slower"))))
}

/// Reconstructs the volume that a cube shows on a grid.
///
/// - Shapes: the cube is `[n_f, n_mic]`, the volume `[n_z, n_y, n_x]`.
/// - Cost: `direct` is voxels × microphones × frequencies phasors; `convolution` two padded 2-D FFTs per skeleton
///   tone, depth and pair of sub-lattices.
/// - The bytes do not depend on the number of threads.
///
/// # Errors
/// `convolution` asked for where it is not possible, or `auto` left with over 10¹¹ direct terms; a grid with voxels
/// behind the array; a tolerance that is not in 0..1; [`Error::Environment`] when the volume does not fit in memory;
/// [`Error::Interrupted`].
pub fn reconstruct(
    cube: &DataCube,
    grid: &Grid,
    options: &ReconstructOptions,
    observer: &dyn Observer,
) -> Result<Reconstruction> {
    if grid.z.first < 0.0 {
        return Err(Error::input(
            "grid.z",
            format!("begins at {} m, behind the array; depths start at z >= 0", grid.z.first),
        ));
    }
    if !(0.0..1.0).contains(&options.tolerance) {
        return Err(Error::input(
            "reconstruct.tolerance",
            format!("{} is no relative error; 1e-4 is usual, 0 sums every frequency", options.tolerance),
        ));
    }
    let (choice, warning) = choose(cube, grid, options)?;
    if let Some(warning) = warning {
        observer.warn(&warning);
    }
    let weights = Weights::new(cube, options.window);
    let samples = zeros(grid.voxel_count()).ok_or_else(|| {
        Error::environment(
            "memory",
            format!(
                "a volume of {} voxels does not fit; use a smaller grid or a larger pitch",
                grid.voxel_count()
            ),
        )
    })?;
    let mut volume = Volume::new(*grid, samples);
    let (method, relative) = match choice {
        Choice::Direct => {
            (Method::Direct, direct::direct(cube, &weights, &mut volume, observer).map(|()| 0.0)?)
        }
        Choice::Convolution(lattice) => {
            let tolerance = options.tolerance;
            let error = convolution::convolution(cube, &weights, &lattice, tolerance, &mut volume, observer)?;
            (Method::Convolution, error)
        }
    };
    let error_bound = if relative > 0.0 { relative * weights.mean_modulus(cube) } else { 0.0 };
    Ok(Reconstruction { volume, method, error_bound })
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

    /// `Σ|w m| / Σw`, with w of the detection: what one unit of relative error comes to in the volume.
    fn mean_modulus(&self, cube: &DataCube) -> f64 {
        // In f64, whose squares of f32 neither overflow nor need `hypot`.
        let modulus = |m: Complex32| (f64::from(m.re).powi(2) + f64::from(m.im).powi(2)).sqrt();
        let of = |f: usize| -> f64 { self.weighted(cube, f).map(modulus).sum() };
        let moduli: Vec<f64> = (0..cube.sweep.len()).into_par_iter().map(of).collect();
        moduli.iter().sum()
    }

    /// The weighted samples of one frequency, `[n_mic]`.
    fn weighted<'a>(&'a self, cube: &'a DataCube, f: usize) -> impl Iterator<Item = Complex32> + 'a {
        cube.frequency(f).iter().zip(&self.microphone).map(move |(m, w)| m * (w * self.frequency[f]))
    }
}
