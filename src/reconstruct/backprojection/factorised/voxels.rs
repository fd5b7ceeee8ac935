//! Voxels from the nodes of every tile: along y, along x, then along ρ, where each voxel has a place of its own.

#![allow(clippy::inline_always)]

use super::frame::Frame;
use super::nodes::TileLattice;
use crate::grid::Grid;
use crate::reconstruct::numerics::{AxisWeights, WIDE, weighted_rows};
use crate::wave::simd::{LANES, dispatched, phasors};
use num_complex::Complex32;
use std::ops::Range;

/// Entries of the table of weights from one node along ρ to the next; between them it is linear, which errs by
/// `(π/512)²/8` at most.
const ENTRIES: usize = 512;

/// The nodes of one tile, `[y, x, ρ]`, and what a voxel's column needs of them.
#[derive(Debug)]
pub(crate) struct TileNodes {
    pub(crate) frame: Frame,
    /// Nodes along ρ that are held, as multiples of the pitch.
    pub(crate) held: Range<usize>,
    /// Those that each column of nodes needs, `[y, x]`; the others stay zero.
    pub(crate) needed: Vec<Range<usize>>,
    /// Real and imaginary parts.
    pub(crate) values: [Vec<f32>; 2],
}

/// The least range that holds two.
pub(crate) fn hull(a: Range<usize>, b: Range<usize>) -> Range<usize> {
    if a.is_empty() {
        b
    } else if b.is_empty() {
        a
    } else {
        a.start.min(b.start)..a.end.max(b.end)
    }
}

/// For every node along x or y the least and the largest of what the voxels made of it need.
fn gather(weights: &AxisWeights, nodes: usize, voxels: &[Range<usize>]) -> Vec<Range<usize>> {
    let mut all = vec![0..0; nodes];
    for (voxel, needed) in voxels.iter().enumerate() {
        let (first, weights) = weights.of(voxel);
        for node in &mut all[first..first + weights.len()] {
            *node = hull(node.clone(), needed.clone());
        }
    }
    all
}

/// How voxels follow from nodes, for all tiles.
#[derive(Debug)]
pub(crate) struct Interpolation<'a> {
    lattice: &'a TileLattice,
    grid: &'a Grid,
    /// f_c/c, 1/m.
    carrier: f64,
    x: AxisWeights,
    y: AxisWeights,
    /// Weights along ρ, padded with zeros.
    table: Vec<[f32; LANES]>,
}

impl<'a> Interpolation<'a> {
    pub(crate) fn new(lattice: &'a TileLattice, grid: &'a Grid, carrier: f64) -> Self {
        let entry = |i: usize| {
            let mut row = [0.0; LANES];
            let weights = lattice.taps.weights(i as f64 / ENTRIES as f64);
            row.iter_mut().zip(weights).for_each(|(padded, w)| *padded = w as f32);
            row
        };
        Self {
            lattice,
            grid,
            carrier,
            x: AxisWeights::new(&grid.x, &lattice.nodes[0]),
            y: AxisWeights::new(&grid.y, &lattice.nodes[1]),
            // One more than a place can lie behind, since rounding may put it on the next node.
            table: (0..ENTRIES + 2).map(entry).collect(),
        }
    }

    /// Ranges of a row of voxels at one depth, m.
    fn row(&self, frame: &Frame, y: usize, z: usize) -> impl Iterator<Item = f64> {
        (0..self.grid.x.count).map(move |x| frame.range(self.grid.position(x, y, z)))
    }

    /// Nodes along ρ that voxels between these two ranges are made of.
    fn between(&self, nearest: f64, farthest: f64) -> Range<usize> {
        self.lattice.along_range(nearest).0..self.lattice.along_range(farthest).0 + self.lattice.taps.count()
    }

    /// The nodes that every column of a tile needs, `[y, x]`.
    pub(crate) fn needed(&self, frame: &Frame) -> Vec<Range<usize>> {
        let [n_x, n_y] = [0, 1].map(|axis: usize| self.lattice.nodes[axis].axis.count);
        let (z, grid) = (self.grid.z.count - 1, self.grid);
        let rows: Vec<Range<usize>> = (0..grid.y.count)
            .flat_map(|y| {
                let ends = self.row(frame, y, 0).zip(self.row(frame, y, z));
                let voxels: Vec<_> = ends.map(|(near, far)| self.between(near, far)).collect();
                gather(&self.x, n_x, &voxels)
            })
            .collect();
        let mut all = vec![0..0; n_x * n_y];
        for x in 0..n_x {
            let column: Vec<_> = (0..grid.y.count).map(|y| rows[y * n_x + x].clone()).collect();
            for (y, needed) in gather(&self.y, n_y, &column).into_iter().enumerate() {
                all[y * n_x + x] = needed;
            }
        }
        all
    }

    /// The nodes along ρ that any voxel of some depths is made of.
    pub(crate) fn needed_at(&self, frame: &Frame, depths: &Range<usize>) -> Range<usize> {
        let rows = (0..self.grid.y.count).map(|y| self.row_needs(frame, y, depths));
        rows.fold(0..0, hull)
    }

