//! A wedge and how sound bends around its edge: the directivity of the pieces of the edge.

use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

/// Nearer to the line of an edge nothing is known of angles, m.
const NEAREST: f64 = 1e-9;

/// Two half planes that meet in a straight edge, as a speaker sees them from the larger of the angles between them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Wedge {
    /// A point of the edge, m.
    origin: DVec3,
    /// Along the edge.
    along: DVec3,
    /// From the edge into one of the faces, and at right angles to it, out of the wedge.
    axes: [DVec3; 2],
    /// Between the faces, around the outside: π to 2π.
    angle: f64,
    /// The speaker.
    source: Cylindrical,
}

/// A point in a wedge's cylindrical coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Cylindrical {
    /// From the line of the edge, m.
    radius: f64,
    /// From the first face.
    angle: f64,
    /// Along the edge, m.
    height: f64,
}

impl Wedge {
    /// The wedge of an edge that starts at `origin` and runs `along` it, with faces towards `faces`, directions at right
    /// angles to the edge that may be the same; `None` where `source` is between the faces, or on the edge.
    pub(super) fn new(origin: DVec3, along: DVec3, faces: [DVec3; 2], source: DVec3) -> Option<Self> {
        let [first, second] = faces;
        let normal = along.cross(first);
        let out = if normal.dot(second) > 0.0 { -normal } else { normal };
        let angle = TAU - first.dot(second).clamp(-1.0, 1.0).acos();
        let unknown = Cylindrical { radius: 0.0, angle: 0.0, height: 0.0 };
        let mut wedge = Self { origin, along, axes: [first, out], angle, source: unknown };
        wedge.source = wedge.outside(source)?;
        Some(wedge)
    }

    /// The same elsewhere, by so many m, before a `source` that stays; one that comes to be between the faces is where it was.
    pub(in crate::reflectors) fn displaced(&self, by: DVec3, source: DVec3) -> Self {
        let moved = Self { origin: self.origin + by, ..self.clone() };
        let source = moved.outside(source).unwrap_or(self.source);
        Self { source, ..moved }
    }

    /// The coordinates of a point outside of the wedge and off its edge.
    fn outside(&self, p: DVec3) -> Option<Cylindrical> {
        let from = p - self.origin;
        let [x, y] = self.axes.map(|axis| axis.dot(from));
        let at = Cylindrical {
            radius: x.hypot(y),
            angle: y.atan2(x).rem_euclid(TAU),
            height: self.along.dot(from),
        };
        (at.radius > NEAREST && at.angle <= self.angle).then_some(at)
    }

    /// Out of the wedge, in the middle between its faces.
    pub(super) fn outward(&self) -> DVec3 {
        let (sin, cos) = (0.5 * self.angle).sin_cos();
        self.axes[0] * cos + self.axes[1] * sin
    }

    /// The factor −νβ/4π of the echo at `r` of the piece of the edge between two heights, m; 0 inside the wedge.
    ///
    /// β = Σ sin νφ / (cosh νη − cos νφ) over the four φ = π ± θ_s ± θ_r, with ν = π over the wedge's angle, and η by
    /// sinh⁻¹((z − z_s)/r_s) + sinh⁻¹((z − z_r)/r_r), which is 0 where the shortest path touches the edge. It is the mean over
    /// the η of the piece, by the integral `∫ sin φ/(cosh η − cos φ) dη = 2 tan⁻¹(tanh(η/2) cot(φ/2))`: near the borders of
    /// shadow and reflection β is a peak much narrower than any piece.
    pub(in crate::reflectors) fn directivity(&self, heights: [f64; 2], r: DVec3) -> f64 {
        let Some(receiver) = self.outside(r) else { return 0.0 };
        let (nu, source) = (PI / self.angle, &self.source);
        let asinh = |z: f64, end: &Cylindrical| ((z - end.height) / end.radius).asinh();
        let [from, to] = heights.map(|z| nu * (asinh(z, source) + asinh(z, &receiver)));
        let [low, high] = [from, to].map(|eta| (0.5 * eta).tanh());
        let integral: f64 = [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]]
            .iter()
            .map(|[a, b]| {
                let (sin, cos) = (0.5 * nu * (PI + a * source.angle + b * receiver.angle)).sin_cos();
                // The difference of two arcs.
                2.0 * (sin * cos * (high - low)).atan2(sin * sin + cos * cos * low * high)
            })
            .sum();
        -nu / (4.0 * PI) * integral / (to - from)
    }
}
