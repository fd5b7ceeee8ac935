//! What sequences of tiles cost, by a fixed model, and the cheapest of them.
//!
//! From the largest tiles down each size follows the one above it that costs least: a tile's nodes depend on what is made
//! of them only by a margin of ranges. So there are as few sequences to compare as there are sizes.

use super::levels::TileLevels;
use super::merge::ROWS;
use super::nodes::TileLattice;
use super::terms::{Ranges, TileDistances};
use crate::acquisition::Instrument;
use crate::grid::Grid;
use crate::reconstruct::backprojection::blocks::{Shape, block_operations};
use crate::reconstruct::backprojection::division::{MOST_SLABS, tone_operations};
use crate::reconstruct::backprojection::profile::Band;
use crate::reconstruct::compress::slab_tones;
use crate::reconstruct::numerics::IntervalNodes;
use crate::wave::simd::LANES;
use rayon::prelude::*;
use std::iter;

/// Operations for each place and tile that it is made of: range and turn; and for each vector of weights along ρ.
const OPERATIONS_PER_PLACE: f64 = 350.0;
const OPERATIONS_ALONG: f64 = 600.0;

/// Operations for placing a node of the smallest tiles.
const OPERATIONS_PER_NODE: f64 = 1500.0;

/// The most tiles that one is made of, as a power of two: rows of all of them are held at a time.
const MOST_MERGED: u32 = 4;

/// Bytes that nodes may take; more only where slabs cannot be thinner.
const MOST_HELD: f64 = 134_217_728.0;

/// Nodes along each axis that are summed at a time, tried in turn.
const LENGTHS: [usize; 12] = [1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 24, 32];

/// Depths whose voxels are made at a time: the more, the fewer of a column's nodes are interpolated for two such.
const DEPTHS: [usize; 2] = [32, 256];

/// Numbers that they are about.
const AT_ONCE: usize = 3 << 20;

/// Depths of a grid whose voxels are made at a time.
fn depths_at_once(grid: &Grid) -> usize {
    let [least, most] = DEPTHS;
    let count = (AT_ONCE / grid.plane_len().max(1)).clamp(least, most);
    // All parts of a volume alike.
    grid.z.count.div_ceil(grid.z.count.div_ceil(count))
}

/// Tiles of one size, and nodes that serve them.
pub(crate) struct Size {
    /// How often the array is halved.
    pub(crate) times: u32,
    pub(crate) distances: TileDistances,
    /// One for each number of taps.
    pub(crate) lattices: Vec<TileLattice>,
}

/// A size of tiles in a sequence, and all above it.
#[derive(Clone)]
struct SequenceStep {
    /// From the largest tiles to this.
    levels: Vec<TileLattice>,
    /// Those of each level in all tiles, for one slab: as computed, and as held.
    nodes: Vec<[f64; 2]>,
    /// Sum of the margins, m.
    margin: f64,
    /// The depth of the nearest node, m.
    near: f64,
    /// For making everything above of these nodes, for one slab.
    operations: f64,
}

/// How many depths slabs may have, the most first: thinner slabs cost more, since each needs nodes before and behind it.
fn slabs(grid: &Grid) -> impl Iterator<Item = usize> {
    let (depths, at_once) = (grid.z.count, depths_at_once(grid));
    let most = depths.div_ceil(at_once);
    let slabs = (0..12).map(|e| 1 << e).take_while(move |slabs| *slabs < 2 * most);
    slabs.map(move |slabs| depths.div_ceil(slabs).next_multiple_of(at_once))
}

