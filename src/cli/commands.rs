//! The commands: each turns its arguments into calls of the library and shows the results.

mod ascan;
mod autofocus;
mod calibrate;
mod import;
mod plan;
mod recording;
mod work;

pub(super) use ascan::AscanArgs;
pub(super) use autofocus::AutofocusArgs;
pub(super) use calibrate::CalibrateArgs;
pub(super) use import::ImportArgs;
pub(super) use plan::PlanArgs;
pub(super) use work::WorkArgs;

use super::inputs::{
    Input, JobInput, bare_mesh, check_kind, config_of, cube_of, has_extension, job_of, reading_limit,
    scene_of,
};
use super::outputs::{announce, open_folder, print_json, print_written};
use super::placement::Placement;
use super::terminal::{Terminal, observed, print};
use super::verdicts::{Compared, check, compare};
use super::{Cli, Command, Overrides, design, guide, info, manual, reproduce, summary};
use crate::checkpoint::Checkpoint;
use crate::config::ANNOTATED;
use crate::error::{Error, Result};
use crate::files::{OutputFolder, write_atomically};
use crate::pipeline;
use crate::progress::{Observer, stage};
use clap::CommandFactory;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The mesh of the run file that `init` writes.
const CORNER_MESH: &str = include_str!("../../scenes/meshes/corner.obj");

/// The extensions of what `simulate` and `reconstruct` write.
const SIMULATED: [&str; 3] = ["npz", "zarr", "wav"];
const RECONSTRUCTED: [&str; 6] = ["npz", "zarr", "exr", "vti", "nrrd", "vdb"];

/// Runs the command.
pub(super) fn run(cli: &Cli, terminal: &Terminal) -> Result<()> {
    match &cli.command {
        Command::Image { input, output, config, overrides, checkpoint } => {
            let checkpoint = Checkpoint::within(output, checkpoint.every()?);
            let _folder = OutputFolder::open(output)?;
            let result = image(input, output, config.as_deref(), overrides, &checkpoint, terminal);
            conclude(checkpoint, result, terminal)
        }
        Command::Simulate { input, output, overrides, checkpoint } => {
            simulate(input, output, overrides, checkpoint.every()?, terminal)
        }
        Command::Work(args) => work::run(args, terminal),
        Command::Import(args) => import::run(args, terminal),
        Command::Ascan(args) => ascan::run(args, terminal),
        Command::Autofocus(args) => autofocus::run(args, terminal),
        Command::Calibrate(args) => calibrate::run(args, terminal),
        Command::Reconstruct { cube, config, output, settings, checkpoint } => {
            output.iter().try_for_each(|path| announce(path, &RECONSTRUCTED))?;
            // The checkpoint is in the folder of the first output.
            let checkpoint = Checkpoint::beside(&output[0], checkpoint.every()?);
            check_kind(cube, "a data cube", "simulate")?;
            let (run, cube) = cube_of(cube, config.as_deref(), &settings.set, terminal)?;
            let job = observed(terminal).with_checkpoint(&checkpoint);
            let result = pipeline::reconstruct_cube(&run, cube, output, &job);
            let files = conclude(checkpoint, result, terminal)?;
            print_written(&files, terminal)
        }
        Command::Depth { volume, config, output, settings } => {
            announce(output, &["exr", "ply"])?;
            check_kind(volume, "a volume", "reconstruct")?;
            let run = config_of(config.as_deref(), &settings.set)?;
            let sweep_known = config.is_some();
            let (map, facts) = pipeline::depth_of_volume(volume, &run, sweep_known, &observed(terminal))?;
            pipeline::write_depth(output, &map, &run, &facts)?;
            print_written(std::slice::from_ref(output), terminal)
        }
        Command::Truth { input, output, overrides } => {
            announce(output, &["exr", "ply", "png"])?;
            let Input { run, bare } = scene_of(input, overrides, terminal)?;
            let job = observed(terminal).with_bare_mesh(bare.as_ref());
            if has_extension(output, &["png"]) {
                pipeline::write_preview(output, &run, &job)?;
            } else {
                let (facts, map) = pipeline::truth_of_scene(&run, &job)?;
                pipeline::write_depth(output, &map, &run, &facts)?;
            }
            print_written(std::slice::from_ref(output), terminal)
        }
        Command::Psf { input, at, output, overrides } => {
            design::psf(input, at, output.as_deref(), overrides, terminal)
        }
        Command::Plan(args) => plan::run(args, terminal),
        Command::Oracle { input, output, overrides } => {
            announce(output, &["exr", "ply"])?;
            let Input { run, bare } = scene_of(input, overrides, terminal)?;
            let oracle = pipeline::oracle_of_scene(&run, &observed(terminal).with_bare_mesh(bare.as_ref()))?;
            pipeline::write_depth(output, &oracle.depth, &run, &oracle.facts)?;
            print_written(std::slice::from_ref(output), terminal)
        }
        Command::Compare { results, truth, oracle, resolution, min, max, png } => {
            let compared = Compared { results, truth, oracle: oracle.as_deref(), resolution: *resolution };
            compare(&compared, [min, max], png.as_deref(), terminal)
        }
        Command::Check { runs, overrides, seeds, oracle } => {
            check(runs, overrides, (seeds, *oracle), terminal)
        }
        Command::Reproduce { output } => reproduce::run(output.as_deref(), terminal),
        Command::Report { folder, open } => report(folder, *open, terminal),
        Command::Info { file, health: true, output, .. } => {
            info::health::show(file, output.as_deref(), terminal)
        }
        Command::Info { file, overrides, .. } => {
            let facts = info::of(file, overrides, reading_limit(), terminal)?;
            if terminal.json() { print_json(&facts) } else { print(&summary::facts(&facts)) }
        }
        Command::Init { folder, mesh: Some(mesh), placement } => init_mesh(folder, mesh, placement, terminal),
        Command::Init { folder, placement, .. } => init(folder, placement, terminal),
        Command::Man { folder: None } => print_text(&manual::page()?, terminal),
        Command::Man { folder: Some(folder) } => print_written(&manual::write(folder)?, terminal),
        Command::Help { topic } => guide::help(topic),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(*shell, &mut Cli::command(), "holosonar", &mut script);
            print_text(&String::from_utf8_lossy(&script), terminal)
        }
    }
}

