//! Reads the numbers of a PLY file in order, whatever its format.

use super::RowResult;
use crate::files::ply::{Element, Format, Scalar};
use crate::text::quoted;

/// Reads one number after another as f64, which represents every type of them exactly.
#[derive(Debug)]
pub(super) struct Source<'a> {
    format: Format,
    rest: &'a [u8],
    line: usize,
}

impl<'a> Source<'a> {
    /// The numbers in `bytes`, which follow `lines` lines of header.
    pub(super) fn new(format: Format, bytes: &'a [u8], lines: usize) -> Self {
        Self { format, rest: bytes, line: lines + 1 }
    }

    /// The next number; only binary files need its type.
    pub(super) fn next(&mut self, scalar: Scalar) -> RowResult<f64> {
        if self.format == Format::Ascii {
            return self.next_word();
        }
        let number = scalar.number(self.rest, self.format).ok_or_else(cut_short)?;
        self.rest = &self.rest[scalar.size()..];
        Ok(number)
    }

    /// Maximum number of rows of an element: those declared, or as many as the remaining bytes can contain.
    pub(super) fn rows_of(&self, element: &Element) -> usize {
        let possible = self.rest.len() as u64 / element.least_row(self.format).max(1);
        element.count.min(possible) as usize
    }

    /// The line that was read last, in a text file.
    pub(super) fn line(&self) -> Option<usize> {
        (self.format == Format::Ascii).then_some(self.line)
    }

    /// Number of bytes left, not counting the white space around a text; `None` at the end.
    pub(super) fn rest(&self) -> Option<usize> {
        let rest = if self.format == Format::Ascii { self.rest.trim_ascii() } else { self.rest };
        (!rest.is_empty()).then_some(rest.len())
    }

    fn next_word(&mut self) -> RowResult<f64> {
        while let Some((b' ' | b'\t' | b'\r' | b'\x0c' | b'\n', rest)) = self.rest.split_first() {
            self.line += usize::from(self.rest[0] == b'\n');
            self.rest = rest;
        }
        if self.rest.is_empty() {
            return Err(cut_short());
        }
        let end = self.rest.iter().position(u8::is_ascii_whitespace).unwrap_or(self.rest.len());
        let (word, rest) = self.rest.split_at(end);
        self.rest = rest;
        let number = std::str::from_utf8(word).ok().and_then(|word| word.parse().ok());
        number.ok_or_else(|| {
            let word = quoted(&String::from_utf8_lossy(word));
            format!("has `{word}` where a number was expected")
        })
    }
}

fn cut_short() -> String {
    "is missing or incomplete: the file is cut short, or its header declares too much".to_owned()
}
