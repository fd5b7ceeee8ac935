//! Eq. 13 as written: every voxel, microphone and frequency, with f64 totals. The oracle.

use super::Weights;
use crate::acquisition::DataCube;
use crate::error::Result;
use crate::grid::{Grid, Volume};
use crate::progress::{Observer, advance, stage};
use crate::wave::simd::{POINTS, Steps, SweepSamples, weighted_sum, weighted_sweep};
use num_complex::Complex32;
use rayon::prelude::*;

/// Operations per term, for comparison with the other methods'.
pub(super) const OPERATIONS: f64 = 8.0;

/// Fills `volume`; any grid, any microphones. Cost: 8 operations per voxel, microphone and frequency where the steps
/// are even, else a phasor.
pub(super) fn direct(
    cube: &DataCube,
    weights: &Weights,
    volume: &mut Volume,
    observer: &dyn Observer,
) -> Result<()> {
    let grid = volume.grid;
    let rows = (grid.y.count * grid.z.count) as u64;
    stage(observer, "reconstructing (direct sum)", rows, || {
        if let Some(step) = cube.sweep.step() {
            let steps = Steps {
                start: -cube.sweep.start() / cube.sound_speed,
                step: -step / cube.sound_speed,
                count: cube.sweep.len(),
            };
            even(cube, weights, steps, volume, observer)
        } else {
            uneven(cube, weights, volume, observer)
        }
    })
}

/// Path lengths of the voxel `ix` of a row to every microphone, m; the padding is left alone.
fn fill(lengths: &mut [f64], cube: &DataCube, grid: &Grid, ix: usize, row: usize) {
    let p = grid.position(ix, row % grid.y.count, row / grid.y.count);
    for (length, &r) in lengths.iter_mut().zip(cube.array.positions()) {
        *length = cube.geometry.path_length(p, r);
    }
}

/// A few voxels of a row at a time, which share the samples.
fn even(
    cube: &DataCube,
    weights: &Weights,
    steps: Steps,
    volume: &mut Volume,
    observer: &dyn Observer,
) -> Result<()> {
    let grid = volume.grid;
    let n_mic = cube.array.len();
    let samples = SweepSamples::new(cube.sweep.len(), n_mic, |f, r| {
        cube.frequency(f)[r] * (weights.microphone[r] * weights.frequency[f])
    });
    volume.samples.par_chunks_mut(grid.x.count).enumerate().try_for_each(|(row, voxels)| {
        let mut lengths = vec![0.0; POINTS * samples.padded_len()];
        for (tile, voxels) in voxels.chunks_mut(POINTS).enumerate() {
            for (l, lengths) in lengths.chunks_exact_mut(samples.padded_len()).enumerate() {
                // The last tile of a row may repeat its last voxel.
                fill(lengths, cube, &grid, tile * POINTS + l.min(voxels.len() - 1), row);
            }
            let mut totals = [[0.0; 2]; POINTS];
            let each = std::array::from_fn(|l| &lengths[l * samples.padded_len()..][..samples.padded_len()]);
            weighted_sweep(&samples, each, steps, &mut totals);
            for (voxel, total) in voxels.iter_mut().zip(totals) {
                *voxel = Complex32::new(total[0] as f32, total[1] as f32);
            }
        }
        advance(observer, 1)
    })
}

/// Frequency by frequency.
fn uneven(
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
    volume.samples.par_chunks_mut(grid.x.count).enumerate().try_for_each(|(row, voxels)| {
        let mut lengths = vec![0.0; cube.array.len()];
        for (ix, voxel) in voxels.iter_mut().enumerate() {
            fill(&mut lengths, cube, &grid, ix, row);
            let mut total = [0.0; 2];
            for (per_metre, [re, im]) in per_metre.iter().zip(&samples) {
                weighted_sum(*per_metre, &lengths, [re, im], &mut total);
            }
            *voxel = Complex32::new(total[0] as f32, total[1] as f32);
        }
        advance(observer, 1)
    })
}