/// Simulates a scene's cube, or the recording of it.
fn simulate(
    input: &Path,
    output: &Path,
    overrides: &Overrides,
    every: Duration,
    terminal: &Terminal,
) -> Result<()> {
    let Input { run, bare } = scene_of(input, overrides, terminal)?;
    announce(output, &SIMULATED)?;
    let checkpoint = Checkpoint::beside(output, every);
    let job = observed(terminal).with_bare_mesh(bare.as_ref()).with_checkpoint(&checkpoint);
    if has_extension(output, &["wav"]) {
        let result = pipeline::record_scene(&run, output, &job);
        let recorded = conclude(checkpoint, result, terminal)?;
        return recording::show(&run, output, recorded, terminal);
    }
    let result = pipeline::simulate_scene(&run, &job)
        .and_then(|cube| stage(terminal, "writing", 0, || pipeline::write_cube(output, &cube)));
    conclude(checkpoint, result, terminal)?;
    print_written(&[output.to_owned()], terminal)
}

/// Makes the page of a folder of results, and opens it on request.
fn report(folder: &Path, open: bool, terminal: &Terminal) -> Result<()> {
    if !folder.is_dir() {
        let problem = "no such folder; one that `holosonar image ... -o` wrote was expected";
        return Err(Error::input(folder.display(), problem));
    }
    let _folder = OutputFolder::open(folder)?;
    let page = stage(terminal, "packing the page", 0, || pipeline::write_page(folder, reading_limit()))?;
    print_written(std::slice::from_ref(&page), terminal)?;
    if open { show(&page) } else { Ok(()) }
}

/// How long the program that opens the page is watched for a failure: failures are immediate, and without one it may run as
/// long as the browser.
const START_TIMEOUT: Duration = Duration::from_secs(2);

/// Opens a page with the system's program for HTML; does not wait for that to end.
fn show(page: &Path) -> Result<()> {
    // A relative path could be mistaken for an option or a URL.
    let page = std::path::absolute(page).unwrap_or_else(|_| page.to_path_buf());
    open::that_detached_with_timeout(&page, START_TIMEOUT).map_err(|error| {
        let why = match error.kind() {
            ErrorKind::NotFound => "no program that opens web pages was found, such as xdg-open".to_owned(),
            _ => format!("the page could not be opened ({error})"),
        };
        Error::io("--open", format!("{why}; open {} in a browser yourself", page.display()))
            .with_source(error)
    })
}

