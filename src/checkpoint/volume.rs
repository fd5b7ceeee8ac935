//! A volume on its way, depth by depth: those of an earlier run first, and the others kept.

use super::{Checkpoint, Pace, Patient, Stage};
use crate::error::Result;
use crate::grid::Grid;
use crate::plan::WAITING;
use crate::reconstruct::{Made, VolumeSink};
use num_complex::Complex32;

/// Samples that may wait to be written; more are written before it is time.
const MOST: usize = WAITING as usize / size_of::<Complex32>();

/// Hands a volume on to a sink, and keeps it.
pub struct KeptVolume<'a> {
    inner: &'a mut dyn VolumeSink,
    pace: Pace<'a>,
    plane_len: usize,
    depths: usize,
    /// Depths that are at hand from the first on.
    done: usize,
    /// Depths that are finished and not kept yet, and the first of them.
    waiting: Vec<Complex32>,
    first: usize,
}

impl std::fmt::Debug for KeptVolume<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("KeptVolume").field("done", &self.done).finish_non_exhaustive()
    }
}

impl<'a> KeptVolume<'a> {
    /// A sink of the depths of a grid before another.
    pub fn new(
        checkpoint: &'a Checkpoint,
        inner: &'a mut dyn VolumeSink,
        grid: &Grid,
        observer: &'a Patient<'a>,
    ) -> Self {
        let (pace, depths) = (Pace::new(checkpoint, observer), grid.z.count);
        Self { inner, pace, plane_len: grid.plane_len(), depths, done: 0, waiting: Vec::new(), first: 0 }
    }

    /// Whether planes can wait beside those that do; there is room for all that may, so that it never grows.
    fn can_wait(&mut self, planes: usize) -> bool {
        let left = (self.depths - self.first) * self.plane_len;
        let most = (MOST + planes).min(left) - self.waiting.len();
        self.waiting.try_reserve_exact(most).is_ok()
    }
}

impl VolumeSink for KeptVolume<'_> {
    fn begin(&mut self, made: &Made) -> Result<()> {
        self.inner.begin(made)?;
        let mut planes = Vec::new();
        while self.pace.checkpoint.recall(Stage::Volume, self.done as u64, &mut planes)
            && !planes.is_empty()
            && planes.len().is_multiple_of(self.plane_len)
        {
            self.inner.take(self.done, &planes)?;
            self.done += planes.len() / self.plane_len;
        }
        self.first = self.done;
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        // What is at hand of these depths already comes first.
        let at_hand = (self.done.saturating_sub(first) * self.plane_len).min(planes.len());
        let planes = &planes[at_hand..];
        self.inner.take(self.done, planes)?;
        self.done += planes.len() / self.plane_len;
        if self.pace.every.is_none() || planes.is_empty() {
            return Ok(());
        }
        let due = self.pace.is_due();
        // What is complete is written as the result right away.
        let complete = self.done == self.depths;
        if self.waiting.is_empty() && (due || !self.can_wait(planes.len())) {
            self.pace.write(Stage::Volume, self.first as u64, planes);
        } else {
            self.waiting.extend_from_slice(planes);
            if !due && (complete || self.waiting.len() < MOST) {
                return Ok(());
            }
            self.pace.write(Stage::Volume, self.first as u64, &self.waiting);
            self.waiting.clear();
        }
        self.first = self.done;
        self.pace.rest()
    }

    fn done(&self) -> usize {
        self.done
    }
}
