//! Line charts: one or several series of numbers over a key's values.

mod scatter;

pub(crate) use scatter::{Scatter, write_scatters};

use super::canvas::{Canvas, Colour, LINE};
use super::lettering::{self, Align, TextStyle};
use super::style::{INK, LABEL, NUMBER, TICK, TICK_GAP};
use super::ticks::ticks;
use crate::error::Result;
use std::path::Path;

/// One chart of a figure.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Chart {
    /// The title above the chart.
    pub(crate) title: String,
    /// Quantity / unit of the rows.
    pub(crate) y_label: String,
    /// For each series one number per place on the x axis; NaN where there is none.
    pub(crate) series: Vec<Vec<f64>>,
}

/// The x axis and the names of the series, common to the charts of a figure.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ChartAxis {
    /// The label below each chart.
    pub(crate) label: String,
    /// The text at each place; if all of them are numbers, they determine the positions.
    pub(crate) places: Vec<String>,
    /// A name per series; not shown if there is only one.
    pub(crate) series: Vec<String>,
}

const BOX: [usize; 2] = [800, 480];
const LEFT: usize = 190;
const RIGHT: usize = 60;
const ABOVE: usize = 96;
const BELOW: usize = 150;
/// Height of a line of the legend, px.
const NAME: usize = 46;
/// Most places whose points are marked; marks of more would hide their lines.
const MARKED: usize = 60;
const GRID: Colour = [228, 228, 228];
const TITLE: TextStyle = TextStyle { size: 40.0, colour: [0, 0, 0] };

/// Colours that are distinct with most kinds of colour vision (Okabe and Ito).
const COLOURS: [Colour; 7] = [
    [0, 114, 178],
    [213, 94, 0],
    [0, 158, 115],
    [204, 121, 167],
    [230, 159, 0],
    [86, 180, 233],
    [90, 90, 90],
];

/// Draws charts, two to a row, over one x axis, with the names of their lines below.
///
/// # Errors
/// As [`crate::files::write_atomically`].
///
/// # Panics
/// Without charts or places, or if a series does not have one number per place.
pub(crate) fn write_charts(path: &Path, charts: &[Chart], axis: &ChartAxis) -> Result<()> {
    assert!(!charts.is_empty() && !axis.places.is_empty(), "a figure needs a chart, and its axis a place");
    for series in charts.iter().flat_map(|chart| &chart.series) {
        assert_eq!(series.len(), axis.places.len(), "one number per place");
    }
    draw(charts, axis).write_png(path)
}

/// Most places along a chart of a curve; of more, the highest of each group is drawn, so that no peak is lost.
const PLACES: usize = 400;

/// A chart of one or several curves over numbers, with its labels along x and y.
pub(super) fn line(
    title: &str,
    [x_label, y_label]: [&str; 2],
    places: &[f64],
    series: &[(String, Vec<f64>)],
) -> Canvas {
    let group = places.len().div_ceil(PLACES);
    let highest = |values: &[f64]| -> Vec<f64> {
        values.chunks(group).map(|v| v.iter().copied().fold(f64::NAN, f64::max)).collect()
    };
    let axis = ChartAxis {
        label: x_label.into(),
        places: places.chunks(group).map(|places| places[places.len() / 2].to_string()).collect(),
        series: series.iter().map(|(name, _)| name.clone()).collect(),
    };
    let series = series.iter().map(|(_, values)| highest(values)).collect();
    draw(&[Chart { title: title.into(), y_label: y_label.into(), series }], &axis)
}

