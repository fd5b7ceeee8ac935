//! Every stage in order, on one page: [`image_scene`] and [`image_cube`] are the main job.
//!
//! Only this module and the binary see the run file. Stages are timed and their warnings kept for the report; the
//! files are written by `outputs`, and `check` holds the same result to the run file's `[expect]`.

mod echoes;
mod facts;
mod forecast;
mod limits;
mod log;
mod outputs;
mod page;
mod report;

pub use facts::resolution_of;
pub use forecast::{Forecast, forecast_cube, forecast_scene};
pub use limits::{Bound, Verdict, hold};
pub use outputs::{write_cube, write_depth, write_outputs, write_volume};
pub use page::write_page;
pub use report::{Report, SceneSummary};

use crate::acquisition::{CubeFile, CubeSource, DataCube, Instrument, Setup, Sweep};
use crate::config::RunFile;
use crate::depth::locate_depth;
use crate::error::{Error, Result};
use crate::export::volume_npz::read_volume_npz;
use crate::grid::{DepthMap, Grid};
use crate::metrics::{Metrics, evaluate};
use crate::plan::{Holding, Plan, check_memory, gib, memory_limit, plan};
use crate::progress::{Observer, stage};
use crate::reconstruct::{Reconstruction, reconstruct_into, reconstruct_whole};
use crate::reflectors::Reflectors;
use crate::scene::Scene;
use crate::truth::trace_depth;
use echoes::{Echoes, Measurement};
use forecast::{needs_of, options_within};
use log::Log;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Everything that one run computes, before anything is written.
#[derive(Debug)]
#[non_exhaustive]
pub struct Outcome {
    /// What was foretold.
    pub plan: Plan,
    /// The scene, when there was one.
    pub scene: Option<SceneSummary>,
    /// The reflectors simulated, when they were.
    pub reflectors: Option<Reflectors>,
    /// What it was, or would be, measured with.
    pub instrument: Instrument,
    /// The volume, and how it was come by.
    pub image: Reconstruction,
    /// What was found.
    pub depth: DepthMap,
    /// What is there; only a mesh scene knows.
    pub truth: Option<DepthMap>,
    /// The one against the other.
    pub metrics: Option<Metrics>,
    /// Seconds per stage, in order.
    pub timings: Vec<(String, f64)>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Scene in, everything out: load, sample, plan, simulate, reconstruct, locate, trace the truth, score.
///
/// `bare` says that the mesh came without a run file and is to be placed before the array.
///
/// # Errors
/// What the stages refuse; a run file without a scene.
pub fn image_scene(run: &RunFile, bare: bool, observer: &dyn Observer) -> Result<Outcome> {
    let log = Log::new(observer);
    need_bandwidth("[sweep]", &run.sweep()?)?;
    let echoes = log.timed("scene", || Echoes::of(run, bare, true, &log))?;
    echoes.warn(&log);
    let cube = log.timed("simulate", || echoes.simulate(run, &log))?;
    let (image, depth) = focus(run, &mut &cube, &echoes.grid, &log)?;
    drop(cube);
    let truth = match &echoes.scene {
        Some(scene) => {
            let options = run.truth_options(&echoes.setup());
            Some(log.timed("truth", || trace_depth(scene, &echoes.grid, &options, &log))?)
        }
        None => None,
    };
    let resolution = echoes.setup().range_resolution().unwrap_or(f64::NAN);
    let metrics = truth.as_ref().map(|truth| evaluate(&depth, truth, resolution)).transpose()?;
    let instrument = echoes.setup().to_instrument();
    let (scene, reflectors, plan) = (echoes.summary(), Some(echoes.reflectors), echoes.plan);
    let (timings, warnings) = log.finish();
    Ok(Outcome { plan, scene, reflectors, instrument, image, depth, truth, metrics, timings, warnings })
}

/// Cube in, everything but truth and metrics out.
///
/// # Errors
/// What the stages refuse; a run file without a grid.
pub fn image_cube(run: &RunFile, mut cube: CubeFile, observer: &dyn Observer) -> Result<Outcome> {
    let log = Log::new(observer);
    let instrument = cube.setup().to_instrument();
    need_bandwidth("the cube's `frequencies`", &instrument.sweep)?;
    let grid = run.voxels(&instrument.setup(), None)?;
    let plan = plan(&instrument.setup(), &grid);
    warn_all(&plan.warnings, &log);
    let holding = Holding { samples: cube.held_bytes(), volume: true, depth: true, ..Holding::default() };
    room(run, &instrument.setup(), &grid, holding, &log)?;
    let (image, depth) = focus(run, &mut cube, &grid, &log)?;
    let (timings, warnings) = log.finish();
    let (scene, reflectors, truth, metrics) = (None, None, None, None);
    Ok(Outcome { plan, scene, reflectors, instrument, image, depth, truth, metrics, timings, warnings })
}

/// Scene in, cube out.
///
/// # Errors
/// What the stages refuse; a run file without a scene.
pub fn simulate_scene(run: &RunFile, bare: bool, observer: &dyn Observer) -> Result<DataCube> {
    let echoes = Echoes::of(run, bare, false, observer)?;
    echoes.warn(observer);
    echoes.simulate(run, observer)
}

/// Cube in, volume files out, and their names; of the run file only `[grid]` and `[reconstruct]` count.
///
/// # Errors
/// What the stages refuse; a run file without a grid; a file that cannot be written.
pub fn reconstruct_cube(
    run: &RunFile,
    mut cube: CubeFile,
    outputs: &[PathBuf],
    observer: &dyn Observer,
) -> Result<Vec<PathBuf>> {
    let instrument = cube.setup().to_instrument();
    let setup = instrument.setup();
    let grid = run.voxels(&setup, None)?;
    let plan = plan(&setup, &grid);
    warn_all(&plan.warnings, observer);
    let volume = outputs.iter().any(|path| outputs::needs_all(path));
    let holding = Holding { samples: cube.held_bytes(), volume, ..Holding::default() };
    room(run, &setup, &grid, holding, observer)?;
    let mut files = outputs::VolumeFiles::new(setup, run, grid, outputs);
    reconstruct_into(&mut cube, &grid, &options_within(run, &grid, holding), &mut files, observer)?;
    files.finish()
}

/// Volume file in, depth map out, with the volume's own facts.
///
/// Δd comes from the file, else from the run file's `[sweep]` if it is the measurement's (`sweep_known`).
///
/// # Errors
/// A file that is no volume; one that does not say its bandwidth, when there is no run file that does.
pub fn depth_of_volume(
    path: &Path,
    run: &RunFile,
    sweep_known: bool,
    limit: u64,
    observer: &dyn Observer,
) -> Result<(DepthMap, Value)> {
    let (volume, meta) = read_volume_npz(path, limit)?;
    let from_run = || run.medium.sound_speed / (2.0 * (run.sweep.stop - run.sweep.start));
    let resolution = resolution_of(&meta).or_else(|| sweep_known.then(from_run)).ok_or_else(|| {
        Error::input(
            path.display(),
            "does not say its bandwidth (`sound_speed` and `bandwidth` in `meta`), which depth needs; give a run file \
             with -c",
        )
    })?;
    Ok((locate_depth(&volume, &run.depth_options(resolution), observer)?, meta))
}

/// Run file in, ground truth and its facts out; nothing is simulated.
///
/// # Errors
/// What the stages refuse; a scene of reflectors, which has no surfaces.
pub fn truth_of_scene(run: &RunFile, bare: bool, observer: &dyn Observer) -> Result<(Value, DepthMap)> {
    let measurement = Measurement::of(run)?;
    let path = scene_path(run)?;
    if is_csv(path) {
        return Err(Error::input(
            path.display(),
            "is a list of reflectors, which have no surfaces and so no true depth; a mesh was expected",
        ));
    }
    let scene = Scene::load(path, &run.load_options(bare)?, observer)?;
    let setup = measurement.setup();
    let grid = run.voxels(&setup, scene.bounds())?;
    let truth = trace_depth(&scene, &grid, &run.truth_options(&setup), observer)?;
    Ok((facts::setup_facts(&setup, run), truth))
}

/// Runs a scene and holds its metrics to the run file's `[expect]`: what `check` does, and our regression tests.
///
/// # Errors
/// What the stages refuse; a run file without `[expect]`, or a scene without a truth.
pub fn check_scene(
    path: &Path,
    overrides: &[String],
    observer: &dyn Observer,
) -> Result<(Metrics, Vec<Verdict>)> {
    let run = RunFile::load(path, overrides)?;
    if run.expect.limits.is_empty() {
        return Err(Error::input(
            path.display(),
            "has no [expect], so there is nothing to hold it to; add for example `completeness = { min = 0.65 }`",
        ));
    }
    let metrics = image_scene(&run, false, observer)?.metrics.ok_or_else(|| {
        Error::input(path.display(), "has no mesh and so no truth to be held to; [expect] needs one")
    })?;
    let bounds =
        run.expect.limits.iter().map(|(metric, limit)| Bound { metric: metric.clone(), limit: *limit });
    Ok((metrics, hold(&metrics, bounds)))
}

/// Refuses to look for depth with a single tone, before the long work rather than after it.
fn need_bandwidth(place: &str, sweep: &Sweep) -> Result<()> {
    if sweep.bandwidth() > 0.0 {
        return Ok(());
    }
    Err(Error::input(
        place,
        "is a single tone, but depth needs a bandwidth (the range resolution is c/2B); take several frequencies, or use \
         `simulate` and `reconstruct`, which do without",
    ))
}

/// Reconstruction and depth, which every job with a cube shares.
fn focus(
    run: &RunFile,
    source: &mut dyn CubeSource,
    grid: &Grid,
    log: &Log,
) -> Result<(Reconstruction, DepthMap)> {
    let resolution = source.setup().range_resolution().unwrap_or(f64::NAN);
    let holding = Holding { samples: source.held_bytes(), volume: true, ..Holding::default() };
    let options = options_within(run, grid, holding);
    let image = log.timed("reconstruct", || reconstruct_whole(source, grid, &options, log))?;
    let depth = log.timed("depth", || locate_depth(&image.volume, &run.depth_options(resolution), log))?;
    if depth.accepted() == 0 {
        log.warn(
            "no return was accepted anywhere: nothing in the grid echoes, or [depth] threshold_db is too high; the \
             files are valid and empty",
        );
    }
    Ok((image, depth))
}

/// Refuses a job that cannot fit in memory, and says what one that can will take.
fn room(run: &RunFile, setup: &Setup, grid: &Grid, holding: Holding, observer: &dyn Observer) -> Result<()> {
    let needs = needs_of(run, setup, grid, holding)?;
    check_memory(&needs, setup, grid, holding, memory_limit())?;
    stage(observer, &format!("taking about {} of memory", gib(needs.peak_bytes)), 0, || Ok(()))
}

fn warn_all(warnings: &[String], observer: &dyn Observer) {
    for warning in warnings {
        observer.warn(warning);
    }
}

/// The scene file that a run needs.
fn scene_path(run: &RunFile) -> Result<&Path> {
    run.scene.mesh.as_ref().map(|file| file.path.as_path()).ok_or_else(|| {
        Error::input(
            "[scene] mesh",
            "is missing; name a mesh (.obj, .gltf, .glb, .stl, .ply) or a reflector list (.csv)",
        )
    })
}

/// Whether a scene file is a list of reflectors.
fn is_csv(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("csv"))
}
