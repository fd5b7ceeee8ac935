//! Results as text: short aligned tables.

use crate::acquisition::RecordingSize;
use crate::error::gib;
use crate::grid::Grid;
use crate::metrics::{METRIC_NAMES, Metrics, Scores};
use crate::pipeline::{Forecast, Judgement, LimitVerdict, Outcome, Report};
use crate::plan::Plan;
use crate::reconstruct::Estimate;
use crate::scene::Up;
pub(super) use crate::text::duration;
use crate::text::{one_line, prefixed, prefixed_range};
use serde_json::Value;
use std::fmt::Write;
use std::path::Path;

/// Two columns, the first as wide as its widest key.
#[derive(Debug, Default)]
struct KeyValueTable(Vec<(String, String)>);

impl KeyValueTable {
    fn row(&mut self, key: &str, value: impl Into<String>) {
        self.0.push((one_line(key).into_owned(), one_line(&value.into()).into_owned()));
    }

    /// Rows of one key, which only the first row shows.
    fn rows(&mut self, key: &str, values: impl IntoIterator<Item = String>) {
        for (i, value) in values.into_iter().enumerate() {
            self.row(if i == 0 { key } else { "" }, value);
        }
    }

    fn text(&self) -> String {
        let width = self.0.iter().map(|(key, _)| key.chars().count()).max().unwrap_or(0);
        self.0.iter().fold(String::new(), |mut text, (key, value)| {
            let _ = writeln!(text, "{}", format!("{key:width$}  {value}").trim_end());
            text
        })
    }
}

/// Lengths along x, y and z, as `1.0 x 2.0 x 3.0`.
fn product(lengths: [f64; 3], digits: usize) -> String {
    lengths.map(|length| format!("{length:.digits$}")).join(" x ")
}

/// The number of voxels of a grid along x, y and z.
fn voxels(grid: &Grid) -> String {
    format!("{} x {} x {} voxels", grid.x.count, grid.y.count, grid.z.count)
}

/// The resolution of a plan in range, and laterally at the nearest and farthest depth.
fn resolution(plan: &Plan, lateral: impl Fn([Option<f64>; 2]) -> String) -> String {
    let [near, far] = [plan.lateral_resolution_near, plan.lateral_resolution_far].map(lateral);
    format!("{} mm in range; {near} to {far} mm across, near to far", millimetres(plan.range_resolution))
}

/// How many resolution cells a scene is wide and high, if that is known.
fn resolution_cells(cells: [Option<f64>; 2]) -> Option<String> {
    let [x, y] = cells.map(|cells| cells.map_or("-".to_owned(), |cells| format!("{cells:.1}")));
    cells.iter().any(Option::is_some).then(|| format!("{x} x {y} resolution cells across"))
}

/// Which axis of a mesh's file points up, and how to choose another.
fn upward(up: Up) -> String {
    match up {
        Up::None => {
            "the file's axes are the array's: x right, y down, z away (--up y or z if the object lies)"
                .to_owned()
        }
        Up::Y | Up::Z => {
            let other = if up == Up::Y { Up::Z } else { Up::Y };
            format!("{up} in the file (--up {other} or none if the object lies or stands on its head)")
        }
    }
}

/// Millimetres, or a dash.
pub(super) fn millimetres(length: Option<f64>) -> String {
    length.map_or("-".to_owned(), |m| format!("{:.1}", m * 1e3))
}

