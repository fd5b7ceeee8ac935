//! The keys of a sweep and their values, as typed.

use crate::error::{Error, Result};
use crate::text::quoted;

/// Maximum number of combinations of a sweep: a prediction takes some tens of milliseconds, a simulation longer.
pub(super) const MAX_COMBINATIONS: usize = 50_000;

/// A key of the run file and its values in a sweep.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SweptKey {
    /// `table.key`.
    pub key: String,
    /// Values as they would be typed after `--set table.key=`.
    pub values: Vec<String>,
}

impl SweptKey {
    /// Reads `KEY=FROM:TO:STEP`, both ends included, or `KEY=a,b,c`; commas within brackets belong to a value.
    ///
    /// # Errors
    /// Text of neither form; a range that never ends, or that has more than 50000 values.
    pub fn parse(typed: &str) -> Result<Self> {
        let wrong = |problem: &str| {
            Error::input(
                format!("--sweep {}", quoted(typed)),
                format!("{problem}; expected KEY=FROM:TO:STEP, as in array.extent=0.5:2:0.25, or KEY=a,b,c"),
            )
        };
        let (key, values) = typed.split_once('=').ok_or_else(|| wrong("has no `=`"))?;
        let (key, values) = (key.trim().to_owned(), values.trim());
        if key.is_empty() || values.is_empty() {
            return Err(wrong("lacks its key or its values"));
        }
        let numbers: Option<Vec<f64>> = values.split(':').map(|part| part.trim().parse().ok()).collect();
        if let Some([from, to, step]) = numbers.as_deref() {
            let intervals = ((to - from) / step + 1e-6).floor();
            if !(intervals >= 0.0 && intervals < MAX_COMBINATIONS as f64) {
                return Err(wrong("is a range that never ends, or that has more than 50000 values"));
            }
            // Rounded, so that 0.1 + 0.2 is 0.3 as typed.
            let value = |i: usize| ((from + i as f64 * step) * 1e9).round() / 1e9;
            let values = (0..=intervals as usize).map(|i| value(i).to_string()).collect();
            return Ok(Self { key, values });
        }
        let mut list = vec![String::new()];
        let mut depth = 0_i32;
        for c in values.chars() {
            match c {
                '[' | '{' => depth += 1,
                ']' | '}' => depth -= 1,
                _ => {}
            }
            match list.last_mut() {
                Some(last) if c != ',' || depth > 0 => last.push(c),
                _ => list.push(String::new()),
            }
        }
        let values: Vec<String> = list.iter().map(|value| value.trim().to_owned()).collect();
        if values.iter().any(String::is_empty) {
            return Err(wrong("has an empty value"));
        }
        Ok(Self { key, values })
    }
}

/// The settings of a combination.
pub(super) fn settings(keys: &[SweptKey], values: &[String]) -> Vec<String> {
    keys.iter().zip(values).map(|(key, value)| format!("{}={value}", key.key)).collect()
}

/// The number of combinations.
///
/// # Errors
/// More than there may be.
pub(super) fn count(keys: &[SweptKey]) -> Result<usize> {
    let total = keys.iter().fold(1_usize, |total, key| total.saturating_mul(key.values.len()));
    if total <= MAX_COMBINATIONS {
        return Ok(total);
    }
    let problem = format!("{total} combinations are too many; the maximum is {MAX_COMBINATIONS}");
    Err(Error::input("--sweep", problem))
}

/// Every combination of the keys' values, the last key fastest.
pub(super) fn products(keys: &[SweptKey]) -> Vec<Vec<String>> {
    keys.iter().fold(vec![Vec::new()], |products, key| {
        let extended = |product: &[String], value: &String| [product, std::slice::from_ref(value)].concat();
        products.iter().flat_map(|product| key.values.iter().map(move |v| extended(product, v))).collect()
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::SweptKey;
    use crate::named::assert_names;

    #[test]
    fn swept_keys_are_ranges_or_lists() {
        let values = |typed: &str| SweptKey::parse(typed).unwrap().values;
        assert_eq!(values("array.extent=0.5:2:0.5"), ["0.5", "1", "1.5", "2"]);
        assert_eq!(values("sweep.step=0.1:0.3:0.1"), ["0.1", "0.2", "0.3"]);
        assert_eq!(values("a.b=3:1:-1"), ["3", "2", "1"]);
        assert_eq!(values("array.layout=grid, spiral"), ["grid", "spiral"]);
        assert_eq!(values("array.count=[15,15],[31,31]"), ["[15,15]", "[31,31]"]);
        for (typed, part) in [
            ("array.count", "`=`"),
            ("=1,2", "key"),
            ("a.b=", "values"),
            ("a.b=1,,2", "empty"),
            ("a.b=0:1:0", "50000"),
            ("a.b=0:1:-1", "50000"),
            ("a.b=0:1:1e-9", "50000"),
            ("a.b=nan:1:1", "50000"),
        ] {
            assert_names(SweptKey::parse(typed).unwrap_err().to_string(), &["--sweep", typed, part]);
        }
    }
}
