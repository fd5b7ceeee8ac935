//! A sink that makes voxels of nodes, or by the adjoint nodes of voxels, depth by depth, and passes them on.

#![allow(clippy::inline_always)]

use super::{Carrier, Upsampling};
use crate::alloc::try_zeroed;
use crate::error::Result;
use crate::grid::{Grid, no_room_for};
use crate::reconstruct::numerics::{AxisWeights, GridPlaces, padded_width};
use crate::reconstruct::plan::cost::{COMPLEX, complex_bytes};
use crate::reconstruct::{ReconstructionInfo, VolumeSink};
use crate::wave::simd::fused::fused;
use crate::wave::simd::rows::{WIDE, weighted_rows};
use crate::wave::simd::{LANES, Lanes, dispatched, lane_sums, phasors};
use crate::wave::two_legs::TwoLegs;
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Depths of nodes that are worked on together.
pub(super) const DEPTHS: usize = 8;

/// Bytes of finished depths beyond which fewer are finished together, so that between far nodes a slab of wide planes does not
/// take more than all else. A depth is summed in the same way beside any others.
const FINISHED_BYTES: u64 = 64 << 20;

/// Runs of depths that each thread finishes, at least where rows are few.
const TASKS: usize = 4;

/// Real and imaginary parts.
type Parts = [Vec<f32>; 2];

/// How the samples of one grid follow from those of another: without their carrier by weights along each axis.
pub(in crate::reconstruct) struct Resampling<'a> {
    from: GridPlaces,
    to: &'a Grid,
    carrier: Carrier,
    /// In whole vectors.
    x: AxisWeights,
    y: AxisWeights,
    z: AxisWeights,
    /// Whether samples differ along x.
    along_x: bool,
}

/// A sink for the samples of one grid that passes those of another on.
pub(in crate::reconstruct) struct Resampled<'a> {
    plan: Resampling<'a>,
    sink: &'a mut dyn VolumeSink,
    /// Samples whose x and y are those of the other grid, `[depth, y, x]` with rows in whole vectors.
    held: Parts,
    /// Which depths of the one grid `held` has.
    depths: Range<usize>,
    /// The depth of the other that is next.
    next: usize,
    /// Room for the depths that are finished together.
    pub(super) finished: Vec<Complex32>,
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

    /// Bytes of what [`Upsampling::onto_voxels`] takes, by the number of threads; no weights are found for it.
    pub(super) fn voxel_bytes(&self) -> impl Fn(usize) -> u64 + use<> {
        bytes(&self.coarse, &self.fine, self.axes[2].nodes.taps())
    }

    /// Bytes of all nodes and of what [`Upsampling::onto_nodes`] takes, by the number of threads.
    pub(in crate::reconstruct) fn adjoint_bytes(&self) -> impl Fn(usize) -> u64 + use<> {
        let own = bytes(&self.fine, &self.coarse, self.adjoint_weights(2).taps());
        let nodes = self.coarse.volume_bytes();
        move |workers| nodes.saturating_add(own(workers))
    }

    /// What voxels are made of along an axis.
    fn weights(&self, axis: usize) -> AxisWeights {
        let voxels: Vec<f64> = [self.fine.x, self.fine.y, self.fine.z][axis].positions().collect();
        AxisWeights::new(self.axes[axis].nodes.weights(&voxels).into_iter())
    }

    /// In what voxels nodes are along an axis.
    fn adjoint_weights(&self, axis: usize) -> AxisWeights {
        self.weights(axis).transposed(self.axes[axis].nodes.axis.count)
    }
}

/// Samples of a row in whole vectors.
fn padded_row(to: &Grid) -> usize {
    to.x.count.next_multiple_of(WIDE)
}

/// Samples of a plane whose rows are whole vectors.
fn padded_plane(to: &Grid) -> usize {
    padded_row(to) * to.y.count
}

/// The most depths that are finished together.
fn finished_together(from: &Grid, to: &Grid) -> usize {
    let per_depth = (from.z.pitch / to.z.pitch).ceil() as usize;
    let plane = COMPLEX * to.plane_len() as u64;
    let fitting = usize::try_from(FINISHED_BYTES / plane.max(1)).unwrap_or(usize::MAX);
    (DEPTHS * per_depth + 1).min(to.z.count).min(fitting.max(1))
}

/// Depths that are held where one is made of so many.
fn held_depths(taps: usize) -> usize {
    taps + DEPTHS
}

/// Bytes of samples that wait for others and of finished ones, and of each thread's rows, by the number of threads; depths
/// are made of so many.
fn bytes(from: &Grid, to: &Grid, taps: usize) -> impl Fn(usize) -> u64 + use<> {
    let held = held_depths(taps) as u64 * padded_plane(to) as u64;
    let finished = finished_together(from, to) as u64 * to.plane_len() as u64;
    let nodes = padded_width(from.x.count) * (from.y.count + 1);
    let row = nodes + LANES * padded_row(to);
    let (shared, of_thread) = (COMPLEX * (held + finished), complex_bytes(2.0 * row as f64));
    move |workers| shared + of_thread * workers as u64
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
    /// The carrier's phasors along a row of so many points, whose path lengths `along` gives; with a sign of −1 those that turn
    /// it back.
    fn turn(&mut self, carrier: &Carrier, sign: f64, count: usize, along: impl FnOnce(&TwoLegs, &mut [f64])) {
        self.lengths.resize(count, 0.0);
        self.turns.resize(count, Complex32::ZERO);
        along(&carrier.legs, &mut self.lengths);
        phasors(sign * carrier.per_metre, &self.lengths, &mut self.turns);
    }
}

