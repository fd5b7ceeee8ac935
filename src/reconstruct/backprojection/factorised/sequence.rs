//! What sequences of tiles cost, by a fixed model, and the cheapest of them.
//!
//! From the largest tiles down each size follows the one above it that costs least: a tile's nodes depend on what is made
//! of them only by a margin of ranges. So there are as few sequences to compare as there are sizes.

use super::levels::TileLevels;
use super::nodes::TileLattice;
use super::terms::TileDistances;
use crate::acquisition::Instrument;
use crate::grid::Grid;
use crate::reconstruct::backprojection::blocks::{Shape, block_operations};
use crate::reconstruct::backprojection::profile::Band;
use crate::reconstruct::numerics::IntervalNodes;

/// Operations for each place and tile that it is made of: range, turn, and interpolation along ρ.
const OPERATIONS_PER_PLACE: f64 = 1200.0;

/// Operations for placing a node of the smallest tiles.
const OPERATIONS_PER_NODE: f64 = 1500.0;

/// The most tiles that one is made of, as a power of two: rows of all of them are held at a time.
const MOST_MERGED: u32 = 4;

/// Bytes that nodes may take; more only where slabs cannot be thinner.
const MOST_HELD: f64 = 134_217_728.0;

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
pub(crate) struct Size<'a> {
    /// How often the array is halved.
    pub(crate) times: u32,
    pub(crate) distances: TileDistances<'a>,
    /// With more and with fewer taps.
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
    /// For making everything above of these nodes, for one slab.
    operations: f64,
}

