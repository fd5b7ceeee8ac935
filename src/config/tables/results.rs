//! The grid, the reconstruction, the depth map, the output files and the expected metrics.

use super::pair::PairVisitor;
use crate::config::choices::{RefineMethod, VolumeFormat};
use crate::depth::{DepthOptions, Pick, Refine};
use crate::export::volume_vdb::THRESHOLD_DB;
use crate::export::{Components, Compression, Fill};
use crate::grid::View;
use crate::reconstruct::{Method, RefineOptions, Solver, Window};
use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// `[grid]`: the voxels. The plan chooses what is left out.
///
/// An axis is `[first, last]` and a pitch: its voxels start at `first`, and the last is the largest that fits.
/// Instead of one of the three, `count` may be given:
/// - `x = [first, last]` and `count`: both ends are voxels, and the pitch follows;
/// - `x = first`, `pitch` and `count`: the last voxel follows.
///
/// Loading fills in the third, so that readers of `x`, `y`, `z` and `pitch` may ignore `count`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GridTable {
    /// First and last column, m.
    #[serde(deserialize_with = "ends")]
    pub x: Option<[f64; 2]>,
    /// First and last row (downwards), m.
    #[serde(deserialize_with = "ends")]
    pub y: Option<[f64; 2]>,
    /// First and last depth, m.
    #[serde(deserialize_with = "ends")]
    pub z: Option<[f64; 2]>,
    /// Distance between neighbours along x, y and z, m.
    pub pitch: Option<[f64; 3]>,
    /// Voxels along x, y and z.
    pub count: Option<[u32; 3]>,
}

/// Reads `[first, last]`, or `first` alone as `[first, NaN]`, which filling replaces or refuses.
fn ends<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<[f64; 2]>, D::Error> {
    let expecting = "[first, last] in metres, or `first` alone with `pitch` and `count`";
    deserializer.deserialize_any(PairVisitor { expecting, single: |first| [first, f64::NAN] })
}

/// `[reconstruct]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReconstructTable {
    /// How the volume is computed.
    pub method: Method,
    /// Error allowed, relative to the mean of the samples' magnitudes; 0 uses every frequency.
    pub tolerance: f64,
    /// Weights over x, y and frequency.
    pub window: Window,
    /// Whether spherical spreading is undone in the volume.
    pub compensate: bool,
    /// Of `correlation`: tones of a sub-band, which are summed with their phases; left out: 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sub_band: Option<u32>,
}

impl Default for ReconstructTable {
    fn default() -> Self {
        Self {
            method: Method::Auto,
            tolerance: 1e-4,
            window: Window::None,
            compensate: false,
            sub_band: None,
        }
    }
}

/// `[refine]`: an image beyond the matched filter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineTable {
    /// How, or that the volume is not refined.
    pub method: RefineMethod,
    /// The most steps.
    pub steps: u32,
    /// Of `fista`: the amplitude that is taken from every voxel's, relative to the largest of the matched filter.
    pub sparsity: f64,
    /// Root mean square of the noise in a sample; left out: measured.
    pub noise: Option<f64>,
}

impl Default for RefineTable {
    fn default() -> Self {
        let stage = RefineOptions::new(Solver::Fista);
        Self {
            method: RefineMethod::None,
            steps: stage.steps as u32,
            sparsity: stage.sparsity,
            noise: stage.noise,
        }
    }
}

