//! Area-aware Poisson-disk sampling of a triangle soup.
//!
//! Candidates are spread evenly by area, tried in random order, and accepted where no accepted sample of a similarly
//! facing surface is closer than the spacing. Every candidate then gives its share of the area to the nearest
//! accepted sample, so the areas add up to the scene's exactly, slivers and small parts included.

mod cells;

use super::{Sample, does_not_fit};
use crate::alloc::{try_filled, try_with_capacity};
use crate::error::Result;
use crate::progress::{Observer, advance};
use crate::scene::Triangle;
use cells::Cells;
use glam::DVec3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardUniform};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

/// Candidates per spacing²; more fill the last holes and cost time.
const CANDIDATES: f64 = 16.0;

/// Candidates of the first block, and between two checks for a stop request.
const STEP: usize = 1 << 14;

/// A point that may become a sample.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    position: DVec3,
    triangle: u32,
    /// The cell that it is in.
    cell: u32,
    /// Its place in the order of trial.
    rank: u32,
}

/// No cell, or no sample.
const NONE: u32 = u32::MAX;

/// Samples at least `spacing` m apart on every surface, dense enough that almost no gap of `spacing` remains.
///
/// Darts hit in one thread; those that miss, nearly all, and the nearest samples are found in all. Cost: about 16 darts for
/// each sample, a microsecond of processor time for each.
///
/// # Errors
/// [`Error::OutOfMemory`](crate::error::Error::OutOfMemory) when they do not fit in memory,
/// [`Error::Interrupted`](crate::error::Error::Interrupted).
pub(super) fn poisson_disk(
    triangles: &[Triangle],
    spacing: f64,
    seed: u64,
    observer: &dyn Observer,
) -> Result<Vec<Sample>> {
    let does_not_fit = || does_not_fit(spacing);
    let mut normals: Vec<DVec3> = try_with_capacity(triangles.len() as u64).ok_or_else(does_not_fit)?;
    normals.par_extend(triangles.par_iter().map(Triangle::normal));
    let mut areas: Vec<f64> = try_with_capacity(triangles.len() as u64).ok_or_else(does_not_fit)?;
    areas.par_extend(triangles.par_iter().map(Triangle::area));
    let total_area: f64 = areas.iter().sum();
    let mut candidates = candidates(triangles, &areas, total_area, spacing, seed).ok_or_else(does_not_fit)?;
    let share = total_area / candidates.len() as f64;
    let mut cells = Cells::new(&mut candidates, spacing).ok_or_else(does_not_fit)?;
    order(&mut candidates, seed).ok_or_else(does_not_fit)?;

    let mut open: Vec<&Candidate> = Vec::new();
    for tried in candidates.chunk_by(|a, b| block(a.rank) == block(b.rank)) {
        // All threads look for those that samples of earlier blocks leave, which are few but in the first.
        open.clear();
        let left = tried.par_chunks(STEP).map(|tried| {
            let left: Vec<_> = tried.iter().filter(|c| !cells.is_taken(c, &normals)).collect();
            advance(observer, tried.len() as u64).map(|()| left)
        });
        open.extend(left.collect::<Result<Vec<_>>>()?.into_iter().flatten());
        // Among themselves the first takes the place.
        open.par_sort_unstable_by_key(|c| c.rank);
        for c in &open {
            if !cells.is_taken(c, &normals) {
                cells.take(c).ok_or_else(does_not_fit)?;
            }
        }
    }

    let mut owned: Vec<AtomicU32> = try_with_capacity(cells.samples.len() as u64).ok_or_else(does_not_fit)?;
    owned.resize_with(cells.samples.len(), AtomicU32::default);
    candidates.par_chunks(STEP).try_for_each(|some| {
        for c in some {
            // A candidate was accepted or has a near neighbour.
            owned[cells.nearest(c, &normals) as usize].fetch_add(1, Ordering::Relaxed);
        }
        advance(observer, some.len() as u64)
    })?;
    let mut samples = cells.samples;
    samples.par_iter_mut().zip(owned).for_each(|(sample, owned)| {
        sample.area = (0..owned.into_inner()).fold(0.0, |area, _| area + share);
    });
    Ok(samples)
}

/// Ranks the candidates at random, and sorts them by block of ranks, then by cell; `None` when the ranks do not fit in
/// memory.
///
/// In the order of ranks each would find its neighbours far away in memory; side by side they find them in the
/// processor's cache, ten times as fast.
fn order(candidates: &mut [Candidate], seed: u64) -> Option<()> {
    // Fisher and Yates.
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(u64::MAX);
    let mut order: Vec<u32> = try_with_capacity(candidates.len() as u64)?;
    order.extend(0..candidates.len() as u32);
    for i in (1..order.len()).rev() {
        let j = (u128::from(random.next_u64()) * (i as u128 + 1)) >> 64;
        order.swap(i, j as usize);
    }
    let mut ranks = try_filled(0, candidates.len() as u64)?;
    (0..).zip(order).for_each(|(rank, index)| ranks[index as usize] = rank);
    candidates.par_iter_mut().zip(ranks).for_each(|(c, rank)| c.rank = rank);
    candidates.par_sort_unstable_by_key(|c| (block(c.rank), c.cell, c.rank));
    Some(())
}

