//! Keys of two values, for which one value may be typed.

use serde::de::value::SeqAccessDeserializer;
use serde::de::{Deserialize, Error, IntoDeserializer, SeqAccess, Visitor};
use std::fmt;

/// Reads `[a, b]`, or a single value, from which `single` makes both.
pub(super) struct PairVisitor<T> {
    pub(super) expecting: &'static str,
    pub(super) single: fn(T) -> [T; 2],
}

impl<'de, T: Deserialize<'de>> Visitor<'de> for PairVisitor<T> {
    type Value = Option<[T; 2]>;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.expecting)
    }

    fn visit_unit<E: Error>(self) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Self::Value, E> {
        T::deserialize(value.into_deserializer()).map(|value| Some((self.single)(value)))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Self::Value, E> {
        T::deserialize(value.into_deserializer()).map(|value| Some((self.single)(value)))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Self::Value, E> {
        T::deserialize(value.into_deserializer()).map(|value| Some((self.single)(value)))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Self::Value, A::Error> {
        let values = Vec::deserialize(SeqAccessDeserializer::new(list))?;
        let pair: Result<[T; 2], Vec<T>> = values.try_into();
        pair.map(Some).map_err(|values| A::Error::invalid_length(values.len(), &self))
    }
}
