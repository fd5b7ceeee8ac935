//! Coordinates in which the image of neighbouring microphones hardly changes sideways, and the tiles that have them.
//!
//! About the middle r₀ of a tile a voxel is told by x, y and its range ρ, the path length by way of r₀. Turned by
//! `e^{+i2πf_c·ρ/c}`, a term is `e^{−i2π[f·(path(p, r) − ρ) + (f − f_c)·ρ]/c}`: at constant ρ it changes along x and y
//! only by as much as r and r₀ see it in different directions, which is little for a small tile.

#![allow(clippy::inline_always)]

use super::terms::Terms;
use crate::acquisition::{Tile, tiles};
use crate::wave::Geometry;
use crate::wave::simd::dispatched;
use crate::wave::two_legs::TwoLegs;
use glam::DVec3;

/// The coordinates (x, y, ρ) of one tile: `ρ = |p − a| + |p − b|` with the foci a, b.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    legs: TwoLegs,
}

impl Frame {
    pub(crate) fn new(geometry: &Geometry, middle: DVec3) -> Self {
        Self { legs: TwoLegs::new(geometry, middle) }
    }

    /// ρ of a point, m.
    pub(crate) fn range(&self, p: DVec3) -> f64 {
        self.legs.length(p)
    }

    /// ρ of points above one place (x, y), m.
    pub(crate) fn ranges(&self, [x, y]: [f64; 2], depths: &[f64], ranges: &mut [f64]) {
        self.legs.along(2, DVec3::new(x, y, 0.0), depths, ranges);
    }

    /// The least ρ above one place (x, y), m: [`Frame::point`] finds all that are larger.
    pub(crate) fn least_range(&self, at: [f64; 2]) -> f64 {
        self.legs.shortest(at)
    }

    /// Depths of the points of some ranges above one place (x, y), all of them larger than the least, m.
    pub(crate) fn depths(&self, [x, y]: [f64; 2], ranges: &[f64], depths: &mut [f64]) {
        let across = |focus: DVec3| (x - focus.x).powi(2) + (y - focus.y).powi(2);
        point_depths(self.legs.foci.map(|focus| [across(focus), focus.z]), ranges, depths);
    }

    /// The point of range ρ above (x, y) that lies deepest; beyond it ρ only grows. `None` where no point has it.
    pub(crate) fn point(&self, x: f64, y: f64, range: f64) -> Option<DVec3> {
        (range > self.least_range([x, y])).then(|| {
            let mut depth = [0.0];
            self.depths([x, y], &[range], &mut depth);
            DVec3::new(x, y, depth[0])
        })
    }

    /// The same for many places, `[range, place]`; anything where a place has no point of a range.
    pub(crate) fn layers(&self, places: &[[f64; 2]], ranges: &[f64]) -> Vec<f64> {
        let across = |focus: DVec3| -> Vec<f64> {
            places.iter().map(|[x, y]| (x - focus.x).powi(2) + (y - focus.y).powi(2)).collect()
        };
        let [across_a, across_b] = self.legs.foci.map(across);
        let mut depths = vec![0.0; places.len() * ranges.len()];
        for (layer, range) in depths.chunks_exact_mut(places.len()).zip(ranges) {
            layer_depths(self.legs.foci.map(|focus| focus.z), *range, [&across_a, &across_b], layer);
        }
        depths
    }

    /// r₀.
    pub(crate) fn middle(&self) -> DVec3 {
        self.legs.foci[1]
    }

    /// The change of ρ with the place.
    pub(crate) fn slope(&self, p: DVec3) -> DVec3 {
        self.legs.slope(p)
    }
}

#[inline(always)]
fn point_depths_body([[across_a, a], [across_b, b]]: [[f64; 2]; 2], ranges: &[f64], depths: &mut [f64]) {
    let difference = across_a - across_b + a * a - b * b;
    let outer = across_a + a * a;
    for (depth, range) in depths.iter_mut().zip(ranges) {
        // |p − a|² − |p − b|² is linear in z, and so is |p − a| = α + β z; squared, that is a quadratic for z.
        let alpha = 0.5 * (range + difference / range);
        let beta = (b - a) / range;
        let (square, linear) = (1.0 - beta * beta, a + alpha * beta);
        let root = linear * linear - square * (outer - alpha * alpha);
        *depth = (linear + root.max(0.0).sqrt()) / square;
    }
}

