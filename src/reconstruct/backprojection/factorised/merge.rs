//! Places from the nodes of several tiles: along y, along x, then along ρ, where each has a place of its own.
//!
//! The places are voxels, or nodes of a tile that is made of smaller ones. Either way they stand in columns above one
//! (x, y) each, which is interpolated at constant ρ; along a column every place then has its own weights.

#![allow(clippy::inline_always)]

use super::frame::Frame;
use super::held::{FilledNodes, TileNodes, hull};
use super::nodes::TileLattice;
use crate::reconstruct::numerics::{AxisWeights, Taps, padded_width};
use crate::wave::simd::fused::{fused, polynomial};
use crate::wave::simd::rows::{WIDE, aligned, aligned_mut, weighted_rows};
use crate::wave::simd::{LANES, Lanes, dispatched, lane_sums, phasors};
use num_complex::Complex32;
use std::ops::Range;

/// Pieces of the table of weights from one node along ρ to the next, of a cubic each, which errs by
/// `(π/32)⁴/3072 ≈ 3·10⁻⁸` at most.
const PIECES: usize = 32;

/// Places in columns, each from near to far.
pub(crate) trait PlaceColumns: Sync {
    /// Depths of the first and the last place in a column, m; `None` where it has none.
    fn ends(&self, x: usize, y: usize) -> Option<[f64; 2]>;

    /// Depths of all places in a column, m, and what their own ranges are, if they have any.
    fn fill(&self, x: usize, y: usize, depths: &mut Vec<f64>, ranges: &mut Vec<f64>);
}

/// The same depths in every column.
pub(crate) struct DepthColumns(pub(crate) Vec<f64>);

impl PlaceColumns for DepthColumns {
    fn ends(&self, _: usize, _: usize) -> Option<[f64; 2]> {
        Some([*self.0.first()?, *self.0.last()?])
    }

    fn fill(&self, _: usize, _: usize, depths: &mut Vec<f64>, ranges: &mut Vec<f64>) {
        depths.clone_from(&self.0);
        ranges.clear();
    }
}

/// The nodes of a tile that are needed.
pub(crate) struct NodeColumns<'a> {
    pub(crate) lattice: &'a TileLattice,
    pub(crate) nodes: &'a TileNodes,
}

impl NodeColumns<'_> {
    fn at(&self, x: usize, y: usize) -> ([f64; 2], Range<usize>) {
        let [nodes_x, nodes_y] = &self.lattice.nodes;
        ([nodes_x.places()[x], nodes_y.places()[y]], self.nodes.needed[y * nodes_x.len() + x].clone())
    }
}

impl PlaceColumns for NodeColumns<'_> {
    fn ends(&self, x: usize, y: usize) -> Option<[f64; 2]> {
        let (at, needed) = self.at(x, y);
        (!needed.is_empty()).then(|| {
            let mut ends = [0.0; 2];
            let ranges = [needed.start, needed.end - 1].map(|k| self.lattice.pitch * k as f64);
            self.nodes.frame.depths(at, &ranges, &mut ends);
            ends
        })
    }

    fn fill(&self, x: usize, y: usize, depths: &mut Vec<f64>, ranges: &mut Vec<f64>) {
        let (at, needed) = self.at(x, y);
        ranges.clear();
        ranges.extend(needed.map(|k| self.lattice.pitch * k as f64));
        depths.resize(ranges.len(), 0.0);
        self.nodes.frame.depths(at, ranges, depths);
    }
}

/// How places in columns follow from the nodes of tiles of one size.
#[derive(Debug)]
pub(crate) struct Merge<'a> {
    lattice: &'a TileLattice,
    /// f_c/c, 1/m.
    carrier: f64,
    /// The columns, m.
    columns: [Vec<f64>; 2],
    x: AxisWeights,
    y: AxisWeights,
    /// Weights along ρ as cubics of a piece each, padded with zeros; one table for each vector of them.
    tables: Vec<Vec<[[f32; LANES]; 4]>>,
}

impl<'a> Merge<'a> {
    pub(crate) fn new(lattice: &'a TileLattice, columns: [Vec<f64>; 2], carrier: f64) -> Self {
        let weights =
            |axis: usize| AxisWeights::new(lattice.nodes[axis].weights_of(&columns[axis]).into_iter());
        let (x, y, tables) = (weights(0), weights(1), tables(&lattice.taps));
        Self { lattice, carrier, columns, x, y, tables }
    }

