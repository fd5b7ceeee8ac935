//! Data cube to volume: Eq. 13, literally or by convolution.
//!
//! `Â(p) = w / (Σ_f w_f · Σ_r w_r) · Σ_f Σ_r w_f w_r m(f, r) e^{−i2πf·path(p, r)/c}`
//!
//! with w = 1 for quadrature, 2 for in-phase data and window weights `w_f`, `w_r` (all 1 without a window), so a
//! unit reflector on a voxel peaks at 1. [`Method::Direct`] sums this as written, on any grid and for any
//! microphones: it is the oracle. [`Method::Convolution`] is Eq. 16 over [`skeleton`] frequencies, for microphones in
//! a plane of constant z; [`Method::Backprojection`] follows range profiles, for any others.
//! [`Method::Linear`] is the paper's far-field approximation of it, for comparison. This module cannot see the scene, so it
//! cannot know the answer.

mod backprojection;
mod compress;
mod convolution;
mod direct;
mod linear;
mod numerics;
mod options;
mod plan;
mod volume;
mod window;

pub use options::{Method, ReconstructOptions};
pub use plan::{Estimate, MOST_DIRECT_TERMS, direct_terms, estimate};
pub use volume::{Made, VolumeSink};
pub use window::Window;

use crate::acquisition::{CubeSource, DataCube};
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume, no_room_for};
use crate::progress::Observer;
use plan::{Choice, Options};
use volume::{Batch, Compensated};
use window::Weights;

/// A volume and how it was come by.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Reconstruction {
    /// The volume.
    pub volume: Volume,
    /// The method that was used; never [`Method::Auto`].
    pub method: Method,
    /// A bound on the error of any voxel against Eq. 13, f32 rounding aside, in the volume's own units: the measured
    /// relative error of skeletons, spreading and range profiles times `Σ|w m| / Σw`.
    pub error_bound: f64,
}

impl Reconstruction {
    /// How it was come by.
    pub fn made(&self) -> Made {
        Made { method: self.method, error_bound: self.error_bound }
    }
}

/// Reconstructs the volume that a cube shows on a grid, all of it in memory.
///
/// - Shapes: the cube is `[n_f, n_mic]`, the volume `[n_z, n_y, n_x]`.
/// - Cost: that of [`reconstruct_into`].
///
/// # Errors
/// Those of [`reconstruct_into`]; [`Error::Environment`] when the volume does not fit in memory.
pub fn reconstruct(
    cube: &DataCube,
    grid: &Grid,
    options: &ReconstructOptions,
    observer: &dyn Observer,
) -> Result<Reconstruction> {
    reconstruct_whole(&mut &*cube, grid, options, observer)
}

/// The same from any source of frequencies.
///
/// # Errors
/// As [`reconstruct`].
pub fn reconstruct_whole(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    observer: &dyn Observer,
) -> Result<Reconstruction> {
    // Filled as depths come, so that nothing is reserved for a job that is refused.
    let mut volume = Volume { grid: *grid, samples: Vec::new() };
    let Made { method, error_bound } = reconstruct_into(source, grid, options, &mut volume, observer)?;
    Ok(Reconstruction { volume, method, error_bound })
}

/// Reconstructs from a source of frequencies into a sink of depths, neither of which need be held whole.
///
/// - Cost: `direct` is voxels × microphones × frequencies terms; `convolution` two padded 2-D FFTs per skeleton
///   tone, depth and pair of sub-lattices; `backprojection` some 130 operations per voxel and microphone, or, by tiles of
///   the array, some 1000 per voxel and tile and 130 per microphone and node of its own tile.
/// - The bytes do not depend on the number of threads, nor on where samples come from and planes go to.
///
/// # Errors
/// `convolution` asked for where it is not possible, `backprojection` without a tolerance, or `auto` with neither and
/// over 10¹¹ direct terms; a grid with voxels behind the array; a tolerance that is not in 0..1; [`Error::Environment`]
/// when what it needs does not fit in memory; [`Error::Interrupted`]; what source and sink come to.
pub fn reconstruct_into(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<Made> {
    // On a thread of the pool: one outside sleeps and is woken at every loop, which costs small jobs as much as their work.
    rayon::scope(|_| in_pool(source, grid, options, sink, observer))
}

fn in_pool(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<Made> {
    let setup = source.instrument();
    let threads = rayon::current_num_threads();
    let possible = Options::of(setup, grid, options, threads)?;
    let batch = possible.chosen(options.method).batch;
    let (choice, warning) = possible.choose(setup, grid, options.method)?;
    if let Some(warning) = warning {
        observer.warn(&warning);
    }
    let weights = Weights::new(setup, options.window);
    if !options.compensate {
        return carry_out((&choice, batch), &weights, source, grid, options, sink, observer);
    }
    let mut compensated = Compensated::new(setup, grid, sink);
    let made = carry_out((&choice, batch), &weights, source, grid, options, &mut compensated, observer)?;
    Ok(compensated.made(&made))
}

/// The method that was chosen, so much of it at a time.
fn carry_out(
    (choice, batch): (&Choice, Batch),
    weights: &Weights,
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<Made> {
    match choice {
        Choice::Direct => direct::direct(source, weights, grid, batch, sink, observer),
        Choice::Convolution(plan) => {
            let divided = (&**plan, batch);
            convolution::convolution(source, weights, divided, options.tolerance, sink, observer)
        }
        Choice::Backprojection(plan) => {
            let divided = (&**plan, batch);
            backprojection::backprojection(source, weights, divided, options.tolerance, sink, observer)
        }
        Choice::Linear => linear::linear(source, weights, grid, batch, sink, observer),
    }
}

/// The refusal of samples that do not fit.
fn no_room(tones: u64, microphones: u64) -> Error {
    Error::environment(
        "memory",
        format!("{tones} tones x {microphones} microphones do not fit; use fewer of either"),
    )
}
