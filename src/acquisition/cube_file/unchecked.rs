//! The samples of a file as they are, to find those that are not finite, at which any other visit stops.

use super::{CubeFile, conjugate};
use crate::acquisition::Instrument;
use crate::acquisition::source::{CubeSource, Visit};
use crate::error::Result;
use num_complex::Complex32;

/// The samples of a file, also those that are not finite.
#[derive(Debug)]
pub struct UncheckedSamples<'a>(&'a mut CubeFile);

impl<'a> UncheckedSamples<'a> {
    pub(super) fn new(file: &'a mut CubeFile) -> Self {
        Self(file)
    }
}

impl CubeSource for UncheckedSamples<'_> {
    fn instrument(&self) -> &Instrument {
        self.0.instrument()
    }

    fn held_bytes(&self) -> u64 {
        self.0.held_bytes()
    }

    fn visit_transmission(&mut self, transmission: usize, block: usize, visit: &mut Visit) -> Result<()> {
        let CubeFile { npz, instrument, conjugated, .. } = &mut *self.0;
        let (n_f, n_mic) = (instrument.sweep.len(), instrument.array.len());
        assert!(transmission == 0 && instrument.transmissions() == 1, "several are looked at one by one");
        let mut first = 0;
        npz.complex_blocks("samples", block.min(n_f) * n_mic, |samples: &mut [Complex32]| {
            if *conjugated {
                conjugate(samples);
            }
            let range = first..first + samples.len() / n_mic;
            first = range.end;
            visit(range, samples)
        })
    }
}
