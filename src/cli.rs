//! The command line: its commands and options, and how results, warnings and errors are shown.
//!
//! Results go to standard output, everything else to standard error. Only the binary uses this module; the library never
//! prints.

mod commands;
pub(crate) mod design;
mod guide;
mod info;
pub(crate) mod inputs;
mod manual;
mod outputs;
mod placement;
mod reproduce;
mod signals;
mod summary;
mod terminal;
mod threads;
mod verdicts;

use crate::error::Error;
use crate::files::protect_inputs;
use crate::progress::Observer;
use crate::text::quoted;
use crate::wave::simd;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Args, CommandFactory, Parser, Subcommand};
use outputs::CheckpointArgs;
use placement::Placement;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use terminal::Terminal;

/// The version, with the commit of the build.
const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), " (", env!("HOLOSONAR_COMMIT"), ")");

const AFTER_HELP: &str = "\
Exit status: 0 done; 1 I/O or memory error; 2 the request or an input file is wrong; 3 a limit of \
compare or check was missed, or calibrate --blind found nothing to trust; 130 interrupted (Ctrl-C), 143 terminated.

Environment: NO_COLOR, if not empty, disables colours; HOLOSONAR_SIMD=baseline, avx2 or avx512 limits the vector \
instructions of the program's own loops, which changes no byte of a result.";

/// The text at the end of `--help`.
fn after_help() -> String {
    format!("{}\n{AFTER_HELP}", guide::topics())
}

/// Images 3-D scenes with sound: CAD mesh or measured cube in, depth and amplitude EXR out.
#[derive(Debug, Parser)]
#[command(name = "holosonar", version = VERSION, after_help = after_help(), max_term_width = 100)]
#[command(arg_required_else_help = true, propagate_version = false, disable_help_subcommand = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    common: Common,
}

/// The options of every command.
#[derive(Debug, Args, Clone, Default)]
struct Common {
    /// Print results as JSON.
    #[arg(long, global = true)]
    json: bool,
    /// Print no progress, no warnings and no summary.
    #[arg(short, long, global = true)]
    quiet: bool,
    /// Print what each stage did and how long it took.
    #[arg(short, long, global = true, conflicts_with = "quiet")]
    verbose: bool,
    /// Worker threads, at most a few per core; the results do not depend on their number [default: one per core].
    #[arg(short = 'j', long, global = true, value_name = "N")]
    threads: Option<u16>,
    /// Maximum memory, as in 2GiB or 500MB; a job that needs more is refused [default: 80 % of what is free].
    #[arg(long, global = true, value_name = "SIZE")]
    memory: Option<String>,
}

/// How a run file is changed from the command line.
#[derive(Debug, Args, Clone)]
struct Settings {
    /// Set a key of the run file, as in --set sweep.step=20 (repeatable).
    #[arg(long = "set", value_name = "TABLE.KEY=VALUE")]
    set: Vec<String>,
}

/// How a run file with a scene is changed from the command line.
#[derive(Debug, Args, Clone)]
struct Overrides {
    #[command(flatten)]
    placement: Placement,
    #[command(flatten)]
    settings: Settings,
}

