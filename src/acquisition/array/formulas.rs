//! Microphone positions from formulas of their indices: scans whose files know the order of their positions, and no more.
//!
//! `exmex` parses and evaluates them: of arithmetic, the usual functions and three variables, without a way to anything
//! else. Of 400 000 random texts none made it panic, and 200 000 nested brackets are no burden to it; other crates
//! for this are no longer maintained (`meval`, `fasteval`) or languages of their own.

use super::{MicArray, check_count};
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result, gib};
use crate::text::{one_line, quoted};
use exmex::{Express, FlatEx, FloatOpsFactory, MatchLiteral, literal_matcher_from_pattern};
use glam::DVec3;

/// Longer formulas are refused, bytes.
const LONGEST: usize = 1000;

/// What a formula may name: column, row and number of a microphone, counted from 0, and half a turn.
const VARIABLES: [&str; 4] = ["ix", "iy", "i", "pi"];

/// Formulas of the positions of `count` = [columns, rows] microphones, m.
///
/// They may name `ix` and `iy`, the column and row of a microphone counted from 0, `i = iy · columns + ix`, and `pi`; `+ - *
/// / ^`, brackets, and functions such as `sin`, `cos` and `sqrt`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PositionFormulas {
    /// Columns and rows.
    pub count: [usize; 2],
    /// x, y and z.
    pub formulas: [String; 3],
}

literal_matcher_from_pattern!(WithExponent, r"^([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?");

/// A formula of numbers that may have an exponent.
type Parsed = FlatEx<f64, FloatOpsFactory<f64>, WithExponent>;

/// A formula, and the values of its variables.
struct Formula {
    parsed: Parsed,
    /// Of each variable, in the order in which it is evaluated, which of [`VARIABLES`] it is.
    variables: Vec<usize>,
}

impl Formula {
    fn parse(text: &str) -> std::result::Result<Self, String> {
        if text.len() > LONGEST {
            return Err(format!("is {} bytes long; up to {LONGEST} are possible", text.len()));
        }
        let parsed =
            Parsed::parse(text).map_err(|error| format!("is no formula: {}", one_line(error.msg())))?;
        let known = |name: &String| {
            VARIABLES.iter().position(|variable| variable == name).ok_or_else(|| {
                format!("names `{}`; a formula knows ix, iy, i and pi, and sin, cos, sqrt, ...", quoted(name))
            })
        };
        let variables = parsed.var_names().iter().map(known).collect::<std::result::Result<_, _>>()?;
        Ok(Self { parsed, variables })
    }

    /// NaN where it has no value.
    fn at(&self, values: [f64; 4]) -> f64 {
        let own: Vec<f64> = self.variables.iter().map(|which| values[*which]).collect();
        self.parsed.eval(&own).unwrap_or(f64::NAN)
    }
}

/// What is wrong with the text of a formula.
pub(crate) fn check_formula(text: &str) -> std::result::Result<(), String> {
    Formula::parse(text).map(drop)
}

impl PositionFormulas {
    /// The microphones, row by row, within `limit` bytes.
    ///
    /// # Errors
    /// A formula that is none, and one without a finite value; no microphones or more than 2²⁴.
    pub(in crate::acquisition) fn microphones(&self, place: &str, limit: u64) -> Result<MicArray> {
        let [n_x, n_y] = self.count;
        let count = n_x.saturating_mul(n_y);
        check_count(count).map_err(|error| error.at(place))?;
        let bytes = (count * size_of::<DVec3>()) as u64;
        if bytes > limit {
            let problem = format!("of {count} microphones take {} of memory, more than there is", gib(bytes));
            return Err(Error::input(place, problem + " (--memory sets another limit); give fewer"));
        }
        let parse = |(name, text): (&str, &String)| {
            Formula::parse(text).map_err(|problem| Error::input(format!("{place}.{name}"), problem))
        };
        let formulas =
            ["x", "y", "z"].into_iter().zip(&self.formulas).map(parse).collect::<Result<Vec<Formula>>>()?;
        let mut points = try_with_capacity(count as u64)
            .ok_or_else(|| Error::out_of_memory(format!("{count} positions do not fit in memory")))?;
        for i in 0..count {
            let (ix, iy) = (i % n_x, i / n_x);
            let values = [ix as f64, iy as f64, i as f64, std::f64::consts::PI];
            let [x, y, z] = [0, 1, 2].map(|axis| formulas[axis].at(values));
            if !(x + y + z).is_finite() {
                let problem = format!(
                    "give ({x}, {y}, {z}) where ix = {ix}, iy = {iy}; finite numbers in m were expected"
                );
                return Err(Error::input(place, problem));
            }
            points.push(DVec3::new(x, y, z));
        }
        MicArray::from_rows([n_y, n_x], points).map_err(|error| error.at(place))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    fn of(count: [usize; 2], formulas: [&str; 3]) -> Result<MicArray> {
        PositionFormulas { count, formulas: formulas.map(str::to_owned) }.microphones("here", 1 << 20)
    }

    #[test]
    fn formulas_are_those_of_rows_and_circles() {
        let raster = of([5, 4], ["0.003 * ix", "0.003 * iy - 0.1", "0"]).unwrap();
        let lattice = raster.lattice().unwrap();
        assert_eq!((lattice.x.count, lattice.y.count, raster.shape()), (5, 4, vec![4, 5]));
        assert!((lattice.y.first + 0.1).abs() < 1e-15);
        let ring = of(
            [8, 1],
            ["0.2*cos(2*pi*i/8)", "0.2 * sin(2e0 * pi * i / 8)", "-(ix - i)*1E-3 + i * .5e+0 - i/2."],
        )
        .unwrap();
        for (i, found) in ring.positions().iter().enumerate() {
            let (sin, cos) = (std::f64::consts::TAU * i as f64 / 8.0).sin_cos();
            assert!(found.distance(DVec3::new(0.2 * cos, 0.2 * sin, 0.0)) < 1e-15, "{found}");
        }
    }

    #[test]
    fn what_is_no_formula_is_refused() {
        let nested = "(".repeat(400) + "ix" + &")".repeat(400);
        assert!(of([2, 2], [&nested, "iy", "0"]).is_ok());
        let long = "1+".repeat(600) + "1";
        for (formula, part) in [
            ("3 *", "no formula"),
            ("", "no formula"),
            ("3 * x", "`x`"),
            ("0.01 ix", "no formula"),
            ("(ix", "no formula"),
            ("ix; iy", "no formula"),
            (&long, "1000"),
        ] {
            assert_names(of([2, 2], ["0", formula, "0"]).unwrap_err().to_string(), &["here.y", part]);
        }
        assert_names(of([2, 2], ["1/ix", "0", "0"]).unwrap_err().to_string(), &["here", "inf", "ix = 0"]);
        assert!(of([0, 2], ["ix", "iy", "0"]).is_err());
        assert_names(of([3000, 3000], ["ix", "iy", "0"]).unwrap_err().to_string(), &["--memory"]);
    }
}
