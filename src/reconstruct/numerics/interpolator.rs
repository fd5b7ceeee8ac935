//! Short least-squares interpolators for functions of a limited band.

use super::Memo;
use crate::linalg::{LeastSquares, Matrix, max_modulus, product, waves};
use crate::wave::interval::chebyshev_point;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Weights of a few nodes around a place, fitted to every plane wave of a band alike.
#[derive(Debug, Clone)]
pub(crate) struct Taps {
    /// Places of the nodes.
    nodes: Vec<f64>,
    /// Wavenumbers that weights are fitted at, cycles per unit; by symmetry the positive ones serve.
    fitted: Vec<f64>,
    factored: Arc<LeastSquares>,
}

/// Weights are kept small where they would gain less than this.
const DAMPING: f64 = 1e-11;

/// Wavenumbers from zero to the edge of a band at which an error is measured.
const MEASURED: usize = 41;

/// How much of the nodes' band the fastest change may take, tried in turn.
const NODE_FILLS: [f64; 12] = [0.8, 0.75, 0.7, 0.65, 0.6, 0.55, 0.5, 0.45, 0.4, 0.35, 0.3, 0.25];

impl Taps {
    /// An even `count` of taps on even nodes, for waves of up to `edge` radians per node.
    pub(crate) fn new(count: usize, edge: f64) -> Self {
        let first = 1.0 - (count / 2) as f64;
        Self::on((0..count).map(|a| first + a as f64).collect(), edge.min(PI / 1.02))
    }

    /// Taps on nodes anywhere, for waves of up to `edge` radians per unit of their places.
    pub(crate) fn on(nodes: Vec<f64>, edge: f64) -> Self {
        Self::damped(nodes, edge, DAMPING)
    }

    /// The same with weights kept small where they would gain less than `damping`.
    pub(crate) fn damped(nodes: Vec<f64>, edge: f64, damping: f64) -> Self {
        let points = nodes.len() + 6;
        // A little beyond the edge, where least squares is least accurate.
        let fitted: Vec<f64> =
            (0..points).map(|k| 1.02 * edge / TAU * chebyshev_point(k, 2 * points)).collect();
        let factored = Arc::new(LeastSquares::damped(&waves(&fitted, &nodes), damping));
        Self { nodes, fitted, factored }
    }

    /// Numbers of taps up to `most`, each with the fullest band that a plane wave of it keeps within the tolerance.
    pub(crate) fn lengths(tolerance: f64, most: usize) -> Vec<(Self, f64)> {
        static LAST: Memo<(f64, usize), Vec<(Taps, f64)>> = Memo::new();
        LAST.of((tolerance, most), || Self::find_lengths(tolerance, most))
    }

    fn find_lengths(tolerance: f64, most: usize) -> Vec<(Self, f64)> {
        let kept = |count: usize, fill: f64| {
            let taps = Self::new(count, PI * fill);
            (taps.error(PI * fill) <= tolerance).then_some((taps, fill))
        };
        // The more taps, the fuller the band.
        let (mut fuller, mut found) = (NODE_FILLS.len(), Vec::new());
        for count in (4..=most).step_by(2) {
            let mut fullest = NODE_FILLS.get(fuller).and_then(|fill| kept(count, *fill));
            while let Some(better) = fuller.checked_sub(1).and_then(|i| kept(count, NODE_FILLS[i])) {
                (fuller, fullest) = (fuller - 1, Some(better));
            }
            found.extend(fullest);
        }
        found
    }

    /// Number of nodes that a place is made of.
    pub(crate) fn count(&self) -> usize {
        self.nodes.len()
    }

    /// The first of even nodes, counted from the one at or before the place.
    pub(crate) fn first(&self) -> isize {
        1 - (self.count() / 2) as isize
    }

    /// Weights of the nodes for a place; on even nodes it lies `t` ∈ [0, 1] after its own.
    pub(crate) fn weights(&self, t: f64) -> Vec<f64> {
        self.weights_of(&[t]).col_as_slice(0).to_vec()
    }

    /// The same for many places, `[taps, places]`.
    pub(crate) fn weights_of(&self, places: &[f64]) -> Matrix {
        self.factored.solve(&waves(&self.fitted, places))
    }

    /// The largest error for a plane wave of up to `edge` radians per unit at any of these places, and the largest sum of
    /// the moduli of their weights.
    pub(crate) fn error_at(&self, edge: f64, places: &[f64]) -> (f64, f64) {
        let weights = self.weights_of(places);
        let cycles: Vec<f64> = (0..MEASURED).map(|k| edge / TAU * k as f64 / (MEASURED - 1) as f64).collect();
        let error = max_modulus(&(waves(&cycles, places) - product(&waves(&cycles, &self.nodes), &weights)));
        let sums = (0..places.len()).map(|n| weights.col_as_slice(n).iter().map(|w| w.abs()).sum());
        (error, sums.fold(0.0, f64::max))
    }

    /// The largest error on even nodes, anywhere between two of them.
    pub(crate) fn error(&self, edge: f64) -> f64 {
        self.error_at(edge, &[0.125, 0.25, 0.375, 0.5]).0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex64;

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
