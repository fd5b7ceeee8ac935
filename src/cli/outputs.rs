//! The output files of commands, and results as JSON.

use super::inputs::has_extension;
use super::terminal::{Terminal, print, print_as_it_is};
use crate::error::{Error, Result};
use crate::files::{OutputFolder, announce_output, write_atomically};
use crate::text::{escaped_json, one_line};
use clap::Args;
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How often a long job stores its finished blocks.
#[derive(Debug, Args, Clone)]
pub(super) struct CheckpointArgs {
    /// Store finished blocks at this interval, so that the same command resumes an interrupted run; 0: after every block.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0)]
    checkpoint_every: f64,
}

impl CheckpointArgs {
    pub(super) fn every(&self) -> Result<Duration> {
        let problem = "was expected to be a number of seconds, 0 or more; 5 is usual";
        Duration::try_from_secs_f64(self.checkpoint_every)
            .map_err(|_| Error::input("--checkpoint-every", problem))
    }
}

/// Announces an output file, whose extension must be one of these, before any work is done for it.
pub(super) fn announce(path: &Path, extensions: &[&str]) -> Result<()> {
    if has_extension(path, extensions) {
        return announce_output(path);
    }
    let known = extensions.iter().map(|e| format!(".{e}")).collect::<Vec<_>>().join(", ");
    Err(Error::input(
        path.display(),
        format!("the extension decides the format; this command writes {known}"),
    ))
}

/// Opens the folder of a command that writes files of these names there, before the long work; returns it and their paths.
pub(super) fn open_folder<S: AsRef<Path>>(
    folder: &Path,
    names: impl IntoIterator<Item = S>,
) -> Result<(OutputFolder, Vec<PathBuf>)> {
    let opened = OutputFolder::open(folder)?;
    let paths: Vec<PathBuf> = names.into_iter().map(|name| folder.join(name)).collect();
    paths.iter().try_for_each(|path| announce_output(path))?;
    Ok((opened, paths))
}

/// Prints the names of the files that a command wrote.
pub(super) fn print_written(files: &[PathBuf], terminal: &Terminal) -> Result<()> {
    if terminal.json() {
        return print_json(&serde_json::json!({ "files": files }));
    }
    if terminal.is_quiet() {
        return Ok(());
    }
    let lines: Vec<String> =
        files.iter().map(|path| format!("wrote {}\n", one_line(&path.display().to_string()))).collect();
    print(&lines.concat())
}

/// Prints a result as JSON.
pub(super) fn print_json(value: &impl Serialize) -> Result<()> {
    print_as_it_is(&escaped_json(&json_text(value)?))
}

/// Writes a result as a JSON file.
pub(super) fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let text = json_text(value)?;
    write_atomically(path, |file| file.write_all(text.as_bytes()))
}

fn json_text(value: &impl Serialize) -> Result<String> {
    let text = serde_json::to_string_pretty(value);
    text.map(|text| text + "\n").map_err(|e| Error::io("JSON", e.to_string()).with_source(e))
}