/// The sequences with each size as the smallest, cheapest first; all sizes in the order of halvings.
pub(crate) fn cheapest(sizes: &[Size], instrument: &Instrument, grid: &Grid, band: &Band) -> Vec<TileLevels> {
    let mut found: Vec<TileLevels> = Vec::new();
    for slab in slabs(grid) {
        let mut steps: Vec<SequenceStep> = Vec::new();
        for size in sizes {
            let of = |lattice: &TileLattice| {
                let own = size.distances.ranges(lattice.sideways(), slab);
                let first = (size.times <= MOST_MERGED)
                    .then(|| SequenceStep::first(lattice, (size, &own), grid, slab));
                let after = steps.iter().filter_map(|above| above.followed(lattice, (size, &own), slab));
                let mut all: Vec<SequenceStep> = first.into_iter().chain(after).collect();
                all.sort_by(|a, b| a.least().total_cmp(&b.least()));
                all.into_iter().find_map(|step| step.placed(size))
            };
            let steps_here: Vec<SequenceStep> = size.lattices.par_iter().filter_map(of).collect();
            let whole = |step: &SequenceStep| step.whole(size, (grid, slab), instrument, band);
            found.par_extend(steps_here.par_iter().filter_map(whole));
            steps.extend(steps_here);
        }
        found.sort_by(|a, b| a.operations.total_cmp(&b.operations));
        if found.first().is_some_and(|levels| levels.bytes <= MOST_HELD) {
            break;
        }
    }
    found
}

/// The sequence of all these sizes, each with its first lattice; `None` where nodes would have no place.
pub(crate) fn in_sequence(
    sizes: &[Size],
    instrument: &Instrument,
    grid: &Grid,
    band: &Band,
) -> Option<TileLevels> {
    let mut found = None;
    for slab in slabs(grid) {
        let mut last: Option<(SequenceStep, &Size)> = None;
        for size in sizes {
            let lattice = size.lattices.first()?;
            let own = size.distances.ranges(lattice.sideways(), slab);
            let step = match &last {
                None => SequenceStep::first(lattice, (size, &own), grid, slab),
                Some((above, _)) => above.followed(lattice, (size, &own), slab)?,
            };
            last = Some((step.placed(size)?, size));
        }
        let (step, size) = last?;
        let levels = step.whole(size, (grid, slab), instrument, band)?;
        let fits = levels.bytes <= MOST_HELD;
        found = Some(levels);
        if fits {
            break;
        }
    }
    found
}

/// Operations for making a place of the nodes of one tile, where rows have `places` of them.
fn per_place(lattice: &TileLattice, places: usize) -> f64 {
    let [x, y] = lattice.sideways();
    // Rows and columns of nodes hold more along ρ than there are places; multiplications and additions of both parts.
    let rows = 2.2 * y.taps() as f64 * x.len() as f64 / places as f64;
    let vectors = lattice.taps.count().div_ceil(LANES) as f64;
    OPERATIONS_PER_PLACE + vectors * OPERATIONS_ALONG + 4.0 * (rows + 1.7 * x.taps() as f64)
}

impl SequenceStep {
    /// Voxels made of these tiles, whose columns of nodes have these ranges.
    fn first(lattice: &TileLattice, (size, own): (&Size, &Ranges), grid: &Grid, slab: usize) -> Self {
        let voxels = grid.plane_len() as f64 * slab.min(grid.z.count) as f64;
        let operations = voxels * size.distances.tiles as f64 * per_place(lattice, grid.x.count);
        let (levels, nodes) = (Vec::new(), Vec::new());
        Self { levels, nodes, margin: 0.0, near: grid.z.first, operations }.with(lattice.clone(), size, own)
    }

    /// The nodes of the last level made of these tiles; `None` where more would be held at a time than may be.
    fn followed(&self, lattice: &TileLattice, (size, own): (&Size, &Ranges), slab: usize) -> Option<Self> {
        let (Some(above), Some([nodes, _])) = (self.levels.last(), self.nodes.last()) else { return None };
        let halvings = lattice.times - above.times;
        if halvings > MOST_MERGED {
            return None;
        }
        let merged = f64::from(1u32 << halvings);
        // There is no need for more nodes than places are made of them.
        let (mut lattice, mut own) = (lattice.clone(), *own);
        for (nodes, above) in
            lattice.zones.iter_mut().flat_map(|zone| zone.nodes.iter_mut().zip(above.sideways()))
        {
            if nodes.len() >= above.len() {
                *nodes = IntervalNodes::themselves(above.places().to_vec());
            }
        }
        if lattice.sideways().iter().any(|nodes| !nodes.interpolates()) {
            own = size.distances.ranges(lattice.sideways(), slab);
        }
        let operations = nodes * merged * per_place(&lattice, above.sideways()[0].len());
        Some(Self { operations: self.operations + operations, ..self.clone() }.with(lattice, size, &own))
    }

