//! What `plan` shows: everything about a job that can be known before any ray or sample.

use super::echoes::{Measurement, placement_warnings};
use super::facts::compensation;
use super::job::JobOptions;
use super::memory::{MemoryBudget, SceneSize};
use super::{is_csv, is_in_metres, outputs, scene_path};
use crate::acquisition::{CubeFile, CubeSource, Instrument};
use crate::config::RunFile;
use crate::error::Result;
use crate::grid::Grid;
use crate::plan::{Design, JobArrays, MemoryEstimate, Plan, design, plan};
use crate::reconstruct::Estimate;
use glam::DVec3;
use serde::Serialize;

/// What a job will resolve, need and write.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Forecast {
    /// Resolution, ambiguity, aliasing.
    pub plan: Plan,
    /// Widths, ghosts and sidelobes, and what would fix each warning.
    pub design: Design,
    /// The voxels, whether typed or chosen.
    pub grid: Grid,
    /// Every method, possible here or not, with its operations and bytes.
    pub methods: Vec<Estimate>,
    /// Which of them the job takes, as an index.
    pub chosen: usize,
    /// Worker threads.
    pub threads: usize,
    /// Memory at the peak of each command that does all of the job or a part of it, `image` first.
    pub memory: Vec<CommandMemory>,
    /// What will be simulated beyond Eq. 5 and done to the volume, in words.
    pub physics: Vec<String>,
    /// Seconds of each method, by a short measurement of this machine's speed.
    pub seconds: Vec<f64>,
    /// Files that `image` will write.
    pub files: Vec<String>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// The memory that a command takes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct CommandMemory {
    /// `image`; `simulate`, where there is a scene; `reconstruct`, from a cube in a file to a volume that is written depth by
    /// depth (.npz, .vti, .nrrd).
    pub command: &'static str,
    /// Bytes at the peak.
    pub bytes: u64,
    /// When that is, and what they are of.
    pub peak: MemoryEstimate,
}

impl CommandMemory {
    fn new(command: &'static str, peak: MemoryEstimate) -> Self {
        Self { command, bytes: peak.total(), peak }
    }
}

/// Predicts `image` of a scene. The mesh is loaded for its size; no ray is traced.
///
/// # Errors
/// A run file without a scene, or one that is refused; a grid that is missing and cannot be chosen.
pub fn forecast_scene(run: &RunFile, job: &JobOptions) -> Result<Forecast> {
    let JobOptions { bare_mesh: bare, observer, .. } = *job;
    let measurement = Measurement::of(run)?;
    let instrument = &measurement.instrument;
    let path = scene_path(run)?;
    let mesh = !is_csv(path);
    let budget = MemoryBudget::of(run);
    let size = SceneSize::of(run, bare, observer)?;
    let bounds = size.bounds;
    let grid = run.voxels(instrument, bounds)?;
    let mut forecast =
        forecast(&budget, instrument, &grid, &measurement.imaging(&budget, &grid, &size), mesh)?;
    let simulation = measurement.simulating(run, &grid, &size).peak(0);
    forecast.memory.push(CommandMemory::new("simulate", simulation));
    forecast.memory.push(reconstruction(&budget, instrument, &grid, JobArrays::default())?);
    forecast.physics = measurement.physics(run);
    let mesh = mesh.then(|| is_in_metres(path));
    forecast.warnings.extend(placement_warnings(instrument, &grid, bounds, mesh));
    Ok(forecast)
}

/// Predicts `image` of a cube file. No sample is read.
///
/// # Errors
/// A grid that is missing, or one that is refused.
pub fn forecast_cube(run: &RunFile, cube: &CubeFile) -> Result<Forecast> {
    let instrument = cube.instrument();
    let grid = run.voxels(instrument, None::<(DVec3, DVec3)>)?;
    let budget = MemoryBudget::of(run);
    let samples = JobArrays { samples: cube.held_bytes(), ..JobArrays::default() };
    let mut forecast =
        forecast(&budget, instrument, &grid, &budget.imaging(instrument, &grid, samples), false)?;
    forecast.memory.push(reconstruction(&budget, instrument, &grid, samples)?);
    Ok(forecast)
}

/// Of `reconstruct` from a file, of whose samples some may be in memory.
fn reconstruction(
    budget: &MemoryBudget,
    instrument: &Instrument,
    grid: &Grid,
    samples: JobArrays,
) -> Result<CommandMemory> {
    let arrays = budget.reconstructing([], grid, false, samples);
    Ok(CommandMemory::new("reconstruct", budget.estimate(instrument, grid, &arrays)?.memory))
}

pub(super) fn forecast(
    budget: &MemoryBudget,
    instrument: &Instrument,
    grid: &Grid,
    arrays: &JobArrays,
    truth: bool,
) -> Result<Forecast> {
    let run = budget.run;
    let plan = plan(instrument, grid);
    let design = design(instrument, grid, run.reconstruct.window);
    let estimate = budget.estimate(instrument, grid, arrays)?;
    let seconds = estimate.seconds();
    let warnings = [plan.warnings.clone(), design.warnings.clone()].concat();
    let physics = compensation(run).into_iter().collect();
    let files = outputs::names(run, truth);
    let memory = vec![CommandMemory::new("image", estimate.memory)];
    let (methods, chosen, threads) = (estimate.methods, estimate.chosen, estimate.threads);
    let grid = *grid;
    Ok(Forecast { plan, design, grid, methods, chosen, threads, memory, physics, seconds, files, warnings })
}
