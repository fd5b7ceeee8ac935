//! `plan`: what a job will take and show, of one design or of every combination of swept keys.

use super::work;
use crate::acquisition::CubeSource;
use crate::cli::Overrides;
use crate::cli::design::{self, sweep};
use crate::cli::inputs::{ARRAYS, Input, JobInput, has_extension, job_of};
use crate::cli::outputs::{open_folder, print_json};
use crate::cli::terminal::{Terminal, observed, print};
use crate::error::{Error, Result};
use crate::export::figure::write_array_figure;
use crate::pipeline;
use crate::progress::Observer;
use clap::Args;
use std::path::{Path, PathBuf};

/// Predicts resolution, aliasing, memory, time and files of a job, in under a second and before anything runs.
///
/// INPUT is as for `image`. Prints the operations, bytes and seconds of every method, and which one the job uses. With --sweep
/// it does so for many designs, and with --simulate it images the scene with each and compares its depth with the truth.
#[derive(Debug, Args)]
pub(in crate::cli) struct PlanArgs {
    /// Run file, mesh, reflector list or cube.
    input: PathBuf,
    /// Run file for a cube: its [grid], [reconstruct] and [output].
    #[arg(short, long, value_name = "RUN.toml")]
    config: Option<PathBuf>,
    /// Plan every value of a key, as in array.extent=0.5:2:0.25 or array.layout=grid,spiral,random (repeatable).
    #[arg(long, value_name = "KEY=VALUES", conflicts_with = "config")]
    sweep: Vec<String>,
    /// Simulate and image every combination of --sweep, and compare its depth with the truth as `check` does; what is finished
    /// is kept in DIR/combinations, and the same command resumes.
    #[arg(long, requires = "sweep")]
    simulate: bool,
    /// Seeds of [reflectors] to simulate each combination with, as in 1,2,3 [default: those of [expect], or the run file's own].
    #[arg(long, value_name = "N,N,..", value_delimiter = ',', requires = "simulate")]
    seeds: Vec<u32>,
    /// The metric whose error is weighed against the time of the measurement and microphones, named as for `compare --min`; of
    /// shares such as completeness the error is what they lack.
    #[arg(long, value_name = "NAME", default_value = "chamfer_distance", requires = "simulate")]
    measure: String,
    /// Simulate only the K-th of N parts of the combinations, from 1/N to N/N, into DIR, which several processes may share; the
    /// same command without it makes the table.
    #[arg(long, value_name = "K/N", requires_all = ["simulate", "output"])]
    part: Option<String>,
    /// List the units of the work that `work` computes, with their shares of a stage's cost, as JSON.
    #[arg(long, conflicts_with_all = ["sweep", "output"])]
    units: bool,
    /// Folder for sweep.csv, sweep.json and sweep.png, with --simulate also for pareto.png, or without --sweep for array.png, the
    /// array and what it is seen as; created if missing.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    #[command(flatten)]
    overrides: Overrides,
}

/// Runs the command.
pub(super) fn run(args: &PlanArgs, terminal: &Terminal) -> Result<()> {
    let PlanArgs { input, config, output, overrides, .. } = args;
    if args.units {
        return work::list((input, config.as_deref()), overrides, terminal);
    }
    if args.sweep.is_empty() {
        return plan((input, config.as_deref()), output.as_deref(), overrides, terminal);
    }
    if has_extension(input, &ARRAYS) {
        let problem = "is a cube, whose array is fixed; a sweep needs a run file";
        return Err(Error::input(input.display(), problem));
    }
    let wanted = sweep::SweepCommand { input, keys: &args.sweep, folder: output.as_deref(), overrides };
    if !args.simulate {
        return wanted.predict(terminal);
    }
    let measure = pipeline::measure_of("--measure", args.measure.trim())?;
    match &args.part {
        None => wanted.simulate(&args.seeds, &measure, terminal),
        Some(part) => wanted.work(&args.seeds, &measure, work::part_of(part)?, terminal),
    }
}

/// Predicts a job of a cube or of a scene, and draws its array into `folder`, if given.
fn plan(
    (input, config): (&Path, Option<&Path>),
    folder: Option<&Path>,
    overrides: &Overrides,
    terminal: &Terminal,
) -> Result<()> {
    let folder = folder.map(|folder| open_folder(folder, ["array.png"])).transpose()?;
    let (forecast, instrument) = match job_of(input, config, overrides, terminal)? {
        JobInput::Cube(job) => {
            let (run, cube) = *job;
            let instrument = cube.instrument().clone();
            (pipeline::forecast_cube(&run, cube, terminal)?, instrument)
        }
        JobInput::Scene(scene) => {
            let Input { run, bare } = *scene;
            let job = observed(terminal).with_bare_mesh(bare.as_ref());
            (pipeline::forecast_scene(&run, &job)?, run.instrument()?)
        }
    };
    for file in folder.iter().flat_map(|(_, files)| files) {
        write_array_figure(file, &instrument)?;
    }
    for warning in &forecast.warnings {
        terminal.warn(warning);
    }
    if terminal.json() {
        return print_json(&forecast);
    }
    print(&design::forecast_text(&forecast))
}
