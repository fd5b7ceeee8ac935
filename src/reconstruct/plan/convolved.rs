//! The convolutions that a job could take: of its voxels, or of nodes.

use super::choice::{Sampled, least, summed};
use super::estimates::Estimate;
use crate::acquisition::Instrument;
use crate::grid::Grid;
use crate::reconstruct::convolution::{ConvolutionPlan, SharedLattice};
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::GridPlaces;
use crate::reconstruct::upsampling::Upsampling;
use rayon::prelude::*;
use std::iter;

/// Below this many operations no uneven depths are found, which takes about as long as a thirtieth of them.
const LEAST_FOR_UNEVEN: f64 = 3e10;

/// Uneven depths hardly ever save more than this part of all operations.
const LEAST_OF_EVEN: f64 = 0.5;

/// A convolution, and its price.
pub(super) type Convolution = (Sampled<ConvolutionPlan>, Estimate);

/// The convolutions that there are for one job, at their `price`.
pub(super) struct Convolutions<'a, P> {
    pub(super) job: (&'a Instrument, &'a Grid, ErrorBudget),
    pub(super) refines: bool,
    pub(super) price: P,
}

impl<P: Fn(&Sampled<ConvolutionPlan>) -> Estimate + Sync> Convolutions<'_, P> {
    /// That of fewest operations, on voxels, of which it is known, or nodes.
    ///
    /// # Errors
    /// Why there is none, and how to fix that.
    pub(super) fn best(
        &self,
        on_voxels: Result<Convolution, String>,
        nodes: &[Upsampling],
    ) -> Result<Convolution, String> {
        let on_nodes: Vec<Result<Convolution, String>> =
            nodes.par_iter().map(|nodes| self.on(Some(nodes))).collect();
        // Those that are possible first; of several obstacles that of the voxels themselves.
        let operations = |found: &Result<Convolution, String>| {
            found.as_ref().map_or(f64::INFINITY, |(_, estimate)| estimate.operations)
        };
        let found = iter::once(on_voxels).chain(on_nodes);
        found
            .min_by(|a, b| operations(a).total_cmp(&operations(b)))
            .expect("the voxels themselves are sampled")
    }

    /// The same with fewer, uneven depths, if that may take less than it and than another method of `rival` operations. A
    /// refinement takes the adjoint, too, for which nodes are even.
    pub(super) fn with_fewer_depths(&self, best: Convolution, rival: f64) -> Convolution {
        let (instrument, grid, budget) = self.job;
        let operations = best.1.operations;
        if self.refines || operations < LEAST_FOR_UNEVEN || LEAST_OF_EVEN * operations > rival {
            return best;
        }
        let nodes = Upsampling::depths_within(best.0.upsampling.as_ref(), (instrument, grid), budget);
        let fewer = nodes.and_then(|nodes| self.on(Some(&nodes)).ok());
        least([best].into_iter().chain(fewer))
    }

    /// That on the voxels, or on nodes.
    ///
    /// # Errors
    /// Why there is none, and how to fix that.
    pub(super) fn on(&self, upsampling: Option<&Upsampling>) -> Result<Convolution, String> {
        let (instrument, grid, budget) = self.job;
        let (_, budget) = summed(upsampling, grid, budget);
        let places = upsampling.map_or_else(|| GridPlaces::even(grid), Upsampling::places);
        let mut lattices = SharedLattice::find(instrument, &places, budget)?;
        if self.refines || !places.are_even() {
            lattices.retain(|lattice| lattice.near.is_empty());
        }
        if lattices.is_empty() {
            return Err(TOO_NEAR.to_owned());
        }
        let of_lattice = |lattice| {
            let plan = ConvolutionPlan::new(instrument, places.clone(), lattice, budget);
            let plan = if self.refines { plan.in_stretches(usize::MAX) } else { plan };
            let sampled = Sampled { upsampling: upsampling.cloned(), plan };
            let estimate = (self.price)(&sampled);
            (sampled, estimate)
        };
        Ok(least(lattices.into_iter().map(of_lattice)))
    }
}

/// What a refinement wants.
const TOO_NEAR: &str = "a refinement takes voxels that are further than half a wave from the array's plane; begin the grid there";
