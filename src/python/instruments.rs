//! Frequencies, microphones and what else an instrument consists of.

use super::arrays::{array, values};
use crate::acquisition::{Detection, Instrument, MicArray, Sweep};
use crate::error::{Error, Result};
use crate::wave::{Geometry, GeometryKind};
use glam::DVec3;
use numpy::{PyArray1, PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::path::PathBuf;

/// An instrument as the package's class `Instrument` holds it.
#[derive(FromPyObject)]
pub(super) struct InstrumentParts<'py> {
    frequencies: PyReadonlyArrayDyn<'py, f64>,
    mic_positions: PyReadonlyArrayDyn<'py, f64>,
    sound_speed: f64,
    geometry: String,
    source: [f64; 3],
    detection: String,
}

impl InstrumentParts<'_> {
    /// The instrument. Microphones in rows and columns that form a lattice are recognised, as in a file.
    ///
    /// # Errors
    /// Frequencies, positions, words or numbers that make no instrument.
    pub(super) fn instrument(&self) -> Result<Instrument> {
        let frequencies = values("frequencies", &self.frequencies)?;
        let sweep = Sweep::from_frequencies(frequencies.to_vec()).map_err(|error| error.at("frequencies"))?;
        let points = points("mic_positions", &self.mic_positions)?;
        let array = match *self.mic_positions.shape() {
            [n_y, n_x, _] => MicArray::from_rows([n_y, n_x], points),
            _ => MicArray::from_positions(points),
        };
        let geometry = match self.geometry.parse()? {
            GeometryKind::FixedSource => Geometry::FixedSource { source: self.source.into() },
            GeometryKind::Monostatic => Geometry::Monostatic,
            GeometryKind::Pair => {
                let problem = "\"pair\" is no geometry here; expected \"fixed-source\" or \"monostatic\"";
                return Err(Error::input("geometry", problem));
            }
        };
        let detection: Detection = self.detection.parse()?;
        let instrument = Instrument::new(sweep, array.map_err(|error| error.at("mic_positions"))?)
            .with_geometry(geometry)
            .with_detection(detection)
            .with_sound_speed(self.sound_speed);
        instrument.check().map(|()| instrument)
    }
}

/// The loudspeaker of an instrument that the package's class can hold: one, or that of a monostatic scan, in one medium.
///
/// # Errors
/// Several loudspeakers, a moved pair, or an interface, which would be lost.
pub(super) fn only_source(instrument: &Instrument) -> Result<DVec3> {
    let what = match instrument.geometry {
        _ if instrument.transmissions() > 1 => "several loudspeakers",
        _ if instrument.interface.is_some() => "an interface of two media",
        Geometry::FixedSource { source } => return Ok(source),
        Geometry::Monostatic => return Ok(DVec3::ZERO),
        Geometry::Pair { .. } => "a moved pair of loudspeaker and microphone",
    };
    let problem =
        format!("has {what}, which a Cube does not hold; image its file, by `image` or on the command line");
    Err(Error::input("cube", problem))
}

/// Points, `[.., 3]`, m.
pub(super) fn points(name: &str, array: &PyReadonlyArrayDyn<'_, f64>) -> Result<Vec<DVec3>> {
    match *array.shape() {
        [_, 3] | [_, _, 3] => Ok(values(name, array)?.chunks_exact(3).map(DVec3::from_slice).collect()),
        ref shape => Err(Error::input(name, format!("must be [n, 3] or [n_y, n_x, 3], not {shape:?}"))),
    }
}

/// Coordinates for Python, `[shape.., 3]`, m.
pub(super) fn coordinates<'py>(
    py: Python<'py>,
    points: &[DVec3],
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let numbers = points.iter().flat_map(DVec3::to_array).collect();
    array(py, numbers, [shape, &[3]].concat())
}

fn positions<'py>(py: Python<'py>, array: &MicArray) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    coordinates(py, array.positions(), &array.shape())
}

/// `start + n step`, both ends included, Hz.
#[pyfunction]
pub(super) fn stepped_frequencies(
    py: Python<'_>,
    start: f64,
    stop: f64,
    step: f64,
) -> PyResult<Bound<'_, PyArray1<f64>>> {
    let sweep = Sweep::stepped(start, stop, step)?;
    Ok(PyArray1::from_slice(py, sweep.frequencies()))
}

/// Microphones in rows and columns, `[n_y, n_x, 3]`, m.
#[pyfunction]
pub(super) fn rectangular_array(
    py: Python<'_>,
    count: [usize; 2],
    pitch: [f64; 2],
    centre: [f64; 3],
) -> PyResult<Bound<'_, PyArrayDyn<f64>>> {
    positions(py, &MicArray::rectangular(count, pitch, centre.into())?)
}

/// Microphones on a spiral, `[n, 3]`, m.
#[pyfunction]
pub(super) fn spiral_array(
    py: Python<'_>,
    count: usize,
    extent: [f64; 2],
    centre: [f64; 3],
) -> PyResult<Bound<'_, PyArrayDyn<f64>>> {
    positions(py, &MicArray::spiral(count, extent, centre.into())?)
}

/// Microphones at random, `[n, 3]`, m.
#[pyfunction]
pub(super) fn random_array(
    py: Python<'_>,
    count: usize,
    extent: [f64; 2],
    centre: [f64; 3],
    spacing: Option<f64>,
    seed: u64,
) -> PyResult<Bound<'_, PyArrayDyn<f64>>> {
    positions(py, &MicArray::random(count, extent, centre.into(), spacing, seed)?)
}

/// Microphones of a file: Acoular's XML, or CSV; `[n, 3]`, m.
#[pyfunction]
pub(super) fn read_array(py: Python<'_>, path: PathBuf) -> PyResult<Bound<'_, PyArrayDyn<f64>>> {
    positions(py, &MicArray::read(&path)?)
}

/// The pitch along x, y and z, m, with which voxels from this depth on lose little.
#[pyfunction]
pub(super) fn advised_pitch(instrument: InstrumentParts<'_>, nearest_z: f64) -> PyResult<[f64; 3]> {
    let instrument = instrument.instrument()?;
    Ok(instrument.advised_pitch(nearest_z.max(instrument.wavelength())))
}
