//! The electronics of the measurement, beyond the ideal mixer of Eqs. 1 to 3: generator, amplifier, microphone, switching
//! mixer, low-pass filter or integrator, converter.
//!
//! Of a stepped tone all of them but the converter are linear in the echo's response, so that they need no time signal: what
//! is read at a tone is `Σ_j α_j M(jf) + β_j M*(jf)`, with the responses M of Eq. 5 at the tone and at its harmonics, and
//! coefficients in closed form ([`chain`]). Jitter turns the phases of the readings, and the converter rounds them
//! ([`readings`]). A recording has what is before the mixer ([`heard`]), and a converter of its own instead of the mixer. A
//! literal simulation of the waveforms is the oracle of the tests.

mod chain;
mod heard;
#[cfg(test)]
mod literal;
mod mixing;
mod readings;
#[cfg(test)]
mod tests;

pub(super) use heard::settled;
pub(crate) use heard::{HeardTones, simulate_heard};
pub(super) use readings::{Converter, convert};

use super::{Detection, Instrument, SimulateOptions, Sweep};
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::with_fields::with_fields;

choice! {
    /// What multiplies the microphone's signal.
    pub enum Mixer: "mixer" {
        /// The generator's sine (Eq. 2).
        Sine = "sine",
        /// A switch that the generator closes and opens: a square wave, whose odd harmonics 3, 5, 7, ... receive those of the
        /// signal with a third, a fifth, a seventh.
        Switch = "switch",
    }
}

choice! {
    /// How both phases are had.
    pub enum QuadratureBy: "quadrature" {
        /// By a second mixer, at the same time.
        Mixers = "mixers",
        /// By a second pass of the sweep, after the first.
        Passes = "passes",
    }
}

choice! {
    /// What is behind the mixer.
    pub enum OutputFilter: "filter" {
        /// An integral over a time without end: the mixer's mean.
        Ideal = "ideal",
        /// An integral over what is left of each tone after its settling.
        Integration = "integration",
        /// A low-pass filter of first order, read at the end of each tone.
        LowPass = "low-pass",
    }
}

choice! {
    /// What an instrument is not ideal in; a row of its budget each.
    pub enum InstrumentElement: "element" {
        /// Corners of the amplifier.
        AmplifierBand = "amplifier band",
        /// Harmonics of the amplifier, as the mixer receives them.
        Distortion = "distortion",
        /// Corners of the microphone.
        MicrophoneBand = "microphone band",
        /// Integration or low-pass of finite length, behind the mixer.
        Filter = "filter",
        /// The two phases are not a quarter of a period apart.
        QuadratureError = "quadrature error",
        /// The room follows the steps with a time constant.
        Settling = "settling",
        /// Readings come at random times.
        Jitter = "jitter",
        /// The generator's frequency is wrong, and drifts.
        Clock = "clock",
        /// Readings are rounded and cut off.
        Converter = "converter",
    }
}

/// What the electronics do; by default nothing.
///
/// ```
/// use holosonar::acquisition::{Electronics, Mixer};
///
/// let ideal = Electronics::default();
/// let paper = ideal.clone().with_mixer(Mixer::Switch).with_harmonics_db(vec![-60.0, -40.0]);
/// assert!(ideal.elements().is_empty() && !paper.elements().is_empty());
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Electronics {
    /// Lower and upper corner of the amplifier that drives the speaker, each of first order, Hz.
    pub amplifier_band: Option<[f64; 2]>,
    /// The amplifier's 2nd, 3rd, ... harmonic at full amplitude, relative to the fundamental, dB: its curve is
    /// `x + Σ d_k T_k(x)`, with Chebyshev's polynomials.
    pub harmonics_db: Vec<f64>,
    /// Corners of the microphone and its amplifier, likewise.
    pub microphone_band: Option<[f64; 2]>,
    /// What multiplies the signal.
    pub mixer: Mixer,
    /// How both phases are had.
    pub quadrature: QuadratureBy,
    /// By how much the second phase is more than a quarter of a period from the first, degrees.
    pub quadrature_error: f64,
    /// What is behind the mixer.
    pub filter: OutputFilter,
    /// Corner of the low-pass filter, Hz.
    pub low_pass: f64,
    /// How long each tone sounds, s; needed by filters, settling and drift.
    pub dwell: Option<f64>,
    /// What is dropped at the beginning of each before it is integrated, s.
    pub settling: f64,
    /// Time constant with which the room follows the steps, s; 0: at once.
    pub decay: f64,
    /// Random times between generator and reading, rms, s.
    pub jitter: f64,
    /// Relative error of the generator's frequency, 10⁻⁶.
    pub clock_error: f64,
    /// By how much that grows, 10⁻⁶ per s.
    pub clock_drift: f64,
    /// Bits of the converter.
    pub adc_bits: Option<u32>,
    /// Amplitude at which it is cut off; `None`: the largest reading of the cube.
    pub adc_full_scale: Option<f64>,
    /// Seed of the jitter alone.
    pub seed: u64,
}

