//! Interpolation between even samples by a short taper, corrected on the other side of the transform.
//!
//! `Σ_j φ(t − j) e^{i2πκj} = φ̂(κ) e^{i2πκt}` up to aliases, which are small for a smooth φ if |κ| stays below a quarter: a
//! function with such a band, each component divided by φ̂(κ) beforehand, is read anywhere from a few samples.
//! φ is the "exponential of semicircle" of Barnett, Magland and af Klinteberg (SIAM J. Sci. Comput. 41, 2019). Half as
//! many taps do as without the correction (as [`super::super::spread`] has to do), an eighth in three dimensions.

use crate::grid::Axis;
use num_complex::Complex64;
use std::f64::consts::TAU;

/// Samples per period of the fastest component: twice as many as need be.
const OVERSAMPLING: f64 = 2.0;

/// The longest taper that is tried; f32 weights gain nothing from more.
pub(super) const MOST_TAPS: usize = 10;

/// Places between two samples at which weights are held; linear in between.
const STEPS: usize = 2048;

/// Steps of κ between which corrections are linear, to within 10⁻⁷.
const COMPONENTS: usize = 2048;

/// Points of the integral of φ̂.
const POINTS: usize = 400;

/// A taper with its measured error.
#[derive(Debug, Clone)]
pub(super) struct Taper {
    taps: usize,
    /// `[place, tap]`.
    table: Vec<f32>,
    /// 1/φ̂ at [`COMPONENTS`] + 1 even steps of κ from zero to the end of the band.
    corrections: Vec<f64>,
    /// The greatest error on any component and at any place, relative to one.
    pub(super) error: f64,
}

impl Taper {
    /// The shortest taper that keeps `tolerance`, or the longest that is tried.
    pub(super) fn new(tolerance: f64) -> Self {
        (2..=MOST_TAPS)
            .map(|taps| Self::of(taps, tolerance))
            .find(|taper| !taper.corrections.is_empty())
            .expect("the longest is good enough for anything")
    }

    fn of(taps: usize, tolerance: f64) -> Self {
        let mut taper = Self { taps, table: Vec::new(), corrections: Vec::new(), error: 0.0 };
        taper.table = (0..=STEPS)
            .flat_map(|step| {
                let place = step as f64 / STEPS as f64;
                (0..taps).map(move |tap| value(taps, place - taps as f64 / 2.0 + tap as f64) as f32)
            })
            .collect();
        taper.error = taper.measure();
        if taper.error <= tolerance || taps == MOST_TAPS {
            let end = 1.0 / (2.0 * OVERSAMPLING * COMPONENTS as f64);
            taper.corrections = (0..=COMPONENTS).map(|i| 1.0 / taper.transform(i as f64 * end)).collect();
        }
        taper
    }

    pub(super) fn taps(&self) -> usize {
        self.taps
    }

    /// φ̂(κ), κ in cycles per sample.
    fn transform(&self, kappa: f64) -> f64 {
        let (width, half) = (self.taps as f64, self.taps as f64 / 2.0);
        let point = |i: usize| -half + width * (i as f64 + 0.5) / POINTS as f64;
        let sum: f64 = (0..POINTS).map(|i| value(self.taps, point(i)) * (TAU * kappa * point(i)).cos()).sum();
        sum * width / POINTS as f64
    }

    /// The first sample that a place `t`, counted in samples, reads, and the weights from there on.
    fn weights<'a>(&self, t: f64, weights: &'a mut [f32; MOST_TAPS]) -> (f64, &'a [f32]) {
        let start = t - self.taps as f64 / 2.0;
        let first = start.ceil();
        let place = (first - start) * STEPS as f64;
        let step = (place as usize).min(STEPS - 1);
        let rest = (place - step as f64) as f32;
        let (low, high) = self.table[step * self.taps..][..2 * self.taps].split_at(self.taps);
        for (weight, (low, high)) in weights.iter_mut().zip(low.iter().zip(high)) {
            *weight = low + rest * (high - low);
        }
        (first, &weights[..self.taps])
    }

    /// The greatest error, with the weights as they are used.
    fn measure(&self) -> f64 {
        let mut worst = 0.0f64;
        for i in 0..=16 {
            let kappa = f64::from(i) / 16.0 / (2.0 * OVERSAMPLING);
            let transform = self.transform(kappa);
            for j in 0..24 {
                let t = 20.0 + (f64::from(j) + 0.31) / 24.0;
                let mut buffer = [0.0; MOST_TAPS];
                let (first, weights) = self.weights(t, &mut buffer);
                let sum: Complex64 = weights
                    .iter()
                    .enumerate()
                    .map(|(tap, w)| Complex64::cis(TAU * kappa * (first + tap as f64 - t)) * f64::from(*w))
                    .sum();
                worst = worst.max((sum / transform - 1.0).norm());
            }
        }
        // Between the places and components that were tried.
        1.1 * worst
    }
}

