//! From text to TOML values that remember where they were typed: in the file, by line and column, or in a
//! `--set` on the command line.

use super::reader::{Fault, joined};
use super::wording::{homes, quoted};
use crate::error::{Error, Result};
use std::collections::HashMap;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

/// Where a value was typed.
#[derive(Debug, Clone)]
enum Origin {
    /// In the file, at this byte.
    File(usize),
    /// In this `--set`.
    Override(String),
}

/// A run file's values, not yet typed, and where each was written.
#[derive(Debug)]
pub(super) struct Source<'t> {
    file: &'t str,
    text: &'t str,
    origins: HashMap<String, Origin>,
    /// The values, always a table.
    pub(super) values: Value,
}

/// Parts of the longest key, `expect.METRIC.max` or `materials.N.name`, and some to spare.
const DEEPEST: usize = 8;

/// Pairs of keys of which one replaces the other, so that a `--set` of one can do without unsetting the other.
const EXCLUSIVE: [[&str; 2]; 4] = [
    ["scene.translate", "scene.fit"],
    ["array.pitch", "array.extent"],
    ["array.count", "array.elements"],
    ["medium.sound_speed", "medium.temperature"],
];

/// Keys of [array] that belong to one layout alone, with that layout: a `--set` of another withdraws them.
const OF_LAYOUT: [[&str; 2]; 3] =
    [["array.file", "file"], ["array.spacing", "random"], ["array.seed", "random"]];

impl<'t> Source<'t> {
    /// Parses `text`, which stands in `file`.
    ///
    /// # Errors
    /// Text that is no TOML, and numbers that do not fit 64 bits.
    pub(super) fn parse(file: &'t str, text: &'t str) -> Result<Self> {
        let mut source = Self { file, text, origins: HashMap::new(), values: Value::Table(Table::new()) };
        let root = DeTable::parse(text).map_err(|error| {
            let place = match error.span() {
                Some(span) => source.position(span.start),
                None => file.to_owned(),
            };
            Error::input(place, format!("is not valid TOML: {}", one_line(error.message())))
        })?;
        match table(root.get_ref(), "", &mut |path, byte| {
            source.origins.insert(path, Origin::File(byte));
        }) {
            Ok(values) => source.values = Value::Table(values),
            Err(fault) => return Err(source.error(fault)),
        }
        Ok(source)
    }

    /// Applies one `table.key=value`; the value is TOML, and a bare word is text.
    ///
    /// # Errors
    /// No `=`, a key without its table, or a value that is neither TOML nor a bare word.
    pub(super) fn set(&mut self, typed: &str) -> Result<()> {
        let wrong = |problem: String| Error::input(set_place(typed), problem);
        let Some((key, value)) = typed.split_once('=') else {
            return Err(wrong(
                "expected table.key=value, such as --set grid.pitch=[0.01,0.01,0.005]".to_owned(),
            ));
        };
        let steps: Vec<&str> = key.split('.').map(str::trim).collect();
        if steps.iter().any(|step| step.is_empty()) {
            return Err(wrong("expected table.key=value; a part of the key is empty".to_owned()));
        }
        if steps.len() > DEEPEST {
            return Err(wrong("no key of a run file lies that deep; write table.key=value".to_owned()));
        }
        let [folders @ .., last] = &steps[..] else { return Ok(()) };
        if folders.is_empty() && *last != "materials" {
            let tables = homes(last);
            let tables =
                if tables.is_empty() { String::new() } else { format!(" ({})", tables.join(" or ")) };
            return Err(wrong(format!("`{}` lacks its table{tables}; write table.key=value", quoted(last))));
        }
        let value = value_of(value).map_err(wrong)?;

        // Walk down to the table that holds the key, making tables that are not there yet.
        let mut path = String::new();
        let mut at = &mut self.values;
        for step in folders {
            (at, path) = descend(at, &path, step).map_err(wrong)?;
            self.origins.entry(path.clone()).or_insert_with(|| Origin::Override(typed.to_owned()));
        }
        let slot;
        (slot, path) = descend(at, &path, last).map_err(wrong)?;
        *slot = value;

        let inner = [format!("{path}."), format!("{path}[")];
        self.origins.retain(|key, _| !inner.iter().any(|prefix| key.starts_with(prefix.as_str())));
        self.origins.insert(path.clone(), Origin::Override(typed.to_owned()));
        for [one, other] in EXCLUSIVE {
            if path == one {
                self.withdraw(other);
            } else if path == other {
                self.withdraw(one);
            }
        }
        if path == "array.layout" {
            for [key, layout] in OF_LAYOUT {
                if self.word("array", "layout") != Some(layout) {
                    self.withdraw(key);
                }
            }
        }
        if path == "depth.view" && self.word("depth", "view") == Some("orthographic") {
            for key in ["depth.fov", "depth.pixels"] {
                self.withdraw(key);
            }
        }
        Ok(())
    }

    fn word(&self, table: &str, key: &str) -> Option<&str> {
        self.values.get(table)?.get(key)?.as_str()
    }

    /// Takes `table.key` out when it was typed in the file; two contradicting `--set` are left to be refused.
    fn withdraw(&mut self, path: &str) {
        if let (Some(Origin::File(_)), Some((table, key))) = (self.origins.get(path), path.split_once('.'))
            && let Some(Value::Table(table)) = self.values.get_mut(table)
        {
            table.remove(key);
            self.origins.remove(path);
        }
    }

