//! Points of a block about its centre, as back-projection's kernels take them.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

use super::{LANES, dispatched};
use crate::wave::Geometry;

/// Points that are processed at a time: four vectors of 16, so that chains of dependent operations overlap.
pub(super) const WIDE: usize = 4 * LANES;

/// Points of a block about its centre, in m, padded to whole lanes.
#[derive(Debug, Clone, Default)]
pub(crate) struct Points {
    pub(super) x: Vec<f32>,
    pub(super) y: Vec<f32>,
    pub(super) z: Vec<f32>,
    /// `x² + y² + z²`, times the number of return legs.
    pub(super) square: Vec<f32>,
    /// Length of the outward path to the point minus that of the path to the centre.
    pub(super) outward: Vec<f32>,
    /// Maximum distance of a point from the centre.
    pub(super) radius: f32,
    /// How many there are, without padding.
    pub(super) count: usize,
}

impl Points {
    /// Points at `places` along x, y and z, all of one length, m, about a centre.
    pub(crate) fn about(centre: [f64; 3], geometry: &Geometry, places: [&[f64]; 3]) -> Self {
        let source = match geometry {
            Geometry::FixedSource { source } => Some(source.to_array()),
            Geometry::Monostatic | Geometry::Pair { .. } => None,
        };
        let legs = geometry.return_legs();
        let count = places[0].len();
        let padded = count.next_multiple_of(WIDE);
        let zeros = || vec![0.0f32; padded];
        let [x, y, z, square, outward] = [(); 5].map(|()| zeros());
        let mut points = Self { x, y, z, square, outward, radius: 0.0, count };
        about(&mut points, centre, source, legs, places);
        let farthest = points.square[..count].iter().fold(0.0, |a: f32, b| a.max(*b));
        points.radius = (farthest / legs as f32).sqrt();
        points
    }

    /// Maximum distance of a point from the centre, m.
    pub(crate) fn radius(&self) -> f32 {
        self.radius
    }

    /// Number of points, including padding; their sums have this length.
    pub(crate) fn padded_len(&self) -> usize {
        self.x.len()
    }

    /// The number of points to which `count` are padded.
    pub(crate) fn padded(count: usize) -> usize {
        count.next_multiple_of(WIDE)
    }
}

#[inline(always)]
fn about_body(
    points: &mut Points,
    centre: [f64; 3],
    source: Option<[f64; 3]>,
    legs: f64,
    [x, y, z]: [&[f64]; 3],
) {
    let count = x.len();
    let offsets = [&mut points.x[..count], &mut points.y[..count], &mut points.z[..count]];
    let (square, outward) = (&mut points.square[..count], &mut points.outward[..count]);
    let [to_x, to_y, to_z] = offsets;
    for i in 0..count {
        let d = [x[i] - centre[0], y[i] - centre[1], z[i] - centre[2]];
        (to_x[i], to_y[i], to_z[i]) = (d[0] as f32, d[1] as f32, d[2] as f32);
        square[i] = (legs * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2])) as f32;
    }
    if let Some(source) = source {
        let length = |p: [f64; 3]| {
            let d = [p[0] - source[0], p[1] - source[1], p[2] - source[2]];
            (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
        };
        let own = length(centre);
        for i in 0..count {
            outward[i] = (length([x[i], y[i], z[i]]) - own) as f32;
        }
    }
}

dispatched! {
    /// Fills [`Points::about`] but for the radius.
    fn about = about_body(
        points: &mut Points, centre: [f64; 3], source: Option<[f64; 3]>, legs: f64, places: [&[f64]; 3],
    )
}
