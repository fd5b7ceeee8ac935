//! Spherical spreading undone in a finished volume.
//!
//! An echo from p arrives as `(1 m)²/(|p − s| |p − r|)` of its amplitude. Multiplying the voxels by `|p − s| |p − r_c|` with
//! the array's centre r_c is as accurate as weighting every term of the sum, as long as the array is not much larger than its
//! distance, and costs nothing.

use crate::acquisition::Instrument;
use crate::error::Result;
use crate::grid::Grid;
use crate::reconstruct::{ReconstructionInfo, VolumeSink};
use crate::wave::spreading;
use glam::DVec3;
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// The factor of every voxel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Gain {
    grid: Grid,
    speaker: DVec3,
    centre: DVec3,
}

impl Gain {
    /// That of a measurement on the voxels of a grid.
    pub(crate) fn new(instrument: &Instrument, grid: &Grid) -> Self {
        let centre = instrument.array.centre();
        Self { grid: *grid, speaker: instrument.viewpoint(), centre }
    }

    pub(super) fn at(&self, p: DVec3) -> f64 {
        1.0 / spreading(p.distance(self.speaker), p.distance(self.centre))
    }

    fn multiply(&self, plane: usize, samples: &mut [Complex32]) {
        let row = self.grid.x.count;
        samples.par_chunks_mut(row).enumerate().for_each(|(iy, samples)| {
            for (ix, sample) in samples.iter_mut().enumerate() {
                *sample *= self.at(self.grid.position(ix, iy, plane)) as f32;
            }
        });
    }

    /// How a volume was computed, with the bound on its error as large as the largest factor makes it.
    pub(crate) fn info(&self, info: &ReconstructionInfo) -> ReconstructionInfo {
        // Either distance is largest at a corner.
        let greatest =
            |from: DVec3| self.grid.corners().into_iter().map(|p| p.distance(from)).fold(0.0, f64::max);
        let most = 1.0 / spreading(greatest(self.speaker), greatest(self.centre));
        ReconstructionInfo { error_bound: info.error_bound * most, ..*info }
    }
}

/// A sink that multiplies what it is given before it passes it on; without a gain it passes it on as it is.
pub(crate) struct Compensated<'a> {
    gain: Option<Gain>,
    sink: &'a mut dyn VolumeSink,
    planes: Vec<Complex32>,
}

impl<'a> Compensated<'a> {
    pub(crate) fn new(gain: Option<Gain>, sink: &'a mut dyn VolumeSink) -> Self {
        Self { gain, sink, planes: Vec::new() }
    }
}

impl VolumeSink for Compensated<'_> {
    fn begin(&mut self, info: &ReconstructionInfo) -> Result<()> {
        self.sink.begin(&self.gain.map_or(*info, |gain| gain.info(info)))
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let Some(gain) = &self.gain else { return self.sink.take(first, planes) };
        self.planes.clear();
        self.planes.extend_from_slice(planes);
        for (i, plane) in self.planes.chunks_exact_mut(gain.grid.plane_len()).enumerate() {
            gain.multiply(first + i, plane);
        }
        self.sink.take(first, &self.planes)
    }

    fn wanted(&self, depths: Range<usize>) -> Range<usize> {
        self.sink.wanted(depths)
    }
}
