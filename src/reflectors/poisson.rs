//! Area-aware Poisson-disk sampling of a triangle soup.
//!
//! Candidates are spread evenly by area, tried in random order, and kept where no accepted one of a similarly
//! facing surface is nearer than the spacing. Every candidate then gives its share of the area to the nearest
//! accepted sample, so the areas add up to the scene's exactly, slivers and small parts included.

use super::Sample;
use crate::error::Result;
use crate::progress::{Observer, advance};
use crate::scene::Triangle;
use glam::{DVec3, I64Vec3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardUniform};
use rustc_hash::FxHashMap;

/// Candidates per spacing²; more fill the last holes and cost time.
const CANDIDATES: f64 = 16.0;

/// Candidates between two looks at whether to stop.
const BLOCK: usize = 1 << 14;

/// Two samples are neighbours on one surface when their normals agree to 60°: the two sides of a thin plate, or
/// walls that meet in an edge, are sampled independently.
const SAME_SURFACE: f64 = 0.5;

/// A candidate before its fate is known.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    position: DVec3,
    triangle: u32,
}

/// Samples at least `spacing` m apart on every surface, dense enough that hardly a gap of `spacing` is left.
///
/// # Errors
/// [`Error::Interrupted`](crate::error::Error::Interrupted).
pub(super) fn poisson_disk(
    triangles: &[Triangle],
    spacing: f64,
    seed: u64,
    observer: &dyn Observer,
) -> Result<Vec<Sample>> {
    let normals: Vec<DVec3> = triangles.iter().map(Triangle::normal).collect();
    let total_area: f64 = triangles.iter().map(Triangle::area).sum();
    let mut candidates = candidates(triangles, total_area, spacing, seed);
    let share = total_area / candidates.len() as f64;

    // Random order makes it dart throwing; Fisher and Yates.
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(u64::MAX);
    for i in (1..candidates.len()).rev() {
        let j = (u128::from(random.next_u64()) * (i as u128 + 1)) >> 64;
        candidates.swap(i, j as usize);
    }

    let mut accepted: Vec<Sample> = Vec::new();
    let mut cells: FxHashMap<I64Vec3, Vec<u32>> = FxHashMap::default();
    let cell = |p: DVec3| (p / spacing).floor().as_i64vec3();
    let nearest = |accepted: &[Sample], cells: &FxHashMap<I64Vec3, Vec<u32>>, c: &Candidate| {
        let (home, normal) = (cell(c.position), normals[c.triangle as usize]);
        let mut best: Option<(f64, u32)> = None;
        for neighbour in (0..27).map(|i| home + I64Vec3::new(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1)) {
            for &index in cells.get(&neighbour).map_or(&[][..], Vec::as_slice) {
                let other = &accepted[index as usize];
                let distance = other.position.distance_squared(c.position);
                if distance < best.map_or(spacing * spacing, |(d, _)| d)
                    && normals[other.triangle as usize].dot(normal) > SAME_SURFACE
                {
                    best = Some((distance, index));
                }
            }
        }
        best.map(|(_, index)| index)
    };
    for block in candidates.chunks(BLOCK) {
        for c in block {
            if nearest(&accepted, &cells, c).is_none() {
                cells.entry(cell(c.position)).or_default().push(accepted.len() as u32);
                accepted.push(Sample { position: c.position, triangle: c.triangle, area: 0.0 });
            }
        }
        advance(observer, block.len() as u64)?;
    }
    for block in candidates.chunks(BLOCK) {
        for c in block {
            let owner =
                nearest(&accepted, &cells, c).expect("a candidate was accepted or had a near neighbour");
            accepted[owner as usize].area += share;
        }
        advance(observer, block.len() as u64)?;
    }
    Ok(accepted)
}

/// How many candidates there are for a scene of this area, m².
fn candidate_count(total_area: f64, spacing: f64) -> u64 {
    (CANDIDATES * total_area / (spacing * spacing)).ceil().max(1.0) as u64
}

/// Units of work that [`poisson_disk`] reports: each candidate is tried, then gives its area away.
pub(super) fn work(total_area: f64, spacing: f64) -> u64 {
    2 * candidate_count(total_area, spacing)
}

