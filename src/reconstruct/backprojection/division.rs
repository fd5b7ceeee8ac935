//! How the voxels of a job are divided into slabs, and these into blocks.

use super::blocks::{Shape, greatest_half};
use super::profile::Band;
use crate::acquisition::Instrument;
use crate::grid::Grid;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::wave::interval::PathInterval;
use glam::DVec3;
use std::ops::Range;

/// The most slabs that depths are dealt out to; each has a decomposition of its own.
pub(super) const MOST_SLABS: usize = 32;

/// How the points of one grid are divided.
#[derive(Debug, Clone, Copy)]
pub(super) struct Division {
    pub(super) band: Band,
    pub(super) shape: Shape,
    /// Depths per slab, a multiple of the blocks'.
    pub(super) thickness: usize,
    pub(super) operations: f64,
}

impl Division {
    /// The division of fewest operations.
    pub(super) fn new(instrument: &Instrument, grid: &Grid, budget: ErrorBudget) -> Self {
        let band = Band {
            carrier: instrument.sweep.centre(),
            bandwidth: instrument.sweep.bandwidth(),
            sound_speed: instrument.sound_speed,
            tolerance: budget.series(),
        };
        let places = instrument.array.positions();
        let step = places.len().div_ceil(24);
        let sample: Vec<DVec3> = places.iter().copied().skip(step / 2).step_by(step).collect();
        let thickness = |shape: Shape| -> usize {
            let depths = shape.0[2];
            depths * grid.z.count.div_ceil(MOST_SLABS).div_ceil(depths)
        };
        let cost = |shape: Shape| {
            let last = thickness(shape).min(grid.z.count);
            let interval = interval(instrument, grid, shape, grid.z.count - last..grid.z.count);
            let tones = (band.bandwidth * interval.duration() + 10.0).min(instrument.sweep.len() as f64);
            shape.operations(grid, &instrument.geometry, &sample, &band, tones).map(|cost| (shape, cost))
        };
        let (shape, cost) = Shape::candidates(grid)
            .filter_map(cost)
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((Shape([1; 3]), f64::INFINITY));
        let terms = grid.voxel_count() as f64 * places.len() as f64;
        let thickness = thickness(shape);
        Self { band, shape, thickness, operations: terms * cost }
    }
}

/// All delays at which profiles of these depths are expanded: the path lengths, and a half-width to both sides.
pub(super) fn interval(
    instrument: &Instrument,
    grid: &Grid,
    shape: Shape,
    depths: Range<usize>,
) -> PathInterval {
    let paths = instrument.path_interval(grid, depths);
    let margin = greatest_half(shape.half(grid));
    PathInterval { shortest: paths.shortest - margin, longest: paths.longest + margin, ..paths }
}
