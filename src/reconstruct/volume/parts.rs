//! Volumes that are put together from many images of a few tones each: slab by slab, so that they need little memory and
//! keep what an interrupted run has.

use super::transmissions::{part_of, slabs};
use crate::acquisition::CubeView;
use crate::blocks::NoStore;
use crate::error::Result;
use crate::grid::Grid;
use crate::progress::{Observer, OfPart, advance, stage};
use crate::reconstruct::plan::Candidates;
use crate::reconstruct::{Method, ReconstructOptions, ReconstructionInfo, VolumeSink, by_candidates};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Some depths as a grid of their own, and those of them that are wanted.
pub(super) struct PartOfGrid<'a> {
    pub(super) grid: Grid,
    wanted: Range<usize>,
    observer: &'a dyn Observer,
}

impl PartOfGrid<'_> {
    /// Images a few tones by a method, and adds what `add` makes of each voxel to what there is of it.
    ///
    /// # Errors
    /// Those of the image.
    pub(super) fn add<T: Send>(
        &self,
        (method, options): (Method, &ReconstructOptions),
        mut cube: CubeView<'_>,
        voxels: &mut [T],
        add: impl Fn(&mut T, &Complex32) + Send + Sync,
    ) -> Result<()> {
        use crate::acquisition::CubeSource;

        let Self { grid, wanted, observer } = self;
        let plan = Candidates::only(method, cube.instrument(), grid, options)?;
        let plane = grid.plane_len();
        let mut sum = AddedTones { voxels, add, plane, wanted: wanted.clone(), observer: *observer };
        by_candidates(&mut cube, (grid, plan), options, (&mut sum, &mut NoStore, None), &OfPart(*observer))?;
        Ok(())
    }
}

/// A sink that adds to voxels what it is given of them.
struct AddedTones<'a, T, F> {
    voxels: &'a mut [T],
    add: F,
    plane: usize,
    wanted: Range<usize>,
    observer: &'a dyn Observer,
}

impl<T: Send, F: Fn(&mut T, &Complex32) + Send + Sync> VolumeSink for AddedTones<'_, T, F> {
    fn begin(&mut self, _: &ReconstructionInfo) -> Result<()> {
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let voxels = &mut self.voxels[first * self.plane..][..planes.len()];
        voxels.par_iter_mut().zip(planes).for_each(|(voxel, a)| (self.add)(voxel, a));
        advance(self.observer, (planes.len() / self.plane) as u64)
    }

    fn wanted(&self, depths: Range<usize>) -> Range<usize> {
        let start = depths.start.max(self.wanted.start).min(depths.end);
        start..depths.end.min(self.wanted.end).max(start)
    }
}

/// Gives a sink the depths that it wants, from slabs of `images` that `compute` puts together.
///
/// # Errors
/// Those of `compute` and of the sink; `Error::Interrupted`.
pub(super) fn in_slabs(
    grid: &Grid,
    sink: &mut dyn VolumeSink,
    (name, images): (&str, usize),
    observer: &dyn Observer,
    compute: &mut dyn FnMut(&PartOfGrid<'_>) -> Result<Vec<Complex32>>,
) -> Result<()> {
    let plane = grid.plane_len();
    stage(observer, name, (images * grid.z.count) as u64, || {
        for depths in slabs(grid) {
            let wanted = sink.wanted(depths.clone());
            advance(observer, (images * (depths.len() - wanted.len())) as u64)?;
            if wanted.is_empty() {
                continue;
            }
            let within = wanted.start - depths.start..wanted.end - depths.start;
            let part = PartOfGrid { grid: part_of(grid, &depths), wanted: within.clone(), observer };
            let planes = compute(&part)?;
            sink.take(wanted.start, &planes[within.start * plane..within.end * plane])?;
        }
        Ok(())
    })
}
