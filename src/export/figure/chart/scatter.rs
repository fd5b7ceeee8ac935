//! Scatter charts: points of two costs, with the front of those that nothing beats.

use super::{ABOVE, BELOW, BOX, COLOURS, LEFT, RIGHT, draw_frame, draw_line, span};
use crate::error::Result;
use crate::export::figure::canvas::{Canvas, Colour};
use crate::export::figure::lettering::{self, Align};
use crate::export::figure::style::{LABEL, NUMBER};
use crate::export::figure::ticks::ticks;
use std::path::Path;

/// One chart of points.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Scatter {
    /// The title above the chart.
    pub(crate) title: String,
    /// Quantity / unit of the columns.
    pub(crate) x_label: String,
    /// Quantity / unit of the rows.
    pub(crate) y_label: String,
    /// Points; those with a number that is not finite are left out.
    pub(crate) points: Vec<[f64; 2]>,
    /// Which of them are on a front of more costs than these two.
    pub(crate) on_front: Vec<bool>,
    /// Which of them are on the front of these two, which is drawn as a line.
    pub(crate) on_line: Vec<bool>,
    /// A letter beside a point.
    pub(crate) letters: Vec<Option<char>>,
}

/// Height of a name below the charts, px.
const NAME: usize = 46;
const OTHERS: Colour = [190, 190, 190];

/// Draws charts, two to a row, and what their letters mean below.
///
/// # Errors
/// As [`crate::files::write_atomically`].
///
/// # Panics
/// Without charts, or if one does not say of each point whether it is on a front.
pub(crate) fn write_scatters(path: &Path, scatters: &[Scatter], names: &[String]) -> Result<()> {
    assert!(!scatters.is_empty(), "a figure needs a chart");
    let columns = scatters.len().min(2);
    let cell = [LEFT + BOX[0] + RIGHT, ABOVE + BOX[1] + BELOW];
    let (width, height) = (columns * cell[0], scatters.len().div_ceil(columns) * cell[1]);
    let key = ["a front of all three", "front of these two", "others"];
    let mut canvas = Canvas::new(width, height + NAME * (names.len() + 2));
    for (i, scatter) in scatters.iter().enumerate() {
        let count = scatter.points.len();
        let lengths = [scatter.on_front.len(), scatter.on_line.len(), scatter.letters.len()];
        assert_eq!(lengths, [count; 3], "one of each per point");
        let corner = [i % columns * cell[0] + LEFT, i / columns * cell[1] + ABOVE];
        draw(&mut canvas, scatter, corner.map(|length| length as i64));
    }
    let mut left = 60.0;
    for (text, colour) in key.into_iter().zip([COLOURS[0], COLOURS[1], OTHERS]) {
        canvas.fill([left as i64, height as i64 + 13], [19, 19], colour);
        lettering::draw(&mut canvas, text, NUMBER, [left + 34.0, height as f32 + 23.0], Align::Left);
        left += 80.0 + lettering::width(text, NUMBER.size);
    }
    for (i, name) in names.iter().enumerate() {
        let name = lettering::fitted(name, NUMBER.size, width as f32 - 120.0);
        let y = (height + NAME + NAME * i) as f32 + 30.0;
        lettering::draw(&mut canvas, &name, NUMBER, [60.0, y], Align::Left);
    }
    canvas.write_png(path)
}

/// From the smallest to the largest value of an axis, from which on it is logarithmic.
const DECADE: f64 = 10.0;

/// Powers of ten from which on they alone have ticks.
const MANY: f64 = 3.0;

/// An axis of costs: from 0, or logarithmic where they are of different orders.
struct CostAxis {
    logarithmic: bool,
    low: f64,
    high: f64,
}

impl CostAxis {
    fn of(values: impl Iterator<Item = f64> + Clone) -> Self {
        let (low, high) = span(values);
        if low > 0.0 && high >= DECADE * low {
            return Self { logarithmic: true, low: low / 1.2, high: high * 1.2 };
        }
        Self { logarithmic: false, low: 0.0, high: 1.08 * if high > 0.0 { high } else { 1.0 } }
    }