    /// The fault as an error that says where to mend it.
    pub(super) fn error(&self, fault: Fault) -> Error {
        // Of several keys that disagree, the one on the command line is the one just typed.
        let overridden =
            std::iter::once(fault.path.as_str()).chain(fault.partners.iter().copied()).find_map(|path| {
                match self.origins.get(path) {
                    Some(Origin::Override(typed)) => Some(set_place(typed)),
                    _ => None,
                }
            });
        Error::input(overridden.unwrap_or_else(|| self.place(&fault.path)), fault.problem)
    }

    /// Where `path`, or else the nearest table around it, was typed.
    fn place(&self, path: &str) -> String {
        let mut known = path;
        loop {
            match self.origins.get(known) {
                Some(Origin::Override(typed)) => return set_place(typed),
                Some(Origin::File(byte)) => return format!("{}, key `{path}`", self.position(*byte)),
                None => match known.rfind(['.', '[']) {
                    Some(end) => known = &known[..end],
                    None if path.is_empty() => return self.file.to_owned(),
                    None => return format!("{}, key `{path}`", self.file),
                },
            }
        }
    }

    /// `FILE:LINE:COLUMN` of a byte of the text, counted from 1, in characters.
    fn position(&self, byte: usize) -> String {
        let before = String::from_utf8_lossy(&self.text.as_bytes()[..byte.min(self.text.len())]);
        let line = before.matches('\n').count() + 1;
        let column = before.rsplit('\n').next().map_or(0, |line| line.chars().count()) + 1;
        format!("{}:{line}:{column}", self.file)
    }
}

/// What an error in a `--set` is called.
fn set_place(typed: &str) -> String {
    format!("--set {}", quoted(typed))
}

/// The parser's message on one line.
fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The element `step` of the value at `path`, made if it is a key that is not there.
fn descend<'v>(
    at: &'v mut Value,
    path: &str,
    step: &str,
) -> std::result::Result<(&'v mut Value, String), String> {
    match at {
        Value::Table(table) => {
            let slot = table.entry(step).or_insert_with(|| Value::Table(Table::new()));
            Ok((slot, joined(path, step)))
        }
        Value::Array(list) => {
            let length = list.len();
            let index = step.parse().unwrap_or(usize::MAX);
            let slot = list.get_mut(index).ok_or_else(|| {
                format!("`{path}` is a list of {length}; name an element by its number, counted from 0")
            })?;
            Ok((slot, format!("{path}[{index}]")))
        }
        _ => Err(format!("`{path}` is a value and has no keys of its own")),
    }
}

/// The value of a `--set`: TOML if it is TOML, otherwise a bare word.
fn value_of(typed: &str) -> std::result::Result<Value, String> {
    let typed = typed.trim();
    match DeValue::parse(typed) {
        Ok(parsed) => value(parsed.get_ref(), "", &mut |_, _| {}).map_err(|fault| fault.problem),
        // Whatever begins like a list, a table or quoted text was meant to be one.
        Err(error) if typed.is_empty() || typed.starts_with(['[', '{', '"', '\'']) => {
            Err(format!("the value is not valid TOML: {}", one_line(error.message())))
        }
        Err(_) => Ok(Value::String(typed.to_owned())),
    }
}

/// Converts a table; `seen` is told the path and place of every key and element.
fn table(
    parsed: &DeTable,
    path: &str,
    seen: &mut dyn FnMut(String, usize),
) -> std::result::Result<Table, Fault> {
    let mut table = Table::new();
    for (key, entry) in parsed {
        let path = joined(path, key.get_ref());
        seen(path.clone(), key.span().start);
        table.insert(key.get_ref().to_string(), value(entry.get_ref(), &path, seen)?);
    }
    Ok(table)
}

/// Converts one value.
fn value(
    parsed: &DeValue,
    path: &str,
    seen: &mut dyn FnMut(String, usize),
) -> std::result::Result<Value, Fault> {
    Ok(match parsed {
        DeValue::String(text) => Value::String(text.to_string()),
        DeValue::Boolean(truth) => Value::Boolean(*truth),
        DeValue::Datetime(date) => Value::Datetime(*date),
        DeValue::Integer(number) => match i64::from_str_radix(number.as_str(), number.radix()) {
            Ok(number) => Value::Integer(number),
            Err(_) => return Err(too_large(path, number.as_str())),
        },
        DeValue::Float(number) => match number.as_str().parse::<f64>() {
            Ok(real) if real.is_infinite() && !number.as_str().contains("inf") => {
                return Err(too_large(path, number.as_str()));
            }
            Ok(real) => Value::Float(real),
            Err(_) => return Err(Fault::new(path, format!("`{}` is not a number", quoted(number.as_str())))),
        },
        DeValue::Array(list) => {
            let mut values = Vec::with_capacity(list.len());
            for (index, element) in list.iter().enumerate() {
                let path = format!("{path}[{index}]");
                seen(path.clone(), element.span().start);
                values.push(value(element.get_ref(), &path, seen)?);
            }
            Value::Array(values)
        }
        DeValue::Table(entries) => Value::Table(table(entries, path, seen)?),
    })
}

fn too_large(path: &str, number: &str) -> Fault {
    Fault::new(path, format!("`{}` is too large a number; expected one that fits 64 bits", quoted(number)))
}
