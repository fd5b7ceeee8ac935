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
    sources: Option<PyReadonlyArrayDyn<'py, f64>>,
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
        let detection: Detection = self.detection.parse()?;
        let instrument = Instrument::new(sweep, array.map_err(|error| error.at("mic_positions"))?)
            .with_detection(detection)
            .with_sound_speed(self.sound_speed);
        let instrument = self.placed(instrument)?;
        instrument.check().map(|()| instrument)
    }

    /// The instrument with its loudspeakers.
    fn placed(&self, instrument: Instrument) -> Result<Instrument> {
        let sources = self.sources.as_ref().map(|sources| points("sources", sources)).transpose()?;
        match (self.geometry.parse()?, sources) {
            (GeometryKind::FixedSource, None) => {
                Ok(instrument.with_geometry(Geometry::FixedSource { source: self.source.into() }))
            }
            (GeometryKind::FixedSource, Some(sources)) => instrument.with_sources(&sources),
            (GeometryKind::Pair, Some(sources)) => {
                instrument.with_pairs(&sources).map_err(|error| error.at("sources"))
            }
            (GeometryKind::Monostatic, None) => Ok(instrument.with_geometry(Geometry::Monostatic)),
            (GeometryKind::Monostatic, Some(_)) => {
                let problem =
                    "are of loudspeakers of their own, and that of a monostatic scan is the microphone's";
                Err(Error::input("sources", problem))
            }
            (GeometryKind::Pair, None) => {
                let problem = "are missing: the geometry \"pair\" has a loudspeaker for each microphone";
                Err(Error::input("sources", problem))
            }
        }
    }
}

/// The loudspeakers of an instrument as the package's class holds them: one place, and those of several or of pairs.
///
/// # Errors
/// An interface of two media, which would be lost.
pub(super) fn sources_of(instrument: &Instrument) -> Result<(DVec3, Vec<DVec3>)> {
    if instrument.interface.is_some() {
        let problem = "has an interface of two media, which a Cube does not hold; image its file, by `image` or on the command \
                       line";
        return Err(Error::input("cube", problem));
    }
    let first = instrument.sources().first().copied().unwrap_or_default();
    let several = match instrument.geometry {
        Geometry::FixedSource { .. } if instrument.transmissions() > 1 => instrument.sources(),
        Geometry::Pair { .. } => {
            let pairs = instrument.array.positions().iter().enumerate();
            pairs.map(|(i, r)| instrument.geometry_of(i).source_of(*r)).collect()
        }
        _ => Vec::new(),
    };
    Ok((first, several))
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
