//! The commands `compare` and `check`, and their exit status.

use super::inputs::{config_of, reading_limit};
use super::outputs::{announce, print_json};
use super::terminal::{Terminal, observed, print};
use super::{Overrides, summary};
use crate::error::{Error, Result};
use crate::export::depth_exr::{DepthFile, read_depth_map};
use crate::export::figure::write_error_figure;
use crate::export::{Attribute, find_attribute};
use crate::grid::DepthMap;
use crate::metrics::{Scores, error_map, score};
use crate::pipeline::{self, Bound, LimitVerdict, aperture_of_file};
use crate::wave::Resolution;
use std::path::{Path, PathBuf};

/// The files of a comparison.
pub(super) struct Compared<'a> {
    pub(super) results: &'a [PathBuf],
    pub(super) truth: &'a Path,
    pub(super) oracle: Option<&'a Path>,
    /// c/2B, m, if it was typed.
    pub(super) resolution: Option<f64>,
}

/// Scores depth maps and checks them against the limits of the command line, minima and maxima.
pub(super) fn compare(
    compared: &Compared<'_>,
    [min, max]: [&[String]; 2],
    png: Option<&Path>,
    terminal: &Terminal,
) -> Result<()> {
    if let Some(png) = png {
        announce(png, &["png"])?;
        if compared.results.len() > 1 {
            return Err(Error::input("--png", "draws the error of one depth map, and several were given"));
        }
    }
    let mut bounds = Vec::new();
    for (option, typed, is_min) in [("--min", min, true), ("--max", max, false)] {
        for typed in typed {
            bounds.push(Bound::parse(option, typed, is_min)?);
        }
    }
    let truth = read_depth_map(compared.truth, reading_limit())?;
    let mut scores = Vec::new();
    for path in compared.results {
        let (found, resolution) = compared.read(path, &truth)?;
        scores.push(score(&found, &truth.map, resolution)?);
        if let Some(png) = png {
            let errors = error_map(&found, &truth.map)?;
            let note = pipeline::error_note(&scores[0].all);
            write_error_figure(png, &errors, &truth.map.raster(), resolution.range, &note)?;
        }
    }
    let oracle = compared.oracle.map(|path| {
        let (found, resolution) = compared.read(path, &truth)?;
        score(&found, &truth.map, resolution)
    });
    let oracle = oracle.transpose()?;
    let verdicts = pipeline::hold(&scores, bounds);
    if terminal.json() {
        let mut value = match scores.as_slice() {
            [one] => scores_json(one),
            several => serde_json::json!({ "results": several.iter().map(scores_json).collect::<Vec<_>>() }),
        };
        value["limits"] = limits_json(&verdicts);
        if let Some(oracle) = &oracle {
            value["oracle"] = scores_json(oracle);
        }
        print_json(&value)?;
    } else {
        let groups = if let [one] = scores.as_slice() { summary::groups(one) } else { String::new() };
        let results: Vec<_> = scores.iter().map(|scores| &scores.all).collect();
        print(&(summary::metrics(&results, oracle.as_ref().map(|oracle| &oracle.all)) + &groups))?;
    }
    limits_kept(&verdicts)
}

impl Compared<'_> {
    /// Reads a depth map on the pixels of the truth, and the resolution by which it is scored.
    fn read(&self, path: &Path, truth: &DepthFile) -> Result<(DepthMap, Resolution)> {
        let mut found = read_depth_map(path, reading_limit().saturating_sub(truth.map.held_bytes()))?;
        if !found.axes_known && found.map.shape() == truth.map.shape() {
            // A depth map of another program has no coordinates: its pixels are compared one by one.
            (found.map.view, found.map.x, found.map.y) = (truth.map.view, truth.map.x, truth.map.y);
        }
        let stored = |file: &DepthFile| match find_attribute(&file.attributes, "sonar:rangeResolution") {
            Some(Attribute::Number(resolution)) => Some(*resolution),
            _ => None,
        };
        let range =
            self.resolution.or_else(|| stored(truth)).or_else(|| stored(&found)).ok_or_else(|| {
                Error::input(
                    "--resolution",
                    "is needed: neither file contains its range resolution c/2B, which decides what is a hit",
                )
            })?;
        let ([rows, columns], [true_rows, true_columns]) = (found.map.shape(), truth.map.shape());
        if [rows, columns] != [true_rows, true_columns] && found.map.view == truth.map.view {
            let problem = format!(
                "has {columns} x {rows} pixels, but {} has {true_columns} x {true_rows}; both must be on the same [grid]: \
                 make the truth with the run file of the result",
                self.truth.display()
            );
            return Err(Error::input(path.display(), problem));
        }
        let aperture = [truth, &found].into_iter().find_map(|file| aperture_of_file(&file.attributes));
        Ok((found.map, Resolution { range, aperture }))
    }
}

/// Runs scenes and checks each against its `[expect]`.
pub(super) fn check(
    runs: &[PathBuf],
    overrides: &Overrides,
    (seeds, oracle): (&[u32], bool),
    terminal: &Terminal,
) -> Result<()> {
    let mut worst: Option<Error> = None;
    let mut rows = Vec::new();
    for path in runs {
        let name = path.display().to_string();
        let outcome = overrides
            .keys()
            .and_then(|keys| config_of(Some(path), &keys))
            .and_then(|run| pipeline::check_scene(path, &run, seeds, oracle, &observed(terminal)));
        match outcome {
            Ok(judgement) => {
                if terminal.json() {
                    let mut row = serde_json::json!({
                        "scene": name,
                        "seeds": judgement.seeds,
                        "limits": limits_json(&judgement.verdicts),
                        "scores": judgement.scores.iter().map(scores_json).collect::<Vec<_>>(),
                    });
                    if let Some(oracle) = &judgement.oracle {
                        row["oracle"] = scores_json(oracle);
                    }
                    rows.push(row);
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
