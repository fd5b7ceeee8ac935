//! The medium, the sweep, the array and the detection.

use super::pair::PairVisitor;
use crate::acquisition::{Detection, PropagationModel, SIMULATION_TOLERANCE};
use crate::config::choices::{ArrayLayout, InputFile};
use crate::wave::air::{Air, REFERENCE_PRESSURE};
use crate::wave::{DEFAULT_SOUND_SPEED, GeometryKind, Interface};
use serde::{Deserialize, Deserializer, Serialize};

/// `[medium]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default = "MediumTable::before_filling", deny_unknown_fields)]
pub struct MediumTable {
    /// Speed of sound, m/s. Excludes `temperature`, from which it would follow.
    pub sound_speed: Option<f64>,
    /// Of the air, °C.
    pub temperature: Option<f64>,
    /// Relative humidity of the air, %; needs `temperature`.
    pub humidity: Option<f64>,
    /// Of the air, Pa; needs `temperature`.
    pub pressure: Option<f64>,
    /// Whether amplitudes fall with distance, `(1 m)²/(d₁ d₂)`.
    pub spreading: bool,
    /// Whether the air absorbs (ISO 9613-1); needs `temperature`.
    pub absorption: bool,
    /// A plane of constant z beyond which sound has another speed.
    pub interface: Option<Interface>,
    /// Of the frame that is imaged, m/s: what moves with it while the tones are played is imaged as if it were still.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<[f64; 3]>,
}

impl MediumTable {
    /// Humidity in % and pressure in Pa of the air when only its temperature is typed.
    pub(in crate::config) const HUMIDITY: f64 = 50.0;
    pub(in crate::config) const PRESSURE: f64 = REFERENCE_PRESSURE;

    /// The defaults before it is known whether `temperature` was typed.
    pub(in crate::config) fn before_filling() -> Self {
        Self {
            sound_speed: None,
            temperature: None,
            humidity: None,
            pressure: None,
            spreading: false,
            absorption: false,
            interface: None,
            velocity: None,
        }
    }

    /// The air, if its temperature was typed.
    pub fn air(&self) -> Option<Air> {
        self.temperature.map(|temperature| Air {
            temperature,
            humidity: self.humidity.unwrap_or(Self::HUMIDITY),
            pressure: self.pressure.unwrap_or(Self::PRESSURE),
        })
    }

    /// Speed of sound c, as typed or of the air, m/s.
    pub fn speed(&self) -> f64 {
        let air = || self.air().map(|air| air.sound_speed());
        self.sound_speed.or_else(air).unwrap_or(DEFAULT_SOUND_SPEED)
    }
}

impl Default for MediumTable {
    fn default() -> Self {
        Self { sound_speed: Some(DEFAULT_SOUND_SPEED), ..Self::before_filling() }
    }
}

/// `[sweep]`: the frequencies, both ends included.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SweepTable {
    /// First frequency, Hz.
    pub start: f64,
    /// Last frequency, Hz.
    pub stop: f64,
    /// Distance between frequencies, Hz.
    pub step: f64,
}

impl Default for SweepTable {
    fn default() -> Self {
        Self { start: 10_000.0, stop: 20_000.0, step: 20.0 }
    }
}

