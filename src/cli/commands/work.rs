//! `work`, and the list of `plan --units`: an image's work shared by several processes.

use crate::checkpoint::Checkpoint;
use crate::cli::Overrides;
use crate::cli::inputs::{JobInput, job_of};
use crate::cli::outputs::print_json;
use crate::cli::terminal::{Terminal, observed, print};
use crate::error::{Error, Result};
use crate::files::OutputFolder;
use crate::pipeline::{self, Wanted, WorkDone};
use crate::text::quoted;
use clap::{ArgGroup, Args};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Computes a part of an image's work, for `image` to take up: on several hosts, as tasks of a cluster, or one by one.
///
/// INPUT, DIR and everything that changes the run file are those of `image`. First the cube is simulated, then depths are
/// reconstructed from all of it: if units of the simulation are missing that others compute, run the same command again
/// when they are done. `plan --units` lists the units; see `holosonar help interruption`.
#[derive(Debug, Args)]
#[command(group(ArgGroup::new("share").required(true)))]
pub(in crate::cli) struct WorkArgs {
    /// Run file, mesh, reflector list or cube.
    input: PathBuf,
    /// Folder of the image, which all processes can reach; created if missing.
    #[arg(short, long, value_name = "DIR")]
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

/// Computes units.
pub(super) fn run(args: &WorkArgs, terminal: &Terminal) -> Result<()> {
    let WorkArgs { input, output, config, overrides, .. } = args;
    let wanted = args.wanted()?;
    let _folder = OutputFolder::shared(output)?;
    let checkpoint = Checkpoint::within(output, Duration::ZERO);
    let job = observed(terminal).with_checkpoint(&checkpoint);
    let done = match job_of(input, config.as_deref(), overrides, terminal)? {
        JobInput::Cube(cube) => {
            let (run, cube) = *cube;
            pipeline::work_on_cube(&run, cube, &wanted, &job)?
        }
        JobInput::Scene(scene) => {
            pipeline::work_on_scene(&scene.run, &wanted, &job.with_bare_mesh(scene.bare.as_ref()))?
        }
    };
    if terminal.json() {
        return print_json(&done);
    }
    if terminal.is_quiet() { Ok(()) } else { print(&text(&done)) }
}

fn text(done: &WorkDone) -> String {
    let WorkDone { units, computed, found, simulation_left, left, .. } = done;
    let found = if *found > 0 { format!(", {found} were there") } else { String::new() };
    let next = match (simulation_left, left) {
        (_, 0) => "all are there: `image` of the same job takes them up".to_owned(),
        (0, left) => format!("{left} are left, all of them depths"),
        (simulation, left) => {
            format!("{left} are left, {simulation} of them of the simulation, which comes before the depths")
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
