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

/// Below this many operations no uneven nodes are looked for; the search takes about as long as so many.
const LEAST_FOR_UNEVEN: f64 = 1e10;
const FINDING_UNEVEN: f64 = 1.5e9;

/// Uneven nodes without tiles hardly ever take less than this part of the operations on even ones.
const UNEVEN: f64 = 0.5;

/// Lines that take this part of the operations of single microphones on even nodes take fewer than uneven nodes or tiles do.
const MUCH_LESS: f64 = 0.25;

/// Tiles of uneven nodes hardly ever take less than this part of the operations of single microphones on even ones.
const LEAST: f64 = 0.05;

/// Below this many operations no tiles are searched for, which take memory for their nodes; the search takes about as long as
/// so many.
const LEAST_FOR_TILES: f64 = 2e10;
const FINDING_TILES: f64 = 2e9;

/// What tiles may take of the operations without them.
const WORTHWHILE: f64 = 0.95;

/// The back-projection of fewest operations, on voxels or nodes, and what it took to find it; without a `search` there are
/// neither lines nor tiles, nor uneven nodes. The last is remembered: a job is planned when its memory is checked, and when it
/// is carried out.
pub(super) fn projected(
    (instrument, grid, budget): (&Instrument, &Grid, ErrorBudget),
    samplings: &[Option<&Upsampling>],
    (search, rival): (bool, f64),
    priced: impl Fn(&Sampled<BackprojectionPlan>) -> Estimate + Sync,
) -> (Sampled<BackprojectionPlan>, f64) {
    type Found = (Sampled<BackprojectionPlan>, f64);
    static LAST: Memo<(Instrument, Grid, ErrorBudget, bool, f64), Found> = Memo::new();
    // By lines only if these take less than `most`.
    let of_sampling = |upsampling: Option<&Upsampling>, most: f64| {
        let points = upsampling.map_or_else(|| GridPlaces::even(grid), Upsampling::places);
        let (_, budget) = summed(upsampling, grid, budget);
        let plan = BackprojectionPlan::new(instrument, points, budget, most);
        let sampled = Sampled { upsampling: upsampling.cloned(), plan };
        let estimate = priced(&sampled);
        (sampled, estimate)
    };
    LAST.of((instrument.clone(), *grid, budget, search, rival), || {
        // Lines are searched for on the fewest nodes, and on the others those that take less.
        let mut samplings = samplings.to_vec();
        samplings.sort_by_key(|upsampling| summed(*upsampling, grid, budget).0.voxel_count());
        let first = of_sampling(samplings[0], if search { rival } else { 0.0 });
        let most = if search { first.1.operations.min(rival) } else { 0.0 };
        let others: Vec<_> =
            samplings[1..].par_iter().map(|upsampling| of_sampling(*upsampling, most)).collect();
        let fewest = first.0.plan.operations_by_microphones();
        let best = least(iter::once(first).chain(others));
        // Uneven nodes, which lines are not made for, are looked for where they or tiles of them may take fewer.
        let most = best.1.operations;
        let worth_more = search && most > MUCH_LESS * fewest;
        let alone = most > LEAST_FOR_UNEVEN && most > UNEVEN * fewest;
        let may_save = worth_more && (alone || most > LEAST_FOR_TILES) && LEAST * fewest < rival;
        let even = samplings.iter().flatten().next().filter(|_| may_save);
        let within = even.and_then(|even| even.within_voxels(instrument, budget));
        let within = within.map(|nodes| of_sampling(Some(&nodes), 0.0));
        let most = within.iter().map(|(_, within)| within.operations).fold(most, f64::min);
        let may_tile = worth_more && most > LEAST_FOR_TILES;
        // On the fewest points, where they may take less than all else.
        let tiled = |(sampled, estimate): &(Sampled<BackprojectionPlan>, Estimate)| {
            let besides = estimate.operations - sampled.plan.operations();
            let plan = sampled.plan.with_tiles(instrument, WORTHWHILE * (most - besides))?;
            let sampled = Sampled { plan, ..sampled.clone() };
            let estimate = priced(&sampled);
            Some((sampled, estimate))
        };
        let tiles = Some(within.as_ref().unwrap_or(&best)).filter(|_| may_tile).and_then(tiled);
        let of_uneven = if even.is_some() { FINDING_UNEVEN } else { 0.0 };
        let of_tiles = if may_tile { FINDING_TILES } else { 0.0 };
        (least(iter::once(best).chain(within).chain(tiles)).0, of_uneven + of_tiles)
    })
}
