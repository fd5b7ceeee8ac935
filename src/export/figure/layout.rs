//! The layout of a figure: boxes, ticks, labels, colour bars.
//!
//! Sizes are for print at 300 dots per inch: a figure of one map is as wide as a journal column (about 88 mm), with
//! numbers of 7 points, labels of 8 and titles of 9.

use super::bar::{self, Bar};
use super::canvas::{Canvas, Colour, LINE};
use super::lettering::{self, Align, TextStyle};
use super::style::{INK, LABEL, NUMBER, TICK, TICK_GAP};
use super::ticks::{self, Tick, ticks};
use super::{COLOURS, Panel, Scale};
use crate::grid::Axis;

/// The grey of pixels without a value, distinct from the white in the middle of the diverging colours.
const NOTHING: Colour = [212, 212, 212];
/// The red of a frame over a map.
const FRAME: Colour = [200, 40, 40];
const TITLE: TextStyle = TextStyle { size: 44.0, colour: [0, 0, 0] };
const NOTE: TextStyle = TextStyle { size: 34.0, colour: [84, 84, 84] };

/// Maximum number of columns in a figure.
const MOST_COLUMNS: usize = 8;
/// Minimum width and height of a map's box, px; a thinner one would not be visible.
const THINNEST: usize = 48;
/// Minimum height of a colour bar, px; below, its numbers would touch.
const SHORTEST_BAR: usize = 260;
/// From a map to its colour bar, px.
const BAR_GAP: usize = 32;
const EDGE: usize = 20;

/// The layout of one panel.
struct Plot<'a> {
    panel: &'a Panel<'a>,
    /// Width and height of the map's box, px.
    size: [usize; 2],
    x_ticks: Vec<Tick>,
    y_ticks: Vec<Tick>,
    /// The colour bar, if this panel has one.
    bar: Option<Bar>,
    /// Space on the left and right of the box, px.
    left: usize,
    right: usize,
}

