//! The checks that several keys share: each names the key, what was found and what was expected.

use super::InputFile;
use super::reader::Fault;

/// Nothing, or the first fault.
pub(super) type Check = Result<(), Fault>;

/// Every value is finite.
pub(super) fn finite(path: &str, values: &[f64]) -> Check {
    match values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(Fault::new(path, format!("found {value:?}; expected a finite number"))),
        None => Ok(()),
    }
}

/// The value is finite and greater than 0.
pub(super) fn positive(path: &str, value: f64) -> Check {
    if value.is_finite() && value > 0.0 {
        return Ok(());
    }
    Err(Fault::new(path, format!("found {value:?}; expected a number greater than 0")))
}

/// The value is finite and at least 0.
pub(super) fn not_negative(path: &str, value: f64) -> Check {
    within(path, value, 0.0, f64::MAX, "0 or more")
}

/// The value lies in `least ..= most`, which `what` puts in words.
pub(super) fn within(path: &str, value: f64, least: f64, most: f64, what: &str) -> Check {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(Fault::new(path, format!("found {value:?}; expected {what}")))
}

/// Numbers of things along axes: at least one each, and at most `most` together.
pub(super) fn counts(path: &str, counts: &[u32], most: f64) -> Check {
    if counts.contains(&0) {
        return Err(Fault::new(path, "found 0; expected at least 1 along each axis"));
    }
    let total: f64 = counts.iter().map(|&count| f64::from(count)).product();
    if total > most {
        return Err(Fault::new(path, format!("{total:.3e} are too many; expected {most:.0e} at most")));
    }
    Ok(())
}

/// A file's name, when one is typed, is not empty.
pub(super) fn named(path: &str, file: Option<&InputFile>) -> Check {
    if file.is_some_and(|file| file.typed.is_empty()) {
        return Err(Fault::new(path, "is empty; expected a file's path, relative to the run file"));
    }
    Ok(())
}

/// Two keys that exclude each other.
pub(super) fn clash(path: &str, partners: &'static [&'static str], why: &str) -> Fault {
    Fault { partners, ..Fault::new(path, format!("{why}; keep one of the two")) }
}
