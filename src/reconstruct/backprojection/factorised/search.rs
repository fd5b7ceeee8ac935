//! Which sizes of tiles an array is halved to, and their nodes: the fewest operations for errors that are measured.

use super::levels::{Halvings, TileLevels};
use super::nodes::TileLattice;
use super::sequence::{Size, cheapest, in_sequence};
use super::terms::{Terms, TileDistances};
use super::trial;
use crate::acquisition::Instrument;
use crate::error::Result;
use crate::reconstruct::backprojection::profile::Band;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::{GridPlaces, Taps};
use crate::wave::Geometry;
use crate::wave::simd::LANES;
use rayon::prelude::*;

/// The most taps along ρ: their weights are one vector or two.
const MOST_TAPS: [usize; 2] = [LANES, 2 * LANES];

/// Taps along x and y for each decimal digit of accuracy: the more, the fewer nodes, but the farther these see.
const TAPS_PER_DIGIT: [f64; 3] = [2.2, 3.4, 4.8];

/// Of the cheapest sequences, how many are tried before all are given up.
const TRIES: usize = 12;

/// How often a smaller error is asked of the nodes where all of them together err too much.
const TIGHTENED: usize = 3;

/// An array and the points that it is to image.
pub(crate) struct TileSearch<'a> {
    instrument: &'a Instrument,
    points: &'a GridPlaces,
    band: Band,
    halvings: Halvings,
}

impl<'a> TileSearch<'a> {
    pub(crate) fn new(instrument: &'a Instrument, points: &'a GridPlaces, band: Band) -> Self {
        Self { instrument, points, band, halvings: Halvings::of(instrument) }
    }

    /// The sequence of fewest operations by a fixed model, fewer than `most`, whose measured error keeps the budget;
    /// `None` where there is none, or where voxels are before the array or the source.
    pub(crate) fn find(&self, budget: ErrorBudget, most: f64) -> Result<Option<TileLevels>> {
        let (low, high) = self.instrument.array.bounds();
        let source = match self.instrument.geometry {
            Geometry::FixedSource { source } => source.z,
            Geometry::Monostatic => low.z,
            // Both legs change with the microphone, and a tile's node has one for all.
            Geometry::Pair { .. } => return Ok(None),
        };
        // Where ρ grows with depth everywhere.
        if self.points.at(2, 0) <= high.z.max(source) {
            return Ok(None);
        }
        let mut strict = budget;
        for _ in 0..TIGHTENED {
            let Some(levels) = self.fewest(strict, |levels| levels.operations < most) else { break };
            let Some(levels) = self.measured(levels)? else { break };
            if levels.error <= budget.interpolation() {
                return Ok(Some(levels));
            }
            strict = strict.before(1.2 * levels.error / budget.interpolation());
        }
        Ok(None)
    }

    /// The sequence of fewest operations among those that are `wanted`, not yet measured.
    pub(crate) fn fewest(
        &self,
        budget: ErrorBudget,
        wanted: impl Fn(&TileLevels) -> bool,
    ) -> Option<TileLevels> {
        let grid = self.points.evened();
        // Of all sizes with nodes as guessed, then of those of one sequence with nodes that serve.
        let mut sizes = self.sizes(budget);
        let guessed = cheapest(&sizes, self.instrument, &grid, &self.band).into_iter();
        let guessed =
            guessed.filter(|levels| wanted(levels)).take(TRIES).find(|levels| self.has_places(levels))?;
        let own = |size: &Size| guessed.levels.iter().find(|level| level.times == size.times);
        sizes.retain(|size| own(size).is_some());
        for size in &mut sizes {
            let own = own(size);
            size.lattices.retain(|lattice| own.is_some_and(|own| own.has_taps_of(lattice)));
        }
        self.fitted(sizes, budget).filter(|levels| wanted(levels))
    }

