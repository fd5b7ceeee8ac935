//! CSV files of one microphone each: a row per frequency, columns as [`TraceColumn`] names them.
//!
//! Fields are separated by commas, semicolons, tabs or blanks; a header line is optional; `#`, `!` and `%` begin comments.

use super::array::NumpyFiles;
use super::traces::Trace;
use super::{parse_number, text_of};
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::files::extension;
use crate::text::quoted;
use crate::wave::phasor;
use num_complex::{Complex32, Complex64};
use std::f64::consts::TAU;
use std::path::Path;

choice! {
    /// What a column of a CSV file is.
    pub enum TraceColumn: "column" {
        /// The frequency.
        Frequency = "f",
        /// The real part; alone, in-phase samples.
        Real = "re",
        /// The imaginary part.
        Imaginary = "im",
        /// The magnitude.
        Magnitude = "mag",
        /// The magnitude in dB, 20 log₁₀.
        Decibel = "db",
        /// The phase in degrees; alone, of magnitude 1.
        Degree = "deg",
        /// The phase in radians; alone, of magnitude 1.
        Radian = "rad",
        /// Nothing that is needed.
        Ignored = "-",
    }
}

/// The forms that a sample can have, as lists of columns.
const FORMS: [&[TraceColumn]; 8] = [
    &[TraceColumn::Real, TraceColumn::Imaginary],
    &[TraceColumn::Real],
    &[TraceColumn::Magnitude, TraceColumn::Degree],
    &[TraceColumn::Magnitude, TraceColumn::Radian],
    &[TraceColumn::Decibel, TraceColumn::Degree],
    &[TraceColumn::Decibel, TraceColumn::Radian],
    &[TraceColumn::Degree],
    &[TraceColumn::Radian],
];

/// Whether columns are complete: at most one frequency, and a sample.
///
/// # Errors
/// Columns that are no sample, or twice there.
pub(crate) fn check_columns(columns: &[TraceColumn]) -> std::result::Result<(), String> {
    let has = |column: &TraceColumn| columns.contains(column);
    let mut used: Vec<_> =
        columns.iter().filter(|c| !matches!(c, TraceColumn::Frequency | TraceColumn::Ignored)).collect();
    used.sort_by_key(|column| column.as_str());
    let complete = FORMS.iter().any(|form| form.len() == used.len() && form.iter().all(has));
    if complete && columns.iter().filter(|column| **column == TraceColumn::Frequency).count() <= 1 {
        return Ok(());
    }
    let words: Vec<&str> = columns.iter().map(|column| column.as_str()).collect();
    Err(format!(
        "found {words:?}; expected \"f\" and one of re, im; db, deg; mag, deg; mag, rad; or re, deg or rad alone; \"-\" for other columns"
    ))
}

/// The fields of a row.
fn fields(line: &str) -> Vec<&str> {
    let marks = [',', ';', '\t'];
    if line.contains(marks) {
        line.split(marks).map(str::trim).collect()
    } else {
        line.split_whitespace().collect()
    }
}

/// Lines that are not blank and no comments, with their numbers.
fn rows(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let lines = (1..).zip(text.lines().map(|line| line.trim_start_matches('\u{feff}').trim()));
    lines.filter(|(_, line)| !line.is_empty() && !line.starts_with(['#', '!', '%']))
}

/// Reads a file's text; without `columns` its header must name them. `unit` is that of the frequencies, Hz.
///
/// # Errors
/// A header of other names, a line without the expected numbers; the message names the line.
pub(super) fn parse(path: &Path, text: &str, columns: &[TraceColumn], unit: f64) -> Result<Trace> {
    let at = |line: usize, problem: String| Error::input(format!("{}:{line}", path.display()), problem);
    let mut rows = rows(text).peekable();
    let header = rows.next_if(|(_, line)| fields(line).iter().all(|field| parse_number(field).is_none()));
    let columns = match (columns, header) {
        ([], Some((number, line))) => {
            let named: Option<Vec<TraceColumn>> =
                fields(line).iter().map(|field| field.parse().ok()).collect();
            named.filter(|columns| check_columns(columns).is_ok()).ok_or_else(|| {
                let problem = format!(
                    "has the header `{}`; say in [import] what its columns are, as in columns = [\"f\", \"re\", \"im\"]",
                    quoted(line)
                );
                at(number, problem)
            })?
        }
        ([], None) => {
            let problem = "has no header; say in [import] what its columns are, as in columns = [\"f\", \"re\", \"im\"]";
            return Err(Error::input(path.display(), problem));
        }
        (typed, _) => {
            check_columns(typed).map_err(|problem| Error::input("import.columns", problem))?;
            typed.to_vec()
        }
    };
    let index = |wanted: TraceColumn| columns.iter().position(|column| *column == wanted);
    let needed =
        columns.iter().rposition(|column| *column != TraceColumn::Ignored).map_or(0, |last| last + 1);
    let frequency = index(TraceColumn::Frequency);
    let (mut frequencies, mut values) = (Vec::new(), Vec::new());
    for (number, line) in rows {
        let row: Vec<Option<f64>> = fields(line).into_iter().map(parse_number).collect();
        let bad = (0..needed)
            .find(|i| columns[*i] != TraceColumn::Ignored && row.get(*i).copied().flatten().is_none());
        if let Some(bad) = bad {
            let problem = format!(
                "has no number in column {} (`{}`); {needed} columns were expected in `{}`",
                bad + 1,
                columns[bad],
                quoted(line)
            );
            return Err(at(number, problem));
        }
        let get = |wanted| index(wanted).and_then(|i| row[i]);
        let magnitude =
            get(TraceColumn::Magnitude).or(get(TraceColumn::Decibel).map(|db| 10_f64.powf(db / 20.0)));
        let angle = get(TraceColumn::Radian).or(get(TraceColumn::Degree).map(f64::to_radians));
        let value = match (magnitude, angle) {
            (Some(magnitude), angle) => Complex64::from_polar(magnitude, angle.unwrap_or(0.0)),
            (None, Some(angle)) => Complex64::cis(angle),
            (None, None) => Complex64::new(
                get(TraceColumn::Real).unwrap_or(0.0),
                get(TraceColumn::Imaginary).unwrap_or(0.0),
            ),
        };
        if let Some(f) = frequency.and_then(|i| row[i]) {
            frequencies.push(f * unit);
        }
        values.push(Complex32::new(value.re as f32, value.im as f32));
    }
    if values.is_empty() {
        return Err(Error::input(path.display(), "has no rows of numbers"));
    }
    let real = index(TraceColumn::Real).is_some() && index(TraceColumn::Imaginary).is_none();
    Ok(Trace { frequencies: frequency.map(|_| frequencies), values, real })
}

