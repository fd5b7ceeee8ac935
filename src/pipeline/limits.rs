//! Checks metrics against limits, for `check`, `compare --min/--max` and the regression tests.

use super::job::JobOptions;
use super::oracle::oracle_of_scene;
use crate::config::{Limit, RunFile};
use crate::error::{Error, Result};
use crate::metrics::{METRIC_NAMES, Measure, Scores};
use crate::text::quoted;
use serde::Serialize;
use std::path::Path;

/// A limit on one metric.
#[derive(Debug, Clone, PartialEq)]
pub struct Bound {
    /// The metric, of everything or of one material or surface.
    pub measure: Measure,
    /// Minimum and maximum value.
    pub limit: Limit,
}

impl Bound {
    /// Parses `NAME=VALUE`, `NAME:MATERIAL=VALUE` or `NAME#K=VALUE` as a minimum (if `min`) or a maximum.
    ///
    /// # Errors
    /// An unknown metric, or a value that is not a number.
    pub fn parse(option: &str, typed: &str, min: bool) -> Result<Self> {
        // A material's name may contain an equals sign, but a number does not.
        let (name, value) = typed.rsplit_once('=').unwrap_or((typed, ""));
        let value: f64 = value.trim().parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| {
            Error::input(
                option,
                format!(
                    "`{}` was expected to be NAME=NUMBER, as in completeness=0.65; of a material \
                     completeness:glass=0.8, of the second surface completeness#2=0.8",
                    quoted(typed)
                ),
            )
        })?;
        let measure = measure_of(option, name.trim())?;
        Ok(Self { measure, limit: Limit { min: min.then_some(value), max: (!min).then_some(value) } })
    }
}

/// The measure that an option names.
///
/// # Errors
/// An unknown metric.
pub(crate) fn measure_of(option: &str, typed: &str) -> Result<Measure> {
    Measure::parse(typed).map_err(|unknown| {
        let known = METRIC_NAMES.join(", ");
        Error::input(option, format!("there is no metric `{}`; expected one of {known}", quoted(&unknown)))
    })
}

/// A metric compared with its limit.
#[derive(Debug, Clone, PartialEq)]
pub struct LimitVerdict {
    /// The limit.
    pub bound: Bound,
    /// The mean of the metric over the seeds; `None` if there was nothing to measure, which fails.
    pub value: Option<f64>,
    /// The metric of each seed.
    pub each: Vec<Option<f64>>,
    /// Whether the limit is kept.
    pub kept: bool,
}

/// Compares the means of metrics with limits; `scores` are those of one or several seeds.
pub fn hold(scores: &[Scores], bounds: impl IntoIterator<Item = Bound>) -> Vec<LimitVerdict> {
    bounds
        .into_iter()
        .map(|bound| {
            let each: Vec<Option<f64>> = scores.iter().map(|scores| scores.get(&bound.measure)).collect();
            let value = mean(&each);
            let kept = value.is_some_and(|v| {
                bound.limit.min.is_none_or(|min| v >= min) && bound.limit.max.is_none_or(|max| v <= max)
            });
            LimitVerdict { bound, value, each, kept }
        })
        .collect()
}

/// The mean over the seeds; a metric that one of them lacks has none.
pub(super) fn mean(each: &[Option<f64>]) -> Option<f64> {
    let sum: Option<f64> = each.iter().copied().sum();
    sum.filter(|_| !each.is_empty()).map(|sum| sum / each.len() as f64)
}

/// The seeds with which a scene is run: those typed, or else those of `[expect]`, or else its own.
pub(super) fn seeds_of(run: &RunFile, typed: &[u32]) -> Vec<u32> {
    match (typed, run.expect.seeds.as_slice()) {
        ([], []) => vec![run.reflectors.seed],
        ([], seeds) | (seeds, _) => seeds.to_vec(),
    }
}

/// The scores of a scene with each of these seeds; `None` of one without a truth.
///
/// # Errors
/// The errors of the stages.
pub(super) fn scores_of(run: &RunFile, seeds: &[u32], job: &JobOptions) -> Result<Option<Vec<Scores>>> {
    let mut run = run.clone();
    let score = |&seed: &u32| {
        run.reflectors.seed = seed;
        super::image_scene(&run, job).map(|outcome| outcome.scores)
    };
    seeds.iter().map(score).collect()
}

