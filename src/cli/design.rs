//! `psf` and `plan --sweep`, and the designer's half of what `plan` prints.

use super::inputs::run_of;
use super::outputs::{make_folder, pretty};
use super::terminal::{Terminal, observed, print};
use super::{Overrides, summary};
use crate::error::gib;
use crate::error::{Error, Result};
use crate::export::figure::{Chart, ChartAxis, write_charts, write_spread_figure};
use crate::pipeline::{self, DesignRow, DesignSweep, SweptKey};
use crate::plan::design::{Design, Verdict};
use crate::progress::Observer;
use crate::psf::{MeasuredGratingLobe, PointSpread, Width};
use glam::DVec3;
use serde_json::json;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Millimetres, or a dash.
fn millimetres(length: Option<f64>) -> String {
    length.map_or("-".to_owned(), |m| format!("{:.1}", m * 1e3))
}

/// Decibels, or a dash.
fn decibels(level: Option<f64>) -> String {
    level.map_or("-".to_owned(), |db| format!("{db:.1}"))
}

/// Rows under a header, each column as wide as its widest cell; the first column is aligned left.
fn columns(rows: &[Vec<String>]) -> String {
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..rows.first().map_or(0, Vec::len)).map(width).collect();
    rows.iter().fold(String::new(), |mut text, row| {
        let mut line = String::new();
        for (i, (cell, width)) in row.iter().zip(&widths).enumerate() {
            let _ = if i == 0 { write!(line, "{cell:width$}") } else { write!(line, "  {cell:>width$}") };
        }
        let _ = writeln!(text, "{}", line.trim_end());
        text
    })
}

/// What `plan` prints of a design, after its table.
pub(super) fn design(design: &Design) -> String {
    let mut rows =
        vec![["depth", "λ_c z/D x", "y", "-3 dB x", "y", "z", "ghosts at"].map(str::to_owned).to_vec()];
    for at in &design.depths {
        rows.push(vec![
            format!("{:.3} m", at.depth),
            millimetres(at.lateral_resolution[0]),
            millimetres(at.lateral_resolution[1]),
            millimetres(at.widths[0]),
            millimetres(at.widths[1]),
            millimetres(at.widths[2]),
            at.ghost_offset.map_or("-".to_owned(), |m| format!("{m:.2} m")),
        ]);
    }
    let mut text = format!("\nwidths in mm before the array's centre\n{}", columns(&rows));
    if let Some(ambiguity) = design.ambiguity {
        let [complex, real] = ambiguity.path;
        let [complex_range, real_range] = ambiguity.range;
        let _ = writeln!(
            text,
            "unambiguous: {complex:.2} m of path ({complex_range:.2} m of range) in quadrature, {real:.2} m ({real_range:.2} \
             m) in phase; this grid uses {:.2} m of {:.2} m",
            ambiguity.used,
            if ambiguity.in_phase { real } else { complex }
        );
    }
    let aliasing = &design.aliasing;
    let verdict = match (aliasing.verdict, aliasing.pitch) {
        (Verdict::AliasFree, _) => "free of ghosts everywhere".to_owned(),
        (Verdict::AliasFreeHere, _) => "free of ghosts within this grid".to_owned(),
        (Verdict::Scattered, _) => "no lattice: no ghosts, but sidelobes".to_owned(),
        (Verdict::Ghosts, pitch) => format!(
            "ghosts within this grid: pitch {} mm, first ghost about {} dB without a window",
            millimetres(pitch),
            decibels(aliasing.rule_db)
        ),
    };
    let _ = writeln!(text, "aliasing: {verdict}");
    if aliasing.pitch.is_some() {
        let here = aliasing.pitch_free_here;
        let _ = writeln!(
            text,
            "  a pitch of {} mm is free of ghosts everywhere, of {} mm within this grid",
            millimetres(Some(aliasing.pitch_free_everywhere)),
            millimetres(here)
        );
    }
    let sidelobes = &aliasing.sidelobes;
    if let Some(peak) = sidelobes.peak_db {
        let _ = writeln!(
            text,
            "sidelobes by the array factor, within this grid: {peak:.1} dB at the most, {} dB in the mean of one tone",
            decibels(sidelobes.mean_db)
        );
    }
    let [x, y, z] = design.voxel_pitch.map(|pitch| format!("{:.1}", pitch * 1e3));
    let _ = writeln!(text, "voxels: {x} x {y} x {z} mm or finer lose little");
    let mut fixed = "";
    for suggestion in &design.suggestions {
        if suggestion.fixes != fixed {
            fixed = suggestion.fixes;
            let _ = writeln!(text, "to fix {fixed}:");
        }
        let set: Vec<String> = suggestion.set.iter().map(|set| format!("--set \"{set}\"")).collect();
        let _ = writeln!(text, "  {}  ({})", set.join(" "), suggestion.effect);
    }
    text
}

