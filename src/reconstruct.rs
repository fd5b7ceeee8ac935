//! Data cube to volume: Eq. 13, literally or by convolution.
//!
//! `Â(p) = w / (Σ_f w_f · Σ_r w_r) · Σ_f Σ_r w_f w_r m(f, r) e^{−i2πf·path(p, r)/c}`
//!
//! (of several loudspeakers the mean of all such sums) with w = 1 for quadrature, 2 for in-phase data and window weights `w_f`, `w_r` (all 1 without a window), so a
//! unit reflector on a voxel peaks at 1. [`Method::Direct`] sums this as written, on any grid and for any
//! microphones: it is the oracle. [`Method::Convolution`] is Eq. 16 over skeleton frequencies, for microphones in
//! a plane of constant z; [`Method::Backprojection`] evaluates range profiles, for any others.
//! [`Method::Linear`] is the paper's far-field approximation of it, for comparison; [`Method::Correlation`] another image, of the
//! phases between pairs of microphones. This module has no access to the
//! scene, so it cannot know the result in advance.

mod backprojection;
mod compress;
mod convolution;
mod direct;
mod error_budget;
mod job;
mod numerics;
mod options;
mod plan;
mod refine;
mod upsampling;
mod volume;
mod window;

pub(crate) use compress::{BYTES_BESIDE_TONES, CONVOLVED};
pub use options::{Method, ReconstructOptions};
pub use plan::{Estimate, Estimates, LEAST_TOLERANCE, direct_terms, estimate};
pub(crate) use refine::MOST_STEPS;
pub use refine::{RefineOptions, Refinement, Solver};
pub(crate) use upsampling::most_nodes;
pub use volume::{Correlation, ReconstructionInfo, VolumeSink};
pub(crate) use volume::{GridSurroundings, needed_among};
pub use window::Window;

use crate::acquisition::{CubeSource, DataCube};
use crate::alloc::try_zeroed;
use crate::blocks::{BlockStore, NoStore, NodeStore};
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume};
use crate::progress::{Observer, Silent};
use compress::KeptTones;
use error_budget::ErrorBudget;
use job::Job;
use num_complex::Complex32;
use plan::{Candidates, MethodPlan, Sampled, summed};
use std::sync::OnceLock;
use upsampling::{InterpolationError, Resampled};
use volume::{Checked, Compensated, Gain, Metered, correlate, in_motion, sum_of_transmissions, turned_round};
use window::Weights;

/// A volume and how it was computed.
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
    /// The amplitude below which a voxel shows nothing, as in [`ReconstructionInfo`].
    pub incoherent_level: Option<f64>,
    /// The amplitude of the strongest echo outside the grid, as in [`ReconstructionInfo`].
    pub outside_level: Option<f64>,
    /// How it was refined, if it was; the bound is then of the volume that it began with.
    pub refinement: Option<Refinement>,
    /// How microphones were correlated, if they were.
    pub correlation: Option<Correlation>,
}

impl Reconstruction {
    pub(crate) fn new(volume: Volume, info: &ReconstructionInfo) -> Self {
        let ReconstructionInfo {
            method,
            error_bound,
            incoherent_level,
            outside_level,
            refinement,
            correlation,
        } = *info;
        Self { volume, method, error_bound, incoherent_level, outside_level, refinement, correlation }
    }

    /// How it was computed.
    pub fn info(&self) -> ReconstructionInfo {
        let Self { method, error_bound, incoherent_level, outside_level, refinement, correlation, .. } =
            *self;
        ReconstructionInfo { method, error_bound, incoherent_level, outside_level, refinement, correlation }
    }
}

/// Reconstructs the volume that a cube shows on a grid, all of it in memory.
///
/// - Shapes: the cube is `[n_f, n_mic]`, or `[n_tx, n_f, n_mic]` for several loudspeakers; the volume `[n_z, n_y, n_x]`.
/// - Cost: that of [`reconstruct_into`].
///
/// # Errors
/// Those of [`reconstruct_into`]; [`Error::OutOfMemory`] when the volume does not fit in memory.
pub fn reconstruct(cube: &DataCube, grid: &Grid, options: &ReconstructOptions) -> Result<Reconstruction> {
    reconstruct_with(cube, grid, options, &Silent)
}

