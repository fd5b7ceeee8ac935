//! Several surfaces per pixel: peaks of smoothed power, front to back.
//!
//! Speckle breaks a single column's amplitude into false peaks; a little smoothing of the power removes them, at
//! the cost of resolution.

use super::columns::RayColumns;
use super::{DepthOptions, confidence, is_peak, parabola, percentile_99};
use crate::alloc::{try_filled, try_with_capacity};
use crate::error::Result;
use crate::grid::{Axis, DepthLayer, Grid, Raster, no_room_for, pixel_values};
use rayon::prelude::*;
use std::mem;

/// Half-width of the surroundings of a peak, and of the peak itself, in Δd.
const SURROUNDINGS: f64 = 6.0;
const OWN: f64 = 1.5;

/// A return of one pixel.
#[derive(Debug, Clone, Copy)]
struct Peak {
    index: usize,
    depth: f64,
    power: f32,
}

/// Up to `options.returns` surfaces per pixel; surface k holds each pixel's k-th from the front.
///
/// Confidence is the peak's power against the reference and against its column's median, in dB.
///
/// # Errors
/// When the power, or a map, does not fit in memory.
pub(super) fn find(
    amplitude: &[f32],
    grid: &Grid,
    raster: &Raster,
    options: &DepthOptions,
) -> Result<Vec<DepthLayer>> {
    let no_room = || no_room_for(grid);
    let mut power = try_with_capacity(grid.voxel_count()).ok_or_else(no_room)?;
    power.par_extend(amplitude.par_iter().map(|a| a * a));
    // Smoothed on the grid, where lengths are in metres.
    let power = smooth(power, grid, options.smoothing).ok_or_else(no_room)?;
    let columns = RayColumns::of_power(&power, grid, raster);
    let maxima = columns.maxima()?;
    let decibels = |db: f64| 10f64.powf(db / 10.0) as f32;
    let mut sorted = pixel_values(0.0, maxima.len())?;
    sorted.copy_from_slice(&maxima);
    let reference = percentile_99(&mut sorted);
    let floor = reference * decibels(options.return_threshold_db);
    let gate = decibels(options.return_gate_db);
    let mut surfaces = Vec::new();
    for _ in 0..options.returns {
        let confidence = Some(pixel_values(f32::NAN, raster.len())?);
        surfaces.push(DepthLayer { confidence, ..DepthLayer::empty(raster.len())? });
    }
    let mut found: Vec<Vec<(Peak, f64)>> = pixel_values(Vec::new(), raster.len())?;
    columns.each(&mut found, |pixel, column, found| {
        let peaks = peaks(column, &grid.z, floor.max(maxima[pixel] * gate), options);
        let level = |found: &Peak| confidence(column, found.power.into(), reference.into());
        found.extend(peaks.iter().map(|peak| (*peak, level(peak))));
    });
    for (pixel, found) in found.iter().enumerate() {
        for (surface, (found, confidence)) in surfaces.iter_mut().zip(found) {
            surface.depth[pixel] = found.depth as f32;
            surface.strength[pixel] = found.power.sqrt();
            surface.confidence.get_or_insert_default()[pixel] = *confidence as f32;
        }
    }
    Ok(surfaces)
}

/// The returns of one column of smoothed power, front to back, none weaker than `enough`.
///
/// Peaks are taken strongest first, so that a sidelobe never displaces the surface that caused it. A further one must
/// also stand out: aliases of the array are narrow in frequency and therefore long in depth, while a surface is short;
/// and two crests of one slope have no valley between them (measured in the tests of the shipped scenes).
fn peaks(column: &[f32], z: &Axis, enough: f32, options: &DepthOptions) -> Vec<Peak> {
    let least = options.separation * options.range_resolution;
    let contrast = 10f64.powf(options.return_contrast_db / 10.0) as f32;
    let mut peaks: Vec<usize> =
        (0..column.len()).filter(|&i| column[i] > 0.0 && column[i] >= enough && is_peak(column, i)).collect();
    peaks.sort_by(|a, b| column[*b].total_cmp(&column[*a]).then(a.cmp(b)));
    let mut kept: Vec<Peak> = Vec::new();
    for index in peaks {
        let depth = z.first + z.pitch * (index as f64 + parabola(column, index));
        let apart = kept.iter().all(|other| (other.depth - depth).abs() >= least);
        if kept.len() < options.returns
            && apart
            && (contrast <= 1.0 || kept.is_empty() || stands_out(column, z, index, &kept, contrast, options))
        {
            kept.push(Peak { index, depth, power: column[index] });
        }
    }
    kept.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    kept
}