/// φ at `s` samples from its middle.
fn value(taps: usize, s: f64) -> f64 {
    let beta = 2.3 * taps as f64;
    let inside = 1.0 - (2.0 * s / taps as f64).powi(2);
    if inside < 0.0 { 0.0 } else { (beta * (inside.sqrt() - 1.0)).exp() }
}

/// An axis sampled finely enough for all components `e^{i2πκq}` with κ in a band.
#[derive(Debug, Clone)]
pub(super) struct Sampled {
    axis: Axis,
    /// The middle of the band, which the samples do without, cycles per unit.
    carrier: f64,
}

/// A band times an extent below which all is one and the same, cycles.
const CONSTANT: f64 = 1e-9;

impl Sampled {
    /// Samples that serve every place between the `ends`.
    pub(super) fn new([low, high]: [f64; 2], [slowest, fastest]: [f64; 2], taper: &Taper) -> Self {
        let carrier = f64::midpoint(slowest, fastest);
        let half = (fastest - slowest) / 2.0;
        if half * (high - low) < CONSTANT {
            return Self { axis: Axis { first: f64::midpoint(low, high), pitch: 1.0, count: 1 }, carrier };
        }
        let pitch = 1.0 / (2.0 * OVERSAMPLING * half);
        let count = (((high - low) / pitch).ceil() as usize).saturating_add(taper.taps + 1);
        Self { axis: Axis { first: low - pitch * taper.taps as f64 / 2.0, pitch, count }, carrier }
    }

    pub(super) fn count(&self) -> usize {
        self.axis.count
    }

    pub(super) fn axis(&self) -> &Axis {
        &self.axis
    }

    pub(super) fn carrier(&self) -> f64 {
        self.carrier
    }

    pub(super) fn positions(&self) -> impl Iterator<Item = f64> + use<> {
        self.axis.positions()
    }

    /// What the component κ is to be multiplied by, beforehand.
    pub(super) fn correction(&self, kappa: f64, taper: &Taper) -> f32 {
        if self.axis.count == 1 {
            return 1.0;
        }
        let of_band = (kappa - self.carrier).abs() * self.axis.pitch * 2.0 * OVERSAMPLING;
        let place = of_band.min(1.0) * COMPONENTS as f64;
        let step = (place as usize).min(COMPONENTS - 1);
        let [low, high] = [taper.corrections[step], taper.corrections[step + 1]];
        (low + (place - step as f64) * (high - low)) as f32
    }

    /// The samples that a place reads: the first, and their weights.
    pub(super) fn weights<'a>(
        &self,
        position: f64,
        taper: &Taper,
        weights: &'a mut [f32; MOST_TAPS],
    ) -> (usize, &'a [f32]) {
        if self.axis.count == 1 {
            weights[0] = 1.0;
            return (0, &weights[..1]);
        }
        let (first, weights) = taper.weights((position - self.axis.first) / self.axis.pitch, weights);
        // Rounding at an end moves a place by no more than 10⁻¹⁵ of the axis.
        ((first.max(0.0) as usize).min(self.axis.count - weights.len()), weights)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_taps_for_a_smaller_tolerance() {
        for (tolerance, most) in [(1e-2, 4), (1e-3, 5), (1e-4, 6), (1e-5, 7), (1e-6, 9)] {
            let taper = Taper::new(tolerance);
            assert!(taper.error <= tolerance, "{:e} above {tolerance:e}", taper.error);
            assert!(taper.taps() <= most, "{} taps for {tolerance:e}", taper.taps());
        }
    }

    #[test]
    fn a_component_is_read_anywhere_between_the_ends() {
        let taper = Taper::new(1e-4);
        let (ends, band) = ([-0.7, 0.4], [3.0, 21.0]);
        let sampled = Sampled::new(ends, band, &taper);
        for kappa in [3.0, 7.7, 12.0, 21.0] {
            let correction = f64::from(sampled.correction(kappa, &taper));
            for i in 0..=100 {
                let q = ends[0] + (ends[1] - ends[0]) * f64::from(i) / 100.0;
                let mut buffer = [0.0; MOST_TAPS];
                let (first, weights) = sampled.weights(q, &taper, &mut buffer);
                let sample = |j: usize| {
                    Complex64::cis(TAU * (kappa - sampled.carrier()) * sampled.axis().position(first + j))
                };
                let sum: Complex64 =
                    weights.iter().enumerate().map(|(j, w)| sample(j) * f64::from(*w) * correction).sum();
                let read = sum * Complex64::cis(TAU * sampled.carrier() * q);
                assert!((read - Complex64::cis(TAU * kappa * q)).norm() < 1e-4, "{kappa} {q}");
            }
        }
    }

    #[test]
    fn what_does_not_change_has_one_sample() {
        let taper = Taper::new(1e-4);
        assert_eq!(Sampled::new([0.2, 0.2], [-40.0, 40.0], &taper).count(), 1);
        assert_eq!(Sampled::new([-0.5, 0.5], [9.0, 9.0], &taper).count(), 1);
    }
}
