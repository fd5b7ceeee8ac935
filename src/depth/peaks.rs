//! The peaks of a column of smoothed power that stand out from it.

use super::DepthOptions;
use super::levels::{Levels, is_peak, parabola};
use crate::grid::Axis;

/// Half-width of the surroundings of a peak, and of the peak itself, in Δd.
const SURROUNDINGS: f64 = 6.0;
const OWN: f64 = 1.5;

/// A peak of one pixel's column.
#[derive(Debug, Clone, Copy)]
pub(super) struct Peak {
    pub(super) index: usize,
    /// m.
    pub(super) depth: f64,
    pub(super) power: f32,
    /// dB.
    pub(super) confidence: f64,
}

/// Up to `most` peaks of a column, front to back.
///
/// Peaks are taken strongest first, so that a sidelobe never displaces the surface that caused it; `accepted` has the last
/// word, and is told whether a peak would be the strongest. A further one must also stand out: aliases of the array are
/// narrow in frequency and therefore long in depth, while a surface is short; and two crests of one slope have no valley
/// between them (measured in the tests of the shipped scenes).
pub(super) fn peaks(
    column: &[f32],
    z: &Axis,
    levels: Levels,
    most: usize,
    options: &DepthOptions,
    accepted: impl Fn(&Peak, bool) -> bool,
) -> Vec<Peak> {
    let decibels = |db: f64| 10f64.powf(db / 10.0) as f32;
    let floor = levels.detectable(options.return_threshold_db);
    let mut order: Vec<usize> =
        (0..column.len()).filter(|&i| column[i] > 0.0 && column[i] >= floor && is_peak(column, i)).collect();
    order.sort_by(|a, b| column[*b].total_cmp(&column[*a]).then(a.cmp(b)));
    let Some(strongest) = order.first() else { return Vec::new() };
    let gate = column[*strongest] * decibels(options.return_gate_db);
    let clutter = levels.clutter(column);
    let (contrast, least) =
        (decibels(options.return_contrast_db), options.separation * options.resolution.range);
    let mut kept: Vec<Peak> = Vec::new();
    for index in order {
        if kept.len() >= most || column[index] < gate {
            break;
        }
        let depth = z.first + z.pitch * (index as f64 + parabola(column, index));
        if kept.iter().any(|other| (other.depth - depth).abs() < least) {
            continue;
        }
        let confidence = levels.confidence(column[index], clutter);
        let peak = Peak { index, depth, power: column[index], confidence };
        let stands_out = kept.is_empty()
            || contrast <= 1.0
            || stands_out(column, z.pitch, index, &kept, options, |power| {
                contrast * levels.beyond_noise(power)
            });
        if stands_out && accepted(&peak, kept.is_empty()) {
            kept.push(peak);
        }
    }
    kept.sort_by_key(|peak| peak.index);
    kept
}

/// Whether a peak is as strong as `required` by the median around it and by every valley to a stronger one.
fn stands_out(
    column: &[f32],
    pitch: f64,
    peak: usize,
    stronger: &[Peak],
    options: &DepthOptions,
    required: impl Fn(f32) -> f32,
) -> bool {
    let valley =
        |other: usize| column[peak.min(other)..=peak.max(other)].iter().copied().fold(f32::MAX, f32::min);
    if stronger.iter().any(|other| column[peak] < required(valley(other.index))) {
        return false;
    }
    let cells = |lengths: f64| (lengths * options.resolution.range / pitch).min(column.len() as f64) as usize;
    let (reach, own) = (cells(SURROUNDINGS), cells(OWN));
    let mut around: Vec<f32> = (peak.saturating_sub(reach)..(peak + reach + 1).min(column.len()))
        .filter(|i| i.abs_diff(peak) > own && stronger.iter().all(|other| i.abs_diff(other.index) > own))
        .map(|i| column[i])
        .collect();
    if around.is_empty() {
        return true;
    }
    let middle = around.len() / 2;
    column[peak] >= required(*around.select_nth_unstable_by(middle, f32::total_cmp).1)
}
