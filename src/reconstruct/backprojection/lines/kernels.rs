//! The loops over sixteen columns at once.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

use super::nodes::Needed;
use crate::reconstruct::numerics::Taps;
use crate::wave::simd::fused::{fused, plus_product, product};
use crate::wave::simd::{LANES, Lanes, ROWS, dispatched};
use num_complex::Complex32;
use std::ops::Range;

/// The most nodes along a coordinate that a place is made of.
pub(crate) const MOST_TAPS: usize = 16;

/// Steps between two nodes at which weights are known; between these they are interpolated.
const STEPS: usize = 1024;

/// Where a row of voxels lies among the nodes.
#[derive(Debug, Clone, Default)]
pub(crate) struct Places {
    /// Pitches after the place whose nodes begin with the first, along ρ and along the path.
    pub(crate) rho: Vec<f64>,
    pub(crate) path: Vec<f64>,
    /// The carrier's path back, m.
    pub(crate) back: Vec<f64>,
}

impl Places {
    /// Makes room for so many.
    pub(crate) fn resize(&mut self, count: usize) {
        for places in [&mut self.rho, &mut self.path, &mut self.back] {
            places.resize(count, 0.0);
        }
    }
}

#[inline(always)]
fn places_body(
    [first, pitch]: [f64; 2],
    [line, height, aside]: [f64; 3],
    [source, over_source]: [f64; 2],
    [along_rho, along_path]: [[f64; 2]; 2],
    found: &mut Places,
) {
    let Places { rho, path, back } = found;
    for (i, ((rho, path), back)) in rho.iter_mut().zip(path).zip(back).enumerate() {
        // i is far below 2³², and such integers become numbers in vector registers.
        let y = first + pitch * f64::from(i as u32);
        let square = (y - line) * (y - line) + height;
        *back = (square + aside).sqrt();
        let out = ((y - source) * (y - source) + over_source).sqrt();
        *rho = (square.sqrt() - along_rho[0]) * along_rho[1];
        *path = (out + *back - along_path[0]) * along_path[1];
    }
}

dispatched! {
    /// Where the rows from `first` on lie among the nodes of a line. Lengths in m; of `height`, `aside` and `over_source`
    /// the squares.
    pub(crate) fn places = places_body(
        rows: [f64; 2], line: [f64; 3], source: [f64; 2], rulers: [[f64; 2]; 2], found: &mut Places,
    )
}

/// Weights of the nodes of a place, by how far it is after its own.
#[derive(Debug, Clone)]
pub(crate) struct TapTable {
    pub(crate) taps: usize,
    /// `[STEPS + 1, taps]`.
    weights: Vec<f32>,
}

impl TapTable {
    /// Of these taps, or of one node with a weight of 1.
    pub(crate) fn new(taps: Option<&Taps>) -> Self {
        let Some(taps) = taps else { return Self { taps: 1, weights: vec![1.0; STEPS + 1] } };
        let places: Vec<f64> = (0..=STEPS).map(|step| step as f64 / STEPS as f64).collect();
        let weights = taps.weights_of(&places);
        let of_step = |step: usize| weights.col_as_slice(step).iter().map(|w| *w as f32);
        Self { taps: taps.count(), weights: (0..=STEPS).flat_map(of_step).collect() }
    }

    /// Those of a place so far after its own node, 0 to 1 pitches.
    #[inline(always)]
    pub(crate) fn at(&self, fraction: f64, weights: &mut [f32; MOST_TAPS]) {
        let place = fraction * STEPS as f64;
        let step = (place as usize).min(STEPS - 1);
        let rest = (place - step as f64) as f32;
        let (low, high) = self.weights[step * self.taps..][..2 * self.taps].split_at(self.taps);
        for ((weight, low), high) in weights.iter_mut().zip(low).zip(high) {
            *weight = low + rest * (high - low);
        }
    }
}

#[inline(always)]
fn add_line_body<const FMA: bool>(
    (nodes, origins): (&[Lanes], &[isize]),
    found: &Places,
    [rho, path]: &[TapTable; 2],
    turns: &[Complex32],
    image: &mut [Lanes],
) {
    let (mut along_rho, mut along_path) = ([0.0; MOST_TAPS], [0.0; MOST_TAPS]);
    for (y, (voxels, turn)) in image.iter_mut().zip(turns).enumerate() {
        let (i, j) = (found.rho[y] as usize, found.path[y] as usize);
        rho.at(found.rho[y] - i as f64, &mut along_rho);
        path.at(found.path[y] - j as f64, &mut along_path);
        let (mut re, mut im) = ([0.0f32; LANES], [0.0f32; LANES]);
        for (origin, weight) in origins[i..i + rho.taps].iter().zip(&along_rho) {
            let nodes = &nodes[(origin + j as isize) as usize..][..path.taps];
            let (mut inner_re, mut inner_im) = ([0.0f32; LANES], [0.0f32; LANES]);
            for (node, w) in nodes.iter().zip(&along_path) {
                for l in 0..LANES {
                    inner_re[l] = fused::<FMA>(*w, node.re[l], inner_re[l]);
                }
                for l in 0..LANES {
                    inner_im[l] = fused::<FMA>(*w, node.im[l], inner_im[l]);
                }
            }
            for l in 0..LANES {
                re[l] = fused::<FMA>(*weight, inner_re[l], re[l]);
            }
            for l in 0..LANES {
                im[l] = fused::<FMA>(*weight, inner_im[l], im[l]);
            }
        }
        for l in 0..LANES {
            voxels.re[l] = fused::<FMA>(re[l], turn.re, fused::<FMA>(-im[l], turn.im, voxels.re[l]));
        }
        for l in 0..LANES {
            voxels.im[l] = fused::<FMA>(re[l], turn.im, fused::<FMA>(im[l], turn.re, voxels.im[l]));
        }
    }
}

