//! Reflectors from a CSV file: header `x,y,z,amplitude`, one point per line, in metres, used as they are.
//!
//! The `csv` crate is not used: numbers need none of its quoting, so it would replace only the two lines that split at
//! commas; the header, the numbers and the messages for bad lines are handled here in any case.

use super::Reflectors;
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result, gib};
use crate::files::open_input;
use crate::text::quoted;
use glam::DVec3;
use num_complex::Complex32;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek};
use std::path::{Path, PathBuf};

/// The largest number that is read: far beyond any scene in metres, and amplitudes of it add up within f32.
pub(crate) const LARGEST: f64 = 1e9;

/// The longest line, bytes: a few numbers take a hundredth of it.
const LONGEST_LINE: usize = 1 << 16;

impl Reflectors {
    /// Bytes of a reflector in memory.
    pub(crate) const BYTES_EACH: u64 = (size_of::<DVec3>() + size_of::<Complex32>()) as u64;

    /// Reads a reflector CSV: positions in m and amplitudes, none beyond 10⁹.
    ///
    /// # Errors
    /// A missing file, another header, or a line without the expected numbers; the message names the line.
    pub fn read_csv(path: &Path) -> Result<Self> {
        Self::read_csv_within(path, None)
    }

    /// [`Reflectors::read_csv`] of a list that takes at most `memory` bytes. The file is read line by line, twice: lines
    /// are counted first, so that nothing is allocated for a list that does not fit.
    ///
    /// # Errors
    /// As [`Reflectors::read_csv`]; a list of more lines than fit.
    pub fn read_csv_within(path: &Path, memory: Option<u64>) -> Result<Self> {
        let table = Table::open(path, ["x", "y", "z", "amplitude"])?;
        let rows = table.fitting_rows(Self::BYTES_EACH, memory)?;
        let mut positions = try_with_capacity(rows).ok_or_else(|| does_not_fit(path))?;
        let mut amplitudes = try_with_capacity(rows).ok_or_else(|| does_not_fit(path))?;
        table.read(|[x, y, z, amplitude]| {
            positions.push(DVec3::new(x, y, z));
            amplitudes.push(Complex32::new(amplitude as f32, 0.0));
        })?;
        if positions.is_empty() {
            let problem = "contains no reflectors; at least one line was expected";
            return Err(Error::input(path.display(), problem));
        }
        Self::new(positions, amplitudes).map_err(|error| error.at(path.display()))
    }
}

/// A CSV of numbers under exactly the given header; blank lines and `#` comments are skipped.
#[derive(Debug)]
pub(crate) struct Table<'a, const N: usize> {
    path: PathBuf,
    header: [&'a str; N],
    file: BufReader<File>,
    /// The most rows that the file can have.
    rows: u64,
}

