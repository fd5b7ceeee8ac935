//! One function per command: arguments in, library calls, results out.

use super::inputs::{config_of, has_extension, run_of};
use super::terminal::{Terminal, print};
use super::{Cli, Command, Overrides, browser, info, summary};
use clap::CommandFactory;
use holosonar::acquisition::CubeFile;
use holosonar::config::ANNOTATED;
use holosonar::error::{Error, Result};
use holosonar::export::depth_exr::{DepthFile, read_depth_map};
use holosonar::export::{Attribute, find_attribute};
use holosonar::files::write_atomically;
use holosonar::metrics::{Metrics, evaluate};
use holosonar::pipeline::{self, Bound, Verdict};
use holosonar::plan::memory_limit;
use holosonar::progress::Observer;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The corner mesh that `init` writes beside its run file.
const CORNER_MESH: &str = include_str!("../../scenes/meshes/corner.obj");

/// Runs what was typed.
pub(super) fn run(cli: &Cli, terminal: &Terminal) -> Result<()> {
    let json = cli.common.json;
    match &cli.command {
        Command::Image { input, output, config, overrides } => {
            let made = make_folder(output)?;
            let result = image(input, output, config.as_deref(), overrides, json, terminal);
            if made && result.is_err() {
                // A request that came to nothing leaves nothing behind; a folder with files in it stays.
                let _ = std::fs::remove_dir(output);
            }
            result
        }
        Command::Simulate { input, output, overrides } => {
            let (run, bare) = run_of(input, overrides)?;
            check_extension(output, &["npz"])?;
            let cube = pipeline::simulate_scene(&run, bare, terminal)?;
            pipeline::write_cube(output, &cube)?;
            wrote(std::slice::from_ref(output), json, terminal)
        }
        Command::Reconstruct { cube, config, output, settings } => {
            for path in output {
                check_extension(path, &["npz", "exr", "vti", "nrrd"])?;
            }
            let run = config_of(config.as_deref(), &settings.set)?;
            let cube = CubeFile::open(cube, reading_limit())?;
            let files = pipeline::reconstruct_cube(&run, cube, output, terminal)?;
            wrote(&files, json, terminal)
        }
        Command::Depth { volume, config, output, settings } => {
            check_extension(output, &["exr", "ply"])?;
            let run = config_of(config.as_deref(), &settings.set)?;
            let known = config.is_some().then_some(&run);
            let (map, facts) =
                pipeline::depth_of_volume(volume, &run, known.is_some(), reading_limit(), terminal)?;
            pipeline::write_depth(output, &map, &run, &facts)?;
            wrote(std::slice::from_ref(output), json, terminal)
        }
        Command::Truth { input, output, overrides } => {
            check_extension(output, &["exr", "ply"])?;
            let (run, bare) = run_of(input, overrides)?;
            let (facts, map) = pipeline::truth_of_scene(&run, bare, terminal)?;
            pipeline::write_depth(output, &map, &run, &facts)?;
            wrote(std::slice::from_ref(output), json, terminal)
        }
        Command::Plan { input, config, overrides } => {
            let forecast = if has_extension(input, &["npz"]) {
                let run = config_of(config.as_deref(), &overrides.keys())?;
                pipeline::forecast_cube(&run, &CubeFile::open(input, reading_limit())?)?
            } else {
                no_config(config.as_deref())?;
                let (run, bare) = run_of(input, overrides)?;
                pipeline::forecast_scene(&run, bare, terminal)?
            };
            for warning in &forecast.warnings {
                terminal.warn(warning);
            }
            if json {
                let value =
                    serde_json::to_value(&forecast).map_err(|e| Error::environment("plan", e.to_string()))?;
                return print(&pretty(&value));
            }
            print(&summary::forecast(&forecast))
        }
        Command::Compare { result, truth, resolution, min, max } => {
            compare(result, truth, *resolution, min, max, json)
        }
        Command::Check { runs, overrides } => check(runs, overrides, json, terminal),
        Command::Report { folder, open } => {
            let page = pipeline::write_page(folder, reading_limit())?;
            wrote(std::slice::from_ref(&page), json, terminal)?;
            if *open { browser::open(&page) } else { Ok(()) }
        }
        Command::Info { file, overrides } => {
            let facts = info::of(file, overrides, reading_limit(), terminal)?;
            print(&if json { pretty(&facts) } else { summary::facts(&facts) })
        }
        Command::Init { folder } => init(folder, json, terminal),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(*shell, &mut Cli::command(), "holosonar", &mut script);
            print(&String::from_utf8_lossy(&script))
        }
    }
}

