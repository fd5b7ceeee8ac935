//! What a refinement takes.

use super::{RefineOptions, Solver};
use crate::acquisition::Instrument;
use crate::grid::Grid;
use crate::reconstruct::compress::CompressionCost;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::plan::cost::{Cost, complex_bytes};
use crate::reconstruct::upsampling::Upsampling;
use crate::reconstruct::volume::Batch;

impl Solver {
    /// Volumes that are held, and sets of virtual tones at the microphones.
    fn held(self) -> [u64; 2] {
        match self {
            Self::Cgls => [3, 2],
            Self::Fista => [2, 3],
        }
    }
}

/// The cost of a refinement, from that of Eq. 13 by convolution.
pub(in crate::reconstruct) fn price<'a>(
    cost: Cost<'a>,
    upsampling: Option<&'a Upsampling>,
    refine: &RefineOptions,
    (instrument, grid, budget): (&Instrument, &Grid, ErrorBudget),
) -> Cost<'a> {
    let Cost { operations, usual, bytes } = cost;
    let [volumes, sets] = refine.solver.held();
    let interval = instrument.longest_path_interval(grid.bounds());
    let compression = CompressionCost::new(instrument, &interval, budget);
    // To measure the noise: an orthonormal basis of all samples that the grid can cause, as it is found.
    let basis = 4.0 * instrument.sweep.len() as f64 * compression.tones;
    let held = (volumes.saturating_mul(grid.volume_bytes()))
        .saturating_add(
            sets.saturating_mul(compression.samples).saturating_mul(instrument.transmissions() as u64),
        )
        .saturating_add(complex_bytes(basis));
    let of_nodes = upsampling.map(Upsampling::adjoint_bytes);
    let nodes = move |batch: Batch| of_nodes.as_ref().map_or(0, |bytes| bytes(batch.workers));
    Cost {
        // Of Eq. 13 and of its adjoint, once for each step.
        operations: 2.0 * refine.steps as f64 * operations,
        usual,
        bytes: Box::new(move |batch: Batch| bytes(batch).saturating_add(held).saturating_add(nodes(batch))),
    }
}
