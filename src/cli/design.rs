//! The command `psf`, `plan --sweep`, and the second half of the output of `plan`, about the design of the array.

mod charts;
pub(crate) mod sweep;

use super::Overrides;
use super::inputs::{Input, run_of};
use super::outputs::{open_folder, print_json, write_json};
use super::summary::{self, millimetres};
use super::terminal::{Terminal, observed, print};
use crate::error::{Error, Result};
use crate::export::figure::write_spread_figure;
use crate::pipeline::{self, Forecast, InstrumentBudget};
use crate::plan::design::{Design, Verdict};
use crate::psf::{MeasuredGratingLobe, PointSpread, Width};
use crate::text::{one_line, quoted};
use glam::DVec3;
use serde_json::json;
use std::fmt::Write;
use std::path::Path;

/// Decibels, or a dash.
fn decibels(level: Option<f64>) -> String {
    level.map_or("-".to_owned(), |db| format!("{db:.1}"))
}

/// Aligned rows, each column as wide as its widest cell; the first column is left-aligned.
pub(super) fn columns(rows: &[Vec<String>]) -> String {
    let width =
        |column: usize| rows.iter().map(|row| one_line(&row[column]).chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..rows.first().map_or(0, Vec::len)).map(width).collect();
    rows.iter().fold(String::new(), |mut text, row| {
        let mut line = String::new();
        for (i, (cell, width)) in row.iter().zip(&widths).enumerate() {
            let cell = one_line(cell);
            let _ = if i == 0 { write!(line, "{cell:width$}") } else { write!(line, "  {cell:>width$}") };
        }
        let _ = writeln!(text, "{}", line.trim_end());
        text
    })
}

/// What `plan` prints of a prediction.
pub(crate) fn forecast_text(forecast: &Forecast) -> String {
    let budget = forecast.budget.as_ref().map(budget);
    summary::forecast(forecast) + &design(&forecast.design) + &budget.unwrap_or_default()
}

/// What the elements of an instrument cost.
fn budget(budget: &InstrumentBudget) -> String {
    let mm = |m: f64| format!("{:+.3}", 1e3 * m);
    let header = ["element", "SNR dB", "level dB", "range bias mm", "rms mm"];
    let rows = budget.rows.iter().map(|row| {
        let snr = row.snr_db.map_or("exact".to_owned(), |db| format!("{db:.1}"));
        let rms = format!("{:.3}", 1e3 * row.range_rms);
        vec![row.element.clone(), snr, format!("{:+.2}", row.level_db), mm(row.range_bias), rms]
    });
    let rows: Vec<_> = std::iter::once(header.map(str::to_owned).to_vec()).chain(rows).collect();
    let points = budget.points;
    format!(
        "\ninstrument: {points} points before one microphone, with each element alone\n{}",
        columns(&rows)
    )
}

