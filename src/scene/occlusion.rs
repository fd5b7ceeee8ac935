//! What a straight path crosses: a tree over the triangles, and a triangle test without gaps.
//!
//! The tree (obvhs' `Bvh2`, f32) only proposes candidates; whether and where a path crosses a triangle is
//! decided here in f64. Its boxes are padded by more than the error of f32, so it may propose too many and
//! never too few. The test is watertight: a path through an edge or a corner that triangles share hits at least one
//! of them. It may then hit several, so crossings at one place along the path count as one surface.

mod build;

use std::fmt;

use glam::{DVec3, Vec3A};
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::fast_stack;
use obvhs::ray::{Ray, RayHit};

use super::triangle::{self, Triangle};
use super::{Material, Scene};
use crate::error::Result;
use crate::progress::Observer;
use build::build;

/// Crossings closer than this times the scene's maximum coordinate (including those of the path's ends) to an end of
/// the path, or to one another, are at the same place: within 0.25 µm in a scene of 2.5 m, far below a wavelength and
/// far above the rounding of f64.
const SAME_PLACE: f64 = 1e-7;

/// Padding of the tree's boxes in the tree's unit, the scene's maximum half extent. In f32 a path of at most 2√3 units
/// deviates by less than 1e-6: rounding of its ends and direction, and obvhs' minimum slope of 1.2e-7.
const PADDING: f32 = 4e-6;

/// One surface that a path crosses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// Distance from the start of the path, m.
    pub distance: f64,
    /// Index into [`Scene::triangles`]; of several at one place, the one with the lowest transmittance.
    pub triangle: u32,
    /// Share of the amplitude that it transmits, 0..1.
    pub transmittance: f64,
}

impl Scene {
    /// Share of the amplitude left on the straight path `from` → `to` (m): the product of the transmittances of
    /// the surfaces strictly between.
    ///
    /// A surface at an end of the path (within 1e-7 of the maximum coordinate) does not count, so a
    /// reflector does not shade itself. Cost: about `O(log n)`; stops at the first opaque surface.
    ///
    /// # Panics
    /// When an end is not finite, or the path is too long for f64.
    pub fn transmittance(&self, from: DVec3, to: DVec3) -> f64 {
        let mut found = Vec::new();
        let mut blocked = false;
        let tolerance = self.tree.tolerance(from, to);
        self.tree.visit(&self.triangles, from, to, tolerance, |distance, triangle| {
            let transmittance = self.transmittance_of(triangle);
            blocked = transmittance == 0.0;
            // Clear surfaces change nothing, whether alone or together with another.
            if transmittance < 1.0 {
                found.push(Crossing { distance, triangle, transmittance });
            }
            !blocked
        });
        if blocked {
            return 0.0;
        }
        merge(&mut found, tolerance);
        found.iter().map(|crossing| crossing.transmittance).product()
    }

    /// The surfaces strictly between `from` and `to` (m), front to back; those at one place count once.
    ///
    /// Cost: about `O(log n)` and the number of crossings.
    ///
    /// # Panics
    /// As [`Scene::transmittance`].
    pub fn crossings(&self, from: DVec3, to: DVec3) -> Vec<Crossing> {
        let mut found = Vec::new();
        let tolerance = self.tree.tolerance(from, to);
        self.tree.visit(&self.triangles, from, to, tolerance, |distance, triangle| {
            found.push(Crossing { distance, triangle, transmittance: self.transmittance_of(triangle) });
            true
        });
        merge(&mut found, tolerance);
        found
    }

    /// The literal form of [`Scene::crossings`]: tries every triangle with the textbook test (Möller and
    /// Trumbore), without a tree. The oracle of the tests; it may let a path slip through a shared edge.
    pub fn crossings_exhaustive(&self, from: DVec3, to: DVec3) -> Vec<Crossing> {
        let (length, tolerance) = (from.distance(to), self.tree.tolerance(from, to));
        let direction = (to - from) / length;
        let mut found: Vec<_> = (0_u32..)
            .zip(&self.triangles)
            .filter_map(|(triangle, t)| {
                let distance = textbook_crossing(from, direction, t)?;
                let transmittance = self.transmittance_of(triangle);
                Some(Crossing { distance, triangle, transmittance })
            })
            .filter(|crossing| crossing.distance > tolerance && crossing.distance < length - tolerance)
            .collect();
        merge(&mut found, tolerance);
        found
    }

