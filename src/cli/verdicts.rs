//! The commands that judge: `compare` and `check`, and their exit status.

use super::commands::{pretty, reading_limit};
use super::terminal::{Terminal, print};
use super::{Overrides, summary};
use holosonar::error::{Error, Result};
use holosonar::export::depth_exr::{DepthFile, read_depth_map};
use holosonar::export::{Attribute, find_attribute};
use holosonar::metrics::{Metrics, evaluate};
use holosonar::pipeline::{self, Bound, Verdict};
use std::path::{Path, PathBuf};

/// Scores a depth map and holds it to the limits typed.
pub(super) fn compare(
    result: &Path,
    truth_path: &Path,
    resolution: Option<f64>,
    min: &[String],
    max: &[String],
    json: bool,
) -> Result<()> {
    let mut bounds = Vec::new();
    for (option, typed, is_min) in [("--min", min, true), ("--max", max, false)] {
        for typed in typed {
            bounds.push(Bound::parse(option, typed, is_min)?);
        }
    }
    let mut found = read_depth_map(result, reading_limit())?;
    let truth = read_depth_map(truth_path, reading_limit())?;
    if !found.axes_known && found.map.shape() == truth.map.shape() {
        // A foreign depth map says nothing of metres; pixel for pixel is what its user means.
        (found.map.x, found.map.y) = (truth.map.x, truth.map.y);
    }
    let said = |file: &DepthFile| match find_attribute(&file.attributes, "sonar:rangeResolution") {
        Some(Attribute::Number(resolution)) => Some(*resolution),
        _ => None,
    };
    let resolution = resolution.or_else(|| said(&truth)).or_else(|| said(&found)).ok_or_else(|| {
        Error::input(
            "--resolution",
            "is needed: neither file says its range resolution c/2B, by which hits and misses are told apart",
        )
    })?;
    let (pixels, wanted) = (found.map.shape(), truth.map.shape());
    if pixels != wanted {
        return Err(Error::input(
            result.display(),
            format!(
                "has {} x {} pixels, but {} has {} x {}; both must be of one [grid]: make the truth with the run file \
                 of the result",
                pixels[1],
                pixels[0],
                truth_path.display(),
                wanted[1],
                wanted[0]
            ),
        ));
    }
    let metrics = evaluate(&found.map, &truth.map, resolution)?;
    let verdicts = pipeline::hold(&metrics, bounds);
    if json {
        print(&pretty(&verdicts_json(&metrics, &verdicts)))?;
    } else {
        print(&summary::metrics(&metrics))?;
    }
    limits_kept(&verdicts)
}

/// Runs scenes and holds each to its `[expect]`.
pub(super) fn check(runs: &[PathBuf], overrides: &Overrides, json: bool, terminal: &Terminal) -> Result<()> {
    let mut worst: Option<Error> = None;
    let mut rows = Vec::new();
    for path in runs {
        let name = path.display().to_string();
        let outcome = pipeline::check_scene(path, &overrides.keys(), terminal);
        match outcome {
            Ok((metrics, verdicts)) => {
                if json {
                    let mut row = verdicts_json(&metrics, &verdicts);
                    row["scene"] = name.clone().into();
                    rows.push(row);
                } else {
                    print(&summary::check_line(&name, &verdicts))?;
                }
                if let Err(error) = limits_kept(&verdicts) {
                    let error = Error::Limit(format!("{name}: {error}"));
                    worst = Some(worse(worst, error));
                }
            }
            Err(Error::Interrupted) => return Err(Error::Interrupted),
            Err(error) => {
                // The others are still worth a line.
                if runs.len() > 1 && !json {
                    print(&format!("FAILED {error}\n"))?;
                }
                rows.push(serde_json::json!({ "scene": name, "error": error.to_string() }));
                worst = Some(worse(worst, error));
            }
        }
    }
    if json {
        print(&pretty(&serde_json::Value::Array(rows)))?;
    }
    worst.map_or(Ok(()), Err)
}

/// Of two errors the one to exit with: a run that failed tells more than a limit that was missed.
fn worse(first: Option<Error>, second: Error) -> Error {
    match first {
        Some(first) if !matches!(first, Error::Limit(_)) || matches!(second, Error::Limit(_)) => first,
        _ => second,
    }
}

fn verdicts_json(metrics: &Metrics, verdicts: &[Verdict]) -> serde_json::Value {
    let limits: Vec<_> = verdicts
        .iter()
        .map(|v| {
            serde_json::json!({
                "metric": v.bound.metric, "min": v.bound.limit.min, "max": v.bound.limit.max,
                "value": v.value, "kept": v.kept,
            })
        })
        .collect();
    serde_json::json!({ "metrics": metrics, "limits": limits })
}

/// Exit status 3 for what was missed, in words.
fn limits_kept(verdicts: &[Verdict]) -> Result<()> {
    let missed: Vec<String> = verdicts.iter().filter(|v| !v.kept).map(summary::verdict).collect();
    if missed.is_empty() { Ok(()) } else { Err(Error::Limit(format!("missed {}", missed.join("; ")))) }
}
