//! One flat, two-sided piece of a surface.

use crate::wave::bounding_box;
use glam::DVec3;

/// A triangle in the array's frame, m. Both sides reflect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triangle {
    /// The corners, m; counter-clockwise as seen from the side the normal points to.
    pub vertices: [DVec3; 3],
    /// Index into [`Scene::materials`](super::Scene::materials).
    pub material: u32,
}

impl Triangle {
    /// Area, m².
    pub fn area(&self) -> f64 {
        0.5 * self.cross().length()
    }

    /// Unit normal by the right-hand rule; zero for a triangle without area.
    pub fn normal(&self) -> DVec3 {
        if self.is_degenerate() { DVec3::ZERO } else { self.cross().normalize_or_zero() }
    }

    /// The point `a + u (b - a) + v (c - a)`, m; inside the triangle when `u, v >= 0` and `u + v <= 1`.
    pub fn point(&self, u: f64, v: f64) -> DVec3 {
        let [a, b, c] = self.vertices;
        a + u * (b - a) + v * (c - a)
    }

    /// Whether the corners lie on one line, to within the rounding of their coordinates.
    pub(super) fn is_degenerate(&self) -> bool {
        let [a, b, c] = self.vertices;
        let longest = (b - a).length_squared().max((c - b).length_squared()).max((a - c).length_squared());
        self.cross().length() <= 4.0 * f64::EPSILON * longest
    }

    fn cross(&self) -> DVec3 {
        let [a, b, c] = self.vertices;
        (b - a).cross(c - a)
    }
}

/// Lower and upper corner of the bounding box of `triangles`; `None` when there are none.
pub(super) fn bounds(triangles: &[Triangle]) -> Option<(DVec3, DVec3)> {
    bounding_box(triangles.iter().flat_map(|t| t.vertices))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn area_normal_and_point_of_a_right_triangle() {
        let t = Triangle { vertices: [DVec3::ZERO, DVec3::X * 3.0, DVec3::Y * 4.0], material: 0 };
        assert_eq!(t.area(), 6.0);
        assert_eq!(t.normal(), DVec3::Z);
        assert_eq!(t.point(1.0 / 3.0, 0.5), DVec3::new(1.0, 2.0, 0.0));
        let line = Triangle { vertices: [DVec3::ZERO, DVec3::X, DVec3::X * 2.0], material: 0 };
        assert!(line.is_degenerate());
        assert_eq!(line.normal(), DVec3::ZERO);
    }
}
