//! Volumes: reconstructed, read and written.

use super::arrays::{AxisParts, AxisTuple, Samples, array, axis_tuple, values};
use super::cubes::{check_samples, json};
use super::instruments::InstrumentParts;
use super::jobs;
use super::run_files::PythonRunFile;
use crate::acquisition::CubeView;
use crate::error::{Error, Result};
use crate::export::read_volume as read;
use crate::grid::{Grid, Volume, VolumeView};
use crate::pipeline::{reconstruct_samples, write_volume as write};
use crate::plan::memory_limit;
use crate::progress::stage;
use num_complex::Complex32;
use numpy::{PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use serde_json::Value;
use std::path::PathBuf;

/// A grid as the package's class `Grid` holds it.
#[derive(FromPyObject)]
pub(super) struct GridParts {
    x: AxisParts,
    y: AxisParts,
    z: AxisParts,
}

impl GridParts {
    pub(super) fn grid(&self) -> Result<Grid> {
        Ok(Grid { x: self.x.axis("grid.x")?, y: self.y.axis("grid.y")?, z: self.z.axis("grid.z")? })
    }
}

/// A volume for Python.
#[derive(IntoPyObject)]
pub(super) struct VolumeParts<'py> {
    samples: Bound<'py, PyArrayDyn<Complex32>>,
    x: AxisTuple,
    y: AxisTuple,
    z: AxisTuple,
    meta: String,
}

impl<'py> VolumeParts<'py> {
    pub(super) fn new(py: Python<'py>, volume: Volume, meta: &Value) -> PyResult<Self> {
        let Volume { grid, samples } = volume;
        Ok(Self {
            samples: array(py, samples, grid.shape())?,
            x: axis_tuple(&grid.x),
            y: axis_tuple(&grid.y),
            z: axis_tuple(&grid.z),
            meta: meta.to_string(),
        })
    }
}

/// A volume as Python gives it.
pub(super) fn view<'a>(
    samples: &'a PyReadonlyArrayDyn<'_, Complex32>,
    grid: &GridParts,
) -> Result<VolumeView<'a>> {
    let grid = grid.grid()?;
    if *samples.shape() != grid.shape() {
        let (found, expected) = (samples.shape(), grid.shape());
        let problem = format!("have the shape {found:?}; the grid needs {expected:?}, [z, y, x]");
        return Err(Error::input("samples", problem));
    }
    Ok(VolumeView::new(grid, values("samples", samples)?))
}

/// Reconstructs a cube, on the given grid or on that of the run file.
#[pyfunction]
pub(super) fn reconstruct<'py>(
    py: Python<'py>,
    samples: Samples<'py>,
    instrument: InstrumentParts<'py>,
    grid: Option<GridParts>,
    run: &PythonRunFile,
    memory: Option<String>,
    progress: Option<Py<PyAny>>,
) -> PyResult<VolumeParts<'py>> {
    let instrument = instrument.instrument()?;
    check_samples(&samples, &instrument)?;
    let grid = grid.map(|grid| grid.grid()).transpose()?;
    let run = run.within(memory.as_deref())?;
    let samples = samples.complex()?;
    let cube = CubeView::new(&instrument, &samples)?;
    let (image, meta) =
        jobs::run(py, progress.as_ref(), |observer| reconstruct_samples(&run, cube, grid, observer))?;
    VolumeParts::new(py, image.volume, &meta)
}

/// Reads a volume file (.npz or .zarr).
#[pyfunction]
pub(super) fn read_volume(py: Python<'_>, path: PathBuf) -> PyResult<VolumeParts<'_>> {
    let (volume, meta) = jobs::run(py, None, |observer| {
        let limit = memory_limit(None).unwrap_or(u64::MAX);
        stage(observer, "reading the volume", 0, || read(&path, limit))
    })?;
    VolumeParts::new(py, volume, &meta)
}

/// Writes a volume in the format of the extension, with `[output]` of the run file; returns the files written.
#[pyfunction]
pub(super) fn write_volume(
    py: Python<'_>,
    path: PathBuf,
    samples: PyReadonlyArrayDyn<'_, Complex32>,
    grid: GridParts,
    meta: String,
    run: &PythonRunFile,
) -> PyResult<Vec<PathBuf>> {
    let volume = view(&samples, &grid)?;
    let meta = json("meta", &meta)?;
    jobs::run(py, None, |_| write(&path, volume, &run.run.output, &meta))
}
