//! How the samples of one grid follow from those of another, depth by depth: along y, along x, then along z.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

use super::{Carrier, Upsampling};
use crate::grid::Grid;
use crate::reconstruct::numerics::{AxisWeights, GridPlaces, padded_width};
use crate::wave::simd::fused::fused;
use crate::wave::simd::rows::{WIDE, aligned, aligned_mut, weighted_rows};
use crate::wave::simd::{LANES, Lanes, dispatched, phasors, transpose};
use crate::wave::two_legs::TwoLegs;
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Depths of nodes that are worked on together.
pub(super) const DEPTHS: usize = 8;

/// Runs of depths that each thread finishes, at least where rows are few.
const TASKS: usize = 4;

/// Depths of a row that are made together.
const ROWS: usize = 4;

/// Real and imaginary parts.
pub(super) type Parts = [Vec<f32>; 2];

/// How the samples of one grid follow from those of another: without their carrier by weights along each axis.
pub(in crate::reconstruct) struct Resampling<'a> {
    pub(super) from: GridPlaces,
    pub(super) to: &'a Grid,
    carrier: Carrier,
    x: AxisWeights,
    y: AxisWeights,
    pub(super) z: AxisWeights,
    /// Whether samples differ along x.
    along_x: bool,
}

impl Upsampling {
    /// From nodes to voxels.
    pub(in crate::reconstruct) fn onto_voxels(&self) -> Resampling<'_> {
        self.resampling(self.places(), &self.fine, [0, 1, 2].map(|axis| self.weights(axis)))
    }

    /// From voxels to nodes, by the adjoint of [`Upsampling::onto_voxels`].
    pub(in crate::reconstruct) fn onto_nodes(&self) -> Resampling<'_> {
        let weights = [0, 1, 2].map(|axis| self.adjoint_weights(axis));
        self.resampling(GridPlaces::even(&self.fine), &self.coarse, weights)
    }

    fn resampling<'a>(&self, from: GridPlaces, to: &'a Grid, [x, y, z]: [AxisWeights; 3]) -> Resampling<'a> {
        let (carrier, along_x) = (self.carrier, self.axes[0].nodes.interpolates());
        Resampling { from, to, carrier, x, y, z, along_x }
    }

    /// What voxels are made of along an axis.
    fn weights(&self, axis: usize) -> AxisWeights {
        let voxels: Vec<f64> = [self.fine.x, self.fine.y, self.fine.z][axis].positions().collect();
        AxisWeights::new(self.axes[axis].nodes.weights(&voxels).into_iter())
    }

    /// In what voxels nodes are along an axis.
    pub(super) fn adjoint_weights(&self, axis: usize) -> AxisWeights {
        self.weights(axis).transposed(self.axes[axis].nodes.axis.count)
    }
}

/// Samples of a row in whole vectors.
pub(super) fn padded_row(to: &Grid) -> usize {
    to.x.count.next_multiple_of(WIDE)
}

/// Samples of a plane whose rows are whole vectors.
pub(super) fn padded_plane(to: &Grid) -> usize {
    padded_row(to) * to.y.count
}

/// Depths of nodes that are turned sideways together: together they have a row for each lane, if there are as many.
pub(super) fn depths_together(to: &Grid) -> usize {
    LANES.div_ceil(to.y.count).min(DEPTHS)
}

/// What a thread needs for some depths of nodes.
#[derive(Default)]
pub(super) struct NodeBuffers {
    lengths: Vec<f64>,
    turns: Vec<Complex32>,
    /// Nodes without their carrier, `[depth, y, x]` with rows in whole vectors.
    nodes: Parts,
    /// Rows of them whose y is the voxels' own, one for each lane.
    rows: Parts,
    /// The same, and voxels made of them, with a row in each lane: by columns.
    columns: Vec<Lanes>,
    made: Vec<Lanes>,
}

impl NodeBuffers {
    /// The carrier's phasors along a row of so many points, whose path lengths `along` gives; with a sign of −1 those that turn
    /// it back.
    fn turn(&mut self, carrier: &Carrier, sign: f64, count: usize, along: impl FnOnce(&TwoLegs, &mut [f64])) {
        self.lengths.resize(count, 0.0);
        self.turns.resize(count, Complex32::ZERO);
        along(&carrier.legs, &mut self.lengths);
        phasors(sign * carrier.per_metre, &self.lengths, &mut self.turns);
    }
}

