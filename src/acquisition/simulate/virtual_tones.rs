//! Virtual tones: a simulation at a few chosen frequencies, expanded to all frequencies of a sweep.
//!
//! Reflectors whose path lengths lie within T seconds of each other give a cube that, after removal of the middle delay,
//! is smooth in f. Q evenly spaced tones about the middle of the band, reaching a little beyond it, determine it
//! completely: for every |δ| ≤ T/2,
//!
//! `e^{i2π(f_n − f_c)δ} = Σ_q W[n, q] e^{i2πqΔδ} + O(ε)`, q = −K … K.
//!
//! The tones need not be frequencies of the sweep, so they are equispaced and a phasor recurrence can be used. W is a
//! least-squares solution; it is real because interval and tones are symmetric. It depends only on T, not on the position
//! of the interval. Its error and its size are checked: too few or too widely spaced tones would make it huge.

use crate::acquisition::Sweep;
use crate::linalg::{LeastSquares, max_modulus, product, waves};
use crate::wave::interval::{chebyshev_point, greater};
use rayon::prelude::*;

/// Tones and weights for every interval of one duration.
#[derive(Debug, Clone)]
pub(super) struct EquispacedTones {
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

/// The number and spacing of tones for one time-bandwidth product.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ToneDesign {
    /// `B·T`.
    pub(super) time_bandwidth: f64,
    /// Tones per T⁻¹: the spacing is 1/(oversampling · T).
    pub(super) oversampling: f64,
    /// K for a tolerance of 10⁻⁶.
    pub(super) pairs: usize,
}

/// The designs that are available. Short intervals need tones much closer than 1/T, long ones only slightly closer: each
/// has the oversampling with which the fewest tones meet 10⁻⁶ and W stays small.
pub(super) const TONE_DESIGNS: [ToneDesign; 9] = [
    ToneDesign { time_bandwidth: 1.0, oversampling: 4.0, pairs: 4 },
    ToneDesign { time_bandwidth: 2.0, oversampling: 3.0, pairs: 5 },
    ToneDesign { time_bandwidth: 3.0, oversampling: 2.8, pairs: 6 },
    ToneDesign { time_bandwidth: 4.0, oversampling: 2.5, pairs: 7 },
    ToneDesign { time_bandwidth: 6.0, oversampling: 2.0, pairs: 9 },
    ToneDesign { time_bandwidth: 8.0, oversampling: 1.8, pairs: 10 },
    ToneDesign { time_bandwidth: 12.0, oversampling: 1.5, pairs: 14 },
    ToneDesign { time_bandwidth: 16.0, oversampling: 1.4, pairs: 17 },
    ToneDesign { time_bandwidth: 25.0, oversampling: 1.3, pairs: 23 },
];

/// Maximum sum of |W|; larger sums would amplify f32 rounding too much.
const LARGEST_WEIGHT_SUM: f64 = 30.0;

/// How far below and above a design's own K the search may go.
const FEWER: usize = 2;
pub(super) const MORE: usize = 4;

/// Number of frequencies that the search samples, and that are solved for at a time.
const SAMPLED: usize = 96;
const BLOCK: usize = 1024;

impl EquispacedTones {
    /// Tones and weights of a design that meet `tolerance`; `None` if there are none, as for a single frequency.
    pub(super) fn find(sweep: &Sweep, design: ToneDesign, tolerance: f64) -> Option<Self> {
        Self::about(sweep.centre(), sweep.frequencies(), design, tolerance)
    }

    /// The same for any ascending frequencies about a centre, positive or not.
    pub(super) fn about(
        centre: f64,
        frequencies: &[f64],
        design: ToneDesign,
        tolerance: f64,
    ) -> Option<Self> {
        let duration = design.time_bandwidth / (frequencies.last()? - frequencies.first()?);
        if !(duration.is_finite() && duration > 0.0) {
            return None;
        }
        let last = frequencies.len() - 1;
        let count = SAMPLED.min(frequencies.len());
        let sampled: Vec<f64> =
            (0..count).map(|i| frequencies[i * last / (count - 1).max(1)] - centre).collect();
        let fewest = design.pairs.saturating_sub(FEWER).max(1);
        (fewest..=design.pairs + MORE).find_map(|pairs| {
            let fit = Fit::new(design.oversampling, duration, pairs);
            if !fit.weights(&sampled).meets(tolerance) {
                return None;
            }
            // Between the sampled frequencies the error may be slightly larger.
            let solved = Some(fit.all(frequencies, centre)).filter(|all| all.meets(tolerance))?;
            Some(Self { centre, step: fit.step, pairs, duration, weights: solved.weights })
        })
    }

