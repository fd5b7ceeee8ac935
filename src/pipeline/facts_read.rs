//! The metadata of images and truths, read back from files, as Python shows it.

use super::facts::{aperture_of, resolution_of};
use crate::export::{Attribute, attributes_as_json};
use crate::wave::Resolution;
use serde_json::Value;

/// The metadata of which these are the attributes; those of other programs keep their names.
pub(crate) fn facts_of_attributes(attributes: &[(String, Attribute)]) -> Value {
    let fact = |(name, value): (String, Value)| {
        let Some(name) = name.strip_prefix("sonar:") else { return (name, value) };
        // What was nested is JSON text.
        let nested = value.as_str().filter(|text| text.starts_with(['{', '[']));
        let nested = nested.and_then(|text| serde_json::from_str(text).ok());
        (snake_case(name), nested.unwrap_or(value))
    };
    match attributes_as_json(attributes) {
        Value::Object(facts) => Value::Object(facts.into_iter().map(fact).collect()),
        other => other,
    }
}

/// What can be resolved, from the metadata of an image or a truth.
pub(crate) fn resolution_in(meta: &Value) -> Option<Resolution> {
    let range = resolution_of(meta).or_else(|| meta["range_resolution"].as_f64())?;
    Some(Resolution { range, aperture: aperture_of(meta) })
}

/// `soundSpeed` → `sound_speed`, the inverse of [`camel_case`].
fn snake_case(name: &str) -> String {
    name.chars().fold(String::new(), |mut text, c| {
        if c.is_ascii_uppercase() {
            text.push('_');
        }
        text.push(c.to_ascii_lowercase());
        text
    })
}