/// `[depth]`: how returns are found in the volume.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthTable {
    /// Which return becomes the pixel's depth.
    pub pick: Pick,
    /// How its position between voxels is found.
    pub refine: Refine,
    /// Minimum amplitude of the picked return, dB relative to the 99th percentile of the columns' maxima; left out: -14 dB of
    /// columns, and none but `return_threshold_db` of surfaces.
    pub threshold_db: Option<f64>,
    /// Minimum confidence of a surface, dB; left out: −5.6 dB, −7 dB in a refined volume, and more where few
    /// microphones leave strong sidelobes.
    pub confidence_db: Option<f64>,
    /// How much weaker than further in a surface is where it ends, dB; left out: −5.8 dB, −7 dB in a refined volume.
    pub rim_db: Option<f64>,
    /// Whether what is in one part of the band only is taken for weaker, and mirrors are told by their phase.
    pub gate: bool,
    /// Maximum number of returns per pixel.
    pub returns: u32,
    /// Minimum amplitude of a further return, dB relative to the same percentile.
    pub return_threshold_db: f64,
    /// Minimum amplitude of a further return, dB relative to its column's maximum.
    pub return_gate_db: f64,
    /// Minimum contrast of a further return with the power around it, dB; 0: none.
    pub return_contrast_db: f64,
    /// Minimum distance between returns, in `c/2B`.
    pub separation: f64,
    /// Gaussian sigma of the power in which further returns are found: along x and y in lateral resolutions, along z in
    /// `c/2B`.
    pub smoothing: [f64; 3],
    /// Side of the median filter, pixels; 1 is none.
    pub median: u32,
    /// `Z` where nothing was accepted.
    pub fill: Fill,
    /// Along which rays depth and truth are located.
    pub view: View,
    /// Vertical field of view of the perspective view, degrees; left out: that of the glTF camera the array sits at.
    pub fov: Option<f64>,
    /// Columns and rows of the perspective view; left out: 256 rows in the camera's shape.
    pub pixels: Option<[u32; 2]>,
}

impl Default for DepthTable {
    fn default() -> Self {
        // The stage's own defaults; the resolution is not part of the table.
        let stage = DepthOptions::new(f64::NAN);
        Self {
            pick: stage.pick,
            refine: stage.refine,
            threshold_db: stage.threshold_db,
            confidence_db: None,
            rim_db: None,
            gate: stage.gate,
            returns: stage.returns as u32,
            return_threshold_db: stage.return_threshold_db,
            return_gate_db: stage.return_gate_db,
            return_contrast_db: stage.return_contrast_db,
            separation: stage.separation,
            smoothing: stage.smoothing,
            median: stage.median as u32,
            fill: Fill::Infinity,
            view: View::Orthographic,
            fov: None,
            pixels: None,
        }
    }
}

/// `[output]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutputTable {
    /// In which formats the volume is written; may be empty.
    pub formats: Vec<VolumeFormat>,
    /// What EXR, VTI and Zarr volumes hold; npz is always complex, NRRD and VDB always amplitude.
    pub components: Components,
    /// Whether amplitudes in EXR files take 16 bits; depths and complex parts always take 32.
    pub float16: bool,
    /// Of EXR, NRRD, VDB and Zarr files.
    pub compression: Compression,
    /// Voxels of a VDB volume below this level, dB relative to the peak, are inactive.
    pub vdb_threshold_db: f64,
    /// Whether `image` writes the point clouds `depth.ply` and `scene.ply`, and the scene's mesh `mesh.ply`.
    pub points: bool,
    /// Whether `image` writes the page `report.html`.
    pub report: bool,
}

impl Default for OutputTable {
    fn default() -> Self {
        Self {
            formats: vec![VolumeFormat::Exr, VolumeFormat::Npz],
            components: Components::Amplitude,
            float16: false,
            compression: Compression::Zip,
            vdb_threshold_db: THRESHOLD_DB,
            points: true,
            report: true,
        }
    }
}

/// `[expect]`: limits on metrics, by name, and the seeds whose mean must keep them.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ExpectTable {
    /// Seeds of `[reflectors]` that `check` runs; if empty, only the run file's own.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub seeds: Vec<u32>,
    /// A metric (one of [`METRIC_NAMES`](crate::metrics::METRIC_NAMES)), or that of a material or surface
    /// ([`Measure::parse`](crate::metrics::Measure::parse)), and its limits.
    #[serde(flatten)]
    pub limits: BTreeMap<String, Limit>,
}

impl<'de> Deserialize<'de> for ExpectTable {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ExpectVisitor;
        impl<'de> Visitor<'de> for ExpectVisitor {
            type Value = ExpectTable;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("limits such as completeness = { min = 0.65 }")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut table: A) -> Result<ExpectTable, A::Error> {
                let mut expect = ExpectTable::default();
                while let Some(name) = table.next_key::<String>()? {
                    if name == "seeds" {
                        expect.seeds = table.next_value()?;
                    } else {
                        expect.limits.insert(name, table.next_value()?);
                    }
                }
                Ok(expect)
            }
        }
        deserializer.deserialize_map(ExpectVisitor)
    }
}

/// The limits of one metric; at least one is given.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limit {
    /// Minimum value: m for an error, a fraction for other metrics.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Maximum value, in the same units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
}
