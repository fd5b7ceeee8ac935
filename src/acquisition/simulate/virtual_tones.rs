//! Virtual tones: a simulation made at few tones of our own choice, and expanded to all of a sweep.
//!
//! Reflectors whose path lengths lie within T seconds of each other give a cube that, with the delay of the middle
//! taken out, is smooth in f. Q tones about the middle of the band, evenly spaced and reaching a little beyond it, say
//! everything about it: for every |δ| ≤ T/2,
//!
//! `e^{i2π(f_n − f_c)δ} = Σ_q W[n, q] e^{i2πqΔδ} + O(ε)`, q = −K … K.
//!
//! The tones need not be measured ones, so they are equispaced and a phasor recurrence serves. W follows by least
//! squares; since interval and tones are symmetric it is real. It depends on T alone, not on where the interval lies.
//! Its error and its size are measured: too few or too wide tones would make it huge.

use crate::acquisition::Sweep;
use crate::linalg::{LeastSquares, greatest, product, waves};
use crate::wave::interval::{chebyshev_point, greater};
use rayon::prelude::*;

/// Tones and weights that serve every interval of one duration.
#[derive(Debug, Clone)]
pub(super) struct VirtualTones {
    /// f_c, Hz.
    pub(super) centre: f64,
    /// Δ, Hz.
    pub(super) step: f64,
    /// K: tones to each side of the centre.
    pub(super) pairs: usize,
    /// Duration T of the intervals, s.
    pub(super) duration: f64,
    /// W, `[n_f][2K + 1]`, one frequency after another.
    pub(super) weights: Vec<f32>,
}

/// How tones are chosen for a `B·T`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rung {
    /// `B·T`: bandwidth times duration.
    pub(super) spread: f64,
    /// Tones per T⁻¹: the spacing is 1/(oversampling · T).
    pub(super) oversampling: f64,
    /// K that keeps 10⁻⁶.
    pub(super) pairs: usize,
}

/// The standard durations. Short intervals want tones far closer than 1/T, long ones hardly closer: for each, the
/// oversampling with which the fewest tones keep 10⁻⁶ and W stays small.
pub(super) const RUNGS: [Rung; 9] = [
    Rung { spread: 1.0, oversampling: 4.0, pairs: 4 },
    Rung { spread: 2.0, oversampling: 3.0, pairs: 5 },
    Rung { spread: 3.0, oversampling: 2.8, pairs: 6 },
    Rung { spread: 4.0, oversampling: 2.5, pairs: 7 },
    Rung { spread: 6.0, oversampling: 2.0, pairs: 9 },
    Rung { spread: 8.0, oversampling: 1.8, pairs: 10 },
    Rung { spread: 12.0, oversampling: 1.5, pairs: 14 },
    Rung { spread: 16.0, oversampling: 1.4, pairs: 17 },
    Rung { spread: 25.0, oversampling: 1.3, pairs: 23 },
];

/// A greater sum of |W| would let f32 rounding through.
const LARGEST_WEIGHT_SUM: f64 = 30.0;

/// How far from a rung's own K the search may go.
const FEWER: usize = 2;
pub(super) const MORE: usize = 4;

/// Frequencies that the search looks at, and frequencies solved for at a time.
const SAMPLED: usize = 96;
const BLOCK: usize = 1024;

impl VirtualTones {
    /// Tones and weights of a rung that keep `tolerance`; `None` where none of the tried do, as for a single frequency.
    pub(super) fn find(sweep: &Sweep, rung: Rung, tolerance: f64) -> Option<Self> {
        let frequencies = sweep.frequencies();
        let duration = rung.spread / sweep.bandwidth();
        if !(duration.is_finite() && duration > 0.0) {
            return None;
        }
        let last = frequencies.len() - 1;
        let count = SAMPLED.min(frequencies.len());
        let sampled: Vec<f64> =
            (0..count).map(|i| frequencies[i * last / (count - 1).max(1)] - sweep.centre()).collect();
        let mut pairs = rung.pairs.saturating_sub(FEWER).max(1);
        let most = rung.pairs + MORE;
        while pairs <= most {
            let fit = Fit::new(rung.oversampling, duration, pairs);
            if fit.weights(&sampled).keeps(tolerance) {
                let solved = fit.all(frequencies, sweep.centre());
                // Between the sampled frequencies the error may be a little greater.
                if solved.keeps(tolerance) {
                    return Some(Self {
                        centre: sweep.centre(),
                        step: fit.step,
                        pairs,
                        duration,
                        weights: solved.weights,
                    });
                }
            }
            pairs += 1;
        }
        None
    }

    /// Q = 2K + 1.
    pub(super) fn count(&self) -> usize {
        2 * self.pairs + 1
    }
}

/// Weights with their error and size.
#[derive(Debug, Default)]
struct Solved {
    weights: Vec<f32>,
    /// The greatest error of the expansion on the dense grid, relative to one.
    error: f64,
    /// `max_n Σ_q |W[n, q]|`.
    weight_sum: f64,
}

impl Solved {
    /// Written so that NaN fails.
    fn keeps(&self, tolerance: f64) -> bool {
        self.error <= tolerance && self.weight_sum <= LARGEST_WEIGHT_SUM
    }
}

/// Least squares for tones of one spacing and number.
#[derive(Debug)]
struct Fit {
    /// Δ, Hz.
    step: f64,
    pairs: usize,
    /// Delays to fit on and to check on, s; by symmetry the positive half serves.
    nodes: Vec<f64>,
    dense: Vec<f64>,
}

