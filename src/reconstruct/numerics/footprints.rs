//! Samples of microphones added to the nodes of a lattice, and by the adjoint nodes' gathered for the microphones.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

use super::nodes::AxisWeights;
use crate::wave::simd::fused::fused;
use crate::wave::simd::{LANES, dispatched};
use num_complex::Complex32;
use rayon::prelude::*;

/// Microphones whose footprints one thread computes at a time.
const AT_ONCE: usize = 64;

/// Bytes that an allocator takes for itself with every small vector.
const ALLOCATION: usize = 16;

/// Of every microphone the nodes that it goes to, and their weights along x and y.
#[derive(Debug)]
pub(crate) enum Footprints {
    /// Of each by itself, and how many nodes a row has.
    Scattered([AxisWeights; 2], usize),
    /// Of those at all x at every y, `[y, x]`.
    InRows(FootprintRows),
}

/// Footprints of microphones in rows.
#[derive(Debug)]
pub(crate) struct FootprintRows {
    /// In numbers of a row: each weight twice, for both parts of a node, in whole vectors.
    x: AxisWeights,
    /// In rows of nodes.
    y: AxisWeights,
    /// Numbers of a row of nodes.
    width: usize,
}

impl Footprints {
    /// Of microphones at these places along x and y, m: of all `[y, x]`, or of each with its own. `along` tells the first node
    /// of places along an axis, of which `n_x` are in a row, and the weights from there on.
    pub(crate) fn new(
        [x, y]: [&[f64]; 2],
        in_rows: bool,
        n_x: usize,
        along: impl Fn(usize, &[f64]) -> Vec<(usize, Vec<f64>)> + Sync,
    ) -> Self {
        let of = |axis: usize, places: &[f64]| -> AxisWeights {
            let all: Vec<_> = places.par_chunks(AT_ONCE).flat_map_iter(|some| along(axis, some)).collect();
            AxisWeights::new(all.into_iter())
        };
        let (x, y) = (of(0, x), of(1, y));
        if in_rows {
            Self::InRows(FootprintRows { x: x.of_both_parts().in_vectors(), y, width: 2 * n_x })
        } else {
            Self::Scattered([x, y], n_x)
        }
    }

    /// Bytes of them for so many places along x and y, these included, that go to so many nodes each: footprints are collected
    /// by doubling, each with a vector of weights, before they are put together.
    pub(crate) fn bytes(taps: [usize; 2], places: [usize; 2]) -> u64 {
        let along = |axis: usize| {
            let weights = size_of::<f64>() * taps[axis] + ALLOCATION;
            let together = 2 * size_of::<f32>() * (taps[axis] + LANES);
            let each = size_of::<f64>() + 3 * size_of::<(usize, Vec<f64>)>() + weights + together;
            (each as u64).saturating_mul(places[axis] as u64)
        };
        along(0).saturating_add(along(1))
    }

    /// How many microphones there are.
    pub(crate) fn microphones(&self) -> usize {
        match self {
            Self::Scattered([x, _], _) => x.len(),
            Self::InRows(rows) => rows.x.len() * rows.y.len(),
        }
    }

    /// Adds the samples of all microphones to a plane of nodes `[n_y, n_x]`; `row` is reused.
    pub(crate) fn spread(&self, samples: &[Complex32], row: &mut Vec<f32>, plane: &mut [Complex32]) {
        match self {
            Self::Scattered([x, y], n_x) => {
                for (m, sample) in samples.iter().enumerate() {
                    let ((first_x, weights_x), (first_y, weights_y)) = (x.of(m), y.of(m));
                    for (k, weight) in weights_y.iter().enumerate() {
                        let nodes = &mut plane[(first_y + k) * n_x + first_x..][..weights_x.len()];
                        let weighted = sample * weight;
                        nodes.iter_mut().zip(weights_x).for_each(|(node, weight)| *node += weighted * weight);
                    }
                }
            }
            Self::InRows(rows) => {
                row.resize(rows.room(), 0.0);
                spread(rows, samples, row, bytemuck::cast_slice_mut(plane));
            }
        }
    }

    /// The adjoint: sets the samples of all microphones to what a plane of nodes `[n_y, n_x]` has for them.
    pub(crate) fn gather(&self, plane: &[Complex32], row: &mut Vec<f32>, samples: &mut [Complex32]) {
        match self {
            Self::Scattered([x, y], n_x) => {
                for (m, sample) in samples.iter_mut().enumerate() {
                    let ((first_x, weights_x), (first_y, weights_y)) = (x.of(m), y.of(m));
                    let of_row = |(k, weight): (usize, &f32)| {
                        let nodes = &plane[(first_y + k) * n_x + first_x..][..weights_x.len()];
                        nodes.iter().zip(weights_x).map(|(node, weight)| node * weight).sum::<Complex32>()
                            * weight
                    };
                    *sample = weights_y.iter().enumerate().map(of_row).sum();
                }
            }
            Self::InRows(rows) => {
                row.resize(rows.room(), 0.0);
                gather(rows, bytemuck::cast_slice(plane), row, samples);
            }
        }
    }
}

impl FootprintRows {
    /// Numbers of a row of nodes, and of vectors of weights that reach beyond its end.
    fn room(&self) -> usize {
        self.width + self.x.taps()
    }
}

