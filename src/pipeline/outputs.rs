//! Writes every file of a run, under its documented name.

mod page;
mod volumes;

pub use page::write_page;
pub use volumes::write_volume;
use volumes::write_volume_with;
pub(super) use volumes::{VolumeFiles, needs_all};

use super::facts::attributes;
use super::job::JobOptions;
use super::{Outcome, Report};
use crate::acquisition::DataCube;
use crate::config::{OutputTable, RunFile, VolumeFormat};
use crate::error::{Error, Result};
use crate::export::depth_exr::write_depth_map;
use crate::export::figure::{
    DepthKind, depth_range, write_amplitude_figure, write_depth_figure, write_error_figure,
};
use crate::export::page::Miniature;
use crate::export::points_ply::{ScenePoints, write_depth_points};
use crate::export::volume_exr::{self, volume_exr_files};
use crate::export::volume_vdb;
use crate::export::volume_zarr;
use crate::export::{Components, Compression, Encoding, fits_float16};
use crate::files::{announce_output, extension, write_atomically};
use crate::grid::{DepthMap, Grid};
use crate::metrics::{Metrics, error_map};
use crate::progress::{Observer, advance, stage};
use page::{MESH, PAGE, page_of, title};
use serde_json::Value;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The figure of the second returns, of which there may be none.
const SECOND: &str = "depth_return2.png";

/// Volumes of fewer samples are written so soon that a second thread would not be worth its memory.
const BESIDE: usize = 1 << 20;

/// Writes the volume, the depth map, the truth, the points, the pictures, `report.json` and the page into `folder`, which
/// is created if it is missing; returns the report.
///
/// # Errors
/// [`Error::Io`] when a file cannot be written; no file is ever left half-written.
pub fn write_outputs(run: &RunFile, outcome: &Outcome, folder: &Path, job: &JobOptions) -> Result<Report> {
    let observer = job.observer;
    let start = Instant::now();
    let Outcome { image, depth, instrument, reflectors, mesh, .. } = outcome;
    warn_of_float16(&run.output, image.volume.peak(), observer);
    let facts = outcome.facts(run);
    let scene = ScenePoints::new(reflectors.as_ref(), &instrument.array, &instrument.sources());
    let scene = scene.with_bounces(outcome.multipath.as_ref().map_or(&[], |multipath| &multipath.seen));
    let truth = outcome.truth.as_ref();
    // Truth and depth share their colours, so that they can be compared by eye.
    let range = depth_range(&[truth.unwrap_or(depth)], instrument.range_resolution().unwrap_or(0.0));
    let second = depth.returns.get(1).filter(|layer| layer.depth.iter().any(|z| z.is_finite()));
    let second = second.map(|layer| DepthMap::new(depth.raster(), layer.clone()));
    let shards = job.shards();
    let write = |name: &Path| {
        let path = folder.join(name);
        let written = match (name.to_str(), truth) {
            (Some("depth.exr" | "depth.ply"), _) => write_depth(&path, depth, run, &facts),
            (Some("depth.png"), _) => write_depth_figure(&path, DepthKind::Found, depth, range),
            (Some("amplitude.png"), _) => write_amplitude_figure(&path, &image.volume),
            (Some("truth.exr"), Some(truth)) => write_depth(&path, truth, run, &facts),
            (Some("truth.png"), Some(truth)) => write_depth_figure(&path, DepthKind::True, truth, range),
            (Some("error.png"), Some(truth)) => write_error(&path, outcome, truth),
            (Some("scene.ply"), _) => scene.write(&path, &attributes(&facts)),
            (Some(MESH), _) => mesh.iter().try_for_each(|mesh| mesh.write(&path, &attributes(&facts))),
            (Some(SECOND), _) => {
                let draw = |map| write_depth_figure(&path, DepthKind::Second, map, range);
                second.iter().try_for_each(draw)
            }
            _ => return write_volume_with(&path, &image.volume, (&run.output, &facts), Some(&shards)),
        };
        written.map(|()| vec![path])
    };
    let mut names = result_names(run, truth.is_some());
    names.extend(second.is_some().then(|| SECOND.into()));
    let mut report = Report::new(run, outcome);
    stage(observer, "writing", names.len() as u64, || {
        let in_turn = |names: &[PathBuf]| -> Result<Vec<_>> {
            let mut written = Vec::new();
            for name in names {
                // A very deep volume takes several files.
                written.extend(write(name)?);
                advance(observer, 1)?;
            }
            Ok(written)
        };
        // Large volumes beside all others.
        let beside = if image.volume.samples.len() < BESIDE { 0 } else { run.output.formats.len() };
        let (volumes, others) = names.split_at(beside);
        let (volumes, others) = rayon::join(|| in_turn(volumes), || in_turn(others));
        let written = volumes?.into_iter().chain(others?);
        report.files.extend(written.filter_map(|path| path.file_name().map(PathBuf::from)));
        Ok(())
    })?;
    report.files.push("report.json".into());
    // The page is packed before the report is written, so that the report contains its time; the page contains the report.
    let page = if run.output.report {
        report.files.push(PAGE.into());
        let volume = Miniature::of_volume(&image.volume);
        Some(stage(observer, "packing the page", 0, || {
            page_of(folder, &report.files, Some(&volume), Some(&scene), u64::MAX)
        })?)
    } else {
        None
    };
    report.timings.insert("write".to_owned(), start.elapsed().as_secs_f64().into());
    let text = report.to_text()?;
    write_atomically(&folder.join("report.json"), |file| file.write_all(text.as_bytes()))?;
    observer.note(&format!("{} files in {}", report.files.len(), folder.display()));
    if let Some(page) = page {
        let scene = reflectors.is_some().then(|| run.to_json());
        page.write(&folder.join(PAGE), &title(scene.as_ref()), &text)?;
    }
    Ok(report)
}

