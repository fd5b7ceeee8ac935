//! Depth maps without a reconstruction: of a volume file, and the truth of a scene.

use super::prepared_scene::Measurement;
use super::{JobOptions, facts, load_scene, mesh_path, resolution_of};
use crate::acquisition::Instrument;
use crate::config::RunFile;
use crate::depth::locate_depth_with;
use crate::error::{Error, Result};
use crate::export::volume_npz::read_volume_npz;
use crate::grid::{DepthMap, Grid, check_voxels};
use crate::plan::memory_limit;
use crate::progress::{Observer, stage};
use crate::scene::Scene;
use crate::truth::trace_depth_with;
use crate::wave::Resolution;
use serde_json::Value;
use std::path::Path;

/// Locates depth in a volume file; returns the depth map and the volume's metadata.
///
/// Δd comes from the file, or else from the run file's `[sweep]` if that is the sweep of the measurement (`sweep_known`).
///
/// # Errors
/// A file that is not a volume; one that does not contain its bandwidth, if no run file gives it either.
pub fn depth_of_volume(
    path: &Path,
    run: &RunFile,
    sweep_known: bool,
    job: &JobOptions,
) -> Result<(DepthMap, Value)> {
    let observer = job.observer;
    let limit = memory_limit(run.memory).unwrap_or(u64::MAX);
    let (volume, meta) = stage(observer, "reading the volume", 0, || read_volume_npz(path, limit))?;
    let from_run = || run.medium.speed() / (2.0 * (run.sweep.stop - run.sweep.start));
    let resolution = resolution_of(&meta).or_else(|| sweep_known.then(from_run)).ok_or_else(|| {
        Error::input(
            path.display(),
            "does not contain its bandwidth (`sound_speed` and `bandwidth` in `meta`), which depth needs; give a run file \
             with -c",
        )
    })?;
    check_voxels(&path.display().to_string(), &volume.grid, 0, &volume.samples)?;
    let mut run = run.clone();
    if let Some(method) = facts::refined_by(&meta) {
        run.refine.method = method;
    }
    let resolution = Resolution { range: resolution, aperture: facts::aperture_of(&meta) };
    let mut options = run.depth_options(resolution, facts::sidelobes_of(&meta).unwrap_or_default());
    options.raster = run.raster(None)?;
    options.floor = meta["incoherent_level"].as_f64().unwrap_or(0.0);
    let depth = locate_depth_with(&volume, &options, observer)?;
    depth.check().map(|()| (depth, meta))
}

/// Traces the ground truth of a run file's scene; returns its metadata and the depth map. Nothing is simulated.
///
/// # Errors
/// The errors of the stages; a scene of reflectors, which has no surfaces.
pub fn truth_of_scene(run: &RunFile, job: &JobOptions) -> Result<(Value, DepthMap)> {
    let JobOptions { bare_mesh: bare, observer, .. } = *job;
    let measurement = Measurement::of(run)?;
    let scene = load_scene(mesh_path(run)?, run, bare, observer)?;
    let instrument = measurement.instrument;
    let grid = run.voxels(&instrument, scene.bounds())?;
    let truth = truth_of(&scene, run, (&instrument, &grid), observer)?;
    Ok((facts::instrument_facts(&instrument, run), truth))
}

/// The true depth of a loaded scene, on the pixels of its depth map.
pub(super) fn truth_of(
    scene: &Scene,
    run: &RunFile,
    (instrument, grid): (&Instrument, &Grid),
    observer: &dyn Observer,
) -> Result<DepthMap> {
    let mut options = run.truth_options(instrument);
    options.raster = run.raster(scene.camera())?;
    trace_depth_with(scene, grid, &options, observer)
}
