//! Eq. 13 as written: every voxel, microphone and frequency, with f64 totals. The oracle.

use super::Weights;
use crate::acquisition::DataCube;
use crate::error::Result;
use crate::grid::{Grid, Volume};
use crate::progress::{Observer, advance, stage};
use crate::wave::simd::{LANES, Steps, SweepSamples, weighted_sum, weighted_sweep};
use num_complex::Complex32;
use rayon::prelude::*;

/// Operations of the job by a fixed model, for comparison with the other methods'.
pub(super) fn operations(cube: &DataCube, grid: &Grid) -> f64 {
    let per_term = if cube.sweep.step().is_some() { 8.0 } else { 30.0 };
    let pairs = grid.voxel_count() as f64 * cube.array.len() as f64;
    pairs * (60.0 + per_term * cube.sweep.len() as f64)
}

/// Voxels that are summed together, so that they share what is read of the samples.
const TOGETHER: usize = 64;

/// Adds the sums of a few voxels, real and imaginary, from their padded path lengths to all microphones.
type Sums = Box<dyn Fn(&[f64], &mut [[f64; 2]]) + Sync>;

/// Fills `volume`; any grid, any microphones. Cost: 8 operations per voxel, microphone and frequency where the steps
/// are even, else a phasor.
pub(super) fn direct(
    cube: &DataCube,
    weights: &Weights,
    volume: &mut Volume,
    observer: &dyn Observer,
) -> Result<()> {
    let (grid, n_f, n_mic) = (volume.grid, cube.sweep.len(), cube.array.len());
    let sums: Sums = match cube.sweep.step() {
        Some(step) => {
            let steps = Steps {
                start: -cube.sweep.start() / cube.sound_speed,
                step: -step / cube.sound_speed,
                count: n_f,
            };
            let samples = SweepSamples::new(n_f, n_mic, |f, r| {
                cube.frequency(f)[r] * (weights.microphone[r] * weights.frequency[f])
            });
            Box::new(move |lengths, totals| weighted_sweep(&samples, lengths, steps, totals))
        }
        None => Box::new(one_by_one(cube, weights)),
    };
    let padded = n_mic.next_multiple_of(LANES);
    let total = volume.samples.len().div_ceil(TOGETHER) as u64;
    stage(observer, "reconstructing (direct sum)", total, || {
        volume.samples.par_chunks_mut(TOGETHER).enumerate().try_for_each_init(
            || vec![0.0; TOGETHER * padded],
            |lengths, (chunk, voxels)| {
                for (i, lengths) in lengths.chunks_exact_mut(padded).enumerate().take(voxels.len()) {
                    let v = chunk * TOGETHER + i;
                    let (row, ix) = (v / grid.x.count, v % grid.x.count);
                    let p = grid.position(ix, row % grid.y.count, row / grid.y.count);
                    for (length, &r) in lengths.iter_mut().zip(cube.array.positions()) {
                        *length = cube.geometry.path_length(p, r);
                    }
                }
                let mut totals = vec![[0.0; 2]; voxels.len()];
                sums(&lengths[..voxels.len() * padded], &mut totals);
                for (voxel, total) in voxels.iter_mut().zip(totals) {
                    *voxel = Complex32::new(total[0] as f32, total[1] as f32);
                }
                advance(observer, 1)
            },
        )
    })
}

/// Sums for uneven steps, frequency by frequency.
fn one_by_one(cube: &DataCube, weights: &Weights) -> impl Fn(&[f64], &mut [[f64; 2]]) + Sync + use<> {
    let per_metre: Vec<f64> = cube.sweep.frequencies().iter().map(|f| -f / cube.sound_speed).collect();
    let samples: Vec<[Vec<f32>; 2]> = (0..cube.sweep.len())
        .map(|f| {
            let (re, im) = weights.weighted(cube, f).map(|m| (m.re, m.im)).unzip();
            [re, im]
        })
        .collect();
    let n_mic = cube.array.len();
    move |lengths, totals| {
        for (lengths, total) in lengths.chunks_exact(n_mic.next_multiple_of(LANES)).zip(totals) {
            for (per_metre, [re, im]) in per_metre.iter().zip(&samples) {
                weighted_sum(*per_metre, &lengths[..n_mic], [re, im], total);
            }
        }
    }
}
