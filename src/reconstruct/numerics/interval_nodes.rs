//! Nodes within an interval from which every place of it is interpolated, and none beyond its ends.
//!
//! They are evenly spaced but for the ends, where they are denser, as Chebyshev's are: there places are made of nodes to
//! one side. The map from Chebyshev's points to nearly even ones is that of Kosloff and Tal-Ezer (1993).

use super::interpolator::Taps;
use super::nodes::Around;
use crate::grid::Axis;
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// What weights are damped by, of the tolerance.
const DAMPING: f64 = 0.01;

/// Nodes of an interval, and how places are made of them.
#[derive(Debug, Clone)]
pub(crate) struct IntervalNodes {
    /// m, ascending.
    places: Vec<f64>,
    /// How many of them a place is made of; 0 where places are nodes.
    taps: usize,
    /// The fastest change that is interpolated, cycles per m.
    band: f64,
    /// Weights are kept small where they would gain less than this.
    damping: f64,
    /// Between these nodes all are evenly spaced.
    even: Range<usize>,
}

impl IntervalNodes {
    /// Places that are their own nodes.
    pub(crate) fn themselves(places: Vec<f64>) -> Self {
        Self { places, taps: 0, band: 0.0, damping: 0.0, even: 0..0 }
    }

    /// `count` nodes between two places, for changes of up to `band` cycles per m, to within `tolerance` if that is
    /// possible; each place is made of up to `taps`.
    pub(crate) fn new([first, last]: [f64; 2], count: usize, taps: usize, band: f64, tolerance: f64) -> Self {
        let taps = taps.min(count);
        // The denser nodes at an end are somewhat more than half as many as a place is made of: with fewer, weights there
        // grow large. Found by trying.
        let dense = (PI * (2.0 + taps as f64 / 8.5) / count as f64).min(0.9);
        let even = (1.0 - dense * dense).sqrt();
        let (middle, half) = (first.midpoint(last), 0.5 * (last - first));
        let place = |k: usize| {
            let chebyshev = (PI * (2 * k + 1) as f64 / (2 * count) as f64).cos();
            middle - half * (even * chebyshev).asin() / even.asin()
        };
        let (places, damping) = ((0..count).map(place).collect(), DAMPING * tolerance);
        Self { places, taps, band, damping, even: 0..0 }
    }

    /// Nodes at most `pitch` apart among the places of an axis and evenly spaced, but for `dense` at either end, which stand
    /// ever closer. Weights are kept small where they would gain less than `damping`. `None` where there is no room for that.
    pub(crate) fn even_inside(
        axis: &Axis,
        pitch: f64,
        dense: usize,
        (taps, band): (usize, f64),
        damping: f64,
    ) -> Option<Self> {
        let extent = axis.last() - axis.first;
        let pitches = (extent / pitch).ceil() as usize;
        let inside = pitches.checked_sub(dense).filter(|inside| *inside > 0 && inside + 2 * dense >= taps)?;
        let pitch = extent / pitches as f64;
        // The pitch grows with the distance from the end as that of Chebyshev's nodes, up to what it is inside.
        let from_end = |k: usize| pitch * (k as f64 + 0.5).powi(2) / (2 * dense) as f64;
        let of_inside = |k: usize| axis.first + pitch * (0.5 * (dense + 1) as f64 + k as f64);
        let places: Vec<f64> = (0..dense)
            .map(|k| axis.first + from_end(k))
            .chain((0..inside).map(of_inside))
            .chain((0..dense).rev().map(|k| axis.last() - from_end(k)))
            .collect();
        Some(Self { places, taps, band, damping, even: dense..dense + inside })
    }

