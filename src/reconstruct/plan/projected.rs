//! The back-projection that a job could take: by single microphones, lines or tiles, of its voxels or of nodes.

use super::choice::{Sampled, least, summed};
use super::estimates::Estimate;
use crate::acquisition::Instrument;
use crate::grid::Grid;
use crate::reconstruct::backprojection::BackprojectionPlan;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::{GridPlaces, Memo};
use crate::reconstruct::upsampling::Upsampling;
use rayon::prelude::*;
use std::iter;

/// Below this many operations no uneven nodes are found, which takes about as long as a tenth of them.
const LEAST_FOR_UNEVEN: f64 = 1e10;

/// Uneven nodes are hardly ever fewer than this part of even ones.
const LEAST_OF_EVEN: f64 = 0.5;

/// The back-projection of fewest operations, on voxels or nodes; without a `search` there are neither lines nor tiles, nor
/// uneven nodes. The last is remembered: a job is planned when its memory is checked, and when it is carried out.
pub(super) fn projected(
    (instrument, grid, budget): (&Instrument, &Grid, ErrorBudget),
    samplings: &[Option<&Upsampling>],
    (search, rival): (bool, f64),
    priced: impl Fn(&Sampled<BackprojectionPlan>) -> Estimate + Sync,
) -> Sampled<BackprojectionPlan> {
    static LAST: Memo<(Instrument, Grid, ErrorBudget, bool, f64), Sampled<BackprojectionPlan>> = Memo::new();
    // With tiles, or by lines only if these take less than `most`.
    let of_sampling = |upsampling: Option<&Upsampling>, most: Option<f64>| {
        let points = upsampling.map_or_else(|| GridPlaces::even(grid), Upsampling::places);
        let (_, budget) = summed(upsampling, grid, budget);
        let plan = match most {
            Some(most) => BackprojectionPlan::without_tiles(instrument, points, budget, most),
            None => BackprojectionPlan::new(instrument, points, budget, rival),
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
        let best = least(iter::once(first).chain(others));
        // Uneven nodes, which neither lines nor tiles are made for, are looked for where they may take fewer.
        let fewest = LEAST_OF_EVEN * best.0.plan.operations_by_microphones();
        let may_save = search && fewest < rival && best.1.operations > LEAST_FOR_UNEVEN.max(fewest);
        let even = samplings.iter().flatten().next().filter(|_| may_save);
        let within = even.and_then(|even| even.within_voxels(instrument, budget));
        let within = within.map(|nodes| of_sampling(Some(&nodes), Some(0.0)));
        least(iter::once(best).chain(within)).0
    })
}
