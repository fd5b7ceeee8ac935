//! `report.json`: resolved parameters, plan, counts, metrics, warnings, files and timings.

use super::Outcome;
use super::facts::PROGRAM;
use crate::acquisition::Instrument;
use crate::config::RunFile;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::metrics::Metrics;
use crate::plan::Plan;
use crate::reconstruct::Refinement;
use crate::reflectors::Reflectors;
use crate::scene::{Material, Scene, Up};
use glam::DVec3;
use serde::Serialize;
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The report of one run, serialised as `report.json`. Only `timings` differs between two runs with the same inputs.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct Report {
    /// Program and version.
    pub program: &'static str,
    /// The run file, every default filled in.
    pub run: Value,
    /// The plan: resolution, ambiguity, aliasing and sizes as predicted.
    pub plan: Plan,
    /// The voxels, as typed or chosen.
    pub grid: Grid,
    /// The scene, when there was one.
    pub scene: Option<SceneSummary>,
    /// Number of reflectors simulated, when they were.
    pub reflectors: Option<usize>,
    /// What was simulated in addition to Eq. 5, and how the volume was corrected, in words.
    pub physics: Vec<String>,
    /// The method of the reconstruction.
    pub method: crate::reconstruct::Method,
    /// Maximum amplitude of the volume.
    pub peak_amplitude: f32,
    /// Bound on the error of any voxel, in units of amplitude.
    pub error_bound: f64,
    /// How the volume was refined, if it was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refinement: Option<Refinement>,
    /// Pixels of the depth map.
    pub pixels: usize,
    /// Pixels with an accepted return.
    pub accepted: usize,
    /// The metrics of the depth map, if there is a truth.
    pub metrics: Option<Metrics>,
    /// The metrics of each material's surfaces, by name.
    pub materials: BTreeMap<String, Metrics>,
    /// The metrics of each pixel's first surface from the front, its second, and so on.
    pub surfaces: Vec<Metrics>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
    /// Files written, by name within the output folder.
    pub files: Vec<PathBuf>,
    /// Seconds per stage.
    pub timings: Map<String, Value>,
}

impl Report {
    pub(crate) fn new(run: &RunFile, outcome: &Outcome) -> Self {
        let scores = outcome.scores.clone().unwrap_or_default();
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
            refinement: outcome.image.refinement,
            pixels: outcome.depth.len(),
            accepted: outcome.depth.accepted(),
            metrics: outcome.metrics(),
            materials: scores.materials,
            surfaces: scores.surfaces,
            warnings: outcome.warnings.clone(),
            files: Vec::new(),
            timings: outcome.timings.iter().map(|(stage, s)| (stage.clone(), (*s).into())).collect(),
        }
    }

    /// The text of `report.json`.
    pub(crate) fn to_text(&self) -> Result<String> {
        // Not through a `Value`, which would write an f32 with the digits of an f64.
        let text = serde_json::to_string_pretty(self);
        text.map(|text| text + "\n").map_err(|e| Error::io("report", e.to_string()).with_source(e))
    }

    /// Seconds of all stages together.
    pub fn seconds(&self) -> f64 {
        self.timings.values().filter_map(Value::as_f64).sum()
    }
}

/// The position, size and materials of a scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct SceneSummary {
    /// Minimum corner of its bounding box, m.
    pub low: [f64; 3],
    /// Maximum corner of its bounding box, m.
    pub high: [f64; 3],
    /// Size of its bounding box, m.
    pub size: [f64; 3],
    /// Size of its bounding box in wavelengths at the centre of the band.
    pub size_wavelengths: [f64; 3],
    /// Resolution cells across it along x and y, at the depth of its middle.
    pub resolution_cells: [Option<f64>; 2],
    /// The upward axis of the mesh's file that was used; `None` for a list of reflectors and at a sensor.
    pub up: Option<Up>,
    /// Triangles; 0 for a list of reflectors.
    pub triangles: usize,
    /// Surface area, m².
    pub area: f64,
    /// Distance between reflectors, as typed or chosen, m; `None` for a list of reflectors.
    pub reflector_spacing: Option<f64>,
    /// The resolved materials.
    pub materials: Vec<Material>,
}

impl SceneSummary {
    pub(super) fn new(
        scene: Option<&Scene>,
        reflector_spacing: Option<f64>,
        (low, high): (DVec3, DVec3),
        instrument: &Instrument,
    ) -> Self {
        let wavelength = instrument.wavelength();
        Self {
            low: low.to_array(),
            high: high.to_array(),
            size: (high - low).to_array(),
            size_wavelengths: ((high - low) / wavelength).to_array(),
            resolution_cells: instrument.cells_across(low, high),
            up: scene.and_then(Scene::frame).and_then(|frame| frame.up),
            triangles: scene.map_or(0, |scene| scene.triangles().len()),
            area: scene.map_or(0.0, Scene::surface_area),
            reflector_spacing,
            materials: scene.map_or(&[][..], Scene::materials).to_vec(),
        }
    }
}
