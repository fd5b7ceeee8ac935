//! `report.json`: resolved parameters, plan, counts, metrics, warnings, files, timings.

use super::Outcome;
use super::facts::PROGRAM;
use crate::config::RunFile;
use crate::grid::Grid;
use crate::metrics::Metrics;
use crate::plan::Plan;
use crate::reflectors::Reflectors;
use crate::scene::{Material, Scene};
use glam::DVec3;
use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// What one run did; serialised as `report.json`. Only `timings` differs between two runs of the same inputs.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// Program and version.
    pub program: &'static str,
    /// The run file, every default filled in.
    pub run: Value,
    /// What was predicted.
    pub plan: Plan,
    /// The voxels, whether typed or chosen.
    pub grid: Grid,
    /// The scene, when there was one.
    pub scene: Option<SceneSummary>,
    /// Number of reflectors simulated, when they were.
    pub reflectors: Option<usize>,
    /// What was simulated beyond Eq. 5 and done to the volume, in words.
    pub physics: Vec<String>,
    /// The method that reconstructed.
    pub method: crate::reconstruct::Method,
    /// Greatest amplitude of the volume.
    pub peak_amplitude: f32,
    /// Bound on the error of any voxel, in units of amplitude.
    pub error_bound: f64,
    /// Pixels of the depth map, and those with an accepted return.
    pub pixels: usize,
    /// Pixels with an accepted return.
    pub accepted: usize,
    /// Depth map against truth, when there is one.
    pub metrics: Option<Metrics>,
    /// The metrics of each material's surfaces, by name.
    pub materials: BTreeMap<String, Metrics>,
    /// The metrics of each pixel's first surface from the front, its second, and so on.
    pub surfaces: Vec<Metrics>,
    /// What the user should know.
    pub warnings: Vec<String>,
    /// Files written, by name within the output folder.
    pub files: Vec<PathBuf>,
    /// Seconds per stage.
    pub timings: Map<String, Value>,
}

impl Report {
    pub(super) fn new(run: &RunFile, outcome: &Outcome) -> Self {
        Self {
            program: PROGRAM,
            run: run.to_json(),
            plan: outcome.plan.clone(),
            grid: outcome.image.volume.grid,
            scene: outcome.scene.clone(),
            reflectors: outcome.reflectors.as_ref().map(Reflectors::len),
            physics: outcome.physics.clone(),
            method: outcome.image.method,
            peak_amplitude: outcome.image.volume.peak(),
            error_bound: outcome.image.error_bound,
            pixels: outcome.depth.len(),
            accepted: outcome.depth.accepted(),
            metrics: outcome.metrics(),
            materials: outcome.scores.as_ref().map_or_else(BTreeMap::new, |scores| scores.materials.clone()),
            surfaces: outcome.scores.as_ref().map_or_else(Vec::new, |scores| scores.surfaces.clone()),
            warnings: outcome.warnings.clone(),
            files: Vec::new(),
            timings: outcome.timings.iter().map(|(stage, s)| (stage.clone(), (*s).into())).collect(),
        }
    }

    /// Seconds of all stages together.
    pub fn seconds(&self) -> f64 {
        self.timings.values().filter_map(Value::as_f64).sum()
    }
}

/// Where a scene lies and what it is made of.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SceneSummary {
    /// Least corner of its box, m.
    pub low: [f64; 3],
    /// Greatest corner of its box, m.
    pub high: [f64; 3],
    /// Its box's size, m.
    pub size: [f64; 3],
    /// Its box's size in wavelengths at the centre of the band.
    pub size_wavelengths: [f64; 3],
    /// Triangles; 0 for a list of reflectors.
    pub triangles: usize,
    /// Surface, m².
    pub area: f64,
    /// Distance between reflectors, whether typed or chosen, m; `None` for a list of reflectors.
    pub reflector_spacing: Option<f64>,
    /// The materials as they were resolved.
    pub materials: Vec<Material>,
}

impl SceneSummary {
    pub(super) fn new(
        scene: Option<&Scene>,
        reflector_spacing: Option<f64>,
        low: DVec3,
        high: DVec3,
        wavelength: f64,
    ) -> Self {
        Self {
            low: low.to_array(),
            high: high.to_array(),
            size: (high - low).to_array(),
            size_wavelengths: ((high - low) / wavelength).to_array(),
            triangles: scene.map_or(0, |scene| scene.triangles().len()),
            area: scene.map_or(0.0, Scene::surface_area),
            reflector_spacing,
            materials: scene.map_or(&[][..], Scene::materials).to_vec(),
        }
    }
}
