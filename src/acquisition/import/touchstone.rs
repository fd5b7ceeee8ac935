//! Touchstone: S-parameters over frequency, as network analysers write them, version 1 and the plain form of version 2.
//!
//! ```text
//! ! a comment
//! # GHz S RI R 50
//! 1.0  0.01 0.02  0.5 -0.1  0.5 -0.1  0.02 0.01
//! ```
//!
//! A record is a frequency and N² parameters of two numbers each; N is in the file's extension, `.s2p`. Records of more than
//! two ports are wrapped over lines. Of two ports the order is S11 S21 S12 S22, of others row by row.

use super::parse_number;
use super::traces::Trace;
use crate::error::{Error, Result};
use crate::text::quoted;
use num_complex::{Complex32, Complex64};
use std::path::Path;

/// Maximum number of ports; more are mistakes.
const MOST_PORTS: usize = 256;

/// How two numbers are a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
enum PairFormat {
    RealImaginary,
    MagnitudeAngle,
    DecibelAngle,
}

impl PairFormat {
    fn value(self, [a, b]: [f64; 2]) -> Complex64 {
        match self {
            Self::RealImaginary => Complex64::new(a, b),
            Self::MagnitudeAngle => Complex64::from_polar(a, b.to_radians()),
            Self::DecibelAngle => Complex64::from_polar(10_f64.powf(a / 20.0), b.to_radians()),
        }
    }
}

/// The number of ports according to the extension, `s2p`; `None` if it is no Touchstone file's.
pub(super) fn ports(extension: &str) -> Option<usize> {
    let digits = extension.strip_prefix('s')?.strip_suffix('p')?;
    digits.parse().ok().filter(|n| (1..=MOST_PORTS).contains(n) && digits.bytes().all(|b| b.is_ascii_digit()))
}

/// Row and column of a parameter, counted from 1: `S21`, or `S10,1` where a number has two digits.
fn indices(parameter: &str) -> Option<[usize; 2]> {
    let digits = parameter.trim().strip_prefix(['S', 's'])?;
    let number = |text: &str| text.parse().ok().filter(|n| *n > 0);
    if let Some((row, column)) = digits.split_once([',', '_']) {
        return Some([number(row)?, number(column)?]);
    }
    if digits.len() == 2 && digits.is_ascii() {
        return Some([number(&digits[..1])?, number(&digits[1..])?]);
    }
    None
}

/// Everything before the data.
#[derive(Debug)]
struct Head {
    ports: usize,
    /// Hz per unit of the frequencies.
    unit: f64,
    format: PairFormat,
    /// Of two ports: whether S21 comes before S12.
    columns_first: bool,
    reading: Reading,
}

/// What the next lines are.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Reading {
    /// Data, or keywords that nobody needs; the files of version 1 have only data.
    Data,
    /// Keywords of version 2, before its data.
    Keywords,
}

impl Head {
    /// `# GHz S MA R 50`, words in any order and case, each with a default.
    fn option_line(&mut self, words: &str) -> std::result::Result<(), String> {
        let words: Vec<String> = words.split_whitespace().map(str::to_ascii_lowercase).collect();
        let mut words = words.iter().map(String::as_str);
        while let Some(word) = words.next() {
            match word {
                "hz" => self.unit = 1.0,
                "khz" => self.unit = 1e3,
                "mhz" => self.unit = 1e6,
                "ghz" => self.unit = 1e9,
                "s" => {}
                "y" | "z" | "g" | "h" => {
                    return Err(format!(
                        "holds {}-parameters; S-parameters were expected: export those",
                        word.to_uppercase()
                    ));
                }
                "ri" => self.format = PairFormat::RealImaginary,
                "ma" => self.format = PairFormat::MagnitudeAngle,
                "db" => self.format = PairFormat::DecibelAngle,
                // The reference resistance, of each port in version 1.1.
                "r" => drop(words.next()),
                other if other.parse::<f64>().is_ok() => {}
                other => {
                    return Err(format!(
                        "has `{}` in its option line; one like `# GHz S RI R 50` was expected",
                        quoted(other)
                    ));
                }
            }
        }
        Ok(())
    }

