//! Predictions: the plan of a job, sweeps of its keys, and the image of a point.

use super::images::unwritable;
use super::jobs;
use super::pictures::picture;
use super::run_files::PythonRunFile;
use crate::cli::design::forecast_text;
use crate::cli::design::sweep::{open_results, write_files};
use crate::cli::inputs::opened_cube;
use crate::config::RunFile;
use crate::error::Result;
use crate::export::figure::write_spread_figure;
use crate::pipeline::{self, JobOptions, SweepSimulation, SweptKey};
use glam::DVec3;
use pyo3::prelude::*;
use serde::Serialize;
use std::path::PathBuf;

fn json(value: &impl Serialize) -> Result<String> {
    serde_json::to_string(value).map_err(|error| unwritable(&error))
}

/// Predicts `image` of a run file's scene, or of a cube file: as JSON, and as the text that `holosonar plan` prints.
#[pyfunction]
pub(super) fn plan(
    py: Python<'_>,
    run: &PythonRunFile,
    cube: Option<PathBuf>,
    memory: Option<String>,
) -> PyResult<(String, String)> {
    let typed = run.within(memory.as_deref())?;
    let keys = run.typed.clone().unwrap_or_default();
    let forecast = jobs::run(py, None, |observer| {
        if let Some(path) = &cube {
            let cube = opened_cube(path, (&typed, &keys), observer)?;
            return pipeline::forecast_cube(&typed, cube, observer);
        }
        let job = JobOptions::default().with_bare_mesh(run.bare.as_ref()).with_observer(observer);
        pipeline::forecast_scene(&typed, &job)
    })?;
    Ok((json(&forecast)?, forecast_text(&forecast)))
}

/// Predicts every combination of values of keys, each `(table.key, values as typed)`, as JSON.
#[pyfunction]
pub(super) fn plan_sweep(
    py: Python<'_>,
    run: &PythonRunFile,
    keys: Vec<(String, Vec<String>)>,
    memory: Option<String>,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let keys = swept(keys);
    let sweep = jobs::run(py, progress.as_ref(), |observer| {
        let run_with = |set: &[String]| run_with(run, set, memory.as_deref());
        let job = JobOptions::default().with_bare_mesh(run.bare.as_ref()).with_observer(observer);
        pipeline::sweep_designs(&keys, &run_with, &job)
    })?;
    Ok(json(&sweep)?)
}

fn swept(keys: Vec<(String, Vec<String>)>) -> Vec<SweptKey> {
    keys.into_iter().map(|(key, values)| SweptKey { key, values }).collect()
}

/// The run file of a combination.
fn run_with(run: &PythonRunFile, set: &[String], memory: Option<&str>) -> Result<RunFile> {
    match &run.bare {
        Some(bare) => bare.run_with(&[run.settings(), set].concat()),
        None => run.with(set)?.within(memory),
    }
}

/// Simulates every combination of values of keys, with these seeds of `[reflectors]`, as JSON; into a folder, if there is one,
/// as the command does.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // named ones, in Python
pub(super) fn simulate_sweep(
    py: Python<'_>,
    run: &PythonRunFile,
    keys: Vec<(String, Vec<String>)>,
    seeds: Vec<u32>,
    measure: &str,
    output: Option<PathBuf>,
    memory: Option<String>,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let keys = swept(keys);
    let measure = pipeline::measure_of("measure", measure)?;
    let sweep = jobs::run(py, progress.as_ref(), |observer| {
        let (results, finished) = output.as_deref().map(open_results).transpose()?.unzip();
        let run_with = |set: &[String]| run_with(run, set, memory.as_deref());
        let job = JobOptions::default().with_bare_mesh(run.bare.as_ref()).with_observer(observer);
        let simulation = SweepSimulation { seeds: &seeds, measure: &measure, folder: finished.as_deref() };
        let sweep = pipeline::simulate_designs(&keys, &run_with, &simulation, &job)?;
        results.map_or(Ok(()), |(_folder, files)| write_files(&files, &sweep))?;
        Ok(sweep)
    })?;
    Ok(json(&sweep)?)
}

/// Point-spread functions at places in m, by default in front of the middle of the grid: as JSON, and as a PNG.
#[pyfunction]
pub(super) fn psf(
    py: Python<'_>,
    run: &PythonRunFile,
    points: Vec<[f64; 3]>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(String, Vec<u8>)> {
    let points: Vec<DVec3> = points.into_iter().map(DVec3::from).collect();
    let (text, png) = jobs::run(py, progress.as_ref(), |observer| {
        let job = JobOptions::default().with_bare_mesh(run.bare.as_ref()).with_observer(observer);
        let (grid, spreads) = pipeline::point_spreads(&run.run, &points, &job)?;
        let value =
            serde_json::json!({ "window": run.run.reconstruct.window, "grid": grid, "points": spreads });
        Ok((value.to_string(), picture(|path| write_spread_figure(path, &spreads))?))
    })?;
    Ok((text, png))
}
