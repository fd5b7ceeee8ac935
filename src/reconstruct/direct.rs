//! Eq. 13 as written: every voxel, microphone and frequency, summed in f64. The oracle.

use super::weights::Weights;
use super::{Made, Method, VolumeSink, room_for};
use crate::acquisition::CubeSource;
use crate::error::Result;
use crate::grid::Grid;
use crate::progress::{Observer, advance, stage};
use crate::wave::simd::weighted_sum;
use num_complex::Complex32;
use rayon::prelude::*;

/// Gives the volume to `sink`; any grid, any microphones. Cost: one phasor per voxel, microphone and frequency; holds
/// all samples.
pub(super) fn direct(
    source: &mut dyn CubeSource,
    weights: &Weights,
    grid: &Grid,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<Made> {
    let n_mic = source.setup().array.len();
    let mut samples: Vec<[Vec<f32>; 2]> = Vec::with_capacity(source.setup().sweep.len());
    source.visit(1, &mut |range, block| {
        let (re, im) = weights.weighted(range.start, block).map(|m| (m.re, m.im)).unzip();
        samples.push([re, im]);
        Ok(())
    })?;
    let setup = source.setup();
    let per_metre: Vec<f64> = setup.sweep.frequencies().iter().map(|f| -f / setup.sound_speed).collect();
    let (geometry, microphones) = (setup.geometry, setup.array.positions());
    let made = Made { method: Method::Direct, error_bound: 0.0 };
    let mut voxels = room_for(grid)?;
    let rows = (grid.y.count * grid.z.count) as u64;
    stage(observer, "reconstructing (direct sum)", rows, || {
        voxels.par_chunks_mut(grid.x.count).enumerate().try_for_each(|(row, voxels)| {
            let (iy, iz) = (row % grid.y.count, row / grid.y.count);
            let mut lengths = vec![0.0; n_mic];
            for (ix, voxel) in voxels.iter_mut().enumerate() {
                let p = grid.position(ix, iy, iz);
                for (length, &r) in lengths.iter_mut().zip(microphones) {
                    *length = geometry.path_length(p, r);
                }
                let mut total = [0.0; 2];
                for (per_metre, [re, im]) in per_metre.iter().zip(&samples) {
                    weighted_sum(*per_metre, &lengths, [re, im], &mut total);
                }
                *voxel = Complex32::new(total[0] as f32, total[1] as f32);
            }
            advance(observer, 1)
        })
    })?;
    sink.begin(&made)?;
    sink.take_all(voxels)?;
    Ok(made)
}