impl Resampling<'_> {
    /// Some depths of nodes from `first` on, `[depth, y, x]`, to the x and y of the other grid, without the carrier.
    pub(super) fn sideways(
        &self,
        first: usize,
        nodes: &[Complex32],
        buffers: &mut NodeBuffers,
        [to_re, to_im]: [&mut [f32]; 2],
    ) {
        let Self { from: places, to, carrier, x, y, .. } = self;
        let from = places.grid();
        let (width, row) = (from.x.count, padded_row(self.to));
        let stride = padded_width(width);
        for part in &mut buffers.nodes {
            part.resize(stride * (nodes.len() / width) + LANES, 0.0);
        }
        for (i, nodes) in nodes.chunks_exact(width).enumerate() {
            let first = places.position([0, i % from.y.count, first + i / from.y.count]);
            buffers.turn(carrier, 1.0, width, |legs, lengths| match places.listed(0) {
                Some(columns) => legs.along(0, first, columns, lengths),
                None => legs.row(first, from.x.pitch, lengths),
            });
            let [re, im] = buffers.nodes.each_mut().map(|part| &mut aligned_mut(part)[i * stride..]);
            for (((node, turn), re), im) in nodes.iter().zip(&buffers.turns).zip(re).zip(im) {
                let turned = node * turn;
                (*re, *im) = (turned.re, turned.im);
            }
        }
        for part in &mut buffers.rows {
            part.resize(stride * LANES, 0.0);
        }
        let rows = to_re.chunks_mut(LANES * row).zip(to_im.chunks_mut(LANES * row));
        for (i, (re, im)) in rows.enumerate() {
            let count = re.len() / row;
            let of_row = |row: usize| {
                let (first, weights) = y.of(row % to.y.count);
                ((row / to.y.count * from.y.count + first) * stride, weights)
            };
            let of_rows: Vec<(usize, &[f32])> = (i * LANES..i * LANES + count).map(of_row).collect();
            for (nodes, rows) in buffers.nodes.iter().zip(&mut buffers.rows) {
                weighted_rows(&of_rows, aligned(nodes), stride, &mut rows[..count * stride]);
            }
            let [rows_re, rows_im] = &buffers.rows;
            if !self.along_x {
                for lane in 0..count {
                    re[lane * row..][..row].copy_from_slice(&rows_re[lane * stride..][..row]);
                    im[lane * row..][..row].copy_from_slice(&rows_im[lane * stride..][..row]);
                }
                continue;
            }
            buffers.columns.resize(stride, Lanes::ZERO);
            buffers.made.resize(row, Lanes::ZERO);
            for (i, columns) in buffers.columns.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
                let part =
                    |rows: &[f32], lane: usize| std::array::from_fn(|x| rows[lane * stride + i * LANES + x]);
                transpose(
                    &std::array::from_fn(|lane| Lanes { re: part(rows_re, lane), im: part(rows_im, lane) }),
                    columns,
                );
            }
            along_columns(x, &buffers.columns, &mut buffers.made[..to.x.count]);
            let mut tile = [Lanes::ZERO; LANES];
            for (i, made) in buffers.made.as_chunks::<LANES>().0.iter().enumerate() {
                transpose(made, &mut tile);
                for (lane, voxels) in tile[..count].iter().enumerate() {
                    re[lane * row + i * LANES..][..LANES].copy_from_slice(&voxels.re);
                    im[lane * row + i * LANES..][..LANES].copy_from_slice(&voxels.im);
                }
            }
        }
    }

    /// Depths of the other grid, `[depth, y, x]`, made of what [`Resampling::sideways`] has made of those from `start` on.
    pub(super) fn voxels(
        &self,
        (start, held): (usize, &Parts),
        depths: Range<usize>,
        voxels: &mut [Complex32],
    ) {
        let Self { to, carrier, z: along_z, .. } = self;
        let (width, padded, plane) = (to.x.count, padded_row(self.to), padded_plane(self.to));
        // A row of a few depths.
        let row = |buffers: &mut NodeBuffers, iy: usize, some: &mut [(usize, &mut [Complex32])]| {
            let of_depth = |(iz, _): &(usize, &mut [Complex32])| {
                let (first, weights) = along_z.of(*iz);
                ((first - start) * plane + iy * padded, weights)
            };
            let of_depths: Vec<(usize, &[f32])> = some.iter().map(of_depth).collect();
            for (held, sums) in held.iter().zip(&mut buffers.rows) {
                sums.resize(some.len() * padded, 0.0);
                weighted_rows(&of_depths, aligned(held), plane, sums);
            }
            for (i, (iz, voxels)) in some.iter_mut().enumerate() {
                let first = to.position(0, iy, *iz);
                buffers.turn(carrier, -1.0, width, |legs, lengths| legs.row(first, to.x.pitch, lengths));
                let [re, im] = [0, 1].map(|part: usize| &buffers.rows[part][i * padded..]);
                for (((voxel, turn), re), im) in voxels.iter_mut().zip(&buffers.turns).zip(re).zip(im) {
                    *voxel = Complex32::new(*re, *im) * turn;
                }
            }
        };
        // Row by row, since the nodes of one stay in a cache for all its depths.
        let (rows, count) = (to.y.count, depths.len());
        let mut of_rows: Vec<Vec<(usize, &mut [Complex32])>> =
            (0..rows).map(|_| Vec::with_capacity(count)).collect();
        for (i, voxels) in voxels.chunks_exact_mut(width).enumerate() {
            of_rows[i % rows].push((depths.start + i / rows, voxels));
        }
        let together = (rows * count).div_ceil(TASKS * rayon::current_num_threads()).min(count);
        let of_rows = of_rows.iter_mut().enumerate();
        let tasks: Vec<_> =
            of_rows.flat_map(|(iy, row)| row.chunks_mut(together).map(move |some| (iy, some))).collect();
        tasks.into_par_iter().for_each_init(NodeBuffers::default, |buffers, (iy, some)| {
            some.chunks_mut(ROWS).for_each(|some| row(buffers, iy, some));
        });
    }
}

