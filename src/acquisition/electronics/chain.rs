//! From the response of an echo to what is read: coefficients for each tone and harmonic.
//!
//! The generator's sine is `sin ωt`, counted from the beginning of the tone. Its amplifier adds harmonics, and the received
//! signal is `r(t) = Σ_j Im X_j e^{ijωt}` with `X_j = c_j H(jf) M*(jf)`: the phases of a cube grow with the path, those of a
//! signal fall. The mixers' references are g₁ and g₂, a quarter of a period before it, and the reading is
//! `m = I − iQ` with `I = Im X J₁`, `Q = Im X J₂` and the [integrals](super::mixing) J of `e^{ijωt} g(t)`. So
//! `m = α M + β M*`; ideally α = 1 and β = 0.
//!
//! A room that follows the steps with a time constant τ has `1 − e^{−t/τ}` of the tone, and `e^{−t/τ}` of the one before.

use super::mixing::{FilterWindow, MixerReference};
use super::{Electronics, Mixer, OutputFilter};
use crate::acquisition::{Detection, Instrument, Sweep};
use crate::error::Result;
use num_complex::Complex64;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// One simulation of the echoes, and what of it is read.
#[derive(Debug)]
pub(super) struct EchoResponse {
    /// Its frequencies.
    pub(super) sweep: Sweep,
    /// Its multiple of the tones.
    pub(super) harmonic: usize,
    /// By pass: what is read at each tone.
    pub(super) readings: Vec<(usize, Vec<ToneReading>)>,
}

impl EchoResponse {
    /// The instrument of this simulation: with both phases, at the frequencies that are heard.
    pub(super) fn instrument(&self, of: &Instrument) -> Instrument {
        of.clone().with_sweep(self.sweep.clone()).with_detection(Detection::Quadrature)
    }
}

/// `α` and `β` of a tone, and those of the tone before it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ToneReading {
    pub(super) own: [Complex64; 2],
    pub(super) before: [Complex64; 2],
}

/// Which of the phases a pass reads.
#[derive(Debug, Clone, Copy)]
struct Phases {
    in_phase: bool,
    quadrature: bool,
}

impl Electronics {
    /// Multiples of the tones that are received, 1 first.
    fn harmonics(&self) -> Vec<usize> {
        // An endless mean knows nothing of harmonics that the reference lacks.
        let heard = |j: &usize| {
            self.filter != OutputFilter::Ideal || (self.mixer == Mixer::Switch && j % 2 == 1) || *j == 1
        };
        (1..self.harmonics_db.len() + 2).filter(heard).collect()
    }

    /// See [`SimulateOptions::simulations`](crate::acquisition::SimulateOptions::simulations).
    pub(super) fn simulations(&self, instrument: &Instrument) -> usize {
        self.harmonics().len() * if self.clock_drift == 0.0 { 1 } else { self.passes(instrument) }
    }

    /// The simulations that are needed, in order, with what is read of them.
    pub(super) fn responses(&self, instrument: &Instrument) -> Result<Vec<EchoResponse>> {
        let passes = self.passes(instrument);
        let mut responses: Vec<EchoResponse> = Vec::new();
        for pass in 0..passes {
            let phases = Phases {
                in_phase: pass == 0,
                quadrature: instrument.detection == Detection::Quadrature && pass + 1 == passes,
            };
            let tones = self.sweep(instrument, pass, 1)?;
            for harmonic in self.harmonics() {
                let sweep = self.sweep(instrument, pass, harmonic)?;
                let read = (pass, self.read(&tones, harmonic, phases));
                match responses.iter_mut().find(|there| there.harmonic == harmonic && there.sweep == sweep) {
                    Some(there) => there.readings.push(read),
                    None => responses.push(EchoResponse { sweep, harmonic, readings: vec![read] }),
                }
            }
        }
        Ok(responses)
    }

    /// What is read of a harmonic at each tone, whose frequencies are the generator's own.
    fn read(&self, tones: &Sweep, harmonic: usize, phases: Phases) -> Vec<ToneReading> {
        let frequencies = tones.frequencies();
        (0..frequencies.len())
            .map(|n| {
                let f = frequencies[n];
                let before = n.checked_sub(1).map(|n| frequencies[n]);
                ToneReading {
                    own: self.coefficients(harmonic, [f, f], phases, false),
                    before: match before {
                        Some(last) if self.decay > 0.0 => {
                            self.coefficients(harmonic, [f, last], phases, true)
                        }
                        _ => [Complex64::ZERO; 2],
                    },
                }
            })
            .collect()
    }

