//! Cubes: simulated, read and written.

use super::arrays::{Samples, array, values};
use super::instruments::{InstrumentParts, coordinates, points, sources_of};
use super::jobs;
use super::run_files::PythonRunFile;
use crate::acquisition::{CubeView, DataCube, Detection, Instrument, simulate_with};
use crate::error::{Error, Result};
use crate::pipeline::{JobOptions, check_cube_name, simulate_scene as simulate};
use crate::plan::memory_limit;
use crate::progress::stage;
use crate::reflectors::Reflectors;
use crate::wave::GeometryKind;
use num_complex::Complex32;
use numpy::{PyArray1, PyArrayDyn, PyReadonlyArrayDyn};
use pyo3::prelude::*;
use serde_json::Value;
use std::path::PathBuf;

/// A cube for Python: the arguments of the package's classes `Instrument` and `Cube`.
#[derive(IntoPyObject)]
pub(super) struct CubeParts<'py> {
    samples: Bound<'py, PyAny>,
    provenance: Option<String>,
    frequencies: Bound<'py, PyArray1<f64>>,
    mic_positions: Bound<'py, PyArrayDyn<f64>>,
    sound_speed: f64,
    geometry: &'static str,
    source: [f64; 3],
    sources: Option<Bound<'py, PyArrayDyn<f64>>>,
    detection: &'static str,
}

impl<'py> CubeParts<'py> {
    fn new(py: Python<'py>, cube: DataCube) -> PyResult<Self> {
        let DataCube { instrument, samples, provenance } = cube;
        let Instrument { sweep, array, geometry, detection, sound_speed, .. } = &instrument;
        let (source, several) = sources_of(&instrument)?;
        let of_pairs = instrument.transmissions() == 1;
        let shape = if of_pairs { array.shape() } else { vec![several.len()] };
        let sources = (!several.is_empty()).then(|| coordinates(py, &several, &shape)).transpose()?;
        Ok(Self {
            samples: samples_for(py, samples, &instrument)?,
            provenance: (!provenance.is_null()).then(|| provenance.to_string()),
            frequencies: PyArray1::from_slice(py, sweep.frequencies()),
            mic_positions: coordinates(py, array.positions(), &array.shape())?,
            sound_speed: *sound_speed,
            geometry: GeometryKind::as_str(geometry.kind()),
            source: source.to_array(),
            sources,
            detection: detection.as_str(),
        })
    }
}

/// Samples for Python: in phase only their real parts.
fn samples_for<'py>(
    py: Python<'py>,
    samples: Vec<Complex32>,
    instrument: &Instrument,
) -> PyResult<Bound<'py, PyAny>> {
    let shape = [leading(instrument), instrument.array.shape()].concat();
    Ok(match instrument.detection {
        Detection::Quadrature => array(py, samples, shape)?.into_any(),
        Detection::InPhase => {
            array(py, samples.iter().map(|m| m.re).collect::<Vec<f32>>(), shape)?.into_any()
        }
    })
}

/// Axes of samples before those of the microphones: loudspeakers, if there are several, and frequencies.
fn leading(instrument: &Instrument) -> Vec<usize> {
    let several = Some(instrument.transmissions()).filter(|count| *count > 1);
    several.into_iter().chain([instrument.sweep.len()]).collect()
}

/// Refuses samples whose type or shape is not the instrument's.
pub(super) fn check_samples(samples: &Samples<'_>, instrument: &Instrument) -> Result<()> {
    if samples.are_complex() != (instrument.detection == Detection::Quadrature) {
        let problem = "must be complex for the detection \"quadrature\" and real for \"in-phase\"";
        return Err(Error::input("samples", problem));
    }
    let shape = samples.shape();
    let leading = leading(instrument);
    let expected = [leading.clone(), instrument.array.shape()].concat();
    // Also a list of them, or rows and columns that are no lattice.
    if shape.strip_prefix(&leading[..]).is_some_and(|of_microphones| {
        !of_microphones.is_empty() && of_microphones.iter().product::<usize>() == instrument.array.len()
    }) {
        return Ok(());
    }
    let problem =
        format!("have the shape {shape:?}; the instrument's frequencies and microphones need {expected:?}");
    Err(Error::input("samples", problem))
}

