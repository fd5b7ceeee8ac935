//! The figure of `autofocus`: the curve of a measure over a parameter, with its width and the value found.

use super::chart::{Chart, ChartAxis, write_charts};
use crate::error::Result;
use crate::focus::Autofocus;
use std::path::Path;

/// Draws how much sharper the image is with some values than with others.
///
/// # Errors
/// As [`crate::files::write_atomically`].
pub(crate) fn write_focus_figure(path: &Path, focus: &Autofocus) -> Result<()> {
    let top = focus.trials.iter().map(|trial| trial.measure).fold(f64::MIN_POSITIVE, f64::max);
    let below = |measure: f64| 100.0 * (measure / top - 1.0);
    let error = focus.standard_error.unwrap_or(0.0);
    let best = [focus.best - error, focus.best, focus.best + error];
    let mut places: Vec<f64> = focus.trials.iter().map(|trial| trial.value).collect();
    places.extend(
        focus.width.iter().chain(&best).filter(|place| (focus.range[0]..=focus.range[1]).contains(*place)),
    );
    places.sort_by(f64::total_cmp);
    places.dedup();
    let curve = places.iter().map(|place| below(on_curve(focus, *place))).collect();
    let half = below(top * (1.0 - 0.5 * focus.contrast));
    let marked = |from: f64, to: f64, level: f64| {
        places.iter().map(|place| if (from..=to).contains(place) { level } else { f64::NAN }).collect()
    };
    let chart = Chart {
        title: format!("{} by {}: {}", focus.parameter, focus.measure, focus.verdict),
        y_label: "below the top / %".into(),
        series: vec![curve, marked(focus.width[0], focus.width[1], half), marked(best[0], best[2], 0.0)],
    };
    let axis = ChartAxis {
        label: format!("{} / {}", focus.parameter, focus.unit),
        places: places.iter().map(f64::to_string).collect(),
        series: vec!["images".into(), "width at half height".into(), "sharpest value".into()],
    };
    write_charts(path, &[chart], &axis)
}

/// The measure between two trials, by a straight line.
fn on_curve(focus: &Autofocus, place: f64) -> f64 {
    let pair = focus.trials.windows(2).find(|pair| (pair[0].value..=pair[1].value).contains(&place));
    pair.map_or(f64::NAN, |pair| {
        let length = pair[1].value - pair[0].value;
        let part = if length > 0.0 { (place - pair[0].value) / length } else { 0.0 };
        pair[0].measure + part * (pair[1].measure - pair[0].measure)
    })
}
