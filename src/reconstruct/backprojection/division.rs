//! How the voxels of a job are divided into slabs, and these into blocks.

use super::blocks::{Shape, greatest_half};
use super::profile::Band;
use crate::acquisition::Instrument;
use crate::reconstruct::compress::{slab_operations, slab_tones};
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::GridPlaces;
use crate::wave::interval::PathInterval;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// The most slabs that depths are dealt out to; each has a decomposition of its own.
pub(super) const MOST_SLABS: usize = 32;

/// Fewer slabs that are tried, and the most samples of one.
const FEWER_SLABS: [usize; 5] = [1, 2, 4, 8, 16];
const MOST_SAMPLES: usize = 1 << 21;

/// Microphones that stand for all where shapes are priced.
const MICROPHONES: usize = 12;

/// Operations of the series of a slab's tones on the half-widths that are used, per tone.
const SERIES: f64 = 4e5;

/// Operations for placing a voxel and putting it in order, whatever it is the sum of.
const PLACING: f64 = 1800.0;

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
    pub(super) fn new(instrument: &Instrument, points: &GridPlaces, budget: ErrorBudget) -> Self {
        let grid = points.grid();
        let band = Band {
            carrier: instrument.sweep.centre(),
            bandwidth: instrument.sweep.bandwidth(),
            sound_speed: instrument.sound_speed,
            tolerance: budget.series(),
        };
        let places = instrument.array.positions();
        let step = places.len().div_ceil(MICROPHONES);
        let sample: Vec<DVec3> = places.iter().copied().skip(step / 2).step_by(step).collect();
        let voxels = grid.voxel_count() as f64;
        let (terms, placing) = (voxels * places.len() as f64, voxels * PLACING);
        let whole = instrument.path_interval_within(points.bounds(0..grid.z.count));
        let of_volume = band.bandwidth * whole.duration();
        let of = |shape: Shape, slabs: usize| {
            let depths = shape.0[2];
            let thickness = depths * grid.z.count.div_ceil(slabs).div_ceil(depths);
            if slabs < MOST_SLABS && thickness * grid.plane_len() > MOST_SAMPLES {
                return None;
            }
            let last = thickness.min(grid.z.count);
            let interval = interval(instrument, points, shape, grid.z.count - last..grid.z.count);
            let spread = band.bandwidth * interval.duration();
            let tones = slab_tones(spread, instrument);
            let cost = shape.operations(points, &instrument.geometry, &sample, &band, tones)?;
            let found =
                grid.z.count.div_ceil(thickness) as f64 * tone_operations([spread, of_volume], instrument);
            Some(Self { band, shape, thickness, operations: terms * cost + found + placing })
        };
        let fewest = |a: &Self, b: &Self| a.operations.total_cmp(&b.operations);
        let shapes: Vec<Shape> = Shape::candidates(grid).collect();
        let priced: Vec<Self> = shapes.into_par_iter().filter_map(|shape| of(shape, MOST_SLABS)).collect();
        let best = priced.into_iter().min_by(fewest);
        // Where microphones are few, decompositions of many slabs take longer than they save.
        let slabs =
            |best: Self| FEWER_SLABS.into_iter().filter_map(move |slabs| of(best.shape, slabs)).chain([best]);
        let one = Self { band, shape: Shape([1; 3]), thickness: grid.z.count, operations: f64::INFINITY };
        best.and_then(|best| slabs(best).min_by(fewest)).unwrap_or(one)
    }
}

/// Operations of a slab's tones and of their series, whatever is summed from them, for the B·T of the slab and of the volume.
pub(super) fn tone_operations(spreads: [f64; 2], instrument: &Instrument) -> f64 {
    slab_operations(spreads, instrument) + slab_tones(spreads[0], instrument) * SERIES
}

/// All delays at which profiles of these depths are expanded: the path lengths, and a half-width to both sides.
pub(super) fn interval(
    instrument: &Instrument,
    points: &GridPlaces,
    shape: Shape,
    depths: Range<usize>,
) -> PathInterval {
    let paths = instrument.path_interval_within(points.bounds(depths));
    let margin = greatest_half(shape.half(points.grid()));
    PathInterval { shortest: paths.shortest - margin, longest: paths.longest + margin, ..paths }
}