    /// A line in brackets, of version 2.
    fn keyword(&mut self, line: &str) -> std::result::Result<(), String> {
        let (name, value) = line.split_once(']').ok_or("has a `[` without `]`")?;
        let (name, value) = (name.trim().to_ascii_lowercase(), value.trim().to_ascii_lowercase());
        match (name.as_str(), value.as_str()) {
            ("version", "2.0" | "2.1") => self.reading = Reading::Keywords,
            ("version", other) => {
                return Err(format!("is of Touchstone version {}; 1 and 2.0 are read", quoted(other)));
            }
            ("number of ports", n) => {
                let n = n.parse().ok().filter(|n| (1..=MOST_PORTS).contains(n));
                self.ports = n.ok_or_else(|| format!("has no number of ports from 1 to {MOST_PORTS}"))?;
            }
            ("two-port data order" | "two-port order", order) => self.columns_first = order == "21_12",
            ("matrix format", "full")
            | (
                "number of frequencies"
                | "number of noise frequencies"
                | "reference"
                | "begin information"
                | "end information",
                _,
            ) => {}
            ("network data", _) => self.reading = Reading::Data,
            (name, value) => {
                let what = quoted(format!("[{name}] {value}").trim());
                return Err(format!("has `{what}`, which is not read here; export Touchstone version 1"));
            }
        }
        Ok(())
    }

    /// The place of a parameter among those of a record.
    fn place(&self, path: &Path, parameter: Option<&str>) -> Result<usize> {
        let n = self.ports;
        let parameter = match (parameter, n) {
            (Some(typed), _) => typed,
            (None, 1) => "S11",
            (None, 2) => "S21",
            (None, _) => {
                let problem =
                    format!("has {n} ports; `parameter` in [import] must say which is meant, as in \"S21\"");
                return Err(Error::input(path.display(), problem));
            }
        };
        let found = indices(parameter).filter(|ij| ij.iter().all(|i| *i <= n));
        let [row, column] = found.ok_or_else(|| {
            let problem = format!(
                "has {n} port{}, and `parameter` is \"{}\"; one from S11 to S{n}{}{n} was expected",
                if n == 1 { "" } else { "s" },
                quoted(parameter),
                if n > 9 { "," } else { "" },
            );
            Error::input(path.display(), problem)
        })?;
        let [row, column] = [row - 1, column - 1];
        Ok(if n == 2 && self.columns_first { column * n + row } else { row * n + column })
    }
}

