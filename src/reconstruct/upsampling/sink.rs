//! A sink that makes voxels of nodes, depth by depth, and passes them on.

#![allow(clippy::inline_always)]

use super::{Carrier, Upsampling};
use crate::alloc::{try_filled, try_zeroed};
use crate::error::Result;
use crate::grid::{Grid, no_room_for};
use crate::reconstruct::numerics::{AxisWeights, padded_width, weighted_rows};
use crate::reconstruct::{ReconstructionInfo, VolumeSink};
use crate::wave::simd::{LANES, Lanes, dispatched, lane_sums, phasors};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Depths of nodes that are worked on together.
pub(super) const DEPTHS: usize = 8;

/// Real and imaginary parts.
type Parts = [Vec<f32>; 2];

/// A sink for the nodes of a volume whose voxels go to another.
pub(in crate::reconstruct) struct Upsampled<'a> {
    plan: &'a Upsampling,
    sink: &'a mut dyn VolumeSink,
    /// In whole vectors.
    x: AxisWeights,
    y: AxisWeights,
    z: AxisWeights,
    /// Nodes between which x and y are the voxels' own, `[depth, y, x]` with rows in whole vectors.
    held: Parts,
    /// Which depths of nodes `held` has.
    depths: Range<usize>,
    /// The depth of voxels that is next.
    next: usize,
    finished: Vec<Complex32>,
}

/// What a thread needs for one depth of nodes.
#[derive(Default)]
struct NodeBuffers {
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
    /// The carrier's phasors along a row of a grid; with a sign of −1 those that turn it back.
    fn turn(&mut self, carrier: &Carrier, sign: f64, (grid, [iy, iz]): (&Grid, [usize; 2])) {
        self.lengths.resize(grid.x.count, 0.0);
        self.turns.resize(grid.x.count, Complex32::ZERO);
        carrier.legs.row(grid.position(0, iy, iz), grid.x.pitch, &mut self.lengths);
        phasors(sign * carrier.per_metre, &self.lengths, &mut self.turns);
    }
}

impl<'a> Upsampled<'a> {
    /// # Errors
    /// [`Error::OutOfMemory`](crate::error::Error::OutOfMemory) when its buffers do not fit in memory.
    pub(in crate::reconstruct) fn new(plan: &'a Upsampling, sink: &'a mut dyn VolumeSink) -> Result<Self> {
        let Upsampling { fine, nodes, .. } = plan;
        let no_room = || no_room_for(fine);
        let room = (nodes[2].taps() + DEPTHS) as u64 * plan.padded_plane() as u64;
        let zeros = || try_filled(0.0_f32, room).ok_or_else(no_room);
        let finished = try_zeroed(plan.finished() as u64 * fine.plane_len() as u64).ok_or_else(no_room)?;
        Ok(Self {
            plan,
            sink,
            x: AxisWeights::new(fine.x.positions().map(|place| nodes[0].weights(place))).in_vectors(),
            y: AxisWeights::new(fine.y.positions().map(|place| nodes[1].weights(place))),
            z: AxisWeights::new(fine.z.positions().map(|place| nodes[2].weights(place))),
            held: [zeros()?, zeros()?],
            depths: 0..0,
            next: 0,
            finished,
        })
    }

    /// The first depth of nodes that any voxel from `next` on is made of.
    fn needed(&self) -> usize {
        if self.next < self.plan.fine.z.count { self.z.of(self.next).0 } else { self.plan.coarse.z.count }
    }

    /// Takes up to [`DEPTHS`] depths of nodes from `first` on, and passes on all voxels that can be made of those there are.
    fn add(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let (coarse, plane) = (&self.plan.coarse, self.plan.padded_plane());
        self.forget(first);
        let from = self.depths.len() * plane;
        let count = planes.len() / coarse.plane_len();
        let [re, im] = &mut self.held;
        let room = re[from..].par_chunks_exact_mut(plane).zip(im[from..].par_chunks_exact_mut(plane));
        let (plan, x, y) = (self.plan, &self.x, &self.y);
        planes.par_chunks_exact(coarse.plane_len()).zip(room).enumerate().for_each_init(
            NodeBuffers::default,
            |buffers, (i, (nodes, (re, im)))| {
                plan.sideways(first + i, nodes, [x, y], buffers, [re, im]);
            },
        );
        self.depths.end = first + count;
        let ready = (self.next..self.plan.fine.z.count)
            .take_while(|depth| {
                let (first, weights) = self.z.of(*depth);
                first + weights.len() <= self.depths.end
            })
            .count();
        let voxels = self.plan.fine.plane_len();
        for some in (0..ready).step_by(self.plan.finished()) {
            let count = (ready - some).min(self.plan.finished());
            let depths = self.next..self.next + count;
            let mut finished = std::mem::take(&mut self.finished);
            self.finish(depths, &mut finished[..count * voxels]);
            let taken = self.sink.take(self.next, &finished[..count * voxels]);
            self.finished = finished;
            taken?;
            self.next += count;
        }
        Ok(())
    }

