//! The brightest voxels of a region, which the channels are fitted to.

use crate::acquisition::DataCube;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::progress::Observer;
use crate::reconstruct::{ReconstructOptions, reconstruct_with};
use glam::DVec3;
use num_complex::Complex32;

/// Most voxels, and the largest share of the region's.
const MOST: usize = 2000;
const SHARE: f64 = 0.02;

/// Most values of channels at voxels that are in memory.
const MOST_VALUES: usize = 1 << 26;

/// Bright voxels of a region.
#[derive(Debug, Clone)]
pub(super) struct Bright {
    /// Their places, m, in the order of the grid.
    pub(super) places: Vec<DVec3>,
    /// Resolution cells that they fill in effect: `(Σ I)² / Σ I²` of their powers, times a voxel's share of a cell.
    pub(super) cells: f64,
    /// `N Σ I² / (Σ I)²` of the whole region.
    pub(super) sharpness: f64,
}

impl Bright {
    /// Images the microphones that are kept, and chooses as many voxels as values of all channels at them fit in memory.
    pub(super) fn choose(
        cube: &DataCube,
        kept: &[usize],
        channels: usize,
        grid: &Grid,
        options: &ReconstructOptions,
        observer: &dyn Observer,
    ) -> Result<Self> {
        let volume = reconstruct_with(&part(cube, kept)?, grid, options, observer)?.volume;
        let power: Vec<f64> = volume.samples.iter().map(|a| f64::from(a.norm_sqr())).collect();
        let count = ((SHARE * power.len() as f64).ceil() as usize)
            .clamp(1, MOST.min((MOST_VALUES / channels).max(1)));
        let mut order: Vec<usize> = (0..power.len()).collect();
        // Of equals the first, so that the choice is the same on every machine.
        order.sort_by(|a, b| power[*b].total_cmp(&power[*a]).then(a.cmp(b)));
        order.truncate(count);
        order.sort_unstable();
        let sums = |powers: &mut dyn Iterator<Item = f64>| {
            powers.fold([0.0, 0.0], |[sum, squares], power| [sum + power, squares + power * power])
        };
        let [bright, squares] = sums(&mut order.iter().map(|i| power[*i]));
        let [all, all_squares] = sums(&mut power.iter().copied());
        if bright <= 0.0 {
            return Err(Error::input(
                "[grid]",
                "is silent: no echo is in it that channels could be fitted to",
            ));
        }
        let place = |i: &usize| {
            let row = i / grid.x.count;
            grid.position(i % grid.x.count, row % grid.y.count, row / grid.y.count)
        };
        Ok(Self {
            places: order.iter().map(place).collect(),
            cells: bright * bright / squares * share_of_cell(cube, grid),
            sharpness: power.len() as f64 * all_squares / (all * all),
        })
    }
}

/// The share of a resolution cell that a voxel is: 1 for larger voxels.
fn share_of_cell(cube: &DataCube, grid: &Grid) -> f64 {
    let (instrument, z) = (&cube.instrument, f64::midpoint(grid.z.first, grid.z.last()));
    let [x, y] = instrument.lateral_resolution(z);
    let cells = [(grid.x.pitch, x), (grid.y.pitch, y), (grid.z.pitch, instrument.range_resolution())];
    cells.into_iter().map(|(pitch, cell)| cell.map_or(1.0, |cell| (pitch / cell).min(1.0))).product()
}

/// The cube with silence in the microphones that are not kept: they stay where they are, so that a lattice remains one.
fn part(cube: &DataCube, kept: &[usize]) -> Result<DataCube> {
    let mut is_kept = vec![false; cube.instrument.array.len()];
    for r in kept {
        is_kept[*r] = true;
    }
    let of = |(i, m): (usize, &Complex32)| if is_kept[i % is_kept.len()] { *m } else { Complex32::ZERO };
    DataCube::new(cube.instrument.clone(), cube.samples.iter().enumerate().map(of).collect())
}