    /// One more level.
    fn with(mut self, lattice: TileLattice, size: &Size, own: &Ranges) -> Self {
        let columns = lattice.mean_columns() * size.distances.tiles as f64;
        let of = |length: f64| {
            columns * ((length + 2.0 * self.margin) / lattice.pitch + lattice.taps.count() as f64)
        };
        // They are held in whole vectors.
        self.nodes.push([of(own.mean), of(own.all + lattice.pitch * (2 * LANES) as f64)]);
        self.margin += lattice.margin();
        self.levels.push(lattice);
        self
    }

    /// The same if all nodes of the last level have a place.
    fn placed(self, size: &Size) -> Option<Self> {
        let lattice = self.levels.last()?;
        let near = size.distances.nearest(lattice.sideways(), self.near, lattice.margin())?;
        Some(Self { near, ..self })
    }

    /// What sequences are compared by that end with the same tiles: everything above, and their own nodes.
    fn least(&self) -> f64 {
        let own = self.nodes.last().map_or(0.0, |[computed, _]| *computed);
        self.operations + own * (OPERATIONS_PER_PLACE + OPERATIONS_ALONG)
    }

    /// As a sequence that ends with these tiles, in blocks of fewest operations.
    fn whole(
        &self,
        Size { distances, .. }: &Size,
        (grid, slab): (&Grid, usize),
        instrument: &Instrument,
        band: &Band,
    ) -> Option<TileLevels> {
        let lattice = self.levels.last()?;
        let [computed, _] = *self.nodes.last()?;
        let (block, half, one) = block(lattice, distances, instrument, band)?;
        let microphones = instrument.array.len() as f64 / distances.tiles as f64;
        // Of one of the largest tiles two levels at a time, beside all of the largest.
        let held: Vec<f64> = self.nodes.iter().map(|[_, held]| 8.0 * held).collect();
        let largest = f64::from(1u32 << self.levels[0].times);
        let two = held[1..].iter().enumerate().map(|(i, own)| own + if i > 0 { held[i] } else { 0.0 });
        let slabs = grid.z.count.div_ceil(slab) as f64;
        let [leaf_slabs, spread] = leaf_slabs(lattice, distances, (block[2], half), instrument);
        let of_volume = instrument.sweep.bandwidth() * (distances.longest - distances.shortest);
        let found = tone_operations([spread, of_volume / instrument.sound_speed], instrument);
        let bytes = held[0] + two.fold(0.0, f64::max) / largest;
        // Of each of the tiles that are merged one row, which needs more than a column and less than all.
        let above = iter::once(0).chain(self.levels.iter().map(|lattice| lattice.times));
        let rows = self.nodes.iter().zip(&self.levels).zip(above).map(|(([column, all], lattice), above)| {
            4.0 * (column + all) / (lattice.sideways()[1].len() as f64 * f64::from(1u32 << above))
        });
        let row_bytes = ROWS as f64 * rows.fold(0.0, f64::max);
        // Where two slabs of depths meet, tones are made for both.
        let made = leaf_slabs + slabs - 1.0;
        Some(TileLevels {
            levels: self.levels.iter().rev().cloned().collect(),
            block,
            half,
            at_once: depths_at_once(grid),
            slab,
            error: 0.0,
            growth: 1.0,
            bytes,
            row_bytes,
            operations: slabs * (self.operations + computed * (microphones * one + OPERATIONS_PER_NODE))
                + made * found,
        })
    }
}

