//! Short least-squares interpolators for functions of a limited band on evenly spaced nodes.

use crate::wave::simd::leave_wide_registers;
use faer::linalg::solvers::{Qr, SolveLstsq};
use faer::{Mat, c64};
use num_complex::Complex64;
use std::f64::consts::PI;

/// Weights of a few nodes around a place, fitted to every plane wave of a band alike.
#[derive(Debug, Clone)]
pub(super) struct Taps {
    count: usize,
    /// Band edge, radians per node.
    band: f64,
    /// The factored normal equations `sinc κ(a − b)`.
    normal: Qr<c64>,
}

fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-9 { 1.0 } else { x.sin() / x }
}

impl Taps {
    /// An even `count` of taps for waves of up to `edge` radians per node.
    pub(super) fn new(count: usize, edge: f64) -> Self {
        // A little beyond the edge, where least squares is least accurate.
        let band = (edge * 1.02).min(PI);
        // Complex only so that the skeletons' solver serves too.
        let normal = Mat::from_fn(count, count, |a, b| {
            // Neighbouring columns are nearly dependent; rounding is kept from being amplified.
            let ridge = if a == b { 1e-13 } else { 0.0 };
            Complex64::from(sinc(band * (a as f64 - b as f64)) + ridge)
        })
        .qr();
        leave_wide_registers();
        Self { count, band, normal }
    }

    /// Number of nodes that a place is made of.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// The first node, counted from the one at or before the place.
    pub(super) fn first(&self) -> isize {
        1 - (self.count / 2) as isize
    }

    /// Weights of the nodes `first ..` for a place `t` ∈ [0, 1] nodes after its own:
    /// `(sinc κ(a − b)) w = sinc κ(a − t)`, least squares over |κ'| ≤ κ.
    pub(super) fn weights(&self, t: f64) -> Vec<f64> {
        let node = |a: usize| (a as isize + self.first()) as f64;
        let right = Mat::from_fn(self.count, 1, |a, _| Complex64::from(sinc(self.band * (node(a) - t))));
        let solution = self.normal.solve_lstsq(&right);
        leave_wide_registers();
        (0..self.count).map(|a| solution[(a, 0)].re).collect()
    }

    /// The greatest error for a plane wave of up to `edge` radians per node, anywhere between two nodes.
    pub(super) fn error(&self, edge: f64) -> f64 {
        let mut worst = 0.0f64;
        for i in 1..=4 {
            let t = f64::from(i) / 8.0;
            let weights = self.weights(t);
            for j in 0..=40 {
                let wavenumber = edge * f64::from(j) / 40.0;
                let wave = |a: usize| Complex64::cis(wavenumber * ((a as isize + self.first()) as f64 - t));
                let sum: Complex64 = weights.iter().enumerate().map(|(a, w)| wave(a) * w).sum();
                worst = worst.max((sum - 1.0).norm());
            }
        }
        worst
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waves_of_the_band_are_carried_and_those_beyond_are_not() {
        let mut last = 1.0;
        for count in [4, 6, 8, 10, 12, 14] {
            let taps = Taps::new(count, 0.5 * PI);
            let error = taps.error(0.5 * PI);
            assert!(error < 0.3 * last, "{count} taps: {error:e}");
            assert!(taps.error(0.9 * PI) > 20.0 * error);
            // Anywhere, not only where it is measured.
            for i in 0..50 {
                let (t, wavenumber) = (f64::from(i) / 49.0, 0.5 * PI * (f64::from(i) * 0.618_034).fract());
                let wave = |a: usize| Complex64::cis(wavenumber * ((a as isize + taps.first()) as f64 - t));
                let sum: Complex64 = taps.weights(t).iter().enumerate().map(|(a, w)| wave(a) * w).sum();
                assert!((sum - 1.0).norm() <= 1.2 * error + 1e-11, "{count} taps at {t}");
            }
            last = error;
        }
        assert!(last < 1e-5);
    }
}
