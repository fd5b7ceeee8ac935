//! Depth maps: located, traced, read, written and compared.

use super::arrays::{AxisParts, AxisTuple, array, axis_tuple, values};
use super::cubes::json;
use super::jobs;
use super::run_files::PythonRunFile;
use super::volumes::{GridParts, view};
use crate::error::{Error, Result};
use crate::export::depth_exr::read_depth_map;
use crate::grid::{DepthLayer, DepthMap, Raster};
use crate::metrics::score;
use crate::pipeline::{
    JobOptions, depth_in_volume, facts_of_attributes, resolution_in, truth_of_scene, write_depth as write,
};
use crate::plan::memory_limit;
use crate::progress::stage;
use crate::wave::Resolution;
use num_complex::Complex32;
use numpy::{Element, PyArrayDyn, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use serde_json::Value;
use std::path::PathBuf;

/// One surface per pixel, for Python.
#[derive(IntoPyObject)]
struct LayerParts<'py> {
    depth: Bound<'py, PyArrayDyn<f32>>,
    amplitude: Bound<'py, PyArrayDyn<f32>>,
    confidence: Option<Bound<'py, PyArrayDyn<f32>>>,
    error: Option<Bound<'py, PyArrayDyn<f32>>>,
    normals: Option<Bound<'py, PyArrayDyn<f32>>>,
    facing: Option<Bound<'py, PyArrayDyn<f32>>>,
    material: Option<Bound<'py, PyArrayDyn<u32>>>,
}

/// A depth map for Python.
#[derive(IntoPyObject)]
pub(super) struct DepthParts<'py> {
    view: &'static str,
    x: AxisTuple,
    y: AxisTuple,
    picked: LayerParts<'py>,
    returns: Vec<LayerParts<'py>>,
    materials: Vec<String>,
    meta: String,
}

impl<'py> LayerParts<'py> {
    fn new(py: Python<'py>, layer: DepthLayer, shape: [usize; 2]) -> PyResult<Self> {
        fn map<T: Element>(
            py: Python<'_>,
            values: Option<Vec<T>>,
            shape: [usize; 2],
        ) -> PyResult<Option<Bound<'_, PyArrayDyn<T>>>> {
            values.map(|values| array(py, values, shape)).transpose()
        }
        let normals =
            layer.normal.map(|normals| array(py, normals.into_flattened(), [&shape[..], &[3]].concat()));
        Ok(Self {
            depth: array(py, layer.depth, shape)?,
            amplitude: array(py, layer.strength, shape)?,
            confidence: map(py, layer.confidence, shape)?,
            error: map(py, layer.error, shape)?,
            normals: normals.transpose()?,
            facing: map(py, layer.facing, shape)?,
            material: map(py, layer.material, shape)?,
        })
    }
}

impl<'py> DepthParts<'py> {
    pub(super) fn new(py: Python<'py>, map: DepthMap, meta: &Value) -> PyResult<Self> {
        let shape = map.shape();
        let DepthMap { view, x, y, mut picked, confidence, returns, materials } = map;
        // A truth has none.
        picked.confidence = Some(confidence).filter(|confidence| !confidence.is_empty());
        let layer = |layer: DepthLayer| LayerParts::new(py, layer, shape);
        Ok(Self {
            view: view.as_str(),
            x: axis_tuple(&x),
            y: axis_tuple(&y),
            picked: layer(picked)?,
            returns: returns.into_iter().map(layer).collect::<PyResult<_>>()?,
            materials,
            meta: meta.to_string(),
        })
    }
}

/// A surface as the package's class `DepthLayer` holds it.
#[derive(FromPyObject)]
struct LayerArrays<'py> {
    depth: PyReadonlyArrayDyn<'py, f32>,
    amplitude: PyReadonlyArrayDyn<'py, f32>,
    confidence: Option<PyReadonlyArrayDyn<'py, f32>>,
    error: Option<PyReadonlyArrayDyn<'py, f32>>,
    normals: Option<PyReadonlyArrayDyn<'py, f32>>,
    facing: Option<PyReadonlyArrayDyn<'py, f32>>,
    material: Option<PyReadonlyArrayDyn<'py, u32>>,
}

/// A depth map as the package's class `DepthMap` holds it.
#[derive(FromPyObject)]
pub(super) struct MapArrays<'py> {
    view: String,
    x: AxisParts,
    y: AxisParts,
    picked: LayerArrays<'py>,
    returns: Vec<LayerArrays<'py>>,
    materials: Vec<String>,
}

