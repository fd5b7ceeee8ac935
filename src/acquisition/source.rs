//! Where samples come from: memory, or a file that is read block by block.

use super::{DataCube, Setup};
use crate::error::Result;
use num_complex::Complex32;
use std::ops::Range;

/// Takes the samples of a range of frequencies, `[f, n_mic]`.
pub type Visit<'v> = dyn FnMut(Range<usize>, &[Complex32]) -> Result<()> + 'v;

/// A cube whose samples are visited in ascending blocks of frequencies, so that it need never be held whole.
pub trait CubeSource: Send {
    /// The measurement.
    fn setup(&self) -> Setup<'_>;

    /// Bytes of samples that are held in memory all along.
    fn held_bytes(&self) -> u64;

    /// Visits all samples in ascending order, `block` frequencies at a time (the last may be fewer).
    ///
    /// # Errors
    /// What reading or `visit` comes to.
    fn visit(&mut self, block: usize, visit: &mut Visit) -> Result<()>;
}

impl CubeSource for &DataCube {
    fn setup(&self) -> Setup<'_> {
        DataCube::setup(self)
    }

    fn held_bytes(&self) -> u64 {
        DataCube::setup(self).cube_bytes()
    }

    fn visit(&mut self, block: usize, visit: &mut Visit) -> Result<()> {
        let (n_f, n_mic) = (self.sweep.len(), self.array.len());
        for first in (0..n_f).step_by(block) {
            let range = first..(first + block).min(n_f);
            visit(range.clone(), &self.samples[range.start * n_mic..range.end * n_mic])?;
        }
        Ok(())
    }
}
