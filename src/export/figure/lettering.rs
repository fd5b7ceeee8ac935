//! Text in figures: `DejaVu` Sans, anti-aliased, horizontal or reading upwards.

use super::canvas::{Canvas, Colour};
use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};
use std::sync::LazyLock;

static SANS: LazyLock<FontRef<'static>> = LazyLock::new(|| {
    FontRef::try_from_slice(dejavu::sans::regular()).expect("the font is part of the program")
});

/// The position of a text relative to its anchor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Align {
    Left,
    Centre,
    Right,
}

/// Size (height of a line, px) and colour of a text.
#[derive(Debug, Clone, Copy)]
pub(super) struct TextStyle {
    pub(super) size: f32,
    pub(super) colour: Colour,
}

/// Width of a text, px.
pub(super) fn width(text: &str, size: f32) -> f32 {
    layout(text, size).1
}

/// The text, truncated with an ellipsis if it is wider than `limit` px.
pub(super) fn fitted(text: &str, size: f32, limit: f32) -> String {
    if width(text, size) <= limit {
        return text.to_owned();
    }
    let mut kept: Vec<char> = text.chars().collect();
    while !kept.is_empty() {
        kept.pop();
        let shortened = kept.iter().collect::<String>().trim_end().to_owned() + "…";
        if width(&shortened, size) <= limit {
            return shortened;
        }
    }
    String::new()
}

/// Draws a text that is vertically centred at `y`.
pub(super) fn draw(canvas: &mut Canvas, text: &str, style: TextStyle, [x, y]: [f32; 2], align: Align) {
    place(text, style.size, align, |right, down, cover| {
        canvas.blend(x.round() as i64 + right, y.round() as i64 + down, style.colour, cover);
    });
}

/// Draws a text that reads upwards, centred at (`x`, `y`).
pub(super) fn draw_upwards(canvas: &mut Canvas, text: &str, style: TextStyle, [x, y]: [f32; 2]) {
    place(text, style.size, Align::Centre, |right, down, cover| {
        canvas.blend(x.round() as i64 + down, y.round() as i64 - right, style.colour, cover);
    });
}

/// Each glyph with the position of its left end, px, and the total width.
fn layout(text: &str, size: f32) -> (Vec<(ab_glyph::GlyphId, f32)>, f32) {
    let font = SANS.as_scaled(PxScale::from(size));
    let mut pen = 0.0;
    let mut before = None;
    let glyphs = text
        .chars()
        .map(|c| {
            let id = font.glyph_id(c);
            if let Some(before) = before.replace(id) {
                pen += font.kern(before, id);
            }
            let at = pen;
            pen += font.h_advance(id);
            (id, at)
        })
        .collect();
    (glyphs, pen)
}

/// Calls `dot` for every pixel, right of and below the text's anchor, with its coverage.
fn place(text: &str, size: f32, align: Align, mut dot: impl FnMut(i64, i64, f32)) {
    let (glyphs, width) = layout(text, size);
    let start = match align {
        Align::Left => 0.0,
        Align::Centre => -width / 2.0,
        Align::Right => -width,
    };
    // Digits and capitals are about 0.63 of the line's height; half of that is below the middle.
    let baseline = (0.315 * size).round();
    for (id, at) in glyphs {
        let glyph = id.with_scale_and_position(size, point(start.round() + at, baseline));
        if let Some(outline) = SANS.outline_glyph(glyph) {
            let corner = outline.px_bounds().min;
            outline.draw(|x, y, cover| {
                dot(corner.x as i64 + i64::from(x), corner.y as i64 + i64::from(y), cover);
            });
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_long_text_is_truncated() {
        assert_eq!(fitted("depth", 14.0, 500.0), "depth");
        let cut = fitted("a title that is much too long for its panel", 14.0, 100.0);
        assert!(cut.ends_with('…') && width(&cut, 14.0) <= 100.0, "{cut}");
        assert_eq!(fitted("depth", 14.0, 0.0), "");
    }
}