impl LayerArrays<'_> {
    fn layer(&self, shape: [usize; 2]) -> Result<DepthLayer> {
        fn map<T: Element + Copy>(
            name: &str,
            array: &PyReadonlyArrayDyn<'_, T>,
            shape: &[usize],
        ) -> Result<Vec<T>> {
            if array.shape() != shape {
                let problem = format!("has the shape {:?}; the axes need {shape:?}", array.shape());
                return Err(Error::input(name, problem));
            }
            values(name, array).map(<[T]>::to_vec)
        }
        let [rows, columns] = shape;
        let normals = self.normals.as_ref().map(|normals| map("normals", normals, &[rows, columns, 3]));
        let optional = |name: &str, array: &Option<PyReadonlyArrayDyn<'_, f32>>| {
            array.as_ref().map(|array| map(name, array, &shape)).transpose()
        };
        let material = self.material.as_ref().map(|array| map("material", array, &shape)).transpose()?;
        Ok(DepthLayer {
            depth: map("depth", &self.depth, &shape)?,
            strength: map("amplitude", &self.amplitude, &shape)?,
            facing: optional("facing", &self.facing)?,
            material,
            confidence: optional("confidence", &self.confidence)?,
            error: optional("error", &self.error)?,
            normal: normals.transpose()?.map(|numbers| numbers.as_chunks::<3>().0.to_vec()),
        })
    }
}

impl MapArrays<'_> {
    /// The depth map.
    ///
    /// # Errors
    /// Arrays whose shape is not that of the axes.
    pub(super) fn map(&self) -> Result<DepthMap> {
        let raster = Raster { view: self.view.parse()?, x: self.x.axis("x")?, y: self.y.axis("y")? };
        let shape = [raster.y.count, raster.x.count];
        let mut picked = self.picked.layer(shape)?;
        let confidence = picked.confidence.take().unwrap_or_default();
        let returns = self.returns.iter().map(|layer| layer.layer(shape)).collect::<Result<_>>()?;
        Ok(DepthMap {
            confidence,
            returns,
            materials: self.materials.clone(),
            ..DepthMap::new(raster, picked)
        })
    }
}

/// Locates depth in a volume with its metadata; `sweep_known` says that the run file's `[sweep]` is that of the volume.
#[pyfunction]
pub(super) fn locate_depth<'py>(
    py: Python<'py>,
    samples: PyReadonlyArrayDyn<'py, Complex32>,
    grid: GridParts,
    meta: String,
    run: &PythonRunFile,
    sweep_known: bool,
    progress: Option<Py<PyAny>>,
) -> PyResult<DepthParts<'py>> {
    let volume = view(&samples, &grid)?;
    let meta = json("meta", &meta)?;
    let map = jobs::run(py, progress.as_ref(), |observer| {
        depth_in_volume(volume, &meta, "volume", (&run.run, sweep_known), observer)
    })?;
    DepthParts::new(py, map, &meta)
}

/// The true depth map of a run file's scene.
#[pyfunction]
pub(super) fn truth<'py>(
    py: Python<'py>,
    run: &PythonRunFile,
    progress: Option<Py<PyAny>>,
) -> PyResult<DepthParts<'py>> {
    let (meta, map) = jobs::run(py, progress.as_ref(), |observer| {
        let job = JobOptions::default().with_bare_mesh(run.bare.as_ref()).with_observer(observer);
        truth_of_scene(&run.run, &job)
    })?;
    DepthParts::new(py, map, &meta)
}

/// Reads a depth map (.exr).
#[pyfunction]
pub(super) fn read_depth(py: Python<'_>, path: PathBuf) -> PyResult<DepthParts<'_>> {
    let file = jobs::run(py, None, |observer| {
        let limit = memory_limit(None).unwrap_or(u64::MAX);
        stage(observer, "reading the depth map", 0, || read_depth_map(&path, limit))
    })?;
    DepthParts::new(py, file.map, &facts_of_attributes(&file.attributes))
}

/// Writes a depth map in the format of the extension, with `[output]` and `[depth]` of the run file.
#[pyfunction]
pub(super) fn write_depth(
    py: Python<'_>,
    path: PathBuf,
    map: MapArrays<'_>,
    meta: String,
    run: &PythonRunFile,
) -> PyResult<()> {
    let map = map.map()?;
    let meta = json("meta", &meta)?;
    jobs::run(py, None, |_| write(&path, &map, &run.run, &meta))
}

/// Scores a depth map against a truth, as JSON; `meta` is that of either, the truth's first.
#[pyfunction]
pub(super) fn compare(
    py: Python<'_>,
    found: MapArrays<'_>,
    truth: MapArrays<'_>,
    meta: [String; 2],
    resolution: Option<f64>,
) -> PyResult<String> {
    let (found, truth) = (found.map()?, truth.map()?);
    let meta = [json("meta", &meta[0])?, json("meta", &meta[1])?];
    let known: Vec<Resolution> = meta.iter().filter_map(resolution_in).collect();
    let range = resolution.or_else(|| known.first().map(|known| known.range)).ok_or_else(|| {
        let problem = "is needed: neither depth map has its range resolution c/2B in its metadata, which decides what is a hit";
        Error::input("resolution", problem)
    })?;
    let aperture = known.into_iter().find_map(|known| known.aperture);
    let scores = jobs::run(py, None, |_| score(&found, &truth, Resolution { range, aperture }))?;
    Ok(serde_json::to_string(&scores).map_err(|error| Error::io("scores", error.to_string()))?)
}