    /// α and β for a reference of one frequency and a signal of another, which is that of the tone before, if it falls.
    fn coefficients(
        &self,
        harmonic: usize,
        [reference, signal]: [f64; 2],
        phases: Phases,
        falls: bool,
    ) -> [Complex64; 2] {
        let gain = self.heard(harmonic, signal);
        let offset = FRAC_PI_2 + self.quadrature_error.to_radians();
        let mixed = |wanted: bool, phase: f64| {
            let reference =
                MixerReference { omega: TAU * reference, phase, square: self.mixer == Mixer::Switch };
            if wanted { self.mixed(&reference, harmonic, TAU * signal, falls) } else { Complex64::ZERO }
        };
        let (j1, j2) = (mixed(phases.in_phase, 0.0), mixed(phases.quadrature, offset));
        let half = Complex64::new(0.0, -0.5);
        let i = Complex64::I;
        [-half * gain.conj() * (j1.conj() - i * j2.conj()), half * gain * (j1 - i * j2)]
    }

    /// J for a wave `e^{ijωt}` that rises, or falls.
    fn mixed(&self, reference: &MixerReference, harmonic: usize, omega: f64, falls: bool) -> Complex64 {
        let j = harmonic as f64;
        let dwell = self.dwell.unwrap_or(1.0);
        let window = match self.filter {
            OutputFilter::Ideal => {
                // The mean of sin(k(ωt + φ)) e^{ijωt} is i/2 e^{−ijφ} for k = j.
                let received = harmonic == 1 || (reference.square && harmonic % 2 == 1);
                let mean = Complex64::I * Complex64::cis(-j * reference.phase) / j;
                return if received { mean } else { Complex64::ZERO };
            }
            OutputFilter::Integration => FilterWindow { times: [self.settling, dwell], decay: 0.0 },
            OutputFilter::LowPass => FilterWindow { times: [0.0, dwell], decay: TAU * self.low_pass },
        };
        let wave = Complex64::new(0.0, j * omega);
        if falls {
            // It began a tone earlier.
            let turned = Complex64::cis((j * omega * dwell).rem_euclid(TAU));
            return turned * window.mixed(reference, wave - 1.0 / self.decay);
        }
        let settled = window.mixed(reference, wave);
        if self.decay > 0.0 { settled - window.mixed(reference, wave - 1.0 / self.decay) } else { settled }
    }

    /// `c_j H(jf)`: what the microphones hear of a harmonic of a tone, of an echo that changes nothing.
    pub(super) fn heard(&self, harmonic: usize, tone: f64) -> Complex64 {
        self.emitted(harmonic) * self.gain(harmonic as f64 * tone)
    }

    /// `c_j`: what the amplifier makes of `sin ωt`. Chebyshev's polynomials of a sine are `s sin jωt` of odd j and
    /// `s cos jωt` of even j, with the signs of `sin jπ/2` and `cos jπ/2`.
    fn emitted(&self, harmonic: usize) -> Complex64 {
        if harmonic == 1 {
            return Complex64::ONE;
        }
        let level = 10_f64.powf(self.harmonics_db[harmonic - 2] / 20.0);
        let sign = if (harmonic / 2) % 2 == 1 { -level } else { level };
        if harmonic % 2 == 1 { sign.into() } else { Complex64::new(0.0, sign) }
    }

    /// H: what amplifier and microphone leave of a frequency, with the phase of a signal.
    fn gain(&self, frequency: f64) -> Complex64 {
        let band = |[low, high]: [f64; 2]| {
            let lower = Complex64::ONE / Complex64::new(1.0, -low / frequency);
            lower / Complex64::new(1.0, frequency / high)
        };
        [self.amplifier_band, self.microphone_band].into_iter().flatten().map(band).product()
    }

    /// What is left of a reading when the next is taken: a low-pass filter remembers.
    pub(super) fn memory(&self) -> f64 {
        match self.filter {
            OutputFilter::LowPass => (-2.0 * PI * self.low_pass * self.dwell.unwrap_or(0.0)).exp(),
            OutputFilter::Ideal | OutputFilter::Integration => 0.0,
        }
    }
}
