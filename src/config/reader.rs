//! Reads typed values from parsed TOML, and says in plain words what is wrong with one that does not fit.
//!
//! It is a serde `Deserializer` of its own because of its errors: each one knows the key at fault, and proposes the
//! nearest valid name for an unknown one.

use super::wording::{described, unknown_key, unknown_table};
use crate::text::{nearest, quoted};
use serde::de::value::{MapDeserializer, SeqDeserializer, StrDeserializer};
use serde::de::{self, Deserializer, Expected, IntoDeserializer, Unexpected, Visitor};
use serde::forward_to_deserialize_any;
use std::fmt::{self, Display};
use toml::Value;

/// What is wrong with one key.
#[derive(Debug)]
pub(super) struct Fault {
    /// The key, such as `grid.pitch` or `materials[0].name`; empty for the whole file.
    pub(super) path: String,
    /// Other keys that could be changed instead.
    pub(super) partners: &'static [&'static str],
    /// What was found, what was expected, how to fix it.
    pub(super) problem: String,
}

impl Fault {
    pub(super) fn new(path: impl Into<String>, problem: impl Into<String>) -> Self {
        Self { path: path.into(), partners: &[], problem: problem.into() }
    }

    /// The same fault, which a change of these other keys would fix as well.
    pub(super) fn or_at(self, partners: &'static [&'static str]) -> Self {
        Self { partners, ..self }
    }

    /// Names the key, unless the fault is already known to be deeper.
    fn at(mut self, path: &str) -> Self {
        if self.path.is_empty() {
            path.clone_into(&mut self.path);
        }
        self
    }
}

impl Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}: {}", self.path, self.problem)
    }
}

impl std::error::Error for Fault {}

impl de::Error for Fault {
    fn custom<T: Display>(message: T) -> Self {
        Self::new("", message.to_string())
    }

    fn invalid_type(found: Unexpected, expected: &dyn Expected) -> Self {
        let found = match found {
            Unexpected::Str(text) => format!("the text \"{}\"", quoted(text)),
            Unexpected::Float(number) => format!("the number {number:?}"),
            Unexpected::Unsigned(number) => format!("the number {number}"),
            Unexpected::Signed(number) => format!("the number {number}"),
            Unexpected::Bool(truth) => truth.to_string(),
            Unexpected::Seq => "a list".to_owned(),
            Unexpected::Map => "a table".to_owned(),
            other => other.to_string(),
        };
        Self::new("", format!("found {found}; expected {expected}"))
    }

    fn invalid_value(found: Unexpected, expected: &dyn Expected) -> Self {
        Self::invalid_type(found, expected)
    }

    fn invalid_length(length: usize, expected: &dyn Expected) -> Self {
        Self::new("", format!("found a list of length {length}; expected {expected}"))
    }

    fn missing_field(key: &'static str) -> Self {
        Self::new("", format!("the key `{key}` is missing; it has no default"))
    }
}

/// The key `key` of the table at `path`.
pub(super) fn joined(path: &str, key: &str) -> String {
    if path.is_empty() { quoted(key) } else { format!("{path}.{}", quoted(key)) }
}

/// Reads one value, and knows its key.
#[derive(Debug)]
pub(super) struct ValueDeserializer<'de> {
    path: String,
    value: &'de Value,
}

impl<'de> ValueDeserializer<'de> {
    /// Reads a complete run file.
    pub(super) fn root(value: &'de Value) -> Self {
        Self { path: String::new(), value }
    }

    fn expected(&self, what: &str) -> Fault {
        Fault::new(&*self.path, format!("found {}; expected {what}", described(self.value)))
    }

    /// Passes a list's elements to `visitor`.
    fn list<V: Visitor<'de>>(&self, list: &'de [Value], visitor: V) -> Result<V::Value, Fault> {
        let path = |index: usize| format!("{}[{index}]", self.path);
        let elements = list.iter().enumerate().map(|(index, value)| Self { path: path(index), value });
        visitor.visit_seq(SeqDeserializer::new(elements)).map_err(|fault: Fault| fault.at(&self.path))
    }

    /// Passes a table's entries to `visitor`.
    fn table<V: Visitor<'de>>(&self, table: &'de toml::Table, visitor: V) -> Result<V::Value, Fault> {
        let entries =
            table.iter().map(|(key, value)| (&**key, Self { path: joined(&self.path, key), value }));
        visitor.visit_map(MapDeserializer::new(entries)).map_err(|fault: Fault| fault.at(&self.path))
    }

    fn number(&self) -> Result<f64, Fault> {
        match self.value {
            Value::Float(number) if number.is_finite() => Ok(*number),
            Value::Float(_) => Err(self.expected("a finite number")),
            Value::Integer(number) => Ok(*number as f64),
            Value::String(text) if text.trim().parse::<f64>().is_ok() => {
                Err(self.expected("a number; leave the quotes out"))
            }
            Value::String(text) if is_with_unit(text) => Err(self.expected(
                "a number without its unit; lengths are in m, frequencies in Hz, angles in degrees",
            )),
            _ => Err(self.expected("a number")),
        }
    }
}

