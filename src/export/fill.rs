//! The value of a depth map where there is no depth.

use crate::error::{Error, Result as Outcome};
use serde::de::{self, Visitor};
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
        struct FillVisitor;
        impl Visitor<'_> for FillVisitor {
            type Value = Fill;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("\"inf\", \"nan\" or a number of metres")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Fill, E> {
                match text {
                    "inf" => Ok(Fill::Infinity),
                    "nan" => Ok(Fill::NaN),
                    _ => Err(E::invalid_value(de::Unexpected::Str(text), &self)),
                }
            }

            // TOML spells infinity and NaN without quotes, and either spelling is clear.
            fn visit_f64<E: de::Error>(self, depth: f64) -> Result<Fill, E> {
                if depth.is_nan() {
                    Ok(Fill::NaN)
                } else if depth == f64::INFINITY {
                    Ok(Fill::Infinity)
                } else if depth.is_finite() {
                    Ok(Fill::Depth(depth))
                } else {
                    Err(E::invalid_value(de::Unexpected::Float(depth), &self))
                }
            }

            fn visit_i64<E: de::Error>(self, depth: i64) -> Result<Fill, E> {
                Ok(Fill::Depth(depth as f64))
            }

            fn visit_u64<E: de::Error>(self, depth: u64) -> Result<Fill, E> {
                Ok(Fill::Depth(depth as f64))
            }
        }
        deserializer.deserialize_any(FillVisitor)
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
