//! Arrays without a lattice: Vogel's spiral, and random positions with a minimum distance.
//!
//! Both fill the same rectangle as a grid of the same extent, so layouts can be compared by changing only their name.
//! Without a lattice there are no grating lobes: the power that a grid concentrates in a few of them is spread into
//! sidelobes of mean power 1/N.

use super::{FARTHEST, MicArray, check_count, invalid, refused, too_far};
use crate::error::Result;
use glam::{DVec2, DVec3, I64Vec2};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rustc_hash::FxHashMap;
use std::f64::consts::{PI, TAU};

/// The golden angle, 2π(1 − 1/φ) = π(3 − √5): of all fractions of a circle it is the worst approximated by ratios of
/// small integers.
const GOLDEN_ANGLE: f64 = PI * (3.0 - 2.236_067_977_499_79);

/// Default minimum distance of random microphones, relative to the pitch of a square lattice of the same density.
const EASY_SPACING: f64 = 0.5;

/// Bytes per microphone while they are scattered at random: its place twice, and its cell.
pub(crate) const RANDOM_BYTES: u64 = 112;

/// Random trials per microphone before a spacing is given up. Random placement of discs jams when their diameter is
/// 0.83 of the pitch of a square lattice of the same density; up to 0.75 this number of trials is ample.
const TRIALS: u64 = 2000;

impl MicArray {
    /// `count` microphones on Vogel's spiral about `centre`, parallel to z = 0: the k-th at the angle `k · 137.5°` and the
    /// radius `½ extent √((k + ½)/(N − ½))`, so that each represents the same area and the last is on the rim.
    /// `extent` is the width along x and y of the ellipse they fill.
    ///
    /// # Errors
    /// A count of 0 or above 2²⁴, an extent that is positive along neither axis, or microphones beyond [`FARTHEST`].
    pub fn spiral(count: usize, extent: [f64; 2], centre: DVec3) -> Result<Self> {
        check(count, extent, centre)?;
        let radius = |k: usize| {
            if count == 1 { 0.0 } else { ((k as f64 + 0.5) / (count as f64 - 0.5)).sqrt() }
        };
        let positions = (0..count)
            .map(|k| {
                let (sin, cos) = ((k as f64 * GOLDEN_ANGLE) % TAU).sin_cos();
                centre + 0.5 * radius(k) * DVec3::new(extent[0] * cos, extent[1] * sin, 0.0)
            })
            .collect();
        Self::from_positions(positions)
    }

