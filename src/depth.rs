//! Finds the depth map of a volume: where along each column the sound came from.
//!
//! The picked return is the strongest (or first) peak of `|Â|` above a threshold, refined by the power centroid and
//! cleaned by a median filter; further returns are found in smoothed power (module `returns`). This module has no
//! access to the scene, so it cannot know the true depths.
//!
//! # Example
//! A column that peaks between two voxels; the power centroid finds the depth:
//! ```
//! use holosonar::depth::{DepthOptions, locate_depth};
//! use holosonar::grid::{Axis, Grid, Volume};
//! use holosonar::num_complex::Complex32;
//!
//! let one = Axis { first: 0.0, pitch: 0.01, count: 1 };
//! let grid = Grid { x: one, y: one, z: Axis { first: 1.0, pitch: 0.01, count: 41 } };
//! let echo = |z: f64| Complex32::from((-0.5 * ((z - 1.204) / 0.01).powi(2)).exp() as f32);
//! let volume = Volume::new(grid, grid.z.positions().map(echo).collect());
//! let mut options = DepthOptions::new(0.017);
//! options.median = 1; // an isolated pixel has no neighbours for a median
//! let map = locate_depth(&volume, &options)?;
//! assert!((map.picked.depth[0] - 1.204).abs() < 5e-4);
//! # Ok::<(), holosonar::error::Error>(())
//! ```

mod columns;
mod returns;

use crate::alloc::try_with_capacity;
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::grid::{DepthLayer, DepthMap, Grid, Raster, Volume, no_room_for, pixel_values};
use crate::progress::{Observer, Silent, stage};
use crate::with_fields::with_fields;
use columns::RayColumns;
use rayon::prelude::*;

choice! {
    /// Which peak of a column is its depth.
    #[derive(Default)]
    pub enum Pick: "pick" {
        /// The peak of maximum amplitude.
        #[default]
        Strongest = "strongest",
        /// The first peak above the threshold, front to back.
        First = "first",
    }
}

choice! {
    /// How a peak is placed between voxels.
    #[derive(Default)]
    pub enum Refine: "refine" {
        /// Power centroid within ±2 range cells: best on slopes, as measured in `guide::method`.
        #[default]
        Centroid = "centroid",
        /// The vertex of a parabola through the peak and its neighbours.
        Parabola = "parabola",
        /// The voxel's own depth.
        None = "none",
    }
}

/// Parameters of [`locate_depth`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct DepthOptions {
    /// Range resolution Δd = c/2B, m.
    pub range_resolution: f64,
    /// Which peak.
    pub pick: Pick,
    /// Sub-voxel refinement.
    pub refine: Refine,
    /// Minimum amplitude, dB against the 99th percentile of the columns' maxima.
    pub threshold_db: f64,
    /// Maximum number of surfaces per pixel; below 2 only the picked one.
    pub returns: usize,
    /// Minimum smoothed power of a return, dB against the 99th percentile of the columns' maxima.
    pub return_threshold_db: f64,
    /// Minimum smoothed power of a further return, dB against its own column's maximum.
    pub return_gate_db: f64,
    /// How far a further return must stand out, dB: above the median of the power around it, and above the valley
    /// between it and every stronger return; 0 requires nothing.
    pub return_contrast_db: f64,
    /// Minimum distance between returns, in Δd.
    pub separation: f64,
    /// Gaussian σ of the power smoothing along x, y, z, m.
    pub smoothing: [f64; 3],
    /// Side of the median filter, pixels, odd; 1 for none.
    pub median: usize,
    /// The pixels; `None` for the grid's own columns.
    pub raster: Option<Raster>,
}

with_fields! {
    DepthOptions {
        with_pick(pick: Pick),
        with_refine(refine: Refine),
        with_threshold_db(threshold_db: f64),
        with_returns(returns: usize),
        with_return_threshold_db(return_threshold_db: f64),
        with_return_gate_db(return_gate_db: f64),
        with_return_contrast_db(return_contrast_db: f64),
        with_separation(separation: f64),
        with_smoothing(smoothing: [f64; 3]),
        with_median(median: usize),
        with_raster(raster: Option<Raster>),
    }
}

