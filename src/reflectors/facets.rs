//! Flat pieces of surface as mirrors: coplanar triangles merged into facets, each with its plane and its outline.
//!
//! A point mirrored in a facet's plane is an image of it; the facet is the opening through which that image is seen. Whether
//! a straight line passes through the opening is decided by the number of times the outline winds about the point where
//! it meets the plane, so that holes, concave outlines and doubled faces need no care.

use crate::scene::{Scene, Triangle};
use glam::{DVec2, DVec3};
use rustc_hash::FxHashMap;
use serde::{Deserialize, Serialize};

/// Vertices this near to a facet's plane are in it, in wavelengths.
const FLATNESS: f64 = 1e-3;

/// Normals of one facet are within 0.08 degrees: the smallest cosine between them.
const PARALLEL: f64 = 1.0 - 1e-6;

/// A facet of less area than the square of this many wavelengths is no mirror: it diffracts more than it reflects.
const SMALLEST: f64 = 2.0;

/// The most facets that mirror, the largest first.
pub(super) const MOST_FACETS: usize = 64;

/// Bytes of a triangle while they are merged: its sides, and what is beside them.
pub(super) const BYTES_PER_TRIANGLE: u64 = 512;

/// A mirror: a plane and the part of it that reflects.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Facet {
    normal: DVec3,
    /// `normal · x` of the points x in the plane, m.
    offset: f64,
    /// Two axes in the plane.
    axes: [DVec3; 2],
    /// The outline, m along the axes, with the area on the left.
    outline: Vec<[DVec2; 2]>,
    /// Index into the scene's materials.
    pub(super) material: u32,
    /// m², counted twice where faces are doubled.
    pub(super) area: f64,
    /// The middle of its bounding box, m.
    pub(super) centre: DVec3,
}

impl Facet {
    fn new(triangles: &[Triangle], members: &[u32]) -> Self {
        let all = || members.iter().map(|&t| &triangles[t as usize]);
        let first = &triangles[members[0] as usize];
        let normal = first.normal();
        let along = normal.any_orthonormal_vector();
        let axes = [along, normal.cross(along)];
        let flat = |v: DVec3| axes.map(|axis| axis.dot(v));
        // An edge that two triangles run along in opposite directions is inside.
        let mut edges: FxHashMap<[[u64; 2]; 2], i32> = FxHashMap::default();
        let mut outline = Vec::new();
        for triangle in all() {
            let mut corners = triangle.vertices.map(flat);
            if triangle.normal().dot(normal) < 0.0 {
                corners.swap(0, 1);
            }
            for side in 0..3 {
                let ends = [corners[side], corners[(side + 1) % 3]].map(|end| end.map(f64::to_bits));
                *edges.entry(ends).or_default() += 1;
                outline.push(ends);
            }
        }
        let mut left = edges.clone();
        outline.retain(|&[a, b]| {
            let (there, back) = (edges[&[a, b]], edges.get(&[b, a]).copied().unwrap_or(0));
            let kept = left.get_mut(&[a, b]).filter(|taken| **taken > back.min(there));
            kept.map(|taken| *taken -= 1).is_some()
        });
        let corners = all().flat_map(|triangle| triangle.vertices);
        let (low, high) = crate::wave::bounding_box(corners).unwrap_or_default();
        Self {
            normal,
            offset: normal.dot(first.vertices[0]),
            axes,
            outline: outline
                .iter()
                .map(|ends| ends.map(|end| DVec2::from(end.map(f64::from_bits))))
                .collect(),
            material: first.material,
            area: all().map(Triangle::area).sum(),
            centre: low.midpoint(high),
        }
    }

    /// The same elsewhere, by so many m.
    pub(super) fn displaced(&self, by: DVec3) -> Self {
        let along = DVec2::from(self.axes.map(|axis| axis.dot(by)));
        let outline = self.outline.iter().map(|ends| ends.map(|end| end + along)).collect();
        let offset = self.offset + self.normal.dot(by);
        Self { offset, outline, centre: self.centre + by, ..self.clone() }
    }

    /// The mirror image of `p`.
    pub(super) fn mirror(&self, p: DVec3) -> DVec3 {
        p - self.normal * (2.0 * self.height(p))
    }

    /// The mirror image of a direction.
    pub(super) fn turn(&self, direction: DVec3) -> DVec3 {
        direction - self.normal * (2.0 * self.normal.dot(direction))
    }

    /// Height of `p` above the plane, m.
    fn height(&self, p: DVec3) -> f64 {
        self.normal.dot(p) - self.offset
    }

    /// |cos| of the angle between `direction` and the normal.
    pub(super) fn cosine(&self, direction: DVec3) -> f64 {
        self.normal.dot(direction.normalize_or_zero()).abs()
    }

