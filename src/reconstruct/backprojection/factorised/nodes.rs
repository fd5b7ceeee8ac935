//! Where the nodes of an array's tiles stand, and of how many of them a place is made.

use super::frame::{bands, some};
use super::terms::{FEW, MANY, Terms, TileDistances};
use super::zones::Zone;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::{Around, GridPlaces, IntervalNodes, Taps};
use crate::wave::interval::greater;

/// Nodes of all tiles of one size, in the coordinates (x, y, ρ) of each.
#[derive(Debug, Clone)]
pub(crate) struct TileLattice {
    /// How often the array is halved.
    pub(crate) times: u32,
    /// Of how many nodes along x and along y a place may be made.
    pub(super) taps_sideways: usize,
    /// Nodes along x and y, from near to far; the same for all tiles.
    pub(crate) zones: Vec<Zone>,
    /// Nodes along ρ stand on whole multiples of this, m.
    pub(crate) pitch: f64,
    pub(crate) taps: Taps,
}

/// Places along an axis at which growth is measured.
const PLACES: usize = 12;

impl TileLattice {
    /// About the fewest nodes for the terms of one size of tiles, for each of these numbers of taps along x and y, and each
    /// of those along ρ with the fill that these allow.
    pub(crate) fn guessed(
        terms: &Terms<'_>,
        times: u32,
        budget: ErrorBudget,
        sideways: &[usize],
        along: &[(Taps, f64)],
    ) -> Vec<Self> {
        let bands = bands(terms);
        let shortest = TileDistances::of(terms).shortest;
        let of = |sideways: usize| {
            let nodes = [0, 1].map(|axis| guess(terms, axis, bands[axis], sideways, budget));
            along.iter().map(move |(taps, fill)| {
                let most = shortest / (2 * taps.count()) as f64;
                let pitch = (0.5 * fill / bands[2].max(f64::MIN_POSITIVE)).min(most);
                let zones = vec![Zone::whole(nodes.clone())];
                Self { times, taps_sideways: sideways, zones, pitch, taps: taps.clone() }
            })
        };
        sideways.iter().flat_map(|sideways| of(*sideways)).collect()
    }

    /// The same with the fewest nodes that keep their share of the budget where that is tried.
    pub(crate) fn fitted(&self, terms: &Terms<'_>, budget: ErrorBudget) -> Self {
        let guessed = self.sideways();
        let fitted = |axis: usize| fewest(terms, axis, guessed[axis], self.taps_sideways, budget);
        let (x, y) = rayon::join(|| fitted(0), || fitted(1));
        Self { zones: vec![Zone::whole([x, y])], taps: self.taps.clone(), ..*self }
    }

    /// Whether places are made of as many nodes.
    pub(crate) fn has_taps_of(&self, other: &Self) -> bool {
        (self.taps_sideways, self.taps.count()) == (other.taps_sideways, other.taps.count())
    }

    /// Nodes along x and y, where they are most.
    pub(crate) fn sideways(&self) -> [&IntervalNodes; 2] {
        self.zones[0].nodes.each_ref()
    }

    /// Columns of nodes, where they are most.
    pub(crate) fn columns(&self) -> usize {
        self.zones[0].columns()
    }

    /// The largest error of a place made of nodes, and by how much it amplifies theirs at most, for the terms of its
    /// tiles; `None` where a node would be where no point has its range.
    pub(crate) fn measured(&self, terms: &Terms<'_>) -> Option<[f64; 2]> {
        let sideways = |axis: usize| {
            self.zones.iter().try_fold([0.0, 1.0], |[error, sum]: [f64; 2], zone| {
                let nodes: &IntervalNodes = &zone.nodes[axis];
                if !nodes.interpolates() {
                    return Some([error, sum]);
                }
                let terms = Terms { from: self.pitch * zone.from as f64, ..*terms };
                let own = terms.error(axis, &|place| nodes.around(place), &MANY, f64::INFINITY)?;
                Some([greater(error, own[0]), sum.max(own[1])])
            })
        };
        let ([error_x, sum_x], [error_y, sum_y]) = (sideways(0)?, sideways(1)?);
        let [error_range, sum_range] = terms.error(2, &|range| self.around(range), &MANY, f64::INFINITY)?;
        // Along y first, then x, then ρ.
        Some([error_range + sum_range * (error_x + sum_x * error_y), sum_x * sum_y * sum_range])
    }

