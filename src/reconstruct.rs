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
mod banded;
mod batch;
mod choice;
mod circle;
mod compensation;
mod convolution;
mod cost;
mod direct;
mod focus;
mod handover;
mod lanes;
mod lattice;
mod layout;
mod line;
mod linear;
mod near;
mod plane;
mod product;
pub mod skeleton;
mod slabs;
mod spectra;
mod spread;
mod taps;
mod tones;
mod virtual_tones;
mod weights;
mod window;

pub use choice::{MOST_DIRECT_TERMS, direct_terms, estimate};
pub use cost::Estimate;
pub use window::Window;

use crate::acquisition::{CubeSource, DataCube};
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume, no_room_for, zeros};
use crate::progress::Observer;
use batch::Batch;
use choice::{Choice, Options};
use compensation::Compensated;
use num_complex::Complex32;
use serde::{Deserialize, Serialize};
use weights::Weights;

/// How the sums of Eq. 13 are carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Convolution where the microphones lie in a plane, else back-projection; direct where that costs less.
    #[default]
    Auto,
    /// Eq. 16 by padded 2-D FFTs, for any planar array and any voxel pitch.
    Convolution,
    /// Range profiles along every voxel's paths, for any array and any grid.
    Backprojection,
    /// Eq. 13 as written.
    Direct,
    /// The far-field Fourier transform of Eq. 9, which the paper dropped; for comparison, and never taken by `Auto`.
    Linear,
}

/// Parameters of [`reconstruct`].
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ReconstructOptions {
    /// How to sum.
    pub method: Method,
    /// Weights over x, y and f.
    pub window: Window,
    /// Error allowed to `Convolution` and `Backprojection`, relative to `Σ|w m| / Σw`; 0 sums every frequency on a
    /// lattice that fits.
    pub tolerance: f64,
    /// Whether to undo spherical spreading: every voxel is multiplied by `|p − s| |p − r_c| / (1 m)²`, r_c the array's
    /// centre (monostatic: `|p − r_c|²`), so that a unit reflector peaks at 1 again, and noise grows with distance.
    pub compensate: bool,
    /// Bytes that may be used beside samples and volume: less is worked on at a time, and by fewer threads, where that
    /// keeps to it. It changes no byte of the volume. `None` is no limit.
    pub memory: Option<u64>,
}

impl Default for ReconstructOptions {
    fn default() -> Self {
        Self::new(Method::Auto, Window::Taylor)
    }
}

impl ReconstructOptions {
    /// Options of a given method and window, with the default tolerance of 10⁻⁴ and nothing compensated.
    pub fn new(method: Method, window: Window) -> Self {
        Self { method, window, tolerance: 1e-4, compensate: false, memory: None }
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
    /// relative error of skeletons, spreading and range profiles times `Σ|w m| / Σw`.
    pub error_bound: f64,
}

impl Reconstruction {
    /// How it was come by.
    pub fn made(&self) -> Made {
        Made { method: self.method, error_bound: self.error_bound }
    }
}

/// How a volume was come by.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Made {
    /// The method that was used; never [`Method::Auto`].
    pub method: Method,
    /// A bound on the error of any voxel against Eq. 13, f32 rounding aside, in the volume's own units: the measured
    /// relative error of skeletons and spreading times `Σ|w m| / Σw`.
    pub error_bound: f64,
}

/// Where depths go as they are finished: memory, or a file that is written slab by slab.
pub trait VolumeSink: Send {
    /// Told once, before the first depth.
    ///
    /// # Errors
    /// What writing comes to; so do the others.
    fn begin(&mut self, made: &Made) -> Result<()>;

    /// Takes neighbouring depths from `first` on, `[plane, y, x]`; they come in ascending order, each once.
    ///
    /// # Errors
    /// See [`VolumeSink::begin`].
    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()>;

    /// Depths that the sink has already from the first on, of an earlier run; they need not come again.
    fn done(&self) -> usize {
        0
    }
}

/// A volume held whole.
impl VolumeSink for Volume {
    fn begin(&mut self, _: &Made) -> Result<()> {
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        // Not before: a volume that comes whole is not held twice.
        if self.samples.is_empty() {
            self.samples = room_for(&self.grid)?;
        }
        self.samples[first * self.grid.plane_len()..][..planes.len()].copy_from_slice(planes);
        Ok(())
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
    let setup = source.setup();
    let threads = rayon::current_num_threads();
    let possible = Options::of(&setup, grid, options, threads, false)?;
    let batch = possible.chosen(options.method).batch;
    let (choice, warning) = possible.choose(&setup, grid, options.method)?;
    if let Some(warning) = warning {
        observer.warn(&warning);
    }
    let weights = Weights::new(&setup, options.window);
    if !options.compensate {
        return carry_out((&choice, batch), &weights, source, grid, options, sink, observer);
    }
    let mut compensated = Compensated::new(&setup, grid, sink);
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
        Choice::Linear(plan) => linear::linear(source, weights, plan, sink, observer),
    }
}

/// The refusal of samples that do not fit.
fn no_room(tones: u64, microphones: u64) -> Error {
    Error::environment(
        "memory",
        format!("{tones} tones x {microphones} microphones do not fit; use fewer of either"),
    )
}

/// Room for the voxels of a grid, filled with zeros.
fn room_for(grid: &Grid) -> Result<Vec<Complex32>> {
    zeros(grid.voxel_count()).ok_or_else(|| no_room_for(grid))
}
