//! How far apart the nodes of a tile may stand, and of how many of them a voxel is made.

use super::frame::{Frame, bands};
use super::terms::{FEW, MANY, Terms, TileDistances};
use crate::acquisition::{Instrument, halvings};
use crate::grid::{Axis, Grid};
use crate::reconstruct::backprojection::blocks::{Shape, block_operations};
use crate::reconstruct::backprojection::profile::Band;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::Around;
use crate::reconstruct::numerics::{NODE_FILLS as FILLS, Nodes, Taps};
use crate::wave::Geometry;
use crate::wave::simd::LANES;
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// The most taps along one axis: a voxel's weights along ρ are one vector.
const MOST_TAPS: usize = LANES;

/// About what weights amplify errors of nodes by, all axes together.
pub(crate) const USUAL_GROWTH: f64 = 6.0;

/// The most halvings of an array.
const MOST_TIMES: u32 = 10;

/// The least microphones of a tile on average.
const LEAST_MEMBERS: usize = 2 * LANES;

/// Bytes that nodes may always take.
const MOST_SMALL: f64 = 268_435_456.0;

/// Of the cheapest divisions, how many are measured before all are given up.
const TRIES: usize = 16;

impl Nodes {
    /// Nodes for changes of up to `band` cycles per m that begin on the first voxel, and half the taps more at both ends;
    /// the voxels themselves if there are not more of them.
    fn along(voxels: &Axis, band: f64, taps: usize, fill: f64) -> Self {
        let extent = voxels.last() - voxels.first;
        let pitch = (0.5 * fill / band).min(extent);
        if pitch > voxels.pitch {
            let count = (extent / pitch).floor() as usize + taps;
            if count < voxels.count {
                let axis = Axis { first: voxels.first - pitch * (taps / 2 - 1) as f64, pitch, count };
                return Self::with_taps(axis, Taps::new(taps, PI * fill));
            }
        }
        Self::themselves(voxels)
    }

    /// The first and the last node, each with the outermost and the innermost voxel that are made of it and the same
    /// others, m.
    fn ends(&self, voxels: &Axis) -> [(f64, [f64; 2]); 2] {
        [(0, voxels.first), (self.axis.count - 1, voxels.last())].map(|(node, end)| {
            let (first, _) = self.first(end);
            let same = voxels.positions().filter(|at| self.first(*at).0 == first);
            let inner =
                same.fold(end, |inner, at| if (at - end).abs() > (inner - end).abs() { at } else { inner });
            (self.axis.position(node), [end, inner])
        })
    }

    /// How far beside a voxel its nodes stand at most, m.
    fn reach(&self) -> f64 {
        if self.interpolates() { self.axis.pitch * self.taps() as f64 / 2.0 } else { 0.0 }
    }
}

/// A division of array and image: tiles of microphones, and nodes in each tile's coordinates.
#[derive(Debug, Clone)]
pub(crate) struct TileLattice {
    /// How often the array is halved.
    pub(crate) times: u32,
    /// Along x and y; the same for all tiles.
    pub(crate) nodes: [Nodes; 2],
    /// Nodes along ρ stand on whole multiples of this, m.
    pub(crate) pitch: f64,
    pub(crate) taps: Taps,
    /// Nodes along x, y and ρ that are summed at a time.
    pub(crate) block: [usize; 3],
    /// By how much a path length differs from that of its block's centre at most, about, m.
    pub(crate) half: f64,
    /// The largest error for exact nodes, relative to `Σ|w m| / Σw`, measured on sampled terms.
    pub(crate) error: f64,
    /// By how much errors of nodes can grow: the largest sums of the weights' moduli.
    pub(crate) growth: f64,
    /// Nodes of all tiles, about.
    pub(crate) count: f64,
    pub(crate) operations: f64,
}