/// `plan --sweep`: a table on standard output, and a picture in `folder` if there is one.
pub(super) fn sweep(
    input: &Path,
    typed: &[String],
    folder: Option<&Path>,
    overrides: &Overrides,
    json: bool,
    terminal: &Terminal,
) -> Result<()> {
    let keys: Vec<SweptKey> = typed.iter().map(|typed| SweptKey::parse(typed)).collect::<Result<_>>()?;
    let run_with = |set: &[String]| {
        let mut with = overrides.clone();
        with.settings.set.extend(set.iter().cloned());
        run_of(input, &with)
    };
    let sweep = pipeline::sweep_designs(&keys, &run_with, &observed(terminal))?;
    for combination in &sweep.combinations {
        if let Some(refused) = &combination.refused {
            terminal.warn(&format!("{}: {refused}", combination.values.join(" ")));
        }
    }
    if let Some(folder) = folder {
        write_sweep(folder, &sweep)?;
    }
    if json {
        let value =
            serde_json::to_value(&sweep).map_err(|e| Error::io("plan", e.to_string()).with_source(e))?;
        return print(&pretty(&value));
    }
    print(&sweep_table(&sweep))
}

fn verdict_word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::AliasFree => "free",
        Verdict::AliasFreeHere => "free here",
        Verdict::Ghosts => "ghosts",
        Verdict::Scattered => "no lattice",
    }
}

fn sweep_table(sweep: &DesignSweep) -> String {
    let measured = [
        "mics",
        "tones",
        "range mm",
        "near mm",
        "middle mm",
        "far mm",
        "aliasing",
        "ghost m",
        "peak dB",
        "mean dB",
        "memory",
        "time",
    ];
    let mut rows =
        vec![sweep.keys.iter().map(String::as_str).chain(measured).map(str::to_owned).collect::<Vec<_>>()];
    for combination in &sweep.combinations {
        let mut row = combination.values.clone();
        match &combination.design {
            Some(design) => row.extend(sweep_cells(design)),
            None => row.extend(measured.iter().map(|_| "-".to_owned())),
        }
        rows.push(row);
    }
    columns(&rows)
        + "near, middle, far: -3 dB width across, with the window; ghost: the nearest beside a point at the nearest depth; \
           peak, mean: sidelobes within the grid by the array factor\n"
}

fn sweep_cells(design: &DesignRow) -> Vec<String> {
    let [near, middle, far] = design.widths.map(millimetres);
    vec![
        design.microphones.to_string(),
        design.tones.to_string(),
        millimetres(design.range_resolution),
        near,
        middle,
        far,
        verdict_word(design.verdict).to_owned(),
        design.ghost_offset.map_or("-".to_owned(), |m| format!("{m:.2}")),
        decibels(design.peak_sidelobe_db),
        decibels(design.mean_sidelobe_db),
        gib(design.peak_bytes),
        summary::duration(design.seconds),
    ]
}

/// `sweep.png` and `sweep.json`: the first key along x, a line for every combination of the others.
fn write_sweep(folder: &Path, sweep: &DesignSweep) -> Result<()> {
    make_folder(folder)?;
    let (mut places, mut series) = (Vec::<String>::new(), Vec::<String>::new());
    let name = |values: &[String]| {
        let named = sweep.keys.iter().zip(values).skip(1).map(|(key, value)| format!("{key} = {value}"));
        named.collect::<Vec<_>>().join(", ")
    };
    for combination in &sweep.combinations {
        let (place, line) = (combination.values[0].clone(), name(&combination.values));
        if !places.contains(&place) {
            places.push(place);
        }
        if !series.contains(&line) {
            series.push(line);
        }
    }
    let chart = |title: &str, y_label: &str, of: &dyn Fn(&DesignRow) -> Option<f64>| {
        let mut lines = vec![vec![f64::NAN; places.len()]; series.len()];
        for combination in &sweep.combinations {
            let line = series.iter().position(|s| *s == name(&combination.values));
            let place = places.iter().position(|p| *p == combination.values[0]);
            if let (Some(line), Some(place), Some(design)) = (line, place, &combination.design) {
                lines[line][place] = of(design).unwrap_or(f64::NAN);
            }
        }
        Chart { title: title.into(), y_label: y_label.into(), series: lines }
    };
    let mm = |m: Option<f64>| m.map(|m| 1e3 * m);
    let charts = [
        chart("width across at the middle depth", "-3 dB width / mm", &|d| mm(d.widths[1])),
        chart("range resolution c/2B", "mm", &|d| mm(d.range_resolution)),
        chart("nearest ghost", "offset at the nearest depth / m", &|d| d.ghost_offset),
        chart("strongest ghost or sidelobe", "dB", &|d| d.peak_sidelobe_db),
        chart("memory", "MiB", &|d| Some(d.peak_bytes as f64 / f64::from(1 << 20))),
        chart("time of the reconstruction", "s", &|d| Some(d.seconds)),
    ];
    let axis = ChartAxis { label: sweep.keys[0].clone(), places, series };
    write_charts(&folder.join("sweep.png"), &charts, &axis)?;
    write_json(&folder.join("sweep.json"), &serde_json::to_value(sweep))
}

