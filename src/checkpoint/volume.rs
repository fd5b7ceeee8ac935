//! A sink that stores a volume depth by depth before it passes it on, and takes depths from an interrupted run and from
//! other processes.

use super::{Checkpoint, CheckpointStore, GracefulStop, Stage};
use crate::alloc::try_zeroed;
use crate::blocks::BlockStore;
use crate::error::{Error, Result};
use crate::grid::{Grid, no_room_for};
use crate::reconstruct::{ReconstructionInfo, VolumeSink, needed_among};
use num_complex::Complex32;
use std::ops::Range;

/// Maximum bytes of finished depths that wait to be written. Beyond them, depths are written before the interval ends; but in
/// the first interval those of a larger volume are not stored at all.
pub(crate) const BUFFER_BYTES: u64 = 8 << 20;

/// The same in samples.
const MAX_WAITING: usize = BUFFER_BYTES as usize / size_of::<Complex32>();

/// A sink that passes everything on to another. Block k is depth k.
pub(crate) struct CheckpointedVolume<'a> {
    inner: &'a mut dyn VolumeSink,
    store: CheckpointStore<'a>,
    grid: Grid,
    /// Which depths are stored, and intact.
    stored: Vec<bool>,
    /// Depths that the inner sink has received, from the first on.
    done: usize,
    /// Depths that are finished and not stored yet: the last of those in `done`.
    waiting: Vec<Complex32>,
}

impl<'a> CheckpointedVolume<'a> {
    /// A sink that passes the depths of a grid on to `inner`; `stop` is the stage's observer.
    pub(crate) fn new(
        checkpoint: &'a Checkpoint,
        inner: &'a mut dyn VolumeSink,
        grid: &Grid,
        stop: &'a GracefulStop<'a>,
    ) -> Self {
        let store = CheckpointStore::new(checkpoint, Stage::Volume, stop);
        Self { inner, store, grid: *grid, stored: Vec::new(), done: 0, waiting: Vec::new() }
    }

    /// Whether this many samples can wait in addition. Capacity for all that follow is reserved at once, so that it never grows.
    fn can_wait(&mut self, samples: usize) -> bool {
        let waiting = self.waiting.len();
        let left = waiting + samples + (self.grid.z.count - self.done) * self.grid.plane_len();
        let capacity = MAX_WAITING.min(left).saturating_sub(waiting);
        waiting + samples <= MAX_WAITING && self.waiting.try_reserve_exact(capacity).is_ok()
    }

    /// Whether all that was computed so far is computed again sooner than an interval ends, and is too much to wait for it.
    fn is_soon_again(&self) -> bool {
        !self.store.wrote && self.grid.voxel_count() > MAX_WAITING as u64
    }

    /// Passes on what is stored of the depths before `end` and was not passed on yet.
    fn pass_stored(&mut self, end: usize) -> Result<()> {
        if self.done >= end {
            return Ok(());
        }
        if !self.waiting.is_empty() {
            self.save(&[])?;
        }
        let mut plane = try_zeroed(self.grid.plane_len() as u64).ok_or_else(|| no_room_for(&self.grid))?;
        while self.done < end {
            if !self.store.load(self.done as u64, &mut plane)? {
                let problem = "a stored depth was deleted or damaged while the job ran; run it again";
                return Err(Error::io("checkpoint", problem));
            }
            self.inner.take(self.done, &plane)?;
            self.done += 1;
        }
        Ok(())
    }

    /// Passes on what is stored after the last depth that was computed.
    ///
    /// # Errors
    /// Those of the inner sink; a stored depth that can no longer be read; [`Error::Interrupted`].
    pub(crate) fn finish(&mut self) -> Result<()> {
        // All depths from there on are stored, or else the reconstruction has failed.
        self.pass_stored(self.stored.len())
    }

    /// Saves the depths that wait, and then `planes`, the last of which is depth `self.done - 1`.
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
        for depth in 0..self.grid.z.count {
            let intact = self.store.load(depth as u64, &mut plane)?;
            if intact && self.done == depth {
                self.inner.take(depth, &plane)?;
                self.done += 1;
            }
            self.stored.push(intact);
        }
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let plane_len = self.grid.plane_len();
        self.pass_stored(first)?;
        // A slab may begin with depths that came from the checkpoint.
        let resumed = (self.done.saturating_sub(first) * plane_len).min(planes.len());
        let planes = &planes[resumed..];
        if planes.is_empty() {
            return Ok(());
        }
        self.inner.take(self.done, planes)?;
        self.done += planes.len() / plane_len;
        if !self.store.is_on() {
            return Ok(());
        }
        if self.store.is_due() {
            return self.save(planes);
        }
        // A complete volume is written as the result immediately.
        if self.done == self.grid.z.count || self.is_soon_again() {
            return Ok(());
        }
        if !self.can_wait(planes.len()) {
            return self.save(planes);
        }
        self.waiting.extend_from_slice(planes);
        Ok(())
    }

    fn wanted(&self, depths: Range<usize>) -> Range<usize> {
        let is_stored = |depth: usize| depth < self.done || self.stored.get(depth).is_some_and(|s| *s);
        needed_among(depths, |depth| !is_stored(depth))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::tests::{INFO, job, opened, opened_for_long, volume};
    use super::*;
    use crate::progress::Silent;

    /// Which of eight depths of a volume are stored once it is complete; they take `mib` MiB each, and come in the first
    /// interval or after it.
    fn stored_of_eight(mib: usize, first_interval: bool) -> Vec<usize> {
        let (_folder, output, identity) = job("volume.npz");
        let checkpoint = opened_for_long(&output, &identity);
        let stop = GracefulStop::new(&checkpoint, &Silent);
        let mut volume = volume([1024, 128 * mib, 8]);
        let grid = volume.grid;
        let mut sink = CheckpointedVolume::new(&checkpoint, &mut volume, &grid, &stop);
        sink.store.wrote = !first_interval;
        sink.begin(&INFO).unwrap();
        let plane = |depth: usize| vec![Complex32::new(depth as f32, 1.0); grid.plane_len()];
        for depth in 0..8 {
            sink.take(depth, &plane(depth)).unwrap();
        }
        assert_eq!(volume.samples, (0..8).flat_map(plane).collect::<Vec<_>>());
        drop(checkpoint);
        let (checkpoint, _) = opened(&output, &identity);
        let stop = GracefulStop::new(&checkpoint, &Silent);
        let mut store = CheckpointStore::new(&checkpoint, Stage::Volume, &stop);
        let mut found = plane(0);
        let is_there = |k: &usize| store.load(*k as u64, &mut found).unwrap() && found == plane(*k);
        (0..8).filter(is_there).collect()
    }

    #[test]
    fn waiting_depths_are_limited_and_the_last_are_left_to_the_result() {
        // Two of 3 MiB may wait: with the third, all are written.
        assert_eq!(
            stored_of_eight(3, false),
            [0, 1, 2, 3, 4, 5],
            "the last two are written as the result at once"
        );
        assert!(stored_of_eight(1, false).is_empty(), "all may wait");
    }

    #[test]
    fn in_the_first_interval_nothing_is_stored() {
        for mib in [1, 3] {
            assert!(stored_of_eight(mib, true).is_empty());
        }
    }
}