impl Overrides {
    /// All overrides as run-file keys.
    fn keys(&self) -> Result<Vec<String>, Error> {
        Ok([self.placement.keys()?, self.settings.set.clone()].concat())
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Images a scene or a measured cube: volume, depth map, pictures and report.
    ///
    /// INPUT is a run file (.toml), a bare mesh (.obj, .gltf, .glb, .stl, .ply), a list of reflectors (.csv) or a cube (.npz,
    /// .zarr).
    Image {
        /// Run file, mesh, reflector list or cube.
        input: PathBuf,
        /// Folder for the results; created if missing.
        #[arg(short, long, value_name = "DIR")]
        output: PathBuf,
        /// Run file for a cube: its [grid], [reconstruct], [depth] and [output].
        #[arg(short, long, value_name = "RUN.toml")]
        config: Option<PathBuf>,
        #[command(flatten)]
        overrides: Overrides,
        #[command(flatten)]
        checkpoint: CheckpointArgs,
    },
    /// Simulates the data cube (.npz or .zarr) of a scene, or the recording (.wav) of its stepped tones.
    Simulate {
        /// Run file, mesh or reflector list.
        input: PathBuf,
        /// The cube to write, .npz or .zarr; .wav for what an audio interface would record, as [recording] says.
        #[arg(short, long, value_name = "CUBE")]
        output: PathBuf,
        #[command(flatten)]
        overrides: Overrides,
        #[command(flatten)]
        checkpoint: CheckpointArgs,
    },
    Work(commands::WorkArgs),
    Import(commands::ImportArgs),
    Calibrate(commands::CalibrateArgs),
    Autofocus(commands::AutofocusArgs),
    Ascan(commands::AscanArgs),
    /// Reconstructs a data cube into a volume (.npz, .zarr, .exr, .vti, .nrrd or .vdb, by extension).
    Reconstruct {
        /// The cube.
        cube: PathBuf,
        /// Run file, of which [grid], [reconstruct] and [output] are used.
        #[arg(short, long, value_name = "RUN.toml")]
        config: Option<PathBuf>,
        /// The volume to write (repeatable).
        #[arg(short, long, value_name = "VOLUME", required = true)]
        output: Vec<PathBuf>,
        #[command(flatten)]
        settings: Settings,
        #[command(flatten)]
        checkpoint: CheckpointArgs,
    },
    /// Locates depth in a volume (.npz or .zarr): depth map (.exr) or point cloud (.ply).
    Depth {
        /// The volume.
        volume: PathBuf,
        /// Run file, of which [depth] is used, and [sweep] if the volume does not contain its bandwidth.
        #[arg(short, long, value_name = "RUN.toml")]
        config: Option<PathBuf>,
        /// The depth map to write; .ply for a point cloud with normals.
        #[arg(short, long, value_name = "DEPTH.exr")]
        output: PathBuf,
        #[command(flatten)]
        settings: Settings,
    },
    /// Ray-casts the ground truth of a scene on the pixels of its depth map.
    Truth {
        /// Run file or mesh.
        input: PathBuf,
        /// The truth to write: a depth map (.exr), points (.ply), or a picture of the scene before the array (.png).
        #[arg(short, long, value_name = "TRUTH.exr")]
        output: PathBuf,
        #[command(flatten)]
        overrides: Overrides,
    },
    /// Images a scene as its array's aperture would at best, without speckle and grating lobes, for `compare --oracle`.
    Oracle {
        /// Run file or mesh.
        input: PathBuf,
        /// The depth map to write.
        #[arg(short, long, value_name = "ORACLE.exr")]
        output: PathBuf,
        #[command(flatten)]
        overrides: Overrides,
    },
    Plan(commands::PlanArgs),
    /// Shows the image of a point: widths, sidelobes and grating lobes, measured on a simulated reflector and predicted.
    ///
    /// INPUT is a run file, a bare mesh or a list of reflectors; only the size of its scene is used, for the grid.
    Psf {
        /// Run file, mesh or reflector list.
        input: PathBuf,
        /// Position of the point in m (repeatable) [default: the middle of the grid's nearest, middle and farthest depth].
        #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
        at: Vec<String>,
        /// Folder for psf.png and psf.json; created if missing.
        #[arg(short, long, value_name = "DIR")]
        output: Option<PathBuf>,
        #[command(flatten)]
        overrides: Overrides,
    },
    /// Scores depth maps against a truth.
    Compare {
        /// Depth map: from holosonar, or any EXR with a Z channel; of several, with other seeds, the means count.
        #[arg(required = true, value_name = "RESULT")]
        results: Vec<PathBuf>,
        /// Truth.
        truth: PathBuf,
        /// Depth map of `holosonar oracle`, for a column of what is possible.
        #[arg(long, value_name = "ORACLE.exr")]
        oracle: Option<PathBuf>,
        /// Range resolution c/2B in m, if neither file contains it.
        #[arg(long, value_name = "M")]
        resolution: Option<f64>,
        /// Minimum of a metric, as in completeness=0.65; of a material completeness:glass=0.8, of each pixel's
        /// second surface completeness#2=0.8 (repeatable).
        #[arg(long, value_name = "NAME=VALUE")]
        min: Vec<String>,
        /// Maximum of a metric, as in median_error=0.01, named as for --min (repeatable).
        #[arg(long, value_name = "NAME=VALUE")]
        max: Vec<String>,
        /// Draw the error, found minus true depth, into this file.
        #[arg(long, value_name = "ERROR.png")]
        png: Option<PathBuf>,
    },
    /// Runs scenes and checks each against its [expect]: one line per scene, exit status 3 if one fails.
    Check {
        /// Run files.
        #[arg(required = true)]
        runs: Vec<PathBuf>,
        /// Seeds of [reflectors] to run each scene with, as in 1,2,3; the mean must keep the limits [default: those
        /// of [expect], or the scene's own].
        #[arg(long, value_name = "N,N,..", value_delimiter = ',')]
        seeds: Vec<u32>,
        /// Also show what the array's aperture could do at best: without speckle and grating lobes (16 more images).
        #[arg(long)]
        oracle: bool,
        #[command(flatten)]
        overrides: Overrides,
    },
    /// Recomputes the paper's Table I, its timings and Figures 3 to 7, and compares them with the printed ones.
    Reproduce {
        /// Folder for the figures and for the numbers as JSON; if left out, nothing is written.
        #[arg(short, long, value_name = "DIR")]
        output: Option<PathBuf>,
    },
    /// Makes the page report.html of a folder that `image` wrote: volume, slices, depth and numbers.
    Report {
        /// The folder of results.
        folder: PathBuf,
        /// Show it in the browser.
        #[arg(long)]
        open: bool,
    },
    /// Shows the content of a cube, volume, depth map, recording, point cloud, mesh or run file.
    Info {
        /// The file.
        file: PathBuf,
        /// Examine a cube's samples: dead, loud and missing channels, noise, echoes, and the sign of the phase.
        #[arg(long)]
        health: bool,
        /// Folder for health.png and health.json; created if missing.
        #[arg(short, long, value_name = "DIR", requires = "health")]
        output: Option<PathBuf>,
        #[command(flatten)]
        overrides: Overrides,
    },
    /// Writes an annotated run file and the corner mesh, as a starting point; or a run file for a mesh of yours.
    Init {
        /// Folder; created if missing.
        #[arg(default_value = ".")]
        folder: PathBuf,
        /// Write NAME.toml for this mesh instead, placed as `image` would.
        #[arg(long, value_name = "MESH")]
        mesh: Option<PathBuf>,
        #[command(flatten)]
        placement: Placement,
    },
    /// Prints the manual page, or writes one for every command and chapter of the guide into a folder.
    Man {
        /// Folder for the pages, of sections 1 and 7; created if missing.
        folder: Option<PathBuf>,
    },
    /// Prints the help of a command or a chapter of the guide.
    Help {
        /// A command; a topic of the guide; or `topics`, for a list of them [default: the help of the program].
        topic: Vec<String>,
    },
    /// Prints a completion script for a shell.
    Completions {
        /// The shell.
        shell: clap_complete::Shell,
    },
}

/// Parses the command line of the process, runs the command and prints its result; returns the exit status.
pub fn main() -> ExitCode {
    ExitCode::from(run_command(&std::env::args_os().collect::<Vec<_>>()))
}

/// The same for arguments of which the first is the name of the program.
pub(crate) fn run_command(typed: &[OsString]) -> u8 {
    threads::with_stack(|| run(typed))
}

fn run(typed: &[OsString]) -> u8 {
    signals::expect_aborts();
    let cli = match Cli::try_parse_from(typed) {
        Ok(cli) => cli,
        Err(error) => return show(&explain(error), typed),
    };
    terminal::explain_panics();
    protect_inputs();
    let terminal = Terminal::new(cli.common.clone());
    if let Command::Help { topic } = &cli.command {
        // The guide is shown even if threads, memory or settings are at fault.
        return finish(guide::help(topic), &terminal);
    }
    let result = threads::start(cli.common.threads, &terminal)
        .and_then(|()| inputs::check_addresses())
        .and_then(|()| inputs::limit_memory(cli.common.memory.as_deref()))
        .and_then(|()| threads::limit_simd())
        .inspect(|()| {
            let (threads, level) = (rayon::current_num_threads(), simd::level());
            terminal.note(&format!("{threads} threads, {level} loops"));
        })
        .and_then(|()| commands::run(&cli, &terminal));
    finish(result, &terminal)
}

/// Prints what clap has to say, help or a mistake in the command line, and returns the exit status.
fn show(message: &clap::Error, typed: &[OsString]) -> u8 {
    let printed = terminal::print_help(message, typed);
    if message.use_stderr() || printed.is_ok() {
        // If standard error is closed, nothing can be reported.
        return u8::try_from(message.exit_code()).unwrap_or(2);
    }
    finish(printed, &Terminal::new(Common::default()))
}

/// Prints the error, if there is one, and returns the exit status.
fn finish(result: Result<(), Error>, terminal: &Terminal) -> u8 {
    match result {
        Ok(()) => 0,
        Err(error) => {
            terminal.error(&error);
            let signal = terminal.signalled().filter(|_| error == Error::Interrupted);
            signal.unwrap_or(error.exit_status())
        }
    }
}

/// Names the command for a file that was typed without one.
fn explain(error: clap::Error) -> clap::Error {
    match error.get(ContextKind::InvalidSubcommand) {
        Some(ContextValue::String(name)) if Path::new(name).is_file() => Cli::command().error(
            ErrorKind::InvalidSubcommand,
            format!(
                "'{}' is a file, but a command was expected; to image it: holosonar image {0} -o DIR",
                quoted(name)
            ),
        ),
        _ => error,
    }
}
