//! What `plan` shows: everything about a job that can be known before any ray or sample.

use super::echoes::{Measurement, placement_warnings};
use super::facts::compensation;
use super::{is_csv, is_in_metres, outputs, scene_path};
use crate::acquisition::{CubeFile, CubeSource, Setup};
use crate::config::RunFile;
use crate::error::Result;
use crate::grid::Grid;
use crate::plan::{Design, Holding, Needs, Plan, design, needs, plan};
use crate::progress::Observer;
use crate::reflectors::Reflectors;
use crate::scene::Scene;
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
    /// Operations, bytes and seconds on this machine.
    pub needs: Needs,
    /// What will be simulated beyond Eq. 5 and done to the volume, in words.
    pub physics: Vec<String>,
    /// Files that `image` will write.
    pub files: Vec<String>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Foretells `image` of a scene. The mesh is loaded for its size; no ray is traced.
///
/// # Errors
/// A run file without a scene, or one that is refused; a grid that is missing and cannot be chosen.
pub fn forecast_scene(run: &RunFile, bare: bool, observer: &dyn Observer) -> Result<Forecast> {
    let measurement = Measurement::of(run)?;
    let setup = measurement.setup();
    let path = scene_path(run)?;
    let mesh = !is_csv(path);
    let bounds = if mesh {
        Scene::load(path, &run.load_options(bare)?, observer)?.bounds()
    } else {
        Reflectors::read_csv(path)?.bounds()
    };
    let grid = run.voxels(&setup, bounds)?;
    let holding = Holding::of_simulation(&setup);
    let mut forecast = forecast(run, &setup, &grid, holding, mesh)?;
    forecast.physics = measurement.physics(run);
    let mesh = mesh.then(|| is_in_metres(path));
    forecast.warnings.extend(placement_warnings(&setup, &grid, bounds, mesh));
    Ok(forecast)
}

/// Foretells `image` of a cube file. No sample is read.
///
/// # Errors
/// A grid that is missing, or one that is refused.
pub fn forecast_cube(run: &RunFile, cube: &CubeFile) -> Result<Forecast> {
    let setup = cube.setup();
    let grid = run.voxels(&setup, None::<(DVec3, DVec3)>)?;
    let holding = Holding { samples: cube.held_bytes(), volume: true, depth: true, ..Holding::default() };
    forecast(run, &setup, &grid, holding, false)
}

pub(super) fn forecast(
    run: &RunFile,
    setup: &Setup,
    grid: &Grid,
    holding: Holding,
    truth: bool,
) -> Result<Forecast> {
    let plan = plan(setup, grid);
    let design = design(setup, grid, run.reconstruct.window);
    let needs = needs(setup, grid, &run.reconstruct_options(), holding, rayon::current_num_threads())?;
    let warnings = [plan.warnings.clone(), design.warnings.clone()].concat();
    let physics = compensation(run).into_iter().collect();
    Ok(Forecast { plan, design, grid: *grid, needs, physics, files: outputs::names(run, truth), warnings })
}
