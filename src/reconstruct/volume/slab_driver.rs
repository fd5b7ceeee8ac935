//! The one loop over the depths of a volume, which every method fills slab by slab.
//!
//! It takes the slabs in ascending order and a function that computes their planes; it leaves out those that the sink has
//! from an interrupted run, passes finished planes to the sink while the next are computed, and reports progress.

use super::double_buffer::DoubleBuffer;
use super::{ReconstructionInfo, VolumeSink};
use crate::error::Result;
use crate::grid::Grid;
use crate::progress::{Observer, advance, stage};
use num_complex::Complex32;
use std::ops::Range;

/// Neighbouring depths that are computed together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Slab {
    /// The depths, by index.
    pub(crate) depths: Range<usize>,
    /// Units of work that they take: what their computation reports, or what is skipped with them.
    pub(crate) work: u64,
}

/// How the depths of a grid are divided, and how the stage is reported.
pub(crate) struct SlabDriver<'a> {
    pub(crate) grid: &'a Grid,
    /// All depths of the grid, in ascending order.
    pub(crate) slabs: Vec<Slab>,
    /// Slabs that are computed at a time.
    pub(crate) at_once: usize,
    /// Whether some depths of a slab can be computed without the others.
    pub(crate) divisible: bool,
    /// Units of work that belong to no slab.
    pub(crate) other_work: u64,
    /// What the stage is called.
    pub(crate) stage: &'a str,
    pub(crate) observer: &'a dyn Observer,
}

impl<'a> SlabDriver<'a> {
    /// Slabs of `thickness` depths, one at a time; `work` gives the units of work of this many depths.
    pub(crate) fn even(
        grid: &'a Grid,
        thickness: usize,
        work: impl Fn(usize) -> u64,
        observer: &'a dyn Observer,
    ) -> Self {
        let depths = (0..grid.z.count).step_by(thickness);
        let depths = depths.map(|first| first..(first + thickness).min(grid.z.count));
        let slabs = depths.map(|depths| Slab { work: work(depths.len()), depths });
        Self { divisible: true, ..Self::new(grid, slabs.collect(), observer) }
    }

    /// These slabs, one at a time.
    pub(crate) fn new(grid: &'a Grid, slabs: Vec<Slab>, observer: &'a dyn Observer) -> Self {
        Self { grid, slabs, at_once: 1, divisible: false, other_work: 0, stage: "reconstructing", observer }
    }

    /// Bytes of the buffers for `at_once` of `depths` depths at a time, of `plane_len` samples each.
    pub(crate) fn bytes(plane_len: u64, at_once: usize, depths: usize) -> u64 {
        DoubleBuffer::bytes(plane_len, at_once, depths)
    }

    /// Computes all depths that the sink wants and passes them to it, in order; others of their slabs, too, unless these are
    /// divisible.
    ///
    /// `compute` takes which slabs, which depths they are in all, and their planes `[plane, y, x]`, of any content. It
    /// reports the progress.
    ///
    /// # Errors
    /// Those of `sink` and `compute`; [`Error::OutOfMemory`](crate::error::Error::OutOfMemory) when the buffers do not fit
    /// in memory; [`Error::Interrupted`](crate::error::Error::Interrupted).
    pub(crate) fn run(
        self,
        info: ReconstructionInfo,
        sink: &mut dyn VolumeSink,
        mut compute: impl FnMut(Range<usize>, Range<usize>, &mut [Complex32]) -> Result<()> + Send,
    ) -> Result<ReconstructionInfo> {
        let Self { grid, slabs, at_once, divisible, other_work, stage: name, observer } = self;
        let depths = |slabs: &[Slab]| match slabs {
            [] => 0..0,
            [first, ..] => first.depths.start..slabs[slabs.len() - 1].depths.end,
        };
        let work = |slabs: &[Slab]| slabs.iter().map(|slab| slab.work).sum::<u64>();
        sink.begin(&info)?;
        let most = slabs.chunks(at_once).map(|slabs| depths(slabs).len()).max().unwrap_or(0);
        let mut buffer = DoubleBuffer::new(sink, grid, most)?;
        stage(observer, name, other_work + work(&slabs), || {
            for first in (0..slabs.len()).step_by(at_once) {
                let all = first..(first + at_once).min(slabs.len());
                let wanted = buffer.wanted(depths(&slabs[all.clone()]));
                let is_wanted =
                    |slab: &Slab| slab.depths.start < wanted.end && wanted.start < slab.depths.end;
                let before = slabs[all.clone()].iter().take_while(|slab| !is_wanted(slab)).count();
                let count =
                    slabs[all.start + before..all.end].iter().take_while(|slab| is_wanted(slab)).count();
                let part = all.start + before..all.start + before + count;
                advance(observer, work(&slabs[all]) - work(&slabs[part.clone()]))?;
                if part.is_empty() {
                    continue;
                }
                let depths = if divisible { wanted } else { depths(&slabs[part.clone()]) };
                let left_out = |Slab { depths: own, work }: &Slab| {
                    let computed = own.end.min(depths.end) - own.start.max(depths.start);
                    work * (own.len() - computed) as u64 / own.len() as u64
                };
                let left_out = slabs[part.clone()].iter().map(left_out).sum();
                let compute = |planes: &mut [Complex32]| compute(part, depths.clone(), planes);
                buffer.next(depths.start, depths.len(), compute)?;
                advance(observer, left_out)?;
            }
            buffer.flush()
        })?;
        Ok(info)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;
