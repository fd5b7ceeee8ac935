//! Every file of a run, under its contracted name.

use super::facts::{attributes, image_facts};
use super::job::JobOptions;
use super::page::{PAGE, page_of, title};
use super::{Outcome, Report};
use crate::acquisition::{DataCube, Instrument};
use crate::config::{OutputTable, RunFile, VolumeFormat};
use crate::error::{Error, Result};
use crate::export::depth_exr::write_depth_map;
use crate::export::figure::{
    DepthKind, depth_range, write_amplitude_figure, write_depth_figure, write_error_figure,
};
use crate::export::page::Miniature;
use crate::export::points_ply::{ScenePoints, write_depth_points};
use crate::export::volume_exr::{DEPTHS_PER_FILE, write_volume_exr};
use crate::export::volume_npz::stream_volume_npz;
use crate::export::volume_nrrd::stream_volume_nrrd;
use crate::export::volume_vti::stream_volume_vti;
use crate::export::{Components, Encoding, VolumeFile, fits_float16};
use crate::files::{extension, write_atomically};
use crate::grid::{DepthMap, Grid, Volume};
use crate::metrics::{Metrics, error_map};
use crate::progress::{Observer, stage};
use crate::reconstruct::{ReconstructionInfo, VolumeSink};
use num_complex::Complex32;
use serde_json::Value;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Writes the volume, the depth map, the truth, the points, the pictures, `report.json` and the page into `folder`, which
/// is made if it is missing; gives the report.
///
/// # Errors
/// [`Error::Io`] when a file cannot be written; no file is ever left half-written.
pub fn write_outputs(run: &RunFile, outcome: &Outcome, folder: &Path, job: &JobOptions) -> Result<Report> {
    let observer = job.observer;
    let begun = Instant::now();
    warn_of_float16(&run.output, outcome.image.volume.peak(), observer);
    let facts = image_facts(&outcome.instrument, run, &outcome.image.info());
    let mut files = Vec::new();
    let scene = ScenePoints::new(
        outcome.reflectors.as_ref(),
        &outcome.instrument.array,
        &outcome.instrument.geometry,
    );
    let formats = &run.output.formats;
    let mut tasks: Vec<Task> = Vec::new();
    for format in formats {
        tasks.push((
            name_of(*format),
            Box::new(|path| write_volume(path, &outcome.image.volume, &run.output, &facts)),
        ));
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
        Box::new(move |path| one(path, write_depth_figure(path, DepthKind::Found, &outcome.depth, range))),
    ));
    if let Some(truth) = truth {
        tasks.push(("truth.exr", Box::new(|path| one(path, write_depth(path, truth, run, &facts)))));
        tasks.push((
            "truth.png",
            Box::new(move |path| one(path, write_depth_figure(path, DepthKind::True, truth, range))),
        ));
        tasks.push(("error.png", Box::new(|path| one(path, write_error(path, outcome, truth)))));
    }
    if run.output.points {
        tasks.push(("depth.ply", Box::new(|path| one(path, write_depth(path, &outcome.depth, run, &facts)))));
        tasks.push(("scene.ply", Box::new(|path| one(path, scene.write(path, &attributes(&facts))))));
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
    // The page is packed before the report is written, so that its time is counted, and holds the report's very text.
    let page = if run.output.report {
        report.files.push(PAGE.into());
        let volume = Miniature::of_volume(&outcome.image.volume);
        Some(stage(observer, "packing the page", 0, || {
            page_of(folder, &report.files, Some(&volume), Some(&scene), u64::MAX)
        })?)
    } else {
        None
    };
    report.timings.insert("write".to_owned(), begun.elapsed().as_secs_f64().into());
    let text = serde_json::to_string_pretty(&report)
        .map_err(|e| Error::io("report", e.to_string()).with_source(e))?
        + "\n";
    write_atomically(&folder.join("report.json"), |file| file.write_all(text.as_bytes()))?;
    observer.note(&format!("{} files in {}", report.files.len(), folder.display()));
    if let Some(page) = page {
        let mesh =
            run.scene.mesh.as_ref().filter(|_| outcome.reflectors.is_some()).map(|file| file.typed.as_str());
        page.write(&folder.join(PAGE), &title(mesh), &text)?;
    }
    Ok(report)
}

