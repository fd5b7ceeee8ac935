//! Where the nodes of an array's tiles stand, and of how many of them a place is made.

use super::frame::bands;
use super::terms::{FEW, MANY, Terms, TileDistances};
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::{Around, IntervalNodes, Taps};

/// The most nodes that are tried along x or y, for each that waves of the band need.
const MOST_NODES: f64 = 4.0;

/// Nodes of all tiles of one size, in the coordinates (x, y, ρ) of each.
#[derive(Debug, Clone)]
pub(crate) struct TileLattice {
    /// How often the array is halved.
    pub(crate) times: u32,
    /// Along x and y; the same for all tiles.
    pub(crate) nodes: [IntervalNodes; 2],
    /// Nodes along ρ stand on whole multiples of this, m.
    pub(crate) pitch: f64,
    pub(crate) taps: Taps,
}

impl TileLattice {
    /// The fewest nodes for the terms of one size of tiles that keep their share of the budget where that is tried, for
    /// each of these numbers of taps along x and y; `along` is of those along ρ, and the fill that they allow.
    pub(crate) fn find(
        terms: &Terms<'_>,
        times: u32,
        budget: ErrorBudget,
        sideways: &[usize],
        (along, fill): &(Taps, f64),
    ) -> Vec<Self> {
        let bands = bands(terms.instrument, terms.grid, terms.tiles);
        let most = TileDistances::of(terms).shortest / (2 * along.count()) as f64;
        let pitch = (0.5 * fill / bands[2].max(f64::MIN_POSITIVE)).min(most);
        // More taps never ask for more nodes.
        let mut least = [1, 1];
        let mut found: Vec<Self> = Vec::new();
        for taps in sideways.iter().rev() {
            let nodes = [0, 1].map(|axis| {
                let nodes = fewest(terms, axis, bands[axis], (*taps, least[axis]), budget)?;
                least[axis] = nodes.len();
                Some(nodes)
            });
            let [Some(x), Some(y)] = nodes else { break };
            found.push(Self { times, nodes: [x, y], pitch, taps: along.clone() });
        }
        found
    }

    /// Columns of nodes.
    pub(crate) fn columns(&self) -> usize {
        self.nodes[0].len() * self.nodes[1].len()
    }

    /// The largest error of a place made of nodes, and by how much it amplifies theirs at most, for the terms of its
    /// tiles; `None` where a node would be where no point has its range.
    pub(crate) fn measured(&self, terms: &Terms<'_>) -> Option<[f64; 2]> {
        let sideways = |axis: usize| {
            let nodes: &IntervalNodes = &self.nodes[axis];
            if !nodes.interpolates() {
                return Some([0.0, 1.0]);
            }
            terms.error(axis, &|place| nodes.around(place), &MANY, f64::INFINITY)
        };
        let ([error_x, sum_x], [error_y, sum_y]) = (sideways(0)?, sideways(1)?);
        let [error_range, sum_range] = terms.error(2, &|range| self.around(range), &MANY, f64::INFINITY)?;
        // Along y first, then x, then ρ.
        Some([error_range + sum_range * (error_x + sum_x * error_y), sum_x * sum_y * sum_range])
    }

    /// The nodes along ρ that a range is made of, m, and their weights.
    fn around(&self, range: f64) -> Around {
        let (first, t) = self.along_range(range);
        let weights = self.taps.weights(t);
        let at = |a: usize| self.pitch * (first + a) as f64;
        ((0..weights.len()).map(at).collect(), weights)
    }

    /// The first node along ρ that a range is made of, and its place after the node before it.
    pub(crate) fn along_range(&self, range: f64) -> (usize, f64) {
        let place = range / self.pitch;
        let own = place.floor();
        ((own as isize + self.taps.first()).max(0) as usize, place - own)
    }

    /// By how much shorter ranges than its own a place needs of its nodes at most, and by how much longer, m.
    pub(crate) fn margin(&self) -> f64 {
        self.pitch * (self.taps.count() / 2 + 1) as f64
    }
}

/// The fewest nodes along x or y, but at least so many, of which terms as tried keep their share of the budget.
fn fewest(
    terms: &Terms<'_>,
    axis: usize,
    band: f64,
    (taps, least): (usize, usize),
    budget: ErrorBudget,
) -> Option<IntervalNodes> {
    let voxels = [terms.grid.x, terms.grid.y][axis];
    let ends = [voxels.first, voxels.last()];
    // What plane waves of the band need at least, and about what they need with so many taps. Found by trying.
    let waves = 2.0 * band * (ends[1] - ends[0]);
    let tolerance = budget.interpolation_axis_of_few();
    let digits = -tolerance.log10();
    let fill = (1.0 - 1.5 * digits / taps as f64).clamp(0.25, 0.9);
    let [few, most] = [0.8 * waves / fill + 2.0, MOST_NODES * waves + 16.0];
    let tried = |count: usize| {
        let nodes = IntervalNodes::new(ends, count, taps, band, tolerance);
        terms.error(axis, &|place| nodes.around(place), &FEW, tolerance).map(|_| nodes)
    };
    let mut count = least.max(few as usize);
    let mut found = None;
    while found.is_none() && (count as f64) < most && count < voxels.count {
        found = tried(count);
        count += 1 + count / 16;
    }
    while let Some(nodes) = &found
        && let fewer = nodes.len() - 1 - nodes.len() / 16
        && fewer >= least.max(1)
        && let Some(fewer) = tried(fewer)
    {
        found = Some(fewer);
    }
    let themselves = || IntervalNodes::themselves(voxels.positions().collect());
    found.or_else(|| (count >= voxels.count).then(themselves))
}