    fn transmittance_of(&self, triangle: u32) -> f64 {
        let material: &Material = &self.materials[self.triangles[triangle as usize].material as usize];
        material.transmittance
    }
}

/// Sorts front to back and merges crossings within `tolerance` of the first at their place. The lowest transmittance
/// is used, so that a shared edge or a doubled face is not counted twice.
fn merge(found: &mut Vec<Crossing>, tolerance: f64) {
    // Sorting makes the result independent of the order in which the tree proposes them.
    found.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.triangle.cmp(&b.triangle)));
    found.dedup_by(|next, kept| {
        let same = next.distance - kept.distance <= tolerance;
        if same && next.transmittance < kept.transmittance {
            (kept.triangle, kept.transmittance) = (next.triangle, next.transmittance);
        }
        same
    });
}

/// The coordinates of the tree, in which the scene fills (-1, 1).
#[derive(Clone, Copy)]
struct TreeFrame {
    centre: DVec3,
    /// Half of the longest side of the scene's box, m.
    unit: f64,
}

impl TreeFrame {
    fn to_tree(self, p: DVec3) -> Vec3A {
        ((p - self.centre) / self.unit).as_vec3a()
    }
}

/// A tree over the triangles' boxes.
pub(super) struct SurfaceTree {
    bvh: Bvh2,
    frame: TreeFrame,
    low: DVec3,
    high: DVec3,
}

impl fmt::Debug for SurfaceTree {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SurfaceTree({} nodes)", self.bvh.nodes.len())
    }
}

impl SurfaceTree {
    /// Bytes per triangle at the peak of [`SurfaceTree::new`].
    pub(super) const BUILDING: u64 = build::BYTES;

    /// # Errors
    /// [`Error::OutOfMemory`](crate::error::Error::OutOfMemory) when it does not fit in memory;
    /// [`Error::Interrupted`](crate::error::Error::Interrupted) when the observer asks to stop.
    pub(super) fn new(triangles: &[Triangle], observer: &dyn Observer) -> Result<Self> {
        let (low, high) = triangle::bounds(triangles).unwrap_or_default();
        let centre = 0.5 * (low + high);
        let half = (0.5 * (high - low)).max_element();
        // A scene that is a single point has no extent; any unit will do.
        let unit = if half > 0.0 { half } else { 1.0 };
        let frame = TreeFrame { centre, unit };
        let bvh = build(triangles, &frame, [low, high], observer)?;
        let padding = DVec3::splat(f64::from(PADDING) * unit);
        Ok(Self { bvh, frame, low: low - padding, high: high + padding })
    }

    /// Bytes of its nodes and indices.
    pub(super) fn memory_bytes(&self) -> u64 {
        (size_of_val(&self.bvh.nodes[..]) + size_of_val(&self.bvh.primitive_indices[..])) as u64
    }

    /// The distance within which places along the path `from` → `to` count as one, m.
    fn tolerance(&self, from: DVec3, to: DVec3) -> f64 {
        let greatest = [self.low, self.high, from, to].map(|p| p.abs().max_element());
        SAME_PLACE * greatest.into_iter().fold(0.0, f64::max)
    }