impl Fit {
    fn new(oversampling: f64, duration: f64, pairs: usize) -> Self {
        let spread = 2.0 * pairs as f64 / oversampling;
        let points = (1.1 * spread).ceil() as usize + 18;
        let node = |k: usize| 0.5 * duration * chebyshev_point(k, 2 * points);
        let even = |k: usize| 0.5 * duration * k as f64 / (3 * points - 1) as f64;
        Self {
            step: 1.0 / (oversampling * duration),
            pairs,
            nodes: (0..points).map(node).collect(),
            dense: (0..3 * points).map(even).collect(),
        }
    }

    /// Weights for frequencies counted from the centre.
    fn weights(&self, frequencies: &[f64]) -> Solved {
        let pairs = self.pairs as i32;
        let tones: Vec<f64> = (-pairs..=pairs).map(|q| f64::from(q) * self.step).collect();
        let weights = LeastSquares::new(&waves(&self.nodes, &tones)).solve(&waves(&self.nodes, frequencies));
        let residual = waves(&self.dense, frequencies) - product(&waves(&self.dense, &tones), &weights);
        let mut solved = Solved { error: greatest(&residual), ..Solved::default() };
        for column in 0..frequencies.len() {
            let w = weights.col_as_slice(column);
            solved.weight_sum = greater(w.iter().map(|w| w.abs()).sum(), solved.weight_sum);
            solved.weights.extend(w.iter().map(|w| *w as f32));
        }
        solved
    }

    /// Weights for all frequencies of a sweep, some at a time.
    fn all(&self, frequencies: &[f64], centre: f64) -> Solved {
        let parts: Vec<Solved> = frequencies
            .par_chunks(BLOCK)
            .map(|some| self.weights(&some.iter().map(|f| f - centre).collect::<Vec<_>>()))
            .collect();
        parts.into_iter().fold(Solved::default(), |mut all, part| {
            all.weights.extend(part.weights);
            all.error = greater(part.error, all.error);
            all.weight_sum = greater(part.weight_sum, all.weight_sum);
            all
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn sweeps() -> [Sweep; 3] {
        let even = Sweep::stepped(10_000.0, 20_000.0, 10.0).expect("ok");
        let uneven: Vec<f64> =
            (0..500).map(|n| 18_000.0 + 4.0 * f64::from(n) + f64::from(n % 7) / 3.0).collect();
        let gaps = vec![5_000.0, 5_100.0, 5_900.0, 7_000.0, 7_001.0];
        [
            even,
            Sweep::from_frequencies(uneven).expect("ascending"),
            Sweep::from_frequencies(gaps).expect("ascending"),
        ]
    }

    #[test]
    fn few_tones_expand_to_all_of_a_sweep() {
        for sweep in sweeps() {
            for rung in RUNGS {
                for tolerance in [1e-3, 1e-5, 1e-6, 1e-7] {
                    let tones = VirtualTones::find(&sweep, rung, tolerance).expect("a standard duration");
                    let mut worst = 0.0f64;
                    for i in 0..=40 {
                        let delay = tones.duration * (f64::from(i) / 40.0 - 0.5);
                        for (n, f) in sweep.frequencies().iter().enumerate().step_by(13) {
                            let weights = &tones.weights[n * tones.count()..][..tones.count()];
                            let (mut re, mut im) = (0.0, 0.0);
                            for (q, w) in weights.iter().enumerate() {
                                let tone = tones.step * (q as f64 - tones.pairs as f64);
                                let (sin, cos) = (TAU * tone * delay).sin_cos();
                                re += f64::from(*w) * cos;
                                im += f64::from(*w) * sin;
                            }
                            let (sin, cos) = (TAU * (f - tones.centre) * delay).sin_cos();
                            worst = worst.max((re - cos).hypot(im - sin));
                        }
                    }
                    // The weights are held in f32.
                    let rounding = 6e-8 * LARGEST_WEIGHT_SUM;
                    assert!(worst <= 1.05 * tolerance + rounding, "{rung:?} {tolerance:e}: {worst:e}");
                }
            }
        }
    }

    #[test]
    fn weights_stay_small_and_tones_few() {
        for sweep in sweeps() {
            for rung in RUNGS {
                let tones = VirtualTones::find(&sweep, rung, 1e-6).expect("a standard duration");
                assert!(tones.pairs <= rung.pairs + 2, "{} for {rung:?}", tones.pairs);
                let size = (0..sweep.len())
                    .map(|n| {
                        let weights = &tones.weights[n * tones.count()..][..tones.count()];
                        weights.iter().map(|w| f64::from(w.abs())).sum::<f64>()
                    })
                    .fold(0.0, f64::max);
                assert!(size <= LARGEST_WEIGHT_SUM * 1.0001, "{rung:?} {size}");
                let coarse = VirtualTones::find(&sweep, rung, 1e-3).expect("a standard duration");
                // Over long intervals it is the size of W, not its error, that asks for so many.
                let fewer = coarse.pairs < tones.pairs || rung.spread > 12.0;
                assert!(fewer && coarse.pairs <= tones.pairs, "{rung:?}: {} {}", coarse.pairs, tones.pairs);
            }
        }
    }

    #[test]
    fn a_single_frequency_has_none() {
        let sweep = Sweep::from_frequencies(vec![1000.0]).expect("one");
        assert!(VirtualTones::find(&sweep, RUNGS[0], 1e-3).is_none());
    }
}
