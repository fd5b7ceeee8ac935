//! Grating lobes told from surfaces: an alias lives in a narrow band, a surface in all of it.

use super::DepthOptions;
use super::power::Power;
use crate::alloc::try_zeroed;
use crate::error::Result;
use crate::grid::{Axis, Grid, VolumeView, no_room_for, pixel_values};
use crate::wave::Aperture;
use crate::wave::simd::{LANES, dispatched};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

/// Parts of the band whose powers are compared.
const BANDS: usize = 3;

/// Half-width of the window of the Fourier transform along z, in Δd.
const WINDOW: f64 = 3.0;

/// σ of the mean power of a part: across in lateral resolutions, and along z in steps.
const MEAN: f64 = 0.65;
const MEAN_STEPS: f64 = 0.5;

/// Multiplies the power of each voxel by the least of its parts of the band over their mean, and tells how evenly the
/// strongest voxels of the columns fill the band, 0 to 1.
///
/// The parts come from the column itself, by a short Fourier transform along z about the carrier of each, which turns with
/// the local gradient of the path: no second reconstruction is needed.
///
/// # Errors
/// When the powers of the parts do not fit in memory.
pub(super) fn flatten(
    power: &mut Power,
    volume: VolumeView<'_>,
    aperture: &Aperture,
    options: &DepthOptions,
) -> Result<f64> {
    let grid = power.grid;
    let Some(cell) = aperture.range_resolution() else { return Ok(1.0) };
    if grid.z.pitch > cell {
        return Ok(1.0); // the parts would be aliases of each other
    }
    let every = every(&grid, cell);
    let coarse = Grid {
        z: Axis {
            pitch: grid.z.pitch * every as f64,
            count: (grid.z.count - 1).div_ceil(every) + 1,
            ..grid.z
        },
        ..grid
    };
    let mut parts = Vec::new();
    for _ in 0..BANDS {
        let values = try_zeroed::<f32>(coarse.voxel_count()).ok_or_else(|| no_room_for(&grid))?;
        parts.push(Power { grid: coarse, values });
    }
    transforms(&mut parts, volume, aperture, every, cell);
    let smoothed = |part: Power| part.smoothed_across([MEAN; 2], MEAN_STEPS, options);
    let parts: Vec<Power> = parts.into_iter().map(smoothed).collect::<Result<_>>()?;
    let depths = grid.z.count;
    let even = evenness(power, &parts, every)?;
    power.values.par_chunks_mut(depths).enumerate().for_each(|(pixel, column)| {
        let share = |place: usize| least_share(parts.iter().map(|part| part.column(pixel)[place]));
        let mut near = share(0);
        for (place, voxels) in column.chunks_mut(every).enumerate() {
            let far = if place + 1 < coarse.z.count { share(place + 1) } else { near };
            for (i, value) in voxels.iter_mut().enumerate() {
                *value *= near + (far - near) * (i as f32 / every as f32);
            }
            near = far;
        }
    });
    Ok(even)
}

/// The least of the powers of the parts over their mean.
fn least_share(powers: impl Iterator<Item = f32>) -> f32 {
    let (least, sum) = powers.fold((f32::MAX, 0.0), |(least, sum), p| (p.min(least), sum + p));
    if sum > 0.0 { least * BANDS as f32 / sum } else { 1.0 }
}

/// Mean share of the weakest part at the strongest voxel of every column, by its power, when the parts are made as strong as
/// each other in the whole volume: a loudspeaker, a window and what reflects may prefer a part of the band.
///
/// # Errors
/// When the columns' shares do not fit in memory.
fn evenness(power: &Power, parts: &[Power], every: usize) -> Result<f64> {
    let mut sums: Vec<[f64; BANDS]> = pixel_values([0.0; BANDS], power.grid.plane_len())?;
    // By the power of all parts, so that surfaces count more than what is between them.
    sums.par_iter_mut().enumerate().for_each(|(pixel, sums)| {
        for place in 0..parts[0].grid.z.count {
            let powers: [f64; BANDS] = std::array::from_fn(|b| f64::from(parts[b].column(pixel)[place]));
            let all: f64 = powers.iter().sum();
            sums.iter_mut().zip(powers).for_each(|(sum, power)| *sum += all * power);
        }
    });
    let levels: [f64; BANDS] = std::array::from_fn(|b| sums.iter().map(|sums| sums[b]).sum());
    if levels.contains(&0.0) {
        return Ok(1.0); // the band has less than three parts
    }
    let weights = levels.map(|level| (levels.iter().sum::<f64>() / level) as f32);
    let mut shares = pixel_values([0.0; 2], power.grid.plane_len())?;
    shares.par_iter_mut().enumerate().for_each(|(pixel, share)| {
        let column = power.column(pixel).iter().copied().enumerate();
        let (at, strongest) = column.fold((0, 0.0), |most, here| if here.1 > most.1 { here } else { most });
        let parts = parts.iter().zip(weights).map(|(part, weight)| weight * part.column(pixel)[at / every]);
        *share = [f64::from(strongest), f64::from(strongest) * f64::from(least_share(parts))];
    });
    let [all, even] = shares.iter().fold([0.0; 2], |sum, share| [sum[0] + share[0], sum[1] + share[1]]);
    Ok(if all > 0.0 { even / all } else { 1.0 })
}

/// Depths from one transform to the next: about Δd, for their windows are six times as wide.
fn every(grid: &Grid, cell: f64) -> usize {
    ((cell / grid.z.pitch).round() as usize).max(1)
}

/// Bytes of the powers of the parts, and of a copy of one.
pub(super) fn bytes(grid: &Grid, cell: f64) -> u64 {
    grid.voxel_count().saturating_mul((BANDS as u64 + 1) * size_of::<f32>() as u64) / every(grid, cell) as u64
}