/// Whether a text is a number and a word, as in `0.3m`.
fn is_with_unit(text: &str) -> bool {
    let number = text.trim().trim_end_matches(|c: char| c.is_alphabetic() || c == '°');
    number.trim_end().parse::<f64>().is_ok()
}

/// Keys of sizes, which are above zero, and a usual one of each.
const SIZES: [(&str, &str); 3] = [("count", "32"), ("extent", "0.5"), ("pitch", "0.01")];

/// So many numbers like those of a key's value: as it has them, the last again for those that it lacks; if it has none, or where
/// it has a zero that it may not, usual ones.
fn example_of(path: &str, value: &Value, length: usize) -> String {
    let given = value.as_array().map_or(std::slice::from_ref(value), Vec::as_slice);
    let key = path.rsplit('.').next().unwrap_or_default();
    let size = SIZES.iter().find(|(of, _)| *of == key).map(|(_, usual)| *usual);
    let written = |value: &Value| {
        let number = value.as_float().or(value.as_integer().map(|number| number as f64));
        let (number, written) = (number.filter(|number| number.is_finite())?, value.to_string());
        Some(match size {
            Some(usual) if number == 0.0 => usual.to_owned(),
            Some(_) => written.trim_start_matches('-').to_owned(),
            None => written,
        })
    };
    let numbers: Vec<String> = given.iter().map_while(written).collect();
    let like = |i: usize| numbers.get(i).or(numbers.last()).map_or(size.unwrap_or("0.0"), String::as_str);
    (0..length).map(like).collect::<Vec<_>>().join(", ")
}

impl<'de> IntoDeserializer<'de, Fault> for ValueDeserializer<'de> {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

impl<'de> Deserializer<'de> for ValueDeserializer<'de> {
    type Error = Fault;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        let read = match self.value {
            Value::String(text) => visitor.visit_str(text),
            Value::Integer(number) => visitor.visit_i64(*number),
            Value::Float(number) => visitor.visit_f64(*number),
            Value::Boolean(truth) => visitor.visit_bool(*truth),
            Value::Datetime(_) => Err(de::Error::invalid_type(Unexpected::Other("a date"), &visitor)),
            Value::Array(list) => self.list(list, visitor),
            Value::Table(table) => self.table(table, visitor),
        };
        read.map_err(|fault| fault.at(&self.path))
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        visitor.visit_f64(self.number()?)
    }

    fn deserialize_u32<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match self.value {
            Value::Integer(number) => {
                let number = u32::try_from(*number)
                    .map_err(|_| self.expected("a whole number from 0 to 4294967295"))?;
                visitor.visit_u32(number)
            }
            _ => Err(self.expected("a whole number")),
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match self.value {
            Value::String(text) => visitor.visit_str(text).map_err(|fault: Fault| fault.at(&self.path)),
            _ => Err(self.expected("text in quotes")),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        visitor.visit_some(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match self.value {
            Value::Array(list) => self.list(list, visitor),
            Value::Table(_) => {
                Err(self.expected(&format!("a list: write [[{}]] in double brackets", self.path)))
            }
            _ => Err(self.expected("a list in brackets, such as [..]")),
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, length: usize, visitor: V) -> Result<V::Value, Fault> {
        match self.value {
            Value::Array(list) if list.len() == length => self.list(list, visitor),
            _ => {
                let example = example_of(&self.path, self.value, length);
                Err(self.expected(&format!("a list of {length} numbers, such as [{example}]")))
            }
        }
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Fault> {
        match self.value {
            Value::Table(table) => self.table(table, visitor),
            _ => Err(self.expected("a table")),
        }
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        keys: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Fault> {
        let Value::Table(table) = self.value else {
            return Err(self.expected(&format!("a table with the keys {}", keys.join(", "))));
        };
        if let Some((key, value)) = table.iter().find(|(key, _)| !keys.contains(&key.as_str())) {
            let problem = if self.path.is_empty() {
                unknown_table(key, value, keys)
            } else {
                unknown_key(&self.path, key, keys)
            };
            return Err(Fault::new(joined(&self.path, key), problem));
        }
        self.table(table, visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        words: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Fault> {
        let accepted = words.iter().map(|word| format!("\"{word}\"")).collect::<Vec<_>>().join(", ");
        match self.value {
            Value::String(word) if words.contains(&word.as_str()) => {
                let word: StrDeserializer<Fault> = word.as_str().into_deserializer();
                visitor.visit_enum(word)
            }
            Value::String(word) => {
                let meant = nearest(word, words)
                    .map_or_else(String::new, |near| format!(" did you mean \"{near}\"?"));
                Err(Fault::new(
                    self.path,
                    format!("this version does not know \"{}\";{meant} accepted: {accepted}", quoted(word)),
                ))
            }
            _ => Err(self.expected(&format!("one of {accepted}"))),
        }
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u64 u128 f32 char str bytes byte_buf unit unit_struct newtype_struct
        tuple_struct identifier ignored_any
    }
}
