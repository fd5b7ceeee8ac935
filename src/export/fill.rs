//! The value of a depth map where there is no depth.

use crate::error::{Error, Result as Outcome};
use serde::de;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::str::FromStr;

/// The value of `Z` where no return was accepted: written `"inf"`, `"nan"`, or a number of m.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Fill {
    /// `+∞`.
    #[default]
    Infinity,
    /// Not a number.
    NaN,
    /// This depth, m.
    Depth(f64),
}

impl Fill {
    /// The value itself, m.
    pub fn value(self) -> f64 {
        match self {
            Self::Infinity => f64::INFINITY,
            Self::NaN => f64::NAN,
            Self::Depth(depth) => depth,
        }
    }
}

impl fmt::Display for Fill {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Infinity => f.pad("inf"),
            Self::NaN => f.pad("nan"),
            Self::Depth(depth) => depth.fmt(f),
        }
    }
}

impl FromStr for Fill {
    type Err = Error;

    /// Reads `inf`, `nan` or a number of m.
    fn from_str(text: &str) -> Outcome<Self> {
        match text {
            "inf" => Ok(Self::Infinity),
            "nan" => Ok(Self::NaN),
            _ => match text.parse() {
                Ok(depth) if f64::is_finite(depth) => Ok(Self::Depth(depth)),
                _ => Err(crate::choice::unknown("fill", text, &["inf", "nan", "a number of m"])),
            },
        }
    }
}

impl Serialize for Fill {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Depth(depth) => serializer.serialize_f64(*depth),
            word => serializer.collect_str(word),
        }
    }
}

impl<'de> Deserialize<'de> for Fill {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged, expecting = "expected \"inf\", \"nan\" or a number of metres")]
        enum Written {
            Number(f64),
            Word(String),
        }
        let invalid = |found| de::Error::invalid_value(found, &"\"inf\", \"nan\" or a number of metres");
        match Written::deserialize(deserializer)? {
            // TOML also has infinity and NaN as numbers, without quotes.
            Written::Number(f64::INFINITY) => Ok(Self::Infinity),
            Written::Number(depth) if depth.is_nan() => Ok(Self::NaN),
            Written::Number(depth) if depth.is_finite() => Ok(Self::Depth(depth)),
            Written::Number(depth) => Err(invalid(de::Unexpected::Float(depth))),
            Written::Word(word) => match word.as_str() {
                "inf" => Ok(Self::Infinity),
                "nan" => Ok(Self::NaN),
                _ => Err(invalid(de::Unexpected::Str(&word))),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Fill;

    #[test]
    fn a_fill_is_read_as_it_is_displayed() {
        for fill in [Fill::Infinity, Fill::NaN, Fill::Depth(0.0), Fill::Depth(9.5)] {
            assert_eq!(fill.to_string().parse(), Ok(fill));
        }
        for wrong in ["", "infinity", "1e999", "far"] {
            let error = wrong.parse::<Fill>().expect_err("no fill").to_string();
            assert!(error.contains("inf") && error.contains("nan") && error.contains("number"), "{error}");
        }
    }
}