/// Images an input into a folder that is there.
fn image(
    input: &Path,
    folder: &Path,
    config: Option<&Path>,
    overrides: &Overrides,
    json: bool,
    terminal: &Terminal,
) -> Result<()> {
    let (run, outcome) = if has_extension(input, &["npz"]) {
        let run = config_of(config, &overrides.keys())?;
        let cube = CubeFile::open(input, reading_limit())?;
        let outcome = pipeline::image_cube(&run, cube, terminal)?;
        (run, outcome)
    } else {
        no_config(config)?;
        let (run, bare) = run_of(input, overrides)?;
        let outcome = pipeline::image_scene(&run, bare, terminal)?;
        (run, outcome)
    };
    let report = pipeline::write_outputs(&run, &outcome, folder, terminal)?;
    if json {
        // Not by way of a `Value`, which would write an f32 with the digits of an f64.
        let text =
            serde_json::to_string_pretty(&report).map_err(|e| Error::environment("report", e.to_string()))?;
        return print(&(text + "\n"));
    }
    if terminal.is_quiet() { Ok(()) } else { print(&summary::image(input, folder, &report, &outcome)) }
}

fn compare(
    result: &Path,
    truth: &Path,
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
    let truth = read_depth_map(truth, reading_limit())?;
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
    let metrics = evaluate(&found.map, &truth.map, resolution)?;
    let verdicts = pipeline::hold(&metrics, bounds);
    if json {
        print(&pretty(&verdicts_json(&metrics, &verdicts)))?;
    } else {
        print(&summary::metrics(&metrics))?;
    }
    limits_kept(&verdicts)
}

fn check(runs: &[PathBuf], overrides: &Overrides, json: bool, terminal: &Terminal) -> Result<()> {
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

fn init(folder: &Path, json: bool, terminal: &Terminal) -> Result<()> {
    let files =
        [(folder.join("corner.toml"), ANNOTATED), (folder.join("meshes").join("corner.obj"), CORNER_MESH)];
    if let Some((path, _)) = files.iter().find(|(path, _)| path.exists()) {
        return Err(Error::input(
            path.display(),
            "is there already and would be overwritten; choose another folder",
        ));
    }
    for (path, text) in &files {
        write_atomically(path, |file| file.write_all(text.as_bytes()))?;
    }
    let paths = files.map(|(path, _)| path);
    wrote(&paths, json, terminal)?;
    if json || terminal.is_quiet() {
        return Ok(());
    }
    print(&format!("now try: holosonar image {} -o {}\n", paths[0].display(), folder.join("out").display()))
}

/// Refuses a second run file beside a scene's own.
fn no_config(config: Option<&Path>) -> Result<()> {
    match config {
        Some(_) => {
            Err(Error::input("--config", "goes with a cube (.npz); a scene's run file is the input itself"))
        }
        None => Ok(()),
    }
}

/// Refuses an output name before any work is done for it.
fn check_extension(path: &Path, extensions: &[&str]) -> Result<()> {
    if has_extension(path, extensions) {
        return Ok(());
    }
    let known = extensions.iter().map(|e| format!(".{e}")).collect::<Vec<_>>().join(", ");
    Err(Error::input(
        path.display(),
        format!("the extension decides the format; this command writes {known}"),
    ))
}

/// Makes the output folder first, so that a place that cannot be written is found before the long work; says whether it
/// was not there before.
fn make_folder(folder: &Path) -> Result<bool> {
    let missing = !folder.exists();
    std::fs::create_dir_all(folder).map(|()| missing).map_err(|e| match e.kind() {
        std::io::ErrorKind::AlreadyExists | std::io::ErrorKind::NotADirectory => {
            Error::input(folder.display(), "is a file; a folder was expected for the results")
        }
        _ => Error::writing(folder, &e),
    })
}

/// Bytes that any one array of an input may take.
fn reading_limit() -> u64 {
    memory_limit().unwrap_or(u64::MAX)
}

fn wrote(files: &[PathBuf], json: bool, terminal: &Terminal) -> Result<()> {
    if json {
        return print(&pretty(&serde_json::json!({ "files": files })));
    }
    if terminal.is_quiet() {
        return Ok(());
    }
    let lines: Vec<String> = files.iter().map(|path| format!("wrote {}\n", path.display())).collect();
    print(&lines.concat())
}

fn pretty(value: &serde_json::Value) -> String {
    format!("{value:#}\n")
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
