//! From the sums of a method to the depths of a volume: batches that keep to the memory, the driver that computes slab
//! after slab, the sinks that take them, the sum of several loudspeakers' volumes, correlation, which adds powers, and a
//! frame that moves.

mod batch;
mod checked;
mod compensation;
mod correlation;
mod double_buffer;
#[cfg(test)]
mod fixtures;
mod metered;
mod motion;
mod parts;
mod sink;
mod slab_driver;
mod surroundings;
mod transmissions;

pub(super) use batch::Batch;
pub(super) use checked::Checked;
pub(super) use compensation::{Compensated, Gain};
pub use correlation::Correlation;
pub(super) use correlation::{correlate, estimate_of_correlation};
pub(super) use double_buffer::DoubleBuffer;
pub(super) use metered::Metered;
pub(super) use motion::{estimates_in_motion, in_motion};
#[cfg(test)]
pub(super) use sink::ResumedVolume;
pub(crate) use sink::needed_among;
pub use sink::{ReconstructionInfo, VolumeSink};
pub(super) use slab_driver::{Slab, SlabDriver};
pub(crate) use surroundings::GridSurroundings;
pub(super) use transmissions::{estimates_of_transmissions, sum_of_transmissions, turned_round};