    /// Where the straight line from `a` to `b`, which are on different sides, passes through the facet.
    pub(super) fn passage(&self, a: DVec3, b: DVec3) -> Option<DVec3> {
        let (above, below) = (self.height(a), self.height(b));
        let apart = above * below < 0.0;
        let x = a + (b - a) * (above / (above - below));
        (apart && self.contains(x)).then_some(x)
    }

    /// Whether a point of the plane is in the facet: its outline winds about it.
    fn contains(&self, x: DVec3) -> bool {
        let p = DVec2::from(self.axes.map(|axis| axis.dot(x)));
        let mut winding = 0;
        for [a, b] in &self.outline {
            let left = (*b - *a).perp_dot(p - *a);
            if a.y <= p.y && b.y > p.y && left > 0.0 {
                winding += 1;
            } else if a.y > p.y && b.y <= p.y && left < 0.0 {
                winding -= 1;
            }
        }
        winding != 0
    }
}

/// The mirrors of a scene.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Facets {
    /// From the largest to the smallest.
    pub(super) mirrors: Vec<Facet>,
    /// The mirror that each triangle belongs to, or [`NO_MIRROR`].
    of_triangle: Vec<u32>,
    /// Area of the surfaces that belong to none, m².
    pub(super) left_out: f64,
}

const NO_MIRROR: u32 = u32::MAX;

impl Facets {
    /// Merges coplanar triangles of one material that share a side, and those of one plane among the largest.
    ///
    /// Cost: a hash map of the triangles' sides.
    pub(super) fn of(scene: &Scene, wavelength: f64) -> Self {
        let triangles = scene.triangles();
        let mut found = merged(triangles, FLATNESS * wavelength);
        let area = |members: &Vec<u32>| members.iter().map(|&t| triangles[t as usize].area()).sum::<f64>();
        let smallest = (SMALLEST * wavelength).powi(2);
        found.retain(|members| area(members) >= smallest);
        // The sort is stable, and so deterministic.
        found.sort_by(|a, b| area(b).total_cmp(&area(a)));
        found.truncate(4 * MOST_FACETS);
        let mut groups: Vec<Vec<u32>> = Vec::new();
        for members in found {
            let seed = &triangles[members[0] as usize];
            let same = |group: &&mut Vec<u32>| {
                is_coplanar(&triangles[group[0] as usize], seed, FLATNESS * wavelength)
            };
            match groups.iter_mut().find(same) {
                Some(group) => group.extend(members),
                None => groups.push(members),
            }
        }
        groups.sort_by(|a, b| area(b).total_cmp(&area(a)));
        groups.truncate(MOST_FACETS);
        let mut of_triangle = vec![NO_MIRROR; triangles.len()];
        for (index, members) in (0_u32..).zip(&groups) {
            for &t in members {
                of_triangle[t as usize] = index;
            }
        }
        let mirrors: Vec<Facet> = groups.iter().map(|members| Facet::new(triangles, members)).collect();
        let left_out = (scene.surface_area() - mirrors.iter().map(|facet| facet.area).sum::<f64>()).max(0.0);
        Self { mirrors, of_triangle, left_out }
    }

    /// Keeps the largest mirrors.
    pub(super) fn keep(&mut self, count: usize) {
        let left = self.mirrors.split_off(count.min(self.mirrors.len()));
        self.left_out += left.iter().map(|facet| facet.area).sum::<f64>();
        for facet in &mut self.of_triangle {
            if *facet as usize >= count {
                *facet = NO_MIRROR;
            }
        }
    }

    /// Whether a triangle belongs to a mirror.
    pub(super) fn mirrors(&self, triangle: u32) -> bool {
        self.of_triangle.get(triangle as usize).is_some_and(|&facet| facet != NO_MIRROR)
    }
}

/// Whether `triangle` is of the material and in the plane of `seed`, to within `flatness` m.
fn is_coplanar(seed: &Triangle, triangle: &Triangle, flatness: f64) -> bool {
    let normal = seed.normal();
    let height = |v: DVec3| (normal.dot(v - seed.vertices[0])).abs();
    seed.material == triangle.material
        && normal.dot(triangle.normal()).abs() >= PARALLEL
        && triangle.vertices.iter().all(|&v| height(v) <= flatness)
}

