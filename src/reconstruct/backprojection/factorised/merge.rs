//! Places from the nodes of several tiles: along y, along x, then along ρ, where each has a place of its own.
//!
//! The places are voxels, or nodes of a tile that is made of smaller ones. Either way they stand in columns above one
//! (x, y) each, which is interpolated at constant ρ; along a column every place then has its own weights.

#![allow(clippy::inline_always)]

use super::frame::Frame;
use super::held::{FilledNodes, Hulls, PlaceColumns, TileNodes, common, hull, whole_vector};
use super::nodes::TileLattice;
use super::zones::Zone;
use crate::reconstruct::numerics::{AxisWeights, IntervalNodes, Taps, padded_width};
use crate::wave::simd::fused::{fused, polynomial};
use crate::wave::simd::rows::{WIDE, aligned, aligned_mut, weighted_rows};
use crate::wave::simd::{LANES, Lanes, dispatched, lane_sums, phasors};
use num_complex::Complex32;
use std::ops::Range;

/// Pieces of the table of weights from one node along ρ to the next, of a cubic each, which errs by
/// `(π/32)⁴/3072 ≈ 3·10⁻⁸` at most.
const PIECES: usize = 32;

/// How places in columns follow from the nodes of tiles of one size.
#[derive(Debug)]
pub(crate) struct Merge<'a> {
    lattice: &'a TileLattice,
    /// f_c/c, 1/m.
    carrier: f64,
    /// The columns, m.
    columns: [Vec<f64>; 2],
    /// Along x and y, those of every zone.
    zones: Vec<[AxisWeights; 2]>,
    /// Weights along ρ as cubics of a piece each, padded with zeros; one table for each vector of them.
    tables: Vec<Vec<[[f32; LANES]; 4]>>,
}

impl<'a> Merge<'a> {
    pub(crate) fn new(lattice: &'a TileLattice, columns: [Vec<f64>; 2], carrier: f64) -> Self {
        let of_zone = |zone: &Zone| {
            let of_axis = |axis: usize| zone.nodes[axis].weights_of(&columns[axis]);
            [0, 1].map(|axis| AxisWeights::new(of_axis(axis).into_iter()))
        };
        let (zones, tables) = (lattice.zones.iter().map(of_zone).collect(), tables(&lattice.taps));
        Self { lattice, carrier, columns, zones, tables }
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

    /// What places need of a tile, of every zone.
    pub(crate) fn needs(&self, frame: Frame, places: &impl PlaceColumns) -> Vec<TileNodes> {
        let of_row = |y: usize| -> Vec<Range<usize>> {
            let needs = |x: usize| self.column_needs(&frame, [x, y], places.ends(x, y));
            (0..self.columns[0].len()).map(needs).collect()
        };
        let of_rows: Vec<Vec<Range<usize>>> = (0..self.columns[1].len()).map(of_row).collect();
        (0..self.zones.len()).map(|zone| self.zone_needs(frame, zone, &of_rows)).collect()
    }

    /// The same of one zone, of what columns `[y, x]` need of all.
    fn zone_needs(&self, frame: Frame, zone: usize, of_rows: &[Vec<Range<usize>>]) -> TileNodes {
        let [nodes_x, nodes_y] = self.lattice.zones[zone].nodes.each_ref().map(IntervalNodes::len);
        let (along, [of_x, of_y]) = (self.lattice.along_zone(zone), &self.zones[zone]);
        let mut needed = Hulls::none(nodes_x * nodes_y);
        for (y, needs) in of_rows.iter().enumerate() {
            let mut row = Hulls::none(nodes_x);
            for (x, needs) in needs.iter().enumerate() {
                let (first, weights) = of_x.of(x);
                row.widen(first..first + weights.len(), &common(needs.clone(), &along));
            }
            let (first, weights) = of_y.of(y);
            (first..first + weights.len()).for_each(|y| needed.widen_each(y * nodes_x, &row));
        }
        let needed = needed.ranges();
        let mut held = needed.iter().cloned().fold(0..0, hull);
        held.start = whole_vector(held.start);
        held.end = held.start + held.len().next_multiple_of(LANES);
        TileNodes { frame, zone, held, needed }
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
        let mut rows = std::mem::take(&mut buffers.rows);
        rows.resize_with(tiles.len(), TileRows::default);
        let ends = |y: usize| -> Vec<_> { (0..self.columns[0].len()).map(|x| places.ends(x, y)).collect() };
        let ends: Vec<Vec<_>> = ys.clone().map(ends).collect();
        let mut needs: Vec<Range<usize>> = Vec::new();
        for (tile, rows) in tiles.iter().zip(&mut rows) {
            let zone = tile.nodes.zone;
            if zone == 0 {
                needs.clear();
                for (y, ends) in ys.clone().zip(&ends) {
                    let ends = ends.iter().enumerate();
                    needs.extend(ends.map(|(x, ends)| self.column_needs(&tile.nodes.frame, [x, y], *ends)));
                }
            }
            let along = self.lattice.along_zone(zone);
            rows.needed = needs.iter().map(|needs| common(needs.clone(), &along)).fold(0..0, hull);
            if rows.needed.is_empty() {
                continue;
            }
            let (first_held, held) = (tile.nodes.held.start, tile.nodes.held.len());
            rows.needed.start = whole_vector(rows.needed.start);
            let nodes_x = self.lattice.zones[zone].nodes[0].len();
            let of_row = |y: usize| {
                let (first, weights) = self.zones[zone][1].of(y);
                (first * nodes_x * held + rows.needed.start - first_held, weights)
            };
            let of_rows: Vec<(usize, &[f32])> = ys.clone().map(of_row).collect();
            // Of a row that is read beyond its end the numbers there are not used, whatever they are.
            rows.width = rows.needed.len().next_multiple_of(WIDE);
            for (values, nodes) in rows.values.iter_mut().zip(&tile.values) {
                values.resize(nodes_x * ys.len() * rows.width + 2 * WIDE + LANES, 0.0);
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
            let zones = self.zones.len();
            for (tile, rows) in tiles.chunks_exact(zones).zip(rows.chunks_exact(zones)) {
                lengths.resize(depths.len(), 0.0);
                tile[0].nodes.frame.ranges(at, depths, lengths);
                let mut needed = self.between(lengths[0], lengths[lengths.len() - 1]);
                needed.start = whole_vector(needed.start);
                for column in columns.iter_mut() {
                    column.resize(padded_width(needed.len()) + WIDE, 0.0);
                }
                for (zone, rows) in rows.iter().enumerate() {
                    let own = common(needed.clone(), &self.lattice.along_zone(zone));
                    if own.is_empty() {
                        continue;
                    }
                    let (first_x, weights_x) = self.zones[zone][0].of(x);
                    let stride = all_rows * rows.width;
                    let from = first_x * stride + own_row * rows.width + own.start - rows.needed.start;
                    // What is beyond its end is the next zone's, or has no weight: vectors of these reach beyond a place's
                    // own taps.
                    let beyond = if own.end == needed.end { LANES } else { 0 };
                    let width = (own.len() + beyond).next_multiple_of(WIDE);
                    for (column, values) in columns.iter_mut().zip(&rows.values) {
                        let sums = &mut column[own.start - needed.start..][..width];
                        weighted_rows(&[(from, weights_x)], aligned(values), stride, sums);
                    }
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

/// What places in some rows are made of, of one zone of one tile: its nodes interpolated along y.
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