impl TileLattice {
    /// The division of fewest operations; `None` where the voxels come too near to the microphones, or none keeps to its
    /// share of the budget.
    pub(crate) fn find(
        instrument: &Instrument,
        grid: &Grid,
        band: &Band,
        budget: ErrorBudget,
    ) -> Option<Self> {
        let (low, high) = instrument.array.bounds();
        let source = match instrument.geometry {
            Geometry::FixedSource { source } => source.z,
            Geometry::Monostatic => low.z,
        };
        // Where ρ grows with depth everywhere.
        if grid.z.first <= high.z.max(source) {
            return None;
        }
        let lengths = Taps::lengths(budget.interpolation_axis(), MOST_TAPS);
        let least = |times: &u32| instrument.array.len() >> times >= LEAST_MEMBERS;
        let most = (1..=MOST_TIMES).take_while(least).last().unwrap_or(0);
        let levels = halvings(instrument.array.positions(), most);
        let terms = |times: u32| Terms { instrument, grid, tiles: &levels[times as usize] };
        let of = |times: u32| Self::halved(&terms(times), band, (times, budget), &lengths);
        let mut found: Vec<Self> = (0..=most).into_par_iter().flat_map_iter(of).collect();
        found.sort_by(|a, b| a.operations.total_cmp(&b.operations));
        let placed = |lattice: &Self| lattice.has_places(&terms(lattice.times));
        found.into_iter().filter(placed).take(TRIES).find_map(|lattice| {
            let terms = terms(lattice.times);
            lattice.measured(&terms, budget.interpolation())
        })
    }

    /// The divisions into tiles that come of this many halvings.
    fn halved(
        terms: &Terms<'_>,
        band: &Band,
        (times, budget): (u32, ErrorBudget),
        lengths: &[(Taps, f64)],
    ) -> Vec<Self> {
        let Terms { instrument, grid, tiles } = *terms;
        let bands = bands(instrument, grid, tiles);
        let distances = TileDistances::of(instrument, grid, tiles);
        let mut found = Vec::new();
        // Terms bend, so that wide taps carry less than plane waves ask for; the more taps, the fuller the band.
        let mut fullest = [0; 2];
        for (sideways, _) in lengths.iter().rev() {
            let mut fewest = |axis: usize| {
                let kept = |fill: &f64| {
                    let nodes = Nodes::along(&[grid.x, grid.y][axis], bands[axis], sideways.count(), *fill);
                    let error = terms.error(axis, &|place| nodes.around(place), &FEW);
                    error
                        .is_some_and(|[error, _]| error <= budget.interpolation_axis_of_few())
                        .then_some(nodes)
                };
                let from = fullest[axis];
                let (skipped, nodes) =
                    FILLS[from..].iter().map(kept).enumerate().find(|(_, nodes)| nodes.is_some())?;
                fullest[axis] += skipped;
                nodes
            };
            let (Some(x), Some(y)) = (fewest(0), fewest(1)) else { break };
            if x.taps() == 1 && y.taps() == 1 {
                continue;
            }
            for (taps, fill) in lengths {
                let most = distances.shortest / (2 * taps.count()) as f64;
                let lattice = Self {
                    times,
                    nodes: [x.clone(), y.clone()],
                    pitch: (0.5 * fill / (1.03 * bands[2])).min(most),
                    taps: taps.clone(),
                    block: [1; 3],
                    half: 0.0,
                    error: 0.0,
                    growth: 1.0,
                    count: 0.0,
                    operations: f64::INFINITY,
                };
                found.extend(lattice.divided(instrument, grid, &distances, band));
            }
        }
        found
    }

