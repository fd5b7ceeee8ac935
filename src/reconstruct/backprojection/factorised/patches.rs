//! Patches of nodes: blocks in a tile's own coordinates, whose sums are taken about one centre.

use super::frame::Frame;
use super::merge::TileNodes;
use super::nodes::TileLattice;
use crate::wave::Geometry;
use crate::wave::simd::Points;
use glam::DVec3;
use num_complex::Complex32;
use std::ops::Range;

/// Some nodes of one tile: the first along x, y and ρ (as a multiple of the pitch), and how many.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Patch {
    pub(crate) tile: usize,
    first: [usize; 3],
    count: [usize; 3],
}

/// A patch's nodes in space.
pub(crate) struct Placed {
    pub(crate) centre: DVec3,
    /// How much a path length of any of the tile's microphones differs from that of the centre at most, m.
    pub(crate) half: f64,
    /// In the order x, y, ρ; `None` where none is needed.
    places: Vec<Option<DVec3>>,
}

impl Placed {
    /// The nodes about the centre.
    pub(crate) fn points(&self, geometry: &Geometry) -> Points {
        let out = geometry.outward_length(self.centre);
        let point = |place: &Option<DVec3>| {
            // A node that is not needed may be anywhere.
            let p = place.unwrap_or(self.centre);
            let d = p - self.centre;
            [d.x, d.y, d.z, geometry.outward_length(p) - out]
        };
        Points::new(geometry.return_legs(), self.places.iter().map(point))
    }
}

impl Patch {
    /// The patches of nodes `shell` along ρ that a tile needs, of at most `block` nodes along x and y.
    pub(crate) fn of<'a>(
        lattice: &TileLattice,
        shell: &Range<usize>,
        [block_x, block_y]: [usize; 2],
        (tile, nodes): (usize, &'a TileNodes),
    ) -> impl Iterator<Item = Self> + use<'a> {
        let [n_x, n_y] = [0, 1].map(|axis: usize| lattice.nodes[axis].len());
        let (first, depth) = (shell.start, shell.len());
        let rows =
            (0..n_y).step_by(block_y).flat_map(move |y| (0..n_x).step_by(block_x).map(move |x| [x, y]));
        let patch = move |[x, y]: [usize; 2]| {
            let count = [block_x.min(n_x - x), block_y.min(n_y - y), depth];
            Self { tile, first: [x, y, first], count }
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

    /// Its columns: the place among the patch's, and the index among a tile's, of which `n_x` make a row.
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
        let ([x, y], [n, m, depth]) = ([&lattice.nodes[0], &lattice.nodes[1]], self.count);
        let mut places = vec![None; n * m * depth];
        let ranges: Vec<f64> = (0..depth).map(|k| lattice.pitch * (self.first[2] + k) as f64).collect();
        let mut depths = vec![0.0; depth];
        for (i, column) in self.columns(x.len()) {
            let needed = self.of_column(nodes, column);
            if needed.is_empty() {
                continue;
            }
            let own = needed.start - self.first[2]..needed.end - self.first[2];
            let at = [x.places()[column % x.len()], y.places()[column / x.len()]];
            nodes.frame.depths(at, &ranges[own.clone()], &mut depths[own.clone()]);
            for k in own {
                places[k * n * m + i] = Some(DVec3::new(at[0], at[1], depths[k]));
            }
        }
        // The needed node that is nearest to the middle of all.
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for p in places.iter().flatten() {
            (low, high) = (low.min(*p), high.max(*p));
        }
        let away = |p: &DVec3| p.distance_squared(low.midpoint(high));
        let centre = places.iter().flatten().copied().min_by(|a, b| away(a).total_cmp(&away(b)))?;
        let half = half_width(&places, centre, geometry, &nodes.frame, (tile_radius, &ranges, n * m));
        Some(Placed { centre, half, places })
    }

    /// Puts a patch's image, turned by `turn` for every node along ρ, into its place among the nodes.
    pub(crate) fn store(
        &self,
        lattice: &TileLattice,
        [re, im]: &[Vec<f32>; 2],
        turn: impl Fn(usize) -> Complex32,
        nodes: &mut TileNodes,
    ) {
        let [n, m, _] = self.count;
        for (i, column) in self.columns(lattice.nodes[0].len()) {
            for k in self.of_column(nodes, column) {
                let from = (k - self.first[2]) * n * m + i;
                let value = Complex32::new(re[from], im[from]) * turn(k);
                let to = column * nodes.held.len() + (k - nodes.held.start);
                nodes.values[0][to] = value.re;
                nodes.values[1][to] = value.im;
            }
        }
    }
}

/// By how much a path length to a microphone of the tile differs from that of the centre at most, m. The places are of
/// these ranges, so many of each.
///
/// `path(p, r) − path(c, r)` is the difference of ranges, and that of `|p − r| − |p − r₀|`, whose slope is no greater
/// than `|r − r₀|` over the distance from both.
fn half_width(
    places: &[Option<DVec3>],
    centre: DVec3,
    geometry: &Geometry,
    frame: &Frame,
    (tile_radius, ranges, each): (f64, &[f64], usize),
) -> f64 {
    let own = frame.range(centre);
    let (mut along, mut aside) = (0.0f64, 0.0f64);
    for (places, range) in places.chunks_exact(each).zip(ranges) {
        let farthest = places.iter().flatten().map(|p| p.distance_squared(centre)).reduce(f64::max);
        if let Some(farthest) = farthest {
            along = along.max((range - own).abs());
            aside = aside.max(farthest);
        }
    }
    let aside = aside.sqrt();
    let distance = centre.distance(frame.middle()) - aside;
    let slope = 2.0 * tile_radius / (2.0 * distance - tile_radius).max(f64::MIN_POSITIVE);
    along + geometry.return_legs() * aside * slope.min(2.0)
}
