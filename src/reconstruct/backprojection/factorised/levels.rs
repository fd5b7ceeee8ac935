//! Which sizes of tiles follow each other, from the smallest, which are summed, to the largest, which voxels are made of.

use super::nodes::TileLattice;
use super::sequence::{Size, cheapest};
use super::terms::{Terms, TileDistances};
use super::trial;
use crate::acquisition::{Instrument, Tile, halvings};
use crate::error::Result;
use crate::grid::Grid;
use crate::reconstruct::backprojection::profile::Band;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::Taps;
use crate::wave::Geometry;
use crate::wave::simd::LANES;
use rayon::prelude::*;

/// The most taps along ρ: their weights are one vector.
const MOST_TAPS: usize = LANES;

/// Taps along x and y for each decimal digit of accuracy: the more, the fewer nodes, but the farther these see.
const TAPS_PER_DIGIT: [f64; 2] = [2.2, 3.4];

/// The most halvings of an array.
const MOST_TIMES: u32 = 12;

/// The least microphones of a tile on average.
const LEAST_MEMBERS: usize = 4;

/// Of the cheapest sequences, how many are tried before all are given up.
const TRIES: usize = 12;

/// How often a smaller error is asked of the nodes where all of them together err too much.
const TIGHTENED: usize = 3;

/// Sizes of tiles and their nodes.
#[derive(Debug, Clone)]
pub(crate) struct TileLevels {
    /// From the smallest tiles, which are summed over their microphones, to the largest, which voxels are made of.
    pub(crate) levels: Vec<TileLattice>,
    /// Nodes along x, y and ρ of the smallest tiles that are summed at a time.
    pub(crate) block: [usize; 3],
    /// By how much a path length differs from that of its block's centre at most, as far as the model tells, m.
    pub(crate) half: f64,
    /// Depths whose voxels are made at a time.
    pub(crate) at_once: usize,
    /// Depths for which nodes are held at a time, a multiple of these.
    pub(crate) slab: usize,
    /// The error of all interpolations, as measured, relative to one.
    pub(crate) error: f64,
    /// By how much all interpolations amplify errors of the smallest tiles' nodes at most.
    pub(crate) growth: f64,
    /// Bytes of all nodes that are held at a time.
    pub(crate) bytes: f64,
    pub(crate) operations: f64,
}

/// An array halved as often as that gives tiles of several microphones.
pub(crate) struct Halvings(Vec<Vec<Tile>>);

impl Halvings {
    pub(crate) fn of(instrument: &Instrument) -> Self {
        let least = |times: &u32| instrument.array.len() >> times >= LEAST_MEMBERS;
        let most = (1..=MOST_TIMES).take_while(least).last().unwrap_or(0);
        Self(halvings(instrument.array.positions(), most))
    }

    /// The tiles of each level, without their microphones.
    pub(crate) fn tiles(&self, levels: &[TileLattice]) -> Vec<&[Tile]> {
        levels.iter().map(|lattice| &self.0[lattice.times as usize][..]).collect()
    }
}

impl TileLevels {
    /// The sequence of fewest operations by a fixed model, fewer than `most`, whose measured error keeps the budget;
    /// `None` where there is none, or where voxels are before the array or the source.
    pub(crate) fn find(
        instrument: &Instrument,
        grid: &Grid,
        band: &Band,
        budget: ErrorBudget,
        most: f64,
    ) -> Result<Option<Self>> {
        let (low, high) = instrument.array.bounds();
        let source = match instrument.geometry {
            Geometry::FixedSource { source } => source.z,
            Geometry::Monostatic => low.z,
            // Both legs change with the microphone, and a tile's node has one for all.
            Geometry::Pair { .. } => return Ok(None),
        };
        // Where ρ grows with depth everywhere.
        if grid.z.first <= high.z.max(source) {
            return Ok(None);
        }
        let halvings = Halvings::of(instrument);
        let mut strict = budget;
        for _ in 0..TIGHTENED {
            let found = Self::sequences(instrument, grid, band, strict, &halvings);
            let placed =
                |levels: &Self| levels.operations < most && levels.has_places(instrument, grid, &halvings);
            let Some(levels) = found.into_iter().take(TRIES).find(placed) else { break };
            let Some(levels) = levels.measured(instrument, grid, &halvings)? else { break };
            if levels.error <= budget.interpolation() {
                return Ok(Some(levels));
            }
            strict = strict.before(1.2 * levels.error / budget.interpolation());
        }
        Ok(None)
    }

    /// All sequences worth trying, cheapest first.
    pub(crate) fn sequences(
        instrument: &Instrument,
        grid: &Grid,
        band: &Band,
        budget: ErrorBudget,
        halvings: &Halvings,
    ) -> Vec<Self> {
        let digits = -budget.interpolation_axis().log10();
        let taps = TAPS_PER_DIGIT.map(|taps| 2 * (0.5 * taps * digits + 0.5) as usize);
        let sideways: Vec<usize> = taps.into_iter().filter(|taps| *taps >= 4).collect();
        let Some(along) = Taps::lengths(budget.interpolation_axis(), MOST_TAPS).pop() else {
            return Vec::new();
        };
        let of = |times: usize| {
            let terms = Terms { instrument, grid, tiles: &halvings.0[times] };
            let lattices = TileLattice::find(&terms, times as u32, budget, &sideways, &along);
            Size { times: times as u32, distances: TileDistances::of(&terms), lattices }
        };
        // Halved along both sides, as a rule.
        let sizes: Vec<Size<'_>> = (0..halvings.0.len()).into_par_iter().step_by(2).map(of).collect();
        cheapest(&sizes, instrument, grid, band)
    }

    /// Whether every node is where some point has its range, for all tiles: those of each level are nearer than what is made
    /// of them, the more so the more aside they see it.
    fn has_places(&self, instrument: &Instrument, grid: &Grid, halvings: &Halvings) -> bool {
        let mut near = grid.z.first;
        self.levels.iter().zip(halvings.tiles(&self.levels)).rev().all(|(lattice, tiles)| {
            let [x, y] = &lattice.nodes;
            let distances = TileDistances::of_all(&Terms { instrument, grid, tiles });
            let nearest = distances.nearest([x, y], near, lattice.margin());
            near = nearest.unwrap_or(near);
            nearest.is_some()
        })
    }

    /// With error and growth as measured; `None` where that cannot be.
    pub(crate) fn measured(
        self,
        instrument: &Instrument,
        grid: &Grid,
        halvings: &Halvings,
    ) -> Result<Option<Self>> {
        let tiles = halvings.tiles(&self.levels);
        let mut growth = 1.0;
        for (lattice, tiles) in self.levels.iter().zip(&tiles) {
            let Some([_, amplified]) = lattice.measured(&Terms { instrument, grid, tiles }) else {
                return Ok(None);
            };
            growth *= amplified;
        }
        let error = trial::error(&self.levels, &tiles, instrument, grid)?;
        Ok(error.map(|error| Self { error, growth, ..self }))
    }

    /// By how much shorter or longer ranges than the voxels' are needed of the smallest tiles at most, m.
    pub(crate) fn margin(&self) -> f64 {
        self.levels.iter().map(TileLattice::margin).sum()
    }
}
