//! What a plan takes: operations and bytes by closed formulas, never by a clock.
//!
//! Every method's plan states its own cost, from the same numbers that it is carried out with.

use super::volume::Batch;

/// Operations of a complex multiplication and addition.
pub(super) const PRODUCT: f64 = 8.0;

/// Bytes of a complex number in single precision.
pub(super) const COMPLEX: u64 = 8;

/// Bytes of `count` complex numbers in single precision.
pub(super) fn complex_bytes(count: f64) -> u64 {
    (count * COMPLEX as f64) as u64
}

/// What one plan takes.
pub(super) struct Cost<'a> {
    /// Floating-point operations, to within a factor of two, comparable between methods.
    pub(super) operations: f64,
    /// How much is worked on at a time where memory does not matter.
    pub(super) usual: Batch,
    /// Bytes at the peak for such a batch, without the volume and what the source of samples holds.
    pub(super) bytes: Box<dyn Fn(Batch) -> u64 + 'a>,
}