dispatched! {
    /// Foci as squared distance from the column, and depth.
    fn point_depths = point_depths_body(foci: [[f64; 2]; 2], ranges: &[f64], depths: &mut [f64])
}

#[inline(always)]
fn layer_depths_body([a, b]: [f64; 2], range: f64, [across_a, across_b]: [&[f64]; 2], depths: &mut [f64]) {
    let (inverse, beta) = (1.0 / range, (b - a) / range);
    let inverse_square = 1.0 / (1.0 - beta * beta);
    let difference = a * a - b * b;
    for ((depth, across_a), across_b) in depths.iter_mut().zip(across_a).zip(across_b) {
        let alpha = 0.5 * (range + (across_a - across_b + difference) * inverse);
        let linear = a + alpha * beta;
        let root = linear * linear - (1.0 - beta * beta) * (across_a + a * a - alpha * alpha);
        *depth = (linear + root.max(0.0).sqrt()) * inverse_square;
    }
}

dispatched! {
    /// As [`point_depths`], for one range above many places: their squared distances from both foci.
    fn layer_depths = layer_depths_body(foci: [f64; 2], range: f64, across: [&[f64]; 2], depths: &mut [f64])
}

/// The tiles, each with a frame, that an array falls into when it is halved so many `times`.
pub(crate) fn halved(positions: &[DVec3], times: u32) -> Vec<Tile> {
    tiles(positions, positions.len().div_ceil(1 << times), f64::INFINITY)
}

/// How fast the turned terms of tiles change along x, y (at constant ρ) and ρ at most, cycles per m; from samples at
/// the edges of everything that a term depends on.
pub(crate) fn bands(terms: &Terms<'_>) -> [f64; 3] {
    let Terms { instrument, points, tiles, .. } = terms;
    let grid = points.evened();
    let (carrier, frequencies) = (instrument.sweep.centre(), instrument.sweep.frequencies());
    let edges = [frequencies[0], frequencies[frequencies.len() - 1]];
    let mut fastest = [0.0f64; 3];
    for tile in some(tiles, SAMPLED_TILES) {
        let frame = Frame::new(&instrument.geometry, tile.centre);
        for p in grid.sampled([5, 5, 4]) {
            let Some(p) = terms.far_enough(&frame, p) else { continue };
            let slope = frame.slope(p);
            for r in tile.corners() {
                let own = Frame::new(&instrument.geometry, r).slope(p);
                let steep = own.z / slope.z;
                for f in edges {
                    let changes = [
                        f * (own.x - slope.x * steep).abs(),
                        f * (own.y - slope.y * steep).abs(),
                        (f * steep - carrier).abs(),
                    ];
                    for (fastest, change) in fastest.iter_mut().zip(changes) {
                        *fastest = fastest.max(change / instrument.sound_speed);
                    }
                }
            }
        }
    }
    fastest
}

/// Tiles that represent all.
const SAMPLED_TILES: usize = 9;