impl DepthOptions {
    /// The default options for a range resolution in m.
    pub fn new(range_resolution: f64) -> Self {
        Self {
            range_resolution,
            pick: Pick::Strongest,
            refine: Refine::Centroid,
            threshold_db: -14.0,
            returns: 2,
            return_threshold_db: -20.0,
            return_gate_db: -12.0,
            return_contrast_db: 5.0,
            separation: 1.5,
            smoothing: [0.02, 0.02, 0.008],
            median: 3,
            raster: None,
        }
    }

    /// Bytes that [`locate_depth`] takes besides a volume: its amplitudes, and for returns their power and a copy of it.
    pub(crate) fn search_bytes(&self, grid: &Grid) -> u64 {
        let copies = if self.returns >= 2 { 3 } else { 1 };
        grid.voxel_count().saturating_mul(copies * size_of::<f32>() as u64)
    }
}

/// One column's picked return, before filtering.
#[derive(Debug, Clone, Copy)]
struct PickedReturn {
    depth: f64,
    peak: f32,
    confidence: f64,
}

/// Finds a depth, an amplitude and a confidence for every pixel, and its further returns.
///
/// Confidence is the peak against the reference (the 99th percentile of the columns' maxima) plus the peak against
/// its column's median, both in dB.
///
/// - Shapes: the volume is `[z, y, x]`, the map `[y, x]`.
/// - Cost: a few passes over the volume; one more volume of f32 for the returns.
///
/// # Errors
/// A range resolution that is not positive, an even median; [`Error::OutOfMemory`] when the passes do not fit in memory.
pub fn locate_depth(volume: &Volume, options: &DepthOptions) -> Result<DepthMap> {
    locate_depth_with(volume, options, &Silent)
}

/// [`locate_depth`], reporting its progress to `observer`, which may stop it.
///
/// # Errors
/// As [`locate_depth`]; `Error::Interrupted` when the observer asks to stop.
pub fn locate_depth_with(
    volume: &Volume,
    options: &DepthOptions,
    observer: &dyn Observer,
) -> Result<DepthMap> {
    if !(options.range_resolution > 0.0 && options.range_resolution.is_finite()) {
        return Err(Error::input(
            "sweep",
            "depth needs a bandwidth: the range resolution c/2B must be a positive length",
        ));
    }
    if options.median.is_multiple_of(2) {
        return Err(Error::input("depth.median", format!("must be odd, not {}", options.median)));
    }
    let grid = volume.grid;
    let raster = options.raster.unwrap_or_else(|| Raster::of_grid(&grid));
    stage(observer, "locating depth", 0, || {
        let no_room = || no_room_for(&grid);
        let mut amplitude: Vec<f32> = try_with_capacity(grid.voxel_count()).ok_or_else(no_room)?;
        amplitude.par_extend(volume.samples.par_iter().map(|a| a.norm()));
        let columns = RayColumns::of_amplitude(&amplitude, &grid, &raster);
        let reference = percentile_99(&mut columns.maxima()?);
        let threshold = f64::from(reference) * 10f64.powf(options.threshold_db / 20.0);
        let mut found: Vec<Option<PickedReturn>> = pixel_values(None, raster.len())?;
        columns.each(&mut found, |_, column, found| {
            *found = pick(column, &grid.z, threshold, reference, options);
        });
        let mut picked = DepthLayer::empty(raster.len())?;
        let mut confidence = pixel_values(f32::NAN, raster.len())?;
        let mut raw: Vec<f64> = try_with_capacity(raster.len() as u64).ok_or_else(no_room)?;
        raw.extend(found.iter().map(|f| f.map_or(f64::NAN, |f| f.depth)));
        let depth = median_filter(raw, raster.x.count, options.median)?;
        for (pixel, found) in found.iter().enumerate() {
            if let (Some(found), false) = (found, depth[pixel].is_nan()) {
                picked.depth[pixel] = depth[pixel] as f32;
                picked.strength[pixel] = found.peak;
                confidence[pixel] = found.confidence as f32;
            }
        }
        let returns = if options.returns >= 2 {
            returns::find(&amplitude, &grid, &raster, options)?
        } else {
            Vec::new()
        };
        Ok(DepthMap { confidence, returns, ..DepthMap::new(raster, picked) })
    })
}