/// The table at the end of `image`.
pub(super) fn image(input: &Path, folder: &Path, report: &Report, outcome: &Outcome) -> String {
    let mut table = KeyValueTable::default();
    let plan = &report.plan;
    if let Some(scene) = &report.scene {
        let mesh = format!(", {} triangles, {:.3} m²", scene.triangles, scene.area);
        let mesh = if scene.triangles > 0 { mesh } else { String::new() };
        table.row("scene", format!("{}{mesh}", input.display()));
        let (metres, wavelengths) = (product(scene.size, 3), product(scene.size_wavelengths, 1));
        table.row("  size", format!("{metres} m = {wavelengths} wavelengths"));
        table.rows("  cells", resolution_cells(scene.resolution_cells));
        if let Some(up) = scene.up {
            table.row("  up", upward(up));
        }
        table.row("  depth", format!("z {:.3} to {:.3} m from the array", scene.low[2], scene.high[2]));
        for material in scene.materials.iter().take(8) {
            let name = if material.name.is_empty() { "(unnamed)" } else { &material.name };
            let (reflectance, transmittance) = (short(material.reflectance), short(material.transmittance));
            let value = format!(
                "{name}: reflectance {reflectance}, transmittance {transmittance} ({})",
                material.source
            );
            table.row("  material", value);
        }
        if scene.materials.len() > 8 {
            table.row("", format!("and {} more; all are in report.json", scene.materials.len() - 8));
        }
    } else {
        table.row("cube", input.display().to_string());
    }
    if let Some(reflectors) = report.reflectors {
        table.row("reflectors", reflectors.to_string());
    }
    let instrument = &outcome.instrument;
    let extent = instrument.array.extent();
    table.row("array", format!("{} microphones over {:.2} x {:.2} m", plan.microphones, extent.x, extent.y));
    let band = prefixed_range(instrument.sweep.start(), instrument.sweep.stop(), 2, "Hz");
    table.row("sweep", format!("{} frequencies, {band}", plan.frequencies));
    table.rows("physics", report.physics.iter().cloned());
    table.rows("refined", report.refinement.map(|refinement| refinement.to_string()));
    table.rows("correlation", report.correlation.map(|pairs| pairs.to_string()));
    table.row("resolution", resolution(plan, |[x, _]| millimetres(x)));
    let grid = &outcome.image.volume.grid;
    let axes = [("x", grid.x), ("y", grid.y), ("z", grid.z)];
    let axes = axes.map(|(name, axis)| format!("{name} {:.3} to {:.3}", axis.first, axis.last()));
    table.row("grid", format!("{}: {} m", voxels(grid), axes.join(", ")));
    table.row("depth", format!("a return at {} of {} pixels", report.accepted, report.pixels));
    let mut text = table.text();
    if let Some(metrics) = &report.metrics {
        text.push_str("against the truth\n");
        text.push_str(&textwrap::indent(&self::metrics(&[metrics], None), "  "));
    }
    let mut table = KeyValueTable::default();
    let stages: Vec<String> = report
        .timings
        .iter()
        .filter_map(|(stage, seconds)| Some(format!("{stage} {:.2}", seconds.as_f64()?)))
        .collect();
    table.row("seconds", format!("{:.2} ({})", report.seconds(), stages.join(", ")));
    let files: Vec<String> = report.files.iter().map(|f| f.display().to_string()).collect();
    table.row("written", format!("{}: {}", folder.display(), files.join(", ")));
    text + &table.text()
}

/// The table of `plan`.
pub(super) fn forecast(forecast: &Forecast) -> String {
    let (plan, grid) = (&forecast.plan, &forecast.grid);
    let mut table = KeyValueTable::default();
    table.row("wavelength", format!("{} at the centre of the band", prefixed(plan.wavelength, 1, "m")));
    let lateral = |[x, y]: [Option<f64>; 2]| {
        if x == y { millimetres(x) } else { format!("{} x {}", millimetres(x), millimetres(y)) }
    };
    table.row("resolution", resolution(plan, lateral));
    table.rows("object", forecast.resolution_cells.and_then(resolution_cells));
    let [shortest, longest] = plan.path_bounds;
    let unambiguous = plan.unambiguous_path.map_or("all".to_owned(), |m| format!("{m:.2} m"));
    table.row("paths", format!("{shortest:.2} to {longest:.2} m; {unambiguous} unambiguous"));
    if plan.alias_free_pitch < 1e3 {
        let pitch = 1e3 * plan.alias_free_pitch;
        table.row("aliasing", format!("none with microphones {pitch:.1} mm apart or less"));
    }
    let pitches = product([grid.x, grid.y, grid.z].map(|axis| axis.pitch * 1e3), 1);
    table.row("grid", format!("{} of {pitches} mm", voxels(grid)));
    table.rows("seen as", plan.virtual_array.map(|array| array.to_string()));
    let (frequencies, microphones, bytes) = (plan.frequencies, plan.microphones, gib(plan.cube_bytes));
    let speakers = match plan.transmissions {
        1 => String::new(),
        several => format!("{several} speakers x "),
    };
    table.row("cube", format!("{speakers}{frequencies} frequencies x {microphones} microphones: {bytes}"));
    table.row("volume", gib(plan.volume_bytes));
    table.rows("physics", forecast.physics.iter().cloned());
    table.rows("tracing", forecast.tracing.map(|tracing| tracing.to_string()));
    table.rows("measured in", forecast.acquisition.map(|time| time.to_string()));
    table.rows("correlation", forecast.correlation.map(|pairs| pairs.to_string()));
    for (i, (method, seconds)) in forecast.methods.iter().zip(&forecast.seconds).enumerate() {
        let name = format!("{}{}", if i == forecast.chosen { "* " } else { "  " }, method.method);
        let (bytes, time) = (gib(method.bytes), duration(*seconds));
        let costs = match &method.obstacle {
            Some(obstacle) => format!("not used: {obstacle}"),
            None => {
                format!("{:.1e} operations, {bytes}, about {time}{}", method.operations, interpolated(method))
            }
        };
        table.row(&name, costs);
    }
    table.rows("memory", forecast.memory.iter().map(ToString::to_string));
    table.row("threads", forecast.threads.to_string());
    table.row("writes", forecast.files.join(", "));
    if let Some(RecordingSize { channels, seconds, bytes, .. }) = forecast.recording {
        let size =
            format!("{channels} channels, {seconds:.2} s, {} (`simulate -o recording.wav`)", gib(bytes));
        table.row("recording", size);
    }
    table.text()
}

