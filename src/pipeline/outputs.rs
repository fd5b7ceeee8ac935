//! Every file of a run, under its contracted name.

use super::facts::{attributes, image_facts};
use super::{Outcome, Report};
use crate::acquisition::DataCube;
use crate::config::{RunFile, VolumeFormat};
use crate::error::{Error, Result};
use crate::export::Components;
use crate::export::depth_exr::write_depth_map;
use crate::export::figure::{depth_range, write_amplitude_figure, write_depth_figure, write_error_figure};
use crate::export::volume_exr::write_volume_exr;
use crate::export::volume_npz::write_volume_npz;
use crate::export::volume_vti::write_volume_vti;
use crate::files::write_atomically;
use crate::grid::{DepthMap, Volume};
use crate::metrics::error_map;
use crate::progress::{Observer, stage};
use serde_json::Value;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Writes the volume, the depth map, the truth, the pictures and `report.json` into `folder`, which is made if it is
/// missing; gives the report.
///
/// # Errors
/// [`Error::Environment`] when a file cannot be written; no file is ever left half-written.
pub fn write_outputs(
    run: &RunFile,
    outcome: &Outcome,
    folder: &Path,
    observer: &dyn Observer,
) -> Result<Report> {
    let begun = Instant::now();
    let facts = image_facts(&outcome.instrument.setup(), run, &outcome.image.made());
    let mut files = Vec::new();
    let formats = &run.output.formats;
    let mut tasks: Vec<Task> = Vec::new();
    for format in formats {
        let name = match format {
            VolumeFormat::Exr => "volume.exr",
            VolumeFormat::Npz => "volume.npz",
            VolumeFormat::Vti => "volume.vti",
        };
        tasks.push((name, Box::new(|path| write_volume(path, &outcome.image.volume, &facts))));
    }
    tasks.push(("depth.exr", Box::new(|path| one(path, write_depth(path, &outcome.depth, run, &facts)))));
    tasks.push((
        "amplitude.png",
        Box::new(|path| one(path, write_amplitude_figure(path, &outcome.image.volume))),
    ));
    let truth = outcome.truth.as_ref();
    // Truth and depth share their colours, so that they can be compared by eye.
    let range = depth_range(&truth.map_or(vec![&outcome.depth], |truth| vec![truth]));
    tasks.push((
        "depth.png",
        Box::new(move |path| one(path, write_depth_figure(path, "depth", &outcome.depth, range))),
    ));
    if let Some(truth) = truth {
        tasks.push(("truth.exr", Box::new(|path| one(path, write_depth(path, truth, run, &facts)))));
        tasks.push((
            "truth.png",
            Box::new(move |path| one(path, write_depth_figure(path, "true depth", truth, range))),
        ));
        tasks.push(("error.png", Box::new(|path| one(path, write_error(path, outcome, truth)))));
    }
    stage(observer, "writing", tasks.len() as u64, || {
        for (name, write) in &tasks {
            files.extend(write(&folder.join(name))?);
            crate::progress::advance(observer, 1)?;
        }
        Ok(())
    })?;
    drop(tasks);
    let mut report = Report::new(run, outcome);
    report.files = files.iter().filter_map(|path| path.file_name().map(PathBuf::from)).collect();
    report.files.push("report.json".into());
    report.timings.insert("write".to_owned(), begun.elapsed().as_secs_f64().into());
    write_json(&folder.join("report.json"), &report)?;
    Ok(report)
}

/// A file's name and what writes it (and, for a deep volume, its continuations).
type Task<'a> = (&'static str, Box<dyn Fn(&Path) -> Result<Vec<PathBuf>> + 'a>);

/// The list of one file.
fn one(path: &Path, written: Result<()>) -> Result<Vec<PathBuf>> {
    written.map(|()| vec![path.to_path_buf()])
}

/// Writes a volume in the format of the path's extension; gives the files written.
///
/// # Errors
/// Another extension than `.exr`, `.npz` or `.vti`; a file that cannot be written.
pub fn write_volume(path: &Path, volume: &Volume, facts: &Value) -> Result<Vec<PathBuf>> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    match extension.as_str() {
        "npz" => one(path, write_volume_npz(path, volume, facts)),
        "exr" => write_volume_exr(path, volume, Components::Amplitude, &attributes(facts)),
        "vti" => one(path, write_volume_vti(path, volume, Components::Complex, &attributes(facts))),
        _ => Err(Error::input(
            path.display(),
            "volumes are written as .npz, .exr or .vti; give one of these extensions",
        )),
    }
}

/// Writes a depth map or a truth with the run's facts.
///
/// # Errors
/// Another extension than `.exr`; a file that cannot be written.
pub fn write_depth(path: &Path, map: &DepthMap, run: &RunFile, facts: &Value) -> Result<()> {
    if !path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr")) {
        return Err(Error::input(path.display(), "depth maps are written as .exr; give this extension"));
    }
    write_depth_map(path, map, run.depth.fill.into(), &attributes(facts))
}

/// Writes a cube.
///
/// # Errors
/// Another extension than `.npz`; a file that cannot be written.
pub fn write_cube(path: &Path, cube: &DataCube) -> Result<()> {
    if !path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npz")) {
        return Err(Error::input(path.display(), "cubes are written as .npz; give this extension"));
    }
    cube.write(path)
}

/// Draws the error with its median and rms.
fn write_error(path: &Path, outcome: &Outcome, truth: &DepthMap) -> Result<()> {
    let errors = error_map(&outcome.depth, truth)?;
    let millimetres = |value: Option<f64>| value.map_or("none".to_owned(), |m| format!("{:.1} mm", m * 1e3));
    let metrics = outcome.metrics.unwrap_or_default();
    let note =
        format!("median |error| {}, rms {}", millimetres(metrics.median_error), millimetres(metrics.rmse));
    write_error_figure(path, &errors, truth.x, truth.y, &note)
}

fn write_json(path: &Path, report: &Report) -> Result<()> {
    write_atomically(path, |file| {
        serde_json::to_writer_pretty(&mut *file, report)?;
        file.write_all(b"\n")
    })
}