    /// The first node that each place is made of, and the weights from there on; faster than [`IntervalNodes::weights`] for
    /// many, since those that are made of the same nodes, or of evenly spaced ones, share a fit.
    pub(crate) fn weights_of(&self, positions: &[f64]) -> Vec<(usize, Vec<f64>)> {
        if !self.interpolates() {
            return positions.iter().map(|position| self.weights(*position)).collect();
        }
        let unit = self.widest().max(f64::MIN_POSITIVE);
        let first: Vec<usize> = positions.iter().map(|position| self.first(*position)).collect();
        let mut fits: Vec<usize> = first.iter().map(|first| self.alike(*first).0).collect();
        fits.sort_unstable();
        fits.dedup();
        let fitted: Vec<Taps> = fits
            .par_iter()
            .map(|fit| {
                let nodes = &self.places[*fit..fit + self.taps];
                let nodes = nodes.iter().map(|node| (node - nodes[0]) / unit).collect();
                Taps::damped(nodes, TAU * self.band * unit, self.damping)
            })
            .collect();
        let weights = |(position, first): (&f64, usize)| {
            let (fit, mirrored) = self.alike(first);
            let place = if mirrored {
                self.places[first + self.taps - 1] - position
            } else {
                position - self.places[first]
            };
            let mut weights = fitted[fits.partition_point(|known| *known < fit)].weights(place / unit);
            if mirrored {
                weights.reverse();
            }
            (first, weights)
        };
        positions.par_iter().zip(first).map(weights).collect()
    }

    /// The first of the nodes whose fit serves those from `first` on, and whether these are their mirror image: evenly spaced
    /// ones are all alike, and so are both halves of the interval.
    fn alike(&self, first: usize) -> (usize, bool) {
        if self.even.start <= first && first + self.taps <= self.even.end {
            return (self.even.start, false);
        }
        let mirror = self.len() - self.taps - first;
        (first.min(mirror), mirror < first)
    }

    /// Whether places are interpolated.
    pub(crate) fn interpolates(&self) -> bool {
        self.taps > 0
    }

    /// The fastest change that they carry, cycles per m.
    pub(crate) fn band(&self) -> f64 {
        self.band
    }

    /// How many nodes a place is made of.
    pub(crate) fn taps(&self) -> usize {
        self.taps.max(1)
    }

    pub(crate) fn len(&self) -> usize {
        self.places.len()
    }

    /// Their places, m.
    pub(crate) fn places(&self) -> &[f64] {
        &self.places
    }

