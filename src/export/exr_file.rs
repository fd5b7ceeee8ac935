//! The common part of all `OpenEXR` files: attributes, encoding, and bit-identical files for the same input.

mod reading;
mod writing;

pub(super) use reading::read_parts;
pub(super) use writing::{OutputPart, Pixels, write_parts, writing_bytes};

use super::{Attribute, Attributes};
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result};
use crate::text::json_escape;
use exr::meta::attribute::{AttributeValue, Text};
use exr::prelude as ex;
use smallvec::SmallVec;

/// A part that was read, with channels of 32 or 16 bits.
pub(super) type ExrPart = ex::Layer<ex::AnyChannels<ex::FlatSamples>>;
/// All parts of a file.
pub(super) type ExrParts = ex::Image<ex::Layers<ex::AnyChannels<ex::FlatSamples>>>;

/// `OpenEXR`'s camera is left-handed with y up and z forward: the program's axes with y reversed.
pub(super) const WORLD_TO_CAMERA: [f32; 16] =
    [1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];

/// ASCII text for an attribute. Some programs read EXR's Latin-1 as UTF-8, so all other characters are escaped.
fn ascii(text: &str) -> Text {
    let mut bytes = SmallVec::new();
    for c in text.chars() {
        if c.is_ascii() {
            bytes.push(c as u8);
        } else {
            bytes.extend_from_slice(json_escape(c).as_bytes());
        }
    }
    Text::from_bytes_unchecked(bytes)
}

/// The attribute in EXR's types. For `v3d`, doubles, the exr crate has no type and passes the bytes through.
fn encode(value: &Attribute) -> AttributeValue {
    match value {
        Attribute::Text(text) => AttributeValue::Text(ascii(text)),
        Attribute::Number(number) => AttributeValue::F64(*number),
        Attribute::Integer(integer) => match i32::try_from(*integer) {
            Ok(integer) => AttributeValue::I32(integer),
            Err(_) => AttributeValue::F64(*integer as f64),
        },
        Attribute::Vector(vector) => {
            let bytes = vector.iter().flat_map(|number| number.to_le_bytes()).collect();
            AttributeValue::Custom { kind: ascii("v3d"), bytes }
        }
    }
}

/// The attribute of an EXR value; `None` for types that are never written.
fn decode(value: &AttributeValue) -> Option<Attribute> {
    Some(match value {
        AttributeValue::Text(text) => Attribute::Text(text.to_string()),
        AttributeValue::F64(number) => Attribute::Number(*number),
        AttributeValue::F32(number) => Attribute::Number(f64::from(*number)),
        AttributeValue::I32(integer) => Attribute::Integer(i64::from(*integer)),
        AttributeValue::FloatVec3((x, y, z)) => {
            Attribute::Vector([f64::from(*x), f64::from(*y), f64::from(*z)])
        }
        AttributeValue::Custom { kind, bytes } if kind.eq("v3d") && bytes.len() == 24 => {
            let numbers = bytes.as_chunks::<8>().0.iter().map(|eight| f64::from_le_bytes(*eight));
            Attribute::Vector(numbers.collect::<Vec<_>>().try_into().ok()?)
        }
        _ => return None,
    })
}

/// The attributes of a part's header, sorted by name.
pub(super) fn attributes_of(header: &ex::LayerAttributes) -> Attributes {
    let mut attributes: Attributes =
        header.other.iter().filter_map(|(name, value)| Some((name.to_string(), decode(value)?))).collect();
    attributes.sort_by(|a, b| a.0.cmp(&b.0));
    attributes
}

/// The error for a channel that does not fit in memory.
pub(super) fn no_room([width, height]: [usize; 2]) -> Error {
    Error::out_of_memory(format!(
        "a channel of {width} x {height} pixels of an EXR does not fit in memory; use fewer pixels, or free some memory"
    ))
}

/// Checks that this many channels of an image fit in memory, before they are allocated one by one.
pub(super) fn expect_room(channels: usize, [width, height]: [usize; 2]) -> Result<()> {
    let values = (channels as u64).saturating_mul(width as u64).saturating_mul(height as u64);
    try_with_capacity::<f32>(values).map(drop).ok_or_else(|| no_room([width, height]))
}

/// The channel of this name.
pub(super) fn channel_of<'a>(part: &'a ExrPart, name: &str) -> Option<&'a ex::AnyChannel<ex::FlatSamples>> {
    part.channel_data.list.iter().find(|channel| channel.name.eq(name))
}

/// A channel's numbers, whatever their type.
pub(super) fn floats(samples: &ex::FlatSamples) -> Vec<f32> {
    let mut values = Vec::with_capacity(samples.len());
    let _ = append_floats(samples, &mut values); // the capacity is sufficient
    values
}

/// Appends a channel's numbers, whatever their type, to `values`; `None` if they do not fit in memory.
pub(super) fn append_floats(samples: &ex::FlatSamples, values: &mut Vec<f32>) -> Option<()> {
    values.try_reserve(samples.len()).ok()?;
    match samples {
        ex::FlatSamples::F32(samples) => values.extend_from_slice(samples),
        ex::FlatSamples::F16(samples) => values.extend(samples.iter().map(|sample| sample.to_f32())),
        ex::FlatSamples::U32(samples) => values.extend(samples.iter().map(|&sample| sample as f32)),
    }
    Some(())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::export::Encoding;

    fn one_pixel(attributes: &[(String, Attribute)]) -> OutputPart<'static> {
        let channels = vec![("Z".into(), Pixels::Held(vec![1.0]))];
        OutputPart::new(None, [1, 1], channels, attributes, Encoding::default())
    }

    #[test]
    fn text_beyond_ascii_is_escaped_as_in_json() {
        let escaped = ascii("{\"name\": \"Ünit → 𝄞\"}").to_string();
        assert_eq!(escaped, "{\"name\": \"\\u00dcnit \\u2192 \\ud834\\udd1e\"}");
        let parsed: serde_json::Value = serde_json::from_str(&escaped).unwrap();
        assert_eq!(parsed["name"], "Ünit → 𝄞");
    }

    #[test]
    fn attributes_are_read_as_they_were_written() {
        let attributes = vec![
            ("sonar:big".to_owned(), Attribute::Integer(1 << 40)),
            ("sonar:gridOrigin".to_owned(), Attribute::Vector([0.1, -0.2, 1.0 / 3.0])),
            ("sonar:seed".to_owned(), Attribute::Integer(-7)),
            ("sonar:soundSpeed".to_owned(), Attribute::Number(343.2)),
            ("sonar:window".to_owned(), Attribute::Text("taylor".into())),
        ];
        let mut part = one_pixel(&attributes);
        let mut expected = attributes;
        expected[0].1 = Attribute::Number((1_u64 << 40) as f64);
        assert_eq!(attributes_of(part.attributes()), expected);
    }

    #[test]
    #[should_panic(expected = "start with `sonar:`")]
    fn an_attribute_cannot_take_a_reserved_name() {
        let _ = one_pixel(&[("channels".into(), Attribute::Integer(1))]);
    }
}