/// The power of each part of the band at every `every`-th depth of every column.
fn transforms(parts: &mut [Power], volume: VolumeView<'_>, aperture: &Aperture, every: usize, cell: f64) {
    let grid = volume.grid;
    let plane = grid.plane_len();
    let (depths, coarse) = (grid.z.count, parts[0].grid.z.count);
    // No tap is farther away than the last depth is from the first.
    let reach = ((WINDOW * cell / grid.z.pitch).floor() as usize).min(depths - 1);
    let weights: Vec<f32> = (0..=reach)
        .map(|t| (0.5 + 0.5 * (PI * t as f64 * grid.z.pitch / (WINDOW * cell)).cos()) as f32)
        .collect();
    let turns = |frequency: f64| TAU * frequency * grid.z.pitch / aperture.sound_speed;
    let (carrier, spacing) = (turns(aperture.centre_frequency()), turns(aperture.bandwidth() / BANDS as f64));
    let [low, middle, high] = parts else { unreachable!("three parts of the band") };
    low.values
        .par_chunks_mut(LANES * coarse)
        .zip(middle.values.par_chunks_mut(LANES * coarse))
        .zip(high.values.par_chunks_mut(LANES * coarse))
        .enumerate()
        .for_each_init(Vec::new, |samples: &mut Vec<[[f32; LANES]; 2]>, (chunk, ((low, middle), high))| {
            let first = chunk * LANES;
            let pixels = low.len() / coarse;
            // Zeros beyond both ends, so that no tap is missing.
            samples.clear();
            samples.resize(depths + 2 * reach, [[0.0; LANES]; 2]);
            for (iz, slice) in volume.samples.chunks_exact(plane).enumerate() {
                for (lane, sample) in slice[first..first + pixels].iter().enumerate() {
                    samples[reach + iz][0][lane] = sample.re;
                    samples[reach + iz][1][lane] = sample.im;
                }
            }
            for place in 0..coarse {
                let iz = (place * every).min(depths - 1);
                let mut phasors = [[[0.0f32; LANES]; 2]; 2];
                for lane in 0..pixels {
                    let pixel = first + lane;
                    let p = grid.position(pixel % grid.x.count, pixel / grid.x.count, iz);
                    let gradient = aperture.path_gradient(p);
                    for (phasor, turn) in phasors.iter_mut().zip([carrier, spacing]) {
                        let (sin, cos) = (turn * gradient).sin_cos();
                        (phasor[0][lane], phasor[1][lane]) = (cos as f32, sin as f32);
                    }
                }
                let mut sums = [[0.0; LANES]; 3];
                powers(&samples[iz..=iz + 2 * reach], &weights, &phasors, &mut sums);
                for lane in 0..pixels {
                    let at = lane * coarse + place;
                    [low[at], middle[at], high[at]] = sums.map(|sums| sums[lane]);
                }
            }
        });
}

dispatched! {
    /// |Σ_t w_t A(t) e^{i t (carrier + b spacing)}|² for b = −1, 0, 1, sixteen columns at a time; `samples` has its middle at
    /// t = 0.
    fn powers = powers_body(
        samples: &[[[f32; LANES]; 2]],
        weights: &[f32],
        phasors: &[[[f32; LANES]; 2]; 2],
        powers: &mut [[f32; LANES]; 3],
    )
}

#[allow(clippy::inline_always)]
#[inline(always)]
fn powers_body(
    samples: &[[[f32; LANES]; 2]],
    weights: &[f32],
    phasors: &[[[f32; LANES]; 2]; 2],
    powers: &mut [[f32; LANES]; 3],
) {
    let reach = weights.len() - 1;
    let [turn, shift] = phasors;
    let middle = &samples[reach];
    // re and im of the sums for b = −1, 0, 1.
    let mut sums = [[middle[0], middle[1]]; 3];
    let (mut carrier, mut spacing) = (*turn, *shift);
    for t in 1..=reach {
        let (after, before, w) = (&samples[reach + t], &samples[reach - t], weights[t]);
        for lane in 0..LANES {
            let (c, s) = (carrier[0][lane], carrier[1][lane]);
            let (p, q) = (spacing[0][lane], spacing[1][lane]);
            // A(t) e^{iωt} and A(−t) e^{−iωt}.
            let (ar, ai) = (w * after[0][lane], w * after[1][lane]);
            let (br, bi) = (w * before[0][lane], w * before[1][lane]);
            let (ur, ui) = (ar * c - ai * s, ar * s + ai * c);
            let (vr, vi) = (br * c + bi * s, bi * c - br * s);
            sums[1][0][lane] += ur + vr;
            sums[1][1][lane] += ui + vi;
            // u e^{±iδt} + v e^{∓iδt} = (u + v) cos ± i (u − v) sin.
            let (er, ei) = ((ur + vr) * p, (ui + vi) * p);
            let (or, oi) = (-(ui - vi) * q, (ur - vr) * q);
            sums[2][0][lane] += er + or;
            sums[2][1][lane] += ei + oi;
            sums[0][0][lane] += er - or;
            sums[0][1][lane] += ei - oi;
            carrier[0][lane] = c * turn[0][lane] - s * turn[1][lane];
            carrier[1][lane] = c * turn[1][lane] + s * turn[0][lane];
            spacing[0][lane] = p * shift[0][lane] - q * shift[1][lane];
            spacing[1][lane] = p * shift[1][lane] + q * shift[0][lane];
        }
    }
    *powers = sums.map(|[re, im]| std::array::from_fn(|lane| re[lane] * re[lane] + im[lane] * im[lane]));
}
