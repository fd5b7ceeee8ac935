//! The power of a volume, column by column.

use super::DepthOptions;
use crate::alloc::{try_with_capacity, try_zeroed};
use crate::error::Result;
use crate::grid::{Grid, VolumeView, no_room_for};
use rayon::prelude::*;
use std::mem;

/// Pixels whose columns are read together: a line of the cache for each depth.
const TOGETHER: usize = 16;

/// `|Â|²` on a grid, `[y, x, z]`: the depths of a pixel are neighbours.
#[derive(Debug)]
pub(super) struct Power {
    pub(super) grid: Grid,
    pub(super) values: Vec<f32>,
}

impl Power {
    /// That of a volume.
    ///
    /// # Errors
    /// When it does not fit in memory.
    pub(super) fn of(volume: VolumeView<'_>) -> Result<Self> {
        let (grid, plane) = (volume.grid, volume.grid.plane_len());
        let depths = grid.z.count;
        let mut values = try_zeroed::<f32>(grid.voxel_count()).ok_or_else(|| no_room_for(&grid))?;
        values.par_chunks_mut(TOGETHER * depths).enumerate().for_each(|(chunk, columns)| {
            let first = chunk * TOGETHER;
            let pixels = columns.len() / depths;
            for (iz, slice) in volume.samples.chunks_exact(plane).enumerate() {
                for (pixel, sample) in slice[first..first + pixels].iter().enumerate() {
                    columns[pixel * depths + iz] = sample.norm_sqr();
                }
            }
        });
        Ok(Self { grid, values })
    }

    /// A copy of it.
    ///
    /// # Errors
    /// When it does not fit in memory.
    pub(super) fn copied(&self) -> Result<Self> {
        let mut values = try_with_capacity(self.grid.voxel_count()).ok_or_else(|| no_room_for(&self.grid))?;
        values.extend_from_slice(&self.values);
        Ok(Self { grid: self.grid, values })
    }

    /// The powers at the depths of column `pixel`, front to back.
    pub(super) fn column(&self, pixel: usize) -> &[f32] {
        let depths = self.grid.z.count;
        &self.values[pixel * depths..][..depths]
    }

    /// Smoothed as returns are found in.
    ///
    /// # Errors
    /// When a copy does not fit in memory.
    pub(super) fn smoothed_for(self, options: &DepthOptions) -> Result<Self> {
        let [x, y, z] = options.smoothing;
        let depth = z * options.resolution.range / self.grid.z.pitch;
        self.smoothed_across([x, y], depth, options)
    }

    /// Smoothed with σ in lateral resolutions along x and y, and in voxels along z.
    ///
    /// # Errors
    /// When a copy does not fit in memory.
    pub(super) fn smoothed_across(
        self,
        across: [f64; 2],
        depth: f64,
        options: &DepthOptions,
    ) -> Result<Self> {
        let grid = self.grid;
        self.smoothed(
            |iz| {
                let cell = options.lateral_resolution(grid.z.position(iz), &grid);
                [across[0] * cell[0] / grid.x.pitch, across[1] * cell[1] / grid.y.pitch]
            },
            depth,
        )
    }

    /// Gaussian smoothing with σ in voxels: along x and y by depth, and along z. The kernel ends at 4σ and is
    /// renormalised at the edges.
    ///
    /// # Errors
    /// When a copy does not fit in memory.
    pub(super) fn smoothed(self, lateral: impl Fn(usize) -> [f64; 2], depth: f64) -> Result<Self> {
        let Self { grid, mut values } = self;
        let no_room = || no_room_for(&grid);
        let by_depth: Vec<[f64; 2]> = (0..grid.z.count).map(lateral).collect();
        let mut scratch = Vec::new();
        for (axis, count, stride) in [(0, grid.x.count, 1), (1, grid.y.count, grid.x.count)] {
            let sigmas: Vec<f64> = by_depth.iter().map(|sigma| sigma[axis]).collect();
            let Some(kernel) = Kernel::of(&sigmas, count) else { continue };
            if scratch.is_empty() {
                scratch = try_zeroed(grid.voxel_count()).ok_or_else(no_room)?;
            }
            kernel.across(&values, &mut scratch, count, stride);
            mem::swap(&mut values, &mut scratch);
        }
        if let Some(kernel) = Kernel::of(&[depth], grid.z.count) {
            let sums = kernel.sums(grid.z.count);
            values
                .par_chunks_mut(grid.z.count)
                .for_each_init(Vec::new, |copy, column| kernel.along(column, copy, &sums));
        }
        Ok(Self { grid, values })
    }
}

