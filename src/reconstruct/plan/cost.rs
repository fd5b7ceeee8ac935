//! What a plan takes: operations and bytes by closed formulas, never by a clock.
//!
//! Every method's plan states its own cost, from the same numbers that it is carried out with.

use crate::reconstruct::volume::Batch;

/// Operations of a complex multiplication and addition.
pub(in crate::reconstruct) const PRODUCT: f64 = 8.0;

/// Bytes of a complex number in single precision.
pub(in crate::reconstruct) const COMPLEX: u64 = 8;

/// Bytes of `count` complex numbers in single precision.
pub(in crate::reconstruct) fn complex_bytes(count: f64) -> u64 {
    (count * COMPLEX as f64) as u64
}

/// What one plan takes.
pub(in crate::reconstruct) struct Cost<'a> {
    /// Floating-point operations, as a rule to within 30 %, comparable between methods.
    pub(in crate::reconstruct) operations: f64,
    /// How much is worked on at a time where memory does not matter.
    pub(in crate::reconstruct) usual: Batch,
    /// Bytes at the peak for such a batch, without the volume and what the source of samples holds.
    pub(in crate::reconstruct) bytes: Box<dyn Fn(Batch) -> u64 + 'a>,
}
