//! One function per command: arguments in, library calls, results out.

use super::inputs::{check_kind, config_of, has_extension, reading_limit, scene_of};
use super::outputs::{check_extension, make_folder, pretty, wrote};
use super::terminal::{Terminal, observed, print};
use super::verdicts::{check, compare};
use super::{Cli, Command, Overrides, design, guide, info, manual, reproduce, summary};
use crate::acquisition::CubeFile;
use crate::checkpoint::Checkpoint;
use crate::config::ANNOTATED;
use crate::error::{Error, Result};
use crate::files::{check_folder, check_writable, write_atomically};
use crate::pipeline;
use crate::progress::{Observer, stage};
use clap::CommandFactory;
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::time::Duration;

/// The corner mesh that `init` writes beside its run file.
const CORNER_MESH: &str = include_str!("../../scenes/meshes/corner.obj");

/// Runs what was typed.
pub(super) fn run(cli: &Cli, terminal: &Terminal) -> Result<()> {
    let json = cli.common.json;
    match &cli.command {
        Command::Image { input, output, config, overrides, keeping } => {
            let checkpoint = Checkpoint::within(output, keeping.every()?);
            let made = make_folder(output)?;
            check_folder(output)?;
            let result = image(input, output, config.as_deref(), overrides, &checkpoint, json, terminal);
            let result = ended(checkpoint, result, terminal);
            if made && result.is_err() {
                // A request that came to nothing leaves nothing behind; a folder with files in it stays.
                let _ = std::fs::remove_dir(output);
            }
            result
        }
        Command::Simulate { input, output, overrides, keeping } => {
            let (run, bare) = scene_of(input, overrides)?;
            check_extension(output, &["npz"])?;
            check_writable(output)?;
            let checkpoint = Checkpoint::beside(output, keeping.every()?);
            let job = observed(terminal).with_bare_mesh(bare).with_checkpoint(&checkpoint);
            let result = pipeline::simulate_scene(&run, &job)
                .and_then(|cube| stage(terminal, "writing", 0, || pipeline::write_cube(output, &cube)));
            ended(checkpoint, result, terminal)?;
            wrote(std::slice::from_ref(output), json, terminal)
        }
        Command::Reconstruct { cube, config, output, settings, keeping } => {
            for path in output {
                check_extension(path, &["npz", "exr", "vti", "nrrd"])?;
                check_writable(path)?;
            }
            // The checkpoint lies beside the first of them.
            let checkpoint = Checkpoint::beside(&output[0], keeping.every()?);
            check_kind(cube, "a data cube", "simulate")?;
            let run = config_of(config.as_deref(), &settings.set)?;
            let cube = CubeFile::open(cube, reading_limit())?;
            let job = observed(terminal).with_checkpoint(&checkpoint);
            let result = pipeline::reconstruct_cube(&run, cube, output, &job);
            let files = ended(checkpoint, result, terminal)?;
            wrote(&files, json, terminal)
        }
        Command::Depth { volume, config, output, settings } => {
            check_extension(output, &["exr", "ply"])?;
            check_kind(volume, "a volume", "reconstruct")?;
            let run = config_of(config.as_deref(), &settings.set)?;
            let known = config.is_some().then_some(&run);
            let (map, facts) = pipeline::depth_of_volume(volume, &run, known.is_some(), &observed(terminal))?;
            pipeline::write_depth(output, &map, &run, &facts)?;
            wrote(std::slice::from_ref(output), json, terminal)
        }
        Command::Truth { input, output, overrides } => {
            check_extension(output, &["exr", "ply"])?;
            let (run, bare) = scene_of(input, overrides)?;
            let (facts, map) = pipeline::truth_of_scene(&run, &observed(terminal).with_bare_mesh(bare))?;
            pipeline::write_depth(output, &map, &run, &facts)?;
            wrote(std::slice::from_ref(output), json, terminal)
        }
        Command::Plan { input, sweep, output, overrides, .. } if !sweep.is_empty() => {
            if has_extension(input, &["npz"]) {
                return Err(Error::input(
                    input.display(),
                    "is a cube, whose array is fixed; a sweep needs a run file",
                ));
            }
            design::sweep(input, sweep, output.as_deref(), overrides, json, terminal)
        }
        Command::Psf { input, at, output, overrides } => {
            design::psf(input, at, output.as_deref(), overrides, json, terminal)
        }
        Command::Plan { input, config, overrides, .. } => {
            plan(input, config.as_deref(), overrides, json, terminal)
        }
        Command::Compare { result, truth, resolution, min, max, png } => {
            compare(result, truth, *resolution, min, max, png.as_deref(), json)
        }
        Command::Check { runs, overrides, seeds } => check(runs, overrides, seeds, json, terminal),
        Command::Reproduce { output } => reproduce::run(output.as_deref(), json, terminal),
        Command::Report { folder, open } => report(folder, *open, json, terminal),
        Command::Info { file, overrides } => {
            let facts = info::of(file, overrides, reading_limit(), terminal)?;
            print(&if json { pretty(&facts) } else { summary::facts(&facts) })
        }
        Command::Init { folder } => init(folder, json, terminal),
        Command::Man { folder: None } => print_text(&manual::page()?, json),
        Command::Man { folder: Some(folder) } => wrote(&manual::write(folder)?, json, terminal),
        Command::Help { topic } => guide::help(topic),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(*shell, &mut Cli::command(), "holosonar", &mut script);
            print_text(&String::from_utf8_lossy(&script), json)
        }
    }
}

