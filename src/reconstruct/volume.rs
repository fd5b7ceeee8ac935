//! From the sums of a method to the depths of a volume: batches that keep to the memory, the driver that computes slab
//! after slab, and the sinks that take them.

mod batch;
mod checked;
mod compensation;
mod double_buffer;
mod sink;
mod slab_driver;

pub(super) use batch::Batch;
pub(super) use checked::Checked;
pub(super) use compensation::{Compensated, Gain};
#[cfg(test)]
pub(super) use sink::ResumedVolume;
pub use sink::{ReconstructionInfo, VolumeSink};
pub(super) use slab_driver::{Slab, SlabDriver};
