//! A sink for a whole volume of Eq. 13 that measures it on the way.

use crate::error::Result;
use crate::reconstruct::{ReconstructionInfo, VolumeSink};
use num_complex::Complex32;
use rayon::prelude::*;

/// Voxels, and the measures of those that came.
pub(super) struct Descent<'a> {
    plane_len: usize,
    voxels: &'a mut [Complex32],
    /// `Σ|A|²`.
    pub(super) square: f64,
    /// The largest `|A|²`, and its depth.
    pub(super) largest: f64,
    pub(super) brightest: usize,
}

impl<'a> Descent<'a> {
    /// For planes of this many voxels.
    pub(super) fn new(voxels: &'a mut [Complex32], plane_len: usize) -> Self {
        Self { plane_len, voxels, square: 0.0, largest: 0.0, brightest: 0 }
    }
}

impl VolumeSink for Descent<'_> {
    fn begin(&mut self, _: &ReconstructionInfo) -> Result<()> {
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        self.voxels[first * self.plane_len..][..planes.len()].copy_from_slice(planes);
        let measures = planes.par_chunks(self.plane_len).map(|plane| {
            let squares = plane.iter().map(|a| f64::from(a.norm_sqr()));
            squares.fold((0.0, 0.0f64), |(sum, most), square| (sum + square, most.max(square)))
        });
        for (iz, (sum, most)) in (first..).zip(measures.collect::<Vec<_>>()) {
            self.square += sum;
            if most > self.largest {
                (self.largest, self.brightest) = (most, iz);
            }
        }
        Ok(())
    }
}