/// Predicts a job of a cube or of a scene.
fn plan(
    input: &Path,
    config: Option<&Path>,
    overrides: &Overrides,
    json: bool,
    terminal: &Terminal,
) -> Result<()> {
    let forecast = if has_extension(input, &["npz"]) {
        let run = config_of(config, &overrides.keys())?;
        pipeline::forecast_cube(&run, &CubeFile::open(input, reading_limit())?)?
    } else {
        no_config(config)?;
        let (run, bare) = scene_of(input, overrides)?;
        pipeline::forecast_scene(&run, &observed(terminal).with_bare_mesh(bare))?
    };
    for warning in &forecast.warnings {
        terminal.warn(warning);
    }
    if json {
        let value =
            serde_json::to_value(&forecast).map_err(|e| Error::io("plan", e.to_string()).with_source(e))?;
        return print(&pretty(&value));
    }
    print(&(summary::forecast(&forecast) + &design::design(&forecast.design)))
}

/// Makes the page of a folder of results, and shows it if asked to.
fn report(folder: &Path, open: bool, json: bool, terminal: &Terminal) -> Result<()> {
    if !folder.is_dir() {
        return Err(Error::input(
            folder.display(),
            "no such folder; one that `holosonar image ... -o` wrote was expected",
        ));
    }
    let page = stage(terminal, "packing the page", 0, || pipeline::write_page(folder, reading_limit()))?;
    wrote(std::slice::from_ref(&page), json, terminal)?;
    if open { show(&page) } else { Ok(()) }
}

/// How long a browser's starter is watched for a failure; one that fails does so at once, one that does not may stay for as long
/// as the browser.
const STARTING: Duration = Duration::from_secs(2);

/// Opens a page with the program that the system takes for HTML; does not wait for its end.
fn show(page: &Path) -> Result<()> {
    // A relative name could be taken for an option or a URL.
    let page = std::path::absolute(page).unwrap_or_else(|_| page.to_path_buf());
    open::that_detached_with_timeout(&page, STARTING).map_err(|error| {
        let why = match error.kind() {
            ErrorKind::NotFound => "no program to open a page with was found, xdg-open or another".to_owned(),
            _ => format!("the page could not be opened ({error})"),
        };
        Error::io("--open", format!("{why}; open {} in a browser yourself", page.display()))
            .with_source(error)
    })
}

/// Images an input into a folder that is there.
fn image(
    input: &Path,
    folder: &Path,
    config: Option<&Path>,
    overrides: &Overrides,
    checkpoint: &Checkpoint,
    json: bool,
    terminal: &Terminal,
) -> Result<()> {
    let job = observed(terminal).with_checkpoint(checkpoint);
    let (run, outcome) = if has_extension(input, &["npz"]) {
        let run = config_of(config, &overrides.keys())?;
        let cube = CubeFile::open(input, reading_limit())?;
        let outcome = pipeline::image_cube(&run, cube, &job)?;
        (run, outcome)
    } else {
        no_config(config)?;
        let (run, bare) = scene_of(input, overrides)?;
        let outcome = pipeline::image_scene(&run, &job.with_bare_mesh(bare))?;
        (run, outcome)
    };
    let report = pipeline::write_outputs(&run, &outcome, folder, &job)?;
    if json {
        // Not by way of a `Value`, which would write an f32 with the digits of an f64.
        let text = serde_json::to_string_pretty(&report)
            .map_err(|e| Error::io("report", e.to_string()).with_source(e))?;
        return print(&(text + "\n"));
    }
    if terminal.is_quiet() { Ok(()) } else { print(&summary::image(input, folder, &report, &outcome)) }
}

/// Deletes the checkpoint once a job is done, and else says how to resume from it.
fn ended<T>(checkpoint: Checkpoint, result: Result<T>, terminal: &Terminal) -> Result<T> {
    match result {
        Ok(_) => checkpoint.remove(),
        Err(_) => terminal.advise(checkpoint.how_to_continue()),
    }
    result
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
    make_folder(folder)?;
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

/// Prints a text that another program is to read, which JSON wraps.
fn print_text(text: &str, json: bool) -> Result<()> {
    if json { print(&pretty(&serde_json::json!({ "text": text }))) } else { print(text) }
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
