//! Tiles of neighbouring microphones.

use crate::wave::{bounding_box, corners};
use glam::DVec3;
use rayon::prelude::*;

/// Neighbouring microphones.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Tile {
    /// Their indices in the array, ascending.
    pub(crate) microphones: Vec<usize>,
    /// Middle of their box, m.
    pub(crate) centre: DVec3,
    /// Half the box, m.
    pub(crate) half: DVec3,
    /// Upper bound of the microphones' distance from the centre, m.
    pub(crate) radius: f64,
}

impl Tile {
    /// The box around microphones, which are left out of it.
    fn around(positions: &[DVec3], microphones: &[usize]) -> Self {
        let (low, high) = bounding_box(microphones.iter().map(|&i| positions[i])).unwrap_or_default();
        let half = 0.5 * (high - low);
        Self { microphones: Vec::new(), centre: low.midpoint(high), half, radius: half.length() }
    }

    /// The tile of microphones in ascending order.
    pub(crate) fn of(positions: &[DVec3], microphones: Vec<usize>) -> Self {
        let around = Self::around(positions, &microphones);
        Self { microphones, ..around }
    }

    /// The corners of the box.
    pub(crate) fn corners(&self) -> [DVec3; 8] {
        corners((self.centre - self.half, self.centre + self.half))
    }
}

/// Cuts an array into tiles of at most `count` microphones and at most `radius` m, halving along the longest side.
///
/// A single microphone is a tile whatever the radius. The cuts depend only on the positions, so scattered arrays are
/// handled like lattices. Cost: `n log n`.
pub(crate) fn tiles(positions: &[DVec3], count: usize, radius: f64) -> Vec<Tile> {
    cut_tiles(positions, vec![(0..positions.len()).collect()], (count, radius))
}

impl Tile {
    /// The same of what [`tiles`] of as many microphones or more, and as large or larger, has cut already, in less time.
    pub(crate) fn cut_further(tiles: &[Self], positions: &[DVec3], count: usize, radius: f64) -> Vec<Self> {
        let waiting = tiles.iter().rev().map(|tile| tile.microphones.clone()).collect();
        cut_tiles(positions, waiting, (count, radius))
    }
}

/// Those of parts of an array, of which the last comes first, each ascending.
fn cut_tiles(positions: &[DVec3], mut waiting: Vec<Vec<usize>>, (count, radius): (usize, f64)) -> Vec<Tile> {
    let (mut tiles, mut buffers) = (Vec::new(), PartBuffers::default());
    while let Some(mut microphones) = waiting.pop() {
        let tile = Tile::around(positions, &microphones);
        let small = microphones.len() <= count.max(1) && tile.radius <= radius;
        if small || microphones.len() == 1 {
            tiles.push(Tile { microphones, ..tile });
            continue;
        }
        let half = buffers.part(positions, &tile, &mut microphones);
        // The first half is cut next, so that neighbouring tiles follow each other.
        let second = microphones.split_off(half);
        waiting.push(second);
        waiting.push(microphones);
    }
    tiles
}

/// Buffers for cutting a tile.
#[derive(Debug, Default)]
struct PartBuffers {
    /// Places along an axis, as numbers in the same order.
    keys: Vec<u64>,
    ordered: Vec<u64>,
    second: Vec<usize>,
}

impl PartBuffers {
    /// Puts the first half of a tile's microphones, along its longest side and of those beside each other by number, before the
    /// others; returns how many they are. Both halves stay ascending.
    fn part(&mut self, positions: &[DVec3], tile: &Tile, microphones: &mut [usize]) -> usize {
        let (half, axis) = (microphones.len() / 2, tile.half.max_position());
        let Self { keys, ordered, second } = self;
        keys.clear();
        keys.extend(microphones.iter().map(|&i| ascending_bits(positions[i][axis])));
        ordered.clone_from(keys);
        let (below, &mut middle, _) = ordered.select_nth_unstable(half);
        let mut beside = below.iter().filter(|key| **key == middle).count();
        second.clear();
        let mut first = 0;
        for (at, key) in keys.iter().enumerate() {
            let microphone = microphones[at];
            if *key < middle || (*key == middle && beside > 0) {
                beside -= usize::from(*key == middle);
                microphones[first] = microphone;
                first += 1;
            } else {
                second.push(microphone);
            }
        }
        microphones[first..].copy_from_slice(second);
        half
    }
}

/// Bits that are ordered as numbers are by `total_cmp`.
const fn ascending_bits(x: f64) -> u64 {
    let bits = x.to_bits();
    if bits >> 63 == 0 { bits | 1 << 63 } else { !bits }
}