with_fields! {
    Electronics {
        with_amplifier_band(amplifier_band: Option<[f64; 2]>),
        with_harmonics_db(harmonics_db: Vec<f64>),
        with_microphone_band(microphone_band: Option<[f64; 2]>),
        with_mixer(mixer: Mixer),
        with_quadrature(quadrature: QuadratureBy),
        with_quadrature_error(quadrature_error: f64),
        with_filter(filter: OutputFilter),
        with_low_pass(low_pass: f64),
        with_dwell(dwell: Option<f64>),
        with_settling(settling: f64),
        with_decay(decay: f64),
        with_jitter(jitter: f64),
        with_clock_error(clock_error: f64),
        with_clock_drift(clock_drift: f64),
        with_adc_bits(adc_bits: Option<u32>),
        with_adc_full_scale(adc_full_scale: Option<f64>),
        with_seed(seed: u64),
    }
}

impl Default for Electronics {
    /// Ideal ones.
    fn default() -> Self {
        Self {
            amplifier_band: None,
            harmonics_db: Vec::new(),
            microphone_band: None,
            mixer: Mixer::Sine,
            quadrature: QuadratureBy::Mixers,
            quadrature_error: 0.0,
            filter: OutputFilter::Ideal,
            low_pass: 10.0,
            dwell: None,
            settling: 0.0,
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

/// Most harmonics of an amplifier.
pub(crate) const MOST_HARMONICS: usize = 16;

impl Electronics {
    /// What is not ideal in them.
    pub fn elements(&self) -> Vec<InstrumentElement> {
        InstrumentElement::ALL.iter().copied().filter(|element| self.has(*element)).collect()
    }

    fn has(&self, element: InstrumentElement) -> bool {
        match element {
            InstrumentElement::AmplifierBand => self.amplifier_band.is_some(),
            InstrumentElement::Distortion => !self.harmonics_db.is_empty(),
            InstrumentElement::MicrophoneBand => self.microphone_band.is_some(),
            InstrumentElement::Filter => self.filter != OutputFilter::Ideal,
            InstrumentElement::QuadratureError => self.quadrature_error != 0.0,
            InstrumentElement::Settling => self.decay > 0.0,
            InstrumentElement::Jitter => self.jitter > 0.0,
            InstrumentElement::Clock => self.clock_error != 0.0 || self.clock_drift != 0.0,
            InstrumentElement::Converter => self.adc_bits.is_some() || self.adc_full_scale.is_some(),
        }
    }

    /// Electronics that are ideal but for one element, and what it depends on: the mixer decides what distortion and filters
    /// do, and the filter what settling does.
    #[must_use]
    pub fn only(&self, element: InstrumentElement) -> Self {
        let ideal = Self { dwell: self.dwell, settling: self.settling, seed: self.seed, ..Self::default() };
        let mixed = Self { mixer: self.mixer, ..ideal.clone() };
        let filtered = Self { filter: self.filter, low_pass: self.low_pass, ..mixed.clone() };
        match element {
            InstrumentElement::AmplifierBand => Self { amplifier_band: self.amplifier_band, ..ideal },
            InstrumentElement::Distortion => Self { harmonics_db: self.harmonics_db.clone(), ..mixed },
            InstrumentElement::MicrophoneBand => Self { microphone_band: self.microphone_band, ..ideal },
            InstrumentElement::Filter => filtered,
            InstrumentElement::QuadratureError => Self { quadrature_error: self.quadrature_error, ..ideal },
            InstrumentElement::Settling => Self { decay: self.decay, ..filtered },
            InstrumentElement::Jitter => Self { jitter: self.jitter, quadrature: self.quadrature, ..ideal },
            InstrumentElement::Clock => Self {
                clock_error: self.clock_error,
                clock_drift: self.clock_drift,
                quadrature: self.quadrature,
                ..ideal
            },
            InstrumentElement::Converter => {
                Self { adc_bits: self.adc_bits, adc_full_scale: self.adc_full_scale, ..ideal }
            }
        }
    }

    /// What is not ideal, in words, one line each.
    pub(crate) fn physics(&self) -> Vec<String> {
        let band = |[low, high]: [f64; 2]| format!("from {low} to {high} Hz, first order");
        let line = |element: InstrumentElement| match element {
            InstrumentElement::AmplifierBand => self
                .amplifier_band
                .map_or_else(String::new, |corners| format!("an amplifier {}", band(corners))),
            InstrumentElement::Distortion => {
                let levels: Vec<String> = self.harmonics_db.iter().map(ToString::to_string).collect();
                format!(
                    "its harmonics 2, 3, ... at {} dB, received by a {} mixer",
                    levels.join(", "),
                    self.mixer
                )
            }
            InstrumentElement::MicrophoneBand => self
                .microphone_band
                .map_or_else(String::new, |corners| format!("microphones {}", band(corners))),
            InstrumentElement::Filter => {
                let dwell = self.dwell.unwrap_or_default();
                match self.filter {
                    OutputFilter::LowPass => {
                        format!("a low-pass filter of {} Hz, read {dwell} s after each step", self.low_pass)
                    }
                    _ => format!("an integral from {} to {dwell} s after each step", self.settling),
                }
            }
            InstrumentElement::QuadratureError => {
                format!("phases that are {} degrees apart", 90.0 + self.quadrature_error)
            }
            InstrumentElement::Settling => {
                format!("a room that follows the steps with a time constant of {} s", self.decay)
            }
            InstrumentElement::Jitter => format!("readings at times that scatter by {:e} s rms", self.jitter),
            InstrumentElement::Clock => {
                format!(
                    "a generator that is {} ppm fast and gains {} ppm per s",
                    self.clock_error, self.clock_drift
                )
            }
            InstrumentElement::Converter => {
                let bits = self
                    .adc_bits
                    .map_or("a converter".to_owned(), |bits| format!("a converter of {bits} bits"));
                match self.adc_full_scale {
                    Some(full) => format!("{bits} that cuts off at {full}"),
                    None => format!("{bits} that the largest reading fills"),
                }
            }
        };
        self.elements().into_iter().map(line).collect()
    }

    /// Rejects numbers that mean nothing, and elements that need to know how long a tone sounds.
    pub(crate) fn check(&self) -> Result<()> {
        let refused = |key: &str, problem: &str| Err(Error::input(format!("[instrument] {key}"), problem));
        let corners = |band: Option<[f64; 2]>| band.is_none_or(|[low, high]| low >= 0.0 && low < high);
        if !corners(self.amplifier_band) || !corners(self.microphone_band) {
            return refused(
                "amplifier_band, microphone_band",
                "were expected to be [lower, upper] corner in Hz",
            );
        }
        if self.harmonics_db.len() > MOST_HARMONICS || self.harmonics_db.iter().any(|db| !db.is_finite()) {
            return refused("harmonics_db", "was expected to be up to 16 levels in dB, as [-60.0, -40.0]");
        }
        let numbers = [self.quadrature_error, self.clock_error, self.clock_drift];
        let amounts = [self.decay, self.jitter, self.settling, self.adc_full_scale.unwrap_or(0.0)];
        if numbers.iter().chain(&amounts).any(|v| !v.is_finite()) || amounts.iter().any(|v| *v < 0.0) {
            return refused("decay, jitter, ...", "were expected to be finite numbers, and times 0 or more");
        }
        if !(self.low_pass > 0.0 && self.low_pass.is_finite()) {
            return refused("low_pass", "was expected to be a corner in Hz, greater than 0");
        }
        if self.adc_bits.is_some_and(|bits| !(1..=24).contains(&bits)) {
            return refused("adc_bits", "was expected to be from 1 to 24");
        }
        if self.decay > 0.0 && self.filter == OutputFilter::Ideal {
            let problem = "needs a filter that is \"integration\" or \"low-pass\": over a time without end everything settles";
            return refused("decay", problem);
        }
        let needs = self.filter != OutputFilter::Ideal || self.clock_drift != 0.0;
        match self.dwell {
            Some(dwell) if dwell > 0.0 && dwell.is_finite() && self.settling < dwell => Ok(()),
            None if !needs => Ok(()),
            _ => {
                let problem = "need to know how long each tone sounds; give [recording] dwell in s, more than its settling";
                refused("filter, clock_drift", problem)
            }
        }
    }

    /// Whether the sweep is measured twice.
    pub(crate) fn passes(&self, instrument: &Instrument) -> usize {
        let complex = instrument.detection == Detection::Quadrature;
        if complex && self.quadrature == QuadratureBy::Passes { 2 } else { 1 }
    }

    /// The frequencies that the generator has in a pass, times a harmonic.
    pub(super) fn sweep(&self, instrument: &Instrument, pass: usize, harmonic: usize) -> Result<Sweep> {
        if self.clock_error == 0.0 && self.clock_drift == 0.0 && harmonic == 1 {
            return Ok(instrument.sweep.clone());
        }
        let n_f = instrument.sweep.len();
        let actual = |(n, f): (usize, &f64)| {
            let seconds = (pass * n_f + n) as f64 * self.dwell.unwrap_or(0.0);
            harmonic as f64 * f * (1.0 + 1e-6 * (self.clock_error + self.clock_drift * seconds))
        };
        let frequencies = instrument.sweep.frequencies().iter().enumerate().map(actual).collect();
        Sweep::from_frequencies(frequencies)
            .map_err(|error| error.at("[instrument] clock_error, clock_drift"))
    }
}

impl SimulateOptions {
    /// How many times the echoes are simulated: at the tones, at harmonics that are received, and in each pass.
    pub(crate) fn simulations(&self, instrument: &Instrument) -> usize {
        self.electronics.as_ref().map_or(1, |electronics| electronics.simulations(instrument))
    }
}
