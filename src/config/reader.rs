//! Reads typed values out of parsed TOML, and says in plain words what is wrong with one that does not fit.
//!
//! This is a serde `Deserializer` of its own for the sake of its errors: each knows the key at fault, and a
//! name that is not known comes with the nearest one that is.

use super::wording::{described, nearest, quoted, unknown_key, unknown_table};
use serde::de::value::StrDeserializer;
use serde::de::{
    self, DeserializeSeed, Deserializer, Expected, IntoDeserializer, MapAccess, SeqAccess, Unexpected,
    Visitor,
};
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
    /// What was found, what was expected, how to mend it.
    pub(super) problem: String,
}

impl Fault {
    pub(super) fn new(path: impl Into<String>, problem: impl Into<String>) -> Self {
        Self { path: path.into(), partners: &[], problem: problem.into() }
    }

    /// Names the key, unless the fault is already known to lie deeper.
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

/// One value, and the key it stands at.
#[derive(Debug)]
pub(super) struct Reader<'de> {
    pub(super) path: String,
    pub(super) value: &'de Value,
}

impl<'de> Reader<'de> {
    /// The whole of a run file.
    pub(super) fn whole(value: &'de Value) -> Self {
        Self { path: String::new(), value }
    }

    fn expected(&self, what: &str) -> Fault {
        Fault::new(&*self.path, format!("found {}; expected {what}", described(self.value)))
    }

    /// Hands a list's elements to `visitor`.
    fn list<V: Visitor<'de>>(&self, list: &'de [Value], visitor: V) -> Result<V::Value, Fault> {
        visitor
            .visit_seq(Elements { path: &self.path, rest: list, next: 0 })
            .map_err(|fault| fault.at(&self.path))
    }

    /// Hands a table's entries to `visitor`.
    fn table<V: Visitor<'de>>(&self, table: &'de toml::Table, visitor: V) -> Result<V::Value, Fault> {
        visitor
            .visit_map(Entries { path: &self.path, rest: table.iter(), entry: None })
            .map_err(|fault| fault.at(&self.path))
    }

    fn number(&self) -> Result<f64, Fault> {
        match self.value {
            Value::Float(number) if number.is_finite() => Ok(*number),
            Value::Float(_) => Err(self.expected("a finite number")),
            Value::Integer(number) => Ok(*number as f64),
            Value::String(text) if text.trim().parse::<f64>().is_ok() => {
                Err(self.expected("a number; leave the quotes out"))
            }
            _ => Err(self.expected("a number")),
        }
    }
}

impl<'de> Deserializer<'de> for Reader<'de> {
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

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        visitor: V,
    ) -> Result<V::Value, Fault> {
        visitor.visit_newtype_struct(self)
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
            _ => Err(self.expected(&format!("a list of {length} numbers, such as [{}]", example(length)))),
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
        let accepted: Vec<String> = words.iter().map(|word| format!("\"{word}\"")).collect();
        let accepted = accepted.join(", ");
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
        bool i8 i16 i32 i64 i128 u8 u16 u64 u128 f32 char str bytes byte_buf unit unit_struct tuple_struct
        identifier ignored_any
    }
}

/// A list of that many numbers, for a message.
fn example(length: usize) -> String {
    vec!["0.0"; length].join(", ")
}

/// The elements of a list, in turn.
struct Elements<'p, 'de> {
    path: &'p str,
    rest: &'de [Value],
    next: usize,
}

impl<'de> SeqAccess<'de> for Elements<'_, 'de> {
    type Error = Fault;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, Fault> {
        let Some((value, rest)) = self.rest.split_first() else { return Ok(None) };
        let path = format!("{}[{}]", self.path, self.next);
        self.rest = rest;
        self.next += 1;
        seed.deserialize(Reader { path, value }).map(Some)
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.rest.len())
    }
}

/// The entries of a table, in turn.
struct Entries<'p, 'de> {
    path: &'p str,
    rest: toml::map::Iter<'de, String, Value>,
    entry: Option<(&'de str, &'de Value)>,
}

impl<'de> MapAccess<'de> for Entries<'_, 'de> {
    type Error = Fault;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, Fault> {
        let Some((key, value)) = self.rest.next() else { return Ok(None) };
        let key: &str = key;
        self.entry = Some((key, value));
        let key: StrDeserializer<Fault> = key.into_deserializer();
        seed.deserialize(key).map(Some)
    }

    fn next_value_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<T::Value, Fault> {
        let (key, value) = self.entry.take().expect("serde asks for a value after its key");
        seed.deserialize(Reader { path: joined(self.path, key), value })
    }
}