/// Weights of a Gaussian at each distance, for one σ or one σ per depth.
struct Kernel {
    /// `[distance, depth]`.
    weights: Vec<f32>,
    depths: usize,
}

impl Kernel {
    /// `None` where nothing would be smoothed.
    fn of(sigmas: &[f64], count: usize) -> Option<Self> {
        let most = sigmas.iter().copied().fold(0.0, f64::max);
        let reach = (4.0 * most).ceil().min((count - 1) as f64) as usize;
        if most < 0.05 || reach == 0 {
            return None;
        }
        let weight = |k: usize, sigma: f64| {
            if k == 0 {
                1.0
            } else if k as f64 > (4.0 * sigma).ceil() {
                0.0
            } else {
                (-0.5 * (k as f64 / sigma).powi(2)).exp() as f32
            }
        };
        let weights = (0..=reach).flat_map(|k| sigmas.iter().map(move |sigma| weight(k, *sigma))).collect();
        Some(Self { weights, depths: sigmas.len() })
    }

    /// Smooths along x or y, whose neighbouring columns are `stride` apart.
    fn across(&self, values: &[f32], smoothed: &mut [f32], count: usize, stride: usize) {
        let depths = self.depths;
        let column = |i: usize| &values[i * depths..][..depths];
        smoothed.par_chunks_mut(depths).enumerate().for_each_init(
            || vec![0.0f32; depths],
            |sums, (i, out)| {
                let place = i / stride % count;
                out.copy_from_slice(column(i));
                sums.fill(1.0);
                for (k, weights) in self.weights.chunks_exact(depths).enumerate().skip(1) {
                    let (before, after) = (k <= place, place + k < count);
                    let sides = [before.then(|| i - k * stride), after.then(|| i + k * stride)];
                    for neighbour in sides.into_iter().flatten() {
                        for (((out, sum), value), weight) in
                            out.iter_mut().zip(sums.iter_mut()).zip(column(neighbour)).zip(weights)
                        {
                            *out += weight * value;
                            *sum += weight;
                        }
                    }
                }
                out.iter_mut().zip(sums).for_each(|(out, sum)| *out /= *sum);
            },
        );
    }

    /// Smooths along z.
    fn along(&self, column: &mut [f32], copy: &mut Vec<f32>, sums: &[f32]) {
        copy.clear();
        copy.extend_from_slice(column);
        let depths = column.len();
        for (k, weight) in self.weights.iter().enumerate().skip(1) {
            let add = |(sum, value): (&mut f32, &f32)| *sum += weight * value;
            column[k..].iter_mut().zip(&copy[..depths - k]).for_each(add);
            column[..depths - k].iter_mut().zip(&copy[k..]).for_each(add);
        }
        column.iter_mut().zip(sums).for_each(|(value, sum)| *value /= sum);
    }

    /// Of all places along z: the sum of the weights that are not beyond its ends.
    fn sums(&self, depths: usize) -> Vec<f32> {
        let inside = |place: usize, k: usize| u8::from(k <= place) + u8::from(place + k < depths);
        let beside = |place: usize| {
            let weights = self.weights.iter().enumerate().skip(1);
            weights.fold(1.0, |sum, (k, weight)| sum + weight * f32::from(inside(place, k)))
        };
        (0..depths).map(beside).collect()
    }
}