/// Minimum bytes of a volume's file, for any content.
pub(super) fn bytes_of(path: &Path, run: &RunFile, grid: &Grid) -> u64 {
    let per_voxel = match extension(path).as_str() {
        "npz" => 8,
        "vti" if run.output.components == Components::Complex => 12,
        "vti" => 4,
        "zarr" if run.output.compression == Compression::None => 4,
        // What is weak is left out, which may be nearly all.
        "vdb" => 0,
        // Compressed: no volume of echoes shrinks to less than a quarter.
        _ => 1,
    };
    grid.voxel_count().saturating_mul(per_voxel)
}

/// The same for all volumes of a run.
pub(super) fn volume_bytes(run: &RunFile, grid: &Grid) -> u64 {
    volume_names(run).map(|name| bytes_of(&name, run, grid)).sum()
}

/// Bytes in addition to the volume that writing it into files of these names takes.
pub(super) fn writing_bytes(paths: impl IntoIterator<Item: AsRef<Path>>, run: &RunFile, grid: &Grid) -> u64 {
    let bytes = |path: &Path| match extension(path).as_str() {
        "exr" => volume_exr::writing_bytes(grid, run.output.components),
        "vdb" => volume_vdb::writing_bytes(grid),
        "zarr" => volume_zarr::writing_bytes(grid, run.output.components),
        _ => 0,
    };
    let (mut together, mut one) = (0, 0);
    for path in paths {
        let (path, taken) = (path.as_ref(), bytes(path.as_ref()));
        // Those that need the whole volume are written one after the other.
        if needs_all(path) { one = taken.max(one) } else { together += taken }
    }
    one.max(together)
}

/// The names of a run's volumes.
pub(super) fn volume_names(run: &RunFile) -> impl Iterator<Item = PathBuf> {
    run.output.formats.iter().map(|format| format!("volume.{format}").into())
}

/// The names of a run's results, with or without a truth; without that of the second returns, of which there may be none.
fn result_names(run: &RunFile, truth: bool) -> Vec<PathBuf> {
    let mut names = vec!["depth.exr", "amplitude.png", "depth.png"];
    if truth {
        names.extend(["truth.exr", "truth.png", "error.png"]);
    }
    if run.output.points {
        names.extend(["depth.ply", "scene.ply"]);
        names.extend(truth.then_some(MESH));
    }
    volume_names(run).chain(names.into_iter().map(PathBuf::from)).collect()
}

