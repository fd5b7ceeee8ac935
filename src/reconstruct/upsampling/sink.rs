//! A sink that makes voxels of nodes, or by the adjoint nodes of voxels, depth by depth, and passes them on.

use super::Upsampling;
use super::ends::{End, Ends};
use super::resampling::{DEPTHS, NodeBuffers, Parts, Resampling, depths_together, padded_plane, padded_row};
use crate::alloc::try_returned;
use crate::blocks::{NodeStore, runs};
use crate::error::Result;
use crate::grid::{Grid, no_room_for};
use crate::reconstruct::numerics::padded_width;
use crate::reconstruct::plan::cost::{COMPLEX, complex_bytes};
use crate::reconstruct::volume::DoubleBuffer;
use crate::reconstruct::{ReconstructionInfo, VolumeSink};
use crate::wave::simd::LANES;
use crate::wave::simd::rows::aligned_mut;
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Bytes of depths that are finished together beyond which these are fewer, so that between far nodes a slab of wide planes does
/// not take more than all else. A depth is summed in the same way beside any others.
const FINISHED_BYTES: u64 = 32 << 20;

/// Bytes of room for nodes that are not needed any more.
const SPARE_BYTES: u64 = 16 << 20;

/// A sink for the samples of one grid that passes those of another on.
pub(in crate::reconstruct) struct Resampled<'a> {
    plan: Resampling<'a>,
    /// Before the sink of the other grid.
    buffer: DoubleBuffer<'a>,
    /// Samples whose x and y are those of the other grid, `[depth, y, x]` with rows in whole vectors.
    held: Parts,
    /// Which depths of the one grid `held` has.
    depths: Range<usize>,
    /// The depth of the other that is next.
    next: usize,
    /// Depths of the other that are finished together at most.
    pub(super) together: usize,
    store: Option<&'a dyn NodeStore>,
    /// Where nodes are shared, once it is known which depths are wanted.
    ends: Option<Ends<'a>>,
}

impl Upsampling {
    /// Bytes of what [`Upsampling::onto_voxels`] takes, by the number of threads, and of nodes that another process has stored;
    /// no weights are found for it.
    pub(super) fn voxel_bytes(&self) -> impl Fn(usize) -> u64 + use<> {
        let own = bytes(&self.coarse, &self.fine, self.axes[2].nodes.taps());
        let stored = COMPLEX * (DEPTHS * self.coarse.plane_len()) as u64;
        move |workers| stored.saturating_add(own(workers))
    }

    /// Bytes of all nodes and of what [`Upsampling::onto_nodes`] takes, by the number of threads.
    pub(in crate::reconstruct) fn adjoint_bytes(&self) -> impl Fn(usize) -> u64 + use<> {
        let own = bytes(&self.fine, &self.coarse, self.adjoint_weights(2).taps());
        let nodes = self.coarse.volume_bytes();
        move |workers| nodes.saturating_add(own(workers))
    }
}

/// The most depths that are finished together: never all of several, so that there are two buffers for them.
fn finished_together(from: &Grid, to: &Grid) -> usize {
    let per_depth = (from.z.pitch / to.z.pitch).ceil() as usize;
    (DEPTHS * per_depth + 1).min(to.z.count.div_ceil(2)).min(fitting(FINISHED_BYTES, to).max(1))
}

/// Depths that are held where one is made of so many: with room for more than are needed, so that these are seldom moved.
fn held_depths(taps: usize, to: &Grid) -> usize {
    taps + DEPTHS + fitting(SPARE_BYTES, to).min(2 * DEPTHS)
}

/// Depths that take so many bytes.
fn fitting(bytes: u64, grid: &Grid) -> usize {
    usize::try_from(bytes / (COMPLEX * grid.plane_len() as u64).max(1)).unwrap_or(usize::MAX)
}

/// Bytes of samples that wait for others and of finished ones, and of each thread's rows, by the number of threads; depths
/// are made of so many.
fn bytes(from: &Grid, to: &Grid, taps: usize) -> impl Fn(usize) -> u64 + use<> {
    let held = held_depths(taps, to) as u64 * padded_plane(to) as u64;
    let finished = DoubleBuffer::bytes(to.plane_len() as u64, finished_together(from, to), to.z.count);
    let rows = padded_width(from.x.count) * (from.y.count * depths_together(to) + 2 * LANES);
    let row = rows + LANES * padded_row(to);
    let (shared, of_thread) = (COMPLEX * held + finished, complex_bytes(2.0 * row as f64));
    move |workers| shared + of_thread * workers as u64
}

impl<'a> Resampled<'a> {
    /// # Errors
    /// [`Error::OutOfMemory`](crate::error::Error::OutOfMemory) when its buffers do not fit in memory.
    pub(in crate::reconstruct) fn new(plan: Resampling<'a>, sink: &'a mut dyn VolumeSink) -> Result<Self> {
        let room = held_depths(plan.z.taps(), plan.to) as u64 * padded_plane(plan.to) as u64;
        let together = finished_together(plan.from.grid(), plan.to);
        let zeros = || try_returned::<f32>(room + LANES as u64).ok_or_else(|| no_room_for(plan.to));
        let (held, buffer) = ([zeros()?, zeros()?], DoubleBuffer::new(sink, plan.to, together)?);
        Ok(Self { plan, buffer, held, depths: 0..0, next: 0, together, store: None, ends: None })
    }

    /// The same with nodes at the ends of the wanted depths that other processes share.
    pub(in crate::reconstruct) fn sharing(self, store: Option<&'a dyn NodeStore>) -> Self {
        Self { store, ..self }
    }