/// `[array]`: speaker and microphones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default = "ArrayTable::before_filling", deny_unknown_fields)]
pub struct ArrayTable {
    /// What moves during the scan.
    pub geometry: GeometryKind,
    /// The speaker, m.
    pub source: [f64; 3],
    /// Several speakers, one after another, m; excludes `source`.
    pub sources: Option<Vec<[f64; 3]>>,
    /// From the microphone to the speaker of a moved pair, m.
    pub source_offset: Option<[f64; 3]>,
    /// The speakers of pairs, one for each microphone in their order (CSV with header `x,y,z`, or Acoular's XML, m);
    /// excludes `source_offset`.
    pub source_file: Option<InputFile>,
    /// Centre of the rectangle of microphones, m; it stays parallel to z = 0.
    pub centre: [f64; 3],
    /// Microphones along x and y; one number counts for both. Other layouts than grids have the product of both in all.
    #[serde(deserialize_with = "both")]
    pub count: Option<[u32; 2]>,
    /// Total number of microphones, instead of `count`; a grid of them is square.
    pub elements: Option<u32>,
    /// Distance between neighbours along x and y, m; one number counts for both. Excludes `extent`. Other layouts cover the
    /// extent that such a grid would.
    #[serde(deserialize_with = "both")]
    pub pitch: Option<[f64; 2]>,
    /// First to last microphone along x and y, m; one number counts for both. Excludes `pitch`.
    #[serde(deserialize_with = "both")]
    pub extent: Option<[f64; 2]>,
    /// Where the positions come from.
    pub layout: ArrayLayout,
    /// Minimum distance between microphones of layout `random`, m.
    pub spacing: Option<f64>,
    /// Seed of layout `random`.
    pub seed: Option<u32>,
    /// The microphones' positions (CSV with header `x,y,z`, or Acoular's XML, m) for layout `file`.
    pub file: Option<InputFile>,
    /// Radius of the speaker, a piston that faces +z, m; 0: omnidirectional.
    pub speaker_radius: f64,
    /// Radius of the microphones, m; likewise.
    pub microphone_radius: f64,
    /// Errors of the microphones' gains, dB rms.
    pub gain_error_db: f64,
    /// Errors of their phases, degrees rms.
    pub phase_error: f64,
    /// Errors of their positions, m rms along each axis.
    pub position_error: f64,
    /// Seed of these errors alone.
    pub error_seed: u32,
}

/// Microphones in no rows that are asked about if they may have been counted along one side.
const MANY: u64 = 10_000;

impl ArrayTable {
    /// The count when neither `count` nor `elements` is typed.
    pub(in crate::config) const COUNT: [u32; 2] = [64, 64];

    /// The pitch when neither `pitch` nor `extent` is typed, m.
    pub(in crate::config) const PITCH: [f64; 2] = [0.016, 0.016];

    /// What to say of a `count` that looks like that of all microphones, where they are in no rows.
    pub(crate) fn count_warning(&self) -> Option<String> {
        let [x, y] = self.count?;
        let all = u64::from(x) * u64::from(y);
        let likely =
            x == y && all >= MANY && matches!(self.layout, ArrayLayout::Spiral | ArrayLayout::Random);
        likely.then(|| {
            format!(
                "[array] count = {x} is {x} x {y} = {all} microphones; elements = {x} asks for {x} of them in layout \"{}\"",
                self.layout
            )
        })
    }

    /// The defaults before it is known whether `pitch` or `extent` was typed.
    pub(in crate::config) fn before_filling() -> Self {
        Self {
            geometry: GeometryKind::FixedSource,
            source: [0.0; 3],
            sources: None,
            source_offset: None,
            source_file: None,
            centre: [0.0; 3],
            count: None,
            elements: None,
            pitch: None,
            extent: None,
            layout: ArrayLayout::Grid,
            spacing: None,
            seed: None,
            file: None,
            speaker_radius: 0.0,
            microphone_radius: 0.0,
            gain_error_db: 0.0,
            phase_error: 0.0,
            position_error: 0.0,
            error_seed: 1,
        }
    }
}

impl Default for ArrayTable {
    fn default() -> Self {
        Self { count: Some(Self::COUNT), pitch: Some(Self::PITCH), ..Self::before_filling() }
    }
}

/// Reads `[along x, along y]`, or one number for both.
fn both<'de, D: Deserializer<'de>, T: Deserialize<'de> + Copy>(
    deserializer: D,
) -> Result<Option<[T; 2]>, D::Error> {
    let expecting = "[along x, along y], or one number for both";
    deserializer.deserialize_any(PairVisitor { expecting, single: |value| [value; 2] })
}

/// `[detection]`: what is measured, and how accurately.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DetectionTable {
    /// Complex samples or real ones.
    pub kind: Detection,
    /// Exact or far-field path lengths.
    pub model: PropagationModel,
    /// Mean signal power over mean noise power, dB; left out: no noise.
    pub snr_db: Option<f64>,
    /// Error allowed to the simulation, relative to the sum of all amplitudes; 0 sums every term.
    pub tolerance: f64,
}

impl Default for DetectionTable {
    fn default() -> Self {
        Self {
            kind: Detection::Quadrature,
            model: PropagationModel::Exact,
            snr_db: None,
            tolerance: SIMULATION_TOLERANCE,
        }
    }
}
