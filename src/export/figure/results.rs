//! The figures of a run: amplitude, depth, truth, error.

use super::ticks::{round_up, scientific};
use super::{ColourMap, Panel, Scale, write_figure};
use crate::error::Result;
use crate::grid::{Axis, DepthMap, Raster, View, VolumeView};
use std::borrow::Cow;
use std::path::Path;

/// How far below the peak the amplitude is shown, dB.
const DYNAMIC_RANGE_DB: f64 = 30.0;

/// Draws the volume's amplitude from the front and from above: the maximum along z and the maximum along y, in dB
/// below the peak.
///
/// # Errors
/// As [`write_figure`].
pub fn write_amplitude_figure<'v>(path: &Path, volume: impl Into<VolumeView<'v>>) -> Result<()> {
    let volume = volume.into();
    let grid = &volume.grid;
    let (n_x, n_y) = (grid.x.count, grid.y.count);
    let mut front = vec![0.0_f32; n_x * n_y];
    let mut above = vec![0.0_f32; n_x * grid.z.count];
    for iz in 0..grid.z.count {
        for (i, sample) in volume.plane(iz).iter().enumerate() {
            let power = sample.norm_sqr();
            front[i] = front[i].max(power);
            let column = &mut above[iz * n_x + i % n_x];
            *column = column.max(power);
        }
    }
    let peak = front.iter().copied().filter(|power| power.is_finite()).fold(0.0, f32::max);
    let decibels = |power: Vec<f32>| -> Vec<f32> {
        let level = |power: f32| if peak > 0.0 { 10.0 * (power / peak).log10() } else { f32::NAN };
        power.into_iter().map(level).collect()
    };
    let scale = Scale::levels(DYNAMIC_RANGE_DB);
    let note = match peak.sqrt() {
        peak if (0.01..1e4).contains(&peak) => format!("maximum along z; peak {peak:.3}"),
        peak => format!("maximum along z; peak {}", scientific(peak.into(), 2)),
    };
    let panels = [
        Panel {
            note,
            nothing: "no signal".into(),
            ..Panel::new("from the front", decibels(front), grid.x, grid.y, scale.clone())
        },
        Panel {
            y_label: "z / m".into(),
            upward: true,
            note: "maximum along y; the array is below".into(),
            nothing: "no signal".into(),
            ..Panel::new("from above", decibels(above), grid.x, grid.z, scale)
        },
    ];
    write_figure(path, &panels, 2)
}

/// The minimum and maximum depth in all maps, m, as a common range of colours for their figures, and at least `least` m wide:
/// colours that differ by less than the range resolution would show noise. `None` if no map has an accepted depth.
pub fn depth_range(maps: &[&DepthMap], least: f64) -> Option<[f64; 2]> {
    let depths = || maps.iter().flat_map(|map| &map.picked.depth).copied().filter(|z| z.is_finite());
    let (low, high) = (depths().fold(f32::INFINITY, f32::min), depths().fold(f32::NEG_INFINITY, f32::max));
    let (low, high) = (f64::from(low), f64::from(high));
    let more = (0.5 * (least - (high - low))).max(0.0);
    (low <= high).then_some([low - more, high + more])
}

/// The kind of depths in a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthKind {
    /// Those of a depth map.
    Found,
    /// Those of the second return of each pixel.
    Second,
    /// Those of a ground truth.
    True,
}

/// Draws a depth map or a ground truth; `range` in m is that of the colours, by default that of the map.
///
/// # Errors
/// As [`write_figure`].
pub fn write_depth_figure(
    path: &Path,
    kind: DepthKind,
    map: &DepthMap,
    range: Option<[f64; 2]>,
) -> Result<()> {
    let range = range.or_else(|| depth_range(&[map], 0.0)).unwrap_or([f64::NAN; 2]);
    let scale = Scale::Sequential { map: ColourMap::Viridis, range, label: "depth z / m".into() };
    let (title, what, nothing) = match kind {
        DepthKind::Found => ("depth found", "return", "no return"),
        DepthKind::Second => ("depth of the second return", "second return", "no second return"),
        DepthKind::True => ("true depth", "surface", "no surface"),
    };
    let raster = map.raster();
    let view = raster
        .field_of_view()
        .map_or(String::new(), |[across, up]| format!(" of {across:.1} x {up:.1} degrees"));
    let panel = Panel {
        note: format!("a {what} at {} of {} pixels{view}", map.accepted(), map.len()),
        nothing: nothing.into(),
        ..panel(title, &map.picked.depth, &raster, scale)
    };
    write_figure(path, &[panel], 1)
}

