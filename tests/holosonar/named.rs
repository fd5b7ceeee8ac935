//! What a message must name: files, keys, places and numbers, whatever the words around them.
//!
//! Tests check these instead of sentences: a rewording breaks no test, but a message that no longer says where the fault
//! is, or by how much, does. The library's unit tests use this file too (`src/lib.rs`).

use crate::progress::Observer;
use std::sync::Mutex;

/// An observer that stores the warnings.
#[derive(Default)]
pub(crate) struct Warnings(Mutex<Vec<String>>);

impl Observer for Warnings {
    fn warn(&self, message: &str) {
        self.0.lock().expect("no panic").push(message.to_owned());
    }
}

impl Warnings {
    /// The warnings so far.
    pub(crate) fn list(&self) -> Vec<String> {
        self.0.lock().expect("no panic").clone()
    }
}

/// The parts that a message does not name. A number must be complete: `30` is in `30.0`, and `1.5` in `1.50`, but `30` is
/// not in `300`, `130`, `30.5` or `1.30`.
fn unnamed<'a>(message: &str, parts: &[&'a str]) -> Vec<&'a str> {
    parts.iter().copied().filter(|part| !names(message, part)).collect()
}

fn names(message: &str, part: &str) -> bool {
    let is_digit = |c: char| c.is_ascii_digit();
    message.match_indices(part).any(|(at, _)| {
        let (before, after) = (&message[..at], &message[at + part.len()..]);
        let cut_before = part.starts_with(is_digit) && before.ends_with(|c| is_digit(c) || c == '.');
        // Zeros at the end of decimals change no number.
        let has_decimals =
            part.rsplit(|c: char| !is_digit(c) && c != '.').next().is_some_and(|n| n.contains('.'));
        let decimals = after.strip_prefix('.').or(has_decimals.then_some(after));
        let rest = decimals.map_or(after, |decimals| decimals.trim_start_matches('0'));
        !(cut_before || part.ends_with(is_digit) && rest.starts_with(is_digit))
    })
}

/// Whether a message names all of `parts`; a number must be complete.
pub(crate) fn all_named(message: impl AsRef<str>, parts: &[&str]) -> bool {
    unnamed(message.as_ref(), parts).is_empty()
}

/// Asserts that a message names all of `parts`; a number must be complete.
///
/// # Panics
/// With the message and what is missing.
#[track_caller]
pub(crate) fn assert_names(message: impl AsRef<str>, parts: &[&str]) {
    let message = message.as_ref();
    let missing = unnamed(message, parts);
    assert!(missing.is_empty(), "{missing:?} is not named: {message}");
}

#[test]
fn numbers_must_be_complete_and_words_may_be_anywhere() {
    let message =
        "run.toml:3:1, key `sweep.step`: 10000.0 is 333.3333 steps of 30; take -9 or 25. Or 1.50 m.";
    let named =
        ["run.toml:3", "`sweep.step`", "333.3333", "30", "-9", "25", "10000", "10000.0", "1.5", "step"];
    assert_eq!(unnamed(message, &named), Vec::<&str>::new());
    let missing = ["333", "3333", "1000", "0", "2", "run.toml:2", "sweep.stop", "25.0"];
    assert_eq!(unnamed(message, &missing), missing);
    assert!(all_named("", &[]) && !all_named("", &["30"]));
}
