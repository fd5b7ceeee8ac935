//! How the samples of one grid follow from those of another, depth by depth: along y, along x, then along z.

#![allow(clippy::inline_always)]

use super::{Carrier, Upsampling};
use crate::grid::Grid;
use crate::reconstruct::numerics::{AxisWeights, GridPlaces, padded_width};
use crate::wave::simd::fused::fused;
use crate::wave::simd::rows::{WIDE, weighted_rows};
use crate::wave::simd::{LANES, Lanes, dispatched, lane_sums, phasors};
use crate::wave::two_legs::TwoLegs;
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Runs of depths that each thread finishes, at least where rows are few.
const TASKS: usize = 4;

/// Real and imaginary parts.
pub(super) type Parts = [Vec<f32>; 2];

/// How the samples of one grid follow from those of another: without their carrier by weights along each axis.
pub(in crate::reconstruct) struct Resampling<'a> {
    pub(super) from: GridPlaces,
    pub(super) to: &'a Grid,
    carrier: Carrier,
    /// In whole vectors.
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
        Resampling { from, to, carrier, x: x.in_vectors(), y, z, along_x }
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

/// What a thread needs for one depth of nodes.
#[derive(Default)]
pub(super) struct NodeBuffers {
    lengths: Vec<f64>,
    turns: Vec<Complex32>,
    /// Nodes without their carrier, `[y, x]` with rows in whole vectors.
    nodes: Parts,
    /// A row of them between which y is the voxels' own.
    row: Parts,
    /// Of its voxels, whole vectors of them.
    products: Vec<Lanes>,
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
    /// One depth whose x and y are those of the other grid, without the carrier.
    pub(super) fn sideways(
        &self,
        depth: usize,
        nodes: &[Complex32],
        buffers: &mut NodeBuffers,
        [to_re, to_im]: [&mut [f32]; 2],
    ) {
        let Self { from: places, to, carrier, x, y, .. } = self;
        let from = places.grid();
        let (width, row) = (from.x.count, padded_row(self.to));
        let stride = padded_width(width);
        for part in &mut buffers.nodes {
            part.resize(stride * from.y.count, 0.0);
        }
        for (iy, nodes) in nodes.chunks_exact(width).enumerate() {
            let first = places.position([0, iy, depth]);
            buffers.turn(carrier, 1.0, width, |legs, lengths| match places.listed(0) {
                Some(columns) => legs.along(0, first, columns, lengths),
                None => legs.row(first, from.x.pitch, lengths),
            });
            let [re, im] = &mut buffers.nodes;
            let [re, im] = [&mut re[iy * stride..], &mut im[iy * stride..]];
            for (((node, turn), re), im) in nodes.iter().zip(&buffers.turns).zip(re).zip(im) {
                let turned = node * turn;
                (*re, *im) = (turned.re, turned.im);
            }
        }
        let rows = to_re.chunks_exact_mut(row).zip(to_im.chunks_exact_mut(row));
        for (iy, (re, im)) in rows.enumerate() {
            let (first, weights) = y.of(iy);
            for (nodes, sums) in buffers.nodes.iter().zip(&mut buffers.row) {
                sums.resize(stride, 0.0);
                weighted_rows(weights, &nodes[first * stride..], stride, sums);
            }
            if !self.along_x {
                re.copy_from_slice(&buffers.row[0][..row]);
                im.copy_from_slice(&buffers.row[1][..row]);
                continue;
            }
            buffers.products.resize(row, Lanes::ZERO);
            along_row(x, [&buffers.row[0], &buffers.row[1]], &mut buffers.products[..to.x.count]);
            let voxels = re.chunks_exact_mut(LANES).zip(im.chunks_exact_mut(LANES));
            for (products, (re, im)) in buffers.products.as_chunks::<LANES>().0.iter().zip(voxels) {
                let sums = lane_sums(products);
                re.copy_from_slice(&sums.re);
                im.copy_from_slice(&sums.im);
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
        let row = |buffers: &mut NodeBuffers, iz: usize, iy: usize, voxels: &mut [Complex32]| {
            let (first, weights) = along_z.of(iz);
            let from = (first - start) * plane + iy * padded;
            for (held, sums) in held.iter().zip(&mut buffers.row) {
                sums.resize(padded, 0.0);
                weighted_rows(weights, &held[from..], plane, sums);
            }
            let first = to.position(0, iy, iz);
            buffers.turn(carrier, -1.0, width, |legs, lengths| legs.row(first, to.x.pitch, lengths));
            let [re, im] = &buffers.row;
            for (((voxel, turn), re), im) in voxels.iter_mut().zip(&buffers.turns).zip(re).zip(im) {
                *voxel = Complex32::new(*re, *im) * turn;
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
            for (iz, voxels) in some {
                row(buffers, *iz, iy, voxels);
            }
        });
    }
}

#[inline(always)]
fn along_row_body<const FMA: bool>(weights: &AxisWeights, [re, im]: [&[f32]; 2], products: &mut [Lanes]) {
    for (ix, product) in products.iter_mut().enumerate() {
        let (first, weights) = weights.of(ix);
        // Sums of their own: in the place of `product` they would be added up one by one.
        let (mut sum_re, mut sum_im) = ([0.0f32; LANES], [0.0f32; LANES]);
        for (i, weights) in weights.as_chunks::<LANES>().0.iter().enumerate() {
            let from = first + i * LANES;
            let (re, im) = (&re[from..][..LANES], &im[from..][..LANES]);
            for (sum, (w, re)) in sum_re.iter_mut().zip(weights.iter().zip(re)) {
                *sum = fused::<FMA>(*w, *re, *sum);
            }
            for (sum, (w, im)) in sum_im.iter_mut().zip(weights.iter().zip(im)) {
                *sum = fused::<FMA>(*w, *im, *sum);
            }
        }
        *product = Lanes { re: sum_re, im: sum_im };
    }
}

dispatched! {
    /// What the voxels of a row sum over lanes: `products[i][l] = Σ_k weights_i[16k + l] nodes[first_i + 16k + l]`.
    fn along_row = fused along_row_body(weights: &AxisWeights, nodes: [&[f32]; 2], products: &mut [Lanes])
}