#[inline(always)]
fn spread_body<const FMA: bool>(
    rows: &FootprintRows,
    samples: &[Complex32],
    row: &mut [f32],
    plane: &mut [f32],
) {
    let FootprintRows { x, y, width } = rows;
    for (iy, samples) in samples.chunks_exact(x.len()).enumerate() {
        row.fill(0.0);
        for (ix, sample) in samples.iter().enumerate() {
            let in_turn: [f32; LANES] =
                std::array::from_fn(|l| if l % 2 == 0 { sample.re } else { sample.im });
            let (first, weights) = x.of(ix);
            let numbers = row[first..][..weights.len()].as_chunks_mut::<LANES>().0;
            for (numbers, weights) in numbers.iter_mut().zip(weights.as_chunks::<LANES>().0) {
                for l in 0..LANES {
                    numbers[l] = fused::<FMA>(in_turn[l], weights[l], numbers[l]);
                }
            }
        }
        let (first, weights) = y.of(iy);
        for (nodes, weight) in plane[first * width..].chunks_exact_mut(*width).zip(weights) {
            nodes
                .iter_mut()
                .zip(&*row)
                .for_each(|(node, number)| *node = fused::<FMA>(*weight, *number, *node));
        }
    }
}

#[inline(always)]
fn gather_body<const FMA: bool>(
    rows: &FootprintRows,
    plane: &[f32],
    row: &mut [f32],
    samples: &mut [Complex32],
) {
    let FootprintRows { x, y, width } = rows;
    for (iy, samples) in samples.chunks_exact_mut(x.len()).enumerate() {
        row.fill(0.0);
        let (first, weights) = y.of(iy);
        for (nodes, weight) in plane[first * width..].chunks_exact(*width).zip(weights) {
            row.iter_mut()
                .zip(nodes)
                .for_each(|(number, node)| *number = fused::<FMA>(*weight, *node, *number));
        }
        for (ix, sample) in samples.iter_mut().enumerate() {
            let (first, weights) = x.of(ix);
            let mut lanes = [0.0f32; LANES];
            let numbers = row[first..][..weights.len()].as_chunks::<LANES>().0;
            for (numbers, weights) in numbers.iter().zip(weights.as_chunks::<LANES>().0) {
                for l in 0..LANES {
                    lanes[l] = fused::<FMA>(numbers[l], weights[l], lanes[l]);
                }
            }
            *sample = lanes.chunks_exact(2).map(|part| Complex32::new(part[0], part[1])).sum();
        }
    }
}

dispatched! {
    /// [`Footprints::spread`] of microphones in rows.
    fn spread = fused spread_body(rows: &FootprintRows, samples: &[Complex32], row: &mut [f32], plane: &mut [f32])
}

dispatched! {
    /// [`Footprints::gather`] for microphones in rows.
    fn gather = fused gather_body(rows: &FootprintRows, plane: &[f32], row: &mut [f32], samples: &mut [Complex32])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers between −1/2 and 1/2.
    fn numbers(count: usize, step: f64) -> Vec<Complex32> {
        let part = |i: usize, step: f64| ((i as f64 * step).fract() - 0.5) as f32;
        (0..count).map(|i| Complex32::new(part(i, step), part(i + 7, 0.754_878))).collect()
    }

    /// Places from 0 on that go to `taps` nodes from some node on, the last of them to the last node.
    fn along(taps: usize, nodes: usize, places: &[f64]) -> Vec<(usize, Vec<f64>)> {
        let first = |place: f64| (place * (nodes - taps) as f64).round() as usize;
        let weights = |place: f64| (0..taps).map(|a| (place * 3.7 + a as f64).sin()).collect();
        places.iter().map(|place| (first(*place), weights(*place))).collect()
    }

    #[test]
    fn samples_go_to_their_nodes_and_back_by_the_adjoint() {
        for (taps, nodes) in [([1, 1], [5, 4]), ([6, 4], [9, 7]), ([12, 10], [40, 13]), ([22, 18], [22, 30])]
        {
            for (in_rows, n_mic) in [(true, 5 * 4), (false, 11)] {
                let places = |count: usize| -> Vec<f64> {
                    (0..count)
                        .map(|i| if i + 1 == count { 1.0 } else { (i as f64 * 0.618).fract() })
                        .collect()
                };
                let [x, y] = if in_rows { [places(5), places(4)] } else { [places(n_mic), places(n_mic)] };
                let of = |axis: usize, places: &[f64]| along(taps[axis], nodes[axis], places);
                let footprints = Footprints::new([&x, &y], in_rows, nodes[0], of);
                assert_eq!(footprints.microphones(), n_mic);
                let (samples, plane) = (numbers(n_mic, 0.618), numbers(nodes[0] * nodes[1], 0.569_84));
                // Literally, sample by sample and node by node.
                let (mut wanted, mut wanted_back) = (plane.clone(), vec![Complex32::ZERO; n_mic]);
                let ([of_x, of_y], columns) = ([of(0, &x), of(1, &y)], if in_rows { 5 } else { n_mic });
                for m in 0..n_mic {
                    let (a, b) = (&of_x[m % columns], &of_y[if in_rows { m / columns } else { m }]);
                    for (j, w_y) in b.1.iter().enumerate() {
                        for (i, w_x) in a.1.iter().enumerate() {
                            let (node, weight) = ((b.0 + j) * nodes[0] + a.0 + i, (w_x * w_y) as f32);
                            wanted[node] += samples[m] * weight;
                            wanted_back[m] += plane[node] * weight;
                        }
                    }
                }
                let (mut row, mut found, mut back) = (Vec::new(), plane.clone(), vec![Complex32::ONE; n_mic]);
                footprints.spread(&samples, &mut row, &mut found);
                footprints.gather(&plane, &mut row, &mut back);
                for (found, wanted) in found.iter().zip(&wanted).chain(back.iter().zip(&wanted_back)) {
                    assert!(
                        (found - wanted).norm() < 2e-5,
                        "{taps:?} {nodes:?} {in_rows}: {found}, {wanted}"
                    );
                }
            }
        }
    }
}
