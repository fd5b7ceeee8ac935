//! Eq. 13 as written: every voxel, microphone and frequency, summed in f64. The oracle.

use super::Weights;
use crate::acquisition::DataCube;
use crate::error::Result;
use crate::grid::Volume;
use crate::progress::{Observer, advance, stage};
use crate::wave::simd::weighted_sum;
use num_complex::Complex32;
use rayon::prelude::*;

/// Fills `volume`; any grid, any microphones. Cost: one phasor per voxel, microphone and frequency.
pub(super) fn direct(
    cube: &DataCube,
    weights: &Weights,
    volume: &mut Volume,
    observer: &dyn Observer,
) -> Result<()> {
    let grid = volume.grid;
    let per_metre: Vec<f64> = cube.sweep.frequencies().iter().map(|f| -f / cube.sound_speed).collect();
    let samples: Vec<[Vec<f32>; 2]> = (0..cube.sweep.len())
        .map(|f| {
            let (re, im) = weights.weighted(cube, f).map(|m| (m.re, m.im)).unzip();
            [re, im]
        })
        .collect();
    let rows = (grid.y.count * grid.z.count) as u64;
    stage(observer, "reconstructing (direct sum)", rows, || {
        volume.samples.par_chunks_mut(grid.x.count).enumerate().try_for_each(|(row, voxels)| {
            let (iy, iz) = (row % grid.y.count, row / grid.y.count);
            let mut lengths = vec![0.0; cube.array.len()];
            for (ix, voxel) in voxels.iter_mut().enumerate() {
                let p = grid.position(ix, iy, iz);
                for (length, &r) in lengths.iter_mut().zip(cube.array.positions()) {
                    *length = cube.geometry.path_length(p, r);
                }
                let mut total = [0.0; 2];
                for (per_metre, [re, im]) in per_metre.iter().zip(&samples) {
                    weighted_sum(*per_metre, &lengths, [re, im], &mut total);
                }
                *voxel = Complex32::new(total[0] as f32, total[1] as f32);
            }
            advance(observer, 1)
        })
    })
}
