//! The options that place a mesh, as keys of `[scene]`.

use crate::error::{Error, Result};
use crate::scene::Unit;
use crate::text::quoted;
use clap::Args;

/// How a mesh is placed; each option is the key of `[scene]` of the same name.
#[derive(Debug, Args, Clone, Default)]
#[command(next_help_heading = "Placement of the mesh")]
pub(super) struct Placement {
    /// Unit of its coordinates: m, cm, mm, in or ft (OBJ, STL and PLY do not define it).
    #[arg(long, value_name = "UNIT")]
    unit: Option<String>,
    /// Instead of a unit: its longest side, as in 0.5m, 30cm or 12in.
    #[arg(long, value_name = "LENGTH")]
    size: Option<String>,
    /// Factor on its size.
    #[arg(long, value_name = "FACTOR", allow_hyphen_values = true)]
    scale: Option<String>,
    /// Its upward axis: y (default of OBJ and glTF), z (of STL) or none, for the array's own axes (of PLY).
    #[arg(long, value_name = "AXIS")]
    up: Option<String>,
    /// Turn it by degrees about x (right), then y (down), then z (away from the array).
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    rotate: Option<String>,
    /// Where the centre of its bounding box goes, m.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    fit: Option<String>,
}

impl Placement {
    /// The options as run-file keys.
    ///
    /// # Errors
    /// A length without a number, or with an unknown unit.
    pub(super) fn keys(&self) -> Result<Vec<String>> {
        let size = self.size.as_deref().map(length).transpose()?.map(|length| format!("{length:?}"));
        // Three numbers are a list with or without brackets.
        let list = |typed: &Option<String>| {
            typed.as_ref().map(|t| if t.contains('[') { t.clone() } else { format!("[{t}]") })
        };
        let keys = [
            ("unit", self.unit.clone()),
            ("size", size),
            ("scale", self.scale.clone()),
            ("up", self.up.clone()),
            ("rotate", list(&self.rotate)),
            ("fit", list(&self.fit)),
        ];
        Ok(keys.into_iter().filter_map(|(key, value)| Some(format!("scene.{key}={}", value?))).collect())
    }
}

/// A length with its unit, m; without one it is in m.
fn length(typed: &str) -> Result<f64> {
    let text = typed.trim();
    let digits = text.find(|c: char| c.is_ascii_alphabetic() && c != 'e').unwrap_or(text.len());
    let (number, unit) = text.split_at(digits);
    let unit = if unit.is_empty() { Some(Unit::Metre) } else { unit.parse().ok() };
    let metres = number.trim().parse::<f64>().ok().zip(unit).map(|(number, unit)| number * unit.metres());
    metres.filter(|length| length.is_finite() && *length > 0.0).ok_or_else(|| {
        let problem =
            "was expected to be a length above 0 with its unit, as in 0.5m, 30cm, 250mm, 12in or 3ft";
        Error::input(format!("--size {}", quoted(typed)), problem)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_read_as_people_type_them() {
        for (typed, metres) in [
            ("0.5m", 0.5),
            ("30 cm", 0.3),
            ("250mm", 0.25),
            ("12in", 0.3048),
            ("3ft", 0.9144),
            ("2", 2.0),
            ("1e-1", 0.1),
        ] {
            assert!((length(typed).expect(typed) - metres).abs() < 1e-12, "{typed}");
        }
        for typed in ["", "m", "-1m", "0", "nan", "inf", "5 apples", "1km", "1e400m"] {
            assert!(length(typed).is_err(), "{typed}");
        }
    }

    #[test]
    fn options_are_keys() {
        let some = |text: &str| Some(text.to_owned());
        let placement = Placement { size: some("50cm"), rotate: some("0,180,0"), ..Placement::default() };
        assert_eq!(placement.keys().expect("valid"), ["scene.size=0.5", "scene.rotate=[0,180,0]"]);
        assert!(Placement::default().keys().expect("valid").is_empty());
    }
}