    /// Passes on what is made of nodes behind the last that were computed.
    ///
    /// # Errors
    /// Those of the other sink; stored nodes that can no longer be read.
    pub(in crate::reconstruct) fn finish(mut self) -> Result<()> {
        let Some(ends) = self.ends.take() else { return Ok(()) };
        let stored = ends.stored_last(&(0..self.plan.from.grid().z.count));
        stored.map_or(Ok(()), |end| self.pass_stored(&ends, end))
    }

    /// Takes nodes that are stored.
    fn pass_stored(&mut self, ends: &Ends<'_>, end: &End) -> Result<()> {
        let first = self.depths.end.max(end.nodes.start);
        let count = end.nodes.end.saturating_sub(first);
        let mut room = ends.room(count.min(DEPTHS))?;
        for nodes in runs(count, DEPTHS) {
            let planes = ends.load(end, first + nodes.start..first + nodes.end, &mut room)?;
            ends.save(first + nodes.start, planes);
            self.add(first + nodes.start, planes)?;
        }
        self.buffer.flush()
    }

    /// Leaves out depths that the other sink does not want.
    fn skip(&mut self) {
        let wanted = self.buffer.wanted(self.next..self.plan.to.z.count);
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

    /// Takes up to [`DEPTHS`] depths of nodes from `first` on, and makes all voxels that can be made of those there are, while
    /// the other sink takes those before them.
    fn add(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let (from_plane, plane) = (self.plan.from.grid().plane_len(), padded_plane(self.plan.to));
        self.forget(first);
        let from = self.depths.len() * plane;
        let count = planes.len() / from_plane;
        self.depths.end = first + count;
        let ready = (self.next..self.plan.to.z.count)
            .take_while(|depth| {
                let (first, weights) = self.plan.z.of(*depth);
                first + weights.len() <= self.depths.end
            })
            .count();
        let (plan, start, held) = (&self.plan, self.depths.start, &mut self.held);
        let mut sideways = Some(|[re, im]: &mut Parts| {
            let each = depths_together(plan.to);
            let [re, im] =
                [re, im].map(|part| aligned_mut(part)[from..][..count * plane].par_chunks_mut(each * plane));
            planes.par_chunks(each * from_plane).zip(re.zip(im)).enumerate().for_each_init(
                NodeBuffers::default,
                |buffers, (i, (nodes, (re, im)))| {
                    plan.sideways(first + i * each, nodes, buffers, [re, im]);
                },
            );
        });
        for depths in runs(ready, self.together) {
            let (next, ready) = (self.next, depths.len());
            self.buffer.next(next, ready, |finished| {
                if let Some(sideways) = sideways.take() {
                    sideways(held);
                }
                plan.voxels((start, held), next..next + ready, finished);
                Ok(())
            })?;
            self.next += ready;
        }
        if let Some(sideways) = sideways {
            sideways(held);
        }
        self.skip();
        Ok(())
    }

    /// Makes room for [`DEPTHS`] depths from `first` on by moving those that are still needed to the front.
    fn forget(&mut self, first: usize) {
        let plane = padded_plane(self.plan.to);
        let kept = self.needed().max(self.depths.start).min(self.depths.end);
        if self.depths.is_empty() || kept == self.depths.end {
            self.depths = first..first;
            return;
        }
        if self.depths.len() + DEPTHS <= held_depths(self.plan.z.taps(), self.plan.to) {
            return;
        }
        let (from, to) = (kept - self.depths.start, self.depths.len());
        for part in &mut self.held {
            aligned_mut(part).copy_within(from * plane..to * plane, 0);
        }
        self.depths.start = kept;
    }
}

impl VolumeSink for Resampled<'_> {
    fn begin(&mut self, info: &ReconstructionInfo) -> Result<()> {
        self.buffer.begin(info)?;
        self.skip();
        if let Some(store) = self.store {
            let depths = self.buffer.wanted(0..self.plan.to.z.count);
            let plane_lens = [self.plan.from.grid(), self.plan.to].map(Grid::plane_len);
            let ends = Ends::new(store, &self.plan.z, depths, plane_lens);
            if let Some(end) = ends.stored_first() {
                self.pass_stored(&ends, end)?;
            }
            self.ends = Some(ends);
        }
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let plane = self.plan.from.grid().plane_len();
        // A resumed run may begin with nodes that none of its voxels are made of, or with some that were stored.
        let skipped = self.needed().max(self.depths.end).saturating_sub(first).min(planes.len() / plane);
        let (first, planes) = (first + skipped, &planes[skipped * plane..]);
        if let Some(ends) = &self.ends {
            ends.save(first, planes);
        }
        for (i, planes) in planes.chunks(DEPTHS * plane).enumerate() {
            self.add(first + i * DEPTHS, planes)?;
        }
        self.buffer.flush()
    }

    fn wanted(&self, depths: Range<usize>) -> Range<usize> {
        let last = self.buffer.wanted(self.next..self.plan.to.z.count).end;
        let Some(last) = last.checked_sub(1).filter(|last| *last >= self.next) else {
            return depths.end..depths.end;
        };
        let (first, weights) = self.plan.z.of(last);
        let end = depths.end.min(first + weights.len());
        let stored = self.ends.as_ref().and_then(|ends| ends.stored_last(&(depths.start..end)));
        let end = stored.map_or(end, |stored| end.min(stored.nodes.start.max(depths.start)));
        self.needed().max(self.depths.end).clamp(depths.start, depths.end).min(end)..end
    }
}
