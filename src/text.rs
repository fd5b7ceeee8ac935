//! Text from files and command lines, made fit for messages and terminals.
//!
//! Names in a mesh, lines of a list and the names of files come from anywhere. Shown as they are, they could move the cursor,
//! clear the screen or reverse the order of letters, and a line of a gigabyte would be an error message of a gigabyte.

use std::borrow::Cow;

/// Maximum length of a quotation, characters.
const MAX_QUOTED: usize = 80;

/// Maximum length of a message; the program's own are shorter, also with several quotations.
const MAX_MESSAGE: usize = 2000;

/// Whether a character could act on a terminal or be invisible: control characters, other than newlines and tabs, and those
/// that set the direction of letters or have no width.
fn acts(c: char) -> bool {
    (c.is_control() && c != '\n' && c != '\t')
        || matches!(c,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}' | '\u{e0000}'..='\u{e007f}')
}

fn replaced(text: &str, is: impl Fn(char) -> bool, write: impl Fn(char) -> String) -> Cow<'_, str> {
    if !text.contains(&is) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is(c) { shown.push_str(&write(c)) } else { shown.push(c) }
    }
    Cow::Owned(shown)
}

fn escape(c: char) -> String {
    c.escape_default().to_string()
}

/// A text of any number of lines for a terminal: `\u{1b}` instead of an escape character.
pub(crate) fn escaped(text: &str) -> Cow<'_, str> {
    replaced(text, acts, escape)
}

/// The same for a text that is to be a single line, or a cell of a table.
pub(crate) fn one_line(text: &str) -> Cow<'_, str> {
    replaced(text, |c| acts(c) || c == '\n' || c == '\t', escape)
}

/// JSON with the same characters as JSON's own escapes.
pub(crate) fn escaped_json(json: &str) -> Cow<'_, str> {
    replaced(json, acts, json_escape)
}

/// A character as JSON's escapes of its units in UTF-16.
pub(crate) fn json_escape(c: char) -> String {
    let units = c.encode_utf16(&mut [0; 2]).iter().map(|unit| format!("\\u{unit:04x}")).collect::<Vec<_>>();
    units.concat()
}

/// A message for people, of which libraries may have made a part: escaped, and cut off after 2000 characters.
pub(crate) fn message(text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(MAX_MESSAGE) {
        Some((end, _)) => Cow::Owned(format!("{}…", escaped(&text[..end]))),
        None => escaped(text),
    }
}

/// A quotation from an input for a message: on one line, escaped, and cut off after 80 characters. The quotation marks are
/// the message's own.
pub(crate) fn quoted(text: &str) -> String {
    match text.char_indices().nth(MAX_QUOTED) {
        Some((end, _)) => format!("{}…", one_line(&text[..end])),
        None => one_line(text).into_owned(),
    }
}

/// The name nearest to `typed`, if one is similar enough to be a likely correction.
pub(crate) fn nearest<'n>(typed: &str, names: &[&'n str]) -> Option<&'n str> {
    // Names have at most 20 letters; the distance to a much longer text is meaningless.
    if typed.len() > 40 {
        return None;
    }
    let typed = typed.to_lowercase();
    names
        .iter()
        .map(|name| (strsim::damerau_levenshtein(&typed, name), *name))
        .filter(|(distance, name)| *distance <= (name.len() / 3).max(1))
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, name)| name)
}

/// A quantity with a prefix that fits, as `22.20 GHz`, to `digits` decimals.
pub(crate) fn prefixed(value: f64, digits: usize, unit: &str) -> String {
    let (scale, prefix) = prefix_of(value);
    format!("{:.digits$} {prefix}{unit}", value / scale)
}

/// A range of quantities with the prefix of the larger, as `10.00 to 20.00 kHz`.
pub(crate) fn prefixed_range(low: f64, high: f64, digits: usize, unit: &str) -> String {
    let (scale, prefix) = prefix_of(high);
    format!("{:.digits$} to {:.digits$} {prefix}{unit}", low / scale, high / scale)
}

/// The largest prefix that leaves a number of at least 1, and its factor.
fn prefix_of(value: f64) -> (f64, &'static str) {
    const PREFIXES: [(f64, &str); 7] =
        [(1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")];
    PREFIXES.into_iter().find(|(scale, _)| value.abs() >= *scale).unwrap_or((1.0, ""))
}

/// Seconds in the usual units of time.
pub(crate) fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 0.1 => "0.1 s or less".to_owned(),
        s if s < 120.0 => format!("{s:.1} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s if s < 172_800.0 => format!("{:.0} h", s / 3600.0),
        s => format!("{:.0} days", s / 86_400.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_acts_on_a_terminal_is_escaped_and_other_text_is_not() {
        let plain = "Glas\\größe \"e\u{301}\" 玻璃 `x`\n\tnext";
        assert_eq!(escaped(plain), plain);
        assert_eq!(one_line(plain), plain.replace('\n', "\\n").replace('\t', "\\t"));
        assert_eq!(escaped("\u{1b}[31mred\u{7}\r\u{9b}K"), "\\u{1b}[31mred\\u{7}\\r\\u{9b}K");
        assert_eq!(one_line("a\u{202e}b\u{200b}c\u{feff}"), "a\\u{202e}b\\u{200b}c\\u{feff}");
    }

    #[test]
    fn escaped_json_has_the_same_values() {
        let value = serde_json::json!({ "a\u{9b}": ["\u{1b}[31m", "\u{202e}\u{e0041}", "größe\n"] });
        let text = serde_json::to_string_pretty(&value).expect("JSON");
        let shown = escaped_json(&text);
        assert!(!shown.contains(acts) && shown.contains("größe"), "{shown}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&shown).ok(), Some(value));
    }

    #[test]
    fn quotations_are_short() {
        assert_eq!(quoted("three words\n"), "three words\\n");
        let long = quoted(&"größe".repeat(1 << 20));
        assert_eq!(long.chars().count(), 81);
        assert!(long.ends_with('…'));
        assert_eq!(message(&"\u{7}".repeat(1 << 20)).chars().filter(|c| *c == '\\').count(), 2000);
        assert_eq!(quoted(&"x".repeat(80)), "x".repeat(80));
    }

    #[test]
    fn quantities_have_prefixes_that_fit() {
        for (value, expected) in [
            (22.2e9, "22.20 GHz"),
            (500.0, "500.00 Hz"),
            (40e3, "40.00 kHz"),
            (0.0, "0.00 Hz"),
            (-2e-3, "-2.00 mHz"),
        ] {
            assert_eq!(prefixed(value, 2, "Hz"), expected);
        }
        assert_eq!(prefixed_range(500.0, 20e3, 1, "Hz"), "0.5 to 20.0 kHz");
        assert_eq!(prefixed(14.3e-9, 1, "m"), "14.3 nm");
    }

    #[test]
    fn only_a_similar_name_is_proposed() {
        assert_eq!(nearest("frequency", &["samples", "frequencies"]), Some("frequencies"));
        assert_eq!(nearest("colour", &["samples", "frequencies"]), None);
    }
}
