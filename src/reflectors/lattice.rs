//! Lattice sampling for smooth, mirror-like surfaces.
//!
//! The image of a coherent surface shows the noise of irregular samples (the level falls by 23 dB from a spacing of λ to
//! one of λ/4), so a smooth surface is sampled on a square lattice. The lattice belongs to the plane, not to the triangle,
//! and edges are half open: triangles that share a plane share the lattice, and no seam appears along a diagonal.

use super::Sample;
use crate::alloc::try_with_capacity;
use crate::scene::Triangle;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Triangles that a thread samples at a time.
const BLOCK: usize = 1024;

/// Lattice points of every triangle, each representing `spacing²`; `None` when they do not fit in memory.
pub(super) fn lattice(triangles: &[Triangle], spacing: f64) -> Option<Vec<Sample>> {
    let blocks = triangles.par_chunks(BLOCK).enumerate().map(|(block, triangles)| {
        let mut samples = Vec::new();
        for (index, triangle) in (block * BLOCK..).zip(triangles) {
            points(triangle, spacing, |position| {
                samples.try_reserve(1).ok()?;
                samples.push(Sample { position, triangle: index as u32, area: spacing * spacing });
                Some(())
            })?;
        }
        Some(samples)
    });
    let blocks: Vec<Vec<Sample>> = blocks.collect::<Option<_>>()?;
    let mut samples = try_with_capacity(blocks.iter().map(|block| block.len() as u64).sum())?;
    for block in blocks {
        samples.extend(block);
    }
    Some(samples)
}

/// Two directions of the plane; the same for every triangle of it, whatever its winding.
fn plane_axes(normal: DVec3) -> (DVec3, DVec3) {
    // Rounding makes coplanar triangles agree in spite of their last bits.
    let mut n = (normal * 1e5).round() / 1e5;
    let first = n.to_array().into_iter().find(|c| *c != 0.0).unwrap_or(1.0);
    if first < 0.0 {
        n = -n;
    }
    let n = n.normalize_or(DVec3::Z);
    let u = n.any_orthonormal_vector();
    (u, n.cross(u))
}

/// Passes every lattice point of a triangle to `take`, until it returns `None`.
fn points(triangle: &Triangle, spacing: f64, mut take: impl FnMut(DVec3) -> Option<()>) -> Option<()> {
    let normal = triangle.normal();
    if normal == DVec3::ZERO {
        return Some(());
    }
    let (u, v) = plane_axes(normal);
    let flat = triangle.vertices.map(|p| DVec2::new(p.dot(u), p.dot(v)));
    let (low, high) = flat.iter().fold((flat[0], flat[0]), |(low, high), p| (low.min(*p), high.max(*p)));
    let (first, last) = ((low / spacing).floor(), (high / spacing).ceil());
    let area = edge(flat[0], flat[1], flat[2]);
    let mut j = first.y;
    while j <= last.y {
        let mut i = first.x;
        while i <= last.x {
            let q = DVec2::new(i + 0.5, j + 0.5) * spacing;
            if inside(&flat, area, q) {
                // Barycentric weights put the point on the triangle itself, whatever the rounded plane says.
                let w = [
                    edge(flat[1], flat[2], q) / area,
                    edge(flat[2], flat[0], q) / area,
                    edge(flat[0], flat[1], q) / area,
                ];
                take(
                    triangle.vertices[0] * w[0] + triangle.vertices[1] * w[1] + triangle.vertices[2] * w[2],
                )?;
            }
            i += 1.0;
        }
        j += 1.0;
    }
    Some(())
}

/// Twice the signed area of (a, b, q); exactly antisymmetric in a and b, so that neighbours agree.
fn edge(a: DVec2, b: DVec2, q: DVec2) -> f64 {
    if (a.x, a.y) <= (b.x, b.y) { (b - a).perp_dot(q - a) } else { -(a - b).perp_dot(q - b) }
}

/// Whether q is in the triangle; of two triangles that share an edge exactly one owns a point on it.
fn inside(flat: &[DVec2; 3], area: f64, q: DVec2) -> bool {
    (0..3).all(|k| {
        let (a, b) = if area > 0.0 { (flat[k], flat[(k + 1) % 3]) } else { (flat[(k + 1) % 3], flat[k]) };
        let e = edge(a, b, q);
        e > 0.0 || (e == 0.0 && (a.x, a.y) < (b.x, b.y))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(tilt: DVec3, flip: bool) -> Vec<Triangle> {
        let (u, v) = (DVec3::X, (DVec3::Y + tilt).normalize());
        let corner = |a: f64, b: f64| u * a + v * b + DVec3::new(0.0, 0.0, 1.0);
        let second = if flip {
            [corner(0.0, 0.0), corner(0.0, 1.0), corner(1.0, 1.0)]
        } else {
            [corner(0.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)]
        };
        vec![
            Triangle { vertices: [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0)], material: 0 },
            Triangle { vertices: second, material: 0 },
        ]
    }

    #[test]
    fn a_diagonal_leaves_no_seam() {
        for (tilt, flip) in
            [(DVec3::ZERO, false), (DVec3::ZERO, true), (DVec3::Z * 0.7, false), (DVec3::Z, true)]
        {
            let samples = lattice(&square(tilt, flip), 0.02).expect("room");
            let count = samples.len() as f64;
            assert!((count * 0.0004 - 1.0).abs() < 0.05, "{count} samples of 0.0004 m² on 1 m²");
            for (i, a) in samples.iter().enumerate() {
                for b in &samples[..i] {
                    assert!(a.position.distance(b.position) > 0.0199, "doubled at {}", a.position);
                }
            }
        }
    }
}