/// The charts as a picture; see [`write_charts`].
pub(super) fn draw(charts: &[Chart], axis: &ChartAxis) -> Canvas {
    let columns = charts.len().min(2);
    let rows = charts.len().div_ceil(columns);
    let cell = [LEFT + BOX[0] + RIGHT, ABOVE + BOX[1] + BELOW];
    let named = if axis.series.len() > 1 { axis.series.len().min(24) } else { 0 };
    let width = columns * cell[0];
    // As many names to a row as fit.
    let longest =
        axis.series.iter().take(named).map(|name| lettering::width(name, NUMBER.size)).fold(0.0, f32::max);
    let in_row = ((width as f32 / (longest + 140.0)) as usize).clamp(1, (width / 520).max(1));
    let legend = if named > 0 { NAME * named.div_ceil(in_row) + NAME / 2 } else { 0 };
    let mut canvas = Canvas::new(width, rows * cell[1] + legend);
    let places = AxisLayout::of(axis);
    for (i, chart) in charts.iter().enumerate() {
        let corner = [i % columns * cell[0] + LEFT, i / columns * cell[1] + ABOVE];
        draw_chart(&mut canvas, chart, axis, &places, corner.map(|length| length as i64));
    }
    for i in 0..named {
        let at = [
            (i % in_row * (width / in_row) + 50) as i64,
            (rows * cell[1] + NAME / 2 + i / in_row * NAME) as i64,
        ];
        canvas.fill([at[0], at[1] - 3], [48, 7], COLOURS[i % COLOURS.len()]);
        let name = lettering::fitted(&axis.series[i], NUMBER.size, (width / in_row) as f32 - 130.0);
        lettering::draw(&mut canvas, &name, NUMBER, [at[0] as f32 + 62.0, at[1] as f32], Align::Left);
    }
    canvas
}

/// The positions of the places along a box, 0 to 1, and the ticks below.
struct AxisLayout {
    /// Whether the places are numbers, which are connected by lines.
    numbers: bool,
    at: Vec<f64>,
    ticks: Vec<(f64, String)>,
}

impl AxisLayout {
    fn of(axis: &ChartAxis) -> Self {
        let numbers: Option<Vec<f64>> =
            axis.places.iter().map(|p| p.parse().ok().filter(|v: &f64| v.is_finite())).collect();
        match numbers.map(|numbers| (span(numbers.iter().copied()), numbers)) {
            Some(((low, high), numbers)) if high > low => {
                let place = |v: f64| 0.04 + 0.92 * (v - low) / (high - low);
                let ticks = ticks(low, high, 7).into_iter().map(|tick| (place(tick.value), tick.label));
                Self {
                    numbers: true,
                    at: numbers.iter().map(|v| place(*v)).collect(),
                    ticks: ticks.collect(),
                }
            }
            _ => {
                let n = axis.places.len();
                let at: Vec<f64> = (0..n).map(|i| (i as f64 + 0.5) / n as f64).collect();
                let every = n.div_ceil(6);
                let room = BOX[0] as f32 * every as f32 / n as f32 - 12.0;
                let ticks = (0..n)
                    .step_by(every)
                    .map(|i| (at[i], lettering::fitted(&axis.places[i], NUMBER.size, room)));
                Self { numbers: false, ticks: ticks.collect(), at }
            }
        }
    }
}

/// Minimum and maximum of some values.
fn span(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
}

fn draw_chart(canvas: &mut Canvas, chart: &Chart, axis: &ChartAxis, places: &AxisLayout, [x, y]: [i64; 2]) {
    let [width, height] = BOX.map(|length| length as f64);
    let bottom = y + BOX[1] as i64;
    let (low, high) = span(chart.series.iter().flatten().copied().filter(|v| v.is_finite()));
    let labels = [&chart.title, &axis.label, &chart.y_label].map(String::as_str);
    if low > high {
        draw_frame(canvas, labels, &places.ticks, &[], [x, y]);
        let centre = [x as f32 + BOX[0] as f32 / 2.0, y as f32 + BOX[1] as f32 / 2.0];
        lettering::draw(canvas, "none", LABEL, centre, Align::Centre);
    } else {
        // Positive quantities are shown from 0; levels in dB have no natural origin.
        let (low, high) = if low >= 0.0 {
            (0.0, 1.08 * high.max(1e-12))
        } else {
            (low - 0.08 * (high - low).max(2.0), high + 0.08 * (high - low).max(2.0))
        };
        let down = |v: f64| bottom as f64 - height * (v - low) / (high - low);
        let up = ticks(low, high, 6).into_iter().map(|tick| ((tick.value - low) / (high - low), tick.label));
        draw_frame(canvas, labels, &places.ticks, &up.collect::<Vec<_>>(), [x, y]);
        for (series, colour) in chart.series.iter().zip(COLOURS.iter().cycle()) {
            let points: Vec<Option<[f64; 2]>> = series
                .iter()
                .zip(&places.at)
                .map(|(v, at)| v.is_finite().then(|| [x as f64 + at * width, down(*v)]))
                .collect();
            let marked = !places.numbers || points.len() <= MARKED;
            for pair in points.windows(2).filter(|_| places.numbers) {
                if let [Some(from), Some(to)] = pair {
                    draw_line(canvas, *from, *to, *colour);
                }
            }
            for [px, py] in points.into_iter().flatten().filter(|_| marked) {
                canvas.fill([px.round() as i64 - 7, py.round() as i64 - 7], [15, 15], *colour);
            }
        }
    }
}