dispatched! {
    /// Adds a line's image to a row of voxels, whose places among the nodes are `found`; `turns` are the carrier's. For every
    /// node along ρ an origin tells where the first along the path would be.
    ///
    /// Cost: 64 operations per node that a voxel is made of, for sixteen columns.
    pub(crate) fn add_line = fused add_line_body(
        nodes: (&[Lanes], &[isize]), found: &Places, tables: &[TapTable; 2], turns: &[Complex32], image: &mut [Lanes],
    )
}

/// Nodes at one ρ from every line.
#[derive(Debug, Clone, Default)]
pub(crate) struct Ring {
    /// For each line, which nodes along the path they are: a multiple of [`ROWS`].
    pub(crate) paths: Vec<Range<usize>>,
}

impl Ring {
    /// The nodes at one ρ that lines need.
    pub(crate) fn of(lines: &[Needed], i: usize) -> Self {
        Self { paths: lines.iter().map(|line| line.get(i).cloned().unwrap_or(0..0)).collect() }
    }

    /// How many there are.
    pub(crate) fn len(&self) -> usize {
        self.paths.iter().map(Range::len).sum()
    }

    /// The nodes along the path that any line has.
    pub(crate) fn all(&self) -> Option<Range<usize>> {
        let own = self.paths.iter().filter(|paths| !paths.is_empty());
        own.cloned().reduce(|a, b| a.start.min(b.start)..a.end.max(b.end))
    }
}

/// For each of [`ROWS`] lines the sum of its samples times the microphones' phasors, W columns at a time.
#[inline(always)]
fn sums_of_lines<const FMA: bool, const W: usize>(
    microphones: &[Lanes],
    samples: &[[Complex32; ROWS]],
) -> [Lanes; ROWS] {
    let mut sums = [Lanes::ZERO; ROWS];
    for first in (0..LANES).step_by(W) {
        // One array for each line: the compiler treats an array of them as a matrix, and scatters it.
        let zeros = ([0.0f32; W], [0.0f32; W]);
        let (mut a, mut b, mut c, mut d) = (zeros, zeros, zeros, zeros);
        for (phasors, samples) in microphones.iter().zip(samples) {
            for l in 0..W {
                let phasor = phasors.at(first + l);
                let add = |(re, im): &mut ([f32; W], [f32; W]), sample: Complex32| {
                    let sum = plus_product::<FMA>(Complex32::new(re[l], im[l]), sample, phasor);
                    (re[l], im[l]) = (sum.re, sum.im);
                };
                add(&mut a, samples[0]);
                add(&mut b, samples[1]);
                add(&mut c, samples[2]);
                add(&mut d, samples[3]);
            }
        }
        for (sums, (re, im)) in sums.iter_mut().zip([a, b, c, d]) {
            sums.re[first..first + W].copy_from_slice(&re);
            sums.im[first..first + W].copy_from_slice(&im);
        }
    }
    sums
}

#[inline(always)]
fn add_tone_body<const FMA: bool, const W: usize>(
    microphones: &[Lanes],
    (outward, first): (&[Lanes], usize),
    samples: &[Complex32],
    carrier: Complex32,
    (ring, mut nodes): (&Ring, &mut [Lanes]),
) {
    let samples = samples.as_chunks::<ROWS>().0.chunks_exact(microphones.len());
    for (paths, samples) in ring.paths.chunks(ROWS).zip(samples) {
        let mut sums = sums_of_lines::<FMA, W>(microphones, samples);
        for (sum, paths) in sums.iter_mut().zip(paths) {
            for l in 0..LANES {
                let turned = product::<FMA>(sum.at(l), carrier);
                (sum.re[l], sum.im[l]) = (turned.re, turned.im);
            }
            let (own, rest) = nodes.split_at_mut(paths.len());
            nodes = rest;
            let outward = outward[paths.start.saturating_sub(first)..].as_chunks::<ROWS>().0;
            for (nodes, turns) in own.as_chunks_mut::<ROWS>().0.iter_mut().zip(outward) {
                for l in 0..LANES {
                    for row in 0..ROWS {
                        let node = plus_product::<FMA>(nodes[row].at(l), turns[row].at(l), sum.at(l));
                        (nodes[row].re[l], nodes[row].im[l]) = (node.re, node.im);
                    }
                }
            }
        }
    }
}

dispatched! {
    /// Adds one tone of all lines to their nodes at one ρ: the sum over `microphones`, turned by their phasors, times
    /// those of the path out, which begin with some node, and the carrier's.
    ///
    /// `samples` are `[line, microphone, line]`, [`ROWS`] lines together, and each line has so many nodes or a multiple.
    /// Cost: 128 operations per microphone and per node.
    pub(crate) fn add_tone = fused add_tone_body by [LANES, 8](
        microphones: &[Lanes], outward: (&[Lanes], usize), samples: &[Complex32], carrier: Complex32,
        nodes: (&Ring, &mut [Lanes]),
    )
}

#[inline(always)]
fn turn_body<const FMA: bool>(turns: &[Lanes], image: &mut [Lanes]) {
    for (turn, voxels) in turns.iter().zip(image) {
        let Lanes { re, im } = *voxels;
        for l in 0..LANES {
            voxels.re[l] = fused::<FMA>(re[l], turn.re[l], -im[l] * turn.im[l]);
        }
        for l in 0..LANES {
            voxels.im[l] = fused::<FMA>(re[l], turn.im[l], im[l] * turn.re[l]);
        }
    }
}

dispatched! {
    /// Multiplies numbers by phasors, lane by lane.
    pub(crate) fn turn = fused turn_body(turns: &[Lanes], image: &mut [Lanes])
}