/// The name of the volume's file in a format.
fn name_of(format: VolumeFormat) -> &'static str {
    match format {
        VolumeFormat::Exr => "volume.exr",
        VolumeFormat::Npz => "volume.npz",
        VolumeFormat::Vti => "volume.vti",
        VolumeFormat::Nrrd => "volume.nrrd",
    }
}

/// The least bytes that a volume's file takes, whatever its content.
pub(super) fn bytes_of(path: &Path, run: &RunFile, grid: &Grid) -> u64 {
    let per_voxel = match extension(path).as_str() {
        "npz" => 8,
        "vti" if run.output.components == Components::Complex => 12,
        "vti" => 4,
        // Compressed: a quarter is more than any volume of echoes gives up.
        _ => 1,
    };
    grid.voxel_count().saturating_mul(per_voxel)
}

/// The same for all volumes of a run.
pub(super) fn volume_bytes(run: &RunFile, grid: &Grid) -> u64 {
    volume_names(run).map(|name| bytes_of(name, run, grid)).sum()
}

/// Bytes that writing a volume into files of these names takes beside it: an EXR file's parts are held until it is written.
pub(super) fn writing_bytes<'a>(
    paths: impl IntoIterator<Item = &'a Path>,
    run: &RunFile,
    grid: &Grid,
) -> u64 {
    let channels = if run.output.components == Components::Complex { 3 } else { 1 };
    let planes = grid.z.count.min(DEPTHS_PER_FILE) as u64;
    let parts = planes.saturating_mul(grid.x.count as u64).saturating_mul(grid.y.count as u64);
    let held = paths.into_iter().any(needs_all);
    if held { parts.saturating_mul(channels * size_of::<f32>() as u64) } else { 0 }
}

/// The names of a run's volumes.
pub(super) fn volume_names(run: &RunFile) -> impl Iterator<Item = &'static Path> {
    run.output.formats.iter().map(|format| Path::new(name_of(*format)))
}

/// The files that [`write_outputs`] will write, with or without a truth; a very deep volume may take several.
pub(super) fn names(run: &RunFile, truth: bool) -> Vec<String> {
    let mut names: Vec<&str> = run.output.formats.iter().map(|format| name_of(*format)).collect();
    names.extend(["depth.exr", "amplitude.png", "depth.png"]);
    if truth {
        names.extend(["truth.exr", "truth.png", "error.png"]);
    }
    if run.output.points {
        names.extend(["depth.ply", "scene.ply"]);
    }
    names.push("report.json");
    if run.output.report {
        names.push(PAGE);
    }
    names.into_iter().map(str::to_owned).collect()
}

/// A file's name and what writes it (and, for a deep volume, its continuations).
type Task<'a> = (&'static str, Box<dyn Fn(&Path) -> Result<Vec<PathBuf>> + 'a>);

/// The list of one file.
fn one(path: &Path, written: Result<()>) -> Result<Vec<PathBuf>> {
    written.map(|()| vec![path.to_path_buf()])
}

/// The half floats that were asked for and cannot hold the amplitudes.
fn warn_of_float16(output: &OutputTable, peak: f32, observer: &dyn Observer) {
    if output.float16 && output.formats.contains(&VolumeFormat::Exr) && !fits_float16(peak) {
        observer.warn(&format!(
            "[output] float16: half floats do not hold amplitudes of a peak of {peak:e} well, so volume.exr keeps 32 bits"
        ));
    }
}

/// Volume files on their way: those of formats that grow depth by depth, and for the others the volume.
#[derive(Debug)]
pub(super) struct VolumeFiles<'a> {
    instrument: &'a Instrument,
    run: &'a RunFile,
    paths: &'a [PathBuf],
    facts: Value,
    growing: Vec<(&'a Path, VolumeFile)>,
    whole: Volume,
}

/// Whether a file of this name needs the volume whole.
pub(super) fn needs_all(path: &Path) -> bool {
    extension(path) == "exr"
}

