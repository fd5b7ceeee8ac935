//! What `plan` shows: everything about a job that can be known before any ray or sample.

use super::budget::{Budget, Seen};
use super::echoes::{Measurement, placement_warnings};
use super::facts::compensation;
use super::{is_csv, is_in_metres, outputs, scene_path};
use crate::acquisition::{CubeFile, CubeSource, Instrument};
use crate::config::RunFile;
use crate::error::Result;
use crate::grid::Grid;
use crate::plan::{Design, Holding, Needs, Plan, design, plan, simulation_peak};
use crate::progress::Observer;
use glam::DVec3;
use serde::Serialize;

/// What a job will resolve, need and write.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Forecast {
    /// Resolution, ambiguity, aliasing.
    pub plan: Plan,
    /// Widths, ghosts and sidelobes, and what would mend each warning.
    pub design: Design,
    /// The voxels, whether typed or chosen.
    pub grid: Grid,
    /// Operations and bytes of `image`.
    pub needs: Needs,
    /// Bytes at the peak by command.
    pub peaks: Peaks,
    /// What will be simulated beyond Eq. 5 and done to the volume, in words.
    pub physics: Vec<String>,
    /// Seconds of each method, by a short measurement of this machine's speed.
    pub seconds: Vec<f64>,
    /// Files that `image` will write.
    pub files: Vec<String>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Bytes at the peak of each command that does all of a job, or a part of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct Peaks {
    /// All of it.
    pub image: u64,
    /// The scene to a cube; of a cube file there is nothing to simulate.
    pub simulate: Option<u64>,
    /// The cube's file to a volume that grows depth by depth: .npz, .vti, .nrrd.
    pub reconstruct: u64,
}

/// Foretells `image` of a scene. The mesh is loaded for its size; no ray is traced.
///
/// # Errors
/// A run file without a scene, or one that is refused; a grid that is missing and cannot be chosen.
pub fn forecast_scene(run: &RunFile, bare: bool, observer: &dyn Observer) -> Result<Forecast> {
    let measurement = Measurement::of(run)?;
    let setup = &measurement.instrument;
    let path = scene_path(run)?;
    let mesh = !is_csv(path);
    let budget = Budget::of(run);
    let seen = Seen::of(run, bare, observer)?;
    let bounds = seen.bounds;
    let grid = run.voxels(setup, bounds)?;
    let holding = measurement.imaging(&budget, &grid, &seen);
    let mut forecast = forecast(&budget, setup, &grid, holding, mesh)?;
    let alone = measurement.simulating(&budget, &grid, &seen);
    forecast.peaks.simulate = Some(simulation_peak(alone, rayon::current_num_threads()));
    forecast.peaks.reconstruct = budget.needs(setup, &grid, Holding::default())?.peak_bytes;
    forecast.physics = measurement.physics(run);
    let mesh = mesh.then(|| is_in_metres(path));
    forecast.warnings.extend(placement_warnings(setup, &grid, bounds, mesh));
    Ok(forecast)
}

/// Foretells `image` of a cube file. No sample is read.
///
/// # Errors
/// A grid that is missing, or one that is refused.
pub fn forecast_cube(run: &RunFile, cube: &CubeFile) -> Result<Forecast> {
    let setup = cube.instrument();
    let grid = run.voxels(setup, None::<(DVec3, DVec3)>)?;
    let budget = Budget::of(run);
    let held = Holding { samples: cube.held_bytes(), ..Holding::default() };
    let mut forecast = forecast(&budget, setup, &grid, budget.imaging(setup, &grid, held), false)?;
    forecast.peaks.reconstruct = budget.needs(setup, &grid, held)?.peak_bytes;
    Ok(forecast)
}

pub(super) fn forecast(
    budget: &Budget,
    setup: &Instrument,
    grid: &Grid,
    holding: Holding,
    truth: bool,
) -> Result<Forecast> {
    let run = budget.run;
    let plan = plan(setup, grid);
    let design = design(setup, grid, run.reconstruct.window);
    let needs = budget.needs(setup, grid, holding)?;
    let seconds = needs.seconds();
    let warnings = [plan.warnings.clone(), design.warnings.clone()].concat();
    let physics = compensation(run).into_iter().collect();
    let files = outputs::names(run, truth);
    let peaks = Peaks { image: needs.peak_bytes, simulate: None, reconstruct: needs.peak_bytes };
    Ok(Forecast { plan, design, grid: *grid, needs, peaks, physics, seconds, files, warnings })
}