/// The 99th percentile of values, which it sorts, interpolated linearly; the maximum itself is driven by speckle.
fn percentile_99(sorted: &mut [f32]) -> f32 {
    sorted.sort_unstable_by(f32::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let place = 0.99 * last as f64;
    let (below, above) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    below + (above - below) * place.fract() as f32
}

fn pick(
    column: &[f32],
    z: &crate::grid::Axis,
    threshold: f64,
    reference: f32,
    options: &DepthOptions,
) -> Option<PickedReturn> {
    let strong = |i: &usize| column[*i] > 0.0 && f64::from(column[*i]) >= threshold;
    let index = match options.pick {
        Pick::Strongest => {
            (0..column.len()).filter(strong).reduce(|best, i| if column[i] > column[best] { i } else { best })
        }
        Pick::First => (0..column.len()).filter(strong).find(|&i| is_peak(column, i)),
    }?;
    let offset = match options.refine {
        Refine::Centroid => {
            let reach = (2.0 * options.range_resolution / z.pitch + 1e-9).floor() as usize;
            let reach = reach.min(column.len()); // any longer one would overflow the sum below
            let range = index.saturating_sub(reach)..(index + reach + 1).min(column.len());
            let (moment, power) = range.fold((0.0, 0.0), |(moment, power), i| {
                let p = f64::from(column[i]).powi(2);
                (moment + p * (i as f64 - index as f64), power + p)
            });
            moment / power
        }
        Refine::Parabola => parabola(column, index),
        Refine::None => 0.0,
    };
    let peak = column[index];
    let confidence = 2.0 * confidence(column, peak.into(), reference.into());
    Some(PickedReturn { depth: z.first + z.pitch * (index as f64 + offset), peak, confidence })
}

/// Ten times the logarithm of a peak relative to a reference, plus that relative to its column's median: for powers the
/// level in dB, for amplitudes half of it. Where a ray has left the grid, its column is 0, which does not count.
fn confidence(column: &[f32], peak: f64, reference: f64) -> f64 {
    let mut inside: Vec<f32> = column.iter().copied().filter(|v| *v > 0.0).collect();
    let middle = (inside.len() / 2).min(inside.len().saturating_sub(1));
    let median = if inside.is_empty() {
        0.0
    } else {
        f64::from(*inside.select_nth_unstable_by(middle, f32::total_cmp).1)
    };
    let level = |ratio: f64| 10.0 * ratio.max(1e-20).log10();
    level(peak / reference) + level(peak / median.max(peak * 1e-20))
}

/// Whether `column[i]` is a local maximum; the first of equal neighbours counts.
fn is_peak(column: &[f32], i: usize) -> bool {
    (i == 0 || column[i] > column[i - 1]) && (i + 1 == column.len() || column[i] >= column[i + 1])
}

/// Offset of the vertex of the parabola through a peak and its neighbours, in voxels, within ±½.
fn parabola(column: &[f32], i: usize) -> f64 {
    if i == 0 || i + 1 >= column.len() {
        return 0.0;
    }
    let [a, b, c] = [column[i - 1], column[i], column[i + 1]].map(f64::from);
    let curvature = a - 2.0 * b + c;
    if curvature < 0.0 { (0.5 * (a - c) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
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
        *filtered = f64::midpoint(neighbours[(n - 1) / 2], neighbours[n / 2]);
    });
    Ok(filtered)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Axis;
    use num_complex::Complex32;

    /// A volume of 5 × 4 columns, each with Gaussian echoes (depth m, amplitude) of width 12 mm.
    fn volume(echoes: impl Fn(usize) -> Vec<(f64, f64)>) -> Volume {
        let axis = |first, pitch, count| Axis { first, pitch, count };
        let grid = Grid { x: axis(-0.02, 0.01, 5), y: axis(0.0, 0.01, 4), z: axis(1.0, 0.008, 60) };
        let mut samples = vec![Complex32::ZERO; 5 * 4 * 60];
        for pixel in 0..20 {
            for (iz, z) in grid.z.positions().enumerate() {
                let a: f64 = echoes(pixel)
                    .iter()
                    .map(|(depth, amplitude)| amplitude * (-((z - depth) / 0.012f64).powi(2)).exp())
                    .sum();
                samples[iz * 20 + pixel] = Complex32::from_polar(a as f32, z as f32 * 40.0);
            }
        }
        Volume::new(grid, samples)
    }

    #[test]
    fn a_peak_is_found_between_voxels() {
        let v = volume(|_| vec![(1.2031, 1.0)]);
        for (refine, tolerance) in [(Refine::Centroid, 1e-4), (Refine::Parabola, 5e-4), (Refine::None, 4e-3)]
        {
            let options = DepthOptions { refine, ..DepthOptions::new(0.017) };
            let map = locate_depth(&v, &options).expect("valid");
            assert_eq!(map.accepted(), 20);
            for z in &map.picked.depth {
                assert!((f64::from(*z) - 1.2031).abs() <= tolerance, "{refine:?}: {z}");
            }
        }
    }

    #[test]
    fn weak_columns_are_left_out_and_lone_pixels_filtered() {
        let v = volume(|pixel| if pixel % 5 < 3 { vec![(1.2, 1.0)] } else { vec![(1.2, 0.1)] });
        let map = locate_depth(&v, &DepthOptions::new(0.017)).expect("valid");
        for pixel in 0..20 {
            assert_eq!(map.picked.depth[pixel].is_nan(), pixel % 5 >= 3, "{pixel}");
            assert_eq!(map.confidence[pixel].is_nan(), pixel % 5 >= 3);
        }
        let lone = volume(|pixel| if pixel == 7 { vec![(1.2, 1.0)] } else { vec![] });
        assert_eq!(locate_depth(&lone, &DepthOptions::new(0.017)).expect("valid").accepted(), 0);
        let options = DepthOptions { median: 1, ..DepthOptions::new(0.017) };
        assert_eq!(locate_depth(&lone, &options).expect("valid").accepted(), 1);
    }

    #[test]
    fn strongest_and_first_differ_where_the_front_is_weaker() {
        let v = volume(|_| vec![(1.1, 0.5), (1.35, 1.0)]);
        let depth = |pick| {
            let options = DepthOptions { pick, ..DepthOptions::new(0.017) };
            locate_depth(&v, &options).expect("valid").picked.depth[6]
        };
        assert!((depth(Pick::Strongest) - 1.35).abs() < 1e-3 && (depth(Pick::First) - 1.1).abs() < 1e-3);
    }

    #[test]
    fn an_empty_volume_gives_an_empty_map() {
        let map = locate_depth(&volume(|_| vec![]), &DepthOptions::new(0.017)).expect("valid");
        assert_eq!((map.accepted(), map.len()), (0, 20));
    }

    #[test]
    fn the_median_takes_the_middle_of_what_is_there() {
        let n = f64::NAN;
        let depth = [1.0, 2.0, n, 9.0, 3.0, n, n, n, n];
        let filtered = median_filter(depth.to_vec(), 3, 3).expect("room");
        assert_eq!(filtered[4], 2.5);
        assert!(filtered[8].is_nan(), "an empty pixel stays empty");
    }
}