/// Slabs of the smallest tiles' nodes that share their tones, and B·T of one: in blocks of so many nodes along ρ, of profiles of
/// this half-width, m.
fn leaf_slabs(
    lattice: &TileLattice,
    distances: &TileDistances,
    (thickness, half): (usize, f64),
    instrument: &Instrument,
) -> [f64; 2] {
    let shell = lattice.pitch * thickness as f64;
    let shells = ((distances.longest - distances.shortest) / shell).ceil().max(1.0);
    let together = (shells / MOST_SLABS as f64).ceil();
    let paths = together * shell + 2.0 * (instrument.geometry.return_legs() * distances.radius + half);
    [(shells / together).ceil(), instrument.sweep.bandwidth() * paths / instrument.sound_speed]
}

/// Nodes along x, y and ρ that are summed at a time for the fewest operations, their half-width of path lengths in m, and
/// the operations for each node and microphone.
fn block(
    lattice: &TileLattice,
    distances: &TileDistances,
    instrument: &Instrument,
    band: &Band,
) -> Option<([usize; 3], f64, f64)> {
    let [x, y] = lattice.sideways();
    let (legs, digits) = (instrument.geometry.return_legs(), -band.tolerance.log10());
    let lengths = |nodes: &IntervalNodes| {
        let count = nodes.len();
        let even = move |n: &usize| count.div_ceil(count.div_ceil(*n));
        let mut lengths: Vec<usize> = LENGTHS.iter().filter(|n| **n < 2 * count).map(even).collect();
        lengths.dedup();
        lengths
    };
    let (along_x, along_y) = (lengths(x), lengths(y));
    let widest = [x.widest(), y.widest()];
    let blocks = LENGTHS.iter().flat_map(|k| along_y.iter().map(move |j| [*j, *k]));
    let blocks = blocks.flat_map(|[j, k]| along_x.iter().map(move |i| [*i, j, k]));
    let cost = |block: [usize; 3]| {
        if block.iter().product::<usize>() > Shape::MOST_VOXELS {
            return None;
        }
        let [side_x, side_y] = [0, 1].map(|axis: usize| widest[axis] * (block[axis] - 1) as f64);
        let along = lattice.pitch * (block[2] - 1) as f64 / 2.0;
        // Nodes of one range lie on a curved surface, as a rule aslant.
        let half = |distance: f64, [tilt_x, tilt_y]: [f64; 2]| {
            let deep = along + tilt_x * side_x + tilt_y * side_y;
            let across = side_x * side_x + side_y * side_y;
            let (radius, bulge) = (0.5 * (across + deep * deep).sqrt(), across / (4.0 * distance));
            along + bulge + legs * radius * (distances.radius / distance).min(2.0)
        };
        let greatest = half(distances.shortest / 2.0, distances.tilts[1]);
        if !band.holds(greatest) {
            return None;
        }
        let [_, spread] = leaf_slabs(lattice, distances, (block[2], greatest), instrument);
        let tones = slab_tones(spread, instrument);
        let typical = half(distances.typical / 2.0, distances.tilts[0]);
        // The last blocks along x and y may be narrower.
        let [of_x, of_y] = [(x, block[0]), (y, block[1])].map(|(nodes, count)| {
            let whole = nodes.len() / count;
            [(count, whole), (nodes.len() - whole * count, 1)]
        });
        let all = of_x.iter().flat_map(|x| of_y.iter().map(move |y| (x.0 * y.0 * block[2], x.1 * y.1)));
        let sum: f64 = all
            .filter(|(points, _)| *points > 0)
            .map(|(points, blocks)| {
                blocks as f64 * block_operations(points, band.edge(typical), digits, tones)
            })
            .sum();
        Some((block, greatest, sum / (lattice.columns() * block[2]) as f64))
    };
    blocks.filter_map(cost).min_by(|a, b| a.2.total_cmp(&b.2))
}