#[inline(always)]
fn along_columns_body<const FMA: bool>(weights: &AxisWeights, columns: &[Lanes], made: &mut [Lanes]) {
    for (ix, made) in made.iter_mut().enumerate() {
        let (first, weights) = weights.of(ix);
        let columns = &columns[first..][..weights.len()];
        // Two sums in turn, so that no addition waits for another; of their own: in the place of `made` they would be stored
        // one by one.
        let (mut re, mut im) = ([0.0f32; LANES], [0.0f32; LANES]);
        let (mut other_re, mut other_im) = ([0.0f32; LANES], [0.0f32; LANES]);
        let (pairs, rest) = weights.as_chunks::<2>();
        let (columns, last) = columns.as_chunks::<2>();
        for ([w, other], [column, next]) in pairs.iter().zip(columns) {
            for l in 0..LANES {
                re[l] = fused::<FMA>(*w, column.re[l], re[l]);
                im[l] = fused::<FMA>(*w, column.im[l], im[l]);
            }
            for l in 0..LANES {
                other_re[l] = fused::<FMA>(*other, next.re[l], other_re[l]);
                other_im[l] = fused::<FMA>(*other, next.im[l], other_im[l]);
            }
        }
        for (w, column) in rest.iter().zip(last) {
            for l in 0..LANES {
                re[l] = fused::<FMA>(*w, column.re[l], re[l]);
                im[l] = fused::<FMA>(*w, column.im[l], im[l]);
            }
        }
        for l in 0..LANES {
            made.re[l] = re[l] + other_re[l];
            made.im[l] = im[l] + other_im[l];
        }
    }
}

dispatched! {
    /// What voxels are made of along x, for sixteen rows at once: `made[i] = Σ_k weights_i[k] columns[first_i + k]`.
    fn along_columns = fused along_columns_body(weights: &AxisWeights, columns: &[Lanes], made: &mut [Lanes])
}
