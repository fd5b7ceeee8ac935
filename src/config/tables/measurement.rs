//! What it is measured with.

use crate::acquisition::SIMULATION_TOLERANCE;
use crate::config::choices::{DetectionKind, Geometry, InputFile, Layout, Model};
use crate::wave::DEFAULT_SOUND_SPEED;
use serde::{Deserialize, Serialize};

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
    pub(in crate::config) const PITCH: [f64; 2] = [0.016, 0.016];

    /// The defaults before it is known whether `pitch` or `extent` was typed.
    pub(in crate::config) fn before_filling() -> Self {
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
