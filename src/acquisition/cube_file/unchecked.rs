//! The samples of a file as they are, to find those that are not finite, at which any other visit stops.

use super::{CubeFile, conjugate};
use crate::acquisition::Instrument;
use crate::acquisition::source::{CubeSource, Visit, visit_samples};
use crate::error::Result;
use num_complex::Complex32;

/// The samples of a file, also those that are not finite; of several loudspeakers they are read once, and kept.
#[derive(Debug)]
pub struct UncheckedSamples<'a> {
    file: &'a mut CubeFile,
    read: Option<Vec<Complex32>>,
}

impl<'a> UncheckedSamples<'a> {
    pub(super) fn new(file: &'a mut CubeFile) -> Self {
        Self { file, read: None }
    }
}

impl CubeSource for UncheckedSamples<'_> {
    fn instrument(&self) -> &Instrument {
        self.file.instrument()
    }

    fn held_bytes(&self) -> u64 {
        self.file.held_bytes()
    }

    fn visit_transmission(&mut self, transmission: usize, block: usize, visit: &mut Visit) -> Result<()> {
        if self.file.instrument.transmissions() > 1 {
            if self.read.is_none() {
                self.read = Some(self.file.samples()?);
            }
            let samples = self.read.as_deref().unwrap_or_default();
            return visit_samples(&self.file.instrument, (transmission, samples), block, visit);
        }
        let CubeFile { arrays, instrument, conjugated, .. } = &mut *self.file;
        let (n_f, n_mic) = (instrument.sweep.len(), instrument.array.len());
        assert!(transmission == 0, "there is one");
        let mut first = 0;
        arrays.complex_blocks("samples", block.min(n_f) * n_mic, |samples: &mut [Complex32]| {
            if *conjugated {
                conjugate(samples);
            }
            let range = first..first + samples.len() / n_mic;
            first = range.end;
            visit(range, samples)
        })
    }
}