    /// Nodes along ρ that places between these two ranges are made of.
    fn between(&self, nearest: f64, farthest: f64) -> Range<usize> {
        self.lattice.along_range(nearest).0..self.lattice.along_range(farthest).0 + self.lattice.taps.count()
    }

    /// Nodes along ρ that a column of places is made of whose first and last are at these depths.
    fn column_needs(&self, frame: &Frame, [x, y]: [usize; 2], ends: Option<[f64; 2]>) -> Range<usize> {
        ends.map_or(0..0, |ends| {
            let mut ranges = [0.0; 2];
            frame.ranges([self.columns[0][x], self.columns[1][y]], &ends, &mut ranges);
            self.between(ranges[0], ranges[1])
        })
    }

    /// What places need of a tile.
    pub(crate) fn needs(&self, frame: Frame, places: &impl PlaceColumns) -> TileNodes {
        let [nodes_x, nodes_y] = [0, 1].map(|axis: usize| self.lattice.nodes[axis].len());
        let mut needed = vec![0..0; nodes_x * nodes_y];
        for y in 0..self.columns[1].len() {
            let mut row = vec![0..0; nodes_x];
            for x in 0..self.columns[0].len() {
                let needs = self.column_needs(&frame, [x, y], places.ends(x, y));
                let (first, weights) = self.x.of(x);
                row[first..first + weights.len()]
                    .iter_mut()
                    .for_each(|node| *node = hull(node.clone(), needs.clone()));
            }
            let (first, weights) = self.y.of(y);
            for column in needed[first * nodes_x..].chunks_exact_mut(nodes_x).take(weights.len()) {
                column
                    .iter_mut()
                    .zip(&row)
                    .for_each(|(node, needs)| *node = hull(node.clone(), needs.clone()));
            }
        }
        let mut held = needed.iter().cloned().fold(0..0, hull);
        held.end = held.start + held.len().next_multiple_of(LANES);
        TileNodes { frame, held, needed }
    }

