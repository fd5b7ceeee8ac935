//! The path by way of a point between two foci: loudspeaker and microphone, or twice the microphone of a scan.

#![allow(clippy::inline_always)]

use super::Geometry;
use super::simd::dispatched;
use glam::DVec3;

/// `|p − a| + |p − b|`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TwoLegs {
    /// a and b; b is the microphone's place.
    pub(crate) foci: [DVec3; 2],
}

impl TwoLegs {
    /// Those of a microphone's paths.
    pub(crate) fn new(geometry: &Geometry, microphone: DVec3) -> Self {
        Self { foci: [geometry.source_of(microphone), microphone] }
    }

    /// The path length by way of `p`, m.
    pub(crate) fn length(&self, p: DVec3) -> f64 {
        p.distance(self.foci[0]) + p.distance(self.foci[1])
    }

    /// How fast it changes with `p`.
    pub(crate) fn slope(&self, p: DVec3) -> DVec3 {
        self.foci.iter().map(|focus| (p - focus).normalize_or_zero()).sum()
    }

    /// The path lengths by way of points `pitch` m apart along x, from `first` on. Cost: some 10 operations each.
    pub(crate) fn row(&self, first: DVec3, pitch: f64, lengths: &mut [f64]) {
        row_lengths(self.foci.map(|focus| focus.to_array()), first.to_array(), pitch, lengths);
    }

    /// The path lengths by way of points of a line through `p` along x (0), y (1) or z (2). Cost: some 10 operations each.
    pub(crate) fn along(&self, axis: usize, p: DVec3, places: &[f64], lengths: &mut [f64]) {
        let [one, other] = [(axis + 1) % 3, (axis + 2) % 3];
        let across = |focus: DVec3| (p[one] - focus[one]).powi(2) + (p[other] - focus[other]).powi(2);
        line_lengths(self.foci.map(|focus| [across(focus), focus[axis]]), places, lengths);
    }

    /// The shortest path by way of a point above one place (x, y), at whatever depth, m.
    pub(crate) fn shortest(&self, [x, y]: [f64; 2]) -> f64 {
        let [a, b] = self.foci;
        let across = (x - a.x).hypot(y - a.y) + (x - b.x).hypot(y - b.y);
        // As by way of a mirror on that line.
        across.hypot(a.z - b.z)
    }
}

#[inline(always)]
fn row_lengths_body([a, b]: [[f64; 3]; 2], [first, y, z]: [f64; 3], pitch: f64, lengths: &mut [f64]) {
    let across = |focus: [f64; 3]| [(y - focus[1]) * (y - focus[1]), (z - focus[2]) * (z - focus[2])];
    let (across_a, across_b) = (across(a), across(b));
    for (i, length) in lengths.iter_mut().enumerate() {
        // i is far below 2³², and such integers become numbers in vector registers.
        let x = first + f64::from(i as u32) * pitch;
        let leg = |focus: f64, [y, z]: [f64; 2]| ((x - focus) * (x - focus) + y + z).sqrt();
        *length = leg(a[0], across_a) + leg(b[0], across_b);
    }
}

dispatched! {
    fn row_lengths = row_lengths_body(foci: [[f64; 3]; 2], first: [f64; 3], pitch: f64, lengths: &mut [f64])
}

#[inline(always)]
fn line_lengths_body([a, b]: [[f64; 2]; 2], places: &[f64], lengths: &mut [f64]) {
    for (length, at) in lengths.iter_mut().zip(places) {
        let leg = |[across, focus]: [f64; 2]| (across + (at - focus) * (at - focus)).sqrt();
        *length = leg(a) + leg(b);
    }
}

dispatched! {
    /// Foci as squared distance from the line, and place along it.
    fn line_lengths = line_lengths_body(foci: [[f64; 2]; 2], places: &[f64], lengths: &mut [f64])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_has_the_lengths_of_its_points() {
        let microphone = DVec3::new(0.3, -0.2, 0.01);
        for geometry in [
            Geometry::ORIGIN,
            Geometry::FixedSource { source: DVec3::new(-0.1, 0.4, -0.2) },
            Geometry::Monostatic,
            Geometry::Pair { offset: DVec3::new(0.1, 0.0, 0.2) },
        ] {
            let (legs, first) = (TwoLegs::new(&geometry, microphone), DVec3::new(-0.7, 0.11, 1.3));
            let mut lengths = [0.0; 53];
            legs.row(first, 0.0123, &mut lengths);
            for (i, length) in lengths.into_iter().enumerate() {
                let p = first + i as f64 * 0.0123 * DVec3::X;
                assert_eq!(legs.length(p), geometry.path_length(p, microphone));
                assert!((length - legs.length(p)).abs() < 1e-15, "{i}");
                let slope = (legs.length(p + 1e-6 * DVec3::Y) - length) / 1e-6;
                assert!((slope - legs.slope(p).y).abs() < 1e-5);
            }
            let places: Vec<f64> = (0..53).map(|i| first.x + f64::from(i) * 0.0123).collect();
            let mut line = [0.0; 53];
            legs.along(0, first, &places, &mut line);
            assert!(line.iter().zip(lengths).all(|(a, b)| (a - b).abs() < 1e-15));
            let depths: Vec<f64> = (0..23).map(|k| 0.1 * f64::from(k) - 0.7).collect();
            let mut lengths = [0.0; 23];
            legs.along(2, DVec3::new(0.2, -0.9, 7.0), &depths, &mut lengths);
            let shortest = legs.shortest([0.2, -0.9]);
            for (z, length) in depths.iter().zip(lengths) {
                assert!((length - legs.length(DVec3::new(0.2, -0.9, *z))).abs() < 1e-15);
                assert!(length >= shortest);
            }
            let at = |k: i32| DVec3::new(0.2, -0.9, f64::from(k) * 1e-4);
            let least = (-3000..3000).map(|k| legs.length(at(k))).fold(f64::INFINITY, f64::min);
            assert!((least - shortest).abs() < 1e-7, "{least} and {shortest}");
        }
    }
}
