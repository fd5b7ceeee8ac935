//! `autofocus`: the curve of a parameter, as a table, and as a picture and JSON in a folder.

use crate::cli::Settings;
use crate::cli::inputs::{check_kind, cube_of};
use crate::cli::outputs::{open_folder, print_json, write_json};
use crate::cli::summary;
use crate::cli::terminal::{Terminal, observed, print};
use crate::error::Result;
use crate::export::figure::write_focus_figure;
use crate::focus::{Autofocus, AutofocusOptions, FocusMeasure, FocusParameter, FocusVerdict};
use crate::pipeline;
use clap::Args;
use serde_json::{Map, Value, json};
use std::fmt::Write;
use std::path::PathBuf;

/// Searches for the speed of sound, delay, tilt, place or velocity with which a measured cube's image is sharpest.
///
/// The region is [grid]. Nothing is changed: what was found is printed as a --set to type. See `holosonar help measured`.
#[derive(Debug, Args)]
pub(in crate::cli) struct AutofocusArgs {
    /// The cube.
    cube: PathBuf,
    /// What is tried: sound-speed, delay, z-offset, tilt-x, tilt-y, source-x, source-y, source-z, velocity-x, velocity-y or velocity-z.
    #[arg(long, value_name = "PARAMETER")]
    over: FocusParameter,
    /// The values that are tried, from and to [default: 3 % of the speed or of the path either way, 5 degrees, velocities that blur by some cycles].
    #[arg(long, value_name = "FROM,TO", allow_hyphen_values = true, value_parser = range)]
    range: Option<[f64; 2]>,
    /// Number of values [default: as many as the top may be narrow].
    #[arg(long, value_name = "N")]
    trials: Option<usize>,
    /// What is called sharp: sharpness, gradient or peak.
    #[arg(long, value_name = "MEASURE", default_value = "sharpness")]
    measure: FocusMeasure,
    /// Run file, of which [grid] and [calibration] are used.
    #[arg(short, long, value_name = "RUN.toml")]
    config: Option<PathBuf>,
    /// Folder for focus.png and focus.json; created if missing.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    settings: Settings,
}

/// Two numbers, as typed.
fn range(typed: &str) -> std::result::Result<[f64; 2], String> {
    let numbers: Option<Vec<f64>> = typed.split(',').map(|word| word.trim().parse().ok()).collect();
    match numbers.as_deref() {
        Some([from, to]) if from.is_finite() && to.is_finite() && from < to => Ok([*from, *to]),
        _ => Err("two numbers were expected, the lesser first, as in 335,351".to_owned()),
    }
}

pub(super) fn run(args: &AutofocusArgs, terminal: &Terminal) -> Result<()> {
    check_kind(&args.cube, "a data cube", "import")?;
    let folder =
        args.output.as_deref().map(|folder| open_folder(folder, ["focus.png", "focus.json"])).transpose()?;
    let (run, cube) = cube_of(&args.cube, args.config.as_deref(), &args.settings.set, terminal)?;
    let options = AutofocusOptions::default()
        .with_measure(args.measure)
        .with_range(args.range)
        .with_trials(args.trials);
    let found = pipeline::autofocus_cube(&run, cube, args.over, &options, &observed(terminal))?;
    if let Some((_, files)) = &folder {
        write_focus_figure(&files[0], &found)?;
        write_json(&files[1], &found)?;
    }
    if terminal.json() {
        return print_json(&found);
    }
    let mut text = summary::facts(&table(&found));
    let _ = match (&found.reason, &found.setting) {
        (Some(reason), _) => writeln!(text, "{} is not known from this cube: {reason}", found.parameter),
        (None, Some(setting)) => writeln!(text, "nothing was changed; to use it: --set {setting}"),
        (None, None) => Ok(()),
    };
    for file in folder.iter().flat_map(|(_, files)| files) {
        let _ = writeln!(text, "wrote {}", file.display());
    }
    print(&text)
}

/// The facts in few words.
fn table(found: &Autofocus) -> Value {
    let digits = |value: f64| format!("{value:.4}");
    let between = |[from, to]: [f64; 2]| format!("{} to {} {}", digits(from), digits(to), found.unit);
    let mut facts = Map::new();
    let mut row = |name: &str, value: Value| facts.insert(name.to_owned(), value);
    row("parameter", json!(found.parameter));
    row("tried", json!(format!("{} in {} images", between(found.range), found.images)));
    row("the cube has", json!(format!("{} {}", digits(found.own), found.unit)));
    let error =
        found.standard_error.map_or(String::new(), |error| format!(", standard error {}", digits(error)));
    row("sharpest at", json!(format!("{} {}{error}", digits(found.best), found.unit)));
    row("within 2 % of that", json!(found.plateau.map(between)));
    row("half height at", json!(between(found.width)));
    row(found.measure.as_str(), json!(format!("falls by {:.1} % from its top", 100.0 * found.contrast)));
    row("blur at the ends", json!(format!("{:.3} rad rms, wherever points move", found.blur)));
    row("verdict", json!(found.verdict));
    if found.verdict == FocusVerdict::Found
        && found.standard_error.is_some_and(|error| (found.best - found.own).abs() <= 2.0 * error)
    {
        row("note", json!("what the cube has is within two standard errors"));
    }
    Value::Object(facts)
}
