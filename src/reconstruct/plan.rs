//! Which method a job takes, and at what price: operations and bytes by closed formulas, never by a clock.

mod choice;
mod convolved;
pub(super) mod cost;
mod estimates;
mod projected;

pub(super) use choice::{Candidates, MethodPlan, Sampled, chosen_among, summed};
pub use choice::{LEAST_TOLERANCE, direct_terms, estimate};
pub use estimates::{Estimate, Estimates};
