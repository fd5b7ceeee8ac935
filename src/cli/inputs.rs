//! What an input is, told by its extension, and the run file that goes with it.

use super::Overrides;
use holosonar::config::{InputFile, RunFile};
use holosonar::error::{Error, Result};
use holosonar::scene::EXTENSIONS;
use std::path::Path;

/// The run file of an input, and whether it is a bare mesh, for which defaults stand in.
pub(super) fn run_of(input: &Path, overrides: &Overrides) -> Result<(RunFile, bool)> {
    if has_extension(input, &["toml"]) {
        return Ok((RunFile::load(input, &overrides.keys())?, false));
    }
    if !has_extension(input, &EXTENSIONS) && !has_extension(input, &["csv"]) {
        return Err(Error::input(
            input.display(),
            "is no input this command takes; a run file (.toml), a mesh (.obj, .gltf, .glb, .stl, .ply) or a list of \
             reflectors (.csv) was expected",
        ));
    }
    let mut run = RunFile::from_str_at("", "command line", Path::new(""), &overrides.keys())?;
    run.scene.mesh = Some(InputFile::new(input));
    Ok((run, true))
}

/// The run file given with `-c`, or the defaults.
pub(super) fn config_of(config: Option<&Path>, settings: &[String]) -> Result<RunFile> {
    match config {
        Some(path) => RunFile::load(path, settings),
        None => RunFile::from_str_at("", "command line", Path::new(""), settings),
    }
}

/// Whether a path ends in one of these.
pub(super) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    extensions.iter().any(|e| extension.eq_ignore_ascii_case(e))
}