/// Triangles joined across sides, as long as they are in the plane of the first of them.
fn merged(triangles: &[Triangle], flatness: f64) -> Vec<Vec<u32>> {
    let key = |v: DVec3| v.to_array().map(|x| (x + 0.0).to_bits());
    let sides = |t: u32| {
        let corners = triangles[t as usize].vertices.map(key);
        [0, 1, 2].map(|side| {
            let [a, b] = [corners[side], corners[(side + 1) % 3]];
            if a < b { [a, b] } else { [b, a] }
        })
    };
    let mut beside: FxHashMap<[[u64; 3]; 2], Vec<u32>> = FxHashMap::default();
    for t in 0..triangles.len() as u32 {
        for side in sides(t) {
            beside.entry(side).or_default().push(t);
        }
    }
    let mut taken = vec![false; triangles.len()];
    let mut found = Vec::new();
    for seed in 0..triangles.len() as u32 {
        if taken[seed as usize] || triangles[seed as usize].normal() == DVec3::ZERO {
            continue;
        }
        taken[seed as usize] = true;
        let mut members = vec![seed];
        let mut next = 0;
        while next < members.len() {
            for side in sides(members[next]) {
                for &t in &beside[&side] {
                    let joins = !taken[t as usize]
                        && is_coplanar(&triangles[seed as usize], &triangles[t as usize], flatness);
                    if joins {
                        taken[t as usize] = true;
                        members.push(t);
                    }
                }
            }
            next += 1;
        }
        found.push(members);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::fixtures::{material, plate};

    fn facets(triangles: Vec<Triangle>) -> Facets {
        let scene = Scene::new(triangles, vec![material(1.0, 0.0), material(0.5, 0.0)]).expect("valid");
        Facets::of(&scene, 0.02)
    }

    #[test]
    fn coplanar_triangles_are_one_mirror_with_an_outline_of_its_corners() {
        let all = facets(plate([-0.5, 0.5], [-0.2, 0.2], 1.0, 0).to_vec());
        let [facet] = &all.mirrors[..] else { panic!("{all:?}") };
        assert_eq!((facet.outline.len(), all.left_out < 1e-12), (4, true));
        assert!((facet.mirror(DVec3::ZERO) - DVec3::new(0.0, 0.0, 2.0)).length() < 1e-12);
        let through = |x: f64, y: f64| facet.passage(DVec3::ZERO, DVec3::new(2.0 * x, 2.0 * y, 2.0));
        assert!((through(0.4, -0.1).expect("inside") - DVec3::new(0.4, -0.1, 1.0)).length() < 1e-12);
        assert!(through(0.51, 0.0).is_none() && through(0.0, 0.21).is_none());
        assert!(facet.passage(DVec3::ZERO, DVec3::new(0.0, 0.0, 0.9)).is_none(), "one side");
    }

    #[test]
    fn doubled_faces_and_unshared_sides_are_one_mirror_and_holes_stay_open() {
        let mut doubled = plate([-0.5, 0.5], [-0.2, 0.2], 1.0, 0).to_vec();
        let back: Vec<Triangle> = doubled
            .iter()
            .map(|t| Triangle { vertices: [t.vertices[0], t.vertices[2], t.vertices[1]], material: 0 })
            .collect();
        doubled.extend(back);
        // A ring of four plates, whose sides meet without sharing corners.
        let ring = [
            plate([-0.5, 0.5], [-0.5, -0.2], 2.0, 1),
            plate([-0.5, 0.5], [0.2, 0.5], 2.0, 1),
            plate([-0.5, -0.2], [-0.2, 0.2], 2.0, 1),
            plate([0.2, 0.5], [-0.2, 0.2], 2.0, 1),
        ];
        let all = facets([doubled, ring.concat()].concat());
        assert_eq!(all.mirrors.len(), 2);
        for facet in &all.mirrors {
            let z = facet.centre.z;
            let open = |x: f64, y: f64| facet.passage(DVec3::ZERO, DVec3::new(x, y, z) * 2.0).is_none();
            assert_eq!((open(0.0, 0.0), open(0.35, 0.0), open(0.6, 0.0)), (z > 1.5, false, true), "{z}");
        }
    }

    #[test]
    fn a_bent_strip_and_small_facets_are_no_mirror() {
        let tilted = |i: i32| {
            let corner = |k: i32, y: f64| {
                let angle = f64::from(k) * 0.01;
                DVec3::new(angle.sin(), y, 2.0 - angle.cos())
            };
            let [a, b, c, d] = [corner(i, -0.5), corner(i + 1, -0.5), corner(i + 1, 0.5), corner(i, 0.5)];
            [[a, b, c], [a, c, d]].map(|vertices| Triangle { vertices, material: 0 })
        };
        let all = facets((0..10).flat_map(tilted).collect());
        assert_eq!(all.mirrors.len(), 10, "each flat strip is a facet of its own");
        let small = facets(plate([0.0, 0.03], [0.0, 0.03], 1.0, 0).to_vec());
        assert!(small.mirrors.is_empty() && (small.left_out - 9e-4).abs() < 1e-12 && !small.mirrors(0));
    }
}