/// Bytes that the candidates take, and the samples and cells that come of them.
pub(super) fn bytes(total_area: f64, spacing: f64) -> u64 {
    let samples = (total_area / (spacing * spacing)) as u64;
    candidate_count(total_area, spacing)
        .saturating_mul(size_of::<Candidate>() as u64)
        .saturating_add(samples.saturating_mul(200))
}

/// Points spread over the triangles in proportion to area: one at random in each equal share of it.
fn candidates(triangles: &[Triangle], total_area: f64, spacing: f64, seed: u64) -> Vec<Candidate> {
    let count = candidate_count(total_area, spacing);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut uniform = || -> f64 { StandardUniform.sample(&mut random) };
    let (mut index, mut passed) = (0, 0.0);
    (0..count)
        .map(|i| {
            let target = (i as f64 + uniform()) / count as f64 * total_area;
            while index + 1 < triangles.len() && passed + triangles[index].area() <= target {
                passed += triangles[index].area();
                index += 1;
            }
            // The square root spreads u evenly over the triangle.
            let (u, v) = (uniform().sqrt(), uniform());
            let [a, b, c] = triangles[index].vertices;
            let position = a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v);
            Candidate { position, triangle: index as u32 }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;

    fn sampled(triangles: &[Triangle], spacing: f64, seed: u64) -> Vec<Sample> {
        poisson_disk(triangles, spacing, seed, &Silent).expect("nobody interrupts")
    }

    fn plate(width: f64, height: f64) -> Vec<Triangle> {
        let v = |x: f64, y: f64| DVec3::new(x, y, 2.0);
        vec![
            Triangle { vertices: [v(0.0, 0.0), v(width, 0.0), v(width, height)], material: 0 },
            Triangle { vertices: [v(0.0, 0.0), v(width, height), v(0.0, height)], material: 0 },
        ]
    }

    #[test]
    fn samples_keep_their_distance_and_leave_no_holes() {
        let spacing = 0.05;
        let samples = sampled(&plate(1.0, 1.0), spacing, 7);
        for (i, a) in samples.iter().enumerate() {
            for b in &samples[..i] {
                assert!(a.position.distance(b.position) >= spacing);
            }
        }
        // A maximal Poisson-disk set has about 0.7/spacing² points.
        let density = samples.len() as f64 * spacing * spacing;
        assert!((0.6..0.9).contains(&density), "{density}");
        let mut worst = 0.0f64;
        for i in 0..10_000 {
            let p = DVec3::new(f64::from(i % 100) / 100.0, f64::from(i / 100) / 100.0, 2.0);
            let nearest = samples.iter().map(|s| s.position.distance(p)).fold(f64::INFINITY, f64::min);
            worst = worst.max(nearest);
        }
        assert!(worst < 1.3 * spacing, "a hole of radius {worst}");
    }

    #[test]
    fn areas_add_up_even_on_slivers() {
        let mut triangles = plate(1.0, 0.5);
        let v = DVec3::new;
        triangles.push(Triangle {
            vertices: [v(0.0, 0.0, 3.0), v(2.0, 0.0, 3.0), v(2.0, 1e-4, 3.0)],
            material: 0,
        });
        let exact: f64 = triangles.iter().map(Triangle::area).sum();
        let samples = sampled(&triangles, 0.03, 1);
        let sum: f64 = samples.iter().map(|s| s.area).sum();
        assert!((sum / exact - 1.0).abs() < 1e-9);
        assert!(samples.iter().all(|s| s.area > 0.0));
    }

    #[test]
    fn both_sides_of_a_thin_plate_are_sampled_fully() {
        let front = plate(1.0, 1.0);
        let back: Vec<Triangle> = front
            .iter()
            .map(|t| {
                let [a, b, c] = t.vertices.map(|p| p + DVec3::new(0.0, 0.0, 0.001));
                Triangle { vertices: [a, c, b], material: 0 }
            })
            .collect();
        let alone = sampled(&front, 0.05, 1).len();
        let both = sampled(&[front, back].concat(), 0.05, 1).len();
        assert!((both as f64 / (2 * alone) as f64 - 1.0).abs() < 0.05, "{alone} {both}");
    }
}