    /// The place of a value, between 0 and 1.
    fn place(&self, value: f64) -> f64 {
        if self.logarithmic {
            (value / self.low).ln() / (self.high / self.low).ln()
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }

    /// Ticks by their places: of a logarithmic axis at 1, 2 and 5 times powers of ten, or at these alone if those are many.
    fn ticks(&self, most: usize) -> Vec<(f64, String)> {
        if !self.logarithmic {
            let ticks = ticks(self.low, self.high, most).into_iter();
            return ticks.map(|tick| (self.place(tick.value), tick.label)).collect();
        }
        let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
        let orders = (self.high / self.low).log10();
        let factors: &[f64] = if orders > MANY { &[1.0] } else { &[1.0, 2.0, 5.0] };
        let values =
            decades.flat_map(|power| factors.iter().map(move |factor| (power, factor * 10_f64.powi(power))));
        let within = values.filter(|(_, value)| (self.low..=self.high).contains(value));
        within
            .map(|(power, value)| (self.place(value), format!("{value:.*}", (-power).max(0) as usize)))
            .collect()
    }
}

/// Draws one chart.
fn draw(canvas: &mut Canvas, scatter: &Scatter, [x, y]: [i64; 2]) {
    let [width, height] = BOX.map(|length| length as f64);
    let drawn: Vec<usize> =
        (0..scatter.points.len()).filter(|i| scatter.points[*i].iter().all(|v| v.is_finite())).collect();
    let [across, up] = [0, 1].map(|k| CostAxis::of(drawn.iter().map(move |i| scatter.points[*i][k])));
    let at = |point: [f64; 2]| {
        [x as f64 + width * across.place(point[0]), y as f64 + height * (1.0 - up.place(point[1]))]
    };
    let labels = [&scatter.title, &scatter.x_label, &scatter.y_label].map(String::as_str);
    let [x_ticks, y_ticks] =
        if drawn.is_empty() { [Vec::new(), Vec::new()] } else { [across.ticks(7), up.ticks(6)] };
    draw_frame(canvas, labels, &x_ticks, &y_ticks, [x, y]);
    if drawn.is_empty() {
        let centre = [x as f32 + width as f32 / 2.0, y as f32 + height as f32 / 2.0];
        lettering::draw(canvas, "none", LABEL, centre, Align::Centre);
        return;
    }
    // Of the others first, so that no front is covered.
    let rank = |i: usize| (scatter.on_line[i], scatter.on_front[i]);
    let mut order = drawn.clone();
    order.sort_by_key(|i| rank(*i));
    let mut line: Vec<[f64; 2]> =
        drawn.iter().filter(|i| scatter.on_line[**i]).map(|i| scatter.points[*i]).collect();
    line.sort_by(|a, b| a[0].total_cmp(&b[0]).then(b[1].total_cmp(&a[1])));
    for pair in line.windows(2) {
        // Steps: between two designs the cheaper one is what can be had.
        let corner = [pair[1][0], pair[0][1]];
        draw_line(canvas, at(pair[0]), at(corner), COLOURS[1]);
        draw_line(canvas, at(corner), at(pair[1]), COLOURS[1]);
    }
    for i in order {
        let [px, py] = at(scatter.points[i]).map(|length| length.round() as i64);
        let (half, colour) = match rank(i) {
            (true, _) => (9, COLOURS[1]),
            (false, true) => (8, COLOURS[0]),
            _ => (6, OTHERS),
        };
        canvas.fill([px - half, py - half], [2 * half as usize + 1; 2], colour);
        if let (true, Some(letter)) = (scatter.on_line[i], scatter.letters[i]) {
            let place = [(px + 14) as f32, (py - 20) as f32];
            lettering::draw(canvas, &letter.to_string(), NUMBER, place, Align::Left);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_of_different_orders_is_logarithmic() {
        let labels = |values: [f64; 2]| {
            let axis = CostAxis::of(values.into_iter());
            let ticks = axis.ticks(6);
            assert!(ticks.iter().all(|(place, _)| (0.0..=1.0).contains(place)), "{ticks:?}");
            assert!(ticks.windows(2).all(|pair| pair[0].0 < pair[1].0), "{ticks:?}");
            (axis.logarithmic, ticks.into_iter().map(|(_, label)| label).collect::<Vec<_>>().join(" "))
        };
        assert_eq!(labels([3.0, 89.0]), (true, "5 10 20 50 100".to_owned()));
        assert_eq!(labels([0.04, 0.9]), (true, "0.05 0.1 0.2 0.5 1".to_owned()));
        assert_eq!(labels([0.2, 40_000.0]), (true, "1 10 100 1000 10000".to_owned()));
        assert_eq!(labels([3.0, 9.0]), (false, "0 2 4 6 8".to_owned()));
        assert!(!labels([0.0, 90.0]).0 && !labels([0.0, 0.0]).0);
    }

    #[test]
    fn points_fronts_and_nothing_are_drawn() {
        let folder = tempfile::tempdir().unwrap();
        let scatter = |points: Vec<[f64; 2]>| Scatter {
            title: "error and cost".into(),
            x_label: "microphones".into(),
            y_label: "error / mm".into(),
            on_front: points.iter().map(|p| p[0] < 3.0).collect(),
            on_line: points.iter().map(|p| p[0] < 2.0).collect(),
            letters: points.iter().map(|_| Some('A')).collect(),
            points,
        };
        let cases = [
            ("some", vec![[1.0, 3.0], [1.5, 2.0], [2.5, 2.5], [4.0, 9.0], [f64::NAN, 1.0]]),
            ("one", vec![[0.0, 0.0]]),
            ("none", vec![[f64::NAN, 1.0]]),
            ("nothing", Vec::new()),
        ];
        let mut drawn = Vec::new();
        for (name, points) in cases {
            let path = folder.path().join(name).with_extension("png");
            let names = ["A: array.count = 15".to_owned()];
            let charts = [scatter(points.clone()), scatter(points)];
            write_scatters(&path, &charts, &names).unwrap();
            let first = std::fs::read(&path).unwrap();
            assert!(first.starts_with(b"\x89PNG") && first.len() > 2000, "{name}");
            write_scatters(&path, &charts, &names).unwrap();
            assert_eq!(first, std::fs::read(&path).unwrap(), "results are bit-identical");
            drawn.push(first);
        }
        assert!(drawn[0] != drawn[1] && drawn[1] != drawn[2]);
        assert!(drawn[2] == drawn[3], "a point without a place is not drawn");
    }
}
