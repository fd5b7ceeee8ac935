//! The back-projection that a job could take: by single microphones, lines or tiles, of its voxels or of nodes.

use super::choice::{Sampled, least, summed};
use super::estimates::Estimate;
use crate::acquisition::Instrument;
use crate::grid::Grid;
use crate::reconstruct::backprojection::BackprojectionPlan;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::Memo;
use crate::reconstruct::upsampling::Upsampling;
use rayon::prelude::*;
use std::iter;

/// The back-projection of fewest operations, on voxels or nodes; without a `search` there are neither lines nor tiles.
/// The last is remembered: a job is planned when its memory is checked, and when it is carried out.
pub(super) fn projected(
    (instrument, grid, budget): (&Instrument, &Grid, ErrorBudget),
    samplings: &[Option<&Upsampling>],
    (search, rival): (bool, f64),
    priced: impl Fn(&Sampled<BackprojectionPlan>) -> Estimate + Sync,
) -> Sampled<BackprojectionPlan> {
    static LAST: Memo<(Instrument, Grid, ErrorBudget, bool, f64), Sampled<BackprojectionPlan>> = Memo::new();
    // With tiles, or by lines only if these take less than `most`.
    let of_sampling = |upsampling: Option<&Upsampling>, most: Option<f64>| {
        let (grid, budget) = summed(upsampling, grid, budget);
        let plan = match most {
            Some(most) => BackprojectionPlan::without_tiles(instrument, grid, budget, most),
            None => BackprojectionPlan::new(instrument, grid, budget, rival),
        };
        let sampled = Sampled { upsampling: upsampling.cloned(), plan };
        let estimate = priced(&sampled);
        (sampled, estimate)
    };
    LAST.of((instrument.clone(), *grid, budget, search, rival), || {
        // Tiles are searched for on the fewest nodes, and on the others lines that take less than those.
        let mut samplings = samplings.to_vec();
        samplings.sort_by_key(|upsampling| summed(*upsampling, grid, budget).0.voxel_count());
        let first = of_sampling(samplings[0], (!search).then_some(0.0));
        let most = if search { first.1.operations.min(rival) } else { 0.0 };
        let others: Vec<_> =
            samplings[1..].par_iter().map(|upsampling| of_sampling(*upsampling, Some(most))).collect();
        least(iter::once(first).chain(others)).0
    })
}