    /// Calls `crossing(distance, triangle)` for every triangle crossed strictly between the ends, in any
    /// order, until it returns false.
    fn visit(
        &self,
        triangles: &[Triangle],
        from: DVec3,
        to: DVec3,
        tolerance: f64,
        mut crossing: impl FnMut(f64, u32) -> bool,
    ) {
        let length = from.distance(to);
        assert!(length.is_finite(), "the ends of a path must be finite: {from} to {to}");
        if triangles.is_empty() || length <= 2.0 * tolerance {
            return;
        }
        let direction = (to - from) / length;
        // Only the part inside the scene's box is converted to f32: a far end would cost the near part its
        // precision.
        let Some((enter, leave)) = clip(from, direction, length, self.low, self.high) else { return };
        let start = self.frame.to_tree(from + enter * direction);
        // Adding +0 turns -0 into +0; with -0 the slab test would fail.
        let heading = direction.as_vec3a() + Vec3A::ZERO;
        let ray = Ray::new(start, heading, 0.0, ((leave - enter) / self.frame.unit) as f32 + PADDING);
        let sheared = ShearedRay::new(from, direction);
        let mut leaf = |node: &Bvh2Node, _: &mut Ray, _: &mut RayHit| {
            let first = node.first_index as usize;
            self.bvh.primitive_indices[first..first + node.prim_count as usize].iter().all(|&index| {
                match sheared.crossing(&triangles[index as usize].vertices) {
                    Some(t) if t > tolerance && t < length - tolerance => crossing(t, index),
                    _ => true,
                }
            })
        };
        fast_stack!(u32, (96, 192), self.bvh.max_depth, stack, {
            self.bvh.ray_traverse_dynamic(&mut stack, ray, &mut RayHit::none(), &mut leaf);
        });
    }
}

/// The part of a path inside a box, as distances from its start; `None` when it misses the box.
fn clip(from: DVec3, direction: DVec3, length: f64, low: DVec3, high: DVec3) -> Option<(f64, f64)> {
    let (mut enter, mut leave) = (0.0_f64, length);
    for axis in 0..3 {
        let (origin, slope) = (from[axis], direction[axis]);
        if slope == 0.0 {
            if origin < low[axis] || origin > high[axis] {
                return None;
            }
            continue;
        }
        let (a, b) = ((low[axis] - origin) / slope, (high[axis] - origin) / slope);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    (enter <= leave).then_some((enter, leave))
}

/// A straight path, sheared so that it runs along an axis: the watertight test of Woop, Benthin and Wald,
/// "Watertight Ray/Triangle Intersection" (JCGT 2, 2013), in f64.
struct ShearedRay {
    origin: DVec3,
    /// The axes of the plane that the triangle is projected onto, and the dominant axis of the path.
    axes: [usize; 3],
    shear: [f64; 3],
}

impl ShearedRay {
    fn new(origin: DVec3, direction: DVec3) -> Self {
        let z = direction.abs().max_position();
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let shear = [direction[x] / direction[z], direction[y] / direction[z], 1.0 / direction[z]];
        Self { origin, axes: [x, y, z], shear }
    }

    /// Distance from the origin, in lengths of the direction, at which the line crosses the triangle; either
    /// side counts, and so do edges and corners. A line within the triangle's plane does not cross it.
    #[inline]
    fn crossing(&self, vertices: &[DVec3; 3]) -> Option<f64> {
        let [x, y, z] = self.axes;
        let [sx, sy, sz] = self.shear;
        // A vertex is sheared identically in every triangle, and an edge's sign changes only with its direction:
        // neighbours agree on which side of their edge the path is.
        let [a, b, c] = vertices.map(|v| {
            let v = v - self.origin;
            [v[x] - sx * v[z], v[y] - sy * v[z], sz * v[z]]
        });
        let u = c[0] * b[1] - c[1] * b[0];
        let v = a[0] * c[1] - a[1] * c[0];
        let w = b[0] * a[1] - b[1] * a[0];
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let sum = u + v + w;
        (sum != 0.0).then(|| (u * a[2] + v * b[2] + w * c[2]) / sum)
    }
}

/// Möller and Trumbore's test, as in the textbooks.
fn textbook_crossing(origin: DVec3, direction: DVec3, triangle: &Triangle) -> Option<f64> {
    let [a, b, c] = triangle.vertices;
    let (e1, e2) = (b - a, c - a);
    let p = direction.cross(e2);
    let determinant = e1.dot(p);
    if determinant == 0.0 {
        return None;
    }
    let s = origin - a;
    let u = s.dot(p) / determinant;
    let q = s.cross(e1);
    let v = direction.dot(q) / determinant;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0).then(|| e2.dot(q) / determinant)
}

#[cfg(test)]
mod tests;