/// The sequences with each size as the smallest, cheapest first; all sizes in the order of halvings.
pub(crate) fn cheapest(
    sizes: &[Size<'_>],
    instrument: &Instrument,
    grid: &Grid,
    band: &Band,
) -> Vec<TileLevels> {
    let at_once = depths_at_once(grid);
    let most = grid.z.count.div_ceil(at_once);
    let mut found: Vec<TileLevels> = Vec::new();
    // Thinner slabs cost more, since each needs nodes before and behind it.
    for slabs in (0..12).map(|e| 1 << e).filter(|slabs| *slabs < 2 * most) {
        let slab = grid.z.count.div_ceil(slabs).next_multiple_of(at_once);
        let slabs = grid.z.count.div_ceil(slab) as f64;
        let mut steps: Vec<SequenceStep> = Vec::new();
        for size in sizes {
            let of = |lattice: &TileLattice| {
                let first =
                    (size.times <= MOST_MERGED).then(|| SequenceStep::first(lattice, size, grid, slab));
                let after = steps.iter().filter_map(|above| above.followed(lattice, size, slab));
                first.flatten().into_iter().chain(after).min_by(|a, b| a.least().total_cmp(&b.least()))
            };
            let steps_here: Vec<SequenceStep> = size.lattices.iter().filter_map(of).collect();
            let whole = |step: &SequenceStep| {
                let levels = step.whole(&size.distances, instrument, band)?;
                Some(TileLevels { at_once, slab, operations: slabs * levels.operations, ..levels })
            };
            found.extend(steps_here.iter().filter_map(whole));
            steps.extend(steps_here);
        }
        found.sort_by(|a, b| a.operations.total_cmp(&b.operations));
        if found.first().is_some_and(|levels| levels.bytes <= MOST_HELD) {
            break;
        }
    }
    found
}

/// Operations for making a place of the nodes of one tile, where rows have `places` of them.
fn per_place(lattice: &TileLattice, places: usize) -> f64 {
    let [x, y] = &lattice.nodes;
    // Rows and columns of nodes hold more along ρ than there are places; multiplications and additions of both parts.
    let rows = 2.2 * y.taps() as f64 * x.len() as f64 / places as f64;
    OPERATIONS_PER_PLACE + 4.0 * (rows + 1.7 * x.taps() as f64)
}

impl SequenceStep {
    /// Voxels made of these tiles.
    fn first(lattice: &TileLattice, size: &Size<'_>, grid: &Grid, slab: usize) -> Option<Self> {
        let voxels = grid.plane_len() as f64 * slab.min(grid.z.count) as f64;
        let operations = voxels * size.distances.tiles as f64 * per_place(lattice, grid.x.count);
        let above = Self { levels: Vec::new(), nodes: Vec::new(), margin: 0.0, operations };
        above.with(lattice.clone(), size, slab)
    }

    /// The nodes of the last level made of these tiles.
    fn followed(&self, lattice: &TileLattice, size: &Size<'_>, slab: usize) -> Option<Self> {
        let (Some(above), Some([nodes, _])) = (self.levels.last(), self.nodes.last()) else { return None };
        let halvings = lattice.times - above.times;
        if halvings > MOST_MERGED {
            return None;
        }
        let merged = f64::from(1u32 << halvings);
        // There is no need for more nodes than places are made of them.
        let mut lattice = lattice.clone();
        for (nodes, above) in lattice.nodes.iter_mut().zip(&above.nodes) {
            if nodes.len() >= above.len() {
                *nodes = IntervalNodes::themselves(above.places().to_vec());
            }
        }
        let operations = nodes * merged * per_place(&lattice, above.nodes[0].len());
        Self { operations: self.operations + operations, ..self.clone() }.with(lattice, size, slab)
    }

    /// One more level; `None` where some of its nodes would have no place.
    fn with(self, lattice: TileLattice, size: &Size<'_>, slab: usize) -> Option<Self> {
        let Self { mut levels, mut nodes, margin, operations } = self;
        let [x, y] = &lattice.nodes;
        let ranges = size.distances.ranges([x, y], slab);
        let columns = (x.len() * y.len()) as f64 * size.distances.tiles as f64;
        let of =
            |length: f64| columns * ((length + 2.0 * margin) / lattice.pitch + lattice.taps.count() as f64);
        let own = [of(ranges.mean), of(ranges.all)];
        let margin = margin + lattice.margin();
        (ranges.spare > margin).then(|| {
            nodes.push(own);
            levels.push(lattice);
            Self { levels, nodes, margin, operations }
        })
    }

    /// What sequences are compared by that end with the same tiles: everything above, and their own nodes.
    fn least(&self) -> f64 {
        let own = self.nodes.last().map_or(0.0, |[computed, _]| *computed);
        self.operations + own * OPERATIONS_PER_PLACE
    }

    /// As a sequence that ends with these tiles, in blocks of fewest operations.
    fn whole(
        &self,
        distances: &TileDistances<'_>,
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
        let bytes = held[0] + two.fold(0.0, f64::max) / largest;
        Some(TileLevels {
            levels: self.levels.iter().rev().cloned().collect(),
            block,
            half,
            at_once: 0,
            slab: 0,
            error: 0.0,
            growth: 1.0,
            bytes,
            operations: self.operations + computed * (microphones * one + OPERATIONS_PER_NODE),
        })
    }
}

/// Nodes along x, y and ρ that are summed at a time for the fewest operations, their half-width of path lengths in m, and
/// the operations for each node and microphone.
fn block(
    lattice: &TileLattice,
    distances: &TileDistances<'_>,
    instrument: &Instrument,
    band: &Band,
) -> Option<([usize; 3], f64, f64)> {
    let [x, y] = &lattice.nodes;
    let (legs, digits) = (instrument.geometry.return_legs(), -band.tolerance.log10());
    let blocks = [4, 8, 16, 32, 64].into_iter();
    let blocks = blocks
        .flat_map(|k| Shape::sizes(y.len()).flat_map(move |j| Shape::sizes(x.len()).map(move |i| [i, j, k])));
    let cost = |block: [usize; 3]| {
        let points = block.iter().product::<usize>();
        let side = |nodes: &IntervalNodes, count: usize| nodes.widest() * (count - 1) as f64;
        let along = lattice.pitch * (block[2] - 1) as f64 / 2.0;
        let radius = (side(x, block[0]).hypot(side(y, block[1])) / 2.0).hypot(along / 2.0);
        let half = |distance: f64| along + legs * radius * (distances.radius / distance).min(2.0);
        let widest = half(distances.shortest / 2.0);
        if points > Shape::MOST_VOXELS || !band.holds(widest) {
            return None;
        }
        let shell = 2.0 * (along + legs * distances.radius + widest);
        let tones =
            (band.bandwidth * shell / instrument.sound_speed + 10.0).min(instrument.sweep.len() as f64);
        let typical = half(distances.typical / 2.0);
        let one = block_operations(points, band.edge(typical), digits, tones) / points as f64;
        Some((block, widest, one))
    };
    blocks.filter_map(cost).min_by(|a, b| a.2.total_cmp(&b.2))
}
