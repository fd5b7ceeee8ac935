//! The source of a cube's samples: memory, or a file that is read block by block.

use super::{DataCube, Instrument};
use crate::error::Result;
use num_complex::Complex32;
use std::ops::Range;

/// Receives the samples of a range of frequencies, `[f, n_mic]`.
pub type Visit<'v> = dyn FnMut(Range<usize>, &[Complex32]) -> Result<()> + 'v;

/// A cube whose samples are visited in ascending blocks of frequencies, so that it need never be in memory as a whole.
pub trait CubeSource: Send {
    /// The instrument that measured the samples.
    fn instrument(&self) -> &Instrument;

    /// Bytes of samples that are in memory throughout.
    fn held_bytes(&self) -> u64;

    /// Visits all samples in ascending order, `block` frequencies at a time (the last may be fewer).
    ///
    /// # Errors
    /// Errors of reading and of `visit`.
    fn visit(&mut self, block: usize, visit: &mut Visit) -> Result<()>;
}

impl CubeSource for &DataCube {
    fn instrument(&self) -> &Instrument {
        &self.instrument
    }

    fn held_bytes(&self) -> u64 {
        self.instrument.cube_bytes()
    }

    fn visit(&mut self, block: usize, visit: &mut Visit) -> Result<()> {
        visit_samples(&self.instrument, &self.samples, block, visit)
    }
}

/// Visits samples that are in memory.
pub(super) fn visit_samples(
    instrument: &Instrument,
    samples: &[Complex32],
    block: usize,
    visit: &mut Visit,
) -> Result<()> {
    let (n_f, n_mic) = (instrument.sweep.len(), instrument.array.len());
    for first in (0..n_f).step_by(block) {
        let range = first..(first + block).min(n_f);
        visit(range.clone(), &samples[range.start * n_mic..range.end * n_mic])?;
    }
    Ok(())
}