/// Whether a peak is `contrast` times as strong as the median around it and as every valley to a stronger return.
fn stands_out(
    column: &[f32],
    z: &Axis,
    peak: usize,
    stronger: &[Peak],
    contrast: f32,
    options: &DepthOptions,
) -> bool {
    let valley =
        |other: usize| column[peak.min(other)..=peak.max(other)].iter().copied().fold(f32::MAX, f32::min);
    if stronger.iter().any(|other| column[peak] < contrast * valley(other.index)) {
        return false;
    }
    let cells =
        |lengths: f64| (lengths * options.range_resolution / z.pitch).min(column.len() as f64) as usize;
    let (reach, own) = (cells(SURROUNDINGS), cells(OWN));
    let mut around: Vec<f32> = (peak.saturating_sub(reach)..(peak + reach + 1).min(column.len()))
        .filter(|i| i.abs_diff(peak) > own && stronger.iter().all(|other| i.abs_diff(other.index) > own))
        .map(|i| column[i])
        .collect();
    if around.is_empty() {
        return true;
    }
    let middle = around.len() / 2;
    column[peak] >= contrast * *around.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// Separable Gaussian smoothing with σ in m along x, y, z; the kernel ends at 4σ and is renormalised at the edges.
/// `None` when a copy does not fit in memory.
fn smooth(mut power: Vec<f32>, grid: &Grid, sigma: [f64; 3]) -> Option<Vec<f32>> {
    let (n_x, plane) = (grid.x.count, grid.plane_len());
    let axes = [(grid.x, sigma[0], 1), (grid.y, sigma[1], n_x), (grid.z, sigma[2], plane)];
    let mut smoothed = Vec::new();
    for (axis, sigma, stride) in axes {
        let cells = sigma / axis.pitch;
        let reach = (4.0 * cells).ceil().min((axis.count - 1) as f64) as usize;
        if cells < 0.05 || reach == 0 {
            continue;
        }
        let kernel: Vec<f32> =
            (0..=reach).map(|k| (-0.5 * (k as f64 / cells).powi(2)).exp() as f32).collect();
        if smoothed.is_empty() {
            smoothed = try_filled(0.0, grid.voxel_count())?;
        }
        // Of all places along the axis: the sum of the weights that are not beyond its ends.
        let weight = |place: usize| {
            kernel.iter().enumerate().skip(1).fold(kernel[0], |sum, (k, w)| {
                let sum = if k <= place { sum + w } else { sum };
                if place + k < axis.count { sum + w } else { sum }
            })
        };
        let weights: Vec<f32> = (0..axis.count).map(weight).collect();
        if stride == 1 {
            // Along rows, and along whatever has nothing beside it.
            let rows = smoothed.par_chunks_mut(axis.count).zip(power.par_chunks(axis.count));
            rows.for_each(|(row, source)| {
                row.iter_mut().zip(source).for_each(|(sum, value)| *sum = kernel[0] * value);
                for (k, w) in kernel.iter().enumerate().skip(1) {
                    add(*w, &source[..axis.count - k], &mut row[k..]);
                    add(*w, &source[k..], &mut row[..axis.count - k]);
                }
                row.iter_mut().zip(&weights).for_each(|(sum, weight)| *sum /= weight);
            });
        } else {
            smoothed.par_chunks_mut(stride).enumerate().for_each(|(i, line)| {
                let (place, source) = (i % axis.count, |line: usize| &power[line * stride..][..stride]);
                line.iter_mut().zip(source(i)).for_each(|(sum, value)| *sum = kernel[0] * value);
                for (k, w) in kernel.iter().enumerate().skip(1) {
                    if k <= place {
                        add(*w, source(i - k), line);
                    }
                    if place + k < axis.count {
                        add(*w, source(i + k), line);
                    }
                }
                for sum in line {
                    *sum /= weights[place];
                }
            });
        }
        mem::swap(&mut power, &mut smoothed);
    }
    Some(power)
}

/// Adds weighted values to sums.
fn add(weight: f32, values: &[f32], sums: &mut [f32]) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(echoes: &[(f64, f64)], options: &DepthOptions) -> Vec<DepthLayer> {
        find(&amplitude(echoes), &grid(), &Raster::of_grid(&grid()), options).expect("fits")
    }

    fn grid() -> Grid {
        let axis = |pitch, count| Axis { first: 1.0, pitch, count };
        Grid { x: axis(0.02, 7), y: axis(0.02, 6), z: axis(0.008, 80) }
    }

    fn amplitude(echoes: &[(f64, f64)]) -> Vec<f32> {
        let grid = grid();
        grid.z
            .positions()
            .flat_map(|z| {
                let a: f64 = echoes.iter().map(|(d, a)| a * (-((z - d) / 0.012f64).powi(2)).exp()).sum();
                vec![a as f32; grid.plane_len()]
            })
            .collect()
    }

    #[test]
    fn two_surfaces_come_back_in_order_with_their_strengths() {
        let surfaces = found(&[(1.40, 1.0), (1.15, 0.5)], &DepthOptions::new(0.017));
        for (surface, expected) in surfaces.iter().zip([1.15, 1.40]) {
            for z in &surface.depth {
                assert!((f64::from(*z) - expected).abs() < 5e-4, "{z}");
            }
        }
        let ratio = surfaces[0].strength[10] / surfaces[1].strength[10];
        assert!((ratio - 0.5).abs() < 0.01, "{ratio}");
        let levels = [0, 1].map(|k: usize| surfaces[k].confidence.as_ref().expect("of every return")[10]);
        // Half the amplitude is 6 dB less against the reference and against the column alike.
        assert!((levels[1] - levels[0] - 12.04).abs() < 0.3, "{levels:?}");
    }

    #[test]
    fn three_surfaces_come_back_when_three_are_asked_for() {
        let echoes = [(1.1, 0.6), (1.25, 1.0), (1.45, 0.5)];
        for (returns, expected) in [(3, vec![1.1, 1.25, 1.45]), (2, vec![1.1, 1.25])] {
            let options = DepthOptions { returns, ..DepthOptions::new(0.017) };
            let surfaces = found(&echoes, &options);
            assert_eq!(surfaces.len(), returns);
            for (surface, expected) in surfaces.iter().zip(expected) {
                assert!((f64::from(surface.depth[20]) - expected).abs() < 5e-4, "{returns}: {surface:?}");
            }
        }
    }

    #[test]
    fn two_crests_of_one_slope_and_a_crest_on_a_long_pedestal_are_no_further_return() {
        let options = DepthOptions::new(0.017);
        let plain = DepthOptions { return_contrast_db: 0.0, ..options.clone() };
        // A wall 60 mm deep in the pixel: crests at both ends, and 3 dB less between them.
        let slope = [(1.20, 1.0), (1.212, 0.7), (1.224, 0.6), (1.236, 0.6), (1.248, 0.8), (1.26, 0.9)];
        // What an alias leaves: 150 mm of power, with one crest a little higher than the rest.
        let mut pedestal: Vec<(f64, f64)> = (0..15).map(|i| (1.30 + 0.01 * f64::from(i), 0.25)).collect();
        pedestal.extend([(1.15, 1.0), (1.37, 0.2)]);
        for echoes in [&slope[..], &pedestal] {
            let second = |options| found(echoes, options)[1].depth[20];
            assert!(second(&options).is_nan(), "{}", second(&options));
            assert!(!second(&plain).is_nan(), "without a crest to refuse, the test proves nothing");
        }
    }

    #[test]
    fn a_weak_or_near_second_peak_is_not_a_surface() {
        for echoes in [[(1.2, 1.0), (1.4, 0.2)], [(1.2, 1.0), (1.22, 0.9)]] {
            let surfaces = found(&echoes, &DepthOptions::new(0.017));
            assert!(surfaces[0].depth.iter().all(|z| !z.is_nan()));
            assert!(surfaces[1].depth.iter().all(|z| z.is_nan()), "{echoes:?}");
        }
    }

    #[test]
    fn smoothing_equals_the_literal_sums_at_every_voxel() {
        let axis = |pitch, count| Axis { first: 1.0, pitch, count };
        let grids = [[9, 4, 11], [1, 6, 11], [7, 1, 8], [1, 1, 13], [5, 3, 1]];
        for [n_x, n_y, n_z] in grids {
            smoothed_literally(&Grid { x: axis(0.02, n_x), y: axis(0.015, n_y), z: axis(0.008, n_z) });
        }
    }

    fn smoothed_literally(grid: &Grid) {
        let [n_z, n_y, n_x] = grid.shape();
        let power: Vec<f32> = (0..n_z * n_y * n_x).map(|i| (i as f32 * 0.618_034).fract()).collect();
        let sigma = [0.013, 0.02, 0.011];
        let weight = |a: usize, b: usize, sigma: f64, pitch: f64| {
            let (apart, cells) = (a.abs_diff(b), sigma / pitch);
            if apart as f64 <= (4.0 * cells).ceil() {
                (-0.5 * (apart as f64 / cells).powi(2)).exp()
            } else {
                0.0
            }
        };
        let smoothed = smooth(power.clone(), grid, sigma).expect("fits");
        for (i, got) in smoothed.iter().enumerate() {
            let at = |i: usize| [i % n_x, i / n_x % n_y, i / (n_x * n_y)];
            let (mut sum, mut all) = (0.0, 0.0);
            for (j, value) in power.iter().enumerate() {
                let axes = [grid.x, grid.y, grid.z];
                let w: f64 = (0..3).map(|k| weight(at(i)[k], at(j)[k], sigma[k], axes[k].pitch)).product();
                (sum, all) = (sum + w * f64::from(*value), all + w);
            }
            assert!((f64::from(*got) - sum / all).abs() < 1e-6, "voxel {i}: {got}, not {}", sum / all);
        }
    }

    #[test]
    fn smoothing_keeps_a_constant_and_spreads_a_spike() {
        let grid = grid();
        let flat = smooth(vec![2.0; grid.voxel_count() as usize], &grid, [0.02, 0.03, 0.01]).expect("fits");
        assert!(flat.iter().all(|p| (p - 2.0).abs() < 1e-5));
        let mut spike = vec![0.0; grid.voxel_count() as usize];
        let centre = 40 * grid.plane_len() + 3 * 7 + 3;
        spike[centre] = 1.0;
        let spread = smooth(spike, &grid, [0.02, 0.02, 0.008]).expect("fits");
        assert!(spread[centre] < 0.1 && spread[centre + 1] > 0.02);
        assert!((spread[centre + 1] / spread[centre] - (-0.5f32).exp()).abs() < 0.01);
    }
}
