//! Two buffers before a sink: finished planes are written from one while the next are computed in the other, so that
//! writing costs one thread and not all.

use super::{ReconstructionInfo, VolumeSink};
use crate::alloc::try_returned;
use crate::error::Result;
use crate::grid::{Grid, no_room_for};
use num_complex::Complex32;
use std::ops::Range;

/// Two sets of planes before a sink.
pub(in crate::reconstruct) struct DoubleBuffer<'a> {
    sink: &'a mut dyn VolumeSink,
    plane_len: usize,
    /// The planes that are computed.
    front: Vec<Complex32>,
    /// The planes that are written.
    back: Vec<Complex32>,
    /// Where the finished planes in `back` begin, and how many samples they are; `None` when there are none.
    finished: Option<(usize, usize)>,
}

impl<'a> DoubleBuffer<'a> {
    /// Buffers for up to `at_once` depths of a grid at a time, two of them unless that is all of it.
    pub(in crate::reconstruct) fn new(
        sink: &'a mut dyn VolumeSink,
        grid: &Grid,
        at_once: usize,
    ) -> Result<Self> {
        let room = |depths: usize| {
            let count = (depths as u64).saturating_mul(grid.plane_len() as u64);
            try_returned(count).ok_or_else(|| no_room_for(grid))
        };
        let all = at_once >= grid.z.count;
        let (front, back) = (room(at_once.min(grid.z.count))?, room(if all { 0 } else { at_once })?);
        Ok(Self { sink, plane_len: grid.plane_len(), front, back, finished: None })
    }

    /// Bytes for depths of `plane_len` samples, `at_once` of `depths` at a time.
    pub(in crate::reconstruct) fn bytes(plane_len: u64, at_once: usize, depths: usize) -> u64 {
        let held = if at_once >= depths { depths } else { 2 * at_once };
        (held as u64 * size_of::<Complex32>() as u64).saturating_mul(plane_len)
    }

    /// Begins the sink.
    pub(in crate::reconstruct) fn begin(&mut self, info: &ReconstructionInfo) -> Result<()> {
        self.sink.begin(info)
    }

    /// What the sink wants of some depths, which come after all that were computed.
    pub(in crate::reconstruct) fn wanted(&self, depths: Range<usize>) -> Range<usize> {
        self.sink.wanted(depths)
    }

    /// Computes `depths` planes from `first` on, in a buffer of any content; meanwhile those before them are written.
    pub(in crate::reconstruct) fn next(
        &mut self,
        first: usize,
        depths: usize,
        compute: impl FnOnce(&mut [Complex32]) -> Result<()> + Send,
    ) -> Result<()> {
        let len = depths * self.plane_len;
        let planes = &mut self.front[..len];
        if let Some((before, len)) = self.finished.take() {
            let (sink, finished) = (&mut *self.sink, &self.back[..len]);
            let (written, computed) = rayon::join(|| sink.take(before, finished), || compute(planes));
            written.and(computed)?;
        } else {
            compute(planes)?;
        }
        std::mem::swap(&mut self.front, &mut self.back);
        self.finished = Some((first, len));
        Ok(())
    }

    /// Writes what is left.
    pub(in crate::reconstruct) fn flush(&mut self) -> Result<()> {
        self.finished.take().map_or(Ok(()), |(first, len)| self.sink.take(first, &self.back[..len]))
    }
}
