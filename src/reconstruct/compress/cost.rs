//! What compressing a sweep takes.

use super::skeleton::{DENSER, dimensions, is_sparse, witnesses_for};
use super::tones::frequencies_at_once;
use super::virtual_tones;
use crate::acquisition::Instrument;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::plan::cost::{COMPLEX, PRODUCT, complex_bytes};
use crate::wave::interval::PathInterval;

/// Taps of a measured frequency's interpolator, about.
const TAPS: f64 = 12.0;

/// An operation on samples that come from memory takes as long as this many of a loop in the caches.
const FROM_MEMORY: f64 = 3.0;

/// Operations of a skeleton among so many frequencies on an interval of `bandwidth_duration` B·T, as measured up to 640: of its
/// matrices, and of what they are filled with.
fn skeleton_operations(bandwidth_duration: f64, frequencies: f64) -> f64 {
    if is_sparse(bandwidth_duration, frequencies) {
        return 0.0;
    }
    let rows = dimensions(bandwidth_duration);
    rows * witnesses_for(bandwidth_duration).min(frequencies) * (48.0 * rows + 4800.0)
}

/// About how many tones the volume has for so much B·T.
pub(in crate::reconstruct) fn volume_tones(bandwidth_duration: f64) -> f64 {
    2.0 * bandwidth_duration + 8.0
}

/// About how many tones a slab has for so much B·T.
pub(in crate::reconstruct) fn slab_tones(bandwidth_duration: f64, instrument: &Instrument) -> f64 {
    (bandwidth_duration + 10.0).min(instrument.sweep.len() as f64)
}

/// Operations of finding a slab's tones, and of making them of the volume's for all microphones, for the B·T of both.
pub(in crate::reconstruct) fn slab_operations([own, of_volume]: [f64; 2], instrument: &Instrument) -> f64 {
    let all = volume_tones(of_volume).min(instrument.sweep.len() as f64);
    skeleton_operations(own, slab_tones(of_volume, instrument))
        + PRODUCT * slab_tones(own, instrument) * all * instrument.array.len() as f64
}

/// What [`VolumeTones::compress`](super::VolumeTones::compress) takes.
#[derive(Debug, Clone, Copy)]
pub(in crate::reconstruct) struct CompressionCost {
    /// Virtual tones, to within two.
    pub(in crate::reconstruct) tones: f64,
    pub(in crate::reconstruct) operations: f64,
    /// Bytes of the virtual tones' samples at the microphones.
    pub(in crate::reconstruct) samples: u64,
    /// Bytes at the peak, those of the samples included.
    pub(in crate::reconstruct) peak: u64,
    bandwidth: f64,
}

impl CompressionCost {
    /// For all path lengths of `interval`, to within the first compression's share of the budget.
    pub(in crate::reconstruct) fn new(
        instrument: &Instrument,
        interval: &PathInterval,
        budget: ErrorBudget,
    ) -> Self {
        let (n_f, n_mic) = (instrument.sweep.len() as f64, instrument.array.len() as f64);
        let tones = virtual_tones::count(&instrument.sweep, interval, budget.virtual_tones()) as f64;
        let finding = n_f * (10.0 * TAPS * TAPS + 40.0 * TAPS);
        // A sample is demodulated, its modulus taken, and it is added to a few tones with real weights, as fast as memory is.
        let summing = FROM_MEMORY * (2.0 * PRODUCT + 0.5 * PRODUCT * TAPS.min(tones));
        let weights = (n_f * 10.0 * TAPS * 8.0) as u64;
        let frequencies = frequencies_at_once(instrument.array.len()).min(instrument.sweep.len());
        let block = COMPLEX * (frequencies as u64).saturating_mul(instrument.array.len() as u64);
        let samples = complex_bytes(tones * n_mic);
        Self {
            tones,
            operations: finding + summing * n_f * n_mic,
            samples,
            peak: samples.saturating_add(block).saturating_add(weights),
            bandwidth: instrument.sweep.bandwidth(),
        }
    }

    /// Bytes that a thread takes to find the skeleton of a slab among the virtual tones: both at delays, and their difference.
    pub(in crate::reconstruct) fn skeleton_bytes(&self, slab: &PathInterval) -> u64 {
        if is_sparse(self.bandwidth * slab.duration(), self.tones) {
            return (8.0 * self.tones * self.tones) as u64;
        }
        let witnesses = witnesses_for(self.bandwidth * slab.duration()).min(self.tones);
        (3.0 * 8.0 * (DENSER * slab.points_for(self.bandwidth)) as f64 * witnesses) as u64
    }
}
