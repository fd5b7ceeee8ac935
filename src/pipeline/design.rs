//! Tools for the design of arrays: every combination of swept keys, predicted or simulated, and point-spread functions.

mod budget;
mod keys;
mod pareto;
mod scores;
mod simulated;
mod table;
mod workers;

pub(super) use budget::instrument_budget;
pub use budget::{BudgetRow, InstrumentBudget};
pub use keys::SweptKey;
pub use scores::{DesignFront, DesignScores};
pub use simulated::{SweepSimulation, SweepWork, simulate_designs, work_on_designs};

use super::job::JobOptions;
use super::job::kept::{KeptScenes, KnownScene};
use super::memory::{MemoryBudget, SceneSize};
use super::prepared_scene::{Held, Measurement};
use crate::config::RunFile;
use crate::error::{Error, Result};
use crate::files::check_inputs;
use crate::grid::{Axis, Grid};
use crate::plan::design::{Verdict, design};
use crate::plan::{AcquisitionTime, memory_limit, seconds_of};
use crate::progress::{Observer, advance, stage};
use crate::psf::{PointSpread, point_spread_with};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// The prediction for one combination; lengths in m.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct DesignRow {
    /// Number of microphones, or of the places of a scan.
    pub microphones: usize,
    /// Number of frequencies.
    pub tones: usize,
    /// How long the measurement takes.
    pub acquisition: AcquisitionTime,
    /// Δd = c/2B.
    pub range_resolution: Option<f64>,
    /// Full widths at −3 dB along x of a point in front of the array's centre, at the nearest, middle and farthest depth.
    pub widths: [Option<f64>; 3],
    /// Whether there are grating lobes, by the pitch of a lattice.
    pub verdict: Verdict,
    /// Distance of the nearest grating lobe from a point at the nearest depth, if there are any in the grid, m.
    #[serde(rename = "ghost_offset")]
    pub grating_lobe_offset: Option<f64>,
    /// Strongest grating lobe or sidelobe within the grid, with the window, dB.
    pub peak_sidelobe_db: Option<f64>,
    /// Mean power of the sidelobes of one frequency, dB.
    pub mean_sidelobe_db: Option<f64>,
    /// What the image takes of this computer; left out where the combination was simulated, so that results are the same on all.
    #[serde(flatten)]
    pub cost: Option<DesignCost>,
}

/// What an image takes of this computer.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct DesignCost {
    /// Peak memory, bytes.
    pub peak_bytes: u64,
    /// Seconds of the reconstruction, from a short measurement of this computer's speed.
    pub seconds: f64,
}

/// One combination of a sweep.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Combination {
    /// One value per key.
    pub values: Vec<String>,
    /// The prediction, if the combination is valid.
    pub design: Option<DesignRow>,
    /// How well its images show the scene, if it was simulated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub simulated: Option<DesignScores>,
    /// Why the combination was refused, if it was.
    pub refused: Option<String>,
}

/// A sweep of run-file keys.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct DesignSweep {
    /// The keys.
    pub keys: Vec<String>,
    /// The metric whose error the fronts are of, if the combinations were simulated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measure: Option<String>,
    /// Every combination, the last key fastest.
    pub combinations: Vec<Combination>,
}

/// Returns the run file of an input with further overrides.
pub type RunWith<'a> = dyn Fn(&[String]) -> Result<RunFile> + Sync + 'a;

/// Predicts every combination of swept keys, several at a time.
///
/// Invalid combinations are listed with the reason for their refusal.
///
/// # Errors
/// More than 50000 combinations; a scene that cannot be read; no valid combination.
pub fn sweep_designs(keys: &[SweptKey], run_with: &RunWith, job: &JobOptions) -> Result<DesignSweep> {
    let total = keys::count(keys)?;
    let kept = KeptScenes::within(memory_limit(typed_memory(keys, run_with)));
    let known = KnownScene { kept: Some(&kept), ..job.known() };
    let machine = Machine { threads: rayon::current_num_threads(), seconds_per_operation: seconds_of(1.0) };
    let products = keys::products(keys);
    let predict = |values: &Vec<String>| {
        let row = run_with(&keys::settings(keys, values))
            .and_then(|run| predicted(&run, Some(&machine), known, job.observer));
        advance(job.observer, 1)?;
        not_fatal(row)
    };
    let rows = stage(job.observer, "planning", total as u64, || {
        workers::spread(&products, workers::workers_for(total), predict)
    })?;
    let rows = refusing_if_all(rows)?;
    let combinations = products.into_iter().zip(rows).map(|(values, row)| {
        let (design, refused) =
            row.map_or_else(|error| (None, Some(error.to_string())), |row| (Some(row), None));
        Combination { values, design, simulated: None, refused }
    });
    Ok(DesignSweep {
        keys: keys.iter().map(|key| key.key.clone()).collect(),
        measure: None,
        combinations: combinations.collect(),
    })
}

