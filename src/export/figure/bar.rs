//! The colour bar beside a map.

use super::Scale;
use super::canvas::{Canvas, LINE};
use super::lettering::{self, Align};
use super::style::{INK, LABEL, NUMBER, TICK, TICK_GAP};
use super::ticks::Tick;

/// Width of the colours, px.
pub(super) const WIDTH: usize = 34;
/// Height of a pointed end, px.
const POINT: usize = 30;

/// The layout of a colour bar.
#[derive(Debug)]
pub(super) struct Bar {
    pub(super) ticks: Vec<Tick>,
    /// Height including pointed ends, px.
    pub(super) height: usize,
    /// Whether the lower and the upper end are pointed, because there are values beyond.
    pub(super) pointed: [bool; 2],
}

impl Bar {
    /// Draws the bar with its upper left corner at (`x`, `y`).
    pub(super) fn draw(&self, canvas: &mut Canvas, [x, y]: [i64; 2], scale: &Scale) {
        let Some([low, high]) = scale.range() else { return };
        let [below, above] = self.pointed.map(|pointed| if pointed { POINT } else { 0 });
        let (top, height) = (y + above as i64, self.height - above - below);
        canvas.frame([x, top], [WIDTH, height], INK);
        for row in 0..height {
            let place = 1.0 - (row as f64 + 0.5) / height as f64;
            canvas.fill([x, top + row as i64], [WIDTH, 1], scale.colour(place));
        }
        // The points are drawn over the ends of the frame, so that the bar is one shape.
        if self.pointed[1] {
            draw_point(canvas, [x, top - 1], -1, scale.colour(1.0));
        }
        if self.pointed[0] {
            draw_point(canvas, [x, top + height as i64], 1, scale.colour(0.0));
        }
        let right = x + (WIDTH + LINE) as i64;
        let mut widest = 0.0_f32;
        for tick in &self.ticks {
            let place = (tick.value - low) / (high - low);
            let at = top as f32 + ((1.0 - place) * (height - 1) as f64) as f32;
            canvas.fill([right, at.round() as i64], [TICK, LINE], INK);
            let start = (right + (TICK + TICK_GAP) as i64) as f32;
            lettering::draw(canvas, &tick.label, NUMBER, [start, at.round()], Align::Left);
            widest = widest.max(lettering::width(&tick.label, NUMBER.size));
        }
        let label_x = (right + (TICK + TICK_GAP) as i64) as f32 + widest.ceil() + 32.0;
        let label = lettering::fitted(scale.label(), LABEL.size, self.height as f32 + 40.0);
        lettering::draw_upwards(canvas, &label, LABEL, [label_x, y as f32 + self.height as f32 / 2.0]);
    }
}

/// Draws the triangle for values beyond an end, starting at row `y`, upwards (`direction` −1) or downwards (1).
fn draw_point(canvas: &mut Canvas, [x, y]: [i64; 2], direction: i64, colour: [u8; 3]) {
    let (half, slope) = (WIDTH as f32 / 2.0, (WIDTH as f32 / 2.0).hypot(POINT as f32) / POINT as f32);
    let line = LINE as i64;
    for row in 0..POINT as i64 + line {
        let reach = half * (1.0 - (row as f32 + 0.5) / POINT as f32);
        for column in -line..WIDTH as i64 + line {
            // Distance from the slanted side, positive inside.
            let inside = (reach - (column as f32 + 0.5 - half).abs()) / slope;
            let place = [x + column, y + direction * row];
            canvas.blend(place[0], place[1], INK, inside + LINE as f32 + 0.5);
            canvas.blend(place[0], place[1], colour, inside + 0.5);
        }
    }
}