impl<'a> Resampled<'a> {
    /// # Errors
    /// [`Error::OutOfMemory`](crate::error::Error::OutOfMemory) when its buffers do not fit in memory.
    pub(in crate::reconstruct) fn new(plan: Resampling<'a>, sink: &'a mut dyn VolumeSink) -> Result<Self> {
        let no_room = || no_room_for(plan.to);
        let room = held_depths(plan.z.taps()) as u64 * padded_plane(plan.to) as u64;
        let together = finished_together(plan.from.grid(), plan.to);
        let zeros = || try_zeroed::<f32>(room).ok_or_else(no_room);
        let finished = try_zeroed(together as u64 * plan.to.plane_len() as u64).ok_or_else(no_room)?;
        let held = [zeros()?, zeros()?];
        Ok(Self { plan, sink, held, depths: 0..0, next: 0, finished })
    }

    /// Leaves out depths that the other sink does not want.
    fn skip(&mut self) {
        let wanted = self.sink.wanted(self.next..self.plan.to.z.count);
        self.next = if wanted.is_empty() { self.plan.to.z.count } else { wanted.start };
    }

    /// The first depth of nodes that any voxel from `next` on is made of.
    fn needed(&self) -> usize {
        if self.next < self.plan.to.z.count {
            self.plan.z.of(self.next).0
        } else {
            self.plan.from.grid().z.count
        }
    }

    /// Takes up to [`DEPTHS`] depths of nodes from `first` on, and passes on all voxels that can be made of those there are.
    fn add(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let (from_plane, plane) = (self.plan.from.grid().plane_len(), padded_plane(self.plan.to));
        self.forget(first);
        let from = self.depths.len() * plane;
        let count = planes.len() / from_plane;
        let [re, im] = &mut self.held;
        let room = re[from..].par_chunks_exact_mut(plane).zip(im[from..].par_chunks_exact_mut(plane));
        let plan = &self.plan;
        planes.par_chunks_exact(from_plane).zip(room).enumerate().for_each_init(
            NodeBuffers::default,
            |buffers, (i, (nodes, (re, im)))| {
                plan.sideways(first + i, nodes, buffers, [re, im]);
            },
        );
        self.depths.end = first + count;
        let ready = (self.next..self.plan.to.z.count)
            .take_while(|depth| {
                let (first, weights) = self.plan.z.of(*depth);
                first + weights.len() <= self.depths.end
            })
            .count();
        let voxels = self.plan.to.plane_len();
        let together = self.finished.len() / voxels;
        for some in (0..ready).step_by(together) {
            let count = (ready - some).min(together);
            let depths = self.next..self.next + count;
            let mut finished = std::mem::take(&mut self.finished);
            self.finish(depths, &mut finished[..count * voxels]);
            let taken = self.sink.take(self.next, &finished[..count * voxels]);
            self.finished = finished;
            taken?;
            self.next += count;
        }
        self.skip();
        Ok(())
    }

    /// Makes room for depths from `first` on by moving those that are still needed to the front.
    fn forget(&mut self, first: usize) {
        let plane = padded_plane(self.plan.to);
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
        let (plan, held, start) = (&self.plan, &self.held, self.depths.start);
        let Resampling { to, carrier, z: along_z, .. } = plan;
        let (width, padded, plane) = (to.x.count, padded_row(plan.to), padded_plane(plan.to));
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

impl VolumeSink for Resampled<'_> {
    fn begin(&mut self, info: &ReconstructionInfo) -> Result<()> {
        self.sink.begin(info)?;
        self.skip();
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let plane = self.plan.from.grid().plane_len();
        // A resumed run may begin with nodes that none of its voxels are made of.
        let skipped = self.needed().saturating_sub(first).min(planes.len() / plane);
        let planes = planes[skipped * plane..].chunks(DEPTHS * plane).enumerate();
        planes.into_iter().try_for_each(|(i, planes)| self.add(first + skipped + i * DEPTHS, planes))
    }

    fn wanted(&self, depths: Range<usize>) -> Range<usize> {
        let last = self.sink.wanted(self.next..self.plan.to.z.count).end;
        let Some(last) = last.checked_sub(1).filter(|last| *last >= self.next) else {
            return depths.end..depths.end;
        };
        let (first, weights) = self.plan.z.of(last);
        let end = depths.end.min(first + weights.len());
        self.needed().clamp(depths.start, depths.end).min(end)..end
    }
}

impl Resampling<'_> {
    /// One depth whose x and y are those of the other grid, without the carrier.
    fn sideways(
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
