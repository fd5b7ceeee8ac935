//! Sizes of tiles that follow each other, from the smallest, which are summed, to the largest, which voxels are made of.

use super::nodes::TileLattice;
use crate::acquisition::{Instrument, Tile, halvings};

/// The most halvings of an array.
const MOST_TIMES: u32 = 12;

/// The least microphones of a tile on average.
const LEAST_MEMBERS: usize = 4;

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
    /// Bytes that a thread needs for rows of the tiles that are merged.
    pub(crate) row_bytes: f64,
    pub(crate) operations: f64,
}

impl TileLevels {
    /// By how much shorter or longer ranges than the voxels' are needed of the smallest tiles at most, m.
    pub(crate) fn margin(&self) -> f64 {
        self.levels.iter().map(TileLattice::margin).sum()
    }
}

/// An array halved as often as that gives tiles of several microphones: the tiles of each number of halvings.
pub(crate) struct Halvings(pub(crate) Vec<Vec<Tile>>);

impl Halvings {
    pub(crate) fn of(instrument: &Instrument) -> Self {
        let least = |times: &u32| instrument.array.len() >> times >= LEAST_MEMBERS;
        let most = (1..=MOST_TIMES).take_while(least).last().unwrap_or(0);
        Self(halvings(instrument.array.positions(), most))
    }

    /// The tiles of each level.
    pub(crate) fn tiles(&self, levels: &[TileLattice]) -> Vec<&[Tile]> {
        levels.iter().map(|lattice| &self.0[lattice.times as usize][..]).collect()
    }
}
