//! Patches of nodes: blocks in a tile's own coordinates, whose sums are taken about one centre.

use super::frame::Frame;
use super::nodes::TileLattice;
use super::voxels::TileNodes;
use crate::acquisition::Tile;
use crate::wave::Geometry;
use crate::wave::simd::Points;
use glam::DVec3;
use std::ops::Range;

/// Some nodes of one tile: the first along x, y and ρ (as a multiple of the pitch), and how many.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Patch {
    pub(crate) tile: usize,
    first: [usize; 3],
    count: [usize; 3],
    /// How much a path length of any of the tile's microphones differs from that of the centre at most, m.
    pub(crate) half: f64,
}

/// A patch's nodes in space.
pub(crate) struct Placed {
    pub(crate) centre: DVec3,
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
    /// The patches of nodes `shell` along ρ that a tile needs; `None` if one is where no point has its range.
    pub(crate) fn of(
        lattice: &TileLattice,
        geometry: &Geometry,
        shell: Range<usize>,
        (index, tile, nodes): (usize, &Tile, &TileNodes),
    ) -> Option<Vec<Self>> {
        let [n_x, n_y] = [0, 1].map(|axis: usize| lattice.nodes[axis].axis.count);
        let [block_x, block_y, _] = lattice.block;
        let mut all = Vec::new();
        for y in (0..n_y).step_by(block_y) {
            for x in (0..n_x).step_by(block_x) {
                let count = [block_x.min(n_x - x), block_y.min(n_y - y), shell.len()];
                let mut patch = Self { tile: index, first: [x, y, shell.start], count, half: 0.0 };
                if patch.nodes(lattice, nodes).all(|node| node.is_none()) {
                    continue;
                }
                let placed = patch.placed(lattice, nodes)?;
                patch.half = half_width(&placed, geometry, &nodes.frame, tile.radius);
                all.push(patch);
            }
        }
        Some(all)
    }

    /// The index of each node that is needed within `TileNodes`' columns, and its place along ρ.
    fn nodes<'a>(
        &self,
        lattice: &TileLattice,
        nodes: &'a TileNodes,
    ) -> impl Iterator<Item = Option<[usize; 3]>> + use<'a> {
        let (n_x, [x, y, k], [n, m, _]) = (lattice.nodes[0].axis.count, self.first, self.count);
        (0..self.count.iter().product::<usize>()).map(move |i| {
            let node = [x + i % n, y + i / n % m, k + i / n / m];
            nodes.needed[node[1] * n_x + node[0]].contains(&node[2]).then_some(node)
        })
    }

    /// Where the nodes stand.
    pub(crate) fn placed(&self, lattice: &TileLattice, nodes: &TileNodes) -> Option<Placed> {
        let at = |[x, y, k]: [usize; 3]| {
            let [along_x, along_y] = [&lattice.nodes[0].axis, &lattice.nodes[1].axis];
            nodes.frame.point(along_x.position(x), along_y.position(y), lattice.pitch * k as f64)
        };
        let places: Vec<Option<DVec3>> = self
            .nodes(lattice, nodes)
            .map(|node| node.map_or(Some(None), |node| at(node).map(Some)))
            .collect::<Option<_>>()?;
        let middle: [usize; 3] = std::array::from_fn(|axis| self.first[axis] + self.count[axis] / 2);
        let nearest = |p: &DVec3, goal: DVec3| p.distance_squared(goal);
        let needed = places.iter().flatten();
        let centre = match at(middle) {
            Some(goal) => needed.min_by(|a, b| nearest(a, goal).total_cmp(&nearest(b, goal))),
            None => needed.into_iter().next(),
        };
        centre.copied().map(|centre| Placed { centre, places })
    }

    /// Puts a patch's image, turned by `turns` (of every node along ρ), into its place among the nodes.
    pub(crate) fn store(
        &self,
        lattice: &TileLattice,
        [re, im]: &[Vec<f32>; 2],
        turns: &[num_complex::Complex32],
        nodes: &mut TileNodes,
    ) {
        let (n_x, held) = (lattice.nodes[0].axis.count, nodes.held.clone());
        let all: Vec<_> = self.nodes(lattice, nodes).collect();
        for ((node, re), im) in all.into_iter().zip(re).zip(im) {
            let Some([x, y, k]) = node else { continue };
            let value = num_complex::Complex32::new(*re, *im) * turns[k - self.first[2]];
            let index = (y * n_x + x) * held.len() + (k - held.start);
            nodes.values[0][index] = value.re;
            nodes.values[1][index] = value.im;
        }
    }
}

/// By how much a path length to a microphone of the tile differs from that of the centre at most, m.
///
/// `path(p, r) − path(c, r)` is the difference of ranges, and that of `|p − r| − |p − r₀|`, whose slope is no greater
/// than `|r − r₀|` over the distance from both.
fn half_width(placed: &Placed, geometry: &Geometry, frame: &Frame, tile_radius: f64) -> f64 {
    let centre = placed.centre;
    let (mut along, mut aside) = (0.0f64, 0.0f64);
    for p in placed.places.iter().flatten() {
        along = along.max((frame.range(*p) - frame.range(centre)).abs());
        aside = aside.max(p.distance(centre));
    }
    let distance = centre.distance(frame.middle()) - aside;
    let slope = 2.0 * tile_radius / (2.0 * distance - tile_radius).max(f64::MIN_POSITIVE);
    along + geometry.return_legs() * aside * slope.min(2.0)
}
