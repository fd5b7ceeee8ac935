//! `[instrument]`: what the electronics of a simulated measurement are not ideal in.

use crate::acquisition::{Mixer, OutputFilter, QuadratureBy};
use serde::{Deserialize, Serialize};

/// `[instrument]`: generator, amplifier, microphone, mixer, filter and converter; ideal unless typed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InstrumentTable {
    /// Lower and upper corner of the amplifier, Hz.
    pub amplifier_band: Option<[f64; 2]>,
    /// Its 2nd, 3rd, ... harmonic, dB relative to the fundamental.
    pub harmonics_db: Vec<f64>,
    /// Lower and upper corner of the microphone, Hz.
    pub microphone_band: Option<[f64; 2]>,
    /// A sine or a switch.
    pub mixer: Mixer,
    /// A second mixer, or a second pass.
    pub quadrature: QuadratureBy,
    /// Of the second phase, degrees.
    pub quadrature_error: f64,
    /// Behind the mixer.
    pub filter: OutputFilter,
    /// Corner of the low-pass filter, Hz.
    pub low_pass: Option<f64>,
    /// Time constant with which the room follows the tones, s.
    pub decay: f64,
    /// Of readings, rms, s.
    pub jitter: f64,
    /// Of the generator's frequency, 10⁻⁶.
    pub clock_error: f64,
    /// Its change, 10⁻⁶ per s.
    pub clock_drift: f64,
    /// Bits of the converter.
    pub adc_bits: Option<u32>,
    /// Amplitude at which it is cut off; left out: the largest of the cube.
    pub adc_full_scale: Option<f64>,
    /// Seed of the jitter alone.
    pub seed: u32,
}

impl InstrumentTable {
    /// Whether nothing of it was typed.
    pub(in crate::config) fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

impl Default for InstrumentTable {
    fn default() -> Self {
        Self {
            amplifier_band: None,
            harmonics_db: Vec::new(),
            microphone_band: None,
            mixer: Mixer::Sine,
            quadrature: QuadratureBy::Mixers,
            quadrature_error: 0.0,
            filter: OutputFilter::Ideal,
            low_pass: None,
            decay: 0.0,
            jitter: 0.0,
            clock_error: 0.0,
            clock_drift: 0.0,
            adc_bits: None,
            adc_full_scale: None,
            seed: 1,
        }
    }
}
