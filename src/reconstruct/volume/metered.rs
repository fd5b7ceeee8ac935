//! The level of a cube's samples, measured while a method reads them, so that none is read for it alone.

use crate::acquisition::{CubeSource, Instrument, Visit};
use crate::error::Result;
use crate::reconstruct::window::Weights;
use std::sync::OnceLock;

/// A source that measures `√Σ|w m|²`, the rms amplitude that samples of these powers and of random phases add up to.
///
/// Every method visits all samples before the first depth, when the level must be known.
pub(crate) struct Metered<'a> {
    pub(crate) source: &'a mut dyn CubeSource,
    pub(crate) weights: &'a Weights,
    /// Known after the first visit.
    pub(crate) level: &'a OnceLock<f64>,
}

impl CubeSource for Metered<'_> {
    fn instrument(&self) -> &Instrument {
        self.source.instrument()
    }

    fn held_bytes(&self) -> u64 {
        self.source.held_bytes()
    }

    fn visit_transmission(&mut self, transmission: usize, block: usize, visit: &mut Visit) -> Result<()> {
        let Self { source, weights, level } = self;
        if level.get().is_some() {
            return source.visit_transmission(transmission, block, visit);
        }
        let (n_mic, mut power) = (source.instrument().array.len(), 0.0);
        source.visit_transmission(transmission, block, &mut |range, samples| {
            let rows = range.clone().zip(samples.chunks_exact(n_mic));
            power += rows.map(|(f, row)| weights.power(f, row)).sum::<f64>();
            visit(range, samples)
        })?;
        level.get_or_init(|| power.sqrt());
        Ok(())
    }
}
