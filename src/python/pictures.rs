//! The figures that the command line writes, as the bytes of a PNG for notebooks.

use super::depths::MapArrays;
use super::jobs;
use super::volumes::{GridParts, view};
use crate::error::{Error, Result};
use crate::export::figure::{DepthKind, write_amplitude_figure, write_depth_figure, write_error_figure};
use crate::files::open_input;
use crate::metrics::error_map;
use num_complex::Complex32;
use numpy::PyReadonlyArrayDyn;
use pyo3::prelude::*;
use std::io::Read;
use std::path::Path;

/// The bytes of a picture that is written to a file.
pub(super) fn picture(write: impl FnOnce(&Path) -> Result<()>) -> Result<Vec<u8>> {
    let failed = |error: std::io::Error| {
        Error::io("picture", format!("no temporary file can be used: {error}")).with_source(error)
    };
    let folder = tempfile::tempdir().map_err(failed)?;
    let path = folder.path().join("picture.png");
    write(&path)?;
    let mut bytes = Vec::new();
    open_input(&path)?.read_to_end(&mut bytes).map_err(failed)?;
    Ok(bytes)
}

/// The amplitude of a volume, from the front and from above.
#[pyfunction]
pub(super) fn amplitude_picture(
    py: Python<'_>,
    samples: PyReadonlyArrayDyn<'_, Complex32>,
    grid: GridParts,
) -> PyResult<Vec<u8>> {
    let volume = view(&samples, &grid)?;
    jobs::run(py, None, |_| picture(|path| write_amplitude_figure(path, volume)))
}

/// A depth map, or a truth.
#[pyfunction]
pub(super) fn depth_picture(py: Python<'_>, map: MapArrays<'_>, truth: bool) -> PyResult<Vec<u8>> {
    let map = map.map()?;
    let kind = if truth { DepthKind::True } else { DepthKind::Found };
    jobs::run(py, None, |_| picture(|path| write_depth_figure(path, kind, &map, None)))
}

/// The depth error of a depth map; `resolution` is c/2B in m.
#[pyfunction]
pub(super) fn error_picture(
    py: Python<'_>,
    found: MapArrays<'_>,
    truth: MapArrays<'_>,
    resolution: f64,
    note: String,
) -> PyResult<Vec<u8>> {
    let (found, truth) = (found.map()?, truth.map()?);
    jobs::run(py, None, |_| {
        let errors = error_map(&found, &truth)?;
        picture(|path| write_error_figure(path, &errors, &truth.raster(), resolution, &note))
    })
}
