//! What a scene shows of itself at first sight, for hints about its orientation.

use super::Scene;
use glam::DVec3;

/// Rays along each side of the bounding box.
const RAYS: usize = 48;

/// Cosine between normals of one flat side: 5 degrees.
const FLAT: f64 = 0.996;

/// Shares of the rays from one point that meet a surface, 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct FirstLook {
    /// That meet the back of a face, by the order of its vertices.
    pub backs: f64,
    /// That meet a face of the most frequent normal.
    pub flat: f64,
}

impl Scene {
    /// Looks at the scene from a point before it. Cost: 2304 rays.
    pub(crate) fn first_look(&self, from: DVec3) -> FirstLook {
        let Some((low, high)) = self.bounds() else { return FirstLook::default() };
        let mut normals = Vec::new();
        let mut backs = 0;
        for i in 0..RAYS * RAYS {
            let [u, v] = [i % RAYS, i / RAYS].map(|k| (k as f64 + 0.5) / RAYS as f64);
            // Through the middle of the box, and on to its far side.
            let across = low + (high - low) * DVec3::new(u, v, 0.5);
            let to = from + (across - from) * (2.0 * (high.z - from.z) / (across.z - from.z).max(1e-9));
            let Some(hit) = self.crossings(from, to).into_iter().next() else { continue };
            let normal = self.triangles()[hit.triangle as usize].normal();
            backs += usize::from(normal.dot(to - from) > 0.0);
            normals.push(normal);
        }
        let hits = normals.len().max(1) as f64;
        let alike = |normal: &DVec3| normals.iter().filter(|other| other.dot(*normal) > FLAT).count();
        // The normal of most is among any few dozen of them.
        let flat = normals.iter().step_by(normals.len() / RAYS + 1).map(alike).max().unwrap_or(0);
        FirstLook { backs: backs as f64 / hits, flat: flat as f64 / hits }
    }
}

#[cfg(test)]
mod tests {
    use crate::scene::fixtures::{material, plate};
    use crate::scene::{Scene, Triangle};
    use glam::DVec3;

    #[test]
    fn a_plate_is_flat_and_shows_its_front_or_its_back() {
        let plate = plate([-0.5, 0.5], [-0.5, 0.5], 1.0, 0);
        let mut turned = plate;
        for triangle in &mut turned {
            triangle.vertices.swap(0, 1);
        }
        let look = |triangles: [Triangle; 2]| {
            let scene = Scene::new(triangles.to_vec(), vec![material(1.0, 0.0)]).expect("valid");
            scene.first_look(DVec3::ZERO)
        };
        let (one, other) = (look(plate), look(turned));
        assert_eq!((one.flat, other.flat), (1.0, 1.0));
        assert_eq!((one.backs - other.backs).abs(), 1.0);
    }
}
