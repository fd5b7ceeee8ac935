//! What `plan` shows: everything about a job that can be known before any ray or sample.

use super::echoes::{Measurement, placement_warnings};
use super::facts::compensation;
use super::{is_csv, is_in_metres, outputs, scene_path};
use crate::acquisition::{CubeFile, CubeSource, Setup};
use crate::config::RunFile;
use crate::error::Result;
use crate::grid::Grid;
use crate::plan::{Design, Holding, Needs, Plan, design, left_for_method, memory_limit, needs, plan};
use crate::progress::Observer;
use crate::reconstruct::ReconstructOptions;
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
    /// Operations and bytes of `image`.
    pub needs: Needs,
    /// Bytes at the peak by command.
    pub peaks: Peaks,
    /// What will be simulated beyond Eq. 5 and done to the volume, in words.
    pub physics: Vec<String>,
    /// Seconds of each method, by a short measurement of this machine's speed.
    pub seconds: [f64; 4],
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
    let setup = measurement.setup();
    let path = scene_path(run)?;
    let mesh = !is_csv(path);
    let bounds = if mesh {
        Scene::load(path, &run.load_options(bare)?, observer)?.bounds()
    } else {
        Reflectors::read_csv(path)?.bounds()
    };
    let grid = run.voxels(&setup, bounds)?;
    let beside = measurement.simulating(bounds);
    let holding = imaging(run, &setup, &grid, setup.cube_bytes(), beside);
    let mut forecast = forecast(run, &setup, &grid, holding, mesh)?;
    forecast.peaks.simulate = Some(measurement.simulation_peak(bounds));
    forecast.peaks.reconstruct = needs_of(run, &setup, &grid, Holding::default())?.peak_bytes;
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
    let holding = imaging(run, &setup, &grid, cube.held_bytes(), 0);
    let mut forecast = forecast(run, &setup, &grid, holding, false)?;
    let alone = Holding { samples: cube.held_bytes(), ..Holding::default() };
    forecast.peaks.reconstruct = needs_of(run, &setup, &grid, alone)?.peak_bytes;
    Ok(forecast)
}

/// What `image` holds, given bytes of samples and what simulating them takes beside them.
pub(super) fn imaging(run: &RunFile, setup: &Setup, grid: &Grid, samples: u64, simulating: u64) -> Holding {
    let depth = run.depth_options(setup.range_resolution().unwrap_or(f64::NAN)).search_bytes(grid);
    let writing = outputs::writing_bytes(outputs::volume_names(run), run, grid);
    Holding { samples, simulating, volume: true, depth, writing }
}

/// How a volume is to be made within the memory there is.
pub(super) fn options_within(run: &RunFile, grid: &Grid, holding: Holding) -> ReconstructOptions {
    let mut options = run.reconstruct_options();
    options.memory = left_for_method(grid, holding, memory_limit(), rayon::current_num_threads());
    options
}

/// What that takes.
pub(super) fn needs_of(run: &RunFile, setup: &Setup, grid: &Grid, holding: Holding) -> Result<Needs> {
    needs(setup, grid, &options_within(run, grid, holding), holding, rayon::current_num_threads())
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
    let needs = needs_of(run, setup, grid, holding)?;
    let seconds = needs.seconds();
    let warnings = [plan.warnings.clone(), design.warnings.clone()].concat();
    let physics = compensation(run).into_iter().collect();
    let files = outputs::names(run, truth);
    let peaks = Peaks { image: needs.peak_bytes, simulate: None, reconstruct: needs.peak_bytes };
    Ok(Forecast { plan, design, grid: *grid, needs, peaks, physics, seconds, files, warnings })
}
