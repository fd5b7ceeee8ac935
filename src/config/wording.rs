//! What messages quote and propose.

use super::RunFile;
use crate::text::{nearest, quoted};
use toml::Value;

/// What a value is, in plain words.
pub(super) fn described(value: &Value) -> String {
    match value {
        Value::String(text) => format!("the text \"{}\"", quoted(text)),
        Value::Integer(number) => format!("the number {number}"),
        Value::Float(number) => format!("the number {number:?}"),
        Value::Boolean(truth) => truth.to_string(),
        Value::Datetime(_) => "a date".to_owned(),
        Value::Array(list) => match list.len() {
            0 => "an empty list".to_owned(),
            1 => "a list of one value".to_owned(),
            n => format!("a list of {n} values"),
        },
        Value::Table(_) => "a table".to_owned(),
    }
}

/// The message about a key that its table does not have.
pub(super) fn unknown_key(table: &str, key: &str, keys: &[&str]) -> String {
    let meant = match (nearest(key, keys), tables_with(key).as_slice()) {
        (Some(near), _) => format!("; did you mean `{near}`?"),
        (None, []) => String::new(),
        (None, tables) => format!("; it belongs in {}", tables.join(" or ")),
    };
    let end = if meant.ends_with('?') { "" } else { "." };
    format!("unknown key `{}` in [{table}]{meant}{end} (Keys here: {}.)", quoted(key), keys.join(", "))
}

/// The message about a name at the top level of the file that is not a table of a run file.
pub(super) fn unknown_table(name: &str, value: &Value, tables: &[&str]) -> String {
    let is_table =
        value.is_table() || value.as_array().is_some_and(|list| list.first().is_some_and(Value::is_table));
    let found = if is_table {
        format!("unknown table [{}]", quoted(name))
    } else {
        format!("unknown key `{}` outside every table", quoted(name))
    };
    let meant = match (nearest(name, tables), tables_with(name).as_slice()) {
        (_, owners) if !is_table && !owners.is_empty() => format!("; it belongs in {}.", owners.join(" or ")),
        (Some(near), _) => format!("; did you mean [{near}]?"),
        _ => ".".to_owned(),
    };
    format!("{found}{meant} (Tables: {}.)", tables.join(", "))
}

/// The tables that have a key of this name, in brackets.
pub(super) fn tables_with(key: &str) -> Vec<String> {
    let serde_json::Value::Object(tables) = RunFile::default().to_json() else { return Vec::new() };
    tables.iter().filter(|(_, keys)| keys.get(key).is_some()).map(|(table, _)| format!("[{table}]")).collect()
}
