//! Metrics held to limits: what `check`, `compare --min/--max` and our own regression tests share.

use crate::config::Limit;
use crate::error::{Error, Result};
use crate::metrics::{METRIC_NAMES, Metrics};

/// A limit on one metric.
#[derive(Debug, Clone, PartialEq)]
pub struct Bound {
    /// Its name, one of [`METRIC_NAMES`].
    pub metric: String,
    /// Least and greatest value allowed.
    pub limit: Limit,
}

impl Bound {
    /// Parses `NAME=VALUE` as a least (`min`) or greatest value.
    ///
    /// # Errors
    /// No such metric, or no number.
    pub fn parse(option: &str, typed: &str, min: bool) -> Result<Self> {
        let (name, value) = typed.split_once('=').unwrap_or((typed, ""));
        let value: f64 = value.trim().parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| {
            Error::input(option, format!("`{typed}` was expected to be NAME=NUMBER, as in completeness=0.65"))
        })?;
        let name = name.trim();
        if !METRIC_NAMES.contains(&name) {
            let known = METRIC_NAMES.join(", ");
            return Err(Error::input(option, format!("there is no metric `{name}`; known are {known}")));
        }
        let limit =
            if min { Limit { min: Some(value), max: None } } else { Limit { min: None, max: Some(value) } };
        Ok(Self { metric: name.to_owned(), limit })
    }
}

/// How one metric stands to its limit.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// The limit.
    pub bound: Bound,
    /// What was measured; `None` where there was nothing to measure it on, which fails.
    pub value: Option<f64>,
    /// Whether the limit is kept.
    pub kept: bool,
}

/// Holds metrics to limits, one verdict each.
pub fn hold(metrics: &Metrics, bounds: impl IntoIterator<Item = Bound>) -> Vec<Verdict> {
    bounds
        .into_iter()
        .map(|bound| {
            let value = metrics.get(&bound.metric).flatten();
            let kept = value.is_some_and(|v| {
                bound.limit.min.is_none_or(|min| v >= min) && bound.limit.max.is_none_or(|max| v <= max)
            });
            Verdict { bound, value, kept }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_inclusive_and_nothing_measured_fails() {
        let metrics = Metrics { completeness: Some(0.65), ..Metrics::default() };
        let kept = |typed: &str, min: bool| {
            let bound = Bound::parse("--min", typed, min).expect("valid");
            hold(&metrics, [bound])[0].kept
        };
        assert!(kept("completeness=0.65", true) && kept("completeness=0.65", false));
        assert!(!kept("completeness=0.66", true) && !kept("completeness=0.64", false));
        assert!(!kept("rmse=1", false), "an rmse of nothing is no success");
    }

    #[test]
    fn a_bound_names_a_known_metric_and_a_number() {
        for typed in ["completness=0.5", "completeness", "completeness=much", "completeness=nan"] {
            assert!(Bound::parse("--min", typed, true).is_err(), "{typed}");
        }
    }
}
