//! How a volume is refined, and how far.

use crate::choice::choice;
use crate::error::{Error, Result};
use crate::with_fields::with_fields;

choice! {
    /// What is minimised.
    #[derive(Default)]
    pub enum Solver: "refinement" {
        /// The sum of squares of what is left of the samples, in few steps.
        Cgls = "cgls",
        /// The same and the sum of the amplitudes' moduli.
        #[default]
        Fista = "fista",
    }
}

/// Parameters of a refinement.
///
/// ```
/// use holosonar::reconstruct::{ReconstructOptions, RefineOptions, Solver};
///
/// let refine = RefineOptions::new(Solver::Fista).with_steps(6_usize);
/// let options = ReconstructOptions::default().with_refine(refine);
/// assert_eq!(options.refine.map(|refine| (refine.steps, refine.sparsity)), Some((6, 0.02)));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct RefineOptions {
    /// How.
    pub solver: Solver,
    /// The most steps. Each takes about as long as two reconstructions.
    pub steps: usize,
    /// Of FISTA: λ, relative to the largest amplitude of the volume that Eq. 13 gives. Where the noise in that volume is more
    /// than half of it, λ is twice the noise's root mean square.
    pub sparsity: f64,
    /// The root mean square of the noise in a sample; measured where it is `None`.
    pub noise: Option<f64>,
}

with_fields! {
    RefineOptions {
        with_steps(steps: usize),
        with_sparsity(sparsity: f64),
        with_noise(noise: Option<f64>),
    }
}

/// The most steps: far more than are of any use.
pub(crate) const MOST_STEPS: usize = 1000;

impl RefineOptions {
    /// Four steps of a solver.
    pub fn new(solver: Solver) -> Self {
        Self { solver, steps: 4, sparsity: 0.02, noise: None }
    }

    /// Refuses what makes no sense.
    pub(crate) fn check(&self) -> Result<()> {
        let refused = |key: &str, what: String| Err(Error::input(format!("refine.{key}"), what));
        if !(1..=MOST_STEPS).contains(&self.steps) {
            return refused("steps", format!("is {}; 1 to {MOST_STEPS} are possible", self.steps));
        }
        if !(0.0..1.0).contains(&self.sparsity) {
            let expected = "a part of the largest amplitude was expected, from 0 to below 1";
            return refused("sparsity", format!("is {}; {expected}", self.sparsity));
        }
        match self.noise {
            Some(noise) if !(noise >= 0.0 && noise.is_finite()) => {
                let expected = "a root mean square in the samples' units was expected, 0 or more";
                refused("noise", format!("is {noise}; {expected}"))
            }
            _ => Ok(()),
        }
    }
}