    /// With blocks of nodes of fewest operations by a fixed model.
    fn divided(
        self,
        instrument: &Instrument,
        grid: &Grid,
        distances: &TileDistances,
        band: &Band,
    ) -> Option<Self> {
        let [n_x, n_y] = [0, 1].map(|axis: usize| self.nodes[axis].axis.count);
        let reach = [0, 1].map(|axis: usize| self.nodes[axis].reach());
        let ranges = distances.ranges(grid, reach) / self.pitch + self.taps.count() as f64;
        let (legs, digits) = (instrument.geometry.return_legs(), -band.tolerance.log10());
        let columns = (n_x * n_y) as f64;
        let depths = Shape::sizes(ranges.ceil() as usize).filter(|n| (4..=64).contains(n));
        let blocks = depths
            .flat_map(|k| Shape::sizes(n_y).flat_map(move |j| Shape::sizes(n_x).map(move |i| [i, j, k])));
        let cost = |block: [usize; 3]| {
            let points = block.iter().product::<usize>();
            let side = |axis: usize| self.nodes[axis].axis.pitch * (block[axis] - 1) as f64;
            let along = self.pitch * (block[2] - 1) as f64 / 2.0;
            let radius = (side(0).hypot(side(1)) / 2.0).hypot(along / 2.0);
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
        let (block, half, one) = blocks.filter_map(cost).min_by(|a, b| a.2.total_cmp(&b.2))?;
        // Blocks are not cut to the nodes that a column needs.
        let each = columns * (ranges + 0.5 * block[2] as f64);
        let tiles = distances.tiles as f64;
        let count = tiles * each;
        let interpolating = grid.voxel_count() as f64 * tiles * OPERATIONS_PER_VOXEL;
        let operations = instrument.array.len() as f64 * each * one + interpolating;
        // No more memory than the voxels take, or not much.
        let held = count * 8.0;
        (held <= (4.0 * grid.volume_bytes() as f64).max(MOST_SMALL)).then(|| Self {
            block,
            half,
            count,
            operations,
            ..self
        })
    }

    /// Whether every node is where some point has its range.
    ///
    /// That is least so of the nodes farthest aside, which only the outermost voxels are made of, for the nearest of these.
    fn has_places(&self, terms: &Terms<'_>) -> bool {
        let Terms { instrument, grid, tiles } = *terms;
        let [x, y] =
            [(&grid.x, &self.nodes[0]), (&grid.y, &self.nodes[1])].map(|(axis, nodes)| nodes.ends(axis));
        tiles.iter().all(|tile| {
            let frame = Frame::new(&instrument.geometry, tile.centre);
            let mut corners = x.iter().flat_map(|x| y.iter().map(move |y| (x, y)));
            corners.all(|((node_x, voxels_x), (node_y, voxels_y))| {
                let voxels = voxels_x.iter().flat_map(|x| voxels_y.map(|y| DVec3::new(*x, y, grid.z.first)));
                let nearest = voxels.map(|p| frame.range(p)).fold(f64::INFINITY, f64::min);
                let range = self.pitch * self.along_range(nearest).0 as f64;
                frame.point(*node_x, *node_y, range).is_some()
            })
        })
    }

    /// With errors and growth as measured; `None` if they pass `tolerance`.
    fn measured(self, terms: &Terms<'_>, tolerance: f64) -> Option<Self> {
        let [error_x, sum_x] = terms.error(0, &|place| self.nodes[0].around(place), &MANY)?;
        let [error_y, sum_y] = terms.error(1, &|place| self.nodes[1].around(place), &MANY)?;
        let [error_range, sum_range] = terms.error(2, &|range| self.around(range), &MANY)?;
        // Along y first, then x, then ρ.
        let error = error_range + sum_range * (error_x + sum_x * error_y) + TABLE_ERROR;
        let growth = sum_x * sum_y * sum_range;
        (error <= tolerance && growth < 3.0 * USUAL_GROWTH).then_some(Self { error, growth, ..self })
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
}

/// Operations for each voxel and tile: range, turn, and interpolation, in which memory takes most of the time.
const OPERATIONS_PER_VOXEL: f64 = 1200.0;

/// What the table of weights along ρ errs by, linear between its entries.
const TABLE_ERROR: f64 = 6e-6;