impl<'a, const N: usize> Table<'a, N> {
    /// Opens a file and counts its lines.
    ///
    /// # Errors
    /// A missing file.
    pub(crate) fn open(path: &Path, header: [&'a str; N]) -> Result<Self> {
        let reading = |error| Error::reading(path, error);
        let mut file = BufReader::with_capacity(LONGEST_LINE, open_input(path)?);
        let (mut length, mut ends) = (0_u64, 0_u64);
        loop {
            let bytes = file.fill_buf().map_err(reading)?;
            if bytes.is_empty() {
                break;
            }
            let count = bytes.len();
            ends += bytes.split(|byte| *byte == b'\n').count() as u64 - 1;
            length += count as u64;
            file.consume(count);
        }
        file.rewind().map_err(reading)?;
        // Every number takes a digit at least, and a comma or the end of the line.
        let rows = (ends + 1).min((length + 1) / (2 * N as u64));
        Ok(Self { path: path.to_owned(), header, file, rows })
    }

    /// The most rows that there can be, if so many fit into `memory` bytes.
    ///
    /// # Errors
    /// More rows than that.
    pub(crate) fn fitting_rows(&self, bytes_each: u64, memory: Option<u64>) -> Result<u64> {
        let bytes = self.rows.saturating_mul(bytes_each);
        match memory.filter(|most| bytes > *most) {
            None => Ok(self.rows),
            Some(most) => Err(Error::input(
                self.path.display(),
                format!(
                    "has {} lines, which take {} of memory, and {} may be used here (--memory sets another limit); give \
                     fewer points",
                    self.rows,
                    gib(bytes),
                    gib(most)
                ),
            )),
        }
    }

    /// Passes every row to `take`.
    ///
    /// # Errors
    /// Another header, or a line without the expected numbers; the message names the line.
    pub(crate) fn read(mut self, mut take: impl FnMut([f64; N])) -> Result<()> {
        let path = &self.path;
        let expected = self.header.join(",");
        let refused =
            |number: u64, problem: String| Err(Error::input(format!("{}:{number}", path.display()), problem));
        let (mut line, mut number, mut begun, mut rows) = (Vec::new(), 0, false, 0);
        loop {
            line.clear();
            number += 1;
            let mut some = self.file.by_ref().take(LONGEST_LINE as u64 + 1);
            if some.read_until(b'\n', &mut line).map_err(|error| Error::reading(path, error))? == 0 {
                break;
            }
            if line.len() > LONGEST_LINE {
                return refused(number, format!("is longer than {LONGEST_LINE} bytes; a CSV was expected"));
            }
            let Ok(text) = std::str::from_utf8(&line) else {
                return Err(Error::input(path.display(), "is not UTF-8 text; a CSV was expected"));
            };
            let text = if number == 1 { text.trim_start_matches('\u{feff}') } else { text }.trim();
            if text.is_empty() || text.starts_with('#') {
                continue;
            }
            if !begun {
                if !text.split(',').map(str::trim).eq(self.header) {
                    return refused(number, format!("the first line must be the header `{expected}`"));
                }
                begun = true;
                continue;
            }
            let mut row = [0.0; N];
            let mut fields = text.split(',').map(|field| field.trim().parse().ok());
            for value in &mut row {
                *value = fields.next().flatten().filter(|v: &f64| v.abs() <= LARGEST).unwrap_or(f64::NAN);
            }
            if fields.next().is_some() || row.iter().any(|value| value.is_nan()) {
                let problem = format!(
                    "{N} numbers `{expected}` of at most {LARGEST:e} were expected, found `{}`",
                    quoted(text)
                );
                return refused(number, problem);
            }
            rows += 1;
            if rows > self.rows {
                return refused(number, "the file grew while it was read; try again".to_owned());
            }
            take(row);
        }
        if begun {
            return Ok(());
        }
        let problem = format!("is empty; a header `{expected}` was expected");
        Err(Error::input(path.display(), problem))
    }
}

/// The error for a list that does not fit in memory.
fn does_not_fit(path: &Path) -> Error {
    Error::out_of_memory(format!(
        "{}: its lines do not fit in memory; give fewer points, or free some memory",
        path.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    fn read(text: &str) -> Result<Reflectors> {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        std::fs::write(file.path(), text).expect("writable");
        Reflectors::read_csv(file.path())
    }

    #[test]
    fn numbers_are_read_as_they_are() {
        let reflectors =
            read("# a comment\nx, y,z,amplitude\r\n0.1,-0.2,1.5,0.5\r\n\n1e-1,2,3,-4\n").expect("valid");
        assert_eq!(reflectors.positions()[0], DVec3::new(0.1, -0.2, 1.5));
        assert_eq!(reflectors.amplitudes()[1], Complex32::new(-4.0, 0.0));
    }

    #[test]
    fn a_list_is_held_to_the_memory_there_is() {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        let text = (0..1000).map(|i| format!("{i},0,1,1\n")).collect::<Vec<_>>().concat();
        std::fs::write(file.path(), format!("x,y,z,amplitude\n{text}")).expect("writable");
        let within = |bytes| Reflectors::read_csv_within(file.path(), Some(bytes));
        let all = within(1002 * Reflectors::BYTES_EACH).expect("it fits");
        assert_eq!((all.len(), all.positions.capacity(), all.amplitudes.capacity()), (1000, 1002, 1002));
        let refused = within(999 * Reflectors::BYTES_EACH).expect_err("too many");
        assert_eq!(refused.exit_status(), 2);
        assert_names(refused.to_string(), &["1002 lines", "--memory"]);
        // Blank lines are no points.
        std::fs::write(file.path(), format!("x,y,z,amplitude\n1,2,3,4\n{}", "\n".repeat(1 << 20)))
            .expect("writable");
        assert!(within(1 << 22).expect_err("by their number").to_string().contains("131"));
        assert_eq!(within(1 << 23).expect("it fits").len(), 1);
    }

    #[test]
    fn a_line_without_end_is_refused() {
        let long = format!("x,y,z,amplitude\n{}", "1".repeat(1 << 17));
        assert_names(read(&long).expect_err("long").to_string(), &[":2", "65536"]);
    }

    #[test]
    fn errors_name_the_line() {
        for (text, words) in [
            ("", &["empty", "`x,y,z,amplitude`"][..]),
            ("x,y,z\n1,2,3\n", &[":1", "`x,y,z,amplitude`"]),
            ("x,y,z,amplitude\n1,2,3\n", &[":2", "4", "`1,2,3`"]),
            ("x,y,z,amplitude\n1,2,3,4\n1,2,nan,4\n", &[":3", "4", "`1,2,nan,4`"]),
            ("x,y,z,amplitude\n1,2,3,1e300\n", &[":2", "4", "`1,2,3,1e300`"]),
            ("x,y,z,amplitude\n1,2,3,3e38\n", &[":2", "1e9", "`1,2,3,3e38`"]),
            ("x,y,z,amplitude\n1,2,-2e9,1\n", &[":2", "1e9", "`1,2,-2e9,1`"]),
            ("x,y,z,amplitude\n", &["reflectors"]),
        ] {
            assert_names(read(text).expect_err(text).to_string(), words);
        }
    }
}