/// A chart without its values: title, labels along x and y, ticks by their places between 0 and 1, and the box.
fn draw_frame(
    canvas: &mut Canvas,
    [title, x_label, y_label]: [&str; 3],
    x_ticks: &[(f64, String)],
    y_ticks: &[(f64, String)],
    [x, y]: [i64; 2],
) {
    let [width, height] = BOX.map(|length| length as f64);
    let bottom = y + BOX[1] as i64;
    let middle = [x as f32 + BOX[0] as f32 / 2.0, y as f32 - 40.0];
    lettering::draw(canvas, title, TITLE, middle, Align::Centre);
    lettering::draw(canvas, x_label, LABEL, [middle[0], bottom as f32 + 100.0], Align::Centre);
    lettering::draw_upwards(canvas, y_label, LABEL, [(x - 150) as f32, y as f32 + BOX[1] as f32 / 2.0]);
    for (at, text) in y_ticks {
        let at = (bottom as f64 - height * at).round() as i64;
        canvas.fill([x, at], [BOX[0], LINE], GRID);
        lettering::draw(canvas, text, NUMBER, [(x - 14) as f32, at as f32], Align::Right);
    }
    for (at, text) in x_ticks {
        let at = x as f64 + at * width;
        canvas.fill([at as i64, bottom + LINE as i64], [LINE, TICK], INK);
        lettering::draw(
            canvas,
            text,
            NUMBER,
            [at as f32, bottom as f32 + (LINE + TICK + TICK_GAP + 20) as f32],
            Align::Centre,
        );
    }
    canvas.frame([x, y], BOX, INK);
}

/// A line five pixels thick.
fn draw_line(canvas: &mut Canvas, from: [f64; 2], to: [f64; 2], colour: Colour) {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let steps = (2.0 * dx.hypot(dy)).ceil().max(1.0);
    for i in 0..=steps as usize {
        let t = i as f64 / steps;
        let (px, py) = (from[0] + t * dx, from[1] + t * dy);
        canvas.fill([px.round() as i64 - 2, py.round() as i64 - 2], [5, 5], colour);
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn charts_of_numbers_words_and_nothing_are_drawn() {
        let folder = tempfile::tempdir().unwrap();
        let chart = |series: Vec<Vec<f64>>| Chart { title: "width".into(), y_label: "mm".into(), series };
        for (name, places) in [("numbers", ["1", "2.5"]), ("words", ["grid", "spiral"]), ("same", ["1", "1"])]
        {
            let axis = ChartAxis {
                label: "array.extent".into(),
                places: places.map(str::to_owned).to_vec(),
                series: vec!["a".into(), "b".into()],
            };
            let charts = [
                chart(vec![vec![1.0, 2.0], vec![0.0, f64::NAN]]),
                chart(vec![vec![-20.0, -10.0], vec![-15.0, -15.0]]),
                chart(vec![vec![f64::NAN; 2]; 2]),
            ];
            let path = folder.path().join(name).with_extension("png");
            write_charts(&path, &charts, &axis).unwrap();
            let first = std::fs::read(&path).unwrap();
            assert!(first.starts_with(b"\x89PNG") && first.len() > 2000, "{name}");
            write_charts(&path, &charts, &axis).unwrap();
            assert_eq!(first, std::fs::read(&path).unwrap(), "results are bit-identical");
        }
    }
}