/// The limits of `[expect]`; errors name `place`.
///
/// # Errors
/// A limit on what is no metric.
pub(super) fn bounds_of(run: &RunFile, place: &str) -> Result<Vec<Bound>> {
    let bound = |(name, limit): (&String, &Limit)| {
        let unknown =
            |name: String| Error::input(place, format!("[expect] names no metric `{}`", quoted(&name)));
        Ok(Bound { measure: Measure::parse(name).map_err(unknown)?, limit: *limit })
    };
    run.expect.limits.iter().map(bound).collect()
}

/// A scene checked against its `[expect]`.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Judgement {
    /// The `[reflectors]` seeds of its runs.
    pub seeds: Vec<u32>,
    /// All metrics of each seed.
    pub scores: Vec<Scores>,
    /// What the aperture could show at best, if it was asked for.
    pub oracle: Option<Scores>,
    /// Each limit, and whether it is kept.
    #[serde(skip)]
    pub verdicts: Vec<LimitVerdict>,
}

/// Runs a scene and checks its metrics against the run file's `[expect]`, as the command `check` does.
///
/// It is run with each of `seeds`, or else with each of `[expect] seeds`, or else with its own seed; the means must keep the
/// limits. With `oracle`, the scores of [`oracle_of_scene`] are found as well. Errors name `path`.
///
/// # Errors
/// The errors of the stages; a run file without `[expect]`, or a scene without a truth.
pub fn check_scene(
    path: &Path,
    run: &RunFile,
    seeds: &[u32],
    oracle: bool,
    job: &JobOptions,
) -> Result<Judgement> {
    if run.expect.limits.is_empty() {
        return Err(Error::input(
            path.display(),
            "has no [expect], so that there is nothing to check; add for example `completeness = { min = 0.65 }`",
        ));
    }
    let seeds = seeds_of(run, seeds);
    let scores = scores_of(run, &seeds, job)?.ok_or_else(|| {
        Error::input(path.display(), "has no mesh, and therefore no truth, which [expect] needs")
    })?;
    let verdicts = hold(&scores, bounds_of(run, &path.display().to_string())?);
    let oracle = if oracle { Some(oracle_of_scene(run, job)?.scores) } else { None };
    Ok(Judgement { seeds, scores, oracle, verdicts })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scores(completeness: Option<f64>) -> Scores {
        let mut scores = Scores::default();
        scores.all.completeness = completeness;
        scores
    }

    fn verdict(scores: &[Scores], typed: &str, min: bool) -> LimitVerdict {
        hold(scores, [Bound::parse("--min", typed, min).expect("valid")]).remove(0)
    }

    #[test]
    fn limits_are_inclusive_and_nothing_measured_fails() {
        let kept = |typed: &str, min: bool| verdict(&[scores(Some(0.65))], typed, min).kept;
        assert!(kept("completeness=0.65", true) && kept("completeness=0.65", false));
        assert!(!kept("completeness=0.66", true) && !kept("completeness=0.64", false));
        assert!(!kept("rmse=1", false), "an rmse without data is no success");
        assert!(!kept("completeness:glass=0.1", true), "nor is one of a missing material");
    }

    #[test]
    fn the_mean_of_the_seeds_must_keep_the_limit() {
        let seeds = [scores(Some(0.5)), scores(Some(0.9))];
        let held = verdict(&seeds, "completeness=0.69", true);
        assert!(held.kept && held.each == [Some(0.5), Some(0.9)]);
        assert!(!verdict(&seeds, "completeness=0.71", true).kept);
        assert!(!verdict(&[scores(Some(0.9)), scores(None)], "completeness=0.1", true).kept);
        assert!(!verdict(&[], "completeness=0.1", true).kept);
    }

    #[test]
    fn a_bound_names_a_known_metric_and_a_number() {
        for typed in ["completness=0.5", "completeness", "completeness=much", "completeness=nan", "rmse#0=1"]
        {
            assert!(Bound::parse("--min", typed, true).is_err(), "{typed}");
        }
        let bound = Bound::parse("--min", "completeness:a=b=0.5", true).expect("valid");
        assert_eq!((bound.measure.to_string().as_str(), bound.limit.min), ("completeness:a=b", Some(0.5)));
    }
}