    /// The tones, Hz, ascending.
    pub(super) fn frequencies(&self) -> Vec<f64> {
        let pairs = self.pairs as i32;
        (-pairs..=pairs).map(|q| self.centre + f64::from(q) * self.step).collect()
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
    /// The maximum error of the expansion on the dense grid, relative to one.
    error: f64,
    /// `max_n Σ_q |W[n, q]|`.
    weight_sum: f64,
}

impl Solved {
    /// False for NaN.
    fn meets(&self, tolerance: f64) -> bool {
        self.error <= tolerance && self.weight_sum <= LARGEST_WEIGHT_SUM
    }
}

/// Least squares for tones of one spacing and number.
#[derive(Debug)]
struct Fit {
    /// Δ, Hz.
    step: f64,
    pairs: usize,
    /// Delays to fit on and to check on, s; by symmetry the positive half is enough.
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

    /// Weights for frequencies relative to the centre.
    fn weights(&self, frequencies: &[f64]) -> Solved {
        let pairs = self.pairs as i32;
        let tones: Vec<f64> = (-pairs..=pairs).map(|q| f64::from(q) * self.step).collect();
        let weights = LeastSquares::new(&waves(&self.nodes, &tones)).solve(&waves(&self.nodes, frequencies));
        let residual = waves(&self.dense, frequencies) - product(&waves(&self.dense, &tones), &weights);
        let mut solved = Solved { error: max_modulus(&residual), ..Solved::default() };
        for column in 0..frequencies.len() {
            let w = weights.col_as_slice(column);
            solved.weight_sum = greater(w.iter().map(|w| w.abs()).sum(), solved.weight_sum);
            solved.weights.extend(w.iter().map(|w| *w as f32));
        }
        solved
    }

    /// Weights for all frequencies of a sweep, in blocks.
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
            for design in TONE_DESIGNS {
                for tolerance in [1e-3, 1e-5, 1e-6, 1e-7] {
                    let tones =
                        EquispacedTones::find(&sweep, design, tolerance).expect("a standard duration");
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
                    // The weights are stored in f32.
                    let rounding = 6e-8 * LARGEST_WEIGHT_SUM;
                    assert!(worst <= 1.05 * tolerance + rounding, "{design:?} {tolerance:e}: {worst:e}");
                }
            }
        }
    }

    #[test]
    fn weights_stay_small_and_tones_few() {
        for sweep in sweeps() {
            for design in TONE_DESIGNS {
                let tones = EquispacedTones::find(&sweep, design, 1e-6).expect("a standard duration");
                assert!(tones.pairs <= design.pairs + 2, "{} for {design:?}", tones.pairs);
                let size = (0..sweep.len())
                    .map(|n| {
                        let weights = &tones.weights[n * tones.count()..][..tones.count()];
                        weights.iter().map(|w| f64::from(w.abs())).sum::<f64>()
                    })
                    .fold(0.0, f64::max);
                assert!(size <= LARGEST_WEIGHT_SUM * 1.0001, "{design:?} {size}");
                let coarse = EquispacedTones::find(&sweep, design, 1e-3).expect("a standard duration");
                // Over long intervals the number follows from the size of W, not from its error.
                let fewer = coarse.pairs < tones.pairs || design.time_bandwidth > 12.0;
                assert!(fewer && coarse.pairs <= tones.pairs, "{design:?}: {} {}", coarse.pairs, tones.pairs);
            }
        }
    }

    #[test]
    fn a_single_frequency_has_no_tones() {
        let sweep = Sweep::from_frequencies(vec![1000.0]).expect("one");
        assert!(EquispacedTones::find(&sweep, TONE_DESIGNS[0], 1e-3).is_none());
    }
}