/// The nodes that a method's voxels are interpolated from, if so.
fn interpolated(method: &Estimate) -> String {
    let Some(Grid { x, y, z }) = &method.nodes else { return String::new() };
    let pitches = product([x, y, z].map(|axis| axis.pitch * 1e3), 1);
    format!(", interpolated from {} x {} x {} nodes {pitches} mm apart", x.count, y.count, z.count)
}

/// Every metric that was measured, with its unit: of one result, or the means of several and their range, and beside them
/// those of an oracle.
pub(super) fn metrics(results: &[&Metrics], oracle: Option<&Metrics>) -> String {
    let mut table = KeyValueTable::default();
    for name in METRIC_NAMES {
        let of = |metrics: &Metrics| metrics.get(name).flatten();
        let each: Vec<Option<f64>> = results.iter().map(|metrics| of(metrics)).collect();
        // A metric that one result lacks has no mean.
        let Some(sum) = each.iter().copied().sum::<Option<f64>>() else { continue };
        let mut text = spread(name, &each, sum / each.len() as f64);
        if let Some(possible) = oracle.and_then(of) {
            let _ = write!(text, ", of the oracle {}", quantity(name, possible));
        }
        table.row(name, text);
    }
    let text = table.text();
    if text.is_empty() { "nothing to measure: the truth is empty\n".to_owned() } else { text }
}

/// A metric's value: lengths in mm, others without a unit.
fn quantity(name: &str, value: f64) -> String {
    if Metrics::is_length(name) { format!("{:.2} mm", value * 1e3) } else { format!("{value:.3}") }
}

/// The metrics by material and by surface, one column each; empty if there is only one of each.
pub(super) fn groups(scores: &Scores) -> String {
    let measured = scores.materials.iter().filter(|(_, metrics)| metrics.completeness.is_some());
    let materials: Vec<_> = measured.map(|(name, metrics)| (shortened(name), metrics)).collect();
    let surfaces = (1..).zip(&scores.surfaces);
    let surfaces: Vec<_> = surfaces.map(|(k, metrics)| (format!("surface {k}"), metrics)).collect();
    let mut text = String::new();
    for (of, columns) in [("by material", materials), ("from the front", surfaces)] {
        if columns.len() < 2 {
            continue;
        }
        let width = |name: &str| name.chars().count().max(9);
        let _ = write!(text, "{of:20}");
        for (name, _) in &columns {
            let _ = write!(text, "  {name:>width$}", width = width(name));
        }
        text.push('\n');
        for metric in METRIC_NAMES {
            let values: Vec<Option<f64>> =
                columns.iter().map(|(_, metrics)| metrics.get(metric).flatten()).collect();
            if values.iter().all(Option::is_none) {
                continue;
            }
            let _ = write!(text, "{metric:20}");
            for ((name, _), value) in columns.iter().zip(values) {
                let value = value.map_or("-".to_owned(), |value| quantity(metric, value));
                let _ = write!(text, "  {value:>width$}", width = width(name));
            }
            text.push('\n');
        }
    }
    text
}

