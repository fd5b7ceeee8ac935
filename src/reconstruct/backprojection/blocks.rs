//! Boxes of voxels and groups of microphones that share their range profiles.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

use super::profile::{Band, MOST_FOR_POWERS};
use crate::grid::{Axis, Grid};
use crate::reconstruct::compress::Tones;
use crate::reconstruct::numerics::GridPlaces;
use crate::wave::interval::greater;
use crate::wave::simd::{LANES, LaneTones, Points, dispatched};
use crate::wave::{Geometry, bounding_box};
use glam::DVec3;

/// A box of voxels, by its size along x, y, z.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Shape(pub(crate) [usize; 3]);

impl Shape {
    /// The most voxels of a block: their points and sums stay in the first-level cache.
    pub(crate) const MOST_VOXELS: usize = 1024;

    /// Half the distance between the first and the last voxel along each axis, m, where they are farthest apart.
    pub(crate) fn half(&self, grid: &Grid) -> DVec3 {
        let along = |axis: &Axis, count: usize| axis.pitch * (count.min(axis.count) - 1) as f64 / 2.0;
        DVec3::new(along(&grid.x, self.0[0]), along(&grid.y, self.0[1]), along(&grid.z, self.0[2]))
    }

    /// Lengths worth trying along an axis: powers of two that there is room for, made even over as many blocks.
    pub(crate) fn sizes(count: usize) -> impl Iterator<Item = usize> {
        let even = move |n: usize| count.div_ceil(count.div_ceil(n));
        (0..11).map(|e| 1usize << e).filter(move |&n| n < 2 * count).map(even)
    }

    /// Every shape worth trying.
    pub(crate) fn candidates(grid: &Grid) -> impl Iterator<Item = Self> {
        let (x, y, z) = (grid.x.count, grid.y.count, grid.z.count);
        Self::sizes(z)
            .flat_map(move |n_z| Self::sizes(y).map(move |n_y| [n_y, n_z]))
            .flat_map(move |[n_y, n_z]| Self::sizes(x).map(move |n_x| Self([n_x, n_y, n_z])))
            .filter(|shape| shape.0.iter().product::<usize>() <= Self::MOST_VOXELS)
    }

    /// Operations per voxel and microphone by a fixed model, over places and microphones that stand for all;
    /// `None` when profiles would be absurdly long.
    pub(crate) fn operations(
        &self,
        places: &GridPlaces,
        geometry: &Geometry,
        microphones: &[DVec3],
        band: &Band,
        tones: f64,
    ) -> Option<f64> {
        let half = self.half(places.grid());
        let widest = greatest_half(half);
        // Blocks of one voxel are always allowed.
        if half != DVec3::ZERO && !band.holds(widest) {
            return None;
        }
        let voxels = self.0.iter().product::<usize>();
        let digits = -band.tolerance.log10();
        let (low, high) = places.bounds(0..places.grid().z.count);
        let (mut sum, mut count) = (0.0, 0.0);
        for i in 0..27 {
            let t = |k: usize| (k % 3) as f64 / 2.0;
            let p = low + DVec3::new(t(i), t(i / 3), t(i / 9)) * (high - low);
            let widths = HalfWidths::new(geometry, p, half);
            for r in microphones {
                let edge = band.edge(widths.of(*r));
                sum += block_operations(voxels, edge, digits, tones);
                count += 1.0;
            }
        }
        Some(sum / count / voxels as f64)
    }
}

/// Operations of one block and microphone by a fixed model: `points` of it, a band's `edge` there, the digits that are
/// wanted, and this many tones.
pub(crate) fn block_operations(points: usize, edge: f64, digits: f64, tones: f64) -> f64 {
    let terms = 1.1 * edge + 2.0 + 1.3 * digits;
    // Horner's rule takes fewer operations than Clenshaw's recurrence.
    let per_term = if edge <= MOST_FOR_POWERS { 3.6 } else { 7.0 };
    let of_points = Points::padded(points) as f64 * (OPERATIONS_PER_POINT + per_term * terms);
    FUSED * (of_points + tones * (40.0 + 3.0 * terms))
}

