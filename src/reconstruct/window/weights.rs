//! The factors that turn `m(f, r)` into the summands of Eq. 13.

use crate::acquisition::Instrument;
use crate::reconstruct::Window;
use crate::wave::simd::LANES;
use num_complex::Complex32;

/// Window weights with the normalisation folded in, that of several transmissions too.
#[derive(Debug, Clone)]
pub(crate) struct Weights {
    /// Per frequency; holds the normalisation and w as well.
    pub(crate) frequency: Vec<f32>,
    /// Per microphone, mean 1.
    pub(crate) microphone: Vec<f32>,
}

impl Weights {
    pub(crate) fn new(instrument: &Instrument, window: Window) -> Self {
        let frequency = window.over_sweep(&instrument.sweep);
        // Pairs that differ are weighed by where they are seen from.
        let microphone = if instrument.has_differing_pairs() {
            window.over_array(&instrument.equivalent().array)
        } else {
            window.over_array(&instrument.array)
        };
        let (sum_f, sum_r) = (frequency.iter().sum::<f64>(), microphone.iter().sum::<f64>());
        let mean_r = sum_r / microphone.len() as f64;
        let samples = (instrument.transmissions() * microphone.len()) as f64;
        let scale = instrument.detection.weight() / (sum_f * samples);
        Self {
            frequency: frequency.iter().map(|w| (w * scale) as f32).collect(),
            microphone: microphone.iter().map(|w| (w / mean_r) as f32).collect(),
        }
    }

    /// The weighted samples of frequency `f`, from its samples `[n_mic]`.
    pub(crate) fn weighted<'a>(
        &'a self,
        f: usize,
        samples: &'a [Complex32],
    ) -> impl Iterator<Item = Complex32> + 'a {
        let of_frequency = self.frequency[f];
        samples.iter().zip(&self.microphone).map(move |(m, w)| m * (w * of_frequency))
    }

    /// `Σ_r |w m|` of frequency `f`. Its sum over all frequencies is one unit of relative error in the volume.
    pub(crate) fn modulus(&self, f: usize, samples: &[Complex32]) -> f64 {
        // By squares, which in f64 neither overflow nor vanish.
        self.sum(samples, |square, w| square.sqrt() * w.abs()) * f64::from(self.frequency[f].abs())
    }

    /// `Σ_r |w m|²` of frequency `f`.
    pub(crate) fn power(&self, f: usize, samples: &[Complex32]) -> f64 {
        self.sum(samples, |square, w| square * w * w) * f64::from(self.frequency[f]).powi(2)
    }

    /// The sum of `of(|m|², w_r)` over the microphones, in as many sums as the processor takes at once.
    fn sum(&self, samples: &[Complex32], of: impl Fn(f64, f64) -> f64) -> f64 {
        let mut sums = [0.0; LANES];
        for (samples, weights) in samples.chunks(LANES).zip(self.microphone.chunks(LANES)) {
            for ((sum, m), w) in sums.iter_mut().zip(samples).zip(weights) {
                let [re, im, w] = [m.re, m.im, *w].map(f64::from);
                *sum += of(re * re + im * im, w);
            }
        }
        sums.iter().sum()
    }
}
