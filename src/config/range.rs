//! The checks that several keys share: each names the key, what was found and what was expected.

use super::InputFile;
use super::reader::Fault;
use crate::reconstruct::LEAST_TOLERANCE;

/// Nothing, or the first fault.
pub(super) type Check = Result<(), Fault>;

/// A fault unless `valid`.
pub(super) fn ensure(valid: bool, fault: impl FnOnce() -> Fault) -> Check {
    if valid { Ok(()) } else { Err(fault()) }
}

/// Every value is finite.
pub(super) fn finite(path: &str, values: &[f64]) -> Check {
    values.iter().try_for_each(|value| expect(path, *value, value.is_finite(), "a finite number"))
}

/// The value is finite and greater than 0.
pub(super) fn positive(path: &str, value: f64) -> Check {
    expect(path, value, value.is_finite() && value > 0.0, "a number greater than 0")
}

/// The value is finite and at least 0.
pub(super) fn not_negative(path: &str, value: f64) -> Check {
    within(path, value, 0.0, f64::MAX, "0 or more")
}

/// The value is in `min ..= max`, which `what` puts in words.
pub(super) fn within(path: &str, value: f64, min: f64, max: f64, what: &str) -> Check {
    expect(path, value, (min..=max).contains(&value), what)
}

/// The value is `valid`, which `what` puts in words.
pub(super) fn expect(path: &str, value: f64, valid: bool, what: &str) -> Check {
    ensure(valid, || Fault::new(path, format!("found {value:?}; expected {what}")))
}

/// The value is 0, for an exact result, or a relative error from [`LEAST_TOLERANCE`] to 0.5.
pub(super) fn tolerance(path: &str, value: f64) -> Check {
    let valid = value == 0.0 || (LEAST_TOLERANCE..=0.5).contains(&value);
    expect(path, value, valid, "a relative error from 1e-9 to 0.5, or 0 for the exact sum")
}

/// Counts along axes: at least one each, and a product of at most `max`.
pub(super) fn counts(path: &str, counts: &[u32], max: f64) -> Check {
    ensure(!counts.contains(&0), || Fault::new(path, "found 0; expected at least 1 along each axis"))?;
    let total: f64 = counts.iter().map(|&count| f64::from(count)).product();
    ensure(total <= max, || Fault::new(path, format!("{total:.3e} are too many; expected {max:.0e} at most")))
}

/// A file's name, when one is typed, is not empty.
pub(super) fn file_name(path: &str, file: Option<&InputFile>) -> Check {
    ensure(file.is_none_or(|file| !file.typed.is_empty()), || {
        Fault::new(path, "is empty; expected a file's path, relative to the run file")
    })
}

/// None of these keys is typed; each comes with whether it is.
pub(super) fn none_typed<'k>(keys: &[(&'k str, bool)], fault: impl FnOnce(&'k str) -> Fault) -> Check {
    keys.iter().find(|(_, typed)| *typed).map_or(Ok(()), |(key, _)| Err(fault(key)))
}

/// Two keys that exclude each other.
pub(super) fn conflict(path: &str, partners: &'static [&'static str], why: &str) -> Fault {
    let others = partners.join("` or `");
    Fault::new(path, format!("{why}; leave `{path}` out, or change `{others}`")).or_at(partners)
}