/// The memory to which the run files of a sweep are limited, bytes.
fn typed_memory(keys: &[SweptKey], run_with: &RunWith) -> Option<u64> {
    let first: Vec<String> = keys.iter().filter_map(|key| key.values.first().cloned()).collect();
    // If this one is invalid, the input by itself may not be.
    run_with(&keys::settings(keys, &first)).or_else(|_| run_with(&[])).ok()?.memory
}

/// What is made of a combination, or why it is refused; the outer error ends the sweep.
fn not_fatal<T>(made: Result<T>) -> Result<Result<T>> {
    match made {
        Err(error @ Error::Interrupted) => Err(error),
        Err(error) => {
            // What would be overwritten is not a matter of this combination.
            check_inputs()?;
            Ok(Err(error))
        }
        made => Ok(made),
    }
}

/// The rows, unless all are refused, which the first refusal explains.
fn refusing_if_all<T>(rows: Vec<Result<T>>) -> Result<Vec<Result<T>>> {
    match rows.first() {
        Some(Err(first)) if rows.iter().all(Result::is_err) => Err(first.clone()),
        _ => Ok(rows),
    }
}

/// The size of the run file's scene; zero if there is no scene and the grid is complete.
fn size_of(run: &RunFile, known: KnownScene<'_>, observer: &dyn Observer) -> Result<SceneSize> {
    let grid = &run.grid;
    if run.scene.files().next().is_none() && grid.x.is_some() && grid.y.is_some() && grid.z.is_some() {
        return Ok(SceneSize::default());
    }
    known.size(run, || SceneSize::of(run, known, observer))
}

/// The threads that a job would have, and how fast they are together.
struct Machine {
    threads: usize,
    seconds_per_operation: f64,
}

/// The prediction for a run file; on a machine, with what its image takes there.
fn predicted(
    run: &RunFile,
    machine: Option<&Machine>,
    known: KnownScene<'_>,
    observer: &dyn Observer,
) -> Result<DesignRow> {
    let measurement = Measurement::of(run)?;
    let instrument = &measurement.instrument;
    let size = size_of(run, known, observer)?;
    let grid = run.voxels(instrument, size.bounds)?;
    let design = design(instrument, &grid, run.reconstruct.window);
    let cost = |machine: &Machine| {
        let budget = MemoryBudget { threads: machine.threads, ..MemoryBudget::of(run) };
        let arrays = measurement.imaging(&budget, &grid, &size);
        let estimate = budget.estimate(instrument, &grid, &arrays)?;
        let seconds = estimate.methods[estimate.chosen].operations * machine.seconds_per_operation;
        Ok(DesignCost { peak_bytes: estimate.memory.total(), seconds })
    };
    Ok(DesignRow {
        microphones: instrument.array.len(),
        tones: instrument.sweep.len(),
        acquisition: measurement.acquisition_time(run, &grid),
        range_resolution: instrument.range_resolution(),
        widths: design.depths.map(|at| at.widths[0]),
        verdict: design.aliasing.verdict,
        grating_lobe_offset: design.depths[0]
            .grating_lobe_offset
            .filter(|_| design.aliasing.verdict == Verdict::GratingLobes),
        peak_sidelobe_db: design.aliasing.sidelobes.peak_db,
        mean_sidelobe_db: design.aliasing.sidelobes.mean_db,
        cost: machine.map(cost).transpose()?,
    })
}

/// Point-spread functions of a run file's instrument at the given points, or, without any, at the middle of the grid's
/// nearest, middle and farthest depth. Only the size of the scene is used.
///
/// # Errors
/// The errors of the run file, of the simulation of one reflector and of its reconstruction.
pub fn point_spreads(run: &RunFile, points: &[DVec3], job: &JobOptions) -> Result<(Grid, Vec<PointSpread>)> {
    let observer = job.observer;
    let measurement = Measurement::of(run)?;
    let instrument = &measurement.instrument;
    let bounds = size_of(run, job.known(), observer)?.bounds;
    let grid = run.voxels(instrument, bounds)?;
    // One point is simulated instead of the scene.
    let budget = MemoryBudget::of(run);
    measurement.check((&budget, Held::Cube), &grid, &SceneSize::within(bounds), observer)?;
    // Adding 0 turns a negative zero into a positive one.
    let middle = |axis: &Axis| (f64::midpoint(axis.first, axis.last()) * 1e9).round() / 1e9 + 0.0;
    let near = grid.z.first.max(instrument.wavelength());
    let depths = [near, f64::midpoint(near, grid.z.last()), grid.z.last().max(near)];
    let chosen = depths.map(|z| DVec3::new(middle(&grid.x), middle(&grid.y), z));
    let points = if points.is_empty() { &chosen[..] } else { points };
    // That of Eq. 13: of a refined volume it would be of this one point only.
    let options = run.reconstruct_options().with_refine(None);
    let spreads = points.iter().map(|p| point_spread_with(instrument, &options, &grid, *p, observer));
    Ok((grid, spreads.collect::<Result<_>>()?))
}
