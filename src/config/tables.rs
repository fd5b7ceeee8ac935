//! The tables of a run file, key by key, as typed: lengths in m, frequencies in Hz, angles in degrees.
//!
//! A key that may be left out, with a meaning of its own when it is, is an `Option`; every other key has the
//! default that `Default` gives.

use super::choices::{
    Components, Compression, DetectionKind, Fill, Geometry, InputFile, Layout, Method, Model, Occlusion,
    Pick, Refine, Shading, Surface, Unit, Up, View, VolumeFormat, Window,
};
use crate::acquisition::SIMULATION_TOLERANCE;
use crate::depth::DepthOptions;
use crate::wave::DEFAULT_SOUND_SPEED;
use serde::de::{self, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;
use std::fmt;

/// `[scene]`: what is imaged, and where it stands.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scene {
    /// Mesh (`.obj`, `.gltf`, `.glb`, `.stl`, `.ply`) or reflectors (`.csv`).
    pub mesh: Option<InputFile>,
    /// Unit of the mesh's coordinates; left out: what the file itself says.
    pub unit: Option<Unit>,
    /// The mesh's upward axis; left out: `y` for glTF, `none` for anything else.
    pub up: Option<Up>,
    /// Factor applied first.
    pub scale: f64,
    /// Degrees about the array's x, then y, then z (fixed axes).
    pub rotate: [f64; 3],
    /// Moves the mesh, m; left out: not at all. Excludes `fit`.
    pub translate: Option<[f64; 3]>,
    /// Where the centre of the mesh's bounding box goes, m. Excludes `translate`.
    pub fit: Option<[f64; 3]>,
    /// `camera:NAME` or `node:NAME` of a glTF file: the array sits there and looks where it looks.
    pub sensor: Option<String>,
    /// Which paths surfaces weaken.
    pub occlusion: Occlusion,
}

impl Default for Scene {
    fn default() -> Self {
        Self {
            mesh: None,
            unit: None,
            up: None,
            scale: 1.0,
            rotate: [0.0; 3],
            translate: None,
            fit: None,
            sensor: None,
            occlusion: Occlusion::Speaker,
        }
    }
}

/// One `[[materials]]`: the first rule whose pattern matches a material's or node's name overrides the mesh
/// file's own values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialRule {
    /// Pattern: `*` stands for any text, `?` for one character.
    pub name: String,
    /// Reflected amplitude, 0 to 1; left out: the mesh file's.
    pub reflectance: Option<f64>,
    /// Amplitude left after one crossing, 0 to 1; left out: the mesh file's.
    pub transmittance: Option<f64>,
}

/// `[reflectors]`: how surfaces become point reflectors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Reflectors {
    /// Distance between reflectors, m; left out: `min(λ_c/2, half the lateral resolution)`.
    pub spacing: Option<f64>,
    /// How they scatter.
    pub surface: Surface,
    /// Rms displacement of a rough surface, in wavelengths at the centre frequency.
    pub roughness: f64,
    /// How the angle of incidence counts.
    pub shading: Shading,
    /// Seed of everything random about them.
    pub seed: u32,
}

impl Default for Reflectors {
    fn default() -> Self {
        Self {
            spacing: None,
            surface: Surface::Diffuse,
            roughness: 0.125,
            shading: Shading::Lambert,
            seed: 1,
        }
    }
}

/// `[medium]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Medium {
    /// Speed of sound, m/s.
    pub sound_speed: f64,
}

impl Default for Medium {
    fn default() -> Self {
        Self { sound_speed: DEFAULT_SOUND_SPEED }
    }
}

/// `[sweep]`: the frequencies, both ends included.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sweep {
    /// First frequency, Hz.
    pub start: f64,
    /// Last frequency, Hz.
    pub stop: f64,
    /// Distance between frequencies, Hz.
    pub step: f64,
}

impl Default for Sweep {
    fn default() -> Self {
        Self { start: 10_000.0, stop: 20_000.0, step: 20.0 }
    }
}

/// `[array]`: speaker and microphones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default = "Array::before_filling", deny_unknown_fields)]
pub struct Array {
    /// Who moves.
    pub geometry: Geometry,
    /// The speaker, m.
    pub source: [f64; 3],
    /// Centre of the rectangle of microphones, m; it stays parallel to z = 0.
    pub centre: [f64; 3],
    /// Microphones along x and y.
    pub count: [u32; 2],
    /// Distance between neighbours along x and y, m. Excludes `extent`.
    pub pitch: Option<[f64; 2]>,
    /// First to last microphone along x and y, m. Excludes `pitch`.
    pub extent: Option<[f64; 2]>,
    /// Where the positions come from.
    pub layout: Layout,
    /// The microphones' positions (CSV with header `x,y,z`, m) for layout `file`.
    pub file: Option<InputFile>,
}

impl Array {
    /// The pitch when neither `pitch` nor `extent` is typed, m.
    pub(super) const PITCH: [f64; 2] = [0.016, 0.016];

    /// The defaults before it is known whether `pitch` or `extent` was typed.
    pub(super) fn before_filling() -> Self {
        Self {
            geometry: Geometry::FixedSource,
            source: [0.0; 3],
            centre: [0.0; 3],
            count: [64, 64],
            pitch: None,
            extent: None,
            layout: Layout::Grid,
            file: None,
        }
    }
}

impl Default for Array {
    fn default() -> Self {
        Self { pitch: Some(Self::PITCH), ..Self::before_filling() }
    }
}