/// The numbers of a file's first column, times `unit`; a header is optional.
///
/// # Errors
/// A line that does not begin with a number, a file without numbers.
pub(super) fn first_column(path: &Path, text: &str, unit: f64) -> Result<Vec<f64>> {
    let mut rows = rows(text).peekable();
    let first = |line: &str| fields(line).first().and_then(|field| parse_number(field));
    rows.next_if(|(_, line)| first(line).is_none());
    rows.map(|(number, line)| {
        first(line).map(|value| value * unit).ok_or_else(|| {
            let problem = format!("does not begin with a number: `{}`", quoted(line));
            Error::input(format!("{}:{number}", path.display()), problem)
        })
    })
    .collect()
}

/// The response of each frequency, and the frequencies in Hz where the file has them: a `.csv`, or phases in rad, `.npy`.
///
/// # Errors
/// As [`parse`]; an array of more than one axis, or with values that are not finite.
pub(in crate::acquisition) fn frequency_response(
    path: &Path,
    columns: &[TraceColumn],
    limit: u64,
) -> Result<(Option<Vec<f64>>, Vec<Complex32>)> {
    let problem = match extension(path).as_str() {
        "csv" | "txt" => {
            let trace = parse(path, &text_of(path, limit)?, columns, 1.0)?;
            return Ok((trace.frequencies, trace.values));
        }
        "npy" => {
            let phases = NumpyFiles::open(&[path.to_owned()], limit).and_then(|mut files| files.only())?;
            if phases.shape.iter().filter(|n| **n != 1).count() <= 1
                && phases.data.iter().all(|phase| phase.is_finite())
            {
                return Ok((None, phases.data.iter().map(|phase| phasor(phase / TAU)).collect()));
            }
            "must be one list of finite phases, in rad"
        }
        _ => {
            "is of an unknown kind; .npz (as `calibrate` writes it), .csv, or .npy (phases in rad) was expected"
        }
    };
    Err(Error::input(path.display(), problem))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    fn read(text: &str, columns: &[TraceColumn]) -> Result<Trace> {
        parse(Path::new("a.csv"), text, columns, 1e3)
    }

    #[test]
    fn every_form_gives_the_same_sample() {
        use TraceColumn::{Decibel, Degree, Frequency, Ignored, Imaginary, Magnitude, Radian, Real};
        for (text, columns) in [
            ("f,re,im\n10,0,2\n", &[][..]),
            ("Freq [kHz];Re;Im\n10;0;2", &[Frequency, Real, Imaginary]),
            ("! lab\n10 7 2 90\n", &[Frequency, Ignored, Magnitude, Degree]),
            ("6.020599913\t1.5707963268\t10", &[Decibel, Radian, Frequency]),
        ] {
            let trace = read(text, columns).unwrap();
            assert_eq!((trace.frequencies.unwrap(), trace.real), (vec![10e3], false));
            assert!((trace.values[0] - Complex32::new(0.0, 2.0)).norm() < 1e-6, "{text}: {:?}", trace.values);
        }
        let real = read("3\n-4\n", &[Real]).unwrap();
        assert_eq!((real.frequencies, real.values.len(), real.real), (None, 2, true));
        assert_eq!(first_column(Path::new("f.csv"), "Hz\n1,x\n2\n", 1e3).unwrap(), [1e3, 2e3]);
    }

    #[test]
    fn a_fault_is_named_with_its_line() {
        use TraceColumn::{Decibel, Frequency, Imaginary, Real};
        for (text, columns, parts) in [
            ("Freq,S21\n1,2\n", &[][..], &["a.csv:1", "`Freq,S21`", "columns ="][..]),
            ("1,2,3\n", &[], &["a.csv", "no header", "columns ="]),
            ("1,2,3\n1,2\n", &[Frequency, Real, Imaginary], &["a.csv:2", "column 3", "`im`"]),
            ("1,2,3\n1,a,3\n", &[Frequency, Real, Imaginary], &["a.csv:2", "column 2"]),
            ("f,re,im\n", &[], &["no rows"]),
            ("1,2,3\n", &[Frequency, Real, Decibel], &["columns", "db, deg"]),
        ] {
            assert_names(read(text, columns).unwrap_err().to_string(), parts);
        }
        assert_names(
            first_column(Path::new("f.csv"), "1\n2\nx\n", 1.0).unwrap_err().to_string(),
            &["f.csv:3"],
        );
    }
}