/// Reads one parameter of a file's text; the place of an error is its line.
///
/// # Errors
/// Another kind of parameters, words in place of numbers, records that are too short or too long, frequencies that do not
/// ascend, a parameter that the file does not have.
pub(super) fn parse(path: &Path, text: &str, ports: usize, parameter: Option<&str>) -> Result<Trace> {
    let mut head = Head {
        ports,
        unit: 1e9,
        format: PairFormat::MagnitudeAngle,
        columns_first: true,
        reading: Reading::Data,
    };
    // Later option lines are ignored, as the format demands.
    let mut has_options = false;
    let (mut frequencies, mut values) = (Vec::new(), Vec::new());
    let mut record: Vec<f64> = Vec::new();
    let (mut place, mut last_line) = (None, 0);
    for (number, line) in (1..).zip(text.lines()) {
        let at = |problem: String| Error::input(format!("{}:{number}", path.display()), problem);
        let line = line.split('!').next().unwrap_or_default().trim().trim_start_matches('\u{feff}');
        if line.is_empty() {
            continue;
        }
        if let Some(words) = line.strip_prefix('#') {
            if !has_options {
                head.option_line(words).map_err(at)?;
            }
            has_options = true;
            continue;
        }
        if let Some(keyword) = line.strip_prefix('[') {
            let end = keyword.to_ascii_lowercase();
            if end.starts_with("end]") || end.starts_with("noise data]") {
                break;
            }
            head.keyword(keyword).map_err(at)?;
            continue;
        }
        if head.reading == Reading::Keywords {
            // The resistances of [Reference] may continue on the next lines.
            continue;
        }
        let of_record = 1 + 2 * head.ports * head.ports;
        // Noise parameters follow those of two ports, five numbers a line, from a lower frequency on.
        if record.is_empty() && head.ports == 2 && line.split_whitespace().count() == 5 {
            break;
        }
        for word in line.split_whitespace() {
            if record.len() == of_record {
                return Err(at(format!(
                    "has more than the {of_record} numbers of a frequency and {} ports; check the extension .s{}p",
                    head.ports, head.ports
                )));
            }
            record.push(parse_number(word).ok_or_else(|| {
                at(format!("has `{}` where a number was expected; comments begin with `!`", quoted(word)))
            })?);
        }
        last_line = number;
        if record.len() == of_record {
            let wanted = match place {
                Some(place) => place,
                None => *place.insert(head.place(path, parameter)?),
            };
            let frequency = record[0] * head.unit;
            if frequencies.last().is_some_and(|last| frequency <= *last) {
                return Err(at(format!("has the frequency {frequency} Hz, which does not ascend")));
            }
            let value = head.format.value([record[1 + 2 * wanted], record[2 + 2 * wanted]]);
            frequencies.push(frequency);
            values.push(Complex32::new(value.re as f32, value.im as f32));
            record.clear();
        }
    }
    let place = |line: usize| format!("{}:{line}", path.display());
    if !record.is_empty() {
        let problem = format!(
            "ends a record of {} numbers; a frequency and {} ports have {}",
            record.len(),
            head.ports,
            1 + 2 * head.ports * head.ports
        );
        return Err(Error::input(place(last_line), problem));
    }
    if frequencies.is_empty() {
        return Err(Error::input(
            path.display(),
            "has no data; a line `# GHz S RI R 50` and numbers were expected",
        ));
    }
    Ok(Trace { frequencies: Some(frequencies), values, real: false })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    fn read(text: &str, ports: usize, parameter: Option<&str>) -> Result<Trace> {
        parse(Path::new("a.s2p"), text, ports, parameter)
    }

    #[test]
    fn the_three_formats_are_the_same_numbers() {
        let ri = "! lab\n# MHz S RI R 50\n10 0 0 3 4 5 6 7 8 ! first\n\n! between\n20 0 0 0 -1 5 6 7 8\n";
        let ma = "#s ma mhz\n10 0 0 5 53.13010235 7 0 0 0\n20 0 0 1 -90 7 0 0 0\n1 2 3 4 5\n";
        let db = "# hz S DB R 75\n1e7 0 0 13.97940009 53.13010235 7 0 0 0\n2D7 0 0 0 -90 7 0 0 0";
        for text in [ri, ma, db] {
            let trace = read(text, 2, None).unwrap();
            assert_eq!(trace.frequencies.unwrap(), [10e6, 20e6]);
            for (value, expected) in trace.values.iter().zip([Complex32::new(3.0, 4.0), -Complex32::I]) {
                assert!((value - expected).norm() < 1e-5, "{value}");
            }
        }
        let other = read(ri, 2, Some("s12")).unwrap().values;
        assert_eq!(other, [Complex32::new(5.0, 6.0); 2]);
        // GHz and magnitudes where nothing is said.
        let one = read("1 2 0", 1, None).unwrap();
        assert_eq!((one.frequencies.unwrap(), one.values), (vec![1e9], vec![Complex32::new(2.0, 0.0)]));
    }

    #[test]
    fn records_of_many_ports_are_wrapped_and_in_rows() {
        let text = "# GHz S RI\n1 11 0 12 0 13 0\n 21 0 22 0 23 0 ! row\n 31 0 32 0 33 0\n2 1 0 2 0 3 0 4 0 5 0 6 0 7 0 8 0 9 0";
        let re = |name| read(text, 3, Some(name)).unwrap().values.iter().map(|v| v.re).collect::<Vec<_>>();
        assert_eq!((re("S21"), re("S3,2"), re("S13")), (vec![21.0, 4.0], vec![32.0, 8.0], vec![13.0, 3.0]));
    }

    #[test]
    fn a_plain_file_of_version_2_is_read() {
        let text = "! new\n[Version] 2.0\n# GHz S RI\n[Number of Ports] 2\n[Two-Port Data Order] 12_21\n[Number of Frequencies] 1\n\
                    [Reference] 50\n75\n[Network Data]\n1 11 0 12 0 21 0 22 0\n[End]\n";
        assert_eq!(read(text, 2, None).unwrap().values, [Complex32::new(21.0, 0.0)]);
        assert_names(
            read("[Version] 2.0\n[Matrix Format] Lower", 2, None).unwrap_err().to_string(),
            &["a.s2p:2", "matrix"],
        );
    }

    #[test]
    fn a_fault_is_named_with_its_line() {
        for (text, ports, parameter, parts) in [
            ("# GHz Z RI\n", 2, None, &["a.s2p:1", "Z-parameters"][..]),
            ("# GHz S XY\n", 2, None, &[":1", "`xy`"]),
            ("# GHz S RI\n1 2 3 4", 2, None, &[":2", "4 numbers", "9"]),
            ("1 2 3 4 5 6 7 8 9 10", 2, None, &[":1", "9 numbers", ".s2p"]),
            ("1 2 3\n1 2 3", 1, None, &[":2", "ascend"]),
            ("1 2 x", 1, None, &[":1", "`x`"]),
            ("1 2 3", 1, Some("S21"), &["1 port", "S21", "S11"]),
            ("1 2 3", 1, Some("21"), &["\"21\""]),
            ("! nothing\n", 1, None, &["no data"]),
            ("[Version] 3.0", 1, None, &["version 3.0"]),
        ] {
            assert_names(read(text, ports, parameter).unwrap_err().to_string(), parts);
        }
        let nine = "1 ".repeat(19);
        assert_names(read(&nine, 3, None).unwrap_err().to_string(), &["3 ports", "`parameter`"]);
        assert_eq!(
            ["s2p", "s16p", "s0p", "sp", "s+2p", "csv"].map(ports),
            [Some(2), Some(16), None, None, None, None]
        );
    }
}
