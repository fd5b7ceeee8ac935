//! Short least-squares interpolators for functions of a limited band.

use super::Memo;
use crate::linalg::{LeastSquares, Matrix, max_modulus, product, waves};
use crate::wave::interval::chebyshev_point;
use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};
use std::sync::Arc;

/// Weights of a few nodes around a place, fitted to every plane wave of a band alike.
#[derive(Debug, Clone)]
pub(crate) struct Taps {
    /// Places of the nodes.
    nodes: Vec<f64>,
    /// Wavenumbers that weights are fitted at, cycles per unit; by symmetry the positive ones serve.
    fitted: Vec<f64>,
    fit: TapsFit,
}

/// Least squares in the waves at the nodes.
#[derive(Debug, Clone)]
enum TapsFit {
    Plain(Arc<LeastSquares>),
    /// Of nodes on both sides of a middle alike, in sums and differences of waves at each two: a quarter of the work.
    Symmetric {
        middle: f64,
        /// Of cosines for the sums, and of sines for the differences.
        parts: Arc<[LeastSquares; 2]>,
    },
}

impl TapsFit {
    fn new(nodes: &[f64], fitted: &[f64], damping: f64) -> Self {
        let middle = nodes.first().zip(nodes.last()).map_or(0.0, |(first, last)| first.midpoint(*last));
        let (left, right) = nodes.split_at(nodes.len() / 2);
        let alike = |(a, b): (&f64, &f64)| (middle - a) - (b - middle) == 0.0;
        if left.len() < right.len() || !left.iter().rev().zip(right).all(alike) {
            return Self::Plain(Arc::new(LeastSquares::damped(&waves(fitted, nodes), damping)));
        }
        let away: Vec<f64> = right.iter().map(|node| node - middle).collect();
        // The squares of two weights are half of those of their sum and their difference.
        let parts = cos_and_sin(fitted, &away);
        let parts = parts.map(|part| LeastSquares::damped(&part, damping * FRAC_1_SQRT_2));
        Self::Symmetric { middle, parts: Arc::new(parts) }
    }

    /// The weights of all nodes for each of these places, `[nodes, places]`.
    fn weights(&self, fitted: &[f64], places: &[f64]) -> Matrix {
        let (middle, parts) = match self {
            Self::Plain(factored) => return factored.solve(&waves(fitted, places)),
            Self::Symmetric { middle, parts } => (middle, parts),
        };
        let away: Vec<f64> = places.iter().map(|place| place - middle).collect();
        let [cos, sin] = cos_and_sin(fitted, &away);
        let (sums, differences) = (parts[0].solve(&cos), parts[1].solve(&sin));
        let pairs = sums.nrows();
        Matrix::from_fn(2 * pairs, places.len(), |a, n| match a.checked_sub(pairs) {
            Some(right) => 0.5 * (sums[(right, n)] + differences[(right, n)]),
            None => 0.5 * (sums[(pairs - 1 - a, n)] - differences[(pairs - 1 - a, n)]),
        })
    }
}

/// The two halves of [`waves`].
fn cos_and_sin(wavenumbers: &[f64], places: &[f64]) -> [Matrix; 2] {
    let (all, count) = (waves(wavenumbers, places), wavenumbers.len());
    [0, count].map(|first| all.subrows(first, count).to_owned())
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
        let fit = TapsFit::new(&nodes, &fitted, damping);
        Self { nodes, fitted, fit }
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
        self.fit.weights(&self.fitted, places)
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
    use crate::linalg::max_modulus;
    use num_complex::Complex64;

    #[test]
    fn symmetric_nodes_have_the_weights_of_any() {
        for count in [2, 4, 12, 22, 36] {
            let edge = PI * (1.0 - 5.0 / (count + 6) as f64).max(0.2);
            let fast = Taps::new(count, edge);
            assert!(matches!(fast.fit, TapsFit::Symmetric { .. }));
            let plain = LeastSquares::damped(&waves(&fast.fitted, &fast.nodes), DAMPING);
            let slow = Taps { fit: TapsFit::Plain(Arc::new(plain)), ..fast.clone() };
            let places: Vec<f64> = (0..9).map(|k| f64::from(k) / 8.0).collect();
            let difference = max_modulus(&(fast.weights_of(&places) - slow.weights_of(&places)));
            assert!(difference < 1e-4, "{count}: {difference:e}");
            let [fast, slow] = [fast, slow].map(|taps| taps.error_at(edge, &places));
            assert!((fast.0 - slow.0).abs() < 1e-3 * slow.0 + 1e-10, "{count}: {fast:?} and {slow:?}");
            assert!((fast.1 - slow.1).abs() < 1e-3 * slow.1);
        }
        assert!(matches!(Taps::on(vec![-1.0, 0.0, 0.9, 2.0], 1.0).fit, TapsFit::Plain(_)));
        assert!(matches!(Taps::on(vec![-1.0, 0.0, 1.0], 1.0).fit, TapsFit::Plain(_)));
    }

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