impl<'a> VolumeFiles<'a> {
    pub(super) fn new(
        instrument: &'a Instrument,
        run: &'a RunFile,
        grid: Grid,
        paths: &'a [PathBuf],
    ) -> Self {
        let whole = Volume { grid, samples: Vec::new() };
        Self { instrument, run, paths, facts: Value::Null, growing: Vec::new(), whole }
    }

    /// Whether a file needs the volume whole.
    fn needs_all(&self) -> bool {
        self.paths.iter().any(|path| needs_all(path))
    }

    /// Ends all files; gives their names in the order asked for.
    pub(super) fn finish(self) -> Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        let mut growing = self.growing;
        for path in self.paths {
            match growing.iter().position(|(grown, _)| grown == path) {
                Some(index) => files.extend(one(path, growing.swap_remove(index).1.finish())?),
                None => files.extend(write_volume(path, &self.whole, &self.run.output, &self.facts)?),
            }
        }
        Ok(files)
    }
}

impl VolumeSink for VolumeFiles<'_> {
    fn begin(&mut self, info: &ReconstructionInfo) -> Result<()> {
        self.facts = image_facts(self.instrument, self.run, info);
        for path in self.paths.iter().filter(|path| !needs_all(path)) {
            let file = stream_volume(path, &self.whole.grid, &self.run.output, &self.facts)?;
            self.growing.push((path, file));
        }
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        for (_, file) in &mut self.growing {
            file.take(planes)?;
        }
        if self.needs_all() { self.whole.take(first, planes) } else { Ok(()) }
    }
}

/// Begins a volume file in the format of the path's extension, which takes depth after depth.
fn stream_volume(path: &Path, grid: &Grid, output: &OutputTable, facts: &Value) -> Result<VolumeFile> {
    match extension(path).as_str() {
        "npz" => stream_volume_npz(path, *grid, facts),
        "vti" => stream_volume_vti(path, grid, output.components, &attributes(facts)),
        "nrrd" => stream_volume_nrrd(path, grid, &attributes(facts), output.compression),
        _ => Err(Error::input(
            path.display(),
            "volumes are written as .npz, .exr, .vti or .nrrd; give one of these extensions",
        )),
    }
}

/// Writes a volume in the format of the path's extension, as `[output]` asks; gives the files written.
///
/// # Errors
/// Another extension than `.exr`, `.npz`, `.nrrd` or `.vti`; a file that cannot be written.
pub fn write_volume(
    path: &Path,
    volume: &Volume,
    output: &OutputTable,
    facts: &Value,
) -> Result<Vec<PathBuf>> {
    let OutputTable { components, float16, compression, .. } = *output;
    let encoding = Encoding { float16: float16 && fits_float16(volume.peak()), compression };
    if needs_all(path) {
        return write_volume_exr(path, volume, components, &attributes(facts), encoding);
    }
    let mut file = stream_volume(path, &volume.grid, output, facts)?;
    file.take(&volume.samples)?;
    one(path, file.finish())
}

/// Writes a depth map or a truth with the run's facts: as an image, or as points.
///
/// # Errors
/// Another extension than `.exr` or `.ply`; a file that cannot be written.
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
/// Another extension than `.npz`; a file that cannot be written.
pub fn write_cube(path: &Path, cube: &DataCube) -> Result<()> {
    if extension(path) != "npz" {
        return Err(Error::input(path.display(), "cubes are written as .npz; give this extension"));
    }
    cube.write(path)
}

/// Draws the error with its median and rms.
fn write_error(path: &Path, outcome: &Outcome, truth: &DepthMap) -> Result<()> {
    let errors = error_map(&outcome.depth, truth)?;
    let resolution = outcome.instrument.range_resolution().unwrap_or(f64::NAN);
    let note = error_note(&outcome.metrics().unwrap_or_default());
    write_error_figure(path, &errors, &truth.raster(), resolution, &note)
}

/// The line above an error figure.
pub(crate) fn error_note(metrics: &Metrics) -> String {
    let millimetres = |value: Option<f64>| value.map_or("none".to_owned(), |m| format!("{:.1} mm", m * 1e3));
    format!("median |error| {}, rms {}", millimetres(metrics.median_error), millimetres(metrics.rmse))
}
