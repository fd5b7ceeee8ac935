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
mod circle;
mod compensation;
mod convolution;
mod cost;
mod direct;
mod focus;
mod lanes;
mod lattice;
mod layout;
mod line;
mod linear;
mod plane;
mod product;
pub mod skeleton;
mod spread;
mod tones;
mod weights;
mod window;

pub use cost::Estimate;
pub use window::Window;

use crate::acquisition::{CubeSource, DataCube, Setup};
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume, zeros};
use crate::progress::Observer;
use compensation::Compensated;
use lattice::SharedLattice;
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
}

impl Default for ReconstructOptions {
    fn default() -> Self {
        Self::new(Method::Auto, Window::Taylor)
    }
}

impl ReconstructOptions {
    /// Options of a given method and window, with the default tolerance of 10⁻⁴ and nothing compensated.
    pub fn new(method: Method, window: Window) -> Self {
        Self { method, window, tolerance: 1e-4, compensate: false }
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

/// Above this many terms `direct` must be asked for by name; it would run for many minutes.
pub const MOST_DIRECT_TERMS: u64 = 100_000_000_000;

/// The terms of Eq. 13: voxels × microphones × frequencies.
pub fn direct_terms(setup: &Setup, grid: &Grid) -> u64 {
    grid.voxel_count().saturating_mul(setup.array.len() as u64).saturating_mul(setup.sweep.len() as u64)
}

/// What is to be done, with what was found out about the lattices.
#[derive(Debug)]
enum Choice {
    Direct,
    Convolution(Box<SharedLattice>),
    Backprojection(Box<backprojection::Plan>),
    Linear(Box<linear::Plan>),
}

/// What each method would cost here, and what the options come to.
#[derive(Debug)]
struct Options {
    estimates: [Estimate; 4],
    lattice: std::result::Result<SharedLattice, String>,
    backprojection: Option<backprojection::Plan>,
    linear: std::result::Result<linear::Plan, String>,
}

impl Options {
    fn of(setup: &Setup, grid: &Grid, options: &ReconstructOptions, threads: usize) -> Result<Self> {
        check(grid, options)?;
        // Spreading and skeletons share the tolerance.
        let lattice = SharedLattice::find(setup, grid, 0.5 * options.tolerance);
        // Where there is a lattice, convolution is so much faster that dividing the other's work is not worth its time.
        let wanted = lattice.is_err() || options.method == Method::Backprojection;
        let backprojection = (wanted && options.tolerance > 0.0)
            .then(|| backprojection::Plan::new(setup, grid, options.tolerance));
        let linear = linear::Plan::new(setup, grid, options.tolerance);
        let estimates =
            cost::estimates(setup, grid, options, &lattice, backprojection.as_ref(), &linear, threads);
        Ok(Self { estimates, lattice, backprojection, linear })
    }

    /// The method asked for, or of those possible the one of fewest operations.
    fn chosen(&self, asked: Method) -> &Estimate {
        let of = |method: Method| self.estimates.iter().find(|e| e.method == method);
        of(asked).unwrap_or_else(|| {
            // `linear` is another formula, not a way to sum this one.
            let possible =
                self.estimates.iter().filter(|e| e.obstacle.is_none() && e.method != Method::Linear);
            possible.min_by(|a, b| a.operations.total_cmp(&b.operations)).expect("the direct sum always is")
        })
    }

    /// The method that the options come to, and a warning if `auto` had to take a slow one.
    fn choose(self, setup: &Setup, grid: &Grid, asked: Method) -> Result<(Choice, Option<String>)> {
        let chosen = self.chosen(asked);
        if let Some(obstacle) = &chosen.obstacle {
            let (name, others) = match chosen.method {
                Method::Convolution => ("convolution", "\"backprojection\" or \"direct\""),
                Method::Linear => ("linear", "\"auto\""),
                _ => ("backprojection", "\"direct\""),
            };
            return Err(Error::input(
                "reconstruct.method",
                format!("\"{name}\" is not possible here: {obstacle}; mend that, or use method = {others}"),
            ));
        }
        match (chosen.method, self.lattice, self.backprojection) {
            (Method::Linear, ..) => {
                let plan = self.linear.map_err(|obstacle| Error::input("reconstruct.method", obstacle))?;
                Ok((Choice::Linear(Box::new(plan)), None))
            }
            (Method::Convolution, Ok(lattice), _) => Ok((Choice::Convolution(Box::new(lattice)), None)),
            (Method::Backprojection, _, Some(plan)) => Ok((Choice::Backprojection(Box::new(plan)), None)),
            (_, Err(misfit), None) if asked == Method::Auto => {
                refuse_long_sum(setup, grid, &misfit)?;
                let slower = "summing Eq. 13 directly instead, which is slower (a tolerance would help)";
                Ok((Choice::Direct, Some(format!("{misfit}; {slower}"))))
            }
            _ => Ok((Choice::Direct, None)),
        }
    }
}

/// Refuses a direct sum of many minutes that nobody asked for by name.
fn refuse_long_sum(setup: &Setup, grid: &Grid, misfit: &str) -> Result<()> {
    let terms = direct_terms(setup, grid);
    if terms <= MOST_DIRECT_TERMS {
        return Ok(());
    }
    Err(Error::input(
        "reconstruct.method",
        format!(
            "{misfit}. That leaves the direct sum of Eq. 13, {:.1e} terms here: many minutes. Make the grid \
             smaller or its pitch larger, allow a tolerance, or ask for it by name with [reconstruct] method = \"direct\"",
            terms as f64
        ),
    ))
}

/// The most voxels, in all and along an axis: far beyond what any computer images, and few enough to be counted over.
const MOST_VOXELS: u64 = 1 << 38;
const MOST_ALONG: usize = 1 << 17;

/// Refuses grids and tolerances that make no sense.
fn check(grid: &Grid, options: &ReconstructOptions) -> Result<()> {
    let [n_z, n_y, n_x] = grid.shape();
    if grid.voxel_count() > MOST_VOXELS || n_x.max(n_y).max(n_z) > MOST_ALONG {
        return Err(Error::input(
            "grid",
            format!(
                "{n_x} x {n_y} x {n_z} voxels are beyond all memory ({:.1e} GiB); use a larger pitch or a smaller grid",
                grid.voxel_count() as f64 * 8.0 / f64::from(1 << 30)
            ),
        ));
    }
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
    Ok(())
}

/// What each method would cost for a job with so many threads, and the one that [`reconstruct`] would take, as an index
/// (which no number of threads changes). Costs up to a tenth of a second.
///
/// # Errors
/// A grid with voxels behind the array; a tolerance that is not in 0..1.
pub fn estimate(
    setup: &Setup,
    grid: &Grid,
    options: &ReconstructOptions,
    threads: usize,
) -> Result<([Estimate; 4], usize)> {
    let possible = Options::of(setup, grid, options, threads)?;
    let chosen = possible.chosen(options.method).method;
    let index = possible.estimates.iter().position(|e| e.method == chosen).unwrap_or(0);
    Ok((possible.estimates, index))
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
pub trait VolumeSink {
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
///   tone, depth and pair of sub-lattices; `backprojection` some 130 operations per voxel (or node of a coarser lattice) and microphone.
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
    let setup = source.setup();
    let (choice, warning) = Options::of(&setup, grid, options, 1)?.choose(&setup, grid, options.method)?;
    if let Some(warning) = warning {
        observer.warn(&warning);
    }
    let weights = Weights::new(&setup, options.window);
    if !options.compensate {
        return carry_out(&choice, &weights, source, grid, options, sink, observer);
    }
    let mut compensated = Compensated::new(&setup, grid, sink);
    let made = carry_out(&choice, &weights, source, grid, options, &mut compensated, observer)?;
    Ok(compensated.made(&made))
}

/// The method that was chosen.
fn carry_out(
    choice: &Choice,
    weights: &Weights,
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<Made> {
    match choice {
        Choice::Direct => direct::direct(source, weights, grid, sink, observer),
        Choice::Convolution(lattice) => {
            convolution::convolution(source, weights, lattice, grid, options.tolerance, sink, observer)
        }
        Choice::Backprojection(plan) => {
            backprojection::backprojection(source, weights, plan, options.tolerance, sink, observer)
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

/// The refusal of a grid that does not fit, all of it or the depths that are worked on at a time.
fn no_room_for(grid: &Grid) -> Error {
    Error::environment(
        "memory",
        format!(
            "a volume of {} voxels does not fit; use a smaller grid or a larger pitch",
            grid.voxel_count()
        ),
    )
}
