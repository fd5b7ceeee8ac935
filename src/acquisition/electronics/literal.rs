//! The waveforms themselves, sampled finely, multiplied and filtered: the oracle of the closed forms.

use super::{Electronics, Mixer, OutputFilter};
use num_complex::Complex64;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Echoes by path: how late they are, in samples, and their amplitudes.
pub(super) type LateEchoes = [(usize, f64)];

/// Simulates the waveforms of some tones with `rate` samples per second.
pub(super) struct Waveforms<'a> {
    pub(super) electronics: &'a Electronics,
    pub(super) rate: f64,
    pub(super) echoes: &'a LateEchoes,
}

impl Waveforms<'_> {
    /// The readings of tones of these frequencies; with two passes those of the second may differ.
    pub(super) fn readings(&self, tones: [&[f64]; 2]) -> Vec<Complex64> {
        let [i, q] = [0.0, FRAC_PI_2 + self.electronics.quadrature_error.to_radians()];
        let (first, second) = (self.mixed(tones[0], i), self.mixed(tones[1], q));
        first.iter().zip(second).map(|(i, q)| Complex64::new(*i, -q)).collect()
    }

    /// What is read behind a mixer whose reference has this phase.
    fn mixed(&self, tones: &[f64], phase: f64) -> Vec<f64> {
        let Electronics { filter, settling, decay, low_pass, .. } = *self.electronics;
        let dwell = self.electronics.dwell.expect("tones have a length");
        let count = (dwell * self.rate).round() as usize;
        let rate = TAU * low_pass / self.rate;
        let (mut state, mut before) = (0.0, Vec::new());
        let mut read = Vec::new();
        for f in tones {
            let sent = self.sent(*f, 2 * count);
            let (mut sum, mut summed) = (0.0, 0);
            for k in 0..count {
                let t = (k as f64 + 0.5) / self.rate;
                let left = if decay > 0.0 { (-t / decay).exp() } else { 0.0 };
                let mut heard = self.heard(&sent, k) * (1.0 - left);
                if !before.is_empty() {
                    heard += self.heard(&before, count + k) * left;
                }
                let sine = (TAU * f * t + phase).sin();
                let reference = match self.electronics.mixer {
                    Mixer::Sine => 2.0 * sine,
                    Mixer::Switch => FRAC_PI_2 * sine.signum(),
                };
                state += (heard * reference - state) * rate;
                if t >= settling {
                    sum += heard * reference;
                    summed += 1;
                }
            }
            read.push(if filter == OutputFilter::LowPass { state } else { sum / f64::from(summed) });
            before = sent;
        }
        read
    }

    /// Sample k after the beginning of a tone, of all echoes.
    fn heard(&self, sent: &[f64], k: usize) -> f64 {
        let lead = self.lead();
        self.echoes.iter().map(|(late, amplitude)| amplitude * sent[lead + k - late]).sum()
    }

    /// Samples before the beginning of a tone that echoes still bring.
    fn lead(&self) -> usize {
        self.echoes.iter().map(|(late, _)| *late).max().unwrap_or(0)
    }

    /// A tone as amplifier and microphone leave it, as if it had begun long ago: from [`Waveforms::lead`] samples before its
    /// beginning on.
    fn sent(&self, frequency: f64, count: usize) -> Vec<f64> {
        let corners: Vec<[f64; 2]> = [self.electronics.amplifier_band, self.electronics.microphone_band]
            .into_iter()
            .flatten()
            .collect();
        let slowest = corners.iter().flatten().filter(|f| **f > 0.0).fold(f64::INFINITY, |a, b| a.min(*b));
        let warming = if slowest.is_finite() { (12.0 / (TAU * slowest) * self.rate) as usize } else { 0 };
        let begin = self.lead() + warming;
        let mut states = vec![[0.0; 2]; corners.len()];
        let mut wave = Vec::with_capacity(begin + count);
        for k in 0..begin + count {
            let t = (k as f64 + 0.5 - begin as f64) / self.rate;
            let mut value = self.amplified((TAU * frequency * t).sin());
            for ([low, high], [below, passed]) in corners.iter().zip(&mut states) {
                // What is below the lower corner is taken away, and what is above the upper one smoothed.
                *below += (value - *below) * (1.0 - (-TAU * low / self.rate).exp());
                *passed += (value - *below - *passed) * (1.0 - (-TAU * high / self.rate).exp());
                value = *passed;
            }
            wave.push(value);
        }
        wave.split_off(warming)
    }

    /// The amplifier's curve, by the recurrence of Chebyshev's polynomials.
    fn amplified(&self, x: f64) -> f64 {
        let (mut last, mut here, mut sum) = (1.0, x, x);
        for level in &self.electronics.harmonics_db {
            (last, here) = (here, 2.0 * x * here - last);
            sum += 10_f64.powf(level / 20.0) * here;
        }
        sum
    }
}