/// Every so many of `items`, about `most` in all, the first and the last among them.
pub(crate) fn some<T>(items: &[T], most: usize) -> impl Iterator<Item = &T> {
    let count = items.len().min(most);
    (0..count).map(move |i| &items[i * (items.len() - 1) / (count - 1).max(1)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquisition::{Instrument, MicArray, Sweep};
    use crate::grid::{Axis, Grid};
    use crate::reconstruct::numerics::GridPlaces;

    fn places(count: usize) -> Vec<DVec3> {
        let t = |i: usize, k: f64| (i as f64 * k).fract();
        (0..count).map(|i| DVec3::new(t(i, 0.618_034), 0.4 * t(i, 0.754_878), 0.1 * t(i, 0.569_84))).collect()
    }

    #[test]
    fn a_point_has_its_range_and_is_the_deepest_that_has() {
        let geometries = [
            Geometry::ORIGIN,
            Geometry::Monostatic,
            Geometry::FixedSource { source: DVec3::new(0.1, -0.2, -0.3) },
        ];
        for geometry in geometries {
            let frame = Frame::new(&geometry, DVec3::new(-0.3, 0.2, 0.15));
            for p in places(60) {
                let p = p + DVec3::Z * 0.3;
                let range = frame.range(p);
                assert!((range - geometry.path_length(p, DVec3::new(-0.3, 0.2, 0.15))).abs() < 1e-12);
                let found = frame.point(p.x, p.y, range).expect("there is one");
                assert!((frame.range(found) - range).abs() < 1e-12);
                assert!(found.distance(p) < 1e-9, "{found} is not {p}");
                let slope = frame.slope(p);
                let layers = frame.layers(&[[p.x, p.y], [p.x, p.y]], &[2.0 * range, range]);
                assert!((layers[3] - p.z).abs() < 1e-9 && layers[0] > p.z);
                let deeper = frame.range(p + DVec3::Z * 1e-6) - range;
                assert!(deeper > 0.0 && (deeper / 1e-6 - slope.z).abs() < 1e-4);
            }
            let least = frame.least_range([0.4, 0.7]);
            assert!(frame.point(0.4, 0.7, least * (1.0 - 1e-9)).is_none());
            assert!(frame.point(0.4, 0.7, least * (1.0 + 1e-9)).is_some());
            assert!(frame.point(0.9, 0.9, 0.5).is_none());
            assert!(frame.point(0.0, 0.0, 0.0).is_none());
        }
    }

    #[test]
    fn tiles_hold_every_microphone_once_and_grow_smaller() {
        for count in [1, 5, 40, 512] {
            let positions = places(count);
            let mut last = f64::INFINITY;
            for times in 0..5 {
                let tiles = halved(&positions, times);
                let mut members: Vec<usize> =
                    tiles.iter().flat_map(|tile| tile.microphones.clone()).collect();
                members.sort_unstable();
                assert_eq!(members, (0..count).collect::<Vec<_>>());
                let widest = tiles.iter().map(|tile| tile.radius).fold(0.0, f64::max);
                assert!(widest <= last);
                last = widest;
                for tile in &tiles {
                    let farthest = tile.microphones.iter().map(|&r| positions[r].distance(tile.centre));
                    assert!(farthest.fold(0.0, f64::max) <= tile.radius * (1.0 + 1e-12));
                }
            }
            assert!(count < 512 || last < 0.2);
        }
    }

    /// The bands are those of differences between neighbouring places, for microphones all over the tiles.
    #[test]
    fn terms_change_no_faster_than_their_bands() {
        let axis = |first: f64, pitch: f64, count: usize| Axis { first, pitch, count };
        let grid = Grid { x: axis(-0.4, 0.02, 41), y: axis(-0.2, 0.02, 31), z: axis(0.5, 0.02, 41) };
        let sweep = Sweep::stepped(10_000.0, 20_000.0, 100.0).expect("valid");
        let array = MicArray::from_positions(places(200)).expect("valid");
        for geometry in [Geometry::ORIGIN, Geometry::Monostatic] {
            let instrument = Instrument::new(sweep.clone(), array.clone()).with_geometry(geometry);
            let tiles = halved(array.positions(), 2);
            let points = GridPlaces::even(&grid);
            let bands = bands(&Terms { instrument: &instrument, points: &points, tiles: &tiles, from: 0.0 });
            let mut fastest = [0.0f64; 3];
            for tile in &tiles {
                let frame = Frame::new(&geometry, tile.centre);
                for p in grid.sampled([4, 3, 6]) {
                    for &r in tile.microphones.iter().step_by(3) {
                        let r = array.positions()[r];
                        for f in [10_000.0, 20_000.0] {
                            let turns = |x: f64, y: f64, range: f64| {
                                let p = frame.point(x, y, range).expect("deep enough");
                                (f * geometry.path_length(p, r) - 15_000.0 * range) / 343.0
                            };
                            let (range, step) = (frame.range(p), 1e-6);
                            let here = turns(p.x, p.y, range);
                            let there = [
                                turns(p.x + step, p.y, range),
                                turns(p.x, p.y + step, range),
                                turns(p.x, p.y, range + step),
                            ];
                            for axis in 0..3 {
                                fastest[axis] = fastest[axis].max((there[axis] - here).abs() / step);
                            }
                        }
                    }
                }
            }
            for axis in 0..3 {
                let (measured, band) = (fastest[axis], bands[axis]);
                assert!(measured <= 1.01 * band && measured > 0.5 * band, "{axis}: {measured} and {band}");
            }
        }
    }
}