/// Draws what of a scene the array sees, from a ground truth whose `facing` is known: as light as it faces the pixels' rays. The
/// corners of the `array` in x and y, m, are drawn as a frame.
///
/// # Errors
/// As [`write_figure`].
pub fn write_preview_figure(path: &Path, truth: &DepthMap, array: [[f64; 2]; 2], note: &str) -> Result<()> {
    let values = truth.picked.facing.as_deref().unwrap_or(&truth.picked.depth);
    let raster = truth.raster();
    let label = "cosine to the ray".into();
    let scale = Scale::Sequential { map: ColourMap::Grey, range: [-0.15, 1.0], label };
    let panel = Panel {
        note: note.into(),
        nothing: "empty; red: the array".into(),
        frame: (raster.view == View::Orthographic).then_some(array),
        ..panel("the scene as the array sees it", values, &raster, scale)
    };
    write_figure(path, &[panel], 1)
}

/// A panel over the pixels of a map. The axes of a perspective view count pixels, so that it matches a rendered picture.
fn panel<'a>(title: &str, values: impl Into<Cow<'a, [f32]>>, raster: &Raster, scale: Scale) -> Panel<'a> {
    if raster.view == View::Orthographic {
        return Panel::new(title, values, raster.x, raster.y, scale);
    }
    let counted = |axis: &Axis| Axis { first: 0.0, pitch: 1.0, count: axis.count };
    Panel {
        x_label: "column / px".into(),
        y_label: "row / px".into(),
        ..Panel::new(title, values, counted(&raster.x), counted(&raster.y), scale)
    }
}

/// Value of the last colour in a figure of errors, in the unit of the errors: their 95th percentile, rounded up, but at
/// most `most`, above which an error is a false return. NaN if there are no errors.
///
/// Otherwise a few gross errors would give all others the same colour.
pub(super) fn error_limit(errors: &[f32], most: f64) -> f64 {
    let mut sizes: Vec<f32> = errors.iter().map(|e| e.abs()).filter(|e| e.is_finite()).collect();
    sizes.sort_by(f32::total_cmp);
    let usual = sizes.get((sizes.len() * 95 / 100).min(sizes.len().saturating_sub(1)));
    // Errors below a micrometre are rounding.
    usual.map_or(f64::NAN, |&usual| round_up(f64::from(usual).max(1e-6)).min(most))
}

/// Draws depth errors (found − true, m, `[y, x]`, NaN where there is nothing to compare) in mm; `note` is a line of
/// text above the map, such as the median; `resolution` is c/2B in m, NaN if unknown.
///
/// The colours reach the 95th percentile of |error|, at most twice the resolution; larger errors have the last colour, and
/// the end of the bar is pointed.
///
/// # Errors
/// As [`write_figure`].
///
/// # Panics
/// If there is not exactly one error per pixel.
pub fn write_error_figure(
    path: &Path,
    errors: &[f32],
    raster: &Raster,
    resolution: f64,
    note: &str,
) -> Result<()> {
    let millimetres: Vec<f32> = errors.iter().map(|error| 1e3 * error).collect();
    let limit = 1e3 * error_limit(errors, 2.0 * resolution);
    let scale = Scale::Diverging { limit, label: "depth error / mm".into() };
    let panel = Panel {
        note: note.into(),
        nothing: "not compared".into(),
        ..panel("depth error: found − true", millimetres, raster, scale)
    };
    write_figure(path, &[panel], 1)
}