/// The files that [`write_outputs`] will write, with or without a truth; a very deep volume may take several, and second
/// returns have a figure of their own.
pub(super) fn names(run: &RunFile, truth: bool) -> Vec<String> {
    let mut names = result_names(run, truth);
    names.push("report.json".into());
    names.extend(run.output.report.then(|| PAGE.into()));
    names.iter().map(|name| name.display().to_string()).collect()
}

/// Announces the files that [`write_outputs`] will write into `folder`, with or without a truth, so that none replaces an
/// input.
///
/// # Errors
/// A name in the folder that refers to an input, or that cannot be written.
pub(crate) fn announce_outputs(run: &RunFile, folder: &Path, truth: bool) -> Result<()> {
    /// More depths than any grid has. Their files that do not exist yet cannot be an input.
    const DEPTHS: usize = 1 << 20;
    let volumes: Vec<PathBuf> = volume_names(run).map(|name| folder.join(name)).collect();
    let further = volumes.iter().flat_map(|path| further_files(path, DEPTHS)).filter(|path| path.exists());
    let second = (run.depth.returns > 1).then(|| SECOND.to_owned());
    let names = names(run, truth).into_iter().chain(second).map(|name| folder.join(name));
    names.chain(further).try_for_each(|path| announce_output(&path))
}

/// Announces the files that very deep volumes take in addition to those that were asked for.
pub(super) fn announce_further(paths: &[PathBuf], grid: &Grid) -> Result<()> {
    paths
        .iter()
        .flat_map(|path| further_files(path, grid.z.count))
        .try_for_each(|path| announce_output(&path))
}

/// The files of a volume of `depths` depths after the first.
fn further_files(path: &Path, depths: usize) -> impl Iterator<Item = PathBuf> {
    let files = if extension(path) == "exr" { volume_exr_files(path, depths) } else { Vec::new() };
    files.into_iter().skip(1)
}

/// Warns of half floats that cannot represent the amplitudes.
fn warn_of_float16(output: &OutputTable, peak: f32, observer: &dyn Observer) {
    if output.float16 && output.formats.contains(&VolumeFormat::Exr) && !fits_float16(peak) {
        observer.warn(&format!(
            "[output] float16: half floats do not represent amplitudes of a peak of {peak:e} well, so volume.exr has 32 bits"
        ));
    }
}

/// Writes a depth map or a truth with its metadata: as an image, or as points.
///
/// # Errors
/// An extension other than `.exr` or `.ply`; a file that cannot be written.
pub fn write_depth(path: &Path, map: &DepthMap, run: &RunFile, facts: &Value) -> Result<()> {
    let OutputTable { float16, compression, .. } = run.output;
    match extension(path).as_str() {
        "exr" => {
            let encoding = Encoding { float16, compression };
            write_depth_map(path, map, run.depth.fill, &attributes(facts), encoding)
        }
        "ply" => write_depth_points(path, map, &attributes(facts)),
        _ => Err(Error::input(
            path.display(),
            "depth maps are written as .exr, or as points in .ply; give one of these extensions",
        )),
    }
}

/// Writes a cube.
///
/// # Errors
/// An extension other than `.npz` or `.zarr`; a file that cannot be written.
pub fn write_cube(path: &Path, cube: &DataCube) -> Result<()> {
    check_cube_name(path)?;
    cube.write(path)
}

/// Refuses an extension with which no cube is written.
pub(crate) fn check_cube_name(path: &Path) -> Result<()> {
    if ["npz", "zarr"].contains(&extension(path).as_str()) {
        return Ok(());
    }
    Err(Error::input(path.display(), "cubes are written as .npz or .zarr; give one of these extensions"))
}

/// Draws the error with its median and rms.
fn write_error(path: &Path, outcome: &Outcome, truth: &DepthMap) -> Result<()> {
    let errors = error_map(&outcome.depth, truth)?;
    let resolution = outcome.instrument.range_resolution().unwrap_or(f64::NAN);
    let note = error_note(&outcome.metrics().unwrap_or_default());
    write_error_figure(path, &errors, &truth.raster(), resolution, &note)
}

/// The caption of an error figure.
pub(crate) fn error_note(metrics: &Metrics) -> String {
    let millimetres = |value: Option<f64>| value.map_or("none".to_owned(), |m| format!("{:.1} mm", m * 1e3));
    format!("median |error| {}, rms {}", millimetres(metrics.median_error), millimetres(metrics.rmse))
}