/// The design that `plan` prints after its table.
fn design(design: &Design) -> String {
    let header = ["depth", "λ_c z/D x", "y", "-3 dB x", "y", "z", "grating lobes at"];
    let mut rows = vec![header.map(str::to_owned).to_vec()];
    for at in &design.depths {
        let lengths = at.lateral_resolution.iter().chain(&at.widths).map(|length| millimetres(*length));
        let lobes = at.grating_lobe_offset.map_or("-".to_owned(), |m| format!("{m:.2} m"));
        rows.push([format!("{:.3} m", at.depth)].into_iter().chain(lengths).chain([lobes]).collect());
    }
    let mut text = format!("\nwidths in mm in front of the array's centre\n{}", columns(&rows));
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
        (Verdict::AliasFree, _) => "free of grating lobes everywhere".to_owned(),
        (Verdict::AliasFreeHere, _) => "free of grating lobes within this grid".to_owned(),
        (Verdict::Scattered, _) => "no lattice: no grating lobes, but sidelobes".to_owned(),
        (Verdict::GratingLobes, pitch) => format!(
            "grating lobes within this grid: pitch {} mm, first grating lobe about {} dB without a window",
            millimetres(pitch),
            decibels(aliasing.rule_db)
        ),
    };
    let _ = writeln!(text, "aliasing: {verdict}");
    if aliasing.pitch.is_some() {
        let _ = writeln!(
            text,
            "  a pitch of {} mm is free of grating lobes everywhere, of {} mm within this grid",
            millimetres(Some(aliasing.pitch_free_everywhere)),
            millimetres(aliasing.pitch_free_here)
        );
    }
    let sidelobes = &aliasing.sidelobes;
    if let Some(peak) = sidelobes.peak_db {
        let _ = writeln!(
            text,
            "sidelobes by the array factor, within this grid: at most {peak:.1} dB, on average {} dB for one frequency",
            decibels(sidelobes.mean_db)
        );
    }
    if !sidelobes.skipped.is_empty() {
        let _ = writeln!(text, "  not searched, to save time: {}", sidelobes.skipped.join("; "));
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

/// `psf`: a table per point, and a picture in `folder`, if given.
pub(super) fn psf(
    input: &Path,
    at: &[String],
    folder: Option<&Path>,
    overrides: &Overrides,
    terminal: &Terminal,
) -> Result<()> {
    let points = at.iter().map(|typed| point(typed)).collect::<Result<Vec<_>>>()?;
    let folder = folder.map(|folder| open_folder(folder, ["psf.png", "psf.json"])).transpose()?;
    let Input { run, bare } = run_of(input, overrides, terminal)?;
    let job = observed(terminal).with_bare_mesh(bare.as_ref());
    let (grid, spreads) = pipeline::point_spreads(&run, &points, &job)?;
    let window = run.reconstruct.window;
    let value = json!({ "window": window, "grid": grid, "points": spreads });
    if let Some((_, files)) = &folder {
        write_spread_figure(&files[0], &spreads)?;
        write_json(&files[1], &value)?;
    }
    if terminal.json() {
        return print_json(&value);
    }
    let mut text = spreads.iter().map(spread).collect::<Vec<_>>().join("\n");
    for file in folder.iter().flat_map(|(_, files)| files) {
        let _ = writeln!(text, "wrote {}", file.display());
    }
    print(&text)
}

/// A point as typed: `x,y,z` in m.
fn point(typed: &str) -> Result<DVec3> {
    let numbers: Option<Vec<f64>> =
        typed.split(',').map(|part| part.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    let problem = "was expected to be x,y,z in metres, as in --at 0,0.2,1.8";
    match numbers.as_deref() {
        Some([x, y, z]) => Ok(DVec3::new(*x, *y, *z)),
        _ => Err(Error::input(format!("--at {}", quoted(typed)), problem)),
    }
}

/// One point's table.
fn spread(spread: &PointSpread) -> String {
    let place = |p: [f64; 3]| {
        // Without negative zeros.
        let [x, y, z] = p.map(|v| if v.abs() < 5e-4 { 0.0 } else { v });
        format!("{x:.3}, {y:.3}, {z:.3} m")
    };
    let mut text = format!("point {}: amplitude {:.3}\n", place(spread.point), spread.amplitude);
    let mut rows =
        vec![["width / mm", "-3 dB", "predicted", "-6 dB", "predicted"].map(str::to_owned).to_vec()];
    for (name, width) in ["  x", "  y", "  z"].into_iter().zip(&spread.widths) {
        let Width { at_3_db, predicted_at_3_db, at_6_db, predicted_at_6_db, .. } = *width;
        let cells = [at_3_db, predicted_at_3_db, at_6_db, predicted_at_6_db].map(millimetres);
        rows.push(std::iter::once(name.to_owned()).chain(cells).collect());
    }
    text.push_str(&columns(&rows));
    if let Some(peak) = spread.peak_sidelobe {
        let _ = writeln!(
            text,
            "sidelobes: at most {:.1} dB ({} predicted), at {}; on average {} dB",
            peak.level_db,
            decibels(spread.predicted_peak_sidelobe_db),
            place(peak.position),
            decibels(spread.mean_sidelobe_db)
        );
    }
    if !spread.grating_lobes.is_empty() {
        let header = ["lobe", "offset m", "predicted", "dB", "predicted", "at", ""];
        let mut rows = vec![header.map(str::to_owned).to_vec()];
        for lobe in &spread.grating_lobes {
            let MeasuredGratingLobe {
                axis,
                order,
                offset: [expected, found],
                measured,
                predicted,
                in_grid,
                ..
            } = *lobe;
            rows.push(vec![
                format!("  {}{order:+}", ["x", "y"][axis.min(1)]),
                format!("{found:.3}"),
                format!("{expected:.3}"),
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