/// The cube of reflectors at `[n, 3]` m with `[n]` complex amplitudes; `[medium]`, `[array]` and `[detection]` of the run
/// file say what is simulated beyond Eq. 5.
#[pyfunction]
pub(super) fn simulate_points<'py>(
    py: Python<'py>,
    positions: PyReadonlyArrayDyn<'py, f64>,
    amplitudes: PyReadonlyArrayDyn<'py, Complex32>,
    instrument: InstrumentParts<'py>,
    run: &PythonRunFile,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let positions = points("positions", &positions)?;
    let amplitudes = values("amplitudes", &amplitudes)?.to_vec();
    if amplitudes.len() != positions.len() {
        let problem = format!("are {}, but there are {} positions", amplitudes.len(), positions.len());
        return Err(Error::input("amplitudes", problem).into());
    }
    let reflectors = Reflectors::new(positions, amplitudes)?;
    let instrument = instrument.instrument()?;
    let options = run.run.simulate_options();
    let cube = jobs::run(py, progress.as_ref(), |observer| {
        simulate_with(&reflectors, &instrument, &options, observer)
    })?;
    samples_for(py, cube.samples, &instrument)
}

/// The cube of a run file's scene.
#[pyfunction]
pub(super) fn simulate_scene<'py>(
    py: Python<'py>,
    run: &PythonRunFile,
    memory: Option<String>,
    progress: Option<Py<PyAny>>,
) -> PyResult<CubeParts<'py>> {
    let (typed, bare) = (run.within(memory.as_deref())?, run.bare.as_ref());
    let cube = jobs::run(py, progress.as_ref(), |observer| {
        simulate(&typed, &JobOptions::default().with_bare_mesh(bare).with_observer(observer))
    })?;
    CubeParts::new(py, cube)
}

/// Reads a cube file.
#[pyfunction]
pub(super) fn read_cube(py: Python<'_>, path: PathBuf) -> PyResult<CubeParts<'_>> {
    let cube = jobs::run(py, None, |observer| {
        let limit = memory_limit(None).unwrap_or(u64::MAX);
        stage(observer, "reading the cube", 0, || DataCube::read(&path, limit))
    })?;
    CubeParts::new(py, cube)
}

/// Writes a cube file; `provenance` is JSON.
#[pyfunction]
pub(super) fn write_cube(
    py: Python<'_>,
    path: PathBuf,
    samples: Samples<'_>,
    instrument: InstrumentParts<'_>,
    provenance: Option<String>,
) -> PyResult<()> {
    let instrument = instrument.instrument()?;
    check_samples(&samples, &instrument)?;
    check_cube_name(&path)?;
    let samples = samples.complex()?;
    let provenance = provenance.as_deref().map(|text| json("provenance", text)).transpose()?;
    let cube = CubeView::new(&instrument, &samples)?;
    jobs::run(py, None, |_| cube.write(&path, &provenance.unwrap_or_default()))
}

/// JSON that the package holds as text, so that it is written again as it was read.
pub(super) fn json(name: &str, text: &str) -> Result<Value> {
    serde_json::from_str(text).map_err(|error| Error::input(name, format!("is not JSON: {error}")))
}

/// Reads a list of reflectors (.csv): positions, `[n, 3]`, m, and complex amplitudes, `[n]`.
#[pyfunction]
#[allow(clippy::type_complexity)]
pub(super) fn read_reflectors(
    py: Python<'_>,
    path: PathBuf,
) -> PyResult<(Bound<'_, PyArrayDyn<f64>>, Bound<'_, PyArray1<Complex32>>)> {
    let reflectors = Reflectors::read_csv(&path)?;
    let positions = coordinates(py, reflectors.positions(), &[reflectors.len()])?;
    Ok((positions, PyArray1::from_slice(py, reflectors.amplitudes())))
}
