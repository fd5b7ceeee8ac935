//! Nodes along an axis, from which other places are interpolated.

use super::IntervalNodes;
use super::interpolator::Taps;
use crate::grid::Axis;
use crate::wave::simd::LANES;
use crate::wave::simd::double::phasors_f64;
use crate::wave::simd::rows::WIDE;
use num_complex::Complex64;
use std::ops::Range;

/// Places of nodes along an axis, m, and the weights that make another place of them.
pub(crate) type Around = (Vec<f64>, Vec<f64>);

/// What a place is made of, found by `around` where it is not `known` yet; for few places.
pub(crate) fn known_at(
    place: f64,
    known: &mut Vec<(f64, Around)>,
    around: impl Fn(f64) -> Around,
) -> &Around {
    let index = known.iter().position(|(at, _)| *at == place).unwrap_or_else(|| {
        known.push((place, around(place)));
        known.len() - 1
    });
    &known[index].1
}

/// By how much a wave at a place differs from what is made of it at nodes: its phases in cycles at these, then at the place.
pub(crate) fn wave_error(weights: &[f64], cycles: &[f64], waves: &mut Vec<Complex64>) -> f64 {
    waves.resize(cycles.len(), Complex64::ZERO);
    phasors_f64(cycles, waves);
    // In several sums, of which none waits for another.
    let mut sums = [Complex64::ZERO; 8];
    for (waves, weights) in waves.chunks(8).zip(weights.chunks(8)) {
        for ((sum, wave), w) in sums.iter_mut().zip(waves).zip(weights) {
            *sum += wave * w;
        }
    }
    let made: Complex64 = sums.iter().sum();
    // `norm` calls a function that minds overflow, and takes as long as the rest.
    (made - waves[weights.len()]).norm_sqr().sqrt()
}

/// Nodes along an axis, and how many of them each place is made of.
#[derive(Debug, Clone)]
pub(crate) struct Nodes {
    /// Where they are; of nodes that are denser at the ends how many, and their pitch between these.
    pub(crate) axis: Axis,
    interpolation: Interpolation,
}

/// What places are made of.
#[derive(Debug, Clone)]
enum Interpolation {
    /// They are nodes.
    None,
    /// Of even nodes on both sides.
    Even(Taps),
    /// Of nodes between the first place and the last.
    Within(IntervalNodes),
}

impl Nodes {
    /// Places that are their own nodes.
    pub(crate) fn themselves(places: &Axis) -> Self {
        Self { axis: *places, interpolation: Interpolation::None }
    }

    /// Nodes around every place that is to be interpolated.
    pub(crate) fn with_taps(axis: Axis, taps: Taps) -> Self {
        Self { axis, interpolation: Interpolation::Even(taps) }
    }

    /// Nodes of which none is beyond the places.
    pub(crate) fn within(nodes: IntervalNodes) -> Self {
        let axis = Axis { first: nodes.places()[0], pitch: nodes.widest(), count: nodes.len() };
        Self { axis, interpolation: Interpolation::Within(nodes) }
    }

    /// Where nodes are that are not even, m.
    pub(crate) fn uneven(&self) -> Option<&[f64]> {
        match &self.interpolation {
            Interpolation::Within(nodes) => Some(nodes.places()),
            Interpolation::None | Interpolation::Even(_) => None,
        }
    }

    /// Whether places are interpolated.
    pub(crate) fn interpolates(&self) -> bool {
        !matches!(self.interpolation, Interpolation::None)
    }

    /// How many nodes a place is made of.
    pub(crate) fn taps(&self) -> usize {
        match &self.interpolation {
            Interpolation::None => 1,
            Interpolation::Even(taps) => taps.count(),
            Interpolation::Within(nodes) => nodes.taps(),
        }
    }