    fn row_needs(&self, frame: &Frame, y: usize, depths: &Range<usize>) -> Range<usize> {
        let nearest = self.row(frame, y, depths.start).fold(f64::INFINITY, f64::min);
        let farthest = self.row(frame, y, depths.end - 1).fold(0.0, f64::max);
        self.between(nearest, farthest)
    }

    /// Adds the image of one tile to the sums of a row of voxels at some depths.
    pub(crate) fn add(&self, tile: &TileNodes, y: usize, depths: &Range<usize>, buffers: &mut RowBuffers) {
        let n_x = self.grid.x.count;
        let nodes_x = self.lattice.nodes[0].axis.count;
        let needed = self.row_needs(&tile.frame, y, depths);
        // The vectors of weights reach beyond a voxel's own taps, where they are zero.
        let width = (needed.len() + LANES).next_multiple_of(WIDE);
        let held = tile.held.len();
        let (first_y, weights_y) = self.y.of(y);
        let RowBuffers { rows, columns, lengths, places, turns, sums: [sums_re, sums_im] } = buffers;
        for part in 0..2 {
            rows[part].resize(nodes_x * width, 0.0);
            columns[part].resize(n_x * width, 0.0);
            for x in 0..nodes_x {
                let from = (first_y * nodes_x + x) * held + (needed.start - tile.held.start);
                let sums = &mut rows[part][x * width..][..width];
                weighted_rows(weights_y, &tile.values[part][from..], nodes_x * held, sums);
            }
            for x in 0..n_x {
                let (first, weights) = self.x.of(x);
                let sums = &mut columns[part][x * width..][..width];
                weighted_rows(weights, &rows[part][first * width..], width, sums);
            }
        }
        lengths.resize(n_x, 0.0);
        places.resize(n_x, 0.0);
        turns.resize(n_x, Complex32::ZERO);
        let before = needed.start as f64 - self.lattice.taps.first() as f64;
        let sums = sums_re.chunks_exact_mut(n_x).zip(sums_im.chunks_exact_mut(n_x));
        for ((sums_re, sums_im), z) in sums.zip(depths.clone()) {
            tile.frame.ranges(self.grid.position(0, y, z), self.grid.x.pitch, lengths);
            phasors(-self.carrier, lengths, turns);
            for (place, length) in places.iter_mut().zip(lengths.iter()) {
                *place = length / self.lattice.pitch - before;
            }
            let columns = [&columns[0][..], &columns[1][..]];
            along_ranges(&self.table, columns, width, (places, turns), [sums_re, sums_im]);
        }
    }
}

/// What a thread needs for [`Interpolation::add`].
#[derive(Debug, Default)]
pub(crate) struct RowBuffers {
    rows: [Vec<f32>; 2],
    columns: [Vec<f32>; 2],
    lengths: Vec<f64>,
    places: Vec<f64>,
    turns: Vec<Complex32>,
    /// Real and imaginary parts of each voxel in as many partial sums as there are lanes, `[depths, x]`.
    sums: [Vec<[f32; LANES]>; 2],
}

impl RowBuffers {
    /// Starts with a row of this many voxels at zero.
    pub(crate) fn clear(&mut self, voxels: usize) {
        for sums in &mut self.sums {
            sums.clear();
            sums.resize(voxels, [0.0; LANES]);
        }
    }

    /// The voxels.
    pub(crate) fn voxels(&self) -> impl Iterator<Item = Complex32> {
        let both = self.sums[0].iter().zip(&self.sums[1]);
        both.map(|(re, im)| Complex32::new(re.iter().sum(), im.iter().sum()))
    }
}

#[inline(always)]
fn along_ranges_body(
    table: &[[f32; LANES]],
    columns: [&[f32]; 2],
    width: usize,
    (places, turns): (&[f64], &[Complex32]),
    [sums_re, sums_im]: [&mut [[f32; LANES]]; 2],
) {
    let both = columns[0].chunks_exact(width).zip(columns[1].chunks_exact(width));
    let sums = sums_re.iter_mut().zip(sums_im);
    for (((sum_re, sum_im), (re, im)), (place, turn)) in sums.zip(both).zip(places.iter().zip(turns)) {
        let own = *place as u32 as usize;
        let fine = (place - own as f64) * ENTRIES as f64;
        let entry = fine as u32 as usize;
        let t = (fine - entry as f64) as f32;
        let (low, high) = (&table[entry], &table[entry + 1]);
        let (re, im) = (&re[own..][..LANES], &im[own..][..LANES]);
        for l in 0..LANES {
            let w = low[l] + t * (high[l] - low[l]);
            let (re, im) = (w * re[l], w * im[l]);
            sum_re[l] += turn.re * re - turn.im * im;
            sum_im[l] += turn.re * im + turn.im * re;
        }
    }
}

dispatched! {
    /// Adds to every sum `turn · w_a(place) column[place + a]`, one lane for each a, with the weights of a table.
    fn along_ranges = along_ranges_body(
        table: &[[f32; LANES]], columns: [&[f32]; 2], width: usize, voxels: (&[f64], &[Complex32]),
        sums: [&mut [[f32; LANES]]; 2],
    )
}