fn write_json(path: &Path, value: &serde_json::Result<serde_json::Value>) -> Result<()> {
    let value = value.as_ref().map_err(|e| Error::io(path.display(), e.to_string()))?;
    crate::files::write_atomically(path, |out| std::io::Write::write_all(out, pretty(value).as_bytes()))
}

/// `psf`: a table per point, and a picture in `folder` if there is one.
pub(super) fn psf(
    input: &Path,
    at: &[String],
    folder: Option<&Path>,
    overrides: &Overrides,
    json: bool,
    terminal: &Terminal,
) -> Result<()> {
    let points = at.iter().map(|typed| point(typed)).collect::<Result<Vec<_>>>()?;
    let (run, bare) = run_of(input, overrides)?;
    let (grid, spreads) = pipeline::point_spreads(&run, &points, &observed(terminal).with_bare_mesh(bare))?;
    let window = run.reconstruct.window;
    let value = json!({ "window": window, "grid": grid, "points": spreads });
    let mut files: Vec<PathBuf> = Vec::new();
    if let Some(folder) = folder {
        make_folder(folder)?;
        files = ["psf.png", "psf.json"].map(|name| folder.join(name)).to_vec();
        write_spread_figure(&files[0], &spreads)?;
        write_json(&files[1], &Ok(value.clone()))?;
    }
    if json {
        return print(&pretty(&value));
    }
    let mut text = spreads.iter().map(spread).collect::<Vec<_>>().join("\n");
    for file in files {
        let _ = writeln!(text, "wrote {}", file.display());
    }
    print(&text)
}

/// A point as typed: `x,y,z` in m.
fn point(typed: &str) -> Result<DVec3> {
    let numbers: Option<Vec<f64>> =
        typed.split(',').map(|part| part.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    match numbers.as_deref() {
        Some([x, y, z]) => Ok(DVec3::new(*x, *y, *z)),
        _ => Err(Error::input(
            format!("--at {typed}"),
            "was expected to be x,y,z in metres, as in --at 0,0.2,1.8",
        )),
    }
}

/// One point's table.
fn spread(spread: &PointSpread) -> String {
    let place = |p: [f64; 3]| {
        // A zero needs no sign.
        let [x, y, z] = p.map(|v| if v.abs() < 5e-4 { 0.0 } else { v });
        format!("{x:.3}, {y:.3}, {z:.3} m")
    };
    let mut text = format!("point {}: amplitude {:.3}\n", place(spread.point), spread.amplitude);
    let mut rows = vec![["width / mm", "-3 dB", "foretold", "-6 dB", "foretold"].map(str::to_owned).to_vec()];
    for (name, width) in ["  x", "  y", "  z"].into_iter().zip(&spread.widths) {
        let Width { at_3_db, predicted_at_3_db, at_6_db, predicted_at_6_db, .. } = *width;
        let cells = [at_3_db, predicted_at_3_db, at_6_db, predicted_at_6_db].map(millimetres);
        rows.push(std::iter::once(name.to_owned()).chain(cells).collect());
    }
    text.push_str(&columns(&rows));
    if let Some(peak) = spread.peak_sidelobe {
        let _ = writeln!(
            text,
            "sidelobes: {:.1} dB at the most ({} foretold), at {}; {} dB in the mean",
            peak.level_db,
            decibels(spread.predicted_peak_sidelobe_db),
            place(peak.position),
            decibels(spread.mean_sidelobe_db)
        );
    }
    if !spread.ghosts.is_empty() {
        let header = ["ghost", "offset m", "foretold", "dB", "foretold", "at", ""];
        let mut rows = vec![header.map(str::to_owned).to_vec()];
        for ghost in &spread.ghosts {
            let MeasuredGratingLobe {
                axis,
                order,
                offset: [foretold, found],
                measured,
                predicted,
                in_grid,
                ..
            } = *ghost;
            rows.push(vec![
                format!("  {}{order:+}", ["x", "y"][axis.min(1)]),
                format!("{found:.3}"),
                format!("{foretold:.3}"),
                format!("{:.1}", measured.level_db),
                format!("{:.1}", predicted.level_db),
                place(measured.position),
                if in_grid { "in the grid".to_owned() } else { String::new() },
            ]);
        }
        text.push_str(&columns(&rows));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_three_numbers() {
        assert_eq!(point("0, -0.2,1.8").expect("a point"), DVec3::new(0.0, -0.2, 1.8));
        for typed in ["", "1,2", "1,2,3,4", "a,b,c", "1,2,nan"] {
            assert!(point(typed).is_err(), "{typed}");
        }
    }
}
