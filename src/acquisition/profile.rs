//! Range profiles: the inverse transform of a microphone's samples over the frequencies (Eqs. 3 and 4), and its peaks.
//!
//! `P(d) = Σ_f w_f m(f) e^{−i2π(f−f₀)d/c} / Σ_f w_f` over path lengths d, whose modulus does not depend on f₀. Evenly spaced
//! frequencies are transformed by an FFT, padded with zeros; others term by term.

use super::Instrument;
use crate::wave::interval::phasor_f64;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;
use rustfft::{Fft, FftPlanner};
use serde::Serialize;
use std::sync::Arc;

/// A peak of a range profile.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ProfilePeak {
    /// Half of its path, m: as seen from the middle of speaker and microphones, about the range.
    pub range: f64,
    /// Its power, dB.
    pub level_db: f64,
}

/// The length of path after which profiles repeat, c/δf, m; of uneven frequencies that of their mean distance.
pub(super) fn unambiguous_path(instrument: &Instrument) -> f64 {
    // The band rather than the step: rounded steps add up.
    instrument.sound_speed * (instrument.sweep.len() - 1) as f64 / instrument.sweep.bandwidth()
}

/// The transform of samples over the frequencies of a sweep.
pub(crate) struct SweepTransform {
    /// Weights of the frequencies, of sum 1.
    weights: Vec<f64>,
    /// The padded transform; `None` of uneven frequencies.
    fft: Option<Arc<dyn Fft<f64>>>,
    /// f − f₀ in cycles per m of path.
    waves: Vec<f64>,
    /// Values of a profile, over the unambiguous path.
    pub(crate) len: usize,
    /// From one value to the next, m of path; the first is at 0.
    pub(crate) pitch: f64,
}

impl SweepTransform {
    /// For `finer` values of a profile for each frequency, and one weight for each.
    pub(crate) fn new(instrument: &Instrument, weights: &[f64], finer: usize) -> Self {
        let sweep = &instrument.sweep;
        let len = sweep.len() * finer;
        let scale = 1.0 / weights.iter().sum::<f64>();
        Self {
            weights: weights.iter().map(|w| w * scale).collect(),
            fft: sweep.step().map(|_| FftPlanner::new().plan_fft_forward(len)),
            waves: sweep.frequencies().iter().map(|f| (f - sweep.start()) / instrument.sound_speed).collect(),
            len,
            pitch: unambiguous_path(instrument) / len as f64,
        }
    }

    /// The profile of one microphone's samples.
    pub(crate) fn of(&self, column: &[Complex32]) -> Vec<Complex64> {
        let Some(fft) = &self.fft else { return self.literal(column) };
        let mut profile = Vec::with_capacity(self.len);
        profile.extend(column.iter().zip(&self.weights).map(|(m, w)| widened(*m) * w));
        profile.resize(self.len, Complex64::ZERO);
        fft.process(&mut profile);
        profile
    }

    /// The mean over microphones of the power of their profiles; `columns` are `[microphone, n_f]`.
    pub(super) fn mean_power(&self, columns: &[Complex32]) -> Vec<f64> {
        let n_f = self.weights.len();
        let mut power = vec![0.0; self.len];
        for column in columns.chunks_exact(n_f) {
            let profile = self.of(column);
            power.iter_mut().zip(&profile).for_each(|(sum, value)| *sum += value.norm_sqr());
        }
        let count = (columns.len() / n_f) as f64;
        for sum in &mut power {
            *sum /= count;
        }
        power
    }

    /// The profile term by term, for any frequencies: the oracle of the FFT. Cost: 60 operations per value and frequency.
    pub(super) fn literal(&self, column: &[Complex32]) -> Vec<Complex64> {
        let at = |k: usize| {
            let path = self.pitch * k as f64;
            let terms = column.iter().zip(&self.weights).zip(&self.waves);
            terms.map(|((m, w), wave)| widened(*m) * phasor_f64(-(wave * path)) * w).sum()
        };
        (0..self.len).into_par_iter().map(at).collect()
    }

    /// The moduli of the transform of the weights themselves: what a unit echo leaves at distances of so many values.
    pub(super) fn sidelobes(&self) -> Vec<f64> {
        self.of(&vec![Complex32::ONE; self.weights.len()]).iter().map(|value| value.norm()).collect()
    }
}

fn widened(m: Complex32) -> Complex64 {
    Complex64::new(m.re.into(), m.im.into())
}

/// 10 log₁₀ of a ratio of powers, dB; `None` unless it is a finite number.
pub(super) fn decibels(power: f64) -> Option<f64> {
    Some(10.0 * power.log10()).filter(|db| db.is_finite())
}

/// The local maxima of a profile's power above a level, strongest first, with their places between the values; `pitch` is
/// from one value to the next, m of range.
pub(super) fn local_maxima(power: &[f64], pitch: f64, floor_db: f64) -> Vec<ProfilePeak> {
    let level = |k: usize| decibels(power[k]).unwrap_or(f64::NEG_INFINITY);
    let mut peaks: Vec<ProfilePeak> = (0..power.len())
        .filter_map(|k| {
            let before = k.checked_sub(1).map_or(f64::NEG_INFINITY, level);
            let after = if k + 1 < power.len() { level(k + 1) } else { f64::NEG_INFINITY };
            let here = level(k);
            (here > before && here >= after && here > floor_db).then(|| {
                // The top of the parabola through three levels; exact for a Gaussian.
                let bend = 2.0 * here - before - after;
                let offset = if bend.is_finite() { 0.5 * (after - before) / bend } else { 0.0 };
                let rise = if bend.is_finite() { 0.25 * (after - before) * offset } else { 0.0 };
                ProfilePeak { range: (k as f64 + offset) * pitch, level_db: here + rise }
            })
        })
        .collect();
    peaks.sort_by(|a, b| b.level_db.total_cmp(&a.level_db));
    peaks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquisition::{MicArray, Sweep};
    use glam::DVec3;

    /// Numbers that look random, within ±1.
    fn random(count: usize) -> Vec<Complex32> {
        let mut state = 7_u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 8_388_608.0 - 1.0
        };
        (0..count).map(|_| Complex32::new(next(), next())).collect()
    }

    #[test]
    fn the_padded_transform_is_the_literal_sum() {
        let mics = MicArray::from_positions(vec![DVec3::ZERO]).expect("one");
        for (start, step, count, finer) in [(10e3, 100.0, 41_u32, 8), (1e3, 7.5, 16, 1), (18e3, 2.0, 30, 3)] {
            let stop = start + f64::from(count - 1) * step;
            let sweep = Sweep::stepped(start, stop, step).expect("even");
            let instrument = Instrument::new(sweep, mics.clone());
            let weights: Vec<f64> = (0..count).map(|n| 1.0 + f64::from(n % 5)).collect();
            let transform = SweepTransform::new(&instrument, &weights, finer);
            let column = random(count as usize);
            let (fast, literal) = (transform.of(&column), transform.literal(&column));
            assert_eq!(fast.len(), count as usize * finer);
            for (k, (a, b)) in fast.iter().zip(&literal).enumerate() {
                assert!((a - b).norm() < 1e-10, "{k}: {a} {b}");
            }
        }
    }
}
