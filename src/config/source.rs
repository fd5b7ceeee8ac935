//! From text to TOML values, each with the place where it was typed: a line and column of the file, or a `--set` on the
//! command line.

use super::reader::{Fault, joined};
use super::wording::tables_with;
use crate::error::{Error, Result};
use crate::text::quoted;
use std::collections::{BTreeMap, HashMap};
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

/// A run file as parsed TOML, and where each of its values was typed.
#[derive(Debug)]
pub(super) struct ParsedRunFile<'t> {
    file: &'t str,
    text: &'t str,
    origins: HashMap<String, Origin>,
    /// The values, always a table.
    pub(super) values: Value,
}

/// The keys of a run file that were typed, in the file or as overrides; all others have their defaults.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TypedKeys(
    /// Each `table.key`, and whether it is an override.
    BTreeMap<String, bool>,
);

impl TypedKeys {
    /// Whether a `table.key`, or anything of a `table`, was typed.
    pub fn contains(&self, key: &str) -> bool {
        self.0.contains_key(key)
    }

    /// Whether it was typed as an override.
    pub fn is_overridden(&self, key: &str) -> bool {
        self.0.get(key).is_some_and(|overridden| *overridden)
    }

    /// The keys that were typed as overrides, and the tables that they were the first to name.
    pub fn overridden(&self) -> impl Iterator<Item = &str> {
        self.0.iter().filter(|(_, overridden)| **overridden).map(|(key, _)| key.as_str())
    }
}

/// Maximum number of parts of a key: `expect.METRIC.max` and `materials.N.name` have three.
const MAX_DEPTH: usize = 8;

/// Pairs of keys that exclude each other: a `--set` of one withdraws the other.
const EXCLUSIVE: [[&str; 2]; 11] = [
    ["scene.mesh", "scene.parts"],
    ["scene.size", "scene.unit"],
    ["scene.size", "scene.scale"],
    ["scene.translate", "scene.fit"],
    ["array.pitch", "array.extent"],
    ["array.source", "array.sources"],
    ["array.source_offset", "array.source_file"],
    ["array.source", "import.sources"],
    ["array.sources", "import.sources"],
    ["array.count", "array.elements"],
    ["medium.sound_speed", "medium.temperature"],
];

/// Keys that apply only with one word of another key: key, that other key, the word. A `--set` of another word withdraws
/// them.
const DEPENDENT: [[&str; 3]; 8] = [
    ["array.source_file", "array.geometry", "pair"],
    ["array.source_offset", "array.geometry", "pair"],
    ["array.file", "array.layout", "file"],
    ["array.spacing", "array.layout", "random"],
    ["array.seed", "array.layout", "random"],
    ["instrument.low_pass", "instrument.filter", "low-pass"],
    ["depth.fov", "depth.view", "perspective"],
    ["depth.pixels", "depth.view", "perspective"],
];

impl<'t> ParsedRunFile<'t> {
    /// Parses `text`, the content of `file`.
    ///
    /// # Errors
    /// Text that is no TOML, and numbers that do not fit 64 bits.
    pub(super) fn parse(file: &'t str, text: &'t str) -> Result<Self> {
        let mut parsed = Self { file, text, origins: HashMap::new(), values: Value::Table(Table::new()) };
        let root = DeTable::parse(text).map_err(|error| {
            let place = error.span().map_or(file.to_owned(), |span| parsed.position(span.start));
            Error::input(place, format!("is not valid TOML: {}", one_line(error.message())))
        })?;
        let values = table(root.get_ref(), "", &mut |path, byte| {
            parsed.origins.insert(path, Origin::File(byte));
        });
        parsed.values = Value::Table(values.map_err(|fault| parsed.error(fault))?);
        Ok(parsed)
    }

    /// Applies one `table.key=value`; the value is TOML, and a bare word is text.
    ///
    /// # Errors
    /// No `=`, a key without its table, or a value that is neither TOML nor a bare word.
    pub(super) fn set(&mut self, typed: &str) -> Result<()> {
        let wrong = |problem: String| Error::input(set_place(typed), problem);
        let Some((key, value)) = typed.split_once('=') else {
            let problem = "expected table.key=value, such as --set grid.pitch=[0.01,0.01,0.005]";
            return Err(wrong(problem.to_owned()));
        };
        let steps: Vec<&str> = key.split('.').map(str::trim).collect();
        if steps.iter().any(|step| step.is_empty()) {
            return Err(wrong("expected table.key=value; a part of the key is empty".to_owned()));
        }
        if steps.len() > MAX_DEPTH {
            return Err(wrong("no key of a run file is that deep; write table.key=value".to_owned()));
        }
        let [parents @ .., last] = &steps[..] else { return Ok(()) };
        if parents.is_empty() && *last != "materials" {
            let tables = tables_with(last);
            let tables =
                if tables.is_empty() { String::new() } else { format!(" ({})", tables.join(" or ")) };
            return Err(wrong(format!("`{}` lacks its table{tables}; write table.key=value", quoted(last))));
        }
        let value = value_of(value).map_err(wrong)?;

        // Descend to the key, creating missing tables.
        let mut path = String::new();
        let mut at = &mut self.values;
        for step in parents {
            (at, path) = descend(at, &path, step).map_err(wrong)?;
            self.origins.entry(path.clone()).or_insert_with(|| Origin::Override(typed.to_owned()));
        }
        (at, path) = descend(at, &path, last).map_err(wrong)?;
        let word = value.as_str().unwrap_or_default().to_owned();
        *at = value;

        self.origins
            .retain(|key, _| !key.strip_prefix(&path).is_some_and(|rest| rest.starts_with(['.', '['])));
        self.origins.insert(path.clone(), Origin::Override(typed.to_owned()));
        for [one, other] in EXCLUSIVE {
            if path == one {
                self.withdraw(other);
            } else if path == other {
                self.withdraw(one);
            }
        }
        for [key, decisive, needed] in DEPENDENT {
            if path == decisive && word != needed {
                self.withdraw(key);
            }
        }
        Ok(())
    }

