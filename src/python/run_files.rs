//! Run files, which carry the options of every job.

use crate::cli::inputs::{bare_mesh, bytes, run_file_of};
use crate::config::{self, TypedKeys};
use crate::error::Result;
use crate::files::extension;
use crate::pipeline::BareMesh;
use crate::progress::Silent;
use pyo3::prelude::*;
use std::path::{Path, PathBuf};

/// Where a run file comes from, so that it can be read again with more settings.
#[derive(Debug, Clone)]
enum RunFileOrigin {
    /// A run file, a mesh or a list of reflectors.
    File(PathBuf),
    /// TOML, and the folder of the files that it names.
    Text(String, PathBuf),
}

/// A run file, or a mesh or a list of reflectors with the settings that suit it.
#[pyclass(frozen, name = "RunFile", module = "holosonar._holosonar")]
#[derive(Debug)]
pub(super) struct PythonRunFile {
    pub(super) run: config::RunFile,
    pub(super) bare: Option<BareMesh>,
    pub(super) typed: Option<TypedKeys>,
    origin: RunFileOrigin,
    settings: Vec<String>,
}

impl PythonRunFile {
    fn read(origin: RunFileOrigin, settings: Vec<String>) -> Result<Self> {
        let (run, bare, typed) = match &origin {
            RunFileOrigin::Text(text, folder) => {
                let (run, typed) = config::RunFile::read_at(text, "run file", folder, &settings)?;
                (run, None, Some(typed))
            }
            RunFileOrigin::File(path) if extension(path) == "toml" => {
                let (run, typed) = config::RunFile::load_with_keys(path, &settings)?;
                (run, None, Some(typed))
            }
            RunFileOrigin::File(path) => match bare_mesh(path, &settings, &Silent)? {
                Some(bare) => (bare.run.clone(), Some(bare), None),
                None => (run_file_of(path, &settings)?, None, None),
            },
        };
        Ok(Self { run, bare, typed, origin, settings })
    }

    /// The run file for a job that may use so much memory, a size as in `2GiB`.
    ///
    /// # Errors
    /// Text that is not a size.
    pub(super) fn within(&self, memory: Option<&str>) -> Result<config::RunFile> {
        let memory = memory.map(|memory| bytes("memory", memory)).transpose()?;
        Ok(config::RunFile { memory, ..self.run.clone() })
    }

    /// The settings that it was read with.
    pub(super) fn settings(&self) -> &[String] {
        &self.settings
    }

    /// The same with more settings.
    pub(super) fn with(&self, settings: &[String]) -> Result<Self> {
        Self::read(self.origin.clone(), [&self.settings, settings].concat())
    }
}

#[pymethods]
impl PythonRunFile {
    /// Reads a run file (.toml), a mesh or a list of reflectors (.csv).
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf, settings: Vec<String>) -> PyResult<Self> {
        py.detach(|| Ok(Self::read(RunFileOrigin::File(path), settings)?))
    }

    /// Reads TOML; files that it names are relative to `folder`.
    #[staticmethod]
    fn from_toml(text: String, folder: PathBuf, settings: Vec<String>) -> PyResult<Self> {
        Ok(Self::read(RunFileOrigin::Text(text, folder), settings)?)
    }

    /// The same with more settings, each `table.key=value`.
    fn with_settings(&self, py: Python<'_>, settings: Vec<String>) -> PyResult<Self> {
        py.detach(|| Ok(self.with(&settings)?))
    }

    /// Every key, with all defaults, as TOML.
    fn to_toml(&self) -> String {
        self.run.to_toml()
    }

    /// Every key, with all defaults, as JSON.
    fn to_json(&self) -> String {
        self.run.to_json().to_string()
    }

    /// Its file, if it is one.
    #[getter]
    fn path(&self) -> Option<&Path> {
        match &self.origin {
            RunFileOrigin::File(path) => Some(path),
            RunFileOrigin::Text(..) => None,
        }
    }

    /// Whether it names a scene.
    #[getter]
    fn has_scene(&self) -> bool {
        self.run.scene.files().next().is_some()
    }

    /// What may be wrong with the placement of a mesh without a run file.
    #[getter]
    fn hints(&self) -> Vec<String> {
        self.bare.as_ref().map_or_else(Vec::new, |bare| bare.hints.clone())
    }
}