/// What these take of the time of as many operations of other loops, of which fewer are fused: measured.
const FUSED: f64 = 0.65;

/// Operations for one point and microphone besides the series: the path, the carrier and the sum.
const OPERATIONS_PER_POINT: f64 = 65.0;

/// A block in its place: where it begins, and its voxels' number along each axis.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Block {
    pub(crate) first: [usize; 3],
    pub(crate) count: [usize; 3],
}

impl Block {
    /// The blocks of the planes `depths`, x fastest.
    pub(crate) fn of(grid: &Grid, shape: Shape, depths: std::ops::Range<usize>) -> Vec<Self> {
        let Shape([n_x, n_y, n_z]) = shape;
        let mut blocks = Vec::new();
        for z in depths.clone().step_by(n_z) {
            for y in (0..grid.y.count).step_by(n_y) {
                for x in (0..grid.x.count).step_by(n_x) {
                    let count =
                        [n_x.min(grid.x.count - x), n_y.min(grid.y.count - y), n_z.min(depths.end - z)];
                    blocks.push(Self { first: [x, y, z], count });
                }
            }
        }
        blocks
    }

    /// Middle of the first and the last voxel, and half of what they are apart, m.
    pub(crate) fn centre_and_half(&self, places: &GridPlaces) -> (DVec3, DVec3) {
        let last: [usize; 3] = std::array::from_fn(|axis| self.first[axis] + self.count[axis] - 1);
        let (first, last) = (places.position(self.first), places.position(last));
        (first.midpoint(last), 0.5 * (last - first))
    }

    /// The voxels, x fastest, about the centre.
    pub(crate) fn points(&self, places: &GridPlaces, geometry: &Geometry) -> Points {
        let [x, y, z] = self.places(places);
        let (centre, _) = self.centre_and_half(places);
        Points::about(centre.to_array(), geometry, [&x, &y, &z])
    }

    /// The voxels' x, y and z, x fastest, m.
    pub(crate) fn places(&self, places: &GridPlaces) -> [Vec<f64>; 3] {
        let along =
            |k: usize| -> Vec<f64> { (0..self.count[k]).map(|i| places.at(k, self.first[k] + i)).collect() };
        let each = |places: &[f64], times: usize| -> Vec<f64> {
            places.iter().flat_map(|place| std::iter::repeat_n(*place, times)).collect()
        };
        let [n_x, n_y, n_z] = self.count;
        let x = along(0).repeat(n_y * n_z);
        let y = each(&along(1), n_x).repeat(n_z);
        let z = each(&along(2), n_x * n_y);
        [x, y, z]
    }
}

/// By how much, at most, path lengths in a box of half-width `half` about `centre` differ from those of the centre.
///
/// A distance is convex, so it lies above its tangent plane; and `√(1 + x) ≤ 1 + x/2` bounds it from above. Near a
/// microphone, where that says little, it is the farthest corner's.
pub(crate) struct HalfWidths<'a> {
    geometry: &'a Geometry,
    centre: DVec3,
    half: DVec3,
    /// Of the loudspeaker that all microphones have.
    out: Slope,
}

/// The gradient of a distance, how far it rises at most above its tangent plane, m, and how much it changes at most, m.
#[derive(Debug, Clone, Copy)]
struct Slope {
    gradient: DVec3,
    bend: f64,
    change: f64,
}

impl Slope {
    const NONE: Self = Self { gradient: DVec3::ZERO, bend: 0.0, change: 0.0 };

    #[inline(always)]
    fn new(from: DVec3, centre: DVec3, half: DVec3) -> Self {
        let away = centre - from;
        let length = away.length();
        Self {
            gradient: away / length.max(f64::MIN_POSITIVE),
            bend: half.length_squared() / (2.0 * length).max(f64::MIN_POSITIVE),
            change: (away.abs() + half).length() - length,
        }
    }

