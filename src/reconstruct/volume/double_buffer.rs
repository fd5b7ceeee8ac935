//! Finished planes go to the sink while the next are worked on, so that writing them costs one thread and not all.

use crate::alloc::try_zeroed;
use crate::error::Result;
use crate::grid::Grid;
use crate::reconstruct::{VolumeSink, no_room_for};
use num_complex::Complex32;

/// Two sets of planes before a sink: one is worked on, the other handed on.
pub(crate) struct Handover<'a> {
    sink: &'a mut dyn VolumeSink,
    plane_len: usize,
    planes: Vec<Complex32>,
    /// Finished, where there are any: those from this depth on, and how many samples they are.
    finished: Vec<Complex32>,
    waiting: Option<(usize, usize)>,
}

impl<'a> Handover<'a> {
    /// Room for up to `at_once` depths of a grid, twice unless that is all of it.
    pub(crate) fn new(sink: &'a mut dyn VolumeSink, grid: &Grid, at_once: usize) -> Result<Self> {
        let room = |depths: usize| {
            let count = (depths as u64).saturating_mul(grid.plane_len() as u64);
            try_zeroed(count).ok_or_else(|| no_room_for(grid))
        };
        let all = at_once >= grid.z.count;
        let (planes, finished) = (room(at_once.min(grid.z.count))?, room(if all { 0 } else { at_once })?);
        Ok(Self { sink, plane_len: grid.plane_len(), planes, finished, waiting: None })
    }

    /// Bytes for depths of so many samples in all, `at_once` of `depths` at a time.
    pub(crate) fn bytes(plane_len: u64, at_once: usize, depths: usize) -> u64 {
        let held = if at_once >= depths { depths } else { 2 * at_once };
        (held as u64 * size_of::<Complex32>() as u64).saturating_mul(plane_len)
    }

    /// Depths that need not be worked on; see [`VolumeSink::done`].
    pub(crate) fn done(&self) -> usize {
        self.sink.done()
    }

    /// Works on `depths` planes from `first` on, which hold what they held before; meanwhile those before them are
    /// handed on.
    pub(crate) fn next(
        &mut self,
        first: usize,
        depths: usize,
        work: impl FnOnce(&mut [Complex32]) -> Result<()> + Send,
    ) -> Result<()> {
        let len = depths * self.plane_len;
        let planes = &mut self.planes[..len];
        if let Some((before, len)) = self.waiting.take() {
            let (sink, finished) = (&mut *self.sink, &self.finished[..len]);
            let (handed, worked) = rayon::join(|| sink.take(before, finished), || work(planes));
            handed.and(worked)?;
        } else {
            work(planes)?;
        }
        std::mem::swap(&mut self.planes, &mut self.finished);
        self.waiting = Some((first, len));
        Ok(())
    }

    /// Hands on what is left.
    pub(crate) fn finish(self) -> Result<()> {
        self.waiting.map_or(Ok(()), |(first, len)| self.sink.take(first, &self.finished[..len]))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::error::Error;
    use crate::grid::{Axis, Volume};
    use crate::reconstruct::Made;

    fn grid() -> Grid {
        let axis = |count| Axis { first: 1.0, pitch: 0.1, count };
        Grid { x: axis(3), y: axis(2), z: axis(10) }
    }

    fn numbered(first: usize, planes: &mut [Complex32]) {
        let number = |i: usize| Complex32::new((6 * first + i) as f32, 1.0);
        planes.iter_mut().enumerate().for_each(|(i, voxel)| *voxel = number(i));
    }

    #[test]
    fn all_depths_come_once_in_order_however_many_at_once() {
        for at_once in [1, 3, 5, 10, 17] {
            let mut volume = Volume { grid: grid(), samples: Vec::new() };
            let mut handover = Handover::new(&mut volume, &grid(), at_once).unwrap();
            for first in (0..10).step_by(at_once) {
                let depths = at_once.min(10 - first);
                let work = |planes: &mut [Complex32]| {
                    numbered(first, planes);
                    Ok(())
                };
                handover.next(first, depths, work).unwrap();
            }
            handover.finish().unwrap();
            let mut expected = vec![Complex32::ZERO; 60];
            numbered(0, &mut expected);
            assert_eq!(volume.samples, expected, "{at_once} at once");
        }
    }

    struct Full;

    impl VolumeSink for Full {
        fn begin(&mut self, _: &Made) -> Result<()> {
            Ok(())
        }

        fn take(&mut self, first: usize, _: &[Complex32]) -> Result<()> {
            if first == 0 { Ok(()) } else { Err(Error::io("disk", "full")) }
        }
    }

    #[test]
    fn what_the_sink_and_the_work_come_to_is_passed_on() {
        let full = Err(Error::io("disk", "full"));
        let mut sink = Full;
        let mut handover = Handover::new(&mut sink, &grid(), 2).unwrap();
        handover.next(0, 2, |_| Ok(())).unwrap();
        handover.next(2, 2, |_| Ok(())).unwrap();
        assert_eq!(handover.next(4, 2, |_| Ok(())), full);
        let mut handover = Handover::new(&mut sink, &grid(), 2).unwrap();
        handover.next(8, 2, |_| Ok(())).unwrap();
        assert_eq!(handover.finish(), full);
        let mut handover = Handover::new(&mut sink, &grid(), 2).unwrap();
        assert_eq!(handover.next(0, 2, |_| Err(Error::Interrupted)), Err(Error::Interrupted));
    }
}