    /// `count` microphones anywhere in a rectangle about `centre`, parallel to z = 0, no two closer than `spacing` m
    /// (`None`: half the pitch of a square lattice of the same density). The same seed gives the same positions.
    ///
    /// # Errors
    /// As [`MicArray::spiral`]; a spacing that is too large for the count.
    pub fn random(
        count: usize,
        extent: [f64; 2],
        centre: DVec3,
        spacing: Option<f64>,
        seed: u64,
    ) -> Result<Self> {
        check(count, extent, centre)?;
        // Along a line, the lattice of the same density has another pitch.
        let [width, height] = extent;
        let dense = match (width > 0.0, height > 0.0) {
            (true, true) => (width * height / count as f64).sqrt(),
            _ => width.max(height) / count as f64,
        };
        let spacing = spacing.unwrap_or(EASY_SPACING * dense);
        if !(spacing.is_finite() && spacing >= 0.0) {
            return refused(format!("the spacing must be 0 m or more, not {spacing} m"));
        }
        let crowded = || {
            invalid(format!(
                "{count} microphones at least {:.1} mm apart cannot be placed at random on {width} x {height} m; use a \
                 spacing of up to {:.1} mm, fewer microphones, or layout = \"spiral\"",
                1e3 * spacing,
                0.7e3 * dense
            ))
        };
        if count > 1 && spacing > 0.83 * dense {
            return Err(crowded());
        }
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut unit = || (random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64 - 0.5;
        let mut places: Vec<DVec2> = Vec::with_capacity(count);
        // The last microphone of every cell, and for each the one before it in its cell: no vector for every cell.
        let mut cells: FxHashMap<I64Vec2, u32> = FxHashMap::default();
        cells.reserve(if spacing > 0.0 { count } else { 0 });
        let mut before: Vec<Option<u32>> = Vec::with_capacity(count);
        let cell = |p: DVec2| (p / spacing.max(f64::MIN_POSITIVE)).floor().as_i64vec2();
        let mut trials = TRIALS.saturating_mul(count as u64);
        while places.len() < count {
            trials = trials.checked_sub(1).ok_or_else(crowded)?;
            let p = DVec2::new(width * unit(), height * unit());
            if spacing > 0.0 {
                let home = cell(p);
                let near = (-1..=1)
                    .flat_map(|y| (-1..=1).map(move |x| home + I64Vec2::new(x, y)))
                    .flat_map(|cell| {
                        std::iter::successors(cells.get(&cell).copied(), |&i| before[i as usize])
                    })
                    .any(|i| places[i as usize].distance_squared(p) < spacing * spacing);
                if near {
                    continue;
                }
                before.push(cells.insert(home, places.len() as u32));
            }
            places.push(p);
        }
        let positions = places.into_iter().map(|p| centre + p.extend(0.0)).collect();
        Self::from_positions(positions)
    }
}

/// Rejects counts and sizes that do not make an array.
fn check(count: usize, extent: [f64; 2], centre: DVec3) -> Result<()> {
    check_count(count)?;
    if !(centre.is_finite() && extent.iter().all(|e| e.is_finite() && *e >= 0.0)) {
        return refused("the extent must be 0 or more and the centre finite, in metres");
    }
    let farthest = centre.abs() + 0.5 * DVec3::new(extent[0], extent[1], 0.0);
    if farthest.max_element() > FARTHEST {
        return too_far("the outermost microphone", farthest);
    }
    if count > 1 && extent == [0.0; 2] {
        return refused(format!("{count} microphones cannot all be at one position; give an extent"));
    }
    Ok(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Minimum distance between any two, over all pairs.
    fn minimum_distance(array: &MicArray) -> f64 {
        let r = array.positions();
        (0..r.len()).flat_map(|i| (0..i).map(move |j| r[i].distance(r[j]))).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn a_spiral_fills_its_ellipse_evenly() {
        let centre = DVec3::new(0.2, -0.1, 0.05);
        let array = MicArray::spiral(256, [1.0, 0.5], centre).unwrap();
        assert_eq!((array.len(), array.shape()), (256, vec![256]));
        assert!(array.lattice().is_none());
        let scaled = |r: &DVec3| DVec2::new((r.x - centre.x) / 0.5, (r.y - centre.y) / 0.25).length();
        let inside = |radius: f64| array.positions().iter().filter(|r| scaled(r) <= radius).count();
        assert_eq!(inside(1.0 + 1e-12), 256);
        // The area within a radius, and so the number of microphones, is proportional to its square.
        for radius in [0.25_f64, 0.5, 0.75] {
            assert!((inside(radius) as f64 - 255.5 * radius * radius).abs() < 1.5, "{radius}");
        }
        // Vogel's packing: the closest two on a disc of radius 1 are about 1.6/√N apart.
        let round = MicArray::spiral(400, [2.0, 2.0], DVec3::ZERO).unwrap();
        assert!(minimum_distance(&round) > 1.4 / 20.0, "{}", minimum_distance(&round));
        assert!((round.extent().x - 2.0).abs() < 0.02 && round.positions().iter().all(|r| r.z == 0.0));
    }

    #[test]
    fn random_microphones_keep_their_distance_and_their_seed() {
        let of = |seed, spacing| MicArray::random(200, [1.0, 0.8], DVec3::ZERO, spacing, seed).unwrap();
        let array = of(1, Some(0.04));
        assert!(minimum_distance(&array) >= 0.04);
        assert_eq!(array, of(1, Some(0.04)), "same seed");
        assert_ne!(array, of(2, Some(0.04)), "another seed");
        let easy = of(1, None);
        assert!(minimum_distance(&easy) >= 0.5 * (0.8_f64 / 200.0).sqrt());
        let (low, high) = array.bounds();
        assert!(low.x >= -0.5 && high.x <= 0.5 && low.y >= -0.4 && high.y <= 0.4);
        let mean = array.positions().iter().sum::<DVec3>() / 200.0;
        assert!(mean.length() < 0.08, "about the centre: {mean}");
        assert!(MicArray::random(3, [1.0, 0.0], DVec3::ZERO, Some(0.1), 1).is_ok(), "on a line");
    }

    #[test]
    fn absurd_scatterings_are_refused() {
        let message = |result: Result<MicArray>| result.unwrap_err().to_string();
        let random = |count, extent, spacing| MicArray::random(count, extent, DVec3::ZERO, spacing, 1);
        assert!(message(random(200, [1.0, 1.0], Some(0.07))).contains("49.5 mm"));
        assert!(message(random(200, [1.0, 1.0], Some(f64::NAN))).contains("spacing"));
        assert!(message(random(0, [1.0, 1.0], None)).contains("16777216"));
        assert!(message(random(usize::MAX, [1.0, 1.0], None)).contains("16777216"));
        assert!(message(random(2, [0.0, 0.0], None)).contains("extent"));
        assert!(message(random(2, [f64::INFINITY, 1.0], None)).contains("extent"));
        assert!(message(MicArray::spiral(9, [-1.0, 1.0], DVec3::ZERO)).contains("extent"));
        assert!(message(MicArray::spiral(9, [1e30, 1.0], DVec3::ZERO)).contains("beyond"));
        assert_eq!(MicArray::spiral(1, [0.0, 0.0], DVec3::ONE).unwrap().positions(), [DVec3::ONE]);
    }
}
