//! From the sums of a method to the depths of a volume: batches that keep to the memory, the double buffer that hands
//! finished depths on while the next are worked on, and the sinks that take them.

mod batch;
mod compensation;
mod double_buffer;
mod sink;

pub(super) use batch::Batch;
pub(super) use compensation::Compensated;
pub(super) use double_buffer::Handover;
pub use sink::{Made, VolumeSink};