    /// The sequence of these sizes, each of its first lattice, with the fewest nodes that serve; those of the smallest tiles in
    /// zones.
    fn fitted(&self, mut sizes: Vec<Size>, budget: ErrorBudget) -> Option<TileLevels> {
        sizes.par_iter_mut().for_each(|size| {
            if let Some(lattice) = size.lattices.first_mut() {
                *lattice = lattice.fitted(&self.terms(size.times), budget);
            }
        });
        if let Some(Size { times, distances, lattices }) = sizes.last_mut()
            && let Some(lattice) = lattices.first_mut()
        {
            *lattice = lattice.zoned(&self.terms(*times), distances, budget);
        }
        let levels = in_sequence(&sizes, self.instrument, &self.points.evened(), &self.band)?;
        self.has_places(&levels).then_some(levels)
    }

    /// The sequence of all sizes after so few and so many halvings, with any number of taps; not yet measured.
    #[cfg(test)]
    pub(crate) fn between(&self, least: u32, most: u32, budget: ErrorBudget) -> Option<TileLevels> {
        let options = self.sizes(budget).first().map_or(0, |size| size.lattices.len());
        let of = |option: usize| {
            let mut sizes = self.sizes(budget);
            sizes.retain(|size| (least..=most).contains(&size.times));
            for size in &mut sizes {
                size.lattices = vec![size.lattices.swap_remove(option)];
            }
            self.fitted(sizes, budget)
        };
        (0..options).find_map(of)
    }

    fn terms(&self, times: u32) -> Terms<'_> {
        let tiles = &self.halvings.0[times as usize];
        Terms { instrument: self.instrument, points: self.points, tiles, from: 0.0 }
    }

    /// All sizes of tiles worth trying, with about the fewest nodes that serve them.
    fn sizes(&self, budget: ErrorBudget) -> Vec<Size> {
        let digits = -budget.interpolation_axis().log10();
        let taps = TAPS_PER_DIGIT.map(|taps| 2 * (0.5 * taps * digits + 0.5) as usize);
        let sideways: Vec<usize> = taps.into_iter().filter(|taps| *taps >= 4).collect();
        let [one, two] = MOST_TAPS;
        let lengths = Taps::lengths(budget.interpolation_axis(), two);
        let longest = |most| lengths.iter().rev().find(|(taps, _)| taps.count() <= most).cloned();
        let mut along: Vec<(Taps, f64)> = [one, two].into_iter().filter_map(longest).collect();
        along.dedup_by_key(|(taps, _)| taps.count());
        let of = |times: u32| {
            let terms = self.terms(times);
            let lattices = TileLattice::guessed(&terms, times, budget, &sideways, &along);
            Size { times, distances: TileDistances::of(&terms), lattices }
        };
        // Halved along both sides, as a rule.
        (0..self.halvings.0.len() as u32).into_par_iter().step_by(2).map(of).collect()
    }

    /// Whether every node is where some point has its range, for all tiles: those of each level are nearer than what is made
    /// of them, the more so the more aside they see it.
    fn has_places(&self, sequence: &TileLevels) -> bool {
        let mut near = self.points.at(2, 0);
        sequence.levels.iter().rev().all(|lattice| {
            let distances = TileDistances::of_all(&self.terms(lattice.times));
            let nearest = distances.nearest(lattice.sideways(), near, lattice.margin());
            near = nearest.unwrap_or(near);
            nearest.is_some()
        })
    }

    /// With error and growth as measured; `None` where that cannot be.
    pub(crate) fn measured(&self, sequence: TileLevels) -> Result<Option<TileLevels>> {
        let growths: Vec<f64> =
            sequence.levels.par_iter().map(|lattice| lattice.growth(self.points)).collect();
        let growth = growths.iter().product();
        let tiles = self.halvings.tiles(&sequence.levels);
        let error = trial::error(&sequence.levels, &tiles, self.instrument, self.points)?;
        Ok(error.map(|error| TileLevels { error, growth, ..sequence }))
    }
}