    /// By how much this distance and `legs` times another change at most together, m.
    #[inline(always)]
    fn with(self, back: Self, legs: f64, half: DVec3) -> f64 {
        let tangent = (self.gradient + back.gradient * legs).abs().dot(half) + self.bend + back.bend * legs;
        tangent.min(self.change + back.change * legs)
    }
}

impl<'a> HalfWidths<'a> {
    pub(crate) fn new(geometry: &'a Geometry, centre: DVec3, half: DVec3) -> Self {
        let out = match geometry {
            Geometry::FixedSource { source } => Slope::new(*source, centre, half),
            Geometry::Monostatic | Geometry::Pair { .. } => Slope::NONE,
        };
        Self { geometry, centre, half, out }
    }

    /// Of paths by way of one microphone, m.
    pub(crate) fn of(&self, microphone: DVec3) -> f64 {
        let Self { geometry, centre, half, .. } = *self;
        let (back, legs) = (Slope::new(microphone, centre, half), geometry.return_legs());
        let out = match geometry {
            Geometry::Pair { .. } => Slope::new(geometry.source_of(microphone), centre, half),
            _ => self.out,
        };
        out.with(back, legs, half)
    }

    /// The widest of paths by way of a group's microphones, with one loudspeaker or each with its own at itself, m.
    pub(crate) fn of_group(&self, group: &Group) -> f64 {
        let Self { geometry, centre, half, out } = self;
        let mut widths = [0.0; LANES];
        half_widths(&group.places, [*centre, *half], (*out, geometry.return_legs()), &mut widths);
        widths.into_iter().fold(0.0, greater)
    }
}

#[inline(always)]
fn half_widths_body(
    places: &[[f64; LANES]; 3],
    [centre, half]: [DVec3; 2],
    (out, legs): (Slope, f64),
    widths: &mut [f64; LANES],
) {
    let [x, y, z] = places;
    for l in 0..LANES {
        let back = Slope::new(DVec3::new(x[l], y[l], z[l]), centre, half);
        widths[l] = out.with(back, legs, half);
    }
}

dispatched! {
    /// [`HalfWidths::of`] for sixteen microphones, without a loudspeaker that moves with them.
    fn half_widths = half_widths_body(
        places: &[[f64; LANES]; 3], block: [DVec3; 2], out: (Slope, f64), widths: &mut [f64; LANES],
    )
}

/// What [`HalfWidths`] are below for any microphone and source, m.
pub(crate) fn greatest_half(half: DVec3) -> f64 {
    2.0 * half.length()
}

/// Sixteen microphones that lie near each other; the last of an array are filled up with silent ones.
#[derive(Debug, Clone)]
pub(crate) struct Group {
    pub(crate) members: Vec<usize>,
    pub(crate) positions: [DVec3; LANES],
    /// The same, along x, y and z.
    places: [[f64; LANES]; 3],
}

impl Group {
    /// Some microphones, along a curve that keeps neighbours together (Morton's).
    pub(crate) fn of(positions: &[DVec3], mut members: Vec<usize>) -> Vec<Self> {
        let (low, high) = bounding_box(members.iter().map(|&r| positions[r])).unwrap_or_default();
        let extent = (high - low).max_element().max(f64::MIN_POSITIVE);
        let code = |r: DVec3| -> u64 {
            let cells = ((r - low) / extent * 1023.0).to_array().map(|t| t as u64);
            (0..30).map(|bit| (cells[bit % 3] >> (bit / 3) & 1) << bit).sum()
        };
        members.sort_by_key(|&r| (code(positions[r]), r));
        let group = |members: &[usize]| {
            let positions = std::array::from_fn(|l| positions[members[l.min(members.len() - 1)]]);
            let places = std::array::from_fn(|axis| positions.map(|r: DVec3| r[axis]));
            Self { members: members.to_vec(), positions, places }
        };
        members.chunks(LANES).map(group).collect()
    }