/// Draws the panels in rows of `columns`.
pub(super) fn draw(panels: &[Panel<'_>], columns: usize) -> Canvas {
    let columns = columns.min(MOST_COLUMNS);
    let target = match columns {
        1 | 2 => 640,
        n => (3800 / n - 280).min(440),
    };
    let plots: Vec<Plot> = panels
        .chunks(columns)
        .flat_map(|row| (0..row.len()).map(move |i| (row, i)))
        .map(|(row, i)| {
            // An incomplete row has no bar if the rows above have the same one.
            let above = if i + 1 < columns { panels.get(columns - 1) } else { None };
            let shared =
                [row.get(i + 1), above].into_iter().flatten().any(|other| other.scale == row[i].scale);
            let bar = (!shared).then(|| beyond(panels, &row[i].scale));
            measure(&row[i], bar, target)
        })
        .collect();
    let in_column =
        |column: usize, of: &dyn Fn(&Plot) -> usize| plots.iter().skip(column).step_by(columns).map(of).max();
    let mut boxes_x = Vec::new();
    let mut right_edge = 0;
    for column in 0..columns {
        boxes_x.push(right_edge + in_column(column, &|plot| plot.left).unwrap_or(0));
        right_edge = boxes_x[column] + in_column(column, &|plot| plot.size[0] + plot.right).unwrap_or(0);
    }
    let rows: Vec<&[Plot]> = plots.chunks(columns).collect();
    let height = EDGE + rows.iter().map(|row| above(row) + below(row)).sum::<usize>();
    let mut canvas = Canvas::new(right_edge, height);
    let mut top = EDGE;
    for row in rows {
        top += above(row);
        for (column, plot) in row.iter().enumerate() {
            let start = if column == 0 { 0 } else { boxes_x[column] - plot.left };
            let next_left = row.get(column + 1).map_or(0, |plot| plot.left);
            let end = boxes_x.get(column + 1).map_or(right_edge, |next| next - next_left);
            plot.draw(&mut canvas, [boxes_x[column], top], [start, end]);
        }
        top += below(row);
    }
    canvas
}

/// Height of the text above the boxes of a row, px.
fn above(row: &[Plot]) -> usize {
    let noted = row.iter().any(|plot| !plot.panel.note.is_empty());
    if noted { 124 } else { 80 }
}

/// Height of the boxes of a row and the text below, px.
fn below(row: &[Plot]) -> usize {
    let axis = TICK + TICK_GAP + 34 + 60 + EDGE;
    row.iter()
        .map(|plot| {
            let bar = plot.bar.as_ref().map_or(0, |bar| bar.height + 2 * EDGE);
            (plot.size[1] + axis).max(bar)
        })
        .max()
        .unwrap_or(0)
}

/// Whether any value of the panels with this scale lies below its first colour, or above its last.
fn beyond(panels: &[Panel<'_>], scale: &Scale) -> [bool; 2] {
    let Some([low, high]) = scale.range() else { return [false; 2] };
    // Values that round to an end's colour do not count.
    let margin = 1e-3 * (high - low);
    let values = || {
        let sharing = panels.iter().filter(|panel| panel.scale == *scale);
        sharing.flat_map(|panel| panel.values.iter()).map(|value| f64::from(*value))
    };
    [values().any(|value| value < low - margin), values().any(|value| value > high + margin)]
}

/// The layout of a panel with a box of about `target` px; `bar` is `None` if it has no colour bar, and otherwise which of
/// the bar's ends are pointed.
fn measure<'a>(panel: &'a Panel<'a>, bar: Option<[bool; 2]>, target: usize) -> Plot<'a> {
    let size = box_size(panel, target);
    let [x0, x1] = edges(&panel.x);
    let [y0, y1] = edges(&panel.y);
    let most = [(size[0] / 124).clamp(2, 9), (size[1] / 84).clamp(2, 10)];
    let mut steps = [ticks::step(x0, x1, most[0]), ticks::step(y0, y1, most[1])];
    // Both axes have the same scale, and are easiest to read with the same distance between ticks.
    let common = if steps[0].length > steps[1].length { steps[0] } else { steps[1] };
    if [(x0, x1), (y0, y1)].iter().all(|(low, high)| common.count(*low, *high) >= 3) {
        steps = [common; 2];
    }
    let (x_ticks, y_ticks) = (steps[0].ticks(x0, x1), steps[1].ticks(y0, y1));
    let bar_height = size[1].max(SHORTEST_BAR);
    let bar = bar.zip(panel.scale.range()).map(|(pointed, [low, high])| Bar {
        ticks: ticks(low, high, (bar_height / 84).clamp(2, 9)),
        height: bar_height,
        pointed,
    });
    // A minimum width of the numbers aligns the boxes of different figures.
    let usual = lettering::width("−0.00", NUMBER.size).ceil() as usize;
    let widest = |ticks: &[Tick]| {
        let width = |tick: &Tick| lettering::width(&tick.label, NUMBER.size).ceil() as usize;
        ticks.iter().map(width).fold(usual, usize::max)
    };
    let left = EDGE + 48 + widest(&y_ticks) + TICK_GAP + TICK;
    let right = match &bar {
        Some(bar) => BAR_GAP + bar::WIDTH + TICK + TICK_GAP + widest(&bar.ticks) + 54 + EDGE,
        None => EDGE + 8,
    };
    // The title may be wider than a narrow map; the panel is widened for it, within limits.
    let title = lettering::width(&panel.title, TITLE.size).max(lettering::width(&panel.note, NOTE.size));
    let wanted = (title.ceil() as usize + 2 * EDGE).min(900.max(target));
    let right = right.max(wanted.saturating_sub(left + size[0]));
    Plot { panel, size, x_ticks, y_ticks, bar, left, right }
}

/// The outer edges of an axis' first and last voxel, m.
fn edges(axis: &Axis) -> [f64; 2] {
    [axis.first - axis.pitch / 2.0, axis.first + axis.pitch * (axis.count as f64 - 0.5)]
}

/// Width and height of the map's box, px: true to the map's proportions, whole pixels to a voxel where possible.
fn box_size(panel: &Panel<'_>, target: usize) -> [usize; 2] {
    let limit = [target as f64, 1.2 * target as f64];
    let counts = [panel.x.count, panel.y.count];
    let mut extents = [panel.x.pitch * counts[0] as f64, panel.y.pitch * counts[1] as f64];
    if panel.stretched {
        extents[1] = extents[0];
    }
    let scale = (limit[0] / extents[0]).min(limit[1] / extents[1]);
    let ideal = extents.map(|extent| extent * scale);
    if !ideal.iter().all(|length| length.is_finite()) {
        return [target, target];
    }
    // Whole pixels per column, so that panels over one x axis have the same width. Rounding up may make the box a third
    // larger, which is better than half the size.
    let per_column = panel.x.pitch * scale;
    let whole = if per_column.ceil() / per_column < 1.35 { per_column.ceil() } else { per_column.floor() };
    let size = if whole >= 1.0 { extents.map(|extent| extent * whole / panel.x.pitch) } else { ideal }
        .map(|length| length.round() as usize);
    size.map(|length| length.max(THINNEST))
}

impl Plot<'_> {
    /// Draws the panel with the box's upper left corner at `corner`, between the columns `[start, end]` px.
    fn draw(&self, canvas: &mut Canvas, corner: [usize; 2], [start, end]: [usize; 2]) {
        let [x, y] = corner.map(|length| length as i64);
        let [width, height] = self.size;
        let coverage = self.draw_map(canvas, [x, y]);
        canvas.frame([x, y], self.size, INK);
        if let Some([low, high]) = self.panel.frame {
            let place = |at: [f64; 2]| {
                let [across, down] =
                    [along(&self.panel.x, at[0], width), along(&self.panel.y, at[1], self.size[1])];
                [x + across as i64, y + down as i64]
            };
            let ([left, top], [right, bottom]) = (place(low), place(high));
            let size = [right - left, bottom - top].map(|length| length.max(0) as usize);
            canvas.frame([left, top], size, FRAME);
        }
        self.draw_axes(canvas, [x, y], coverage);
        if let Some(bar) = &self.bar {
            bar.draw(canvas, [x + (width + BAR_GAP) as i64, y], &self.panel.scale);
        }
        if coverage == Coverage::Empty {
            let text = lettering::fitted(&self.panel.nothing, LABEL.size, width as f32 - 8.0);
            let middle = [x as f32 + width as f32 / 2.0, y as f32 + height as f32 / 2.0];
            lettering::draw(canvas, &text, LABEL, middle, Align::Centre);
        }
        let mut line = y as f32 - 36.0;
        for (text, style) in [(&self.panel.note, NOTE), (&self.panel.title, TITLE)] {
            if text.is_empty() {
                continue;
            }
            let text = lettering::fitted(text, style.size, (end - start) as f32 - EDGE as f32);
            // Centred over the box, but within the panel.
            let half = lettering::width(&text, style.size) / 2.0;
            let middle =
                (x as f32 + width as f32 / 2.0).min(end as f32 - half - 8.0).max(start as f32 + half + 8.0);
            lettering::draw(canvas, &text, style, [middle, line], Align::Centre);
            line -= 50.0;
        }
    }

    fn draw_map(&self, canvas: &mut Canvas, [x, y]: [i64; 2]) -> Coverage {
        let panel = self.panel;
        let [width, height] = self.size;
        let Some([low, high]) = panel.scale.range().filter(|_| panel.values.iter().any(|v| !v.is_nan()))
        else {
            canvas.fill([x, y], self.size, NOTHING);
            return Coverage::Empty;
        };
        let colours: Vec<Colour> =
            (0..COLOURS).map(|i| panel.scale.colour(i as f64 / (COLOURS - 1) as f64)).collect();
        let mut coverage = Coverage::Full;
        for row in 0..height {
            let from_top = voxel(row, height, panel.y.count);
            let iy = if panel.upward { panel.y.count - 1 - from_top } else { from_top };
            for column in 0..width {
                let value = panel.values[iy * panel.x.count + voxel(column, width, panel.x.count)];
                let colour = if value.is_nan() {
                    coverage = Coverage::Partial;
                    NOTHING
                } else {
                    let place = (f64::from(value) - low) / (high - low);
                    colours[((COLOURS - 1) as f64 * place.clamp(0.0, 1.0)).round() as usize]
                };
                canvas.blend(x + column as i64, y + row as i64, colour, 1.0);
            }
        }
        coverage
    }

    fn draw_axes(&self, canvas: &mut Canvas, [x, y]: [i64; 2], coverage: Coverage) {
        let panel = self.panel;
        let [width, height] = self.size;
        let bottom = y + height as i64;
        let number_y = (bottom as usize + TICK + TICK_GAP + 17) as f32;
        let mut free_from = f32::NEG_INFINITY;
        for tick in &self.x_ticks {
            let at = x as f32 + along(&panel.x, tick.value, width);
            canvas.fill([at as i64, bottom + LINE as i64], [LINE, TICK], INK);
            let half = lettering::width(&tick.label, NUMBER.size) / 2.0;
            // In a very narrow box not every number fits.
            if at - half > free_from {
                lettering::draw(canvas, &tick.label, NUMBER, [at, number_y], Align::Centre);
                free_from = at + half + 10.0;
            }
        }
        let mut free_below = f32::NEG_INFINITY;
        let mut y_places: Vec<(f32, &Tick)> = self
            .y_ticks
            .iter()
            .map(|tick| {
                let down = along(&panel.y, tick.value, height);
                (if panel.upward { bottom as f32 - 1.0 - down } else { y as f32 + down }, tick)
            })
            .collect();
        y_places.sort_by(|a, b| a.0.total_cmp(&b.0));
        let tick_x = x - (LINE + TICK) as i64;
        for (at, tick) in y_places {
            canvas.fill([tick_x, at as i64], [TICK, LINE], INK);
            if at - 17.0 > free_below {
                let end = (tick_x - TICK_GAP as i64) as f32;
                lettering::draw(canvas, &tick.label, NUMBER, [end, at], Align::Right);
                free_below = at + 17.0;
            }
        }
        let label_y = number_y + 50.0;
        let middle = x as f32 + width as f32 / 2.0;
        lettering::draw(canvas, &panel.x_label, LABEL, [middle, label_y], Align::Centre);
        let label_x = (x - self.left as i64) as f32 + EDGE as f32 + 20.0;
        lettering::draw_upwards(canvas, &panel.y_label, LABEL, [label_x, y as f32 + height as f32 / 2.0]);
        if coverage == Coverage::Partial {
            self.draw_key(canvas, [x + width as i64, label_y as i64]);
        }
    }

    /// Draws the key of the grey at the lower right below the box, if there is space next to the axis' label.
    fn draw_key(&self, canvas: &mut Canvas, [right, middle]: [i64; 2]) {
        let text = &self.panel.nothing;
        let text_width = lettering::width(text, NOTE.size).ceil();
        let label = lettering::width(&self.panel.x_label, LABEL.size);
        if text_width + 44.0 + label / 2.0 + 16.0 > self.size[0] as f32 / 2.0 {
            return;
        }
        lettering::draw(canvas, text, NOTE, [right as f32, middle as f32], Align::Right);
        let swatch = [right - text_width as i64 - 38, middle - 12];
        canvas.fill(swatch, [24, 24], NOTHING);
        canvas.frame(swatch, [24, 24], [150, 150, 150]);
    }
}

/// The share of a map that has values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Coverage {
    Empty,
    Partial,
    Full,
}

/// The voxel that covers a pixel of the box.
fn voxel(pixel: usize, pixels: usize, count: usize) -> usize {
    (((pixel as f64 + 0.5) * count as f64 / pixels as f64) as usize).min(count - 1)
}

/// The place of a position in m along a box of this many pixels, px.
fn along(axis: &Axis, position: f64, pixels: usize) -> f32 {
    let [start, end] = edges(axis);
    let place = ((position - start) / (end - start)).clamp(0.0, 1.0);
    (place * (pixels - 1) as f64).round() as f32
}
