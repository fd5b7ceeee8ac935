//! Depth maps without a reconstruction: of a volume file, and the truth of a scene.

use super::job::kept::KnownScene;
use super::prepared_scene::Measurement;
use super::{JobOptions, facts, load_surfaces, resolution_of, warn_all};
use crate::acquisition::Instrument;
use crate::config::RunFile;
use crate::depth::locate_depth_with;
use crate::error::{Error, Result};
use crate::export::figure::write_preview_figure;
use crate::export::read_volume;
use crate::grid::{Axis, DepthMap, Grid, Raster, View, VolumeView, check_voxels};
use crate::plan::memory_limit;
use crate::progress::{Observer, stage};
use crate::scene::{Scene, metres};
use crate::wave::Resolution;
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;

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
    let (volume, meta) = stage(observer, "reading the volume", 0, || read_volume(path, limit))?;
    let place = path.display().to_string();
    let depth = depth_in_volume(volume.view(), &meta, &place, (run, sweep_known), observer)?;
    Ok((depth, meta))
}

/// Locates depth in a volume in memory with its metadata, as [`depth_of_volume`] does in a file; `place` names it in messages.
///
/// # Errors
/// As [`depth_of_volume`].
pub fn depth_in_volume(
    volume: VolumeView<'_>,
    meta: &Value,
    place: &str,
    (run, sweep_known): (&RunFile, bool),
    observer: &dyn Observer,
) -> Result<DepthMap> {
    let from_run = || run.medium.speed() / (2.0 * (run.sweep.stop - run.sweep.start));
    let resolution = resolution_of(meta).or_else(|| sweep_known.then(from_run)).ok_or_else(|| {
        Error::input(
            place,
            "does not contain its bandwidth (`sound_speed` and `bandwidth` in `meta`), which depth needs; give a run file \
             with -c",
        )
    })?;
    check_voxels(place, &volume.grid, 0, volume.samples)?;
    let mut run = run.clone();
    if let Some(method) = facts::refined_by(meta) {
        run.refine.method = method;
    }
    let correlated = facts::correlated_resolution(meta);
    if let Some(method) = meta["method"].as_str().and_then(|method| method.parse().ok()) {
        run.reconstruct.method = method;
    }
    let range = correlated.unwrap_or(resolution);
    let resolution = Resolution { range, aperture: facts::aperture_of(meta) };
    let mut options = run.depth_options(resolution, facts::sidelobes_of(meta).unwrap_or_default());
    options.raster = run.raster(None)?;
    options.floor = meta["incoherent_level"].as_f64().unwrap_or(0.0);
    options.outside = meta["outside_level"].as_f64().unwrap_or(0.0);
    let depth = locate_depth_with(volume, &options, observer)?;
    depth.check().map(|()| depth)
}

/// Traces the ground truth of a run file's scene; returns its metadata and the depth map. Nothing is simulated.
///
/// # Errors
/// The errors of the stages; a scene of reflectors, which has no surfaces.
pub fn truth_of_scene(run: &RunFile, job: &JobOptions) -> Result<(Value, DepthMap)> {
    let (known, observer) = (job.known(), job.observer);
    let measurement = Measurement::of(run)?;
    let scene = load_surfaces(run, known, observer)?;
    let instrument = measurement.instrument;
    let grid = run.voxels(&instrument, scene.bounds())?;
    let truth = truth_of((&scene, known), run, (&instrument, &grid), observer)?;
    Ok((facts::instrument_facts(&instrument, run), truth))
}

/// Pixels along the longer side of a preview.
const PREVIEW: f64 = 320.0;

/// Draws a run file's scene as the array sees it, with the array's outline, into a PNG; nothing is simulated.
///
/// # Errors
/// As [`truth_of_scene`]; a file that cannot be written.
pub fn write_preview(path: &Path, run: &RunFile, job: &JobOptions) -> Result<()> {
    let observer = job.observer;
    let instrument = Measurement::of(run)?.instrument;
    let scene = load_surfaces(run, job.known(), observer)?;
    let grid = run.voxels(&instrument, scene.bounds())?;
    let (centre, half) = (instrument.array.centre(), 0.5 * instrument.array.extent());
    let (low, high) = (centre - half, centre + half);
    // All of the grid and of the array, in pixels of its own.
    let ends = [(&grid.x, low.x, high.x), (&grid.y, low.y, high.y)]
        .map(|(axis, low, high)| [axis.first.min(low), axis.last().max(high)]);
    let pitch = ends.iter().map(|[low, high]| (high - low) / PREVIEW).fold(1e-6, f64::max);
    let axis = |[low, high]: [f64; 2]| Axis::spanning(low - 4.0 * pitch, high + 4.0 * pitch, pitch);
    let wide = Raster { view: View::Orthographic, x: axis(ends[0])?, y: axis(ends[1])? };
    let raster = run.raster(scene.camera())?.unwrap_or(wide);
    let truth = truth_on(Some(raster), (&scene, job.known()), run, (&instrument, &grid), observer)?;
    let [across, up] = [half.x, half.y].map(|half| metres(2.0 * half));
    let note = scene.bounds().map_or_else(String::new, |(low, high)| {
        format!("z {:.2} to {:.2} m; array {across} x {up}", low.z, high.z)
    });
    warn_all(job.hints(), observer);
    write_preview_figure(path, &truth, [[low.x, low.y], [high.x, high.y]], &note)
}

/// The true depth of a loaded scene, on the pixels of its depth map.
pub(super) fn truth_of(
    (scene, known): (&Arc<Scene>, KnownScene<'_>),
    run: &RunFile,
    (instrument, grid): (&Instrument, &Grid),
    observer: &dyn Observer,
) -> Result<DepthMap> {
    truth_on(run.raster(scene.camera())?, (scene, known), run, (instrument, grid), observer)
}

/// The same on other pixels; `None` for those of the grid.
fn truth_on(
    raster: Option<Raster>,
    (scene, known): (&Arc<Scene>, KnownScene<'_>),
    run: &RunFile,
    (instrument, grid): (&Instrument, &Grid),
    observer: &dyn Observer,
) -> Result<DepthMap> {
    let mut options = run.truth_options(instrument);
    options.raster = raster;
    known.truth(scene, grid, &options, observer)
}
