//! The commands `compare` and `check`, and their exit status.

use super::inputs::{config_of, reading_limit};
use super::outputs::{announce, print_json};
use super::terminal::{Terminal, observed, print};
use super::{Overrides, summary};
use crate::error::{Error, Result};
use crate::export::depth_exr::{DepthFile, read_depth_map};
use crate::export::figure::write_error_figure;
use crate::export::{Attribute, find_attribute};
use crate::metrics::{Scores, error_map, score};
use crate::pipeline::{self, Bound, LimitVerdict, aperture_of_file};
use crate::wave::Resolution;
use std::path::{Path, PathBuf};

/// Scores a depth map and checks it against the limits of the command line.
pub(super) fn compare(
    result: &Path,
    truth_path: &Path,
    resolution: Option<f64>,
    min: &[String],
    max: &[String],
    png: Option<&Path>,
    terminal: &Terminal,
) -> Result<()> {
    if let Some(png) = png {
        announce(png, &["png"])?;
    }
    let mut bounds = Vec::new();
    for (option, typed, is_min) in [("--min", min, true), ("--max", max, false)] {
        for typed in typed {
            bounds.push(Bound::parse(option, typed, is_min)?);
        }
    }
    let limit = reading_limit();
    let mut found = read_depth_map(result, limit)?;
    let truth = read_depth_map(truth_path, limit.saturating_sub(found.map.held_bytes()))?;
    if !found.axes_known && found.map.shape() == truth.map.shape() {
        // A depth map of another program has no coordinates: its pixels are compared one by one.
        (found.map.view, found.map.x, found.map.y) = (truth.map.view, truth.map.x, truth.map.y);
    }
    let stored = |file: &DepthFile| match find_attribute(&file.attributes, "sonar:rangeResolution") {
        Some(Attribute::Number(resolution)) => Some(*resolution),
        _ => None,
    };
    let resolution = resolution.or_else(|| stored(&truth)).or_else(|| stored(&found)).ok_or_else(|| {
        Error::input(
            "--resolution",
            "is needed: neither file contains its range resolution c/2B, which decides what is a hit",
        )
    })?;
    let ([rows, columns], [true_rows, true_columns]) = (found.map.shape(), truth.map.shape());
    if [rows, columns] != [true_rows, true_columns] && found.map.view == truth.map.view {
        let problem = format!(
            "has {columns} x {rows} pixels, but {} has {true_columns} x {true_rows}; both must be on the same [grid]: make \
             the truth with the run file of the result",
            truth_path.display()
        );
        return Err(Error::input(result.display(), problem));
    }
    let aperture = [&truth, &found].into_iter().find_map(|file| aperture_of_file(&file.attributes));
    let scores = score(&found.map, &truth.map, Resolution { range: resolution, aperture })?;
    if let Some(png) = png {
        let errors = error_map(&found.map, &truth.map)?;
        let note = pipeline::error_note(&scores.all);
        write_error_figure(png, &errors, &truth.map.raster(), resolution, &note)?;
    }
    let verdicts = pipeline::hold(std::slice::from_ref(&scores), bounds);
    if terminal.json() {
        let mut value = scores_json(&scores);
        value["limits"] = limits_json(&verdicts);
        print_json(&value)?;
    } else {
        print(&(summary::metrics(&scores.all) + &summary::groups(&scores)))?;
    }
    limits_kept(&verdicts)
}

/// Runs scenes and checks each against its `[expect]`.
pub(super) fn check(
    runs: &[PathBuf],
    overrides: &Overrides,
    seeds: &[u32],
    terminal: &Terminal,
) -> Result<()> {
    let mut worst: Option<Error> = None;
    let mut rows = Vec::new();
    for path in runs {
        let name = path.display().to_string();
        let outcome = config_of(Some(path), &overrides.keys())
            .and_then(|run| pipeline::check_scene(path, &run, seeds, &observed(terminal)));
        match outcome {
            Ok(judgement) => {
                if terminal.json() {
                    rows.push(serde_json::json!({
                        "scene": name,
                        "seeds": judgement.seeds,
                        "limits": limits_json(&judgement.verdicts),
                        "scores": judgement.scores.iter().map(scores_json).collect::<Vec<_>>(),
                    }));
                } else {
                    print(&summary::check_line(&name, &judgement))?;
                }
                if let Err(error) = limits_kept(&judgement.verdicts) {
                    let error = Error::LimitMissed(format!("{name}: {error}"));
                    worst = Some(worse(worst, error));
                }
            }
            Err(Error::Interrupted) => return Err(Error::Interrupted),
            Err(error) => {
                // The other scenes are still run.
                if runs.len() > 1 && !terminal.json() {
                    print(&format!("FAILED {error}\n"))?;
                }
                rows.push(serde_json::json!({ "scene": name, "error": error.to_string() }));
                worst = Some(worse(worst, error));
            }
        }
    }
    if terminal.json() {
        print_json(&rows)?;
    }
    worst.map_or(Ok(()), Err)
}

/// The error to exit with: a failed run takes precedence over a missed limit, and the first over the second.
fn worse(first: Option<Error>, second: Error) -> Error {
    match first {
        Some(first) if !matches!(first, Error::LimitMissed(_)) || matches!(second, Error::LimitMissed(_)) => {
            first
        }
        _ => second,
    }
}

fn scores_json(scores: &Scores) -> serde_json::Value {
    let Scores { all, materials, surfaces, .. } = scores;
    serde_json::json!({ "metrics": all, "materials": materials, "surfaces": surfaces })
}

fn limits_json(verdicts: &[LimitVerdict]) -> serde_json::Value {
    let limits = verdicts.iter().map(|v| {
        serde_json::json!({
            "metric": v.bound.measure.to_string(), "min": v.bound.limit.min, "max": v.bound.limit.max,
            "value": v.value, "each": v.each, "kept": v.kept,
        })
    });
    limits.collect()
}

/// An error with exit status 3 that describes the missed limits.
fn limits_kept(verdicts: &[LimitVerdict]) -> Result<()> {
    let missed: Vec<String> = verdicts.iter().filter(|v| !v.kept).map(summary::verdict).collect();
    if missed.is_empty() { Ok(()) } else { Err(Error::LimitMissed(format!("missed {}", missed.join("; ")))) }
}