    /// By how much a place made of nodes amplifies what these err by, at most: the sum of the weights' moduli.
    pub(crate) fn growth(&self, points: &GridPlaces) -> f64 {
        let most = |sums: &mut dyn Iterator<Item = f64>| sums.fold(1.0, f64::max);
        let sum = |weights: &[f64]| weights.iter().map(|w| w.abs()).sum();
        let sideways = |axis: usize| {
            let all = points.along(axis);
            let places: Vec<f64> = some(&all, PLACES).copied().collect();
            let of_zone = |zone: &Zone| {
                let weights = zone.nodes[axis].weights_of(&places);
                most(&mut weights.iter().map(|(_, weights)| sum(weights)))
            };
            most(&mut self.zones.iter().map(of_zone))
        };
        // Half-way is among them, where it is most as a rule.
        let places: Vec<f64> = (0..PLACES).map(|k| k as f64 / PLACES as f64).collect();
        let weights = self.taps.weights_of(&places);
        let along = most(&mut (0..PLACES).map(|n| sum(weights.col_as_slice(n))));
        sideways(0) * sideways(1) * along
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

/// About the fewest nodes along x or y for changes of up to `band` cycles per m; the points themselves if they are no more.
fn guess(terms: &Terms<'_>, axis: usize, band: f64, taps: usize, budget: ErrorBudget) -> IntervalNodes {
    let places = terms.points.along(axis);
    let ends = [places[0], places[places.len() - 1]];
    let tolerance = budget.interpolation_axis_of_few();
    let count = usual_count(band * (ends[1] - ends[0]), taps, tolerance);
    if count < places.len() as f64 {
        IntervalNodes::new(ends, count as usize, taps, band, tolerance)
    } else {
        IntervalNodes::themselves(places)
    }
}

/// Nodes that changes of up to so many cycles from end to end need, about.
pub(crate) fn usual_count(cycles: f64, taps: usize, tolerance: f64) -> f64 {
    // What plane waves need at least, the more the fewer taps, and some more at the ends. Found by trying.
    let (waves, digits) = (2.0 * cycles, -tolerance.log10());
    let of_taps = digits / taps as f64;
    waves * (1.0 + of_taps * (2.1 + 2.7 * of_taps)) + 1.4 * digits
}

/// The fewest nodes along x or y, about as many as guessed, of which terms as tried keep their share of the budget.
fn fewest(
    terms: &Terms<'_>,
    axis: usize,
    guessed: &IntervalNodes,
    taps: usize,
    budget: ErrorBudget,
) -> IntervalNodes {
    if !guessed.interpolates() {
        return guessed.clone();
    }
    let places = terms.points.along(axis);
    let ends = [places[0], places[places.len() - 1]];
    let tolerance = budget.interpolation_axis_of_few();
    let tried = |count: usize| {
        let nodes = IntervalNodes::new(ends, count, taps, guessed.band(), tolerance);
        terms.error(axis, &|place| nodes.around(place), &FEW, tolerance).map(|_| nodes)
    };
    let step = |count: usize| 1 + count / 16;
    let mut count = guessed.len();
    let mut found = tried(count);
    // Where as many do already, fewer may.
    while let Some(nodes) = &found
        && nodes.len() > step(nodes.len())
        && let Some(fewer) = tried(nodes.len() - step(nodes.len()))
    {
        found = Some(fewer);
    }
    while found.is_none() && count + step(count) < places.len() {
        count += step(count);
        found = tried(count);
    }
    found.unwrap_or_else(|| IntervalNodes::themselves(places))
}
