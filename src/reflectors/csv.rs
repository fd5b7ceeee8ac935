//! Reflectors from a CSV file: header `x,y,z,amplitude`, one point per line, in metres, used as they are.
//!
//! The `csv` crate is not used: numbers need none of its quoting, so it would replace only the two lines that split at
//! commas; the header, the numbers and the messages for bad lines are handled here in any case.

use super::Reflectors;
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result};
use crate::text::quoted;
use glam::DVec3;
use num_complex::Complex32;
use std::path::Path;

impl Reflectors {
    /// Reads a reflector CSV.
    ///
    /// # Errors
    /// A missing file, another header, or a line without the expected numbers; the message names the line.
    pub fn read_csv(path: &Path) -> Result<Self> {
        let rows = read_columns(path, ["x", "y", "z", "amplitude"])?;
        if rows.is_empty() {
            let problem = "contains no reflectors; at least one line was expected";
            return Err(Error::input(path.display(), problem));
        }
        let mut positions = try_with_capacity(rows.len() as u64).ok_or_else(|| does_not_fit(path))?;
        let mut amplitudes = try_with_capacity(rows.len() as u64).ok_or_else(|| does_not_fit(path))?;
        for [x, y, z, amplitude] in rows {
            positions.push(DVec3::new(x, y, z));
            amplitudes.push(Complex32::new(amplitude as f32, 0.0));
        }
        Self::new(positions, amplitudes)
    }
}

/// Reads a CSV of finite numbers under exactly the given header; blank lines and `#` comments are skipped.
///
/// # Errors
/// A missing file, another header, or a line without the expected numbers; the message names the line.
pub(crate) fn read_columns<const N: usize>(path: &Path, header: [&str; N]) -> Result<Vec<[f64; N]>> {
    let text = std::fs::read_to_string(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::InvalidData => {
            Error::input(path.display(), "is not UTF-8 text; a CSV was expected")
        }
        _ => Error::reading(path, e),
    })?;
    let mut lines = text
        .trim_start_matches('\u{feff}')
        .lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let expected = header.join(",");
    let refused =
        |number: usize, problem: String| Err(Error::input(format!("{}:{number}", path.display()), problem));
    match lines.next() {
        Some((_, line)) if line.split(',').map(str::trim).eq(header) => {}
        Some((number, _)) => {
            return refused(number, format!("the first line must be the header `{expected}`"));
        }
        None => {
            let problem = format!("is empty; a header `{expected}` was expected");
            return Err(Error::input(path.display(), problem));
        }
    }
    let mut rows = Vec::new();
    for (number, line) in lines {
        let mut row = [0.0; N];
        let mut fields = line.split(',').map(|field| field.trim().parse().ok());
        for value in &mut row {
            // Amplitudes become f32, and lengths in metres are far below its limit.
            *value = fields.next().flatten().filter(|v: &f64| (*v as f32).is_finite()).unwrap_or(f64::NAN);
        }
        if fields.next().is_some() || row.iter().any(|value| value.is_nan()) {
            let problem = format!("{N} finite numbers `{expected}` were expected, found `{}`", quoted(line));
            return refused(number, problem);
        }
        rows.try_reserve(1).map_err(|_| does_not_fit(path))?;
        rows.push(row);
    }
    Ok(rows)
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
    fn errors_name_the_line() {
        for (text, words) in [
            ("", &["empty", "`x,y,z,amplitude`"][..]),
            ("x,y,z\n1,2,3\n", &[":1", "`x,y,z,amplitude`"]),
            ("x,y,z,amplitude\n1,2,3\n", &[":2", "4", "`1,2,3`"]),
            ("x,y,z,amplitude\n1,2,3,4\n1,2,nan,4\n", &[":3", "4", "`1,2,nan,4`"]),
            ("x,y,z,amplitude\n1,2,3,1e300\n", &[":2", "4", "`1,2,3,1e300`"]),
            ("x,y,z,amplitude\n", &["reflectors"]),
        ] {
            assert_names(read(text).expect_err(text).to_string(), words);
        }
    }
}
