//! The literal way: every pixel's returns from its own column alone, then a median filter.

use super::columns::RayColumns;
use super::levels::{Levels, is_peak, parabola};
use super::peaks::{Peak, peaks};
use super::power::Power;
use super::{DepthOptions, Pick, Refine};
use crate::error::Result;
use crate::grid::{Axis, DepthLayer, Raster, pixel_values};
use rayon::prelude::*;

/// Minimum amplitude of a picked return unless one is given, dB against the reference.
const THRESHOLD_DB: f64 = -14.0;

/// The picked return of every pixel, its confidence, and all returns, front to back.
///
/// Further returns are found in smoothed power: speckle breaks a single column's into false peaks.
///
/// # Errors
/// When a map, or the smoothed power, does not fit in memory.
pub(super) fn locate(
    power: Power,
    raster: &Raster,
    options: &DepthOptions,
) -> Result<(DepthLayer, Vec<f32>, Vec<DepthLayer>)> {
    let (picked, confidence) = pick(&power, raster, options)?;
    let returns = if options.returns >= 2 { find(power, raster, options)? } else { Vec::new() };
    Ok((picked, confidence, returns))
}

/// The picked return of every pixel, and its confidence.
fn pick(power: &Power, raster: &Raster, options: &DepthOptions) -> Result<(DepthLayer, Vec<f32>)> {
    let columns = RayColumns::new(power, raster);
    let levels = Levels::of(&columns.maxima()?, options)?;
    let threshold = levels.detectable(options.threshold_db.unwrap_or(THRESHOLD_DB));
    let mut found: Vec<Option<Peak>> = pixel_values(None, raster.len())?;
    columns.each(&mut found, |_, column, found| {
        *found = peak(column, &power.grid.z, threshold, levels, options);
    });
    let mut raw = pixel_values(f64::NAN, raster.len())?;
    raw.iter_mut().zip(&found).for_each(|(raw, found)| *raw = found.map_or(f64::NAN, |peak| peak.depth));
    let depth = median_filter(raw, raster.x.count, options.median)?;
    let mut picked = DepthLayer::empty(raster.len())?;
    let mut confidence = pixel_values(f32::NAN, raster.len())?;
    for (pixel, found) in found.iter().enumerate() {
        if let (Some(found), false) = (found, depth[pixel].is_nan()) {
            picked.depth[pixel] = depth[pixel] as f32;
            picked.strength[pixel] = found.power.sqrt();
            confidence[pixel] = found.confidence as f32;
        }
    }
    Ok((picked, confidence))
}

fn peak(column: &[f32], z: &Axis, threshold: f32, levels: Levels, options: &DepthOptions) -> Option<Peak> {
    let strong = |i: &usize| column[*i] > 0.0 && column[*i] >= threshold;
    let index = match options.pick {
        Pick::Strongest => {
            (0..column.len()).filter(strong).reduce(|best, i| if column[i] > column[best] { i } else { best })
        }
        Pick::First => (0..column.len()).filter(strong).find(|&i| is_peak(column, i)),
    }?;
    let offset = match options.refine {
        Refine::Surface | Refine::Column => {
            let reach = (2.0 * options.resolution.range / z.pitch + 1e-9).floor() as usize;
            let reach = reach.min(column.len()); // any longer one would overflow the sum below
            let range = index.saturating_sub(reach)..(index + reach + 1).min(column.len());
            let (moment, power) = range.fold((0.0, 0.0), |(moment, power), i| {
                let p = f64::from(column[i]);
                (moment + p * (i as f64 - index as f64), power + p)
            });
            moment / power
        }
        Refine::Parabola => parabola(column, index),
        Refine::None => 0.0,
    };
    let depth = z.first + z.pitch * (index as f64 + offset);
    let confidence = levels.confidence(column[index], levels.clutter(column));
    Some(Peak { index, depth, power: column[index], confidence })
}

/// Up to `options.returns` surfaces per pixel; surface k holds each pixel's k-th from the front.
fn find(power: Power, raster: &Raster, options: &DepthOptions) -> Result<Vec<DepthLayer>> {
    let z = power.grid.z;
    // Smoothed on the grid, where lengths are in metres.
    let power = power.smoothed_for(options)?;
    let columns = RayColumns::new(&power, raster);
    let levels = Levels::of(&columns.maxima()?, options)?;
    let mut found: Vec<Vec<Peak>> = pixel_values(Vec::new(), raster.len())?;
    columns.each(&mut found, |_, column, found| {
        *found = peaks(column, &z, levels, options.returns, options, |_, _| true);
    });
    let mut surfaces = Vec::new();
    for k in 0..options.returns {
        let mut surface = DepthLayer::empty(raster.len())?;
        let mut confidence = pixel_values(f32::NAN, raster.len())?;
        for (pixel, found) in found.iter().enumerate() {
            if let Some(peak) = found.get(k) {
                surface.depth[pixel] = peak.depth as f32;
                surface.strength[pixel] = peak.power.sqrt();
                confidence[pixel] = peak.confidence as f32;
            }
        }
        surfaces.push(DepthLayer { confidence: Some(confidence), ..surface });
    }
    Ok(surfaces)
}

/// The median of the returns within a square; a pixel keeps its return where at least 4 of 9 have one.
fn median_filter(depth: Vec<f64>, n_x: usize, side: usize) -> Result<Vec<f64>> {
    if side == 1 {
        return Ok(depth);
    }
    let mut filtered = pixel_values(f64::NAN, depth.len())?;
    let (n_y, reach) = (depth.len() / n_x, side / 2);
    let enough = (4 * side * side).div_ceil(9);
    filtered.par_iter_mut().enumerate().for_each_init(Vec::new, |neighbours, (pixel, filtered)| {
        if depth[pixel].is_nan() {
            return;
        }
        let (x, y) = (pixel % n_x, pixel / n_x);
        neighbours.clear();
        for row in y.saturating_sub(reach)..(y + reach + 1).min(n_y) {
            for column in x.saturating_sub(reach)..(x + reach + 1).min(n_x) {
                let z = depth[row * n_x + column];
                if !z.is_nan() {
                    neighbours.push(z);
                }
            }
        }
        if neighbours.len() < enough {
            return;
        }
        neighbours.sort_by(f64::total_cmp);
        let n = neighbours.len();
        // Of two in the middle the nearer: between a surface and the next there is none.
        let (below, above) = (neighbours[(n - 1) / 2], neighbours[n / 2]);
        *filtered = if depth[pixel] - below <= above - depth[pixel] { below } else { above };
    });
    Ok(filtered)
}
