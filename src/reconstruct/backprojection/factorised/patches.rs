//! Patches of nodes: blocks in a tile's own coordinates, whose sums are taken about one centre.

use super::frame::Frame;
use super::held::{TileNodes, common, hull};
use super::nodes::TileLattice;
use crate::reconstruct::numerics::IntervalNodes;
use crate::wave::Geometry;
use crate::wave::simd::Points;
use glam::DVec3;
use num_complex::Complex32;
use std::ops::Range;

/// Some nodes of one zone of one tile: which of all these, the first along x, y and ρ (as a multiple of the pitch), and how many.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Patch {
    pub(crate) leaf: usize,
    first: [usize; 3],
    count: [usize; 3],
}

/// A patch's nodes in space, about their centre; one that is not needed may be anywhere.
pub(crate) struct Placed {
    pub(crate) centre: DVec3,
    /// In the order x, y, ρ.
    pub(crate) points: Points,
    /// How much a path length of any of the tile's microphones differs from that of the centre at most, m.
    pub(crate) half: f64,
}

impl Patch {
    /// The patches of nodes `shell` along ρ that are needed of a zone of a tile, of at most `block` nodes along x and y.
    pub(crate) fn of<'a>(
        lattice: &TileLattice,
        shell: &Range<usize>,
        [block_x, block_y]: [usize; 2],
        (leaf, nodes): (usize, &'a TileNodes),
    ) -> impl Iterator<Item = Self> + use<'a> {
        let [n_x, n_y] = lattice.zones[nodes.zone].nodes.each_ref().map(IntervalNodes::len);
        let shell = common(shell.clone(), &lattice.along_zone(nodes.zone));
        let (first, depth) = (shell.start, shell.len());
        let rows =
            (0..n_y).step_by(block_y).flat_map(move |y| (0..n_x).step_by(block_x).map(move |x| [x, y]));
        let patch = move |[x, y]: [usize; 2]| {
            let count = [block_x.min(n_x - x), block_y.min(n_y - y), depth];
            Self { leaf, first: [x, y, first], count }
        };
        rows.map(patch).filter(move |patch| {
            patch.columns(n_x).any(|(_, column)| !patch.of_column(nodes, column).is_empty())
        })
    }

    /// The patch cut in two where it has most nodes; `None` if it has but one.
    pub(crate) fn halves(self) -> Option<[Self; 2]> {
        let axis = (0..3).max_by_key(|&axis| self.count[axis]).unwrap_or(0);
        let (mut one, mut other) = (self, self);
        one.count[axis] /= 2;
        other.first[axis] += one.count[axis];
        other.count[axis] -= one.count[axis];
        (one.count[axis] > 0).then_some([one, other])
    }

    /// Its columns: the place among the patch's, and the index among the zone's, of which `n_x` make a row.
    fn columns(&self, n_x: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
        let ([x, y, _], [n, m, _]) = (self.first, self.count);
        (0..n * m).map(move |i| (i, (y + i / n) * n_x + x + i % n))
    }

    /// The nodes along ρ that one of its columns needs.
    fn of_column(&self, nodes: &TileNodes, column: usize) -> Range<usize> {
        let needed = &nodes.needed[column];
        needed.start.max(self.first[2])..needed.end.min(self.first[2] + self.count[2])
    }

    /// Where the nodes stand; `None` where none is needed.
    pub(crate) fn placed(
        &self,
        lattice: &TileLattice,
        geometry: &Geometry,
        nodes: &TileNodes,
        tile_radius: f64,
    ) -> Option<Placed> {
        let [x, y] = &lattice.zones[nodes.zone].nodes;
        let ranges: Vec<f64> =
            (0..self.count[2]).map(|k| lattice.pitch * (self.first[2] + k) as f64).collect();
        let at = |(_, column): (usize, usize)| [x.places()[column % x.len()], y.places()[column / x.len()]];
        let columns: Vec<[f64; 2]> = self.columns(x.len()).map(at).collect();
        let mut depths = nodes.frame.layers(&columns, &ranges);
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let mut all = 0..0;
        for (i, column) in self.columns(x.len()) {
            let needed = self.of_column(nodes, column);
            if !needed.is_empty() {
                let own = needed.start - self.first[2]..needed.end - self.first[2];
                let at = |k: usize| DVec3::new(columns[i][0], columns[i][1], depths[k * columns.len() + i]);
                low = low.min(at(own.start)).min(at(own.end - 1));
                high = high.max(at(own.start)).max(at(own.end - 1));
                all = hull(all, own);
            }
        }
        if all.is_empty() {
            return None;
        }
        // Nodes that are not needed may be anywhere.
        for z in &mut depths {
            *z = z.clamp(low.z, high.z);
        }
        let each = |axis: usize| {
            let layer: Vec<f64> = columns.iter().map(|at| at[axis]).collect();
            layer.repeat(ranges.len())
        };
        let centre = low.midpoint(high);
        let places = [&each(0)[..], &each(1), &depths];
        let points = Points::about(centre.to_array(), geometry, places);
        let own = nodes.frame.range(centre);
        let along = (ranges[all.end - 1] - own).abs().max((ranges[all.start] - own).abs());
        let half =
            half_width(along, (centre, f64::from(points.radius())), geometry, &nodes.frame, tile_radius);
        Some(Placed { centre, points, half })
    }

    /// Puts a patch's image into its place among the nodes, those at each ρ turned by one of `turns`, which begin with those of
    /// node `first` along ρ.
    pub(crate) fn store(
        &self,
        lattice: &TileLattice,
        [re, im]: &[Vec<f32>; 2],
        (first, turns): (usize, &[Complex32]),
        (nodes, [to_re, to_im]): (&TileNodes, &mut [&mut [f32]; 2]),
    ) {
        let layer = self.count[0] * self.count[1];
        for (i, column) in self.columns(lattice.zones[nodes.zone].nodes[0].len()) {
            let needed = self.of_column(nodes, column);
            if needed.is_empty() {
                continue;
            }
            let from = (needed.start - self.first[2]) * layer + i;
            let image = re[from..].iter().step_by(layer).zip(im[from..].iter().step_by(layer));
            let to = column * nodes.held.len() + (needed.start - nodes.held.start);
            let node = to_re[to..][..needed.len()].iter_mut().zip(&mut to_im[to..][..needed.len()]);
            for (((to_re, to_im), (re, im)), turn) in node.zip(image).zip(&turns[needed.start - first..]) {
                let value = Complex32::new(*re, *im) * turn;
                (*to_re, *to_im) = (value.re, value.im);
            }
        }
    }
}

/// By how much a path length to a microphone of the tile differs from that of the centre at most, m, for places whose
/// ranges differ from its own by `along` at most, and that lie up to `aside` from it.
///
/// `path(p, r) − path(c, r)` is the difference of ranges, and that of `|p − r| − |p − r₀|`, whose slope is no greater
/// than `|r − r₀|` over the distance from both.
fn half_width(
    along: f64,
    (centre, aside): (DVec3, f64),
    geometry: &Geometry,
    frame: &Frame,
    tile_radius: f64,
) -> f64 {
    // The distance is rounded to single precision.
    let aside = aside * (1.0 + f64::from(f32::EPSILON));
    let distance = centre.distance(frame.middle()) - aside;
    let slope = 2.0 * tile_radius / (2.0 * distance - tile_radius).max(f64::MIN_POSITIVE);
    along + geometry.return_legs() * aside * slope.min(2.0)
}