    /// The first node that every place is made of, and the weights from there on.
    pub(crate) fn weights(&self, positions: &[f64]) -> Vec<(usize, Vec<f64>)> {
        let place = |position: f64| (position - self.axis.first) / self.axis.pitch;
        match &self.interpolation {
            Interpolation::None => {
                positions.iter().map(|p| (place(*p).round() as usize, vec![1.0])).collect()
            }
            Interpolation::Even(taps) => {
                let weights = |position: &f64| {
                    let own = (place(*position) + 1e-9).floor();
                    let first = (own as isize + taps.first()).max(0) as usize;
                    let t = (place(*position) - own).max(0.0);
                    (first.min(self.axis.count - taps.count()), taps.weights(t))
                };
                positions.iter().map(weights).collect()
            }
            Interpolation::Within(nodes) => nodes.weights_of(positions),
        }
    }

    /// The nodes that every place is made of, m, and their weights.
    pub(crate) fn around(&self, positions: &[f64]) -> Vec<Around> {
        let at = |node: usize| self.uneven().map_or_else(|| self.axis.position(node), |places| places[node]);
        let around =
            |(first, weights): (usize, Vec<f64>)| ((first..first + weights.len()).map(at).collect(), weights);
        self.weights(positions).into_iter().map(around).collect()
    }
}

/// The weights of every place along an axis.
#[derive(Debug, Clone)]
pub(crate) struct AxisWeights {
    first: Vec<usize>,
    /// `[count, taps]`.
    weights: Vec<f32>,
    taps: usize,
}

impl AxisWeights {
    /// Of every place, the first node that it is made of and as many weights from there on.
    pub(crate) fn new(places: impl Iterator<Item = (usize, Vec<f64>)>) -> Self {
        let all: Vec<(usize, Vec<f64>)> = places.collect();
        Self {
            first: all.iter().map(|(first, _)| *first).collect(),
            weights: all.iter().flat_map(|(_, weights)| weights.iter().map(|w| *w as f32)).collect(),
            taps: all.first().map_or(0, |(_, weights)| weights.len()),
        }
    }

    /// The same with as many weights as whole vectors have, zeros after the others.
    pub(crate) fn in_vectors(self) -> Self {
        let taps = self.taps.next_multiple_of(LANES);
        let padded = |weights: &[f32]| [weights, &vec![0.0; taps - weights.len()]].concat();
        let weights = self.weights.chunks(self.taps.max(1)).flat_map(padded).collect();
        Self { weights, taps, ..self }
    }

    /// The same of nodes of two numbers, counted in these: every weight twice.
    pub(crate) fn of_both_parts(self) -> Self {
        Self {
            first: self.first.iter().map(|first| 2 * first).collect(),
            weights: self.weights.iter().flat_map(|weight| [*weight; 2]).collect(),
            taps: 2 * self.taps,
        }
    }

    /// The weights of every one of so many nodes in the places that are made of it: the adjoint of the interpolation.
    pub(crate) fn transposed(&self, nodes: usize) -> Self {
        let mut places: Vec<Range<usize>> = vec![0..0; nodes];
        for (place, first) in self.first.iter().enumerate() {
            for of_node in &mut places[*first..first + self.taps] {
                let from = if of_node.end == 0 { place } else { of_node.start };
                *of_node = from..place + 1;
            }
        }
        let taps = places.iter().map(Range::len).max().unwrap_or(0);
        let weights_of = |(node, places): (usize, &Range<usize>)| {
            let first = places.start.min(self.first.len() - taps);
            let weight = |place: usize| {
                let (from, weights) = self.of(place);
                node.checked_sub(from).and_then(|tap| weights.get(tap)).map_or(0.0, |w| f64::from(*w))
            };
            (first, (first..first + taps).map(weight).collect())
        };
        Self::new(places.iter().enumerate().map(weights_of))
    }

    /// How many nodes a place is made of.
    pub(crate) fn taps(&self) -> usize {
        self.taps
    }

    /// How many places there are.
    pub(crate) fn len(&self) -> usize {
        self.first.len()
    }

    /// The first node of a place, and the weights from there on.
    pub(crate) fn of(&self, place: usize) -> (usize, &[f32]) {
        (self.first[place], &self.weights[place * self.taps..][..self.taps])
    }
}

/// Numbers of a row, padded so that vectors that begin at any of them are whole, and so are those of
/// [`weighted_rows`](crate::wave::simd::rows::weighted_rows).
pub(crate) fn padded_width(count: usize) -> usize {
    (count + LANES).next_multiple_of(WIDE)
}