    /// The keys that were typed.
    pub(super) fn typed(self) -> TypedKeys {
        let is_override = |origin: &Origin| matches!(origin, Origin::Override(_));
        TypedKeys(self.origins.into_iter().map(|(key, origin)| (key, is_override(&origin))).collect())
    }

    /// Removes `table.key` if it was typed in the file; two contradicting `--set` remain, and are refused later.
    fn withdraw(&mut self, path: &str) {
        if let (Some(Origin::File(_)), Some((table, key))) = (self.origins.get(path), path.split_once('.'))
            && let Some(Value::Table(table)) = self.values.get_mut(table)
        {
            table.remove(key);
            self.origins.remove(path);
        }
    }

    /// The fault as an error that says where to fix it.
    pub(super) fn error(&self, fault: Fault) -> Error {
        // Of several keys that disagree, the one on the command line was typed last.
        let mut keys = std::iter::once(fault.path.as_str()).chain(fault.partners.iter().copied());
        let overridden = keys.find_map(|path| match self.origins.get(path) {
            Some(Origin::Override(typed)) => Some(set_place(typed)),
            _ => None,
        });
        Error::input(overridden.unwrap_or_else(|| self.place(&fault.path)), fault.problem)
    }

    /// Where `path`, or else the nearest table around it, was typed.
    fn place(&self, path: &str) -> String {
        let mut known = path;
        loop {
            match self.origins.get(known) {
                Some(Origin::Override(typed)) => return set_place(typed),
                Some(Origin::File(byte)) => {
                    return format!("{}, key `{}`", self.position(*byte), quoted(path));
                }
                None => match known.rfind(['.', '[']) {
                    Some(end) => known = &known[..end],
                    None if path.is_empty() => return self.file.to_owned(),
                    None => return format!("{}, key `{}`", self.file, quoted(path)),
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

/// The place that an error in a `--set` names.
fn set_place(typed: &str) -> String {
    format!("--set {}", quoted(typed))
}

/// The parser's message on one line.
fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The element `step` of the value at `path`, and its own path; a missing key is created.
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
                let path = quoted(path);
                format!("`{path}` is a list of {length}; name an element by its number, counted from 0")
            })?;
            Ok((slot, format!("{path}[{index}]")))
        }
        _ => Err(format!("`{}` is a value and has no keys of its own", quoted(path))),
    }
}

/// The value of a `--set`: TOML if it is TOML, otherwise a bare word; numbers may be typed as `.5` and `5.`, too.
fn value_of(typed: &str) -> std::result::Result<Value, String> {
    let typed = typed.trim();
    let parsed = |text: &str| DeValue::parse(text).map(|parsed| value(parsed.get_ref(), "", &mut |_, _| {}));
    match parsed(typed).or_else(|error| parsed(&with_zeros(typed)).map_err(|_| error)) {
        Ok(value) => value.map_err(|fault| fault.problem),
        // Whatever begins like a list, a table or quoted text was meant to be one.
        Err(error) if typed.is_empty() || typed.starts_with(['[', '{', '"', '\'']) => {
            Err(format!("the value is not valid TOML: {}", one_line(error.message())))
        }
        Err(_) => Ok(Value::String(typed.to_owned())),
    }
}

/// A number, or a list of numbers, with the zeros before and after points that TOML asks for and people leave out.
fn with_zeros(typed: &str) -> String {
    let is_numbers = typed.chars().all(|c| c.is_ascii_digit() || " \t.,eE+-[]".contains(c));
    if !is_numbers {
        return typed.to_owned();
    }
    let mut text = String::with_capacity(typed.len() + 8);
    let mut characters = typed.chars().peekable();
    while let Some(c) = characters.next() {
        let [before, after] = [text.chars().next_back(), characters.peek().copied()]
            .map(|next| next.is_some_and(|next| next.is_ascii_digit()));
        match (c, before, after) {
            ('.', false, true) => text += "0.",
            ('.', true, false) => text += ".0",
            _ => text.push(c),
        }
    }
    text
}

/// Converts a table; `seen` receives the path and position of every key and element.
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
