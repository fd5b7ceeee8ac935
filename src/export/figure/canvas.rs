//! A white canvas of 8-bit RGB pixels, and its PNG encoding.

use crate::error::Result;
use crate::files::write_atomically;
use rustc_hash::FxHashMap;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Width of the lines of frames and ticks, px.
pub(super) const LINE: usize = 2;
/// Pixels in a metre of paper: 300 per inch.
const PER_METRE: u32 = 11_811;

/// Red, green, blue.
pub(super) type Colour = [u8; 3];

/// A picture that is being drawn. Anything outside is clipped.
pub(super) struct Canvas {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Canvas {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self { width, height, rgb: vec![255; 3 * width * height] }
    }

    /// Pictures two to a row.
    pub(super) fn in_pairs(pictures: &[Self]) -> Self {
        let width = |pair: &[Self]| pair.iter().map(|picture| picture.width).sum::<usize>();
        let height = |pair: &[Self]| pair.iter().map(|picture| picture.height).max().unwrap_or(0);
        let pairs = || pictures.chunks(2);
        let mut whole = Self::new(pairs().map(width).max().unwrap_or(0), pairs().map(height).sum());
        let mut top = 0;
        for pair in pairs() {
            let mut left = 0;
            for picture in pair {
                for (y, row) in picture.rgb.chunks_exact(3 * picture.width).enumerate() {
                    let at = 3 * ((top + y) * whole.width + left);
                    whole.rgb[at..at + row.len()].copy_from_slice(row);
                }
                left += picture.width;
            }
            top += height(pair);
        }
        whole
    }

    /// Blends `colour` over one pixel: `cover` 0 leaves it, 1 replaces it. Steps of an eighth are fine enough, and keep the
    /// number of colours small enough for a palette.
    pub(super) fn blend(&mut self, x: i64, y: i64, colour: Colour, cover: f32) {
        let (Ok(x), Ok(y)) = (usize::try_from(x), usize::try_from(y)) else { return };
        if x >= self.width || y >= self.height {
            return;
        }
        let cover = (8.0 * cover.clamp(0.0, 1.0)).round() / 8.0;
        let at = 3 * (y * self.width + x);
        for (old, new) in self.rgb[at..at + 3].iter_mut().zip(colour) {
            let mixed = f32::from(*old) + cover * (f32::from(new) - f32::from(*old));
            *old = mixed.round() as u8;
        }
    }

    /// Fills a rectangle.
    pub(super) fn fill(&mut self, [x, y]: [i64; 2], [width, height]: [usize; 2], colour: Colour) {
        for row in y..y + height as i64 {
            for column in x..x + width as i64 {
                self.blend(column, row, colour, 1.0);
            }
        }
    }

    /// Draws a frame just outside of a rectangle.
    pub(super) fn frame(&mut self, [x, y]: [i64; 2], [width, height]: [usize; 2], colour: Colour) {
        let line = LINE as i64;
        self.fill([x - line, y - line], [width + 2 * LINE, LINE], colour);
        self.fill([x - line, y + height as i64], [width + 2 * LINE, LINE], colour);
        self.fill([x - line, y - line], [LINE, height + 2 * LINE], colour);
        self.fill([x + width as i64, y - line], [LINE, height + 2 * LINE], colour);
    }

    /// Writes the picture as a PNG without a time stamp: the same picture gives the same bytes.
    pub(super) fn write_png(&self, path: &Path) -> Result<()> {
        write_atomically(path, |out| self.encode(out).map_err(io::Error::other))
    }

    fn encode(&self, out: &mut BufWriter<impl Write>) -> std::result::Result<(), png::EncodingError> {
        let mut encoder = png::Encoder::new(out, self.width as u32, self.height as u32);
        let indexed = self.indexed();
        match &indexed {
            Some((palette, _)) => {
                encoder.set_color(png::ColorType::Indexed);
                encoder.set_palette(palette.concat());
            }
            None => encoder.set_color(png::ColorType::Rgb),
        }
        encoder.set_depth(png::BitDepth::Eight);
        // Blocks of equal pixels compress best without a filter.
        encoder.set_compression(png::Compression::High);
        encoder.set_filter(png::Filter::NoFilter);
        encoder.set_pixel_dims(Some(png::PixelDimensions {
            xppu: PER_METRE,
            yppu: PER_METRE,
            unit: png::Unit::Meter,
        }));
        let mut writer = encoder.write_header()?;
        writer.write_image_data(indexed.as_ref().map_or(&self.rgb, |(_, indices)| indices))?;
        writer.finish()
    }

    /// The picture's colours in order of appearance, and the index of each pixel's colour; `None` for more than 256
    /// colours. It halves the size of the file.
    fn indexed(&self) -> Option<(Vec<Colour>, Vec<u8>)> {
        let mut places: FxHashMap<Colour, u8> = FxHashMap::default();
        let mut palette = Vec::new();
        let mut indices = Vec::with_capacity(self.width * self.height);
        for rgb in self.rgb.chunks_exact(3) {
            let colour = [rgb[0], rgb[1], rgb[2]];
            let place = if let Some(place) = places.get(&colour) {
                *place
            } else {
                let place = u8::try_from(palette.len()).ok()?;
                palette.push(colour);
                places.insert(colour, place);
                place
            };
            indices.push(place);
        }
        Some((palette, indices))
    }
}