/// [`reconstruct`], reporting its progress to `observer`, which may stop it.
///
/// # Errors
/// As [`reconstruct`]; `Error::Interrupted` when the observer asks to stop.
pub fn reconstruct_with(
    cube: &DataCube,
    grid: &Grid,
    options: &ReconstructOptions,
    observer: &dyn Observer,
) -> Result<Reconstruction> {
    // Filled as depths come, so that nothing is reserved for a job that is refused.
    let mut volume = Volume { grid: *grid, samples: Vec::new() };
    let info = reconstruct_into(&mut &*cube, grid, options, &mut volume, observer)?;
    Ok(Reconstruction::new(volume, &info))
}

/// Reconstructs from a source of frequencies into a sink of depths, neither of which need be in memory as a whole.
///
/// - Cost: `direct` is voxels × microphones × frequencies terms; `convolution` two padded 2-D FFTs per skeleton
///   tone, depth and pair of sublattices; `backprojection` some 100 operations per voxel and microphone, or, by tiles of
///   the array, some 1000 per voxel and tile and 100 per microphone and node of its own tile; or, by lines of a lattice, some
///   300 per voxel and line and 8 per tone, microphone and node.
///   With [`ReconstructOptions::refine`], twice as much for each step, and two or three volumes.
/// - The bytes do not depend on the number of threads, nor on where samples come from and planes go to.
///
/// # Errors
/// `convolution` selected where it is not possible, `backprojection` without a tolerance, or `auto` with neither and
/// over 10¹¹ direct terms; a grid with voxels behind the array or beyond 10⁹ m; a tolerance that is not 0 or in 10⁻⁹..1;
/// samples so large that a voxel's power is not finite in single precision; [`Error::OutOfMemory`]
/// when what it needs does not fit in memory; [`Error::Interrupted`]; those of source and sink.
pub fn reconstruct_into(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    reconstruct_stored(source, grid, options, sink, &mut NoStore, observer)
}

/// [`reconstruct_into`], storing what a refinement has after its steps, or without one the tones of a volume that is no sum of
/// several; depths are the sink's to store.
///
/// # Errors
/// As [`reconstruct_into`].
pub(crate) fn reconstruct_stored(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    sink: &mut dyn VolumeSink,
    store: &mut (dyn BlockStore + Send),
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    reconstruct_shared(source, grid, options, (sink, store, None), observer)
}

/// The same of some depths, of which other processes compute the others, and where they share nodes.
///
/// # Errors
/// As [`reconstruct_into`]; nodes that were deleted after they were found.
pub(crate) fn reconstruct_shared(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    (sink, store, nodes): (&mut dyn VolumeSink, &mut (dyn BlockStore + Send), Option<&dyn NodeStore>),
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    // On a thread of the pool: one outside sleeps and is woken at every loop, which costs small jobs as much as their work.
    rayon::scope(|_| in_pool(source, grid, options, (sink, store, nodes), observer))
}

/// Where depths go, and what is kept for and of other runs and processes.
type Outward<'a> = (&'a mut dyn VolumeSink, &'a mut (dyn BlockStore + Send), Option<&'a dyn NodeStore>);

fn in_pool(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    (sink, store, nodes): Outward<'_>,
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    if let Some(motion) = options.motion.filter(|_| options.method != Method::Correlation) {
        return in_motion(source, grid, (options, motion), sink, observer);
    }
    if options.method == Method::Correlation {
        return correlate(source, grid, options, sink, observer);
    }
    if let Some(turned) = turned_round(source, options)? {
        return in_order(&mut &turned, grid, options, (sink, store, nodes), observer);
    }
    in_order(source, grid, options, (sink, store, nodes), observer)
}

/// The same with loudspeakers and microphones in the places that take less.
fn in_order(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    (sink, store, nodes): Outward<'_>,
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    if source.instrument().transmissions() > 1 && options.refine.is_none() {
        return sum_of_transmissions(source, grid, options, sink, observer);
    }
    let threads = rayon::current_num_threads();
    let candidates = Candidates::new(source.instrument(), grid, options, threads)?;
    by_candidates(source, (grid, candidates), options, (sink, store, nodes), observer)
}

