//! The ring around silhouettes within which a detection next to a surface is not scored.

use super::depths;
use crate::grid::{DepthLayer, DepthMap, View};

/// Width of the guard ring around silhouettes, m.
pub const GUARD_RING: f64 = 0.04;

/// Finds the pixels whose centre is within the guard ring of a pixel with a true surface.
pub(super) struct GuardRing<'a> {
    truth: &'a DepthMap,
    /// Depth of each pixel's first true surface, m; infinite where there is none.
    nearest: Vec<f64>,
    reach: [isize; 2],
}

impl<'a> GuardRing<'a> {
    pub(super) fn new(truth: &'a DepthMap, surfaces: &[DepthLayer]) -> Self {
        let first = |pixel| depths(surfaces, pixel).next().map_or(f64::INFINITY, |(_, z)| z);
        let nearest: Vec<f64> = (0..truth.len()).map(first).collect();
        let closest = nearest.iter().copied().fold(f64::INFINITY, f64::min);
        let reach = [&truth.x, &truth.y].map(|axis| {
            let metres = axis.pitch * metres_per_unit(truth.view, closest);
            ((GUARD_RING / metres + 1e-6).floor() as isize).min(axis.count as isize)
        });
        Self { truth, nearest, reach }
    }

    pub(super) fn holds(&self, pixel: usize) -> bool {
        let (n_x, n_y) = (self.truth.x.count, self.truth.y.count);
        let (x, y) = ((pixel % n_x) as isize, (pixel / n_x) as isize);
        (-self.reach[1]..=self.reach[1]).any(|dy| {
            (-self.reach[0]..=self.reach[0]).any(|dx| {
                let (i, j) = (x + dx, y + dy);
                if i < 0 || j < 0 || i >= n_x as isize || j >= n_y as isize {
                    return false;
                }
                let z = self.nearest[j as usize * n_x + i as usize];
                let distance = (dx as f64 * self.truth.x.pitch).hypot(dy as f64 * self.truth.y.pitch);
                z.is_finite() && distance * metres_per_unit(self.truth.view, z) <= GUARD_RING
            })
        })
    }
}

/// The length of one unit of a map's axes at depth `z`, m.
fn metres_per_unit(view: View, z: f64) -> f64 {
    match view {
        View::Orthographic => 1.0,
        View::Perspective => z,
    }
}
