//! Which method a job takes, and at what price: operations and bytes by closed formulas, never by a clock.

mod choice;
mod cost;

pub(super) use choice::{Choice, Options};
pub use choice::{direct_terms, estimate};
pub use cost::{Estimate, Estimates};