/// The same with plans that are found already.
fn by_candidates(
    source: &mut dyn CubeSource,
    (grid, candidates): (&Grid, Candidates),
    options: &ReconstructOptions,
    (sink, store, nodes): Outward<'_>,
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    let instrument = source.instrument();
    let batch = candidates.chosen(options.method).batch;
    let (plan, warning) = candidates.choose(instrument, grid, options.method)?;
    if let Some(warning) = warning {
        observer.warn(&warning);
    }
    let gain = options.compensate.then(|| Gain::new(instrument, grid));
    let weights = Weights::new(source.instrument(), options.window);
    let plain = options.refine.is_none() && !options.compensate;
    let level = OnceLock::new();
    let mut metered = Metered { source, weights: &weights, level: &level };
    let source: &mut dyn CubeSource = if plain { &mut metered } else { metered.source };
    let sink: &mut dyn VolumeSink = &mut Checked { grid: *grid, incoherent_level: Some(&level), sink };
    let sink: &mut dyn VolumeSink = &mut Compensated::new(gain, sink);
    let info = if let (Some(by), MethodPlan::Convolution(plan)) = (&options.refine, &plan) {
        refine::refine(source, grid, (plan, batch), (options, by), (store, sink), observer)?
    } else {
        let weights = &weights;
        let convolved = matches!(plan, MethodPlan::Convolution(_));
        let (level, error) = (plain.then_some(&level), OnceLock::new());
        let kept = KeptTones { store: Some(store), convolved, level, error, find_error: None, nodes };
        let (budget, interpolation) = (ErrorBudget::new(options.tolerance), InterpolationError::NONE);
        carry_out(&plan, Job { source, kept, weights, grid, budget, interpolation, batch, sink, observer })?
    };
    let info = gain.map_or(info, |gain| gain.info(&info));
    Ok(ReconstructionInfo { incoherent_level: level.into_inner(), ..info })
}

fn carry_out(plan: &MethodPlan, job: Job<'_>) -> Result<ReconstructionInfo> {
    match plan {
        MethodPlan::Direct(plan) => direct::direct(job, plan),
        MethodPlan::Convolution(sampled) => on_nodes(sampled, job, convolution::convolution),
        MethodPlan::Backprojection(sampled) => on_nodes(sampled, job, backprojection::backprojection),
        MethodPlan::Linear(plan) => direct::linear(job, plan),
    }
}

/// Carries out a method's plan for the voxels, or for nodes that they are interpolated from.
fn on_nodes<P>(
    Sampled { upsampling, plan }: &Sampled<P>,
    job: Job<'_>,
    method: impl FnOnce(Job<'_>, &P) -> Result<ReconstructionInfo>,
) -> Result<ReconstructionInfo> {
    let Some(upsampling) = upsampling else { return method(job, plan) };
    let Job { source, mut kept, weights, grid, budget, batch, sink, observer, .. } = job;
    let nodes = kept.nodes;
    let kept = kept.lent();
    let (grid, budget) = summed(Some(upsampling), grid, budget);
    let mut resampled = Resampled::new(upsampling.onto_voxels(), sink)?.sharing(nodes);
    let (sink, interpolation): (&mut dyn VolumeSink, _) = (&mut resampled, upsampling.error);
    let info =
        method(Job { source, kept, weights, grid, budget, interpolation, batch, sink, observer }, plan)?;
    resampled.finish()?;
    Ok(info)
}

/// Samples of so many tones at so many microphones or nodes, all zero.
///
/// # Errors
/// They do not fit in memory.
fn silence(tones: usize, places: usize) -> Result<Vec<Complex32>> {
    let (tones, places) = (tones as u64, places as u64);
    try_zeroed(tones.saturating_mul(places)).ok_or_else(|| no_room(tones, places))
}

/// The error when samples do not fit in memory.
fn no_room(frequencies: u64, microphones: u64) -> Error {
    Error::out_of_memory(format!(
        "{frequencies} frequencies x {microphones} microphones do not fit in memory; use fewer of either"
    ))
}

#[cfg(test)]
mod tests;
