//! A volume that is stored depth by depth on its way to a sink, and whose first depths may come from an interrupted run.

use super::{Checkpoint, CheckpointStore, GracefulStop, Stage};
use crate::alloc::try_zeroed;
use crate::blocks::BlockStore;
use crate::error::Result;
use crate::grid::{Grid, no_room_for};
use crate::reconstruct::{ReconstructionInfo, VolumeSink};
use num_complex::Complex32;

/// The most bytes of finished depths that wait to be written; more are written before it is time.
pub(crate) const BUFFER_BYTES: u64 = 16 << 20;

/// The same in samples.
const MOST_WAITING: usize = BUFFER_BYTES as usize / size_of::<Complex32>();

/// A sink before another. Block k is depth k.
pub(crate) struct CheckpointedVolume<'a> {
    inner: &'a mut dyn VolumeSink,
    store: CheckpointStore<'a>,
    grid: Grid,
    /// Depths that the other sink has, from the first on.
    done: usize,
    /// Depths that are finished and not stored yet; they end before `done`.
    waiting: Vec<Complex32>,
}

impl<'a> CheckpointedVolume<'a> {
    /// Before `inner`, which takes the depths of a grid; `stop` is the stage's observer.
    pub(crate) fn new(
        checkpoint: &'a Checkpoint,
        inner: &'a mut dyn VolumeSink,
        grid: &Grid,
        stop: &'a GracefulStop<'a>,
    ) -> Self {
        let store = CheckpointStore::new(checkpoint, Stage::Volume, stop);
        Self { inner, store, grid: *grid, done: 0, waiting: Vec::new() }
    }

    /// Whether so many samples can wait beside those that do. There is room for all that ever will, so that it never grows.
    fn can_wait(&mut self, samples: usize) -> bool {
        let waiting = self.waiting.len();
        let left = waiting + samples + (self.grid.z.count - self.done) * self.grid.plane_len();
        let room = MOST_WAITING.min(left).saturating_sub(waiting);
        waiting + samples <= MOST_WAITING && self.waiting.try_reserve_exact(room).is_ok()
    }

    /// Saves the depths that wait, and these after them up to `self.done`.
    fn save(&mut self, planes: &[Complex32]) -> Result<()> {
        let plane_len = self.grid.plane_len();
        let first = self.done - (self.waiting.len() + planes.len()) / plane_len;
        let each = self.waiting.chunks_exact(plane_len).chain(planes.chunks_exact(plane_len));
        for (depth, plane) in (first..).zip(each) {
            self.store.save(depth as u64, plane);
        }
        self.waiting.clear();
        self.store.flush()
    }
}

impl VolumeSink for CheckpointedVolume<'_> {
    fn begin(&mut self, info: &ReconstructionInfo) -> Result<()> {
        self.inner.begin(info)?;
        if !self.store.is_on() {
            return Ok(());
        }
        let mut plane = try_zeroed(self.grid.plane_len() as u64).ok_or_else(|| no_room_for(&self.grid))?;
        while self.done < self.grid.z.count && self.store.load(self.done as u64, &mut plane) {
            self.inner.take(self.done, &plane)?;
            self.done += 1;
        }
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let plane_len = self.grid.plane_len();
        // A slab may begin with depths that were resumed.
        let resumed = (self.done.saturating_sub(first) * plane_len).min(planes.len());
        let planes = &planes[resumed..];
        self.inner.take(self.done, planes)?;
        self.done += planes.len() / plane_len;
        if !self.store.is_on() || planes.is_empty() {
            return Ok(());
        }
        if self.store.is_due() {
            return self.save(planes);
        }
        // A complete volume is written as the result right away.
        if self.done == self.grid.z.count {
            return Ok(());
        }
        if self.can_wait(planes.len()) {
            self.waiting.extend_from_slice(planes);
            return Ok(());
        }
        self.save(planes)
    }

    fn depths_done(&self) -> usize {
        self.done
    }
}