    /// The group's part of tones in rows of `width`.
    pub(crate) fn tones(&self, tones: &Tones, width: usize) -> LaneTones {
        let mut split = LaneTones::default();
        for row in tones.samples.chunks_exact(width) {
            let (mut re, mut im) = ([0.0; LANES], [0.0; LANES]);
            for (l, &r) in self.members.iter().enumerate() {
                (re[l], im[l]) = (row[r].re, row[r].im);
            }
            split.re.push(re);
            split.im.push(im);
        }
        split
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid() -> Grid {
        let axis = |first: f64, pitch: f64, count: usize| Axis { first, pitch, count };
        Grid { x: axis(-0.3, 0.01, 37), y: axis(-0.2, 0.013, 21), z: axis(0.0, 0.02, 9) }
    }

    #[test]
    fn blocks_cover_every_voxel_once() {
        let grid = grid();
        for shape in [Shape([16, 8, 2]), Shape([1, 1, 1]), Shape([37, 4, 4])] {
            let mut seen = vec![0; grid.voxel_count() as usize];
            for block in Block::of(&grid, shape, 0..9) {
                for z in 0..block.count[2] {
                    for y in 0..block.count[1] {
                        for x in 0..block.count[0] {
                            let [a, b, c] = block.first;
                            seen[((c + z) * 21 + b + y) * 37 + a + x] += 1;
                        }
                    }
                }
            }
            assert!(seen.iter().all(|&n| n == 1), "{shape:?}");
        }
    }

    #[test]
    fn the_half_width_holds_for_every_voxel_of_a_block() {
        let grid = grid();
        let microphones = [DVec3::ZERO, DVec3::new(-0.3, -0.2, 0.0), DVec3::new(0.4, -0.7, -0.3)];
        let geometries = [
            Geometry::Monostatic,
            Geometry::ORIGIN,
            Geometry::FixedSource { source: DVec3::splat(0.1) },
            Geometry::Pair { offset: DVec3::new(-0.2, 0.1, 0.1) },
        ];
        let mut closest = f64::INFINITY;
        for block in Block::of(&grid, Shape([8, 4, 2]), 0..9) {
            let (centre, half) = block.centre_and_half(&GridPlaces::even(&grid));
            for r in microphones {
                for geometry in geometries {
                    let bound = HalfWidths::new(&geometry, centre, half).of(r);
                    let mut worst = 0.0f64;
                    for z in 0..block.count[2] {
                        for y in 0..block.count[1] {
                            for x in 0..block.count[0] {
                                let [a, b, c] = block.first;
                                let p = grid.position(a + x, b + y, c + z);
                                let path = geometry.path_length(p, r) - geometry.path_length(centre, r);
                                worst = worst.max(path.abs());
                            }
                        }
                    }
                    assert!(worst <= bound * (1.0 + 1e-12) && bound <= greatest_half(half) * (1.0 + 1e-12));
                    if !matches!(geometry, Geometry::Pair { .. }) {
                        let group = &Group::of(&[r], vec![0])[0];
                        assert_eq!(HalfWidths::new(&geometry, centre, half).of_group(group), bound);
                    }
                    closest = closest.min(bound - worst);
                }
            }
        }
        assert!(closest < 1e-3, "no bound is near: {closest}");
    }

    #[test]
    fn groups_hold_every_microphone_once() {
        let positions: Vec<DVec3> = (0..45)
            .map(|i| {
                let t = |k: f64| (f64::from(i) * k).fract();
                DVec3::new(t(0.618), t(0.755), t(0.57))
            })
            .collect();
        let groups = Group::of(&positions, (0..45).collect());
        let mut members: Vec<usize> = groups.iter().flat_map(|g| g.members.clone()).collect();
        members.sort_unstable();
        assert_eq!(members, (0..45).collect::<Vec<_>>());
        assert_eq!(Group::of(&[DVec3::ONE; 3], vec![0, 1, 2]).len(), 1);
    }
}
