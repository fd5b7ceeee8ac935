//! Power that a stronger neighbour explains.

use super::power::Power;
use super::{DepthOptions, visited};
use glam::DVec3;

/// σ of the main lobe across, in lateral resolutions.
const LOBE: f64 = 0.44;

/// Half-width of the depths at which a neighbour counts, in Δd.
const SAME_DEPTH: f64 = 0.75;

/// How far across a neighbour counts, in lateral resolutions: beyond the first sidelobes.
const REACH: f64 = 3.0;

/// Share of a neighbour's main lobe, smoothed, that a peak must exceed.
const MAIN: f64 = 0.6;

/// Whether a stronger neighbour at the same depth explains the power of a voxel through the lateral point spread: a main lobe
/// as wide as the smoothing makes it, or `sidelobes`, a share of its power.
pub(super) fn leaked(power: &Power, here: DVec3, own: f32, sidelobes: f64, options: &DepthOptions) -> bool {
    explained(power, here, own, 0.0, |lobe| (MAIN * lobe).max(sidelobes), options)
}

/// The same for a neighbour at least `apart` lateral resolutions away, by the `share` of its power that may be seen here, given
/// the main lobe, 1 to 0.
pub(super) fn explained(
    power: &Power,
    here: DVec3,
    own: f32,
    apart: f64,
    share: impl Fn(f64) -> f64,
    options: &DepthOptions,
) -> bool {
    let grid = &power.grid;
    let cell = options.lateral_resolution(here.z, grid);
    let spread = [0, 1].map(|k: usize| LOBE.hypot(options.smoothing[k]));
    let index = (((here.z - grid.z.first) / grid.z.pitch).round().max(0.0) as usize).min(grid.z.count - 1);
    let half = ((SAME_DEPTH * options.resolution.range / grid.z.pitch).round() as usize).min(grid.z.count);
    let depths = index.saturating_sub(half)..(index + half + 1).min(grid.z.count);
    let columns = visited(&grid.x, here.x, REACH * cell[0], cell[0]);
    visited(&grid.y, here.y, REACH * cell[1], cell[1]).any(|iy| {
        columns.clone().any(|ix| {
            let (u, v) = ((grid.x.position(ix) - here.x) / cell[0], (grid.y.position(iy) - here.y) / cell[1]);
            let lobe = (-0.5 * ((u / spread[0]).powi(2) + (v / spread[1]).powi(2))).exp();
            let least = f64::from(own) / share(lobe);
            u.hypot(v) >= apart
                && power.column(iy * grid.x.count + ix)[depths.clone()].iter().any(|p| f64::from(*p) > least)
        })
    })
}