/// A verdict in words: `completeness 0.610, expected at least 0.650`.
pub(super) fn verdict(verdict: &LimitVerdict) -> String {
    let measure = &verdict.bound.measure;
    let value = verdict.value;
    let value =
        value.map_or("could not be measured".to_owned(), |v| spread(&measure.metric, &verdict.each, v));
    let expected: Vec<String> = [("at least", verdict.bound.limit.min), ("at most", verdict.bound.limit.max)]
        .into_iter()
        .filter_map(|(words, limit)| Some(format!("{words} {}", quantity(&measure.metric, limit?))))
        .collect();
    format!("{measure} {value}, expected {}", expected.join(" and "))
}

/// The mean of a metric, and the minimum and maximum of its seeds if there are several.
fn spread(metric: &str, each: &[Option<f64>], mean: f64) -> String {
    let text = quantity(metric, mean);
    if each.len() < 2 {
        return text;
    }
    let known = || each.iter().flatten().copied();
    let (low, high) = (known().fold(f64::INFINITY, f64::min), known().fold(f64::NEG_INFINITY, f64::max));
    // The unit is that of the value before it.
    let low = quantity(metric, low);
    format!("{text} ({} to {})", low.trim_end_matches(" mm"), quantity(metric, high))
}

/// One line of `check`.
pub(super) fn check_line(name: &str, judgement: &Judgement) -> String {
    let kept = judgement.verdicts.iter().all(|v| v.kept);
    let values = judgement.verdicts.iter().map(|v| {
        let metric = &v.bound.measure.metric;
        let mut value = v.value.map_or("none".to_owned(), |value| spread(metric, &v.each, value));
        if let Some(possible) = judgement.oracle.as_ref().and_then(|oracle| oracle.get(&v.bound.measure)) {
            let _ = write!(value, " of {}", quantity(metric, possible));
        }
        format!("{}{} {value}", if v.kept { "" } else { "! " }, v.bound.measure)
    });
    let values: Vec<String> = values.collect();
    let seeds: Vec<String> = judgement.seeds.iter().map(u32::to_string).collect();
    let seeds =
        if seeds.len() > 1 { format!(" (mean of seeds {})", seeds.join(", ")) } else { String::new() };
    format!("{} {name}{seeds}: {}\n", if kept { "ok    " } else { "MISSED" }, values.join(", "))
}

/// The facts of `info`, one per line; nested ones are indented.
pub(super) fn facts(value: &Value) -> String {
    fn rows(table: &mut KeyValueTable, value: &Value, indent: usize) {
        let Some(facts) = value.as_object() else { return };
        for (name, value) in facts {
            let name = format!("{}{}", "  ".repeat(indent), name.replace('_', " "));
            match value {
                Value::Object(_) => {
                    table.row(&name, "");
                    rows(table, value, indent + 1);
                }
                Value::String(text) => table.row(&name, shortened(text)),
                Value::Array(list) if list.iter().all(|v| !v.is_object()) => {
                    let items: Vec<String> = list.iter().map(plain).collect();
                    table.row(&name, items.join(", "));
                }
                Value::Array(list) => {
                    for item in list {
                        table.row(&name, plain(item));
                    }
                }
                Value::Null => {}
                other => table.row(&name, plain(other)),
            }
        }
    }
    let mut table = KeyValueTable::default();
    rows(&mut table, value, 0);
    table.text()
}

/// What was guessed, a line each.
pub(super) fn guesses(guesses: &[String]) -> String {
    guesses.iter().fold(String::new(), |mut text, guess| {
        let _ = writeln!(text, "guessed: {}", one_line(guess));
        text
    })
}

/// A text of a line or two; longer ones, such as a run file in an attribute, are cut off.
fn shortened(text: &str) -> String {
    const MAX_CHARS: usize = 120;
    if text.chars().count() <= MAX_CHARS {
        return text.to_owned();
    }
    format!("{} ... (--json prints all)", text.chars().take(MAX_CHARS).collect::<String>())
}

/// A value without quotes and superfluous digits.
fn plain(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Number(n) if n.is_f64() => short(n.as_f64().unwrap_or_default()),
        Value::Object(fields) => {
            fields.iter().map(|(k, v)| format!("{k} {}", plain(v))).collect::<Vec<_>>().join(", ")
        }
        other => other.to_string(),
    }
}

/// Up to six significant digits.
fn short(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return value.to_string();
    }
    let digits = (5 - value.abs().log10().floor() as i32).clamp(0, 12) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        for (value, text) in
            [(0.0, "0"), (0.4, "0.4"), (1.0 / 3.0, "0.333333"), (20_000.0, "20000"), (-0.05, "-0.05")]
        {
            assert_eq!(short(value), text);
        }
    }
}