/// `[detection]`: what is measured, and how well.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Detection {
    /// Complex samples or real ones.
    pub kind: DetectionKind,
    /// Exact or far-field path lengths.
    pub model: Model,
    /// Mean signal power over mean noise power, dB; left out: no noise.
    pub snr_db: Option<f64>,
    /// Error allowed to the simulation, relative to the sum of all amplitudes; 0 sums every term.
    pub tolerance: f64,
}

impl Default for Detection {
    fn default() -> Self {
        Self {
            kind: DetectionKind::Quadrature,
            model: Model::Exact,
            snr_db: None,
            tolerance: SIMULATION_TOLERANCE,
        }
    }
}

/// `[grid]`: the voxels. What is left out, the plan chooses.
///
/// An axis is `[first, last]` and a pitch: its voxels start at `first`, and the last is the largest that fits.
/// Instead of one of the three, `count` may be given:
/// - `x = [first, last]` and `count`: both ends are voxels, and the pitch follows;
/// - `x = first`, `pitch` and `count`: the last voxel follows.
///
/// Loading fills in what follows, so that whoever reads `x`, `y`, `z` and `pitch` may ignore `count`.
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
    struct Ends([f64; 2]);
    impl<'de> Deserialize<'de> for Ends {
        fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
            deserializer.deserialize_any(EndsVisitor)
        }
    }
    struct EndsVisitor;
    impl<'de> Visitor<'de> for EndsVisitor {
        type Value = Ends;

        fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
            f.write_str("[first, last] in metres, or `first` alone beside `pitch` and `count`")
        }

        fn visit_f64<E: de::Error>(self, first: f64) -> Result<Ends, E> {
            Ok(Ends([first, f64::NAN]))
        }

        fn visit_i64<E: de::Error>(self, first: i64) -> Result<Ends, E> {
            self.visit_f64(first as f64)
        }

        fn visit_u64<E: de::Error>(self, first: u64) -> Result<Ends, E> {
            self.visit_f64(first as f64)
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Ends, A::Error> {
            let mut values: Vec<f64> = Vec::new();
            while let Some(value) = list.next_element()? {
                values.push(value);
            }
            match values[..] {
                [first, last] if !last.is_nan() => Ok(Ends([first, last])),
                _ => Err(de::Error::invalid_length(values.len(), &self)),
            }
        }
    }
    Ok(Option::<Ends>::deserialize(deserializer)?.map(|ends| ends.0))
}

/// `[reconstruct]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Reconstruct {
    /// How the volume is computed.
    pub method: Method,
    /// Error allowed relative to the mean of the samples' magnitudes; 0 uses every frequency.
    pub tolerance: f64,
    /// Weights over x, y and frequency.
    pub window: Window,
}

impl Default for Reconstruct {
    fn default() -> Self {
        Self { method: Method::Auto, tolerance: 1e-4, window: Window::Taylor }
    }
}

/// `[depth]`: how returns are found in the volume.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Depth {
    /// Which return becomes the pixel's depth.
    pub pick: Pick,
    /// How it is placed between voxels.
    pub refine: Refine,
    /// Least amplitude, dB against the 99th percentile of the columns' maxima.
    pub threshold_db: f64,
    /// Most returns per pixel.
    pub returns: u32,
    /// Least amplitude of a further return, dB against the same percentile.
    pub return_threshold_db: f64,
    /// Least amplitude of a further return, dB against its column's maximum.
    pub return_gate_db: f64,
    /// Least distance between returns, in `c/2B`.
    pub separation: f64,
    /// Gaussian sigma along x, y, z of the power in which further returns are found, m.
    pub smoothing: [f64; 3],
    /// Side of the median filter, pixels; 1 is none.
    pub median: u32,
    /// `Z` where nothing was accepted.
    pub fill: Fill,
    /// Along which rays depth is looked for.
    pub view: View,
}

impl Default for Depth {
    fn default() -> Self {
        // The stage's own defaults; a resolution is no part of the table.
        let stage = DepthOptions::new(f64::NAN);
        Self {
            pick: stage.pick,
            refine: stage.refine,
            threshold_db: stage.threshold_db,
            returns: stage.returns as u32,
            return_threshold_db: stage.return_threshold_db,
            return_gate_db: stage.return_gate_db,
            separation: stage.separation,
            smoothing: stage.smoothing,
            median: stage.median as u32,
            fill: Fill::Inf,
            view: View::Orthographic,
        }
    }
}

/// `[output]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Output {
    /// In which formats the volume is written; none at all is allowed.
    pub formats: Vec<VolumeFormat>,
    /// What EXR and VTI volumes hold; npz is always complex, NRRD always amplitude.
    pub components: Components,
    /// Whether amplitudes in EXR files take 16 bits; depths and complex parts keep 32.
    pub float16: bool,
    /// Of EXR and NRRD files.
    pub compression: Compression,
    /// Whether `image` writes the point clouds `depth.ply` and `scene.ply`.
    pub points: bool,
    /// Whether `image` writes the page `report.html`.
    pub report: bool,
}

impl Default for Output {
    fn default() -> Self {
        Self {
            formats: vec![VolumeFormat::Exr, VolumeFormat::Npz],
            components: Components::Amplitude,
            float16: false,
            compression: Compression::Zip,
            points: true,
            report: true,
        }
    }
}

/// `[expect]`: limits on metrics, by name.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Expect {
    /// Name of a metric (one of [`METRIC_NAMES`](crate::metrics::METRIC_NAMES)) and what it is held to.
    pub limits: BTreeMap<String, Limit>,
}

/// What one metric is held to; at least one side is given.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limit {
    /// Least value allowed: m for an error, a fraction for the rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// Greatest value allowed, in the same units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
}
