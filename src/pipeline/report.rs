//! `report.json`: resolved parameters, plan, counts, metrics, warnings, files and timings.

use super::Outcome;
use super::facts::PROGRAM;
use crate::acquisition::{CodeReport, Instrument};
use crate::config::RunFile;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::metrics::Metrics;
use crate::plan::{Plan, Smear};
use crate::reconstruct::{Correlation, Refinement};
use crate::reflectors::{BounceCounts, BouncePath, Reflectors};
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
    /// The bounced echoes among them, if there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub multipath: Option<Multipath>,
    /// What was simulated in addition to Eq. 5, and how the volume was corrected, in words.
    pub physics: Vec<String>,
    /// What the motion of the scene does to its image, if something moves.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub motion: Vec<Smear>,
    /// What the code of loudspeakers that sound at once is worth, if they do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coding: Option<CodeReport>,
    /// The method of the reconstruction.
    pub method: crate::reconstruct::Method,
    /// Maximum amplitude of the volume.
    pub peak_amplitude: f32,
    /// Bound on the error of any voxel, in units of amplitude.
    pub error_bound: f64,
    /// How the volume was refined, if it was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refinement: Option<Refinement>,
    /// How microphones were correlated, if they were.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub correlation: Option<Correlation>,
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
            multipath: outcome.multipath.clone(),
            physics: outcome.physics.clone(),
            motion: outcome.motion.clone(),
            coding: outcome.coding,
            method: outcome.image.method,
            peak_amplitude: outcome.image.volume.peak(),
            error_bound: outcome.image.error_bound,
            refinement: outcome.image.refinement,
            correlation: outcome.image.correlation,
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

/// Echoes of several surfaces; of several speakers those of the first.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Multipath {
    /// Number of bounced echoes.
    pub echoes: usize,
    /// What was found and what was left out.
    pub counts: BounceCounts,
    /// Their longest path, m.
    pub longest_path: f64,
    /// The kinds of paths from the strongest to the weakest, and where an image shows them.
    pub strongest: Vec<BouncePath>,
    /// Where the strongest echoes are seen, m, and their amplitudes.
    #[serde(skip)]
    pub seen: Vec<(DVec3, f32)>,
}

/// Kinds of paths that are listed, in the report and in words.
const LISTED: usize = 32;
const NAMED: usize = 4;

/// Echoes whose places are shown.
const SHOWN: usize = 1 << 14;

impl Multipath {
    /// Of a list of reflectors that has bounced ones, or pieces of edges.
    pub(super) fn of(reflectors: &Reflectors, instrument: &Instrument) -> Option<Self> {
        let counts = reflectors.bounce_counts()?;
        let centre = instrument.array.centre();
        let transmit = reflectors.transmit_lengths();
        let places = &reflectors.positions()[reflectors.direct()..];
        let paths = places.iter().zip(transmit).map(|(q, transmit)| transmit + q.distance(centre));
        let speaker = instrument.transmission(0).viewpoint();
        let mut strongest = reflectors.bounce_paths(speaker, centre);
        strongest.truncate(LISTED);
        Some(Self {
            echoes: transmit.len(),
            counts,
            longest_path: paths.fold(0.0, f64::max),
            strongest,
            seen: reflectors.seen_bounces(speaker, centre, SHOWN),
        })
    }

    /// What may be missing or in the wrong place.
    pub(super) fn warnings(&self, instrument: &Instrument) -> Vec<String> {
        let mut warnings = Vec::new();
        if let Some(unambiguous) = instrument.unambiguous_path().filter(|most| *most < self.longest_path) {
            warnings.push(format!(
                "bounced paths of up to {:.2} m are longer than the {unambiguous:.2} m that the sweep's step tells apart; they \
                 are seen nearer than they are",
                self.longest_path
            ));
        }
        if self.counts.edge_length_left_out > 0.0 {
            warnings.push(format!(
                "{:.2} m of the shortest edges do not diffract, to limit the number of their pieces; a coarser mesh has fewer",
                self.counts.edge_length_left_out
            ));
        }
        if self.counts.dropped_energy > 0.01 {
            warnings.push(format!(
                "the weakest bounced echoes, with {:.1} % of the energy of all, are left out to limit their number; use a larger \
                 [reflectors] spacing",
                100.0 * self.counts.dropped_energy
            ));
        }
        warnings
    }

    /// The strongest, a line each.
    pub(super) fn lines(&self) -> Vec<String> {
        let BounceCounts { mirrors, partners: [some, all], edge_length, edge_pieces, .. } = self.counts;
        let of = if some == all { String::new() } else { format!(" by {some} of {all}") };
        let bounced = self.echoes - edge_pieces;
        let of_surfaces =
            format!("{bounced} bounced echoes of {mirrors} mirrors and patches that light each other{of}");
        let of_edges = format!("{edge_length:.2} m of edges that diffract, in {edge_pieces} pieces");
        let found = [(bounced > 0).then_some(of_surfaces), (edge_length > 0.0).then_some(of_edges)];
        let found = found.into_iter().flatten().collect::<Vec<_>>().join("; ") + "; the strongest:";
        let named = self.strongest.iter().take(NAMED).map(|kind| {
            let [x, y, z] = kind.place;
            let [[_, _, near], [_, _, far]] = kind.within;
            format!(
                "{:.1} dB of the direct echoes, {}: seen about ({x:.2}, {y:.2}, {z:.2}), z {near:.2} to {far:.2} m",
                kind.level_db, kind.path
            )
        });
        std::iter::once(found).chain(named).collect()
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
