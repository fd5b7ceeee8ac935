//! `work`, and the list of `plan --units`: the work of an image, a cube or a volume shared by several processes.

use crate::checkpoint::Checkpoint;
use crate::cli::Overrides;
use crate::cli::commands::{RECONSTRUCTED, SIMULATED};
use crate::cli::inputs::{JobInput, has_extension, job_of};
use crate::cli::outputs::{announce, print_json};
use crate::cli::terminal::{Terminal, observed, print};
use crate::error::{Error, Result};
use crate::files::OutputFolder;
use crate::pipeline::{self, Wanted, WorkDone};
use crate::text::quoted;
use clap::{ArgGroup, Args};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Computes a part of the work of `image`, `simulate` or `reconstruct`, which takes it up: on several hosts, as tasks of a
/// cluster, or one by one.
///
/// INPUT, -o and everything that changes the run file are those of that command: of `image` if -o is a folder, of `simulate`
/// if it is a file and INPUT a scene, of `reconstruct` if INPUT is a cube. Of an image first the cube is simulated, then depths
/// are reconstructed from all of it: if units of the simulation are missing that others compute, run the same command again
/// when they are done. `--units 0` alone before all others does what all of them need. `plan --units` lists the units; see `holosonar help interruption`.
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("share").required(true)))]
pub(in crate::cli) struct WorkArgs {
    /// Run file, mesh, reflector list or cube.
    input: PathBuf,
    /// Folder of the image, or file of the cube or volume (of several volumes the first), where all processes can reach it;
    /// a missing folder is created.
    #[arg(short, long, value_name = "OUTPUT")]
    output: PathBuf,
    /// Run file for a cube: its [grid], [reconstruct], [depth] and [output].
    #[arg(short, long, value_name = "RUN.toml")]
    config: Option<PathBuf>,
    /// The K-th of N parts of the units, from 1/N to N/N, as in 3/8.
    #[arg(long, value_name = "K/N", group = "share")]
    part: Option<String>,
    /// Units by number, as in 0-15 or 7.
    #[arg(long, value_name = "A-B", group = "share")]
    units: Option<String>,
    #[command(flatten)]
    overrides: Overrides,
}

impl WorkArgs {
    fn wanted(&self) -> Result<Wanted> {
        let typed = self.units.as_deref().or(self.part.as_deref()).unwrap_or_default();
        if self.units.is_some() {
            let one = || typed.trim().parse::<u64>().ok().map(|unit| (unit, unit));
            let (first, last) = pair(typed, '-').or_else(one).ok_or_else(|| {
                Error::input("--units", format!("\"{typed}\" was expected to be as 0-15 or 7"))
            })?;
            return Ok(Wanted::Numbers(first..last.saturating_add(1)));
        }
        part_of(typed).map(|(part, of)| Wanted::Part { part, of })
    }
}

/// Two numbers with a sign between them.
fn pair(typed: &str, sign: char) -> Option<(u64, u64)> {
    let (a, b) = typed.split_once(sign)?;
    Some((a.trim().parse().ok()?, b.trim().parse().ok()?))
}

/// A part as typed: K/N.
pub(super) fn part_of(typed: &str) -> Result<(u64, u64)> {
    pair(typed, '/').filter(|(part, of)| (1..=*of).contains(part)).ok_or_else(|| {
        let problem = format!("\"{}\" was expected to be K/N with K from 1 to N, as 3/8", quoted(typed));
        Error::input("--part", problem)
    })
}

/// The commands whose work is shared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sharing {
    Image,
    Simulate,
    Reconstruct,
}

impl Sharing {
    /// What an output is of, by its extension.
    fn of(output: &Path, input: &JobInput) -> Self {
        let is_file = has_extension(output, &SIMULATED) || has_extension(output, &RECONSTRUCTED);
        match (is_file, input) {
            (false, _) => Self::Image,
            (true, JobInput::Scene(_)) => Self::Simulate,
            (true, JobInput::Cube(_)) => Self::Reconstruct,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Image => "image",
            Self::Simulate => "simulate",
            Self::Reconstruct => "reconstruct",
        }
    }
}

/// Computes units.
pub(super) fn run(args: &WorkArgs, terminal: &Terminal) -> Result<()> {
    let WorkArgs { input, output, config, overrides, .. } = args;
    let wanted = args.wanted()?;
    let input = job_of(input, config.as_deref(), overrides, terminal)?;
    let sharing = Sharing::of(output, &input);
    // The command announces as much.
    match sharing {
        Sharing::Image => {}
        Sharing::Simulate => announce(output, &SIMULATED)?,
        Sharing::Reconstruct => announce(output, &RECONSTRUCTED)?,
    }
    let is_image = sharing == Sharing::Image;
    let folder = if is_image { output } else { output.parent().unwrap_or(output) };
    let _folder = OutputFolder::shared(folder)?;
    let beside = if is_image { Checkpoint::within } else { Checkpoint::beside };
    let checkpoint = beside(output, Duration::ZERO);
    let job = observed(terminal).with_checkpoint(&checkpoint);
    let done = match input {
        JobInput::Cube(cube) => {
            let (run, cube) = *cube;
            if is_image {
                pipeline::work_on_cube(&run, cube, &wanted, &job)?
            } else {
                pipeline::work_on_reconstruction(&run, cube, output, &wanted, &job)?
            }
        }
        JobInput::Scene(scene) => {
            let job = job.with_bare_mesh(scene.bare.as_ref());
            if is_image {
                pipeline::work_on_scene(&scene.run, &wanted, &job)?
            } else {
                pipeline::work_on_simulation(&scene.run, output, &wanted, &job)?
            }
        }
    };
    if terminal.json() {
        return print_json(&done);
    }
    if terminal.is_quiet() { Ok(()) } else { print(&text(&done, sharing)) }
}

fn text(done: &WorkDone, sharing: Sharing) -> String {
    let WorkDone { units, computed, found, simulation_left, shards_left, left, .. } = done;
    let found = if *found > 0 { format!(", {found} were there") } else { String::new() };
    let next = match (simulation_left, left) {
        (_, 0) => format!("all are there: `{}` of the same job takes them up", sharing.name()),
        (0, left) if *left == shards_left.len() as u64 => {
            format!("{left} are left, shards of the store, which `{}` encodes, too", sharing.name())
        }
        (0, left) => format!("{left} are left, all of them of the reconstruction"),
        (_, left) if sharing == Sharing::Simulate => format!("{left} are left"),
        (simulation, left) => {
            format!("{left} are left, {simulation} of them of the simulation, which comes first")
        }
    };
    format!("computed {} of {units} units{found}; {next}\n", computed.len())
}

/// Lists the units of a job.
pub(super) fn list(
    (input, config): (&Path, Option<&Path>),
    overrides: &Overrides,
    terminal: &Terminal,
) -> Result<()> {
    let units = match job_of(input, config, overrides, terminal)? {
        JobInput::Cube(cube) => pipeline::units_of_cube(&cube.0, &cube.1)?,
        JobInput::Scene(scene) => {
            let job = observed(terminal).with_bare_mesh(scene.bare.as_ref());
            pipeline::units_of_scene(&scene.run, &job)?
        }
    };
    print_json(&units)
}
