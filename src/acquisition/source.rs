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

    /// Visits all samples of a transmission in ascending order, `block` frequencies at a time (the last may be fewer).
    ///
    /// # Errors
    /// Errors of reading and of `visit`.
    ///
    /// # Panics
    /// If there are not so many [transmissions](Instrument::transmissions).
    fn visit_transmission(&mut self, transmission: usize, block: usize, visit: &mut Visit) -> Result<()>;

    /// The same for a cube of one loudspeaker, or of a scan.
    ///
    /// # Errors
    /// Errors of reading and of `visit`.
    ///
    /// # Panics
    /// If there are several transmissions, whose samples do not follow one another.
    fn visit(&mut self, block: usize, visit: &mut Visit) -> Result<()> {
        assert_eq!(self.instrument().transmissions(), 1, "a transmission is visited by its number");
        self.visit_transmission(0, block, visit)
    }
}

/// Some transmissions of a cube, as a cube of their own.
pub(crate) struct SomeTransmissions<'a> {
    source: &'a mut dyn CubeSource,
    instrument: Instrument,
    first: usize,
}

impl<'a> SomeTransmissions<'a> {
    /// Neighbouring ones.
    ///
    /// # Panics
    /// If there are not so many, or none.
    pub(crate) fn of(source: &'a mut dyn CubeSource, which: Range<usize>) -> Self {
        let instrument = source.instrument().some_transmissions(which.clone());
        Self { source, instrument, first: which.start }
    }

    /// One of them.
    ///
    /// # Panics
    /// If there are not so many.
    pub(crate) fn one(source: &'a mut dyn CubeSource, index: usize) -> Self {
        Self::of(source, index..index + 1)
    }
}

impl CubeSource for SomeTransmissions<'_> {
    fn instrument(&self) -> &Instrument {
        &self.instrument
    }

    fn held_bytes(&self) -> u64 {
        self.source.held_bytes()
    }

    fn visit_transmission(&mut self, transmission: usize, block: usize, visit: &mut Visit) -> Result<()> {
        assert!(transmission < self.instrument.transmissions(), "there are not so many");
        self.source.visit_transmission(self.first + transmission, block, visit)
    }
}

impl CubeSource for &DataCube {
    fn instrument(&self) -> &Instrument {
        &self.instrument
    }

    fn held_bytes(&self) -> u64 {
        self.instrument.cube_bytes()
    }

    fn visit_transmission(&mut self, transmission: usize, block: usize, visit: &mut Visit) -> Result<()> {
        visit_samples(&self.instrument, (transmission, &self.samples), block, visit)
    }
}

/// Visits a transmission of samples that are in memory, `[n_tx, n_f, n_mic]`.
pub(super) fn visit_samples(
    instrument: &Instrument,
    (transmission, samples): (usize, &[Complex32]),
    block: usize,
    visit: &mut Visit,
) -> Result<()> {
    let (n_f, n_mic) = (instrument.sweep.len(), instrument.array.len());
    let samples = &samples[transmission * n_f * n_mic..][..n_f * n_mic];
    for first in (0..n_f).step_by(block) {
        let range = first..(first + block).min(n_f);
        visit(range.clone(), &samples[range.start * n_mic..range.end * n_mic])?;
    }
    Ok(())
}
