//! The main job: a scene or a cube to volume, depth map and everything else, in memory and on request in files.

use super::arrays::Samples;
use super::cubes::check_samples;
use super::depths::DepthParts;
use super::instruments::InstrumentParts;
use super::jobs;
use super::run_files::PythonRunFile;
use super::volumes::{GridParts, VolumeParts};
use crate::acquisition::CubeView;
use crate::checkpoint::Checkpoint;
use crate::cli::inputs::opened_cube;
use crate::config;
use crate::error::{Error, Result};
use crate::files::OutputFolder;
use crate::pipeline::{self, JobOptions, Outcome, Report, announce_outputs, has_truth, write_outputs};
use crate::progress::Observer;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How often a job that writes files stores its finished blocks, as the command line does by default.
const EVERY: Duration = Duration::from_secs(5);

/// Everything that a job computed, for Python.
#[derive(IntoPyObject)]
pub(super) struct ImageParts<'py> {
    volume: VolumeParts<'py>,
    depth: DepthParts<'py>,
    truth: Option<DepthParts<'py>>,
    report: String,
    files: Vec<PathBuf>,
}

impl<'py> ImageParts<'py> {
    fn new(py: Python<'py>, run: &config::RunFile, (outcome, report): (Outcome, Report)) -> PyResult<Self> {
        let facts = outcome.facts(run);
        let Outcome { image, depth, truth, .. } = outcome;
        Ok(Self {
            volume: VolumeParts::new(py, image.volume, &facts)?,
            depth: DepthParts::new(py, depth, &facts)?,
            truth: truth.map(|truth| DepthParts::new(py, truth, &facts)).transpose()?,
            report: report.to_text()?,
            files: report.files,
        })
    }
}

/// Does a job without files, or, given a folder, as the command line does: with its files, and with a checkpoint from which
/// an interrupted job resumes.
fn carry_out(
    run: &config::RunFile,
    folder: Option<&Path>,
    truth: bool,
    observer: &dyn Observer,
    image: impl Fn(&JobOptions) -> Result<Outcome>,
) -> Result<(Outcome, Report)> {
    let job = JobOptions::default().with_observer(observer);
    let Some(folder) = folder else {
        let outcome = image(&job)?;
        let report = Report::new(run, &outcome);
        return Ok((outcome, report));
    };
    let checkpoint = Checkpoint::within(folder, EVERY);
    let _folder = OutputFolder::open(folder)?;
    announce_outputs(run, folder, truth)?;
    let job = job.with_checkpoint(&checkpoint);
    let outcome = image(&job)?;
    let report = write_outputs(run, &outcome, folder, &job)?;
    checkpoint.remove();
    Ok((outcome, report))
}

/// Images a run file's scene.
#[pyfunction]
pub(super) fn image_scene<'py>(
    py: Python<'py>,
    run: &PythonRunFile,
    output: Option<PathBuf>,
    memory: Option<String>,
    progress: Option<Py<PyAny>>,
) -> PyResult<ImageParts<'py>> {
    let typed = run.within(memory.as_deref())?;
    let result = jobs::run(py, progress.as_ref(), |observer| {
        carry_out(&typed, output.as_deref(), has_truth(&typed), observer, |job| {
            pipeline::image_scene(&typed, &job.with_bare_mesh(run.bare.as_ref()))
        })
    })?;
    ImageParts::new(py, &typed, result)
}

/// Images a cube file.
#[pyfunction]
pub(super) fn image_file<'py>(
    py: Python<'py>,
    path: PathBuf,
    run: &PythonRunFile,
    output: Option<PathBuf>,
    memory: Option<String>,
    progress: Option<Py<PyAny>>,
) -> PyResult<ImageParts<'py>> {
    let typed = run.within(memory.as_deref())?;
    let keys = run.typed.clone().unwrap_or_default();
    let result = jobs::run(py, progress.as_ref(), |observer| {
        carry_out(&typed, output.as_deref(), false, observer, |job| {
            let cube = opened_cube(&path, (&typed, &keys), observer)?;
            pipeline::image_cube(&typed, cube, job)
        })
    })?;
    ImageParts::new(py, &typed, result)
}

/// Images a cube in memory, on the given grid or on that of the run file.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // they are keywords in Python
pub(super) fn image_samples<'py>(
    py: Python<'py>,
    samples: Samples<'py>,
    instrument: InstrumentParts<'py>,
    grid: Option<GridParts>,
    run: &PythonRunFile,
    output: Option<PathBuf>,
    memory: Option<String>,
    progress: Option<Py<PyAny>>,
) -> PyResult<ImageParts<'py>> {
    let instrument = instrument.instrument()?;
    check_samples(&samples, &instrument)?;
    let grid = grid.map(|grid| grid.grid()).transpose()?;
    let typed = run.within(memory.as_deref())?;
    let samples = samples.complex()?;
    let cube = CubeView::new(&instrument, &samples)?;
    let result = jobs::run(py, progress.as_ref(), |observer| {
        let image = |_: &JobOptions| pipeline::image_samples(&typed, cube, grid, observer);
        carry_out(&typed, output.as_deref(), false, observer, image)
    })?;
    ImageParts::new(py, &typed, result)
}

/// The error for text that Python cannot have given.
pub(super) fn unwritable(error: &serde_json::Error) -> Error {
    Error::io("JSON", error.to_string())
}