/// Images an input into an existing folder.
fn image(
    input: &Path,
    folder: &Path,
    config: Option<&Path>,
    overrides: &Overrides,
    checkpoint: &Checkpoint,
    terminal: &Terminal,
) -> Result<()> {
    let job = observed(terminal).with_checkpoint(checkpoint);
    let (run, outcome) = match job_of(input, config, overrides, terminal)? {
        JobInput::Cube(cube) => {
            let (run, cube) = *cube;
            pipeline::announce_outputs(&run, folder, false)?;
            let outcome = pipeline::image_cube(&run, cube, &job)?;
            (run, outcome)
        }
        JobInput::Scene(scene) => {
            let Input { run, bare } = *scene;
            pipeline::announce_outputs(&run, folder, pipeline::has_truth(&run))?;
            let outcome = pipeline::image_scene(&run, &job.with_bare_mesh(bare.as_ref()))?;
            (run, outcome)
        }
    };
    let report = pipeline::write_outputs(&run, &outcome, folder, &job)?;
    if terminal.json() {
        return print_json(&report);
    }
    if terminal.is_quiet() { Ok(()) } else { print(&summary::image(input, folder, &report, &outcome)) }
}

/// Deletes the checkpoint of a job that succeeded, or else tells how to resume from it.
fn conclude<T>(checkpoint: Checkpoint, result: Result<T>, terminal: &Terminal) -> Result<T> {
    match result {
        Ok(_) => checkpoint.remove(),
        Err(_) => terminal.advise(checkpoint.how_to_continue()),
    }
    result
}

fn init(folder: &Path, placement: &Placement, terminal: &Terminal) -> Result<()> {
    const NAMES: [&str; 2] = ["corner.toml", "meshes/corner.obj"];
    if let Some(key) = placement.keys()?.first() {
        return Err(Error::input(key, "places a mesh of yours; name it with --mesh"));
    }
    NAMES.iter().try_for_each(|name| refuse_existing(&folder.join(name)))?;
    let (_folder, paths) = open_folder(folder, NAMES)?;
    for (path, text) in paths.iter().zip([ANNOTATED, CORNER_MESH]) {
        write_atomically(path, |file| file.write_all(text.as_bytes()))?;
    }
    conclude_init(&paths, folder, terminal)
}

/// Writes a run file that images a mesh as `image` of the mesh itself would.
fn init_mesh(folder: &Path, mesh: &Path, placement: &Placement, terminal: &Terminal) -> Result<()> {
    let Some(bare) = bare_mesh(mesh, &placement.keys()?, terminal)? else {
        let problem = "is no mesh; .obj, .gltf, .glb, .stl or .ply was expected";
        return Err(Error::input(mesh.display(), problem));
    };
    let path = folder.join(mesh.file_name().unwrap_or_default()).with_extension("toml");
    refuse_existing(&path)?;
    let (_folder, paths) = open_folder(folder, path.file_name())?;
    // Beside the run file by its name, elsewhere by its whole path.
    let [here, there] = [Some(folder), mesh.parent()].map(|folder| {
        let folder = folder.filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        folder.canonicalize().ok()
    });
    let name = if here == there { mesh.file_name().map(PathBuf::from) } else { mesh.canonicalize().ok() };
    let name = name.as_deref().and_then(Path::to_str).ok_or_else(|| {
        Error::input(mesh.display(), "has a name that is not UTF-8, which no run file can hold; rename it")
    })?;
    write_atomically(&paths[0], |file| file.write_all(bare.text(name).as_bytes()))?;
    bare.hints.iter().for_each(|hint| terminal.warn(hint));
    conclude_init(&paths, folder, terminal)
}

fn refuse_existing(path: &Path) -> Result<()> {
    let problem = "already exists and would be overwritten; choose another folder";
    if path.exists() { Err(Error::input(path.display(), problem)) } else { Ok(()) }
}

/// Shows what `init` wrote, and what to do with it.
fn conclude_init(written: &[PathBuf], folder: &Path, terminal: &Terminal) -> Result<()> {
    print_written(written, terminal)?;
    if terminal.json() || terminal.is_quiet() {
        return Ok(());
    }
    let (run, out) = (written[0].display(), folder.join("out"));
    print(&format!("now try: holosonar image {run} -o {}\n", out.display()))
}

/// Prints a text for another program; with `--json`, as a string.
fn print_text(text: &str, terminal: &Terminal) -> Result<()> {
    if terminal.json() { print_json(&serde_json::json!({ "text": text })) } else { print(text) }
}
