//! The terms that a job can have, sampled, and how the tiles of an array see a grid.

use super::frame::{Frame, some};
use crate::acquisition::{Instrument, Tile};
use crate::grid::{Axis, Grid};
use crate::reconstruct::numerics::Around;
use crate::wave::interval::greater;
use glam::DVec3;
use num_complex::Complex64;
use std::f64::consts::TAU;

/// Terms of one frequency and one microphone each, in the coordinates of its tile.
pub(crate) struct Terms<'a> {
    pub(crate) instrument: &'a Instrument,
    pub(crate) grid: &'a Grid,
    pub(crate) tiles: &'a [Tile],
}

/// How many samples are taken of what terms depend on.
pub(crate) struct Density {
    tiles: usize,
    /// Along the axis that is tried, and along the others.
    places: [usize; 2],
    /// Every so many corners of a tile.
    corners: usize,
}

/// What pitches are chosen by.
pub(crate) const FEW: Density = Density { tiles: 2, places: [9, 2], corners: 3 };

/// What errors are measured at.
pub(crate) const MANY: Density = Density { tiles: 5, places: [12, 4], corners: 1 };

impl Terms<'_> {
    /// The largest error of voxels made of nodes along one axis (x, y, ρ) for any sampled term, and the largest sum of
    /// the weights' moduli; `None` where no point has a node's range.
    pub(crate) fn error(
        &self,
        axis: usize,
        around: &dyn Fn(f64) -> Around,
        density: &Density,
    ) -> Option<[f64; 2]> {
        let Self { instrument, grid, tiles } = self;
        let carrier = instrument.sweep.centre();
        let frequencies = instrument.sweep.frequencies();
        let frequencies = [frequencies[0], frequencies[frequencies.len() - 1]];
        let (mut worst, mut moduli) = (0.0f64, 1.0f64);
        for tile in some(tiles, density.tiles) {
            let frame = Frame::new(&instrument.geometry, tile.centre);
            let [along, across] = density.places;
            for mut p in grid.sampled(std::array::from_fn(|of| if of == axis { along } else { across })) {
                if axis < 2 {
                    let voxels = [grid.x, grid.y][axis];
                    p[axis] = voxels.position(((p[axis] - voxels.first) / voxels.pitch).round() as usize);
                }
                let range = frame.range(p);
                let (places, weights) = around(if axis < 2 { p[axis] } else { range });
                if weights.len() == 1 {
                    continue;
                }
                let node = |place: &f64| match axis {
                    0 => frame.point(*place, p.y, range).map(|q| (q, range)),
                    1 => frame.point(p.x, *place, range).map(|q| (q, range)),
                    _ => frame.point(p.x, p.y, *place).map(|q| (q, *place)),
                };
                let nodes: Vec<(DVec3, f64)> = places.iter().map(node).collect::<Option<_>>()?;
                moduli = moduli.max(weights.iter().map(|w| w.abs()).sum());
                for r in tile.corners().into_iter().step_by(density.corners) {
                    for f in frequencies {
                        let term = |(q, range): &(DVec3, f64)| {
                            let turns = f * instrument.geometry.path_length(*q, r) - carrier * range;
                            Complex64::cis(-TAU / instrument.sound_speed * turns)
                        };
                        let sum: Complex64 = weights.iter().zip(&nodes).map(|(w, node)| term(node) * w).sum();
                        worst = greater(worst, (sum - term(&(p, range))).norm());
                    }
                }
            }
        }
        Some([worst, moduli])
    }
}

/// How tiles see the grid.
pub(crate) struct TileDistances {
    frames: Vec<Frame>,
    pub(crate) tiles: usize,
    /// Of the widest tile, m.
    pub(crate) radius: f64,
    /// The least range of a voxel, and that of the middle one, m.
    pub(crate) shortest: f64,
    pub(crate) typical: f64,
}

impl TileDistances {
    pub(crate) fn of(instrument: &Instrument, grid: &Grid, tiles: &[Tile]) -> Self {
        let frames: Vec<Frame> =
            some(tiles, 3).map(|tile| Frame::new(&instrument.geometry, tile.centre)).collect();
        let (low, high) = instrument.array.bounds();
        let (first, last) = grid.bounds();
        let [shortest, _] = instrument.geometry.path_bounds((first, last), (low, high));
        Self {
            tiles: tiles.len(),
            radius: tiles.iter().map(|tile| tile.radius).fold(0.0, f64::max),
            shortest,
            typical: instrument.geometry.path_length(first.midpoint(last), low.midpoint(high)),
            frames,
        }
    }

    /// The mean length of the ranges that a column of nodes needs when voxels so far beside it are made of it, m.
    pub(crate) fn ranges(&self, grid: &Grid, reach: [f64; 2]) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        let layer = Grid { z: Axis { count: 1, ..grid.z }, ..*grid };
        for frame in &self.frames {
            for p in layer.sampled([4, 4, 1]) {
                let (mut low, mut high) = (f64::INFINITY, 0.0f64);
                for i in 0..9 {
                    let beside = |axis: usize, step: usize| {
                        let along = [grid.x, grid.y][axis];
                        (p[axis] + reach[axis] * (step as f64 - 1.0)).clamp(along.first, along.last())
                    };
                    let (x, y) = (beside(0, i % 3), beside(1, i / 3));
                    low = low.min(frame.range(DVec3::new(x, y, grid.z.first)));
                    high = high.max(frame.range(DVec3::new(x, y, grid.z.last())));
                }
                sum += high - low;
                count += 1.0;
            }
        }
        sum / count
    }
}