    /// The greatest distance between neighbours, m.
    pub(crate) fn widest(&self) -> f64 {
        self.places.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max)
    }

    /// The first node that a place is made of.
    fn first(&self, position: f64) -> usize {
        if !self.interpolates() {
            let after = self.places.partition_point(|place| *place < position);
            let nearer = |a: &usize, b: &usize| {
                (self.places[*a] - position).abs().total_cmp(&(self.places[*b] - position).abs())
            };
            return (after.saturating_sub(1)..(after + 1).min(self.len())).min_by(nearer).unwrap_or(0);
        }
        let before = self.places.partition_point(|place| *place <= position);
        before.saturating_sub(self.taps / 2).min(self.len() - self.taps)
    }

    /// The places, m, between which all lie that are made of this node, if any are.
    pub(crate) fn made_of(&self, node: usize, [first, last]: [f64; 2]) -> [f64; 2] {
        if !self.interpolates() {
            return [self.places[node]; 2];
        }
        let (half, n) = (self.taps / 2, self.len());
        // What is made of `taps` nodes from the first on has half of them before it.
        let low = if node < self.taps { first } else { self.places[node - (self.taps - half)] };
        let high = if node + self.taps >= n { last } else { self.places[node + half] };
        [low, high]
    }

    /// The first node that a place is made of, and the weights from there on.
    pub(crate) fn weights(&self, position: f64) -> (usize, Vec<f64>) {
        let first = self.first(position);
        if !self.interpolates() {
            return (first, vec![1.0]);
        }
        let nodes = &self.places[first..first + self.taps];
        // In units of their spacing, and from the place on, so that numbers are about one.
        let unit = self.widest().max(f64::MIN_POSITIVE);
        let nodes = nodes.iter().map(|node| (node - position) / unit).collect();
        let taps = Taps::damped(nodes, TAU * self.band * unit, self.damping);
        (first, taps.weights(0.0))
    }

    /// The nodes that a place is made of, m, and their weights.
    pub(crate) fn around(&self, position: f64) -> Around {
        let (first, weights) = self.weights(position);
        (self.places[first..first + weights.len()].to_vec(), weights)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use num_complex::Complex64;

    #[test]
    fn waves_are_carried_up_to_the_ends() {
        for (count, taps, band, bound) in
            [(24, 24, 4.0, 1e-5), (45, 16, 7.0, 1e-4), (60, 24, 10.0, 1e-5), (1, 1, 0.0, 1e-12)]
        {
            let nodes = IntervalNodes::new([-0.3, 1.1], count, taps, band, bound);
            assert!(
                nodes.places().is_sorted() && nodes.places()[0] > -0.3 && nodes.places()[count - 1] < 1.1
            );
            let (mut worst, mut moduli) = (0.0f64, 0.0f64);
            for i in 0..=200 {
                let place = -0.3 + 1.4 * f64::from(i) / 200.0;
                let (around, weights) = nodes.around(place);
                let (first, _) = nodes.weights(place);
                for node in first..first + weights.len() {
                    let [low, high] = nodes.made_of(node, [-0.3, 1.1]);
                    assert!((low..=high).contains(&place), "{place} is made of {node}");
                }
                moduli = moduli.max(weights.iter().map(|w| w.abs()).sum());
                for k in 0..5 {
                    let wave = |at: &f64| Complex64::cis(TAU * band * f64::from(k) / 4.0 * at);
                    let sum: Complex64 = around.iter().zip(&weights).map(|(at, w)| wave(at) * w).sum();
                    worst = worst.max((sum - wave(&place)).norm());
                }
            }
            assert!(worst < bound && moduli < 8.0, "{count} nodes, {taps} taps: {worst:e}, {moduli}");
        }
    }

    #[test]
    fn nodes_that_are_even_inside_carry_waves_up_to_the_ends_and_many_places_share_fits() {
        let axis = Axis { first: -0.3, pitch: 0.007, count: 201 };
        for (taps, fill, bound) in [(36, 0.8, 2e-5), (24, 0.7, 2e-5), (12, 0.5, 5e-4)] {
            let pitch = 0.0141;
            let band = 0.5 * fill / pitch;
            let nodes = IntervalNodes::even_inside(&axis, pitch, 7, (taps, band), 0.01 * bound).unwrap();
            assert!(nodes.places().is_sorted() && nodes.widest() < pitch * (1.0 + 1e-9));
            assert!(nodes.places()[0] > axis.first && nodes.places()[nodes.len() - 1] < axis.last());
            assert_eq!(nodes.len(), 100 + 7);
            let places: Vec<f64> = axis.positions().collect();
            let (mut worst, mut moduli) = (0.0f64, 0.0f64);
            for (place, (first, weights)) in places.iter().zip(nodes.weights_of(&places)) {
                let by_itself = nodes.weights(*place);
                assert_eq!(first, by_itself.0);
                moduli = moduli.max(weights.iter().map(|w| w.abs()).sum());
                for k in 0..9 {
                    let wave = |at: &f64| Complex64::cis(TAU * band * f64::from(k) / 8.0 * at);
                    let sum = |weights: &[f64]| -> Complex64 {
                        nodes.places()[first..].iter().zip(weights).map(|(at, w)| wave(at) * w).sum()
                    };
                    worst = worst.max((sum(&weights) - wave(place)).norm());
                    assert!((sum(&weights) - sum(&by_itself.1)).norm() < bound);
                }
            }
            assert!(worst < bound && moduli < 9.0, "{taps} taps: {worst:e}, {moduli}");
        }
        let short = Axis { count: 50, ..axis };
        assert!(IntervalNodes::even_inside(&short, 0.0141, 7, (36, 20.0), 1e-5).is_none());
    }

    #[test]
    fn places_that_are_nodes_are_made_of_themselves() {
        let nodes = IntervalNodes::themselves(vec![0.1, 0.2, 0.4]);
        for (k, place) in [0.1, 0.2, 0.4].into_iter().enumerate() {
            assert_eq!(nodes.weights(place + 1e-12), (k, vec![1.0]));
            assert_eq!(nodes.made_of(k, [0.1, 0.4]), [place; 2]);
        }
    }
}