/// The boxes of the tiles, without their microphones, of an array that is halved 0 .. `most` times: as [`tiles`] of one
/// microphone in 2, 4, 8 .., as long as each has several, but all in the time of the smallest.
pub(crate) fn halvings(positions: &[DVec3], most: u32) -> Vec<Vec<Tile>> {
    let mut order: Vec<usize> = (0..positions.len()).collect();
    let mut parts: Vec<&mut [usize]> = vec![&mut order];
    let mut levels = Vec::new();
    for times in 0..=most {
        let boxes: Vec<Tile> = parts.par_iter().map(|part| Tile::around(positions, part)).collect();
        if times < most {
            let halved = parts.into_par_iter().zip(&boxes).map_init(
                PartBuffers::default,
                |buffers, (members, tile)| {
                    let half = buffers.part(positions, tile, members);
                    let (first, second) = members.split_at_mut(half);
                    [first, second]
                },
            );
            parts = halved.flatten_iter().collect();
        } else {
            parts = Vec::new();
        }
        levels.push(boxes);
    }
    levels
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquisition::MicArray;

    #[test]
    fn a_lattice_is_cut_into_squares() {
        let array = MicArray::rectangular([64, 64], [0.008; 2], DVec3::ZERO).expect("ok");
        let tiles = tiles(array.positions(), 64, 1.0);
        assert_eq!(tiles.len(), 64);
        for tile in &tiles {
            assert_eq!(tile.microphones.len(), 64);
            assert!((tile.half - DVec3::new(0.028, 0.028, 0.0)).length() < 1e-12);
        }
    }

    #[test]
    fn every_microphone_is_in_one_tile_that_is_small_enough() {
        let fraction = |i: usize, k: f64| (i as f64 * k).fract();
        let positions: Vec<DVec3> = (0..500)
            .map(|i| DVec3::new(fraction(i, 0.618), 0.3 * fraction(i, 0.755), 0.1 * fraction(i, 0.57)))
            .chain([DVec3::new(90.0, 0.0, 3.0), DVec3::ZERO, DVec3::ZERO, DVec3::ZERO])
            .collect();
        for (count, radius) in [(64, 0.1), (16, 10.0), (1, 1.0), (1000, 1e-3)] {
            let tiles = tiles(&positions, count, radius);
            let mut seen: Vec<usize> = tiles.iter().flat_map(|t| t.microphones.clone()).collect();
            seen.sort_unstable();
            assert!(seen.iter().copied().eq(0..positions.len()));
            for (more, larger) in [(count, f64::INFINITY), (2 * count + 1, radius), (500, 2.0 * radius)] {
                let before = super::tiles(&positions, more, larger);
                assert_eq!(Tile::cut_further(&before, &positions, count, radius), tiles);
            }
            for tile in &tiles {
                assert!(
                    tile.microphones.len() <= count && (tile.radius <= radius || tile.microphones.len() == 1)
                );
                for &i in &tile.microphones {
                    assert!(positions[i].distance(tile.centre) <= tile.radius + 1e-12);
                }
            }
        }
    }

    #[test]
    fn the_first_half_is_along_the_longest_side_and_then_by_number() {
        let lattice = |i: usize| DVec3::new((i % 7) as f64 - 3.0, (i / 7 % 5) as f64, 0.0);
        let places: Vec<DVec3> =
            (0..97).map(lattice).chain([DVec3::new(-0.0, 1.0, 0.5), DVec3::new(0.0, 1.0, -0.5)]).collect();
        let mut microphones: Vec<usize> = (0..places.len()).filter(|i| i % 9 != 4).collect();
        let mut buffers = PartBuffers::default();
        while microphones.len() > 1 {
            let tile = Tile::around(&places, &microphones);
            let axis = tile.half.max_position();
            let mut expected = microphones.clone();
            expected.sort_by(|&a, &b| places[a][axis].total_cmp(&places[b][axis]).then(a.cmp(&b)));
            let half = buffers.part(&places, &tile, &mut microphones);
            assert_eq!(half, expected.len() / 2);
            let (first, second) = expected.split_at_mut(half);
            first.sort_unstable();
            second.sort_unstable();
            assert_eq!(microphones, expected);
            microphones.drain(..half);
        }
    }

    #[test]
    fn halvings_are_the_tiles_of_half_as_many() {
        let t = |i: usize, k: f64| (i as f64 * k).fract();
        let places: Vec<_> =
            (0..1003).map(|i| DVec3::new(t(i, 0.618_034), 0.4 * t(i, 0.754_878), 0.0)).collect();
        for (times, boxes) in halvings(&places, 5).into_iter().enumerate() {
            let mut expected = tiles(&places, places.len().div_ceil(1 << times), f64::INFINITY);
            for tile in &mut expected {
                assert!(tile.microphones.is_sorted() && !tile.microphones.is_empty());
                tile.microphones.clear();
            }
            assert_eq!(boxes, expected);
        }
    }
}