/// The block of a rank: as many as come before it, but not too few.
fn block(rank: u32) -> u32 {
    (rank / STEP as u32).checked_ilog2().map_or(0, |block| block + 1)
}

/// Number of candidates for a scene of this area, m².
fn candidate_count(total_area: f64, spacing: f64) -> u64 {
    (CANDIDATES * total_area / (spacing * spacing)).ceil().max(1.0) as u64
}

/// Units of work that [`poisson_disk`] reports: each candidate is tried, then gives its area away.
pub(super) fn work(total_area: f64, spacing: f64) -> u64 {
    2 * candidate_count(total_area, spacing)
}

/// Bytes of the samples and cells of one spacing².
const PER_SPACING: u64 = 250;

/// Bytes of the candidates and their order, of the samples and cells made from them, and of the triangles' normals
/// and areas.
pub(super) fn bytes(triangles: u64, total_area: f64, spacing: f64) -> u64 {
    let samples = (total_area / (spacing * spacing)) as u64;
    candidate_count(total_area, spacing)
        .saturating_mul((size_of::<Candidate>() + 2 * size_of::<u32>()) as u64)
        .saturating_add(samples.saturating_mul(PER_SPACING))
        .saturating_add(triangles.saturating_mul((size_of::<DVec3>() + size_of::<f64>()) as u64))
}

/// Points spread over the triangles in proportion to area: one at random in each equal share of it. `None` when they do
/// not fit in memory.
fn candidates(
    triangles: &[Triangle],
    areas: &[f64],
    total_area: f64,
    spacing: f64,
    seed: u64,
) -> Option<Vec<Candidate>> {
    let count = candidate_count(total_area, spacing);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut uniform = || -> f64 { StandardUniform.sample(&mut random) };
    let (mut index, mut passed) = (0, 0.0);
    let mut candidates = try_with_capacity(count)?;
    candidates.extend((0..count).map(|i| {
        let target = (i as f64 + uniform()) / count as f64 * total_area;
        while index + 1 < triangles.len() && passed + areas[index] <= target {
            passed += areas[index];
            index += 1;
        }
        // The square root spreads u evenly over the triangle.
        let (u, v) = (uniform().sqrt(), uniform());
        let [a, b, c] = triangles[index].vertices;
        let position = a * (1.0 - u) + b * (u * (1.0 - v)) + c * (u * v);
        Candidate { position, triangle: index as u32, cell: NONE, rank: NONE }
    }));
    Some(candidates)
}

#[cfg(test)]
mod tests {
    use super::cells::SAME_SURFACE;
    use super::*;
    use crate::progress::Silent;
    use crate::scene::fixtures;

    fn sampled(triangles: &[Triangle], spacing: f64, seed: u64) -> Vec<Sample> {
        poisson_disk(triangles, spacing, seed, &Silent).expect("not interrupted")
    }

    fn plate(width: f64, height: f64) -> Vec<Triangle> {
        fixtures::plate([0.0, width], [0.0, height], 2.0, 0).to_vec()
    }

    /// The literal sampling: every candidate is compared with all samples.
    fn literal(triangles: &[Triangle], spacing: f64, seed: u64) -> Vec<Sample> {
        let areas: Vec<f64> = triangles.iter().map(Triangle::area).collect();
        let total_area = areas.iter().sum::<f64>();
        let mut candidates = candidates(triangles, &areas, total_area, spacing, seed).expect("room");
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(u64::MAX);
        for i in (1..candidates.len()).rev() {
            candidates.swap(i, ((u128::from(random.next_u64()) * (i as u128 + 1)) >> 64) as usize);
        }
        let nearest = |samples: &[Sample], c: &Candidate| {
            let facing = |s: &Sample| {
                let normals = [s.triangle, c.triangle].map(|t| triangles[t as usize].normal());
                normals[0].dot(normals[1]) > SAME_SURFACE
            };
            let distances = samples.iter().map(|s| s.position.distance_squared(c.position)).enumerate();
            let near = distances.filter(|(i, d)| *d < spacing * spacing && facing(&samples[*i]));
            near.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
        };
        let mut samples: Vec<Sample> = Vec::new();
        for c in &candidates {
            if nearest(&samples, c).is_none() {
                samples.push(Sample { position: c.position, triangle: c.triangle, area: 0.0 });
            }
        }
        for c in &candidates {
            let owner = nearest(&samples, c).expect("accepted, or near one that was");
            samples[owner].area += total_area / candidates.len() as f64;
        }
        samples
    }

    #[test]
    fn the_cells_change_nothing() {
        let fraction = |i: usize, k: f64| (i as f64 * k).fract() - 0.5;
        let vertex =
            |i| DVec3::new(fraction(i, 0.618_034), fraction(i, 0.754_878), 1.0 + 0.3 * fraction(i, 0.569_84));
        let soup: Vec<Triangle> = (0..12)
            .map(|t| Triangle { vertices: [0, 1, 2].map(|v| vertex(3 * t + v)), material: 0 })
            .collect();
        for (triangles, spacing) in [(soup, 0.08), (plate(1.0, 0.5), 0.05)] {
            for seed in 1..4 {
                assert_eq!(sampled(&triangles, spacing, seed), literal(&triangles, spacing, seed));
            }
        }
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
