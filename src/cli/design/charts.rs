//! The pictures of a sweep: what each key does to a design, and error against what it costs.

use crate::cli::summary::duration;
use crate::error::Result;
use crate::export::figure::{Chart, ChartAxis, Scatter, write_charts, write_scatters};
use crate::metrics::{Measure, Metrics};
use crate::pipeline::{Combination, DesignSweep};
use std::path::Path;

/// Draws a sweep, with the first key along x and a line for every combination of the others.
pub(super) fn write_sweep(path: &Path, sweep: &DesignSweep) -> Result<()> {
    // Combinations are in the order of their keys: all lines of a place follow one another.
    let lines = line_count(sweep);
    let places: Vec<String> =
        sweep.combinations.iter().step_by(lines).map(|combination| combination.values[0].clone()).collect();
    let name = |combination: &Combination| {
        let named = sweep.keys.iter().zip(&combination.values).skip(1);
        named.map(|(key, value)| format!("{key} = {value}")).collect::<Vec<_>>().join(", ")
    };
    let series: Vec<String> = sweep.combinations.iter().take(lines).map(name).collect();
    let chart = |title: &str, y_label: &str, of: &dyn Fn(&Combination) -> Option<f64>| {
        let along = |line: usize| {
            let line = sweep.combinations.iter().skip(line).step_by(lines);
            line.map(|combination| of(combination).unwrap_or(f64::NAN)).collect()
        };
        Chart { title: title.into(), y_label: y_label.into(), series: (0..lines).map(along).collect() }
    };
    let mm = |m: Option<f64>| m.map(|m| 1e3 * m);
    let cost = |combination: &Combination| combination.design.as_ref()?.cost;
    let mean = |combination: &Combination| Some(combination.simulated.as_ref()?.mean);
    let time = chart("time of the measurement", "s", &|c| Some(c.design.as_ref()?.acquisition.seconds));
    let charts = if sweep.measure.is_some() {
        vec![
            chart("completeness", "share", &|c| mean(c)?.completeness),
            chart("false returns", "share", &|c| mean(c)?.false_returns),
            chart("median depth error", "mm", &|c| mm(mean(c)?.median_error)),
            chart("mean distance of found and true points", "mm", &|c| mm(mean(c)?.chamfer_distance)),
            chart("lateral width at the middle depth", "-3 dB width / mm", &|c| {
                mm(c.design.as_ref()?.widths[1])
            }),
            time,
        ]
    } else {
        vec![
            chart("lateral width at the middle depth", "-3 dB width / mm", &|c| {
                mm(c.design.as_ref()?.widths[1])
            }),
            chart("range resolution c/2B", "mm", &|c| mm(c.design.as_ref()?.range_resolution)),
            chart("nearest grating lobe", "offset at the nearest depth / m", &|c| {
                c.design.as_ref()?.grating_lobe_offset
            }),
            chart("strongest grating lobe or sidelobe", "dB", &|c| c.design.as_ref()?.peak_sidelobe_db),
            chart("memory", "MiB", &|c| Some(cost(c)?.peak_bytes as f64 / f64::from(1 << 20))),
            chart("time of the reconstruction", "s", &|c| Some(cost(c)?.seconds)),
        ]
    };
    let axis = ChartAxis { label: sweep.keys[0].clone(), places, series };
    write_charts(path, &charts, &axis)
}

/// How many combinations there are of the keys but the first.
fn line_count(sweep: &DesignSweep) -> usize {
    let all = &sweep.combinations;
    let same = |combination: &&Combination| combination.values[0] == all[0].values[0];
    // A value may have been typed twice.
    let first = all.iter().take_while(same).count();
    let others = |combination: &Combination| combination.values[1..] == all[0].values[1..];
    (1..first).find(|at| others(&all[*at])).unwrap_or(first)
}

/// An error by a measure: lengths in mm, others without a unit.
pub(super) fn error_text(measure: &str, error: f64) -> String {
    if is_length(measure) { format!("{:.1} mm", 1e3 * error) } else { format!("{error:.3}") }
}

fn is_length(measure: &str) -> bool {
    Measure::parse(measure).is_ok_and(|measure| Metrics::is_length(&measure.metric))
}

/// Most points of a front that are named.
const NAMED: usize = 24;

/// Draws error against time of the measurement and against number of microphones, with the fronts.
pub(super) fn write_pareto(path: &Path, sweep: &DesignSweep) -> Result<()> {
    let measure = sweep.measure.as_deref().unwrap_or_default();
    let factor = if is_length(measure) { 1e3 } else { 1.0 };
    let is_share = Measure::parse(measure).is_ok_and(|measure| !Metrics::is_error(&measure.metric));
    let label = match (is_length(measure), is_share) {
        (true, _) => format!("{measure} / mm"),
        (_, true) => format!("1 - {measure}"),
        _ => measure.to_owned(),
    };
    let front = |combination: &Combination| {
        combination.simulated.as_ref().map(|simulated| simulated.front).unwrap_or_default()
    };
    // Those on a front of two numbers are named, by what they cost.
    let mut named: Vec<usize> = (0..sweep.combinations.len())
        .filter(|i| {
            let front = front(&sweep.combinations[*i]);
            front.time || front.microphones
        })
        .collect();
    named.sort_by(|a, b| {
        let [a, b] = [a, b].map(|i| sweep.combinations[*i].costs());
        a[1].total_cmp(&b[1]).then(a[2].total_cmp(&b[2])).then(a[0].total_cmp(&b[0]))
    });
    named.truncate(NAMED);
    let letter = |i: usize| named.iter().position(|named| *named == i).map(|at| (b'A' + at as u8) as char);
    let scatter = |cost: usize, title: &str, x_label: &str| {
        let points = sweep.combinations.iter().map(|combination| {
            let costs = combination.costs();
            [costs[cost], factor * costs[0]]
        });
        let on_line = |i: usize| {
            let front = front(&sweep.combinations[i]);
            if cost == 1 { front.time } else { front.microphones }
        };
        Scatter {
            title: title.into(),
            x_label: x_label.into(),
            y_label: label.clone(),
            points: points.collect(),
            on_front: sweep.combinations.iter().map(|combination| front(combination).all).collect(),
            on_line: (0..sweep.combinations.len()).map(on_line).collect(),
            letters: (0..sweep.combinations.len()).map(letter).collect(),
        }
    };
    let names = named.iter().map(|i| {
        let combination = &sweep.combinations[*i];
        let keys = sweep.keys.iter().zip(&combination.values).map(|(key, value)| format!("{key} = {value}"));
        let [error, seconds, microphones] = combination.costs();
        format!(
            "{}: {} ({microphones} microphones, {}, {})",
            letter(*i).unwrap_or(' '),
            keys.collect::<Vec<_>>().join(", "),
            duration(seconds),
            error_text(measure, error)
        )
    });
    let scatters = [
        scatter(1, "error and time of the measurement", "time of the measurement / s"),
        scatter(2, "error and number of microphones", "microphones"),
    ];
    write_scatters(path, &scatters, &names.collect::<Vec<_>>())
}
