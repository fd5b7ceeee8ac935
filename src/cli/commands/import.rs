//! `import`: from a laboratory's files to a cube.

use crate::acquisition::import;
use crate::cli::Settings;
use crate::cli::inputs::{ARRAYS, has_extension, measured_run_of};
use crate::cli::outputs::{announce, print_json, print_written};
use crate::cli::summary;
use crate::cli::terminal::{Terminal, print};
use crate::error::Result;
use crate::pipeline;
use crate::progress::{Observer, stage};
use clap::Args;
use std::path::PathBuf;

/// Makes a data cube (.npz or .zarr) of a laboratory's files: NumPy arrays, Touchstone, CSV, recordings (WAV).
///
/// Prints what was found in them and what was guessed. See `holosonar help measured`.
#[derive(Debug, Args)]
pub(in crate::cli) struct ImportArgs {
    /// Run file with [import]; or the samples themselves: .npy, .npz, .wav, .sNp, .csv, or a pattern of names, scan/x{x}_y{y}.s2p.
    input: PathBuf,
    /// The cube to write.
    #[arg(short, long, value_name = "CUBE.npz")]
    output: PathBuf,
    #[command(flatten)]
    settings: Settings,
}

/// Imports the files of a run file, or a file itself.
pub(super) fn run(args: &ImportArgs, terminal: &Terminal) -> Result<()> {
    let ImportArgs { input, output, settings } = args;
    announce(output, &ARRAYS)?;
    let (run, typed) = measured_run_of(input, &settings.set, has_extension(input, &["toml"]))?;
    let options = run.import_options(&typed)?;
    let imported = stage(terminal, "reading", 0, || import(&options))?;
    stage(terminal, "writing", 0, || pipeline::write_cube(output, &imported.cube))?;
    imported.warnings.iter().for_each(|warning| terminal.warn(warning));
    let mut facts = imported.facts();
    if terminal.json() {
        facts["cube"] = output.display().to_string().into();
        return print_json(&facts);
    }
    if let Some(facts) = facts.as_object_mut() {
        facts.remove("guesses");
        // A number per frequency is for machines.
        facts.remove("snr_db_of_tones");
    }
    if !terminal.is_quiet() {
        print(&(summary::facts(&facts) + &summary::guesses(&imported.guesses)))?;
    }
    print_written(std::slice::from_ref(output), terminal)
}
