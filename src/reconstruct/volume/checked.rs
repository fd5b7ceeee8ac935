//! No volume with a NaN or an infinity: such depths are refused before they are stored or written.
//!
//! Finite samples can still overflow single precision where they add up.

use crate::error::Result;
use crate::grid::{Grid, check_voxels};
use crate::reconstruct::{ReconstructionInfo, VolumeSink};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::OnceLock;

/// A sink that checks what it is given before it passes it on.
pub(crate) struct Checked<'a> {
    pub(crate) grid: Grid,
    /// What is known of the samples when the first depth is.
    pub(crate) incoherent_level: Option<&'a OnceLock<f64>>,
    pub(crate) sink: &'a mut dyn VolumeSink,
}

impl VolumeSink for Checked<'_> {
    fn begin(&mut self, info: &ReconstructionInfo) -> Result<()> {
        let incoherent_level = self.incoherent_level.and_then(|level| level.get().copied());
        self.sink.begin(&ReconstructionInfo { incoherent_level, ..*info })
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let plane = self.grid.plane_len();
        planes
            .par_chunks(plane)
            .enumerate()
            .try_for_each(|(i, voxels)| check_voxels("volume", &self.grid, first + i, voxels))?;
        self.sink.take(first, planes)
    }

    fn wanted(&self, depths: Range<usize>) -> Range<usize> {
        self.sink.wanted(depths)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{Axis, Volume};
    use crate::named::assert_names;

    #[test]
    fn a_depth_that_is_not_finite_is_named_and_not_passed_on() {
        let axis = |count| Axis { first: 0.0, pitch: 1.0, count };
        let grid = Grid { x: axis(3), y: axis(2), z: axis(4) };
        for bad in
            [Complex32::new(0.0, f32::NAN), Complex32::new(f32::INFINITY, 0.0), Complex32::new(2e19, 0.0)]
        {
            let mut volume = Volume { grid, samples: Vec::new() };
            let mut sink = Checked { grid, incoherent_level: None, sink: &mut volume };
            sink.take(0, &[Complex32::ONE; 12]).expect("finite");
            let mut planes = [Complex32::ONE; 12];
            planes[6 + 3 + 1] = bad;
            let refused = sink.take(2, &planes).expect_err("not finite");
            assert_eq!(refused.exit_status(), 2);
            assert_names(refused.to_string(), &["volume", "[3, 1, 1]", "divide"]);
            assert_eq!(volume.samples[12..], [Complex32::ZERO; 12]);
        }
    }
}