    /// Makes room for depths from `first` on by moving those that are still needed to the front.
    fn forget(&mut self, first: usize) {
        let plane = self.plan.padded_plane();
        let kept = self.needed().max(self.depths.start).min(self.depths.end);
        if self.depths.is_empty() || kept == self.depths.end {
            self.depths = first..first;
            return;
        }
        let (from, to) = (kept - self.depths.start, self.depths.len());
        for part in &mut self.held {
            part.copy_within(from * plane..to * plane, 0);
        }
        self.depths.start = kept;
    }

    /// Computes depths of voxels, `[depth, y, x]`.
    fn finish(&self, depths: Range<usize>, voxels: &mut [Complex32]) {
        let (plan, held, along_z, start) = (self.plan, &self.held, &self.z, self.depths.start);
        let Upsampling { fine, carrier, .. } = plan;
        let (width, padded, plane) = (fine.x.count, plan.padded_row(), plan.padded_plane());
        voxels.par_chunks_exact_mut(width).enumerate().for_each_init(
            NodeBuffers::default,
            |buffers, (i, voxels)| {
                let (iz, iy) = (depths.start + i / fine.y.count, i % fine.y.count);
                let (first, weights) = along_z.of(iz);
                let from = (first - start) * plane + iy * padded;
                for (held, sums) in held.iter().zip(&mut buffers.row) {
                    sums.resize(padded, 0.0);
                    weighted_rows(weights, &held[from..], plane, sums);
                }
                buffers.turn(carrier, -1.0, (fine, [iy, iz]));
                let [re, im] = &buffers.row;
                for (((voxel, turn), re), im) in voxels.iter_mut().zip(&buffers.turns).zip(re).zip(im) {
                    *voxel = Complex32::new(*re, *im) * turn;
                }
            },
        );
    }
}

impl VolumeSink for Upsampled<'_> {
    fn begin(&mut self, info: &ReconstructionInfo) -> Result<()> {
        self.sink.begin(info)?;
        self.next = self.sink.depths_done();
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let plane = self.plan.coarse.plane_len();
        // A resumed run may begin with nodes that none of its voxels are made of.
        let skipped = self.needed().saturating_sub(first).min(planes.len() / plane);
        let planes = planes[skipped * plane..].chunks(DEPTHS * plane).enumerate();
        planes.into_iter().try_for_each(|(i, planes)| self.add(first + skipped + i * DEPTHS, planes))
    }

    fn depths_done(&self) -> usize {
        self.needed()
    }
}

impl Upsampling {
    /// One depth of nodes between which x and y are the voxels' own, without the carrier.
    fn sideways(
        &self,
        depth: usize,
        nodes: &[Complex32],
        [x, y]: [&AxisWeights; 2],
        buffers: &mut NodeBuffers,
        [to_re, to_im]: [&mut [f32]; 2],
    ) {
        let (coarse, carrier) = (&self.coarse, &self.carrier);
        let (width, row) = (coarse.x.count, self.padded_row());
        let stride = padded_width(width);
        for part in &mut buffers.nodes {
            part.resize(stride * coarse.y.count, 0.0);
        }
        for (iy, nodes) in nodes.chunks_exact(width).enumerate() {
            buffers.turn(carrier, 1.0, (coarse, [iy, depth]));
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
            if !self.nodes[0].interpolates() {
                re.copy_from_slice(&buffers.row[0][..row]);
                im.copy_from_slice(&buffers.row[1][..row]);
                continue;
            }
            buffers.products.resize(row, Lanes::ZERO);
            along_row(x, [&buffers.row[0], &buffers.row[1]], &mut buffers.products[..self.fine.x.count]);
            let voxels = re.chunks_exact_mut(LANES).zip(im.chunks_exact_mut(LANES));
            for (products, (re, im)) in buffers.products.as_chunks::<LANES>().0.iter().zip(voxels) {
                let sums = lane_sums(products);
                re.copy_from_slice(&sums.re);
                im.copy_from_slice(&sums.im);
            }
        }
    }
}

#[inline(always)]
fn along_row_body(weights: &AxisWeights, [re, im]: [&[f32]; 2], products: &mut [Lanes]) {
    for (ix, product) in products.iter_mut().enumerate() {
        let (first, weights) = weights.of(ix);
        // Sums of their own: in the place of `product` they would be added up one by one.
        let (mut sum_re, mut sum_im) = ([0.0f32; LANES], [0.0f32; LANES]);
        for (i, weights) in weights.as_chunks::<LANES>().0.iter().enumerate() {
            let from = first + i * LANES;
            let (re, im) = (&re[from..][..LANES], &im[from..][..LANES]);
            for (sum, (w, re)) in sum_re.iter_mut().zip(weights.iter().zip(re)) {
                *sum += w * re;
            }
            for (sum, (w, im)) in sum_im.iter_mut().zip(weights.iter().zip(im)) {
                *sum += w * im;
            }
        }
        *product = Lanes { re: sum_re, im: sum_im };
    }
}

dispatched! {
    /// What the voxels of a row sum over lanes: `products[i][l] = Σ_k weights_i[16k + l] nodes[first_i + 16k + l]`.
    fn along_row = along_row_body(weights: &AxisWeights, nodes: [&[f32]; 2], products: &mut [Lanes])
}