    /// Sums rows of columns over tiles; `done` takes the row, the index of each column in it that has places, and its sums.
    ///
    /// Neighbouring rows are made of almost the same nodes, which are read once for [`ROWS`] of them.
    pub(crate) fn rows(
        &self,
        tiles: &[FilledNodes<'_>],
        places: &impl PlaceColumns,
        ys: Range<usize>,
        buffers: &mut RowBuffers,
        mut done: impl FnMut([usize; 2], &[f32], &[f32]),
    ) {
        let nodes_x = self.lattice.nodes[0].len();
        let mut rows = std::mem::take(&mut buffers.rows);
        rows.resize_with(tiles.len(), TileRows::default);
        let ends = |y: usize| -> Vec<_> { (0..self.columns[0].len()).map(|x| places.ends(x, y)).collect() };
        let ends: Vec<Vec<_>> = ys.clone().map(ends).collect();
        for (tile, rows) in tiles.iter().zip(&mut rows) {
            let needs = ys.clone().zip(&ends).flat_map(|(y, ends)| {
                let needs =
                    move |(x, ends): (usize, &Option<_>)| self.column_needs(&tile.nodes.frame, [x, y], *ends);
                ends.iter().enumerate().map(needs)
            });
            rows.needed = needs.fold(0..0, hull);
            if rows.needed.is_empty() {
                continue;
            }
            let (first_held, held) = (tile.nodes.held.start, tile.nodes.held.len());
            rows.needed.start = from_vector(rows.needed.start, first_held);
            let of_row = |y: usize| {
                let (first, weights) = self.y.of(y);
                (first * nodes_x * held + rows.needed.start - first_held, weights)
            };
            let of_rows: Vec<(usize, &[f32])> = ys.clone().map(of_row).collect();
            // Vectors of weights reach beyond a place's own taps, where they are zero.
            rows.width = padded_width(rows.needed.len());
            for (values, nodes) in rows.values.iter_mut().zip(&tile.values) {
                values.resize(nodes_x * ys.len() * rows.width + WIDE + LANES, 0.0);
                let columns = aligned_mut(values).chunks_exact_mut(ys.len() * rows.width).take(nodes_x);
                for (x, sums) in columns.enumerate() {
                    weighted_rows(&of_rows, &nodes[x * held..], nodes_x * held, sums);
                }
            }
        }
        if !tiles.is_empty() {
            for (i, y) in ys.clone().enumerate() {
                self.row((tiles, &rows), places, (y, [i, ys.len()]), buffers, |x, re, im| {
                    done([x, y], re, im);
                });
            }
        }
        buffers.rows = rows;
    }

    /// Sums the columns of one row, of those that were interpolated along y together, over tiles.
    fn row(
        &self,
        (tiles, rows): (&[FilledNodes<'_>], &[TileRows]),
        places: &impl PlaceColumns,
        (y, [own_row, all_rows]): (usize, [usize; 2]),
        buffers: &mut RowBuffers,
        mut done: impl FnMut(usize, &[f32], &[f32]),
    ) {
        let RowBuffers { columns, depths, own, lengths, places: along, turns, sums, whole, .. } = buffers;
        for x in 0..self.columns[0].len() {
            places.fill(x, y, depths, own);
            if depths.is_empty() {
                continue;
            }
            sums.clear();
            sums.resize(depths.len().next_multiple_of(LANES), Lanes::ZERO);
            let at = [self.columns[0][x], self.columns[1][y]];
            let (first_x, weights_x) = self.x.of(x);
            for (tile, rows) in tiles.iter().zip(rows) {
                lengths.resize(depths.len(), 0.0);
                tile.nodes.frame.ranges(at, depths, lengths);
                let mut needed = self.between(lengths[0], lengths[lengths.len() - 1]);
                needed.start = from_vector(needed.start, rows.needed.start);
                let width = padded_width(needed.len());
                let stride = all_rows * rows.width;
                let from = first_x * stride + own_row * rows.width + needed.start - rows.needed.start;
                for (column, values) in columns.iter_mut().zip(&rows.values) {
                    column.resize(width, 0.0);
                    weighted_rows(&[(from, weights_x)], aligned(values), stride, column);
                }
                let before = needed.start as f64 - self.lattice.taps.first() as f64;
                along.clear();
                along.extend(lengths.iter().map(|length| length / self.lattice.pitch - before));
                lengths.iter_mut().zip(own.iter()).for_each(|(length, own)| *length -= own);
                turns.resize(depths.len(), Complex32::ZERO);
                phasors(-self.carrier, lengths, turns);
                along_column(&self.tables, [&columns[0], &columns[1]], (along, turns), sums);
            }
            for part in whole.iter_mut() {
                part.clear();
            }
            let (tiles_of_sums, _) = sums.as_chunks::<LANES>();
            for sums in tiles_of_sums {
                let sum = lane_sums(sums);
                whole[0].extend(sum.re);
                whole[1].extend(sum.im);
            }
            done(x, &whole[0][..depths.len()], &whole[1][..depths.len()]);
        }
    }
}

/// The node that the vector with this one begins with, of those that follow each other from `first` on.
fn from_vector(node: usize, first: usize) -> usize {
    node - (node - first) % LANES
}

/// Weights along ρ in each piece of the way between two nodes, as coefficients of powers of the place in it: those of every
/// vector of taps.
fn tables(taps: &Taps) -> Vec<Vec<[[f32; LANES]; 4]>> {
    // Through Chebyshev's points, by divided differences.
    let at: [f64; 4] =
        std::array::from_fn(|k| 0.5 - 0.5 * (std::f64::consts::PI * (2 * k + 1) as f64 / 8.0).cos());
    // One more piece than a place can lie in, since rounding may put it on the next node.
    let pieces = 0..=PIECES;
    let places: Vec<f64> =
        pieces.clone().flat_map(|piece| at.map(|t| (piece as f64 + t) / PIECES as f64)).collect();
    let weights = taps.weights_of(&places);
    let cubic = |piece: usize, first: usize| {
        let mut coefficients = [[0.0; LANES]; 4];
        for a in 0..(taps.count() - first).min(LANES) {
            let values = std::array::from_fn(|k| weights[(first + a, 4 * piece + k)]);
            coefficients.iter_mut().zip(powers(&at, values)).for_each(|(row, power)| row[a] = power as f32);
        }
        coefficients
    };
    let table = |first: usize| pieces.clone().map(|piece| cubic(piece, first)).collect();
    (0..taps.count()).step_by(LANES).map(table).collect()
}

/// The coefficients of the cubic with these values at four places.
fn powers(at: &[f64; 4], mut differences: [f64; 4]) -> [f64; 4] {
    for order in 1..4 {
        for k in (order..4).rev() {
            differences[k] = (differences[k] - differences[k - 1]) / (at[k] - at[k - order]);
        }
    }
    // Newton's form to powers.
    let mut powers = [0.0; 4];
    for k in (0..4).rev() {
        let before = powers;
        for j in 0..4 {
            let lower: f64 = if j > 0 { before[j - 1] } else { differences[k] };
            powers[j] = lower - at[k] * before[j];
        }
    }
    powers
}

/// Rows that are interpolated along y together.
pub(crate) const ROWS: usize = 4;

/// What places in some rows are made of, of one tile: its nodes interpolated along y.
#[derive(Debug, Default)]
struct TileRows {
    /// Nodes along ρ, those of all rows.
    needed: Range<usize>,
    /// Numbers from one row to the next.
    width: usize,
    /// Real and imaginary parts, `[x, row, ρ]`.
    values: [Vec<f32>; 2],
}

/// What a thread needs for [`Merge::rows`].
#[derive(Debug, Default)]
pub(crate) struct RowBuffers {
    /// Of each tile.
    rows: Vec<TileRows>,
    columns: [Vec<f32>; 2],
    depths: Vec<f64>,
    own: Vec<f64>,
    lengths: Vec<f64>,
    places: Vec<f64>,
    turns: Vec<Complex32>,
    /// Each place in as many partial sums as there are lanes.
    sums: Vec<Lanes>,
    whole: [Vec<f32>; 2],
}

#[inline(always)]
fn along_column_body<const FMA: bool>(
    tables: &[Vec<[[f32; LANES]; 4]>],
    [re, im]: [&[f32]; 2],
    along: (&[f64], &[Complex32]),
    sums: &mut [Lanes],
) {
    // Two at a time where there are as many, so that sums are read and turned once for both.
    for (i, tables) in tables.chunks(2).enumerate() {
        let column = [&re[2 * i * LANES..], &im[2 * i * LANES..]];
        match tables {
            [one] => by_tables::<FMA, 1>([one], column, along, sums),
            [one, other] => by_tables::<FMA, 2>([one, other], column, along, sums),
            _ => {}
        }
    }
}

#[inline(always)]
fn by_tables<const FMA: bool, const N: usize>(
    tables: [&[[[f32; LANES]; 4]]; N],
    [re, im]: [&[f32]; 2],
    (places, turns): (&[f64], &[Complex32]),
    sums: &mut [Lanes],
) {
    for (sum, (place, turn)) in sums.iter_mut().zip(places.iter().zip(turns)) {
        let own = *place as u32 as usize;
        let fine = (place - own as f64) * PIECES as f64;
        let piece = fine as u32 as usize;
        let t = (fine - piece as f64) as f32;
        let (mut made_re, mut made_im) = ([0.0f32; LANES], [0.0f32; LANES]);
        for (i, table) in tables.iter().enumerate() {
            let [c0, c1, c2, c3] = &table[piece];
            let first = own + i * LANES;
            let (re, im) = (&re[first..][..LANES], &im[first..][..LANES]);
            for l in 0..LANES {
                let w = polynomial::<FMA>(&[c0[l], c1[l], c2[l], c3[l]], t);
                made_re[l] = fused::<FMA>(w, re[l], made_re[l]);
                made_im[l] = fused::<FMA>(w, im[l], made_im[l]);
            }
        }
        // A sum and a turn of their own: otherwise the compiler, which does not know that they are apart, goes lane by lane.
        let (mut whole, turn) = (*sum, *turn);
        for l in 0..LANES {
            let (re, im) = (made_re[l], made_im[l]);
            whole.re[l] = fused::<FMA>(turn.re, re, fused::<FMA>(-turn.im, im, whole.re[l]));
            whole.im[l] = fused::<FMA>(turn.re, im, fused::<FMA>(turn.im, re, whole.im[l]));
        }
        *sum = whole;
    }
}

dispatched! {
    /// Adds to every sum `turn · w_a(place) column[place + a]`, one lane for every sixteenth a, with the weights of all tables.
    fn along_column = fused along_column_body(
        tables: &[Vec<[[f32; LANES]; 4]>], column: [&[f32]; 2], along: (&[f64], &[Complex32]), sums: &mut [Lanes],
    )
}
