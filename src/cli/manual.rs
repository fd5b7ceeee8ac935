//! The manual pages, generated from the text of `--help`.

use super::outputs::open_folder;
use super::{Cli, guide};
use crate::error::{Error, Result};
use crate::files::write_atomically;
use clap::CommandFactory;
use clap_mangen::Man;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The page of the program itself, in roff.
pub(super) fn page() -> Result<String> {
    text(&Man::new(complete()))
}

/// Writes the page of the program, one for every command and one for every chapter of the guide; returns their paths.
pub(super) fn write(folder: &Path) -> Result<Vec<PathBuf>> {
    let program = complete();
    let commands = program.get_subcommands().filter(|command| !command.is_hide_set()).cloned();
    let mut pages = Vec::new();
    for command in std::iter::once(program.clone()).chain(commands) {
        let man = Man::new(command);
        pages.push((man.get_filename(), text(&man)?));
    }
    pages.extend(guide::pages());
    let (_folder, paths) = open_folder(folder, pages.iter().map(|(name, _)| name))?;
    for (path, (_, text)) in paths.iter().zip(&pages) {
        write_atomically(path, |file| file.write_all(text.as_bytes()))?;
    }
    Ok(paths)
}

/// The command line with complete names, such as `holosonar-image`.
fn complete() -> clap::Command {
    let mut program = Cli::command();
    program.build();
    program
}

fn text(man: &Man) -> Result<String> {
    let mut text = Vec::new();
    man.render(&mut text).map_err(|error| Error::io("man", error.to_string()).with_source(error))?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}
