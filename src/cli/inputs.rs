//! What an input is, told by its extension, and the run file that goes with it.

use super::Overrides;
use crate::config::{InputFile, RunFile};
use crate::error::{Error, Result};
use crate::files::extension;
use crate::plan::memory_limit;
use crate::scene::EXTENSIONS;
use std::path::Path;
use std::sync::OnceLock;

/// The run file of an input, and whether it is a bare mesh, for which defaults stand in.
pub(super) fn run_of(input: &Path, overrides: &Overrides) -> Result<(RunFile, bool)> {
    if has_extension(input, &["toml"]) {
        return Ok((limited(RunFile::load(input, &overrides.keys())?), false));
    }
    if !has_extension(input, &EXTENSIONS) && !has_extension(input, &["csv"]) {
        let what = if input.is_dir() {
            "is a folder"
        } else if has_extension(input, &["step", "stp", "iges", "igs", "brep", "3mf", "fbx", "dae", "blend"])
        {
            "is of a format that is not read; export it as one that is"
        } else {
            "is no input this command takes"
        };
        return Err(Error::input(
            input.display(),
            format!(
                "{what}; a run file (.toml), a mesh (.obj, .gltf, .glb, .stl, .ply) or a list of reflectors (.csv) was \
                 expected"
            ),
        ));
    }
    let mut run = RunFile::from_str_at("", "command line", Path::new(""), &overrides.keys())?;
    run.scene.mesh = Some(InputFile::new(input));
    Ok((limited(run), true))
}

/// As [`run_of`], where a scene is needed: says which run file lacks it, or names one that is not there.
pub(super) fn scene_of(input: &Path, overrides: &Overrides) -> Result<(RunFile, bool)> {
    let (run, bare) = run_of(input, overrides)?;
    let place = || format!("{}: [scene] mesh", input.display());
    match &run.scene.mesh {
        None => Err(Error::input(
            place(),
            "is missing; name a mesh (.obj, .gltf, .glb, .stl, .ply) or a list of reflectors (.csv)",
        )),
        Some(mesh) if !bare && !mesh.path.exists() => Err(Error::input(
            place(),
            format!(
                "{}: no such file; a path is taken from the run file's folder, unless it is absolute",
                mesh.path.display()
            ),
        )),
        Some(_) => Ok((run, bare)),
    }
}

/// Refuses an input of another kind than the command reads, by its extension.
pub(super) fn check_kind(input: &Path, what: &str, maker: &str) -> Result<()> {
    if has_extension(input, &["npz"]) || !input.exists() {
        return Ok(());
    }
    Err(Error::input(
        input.display(),
        format!("was expected to be {what} (.npz), as `holosonar {maker}` writes it; run files go with -c"),
    ))
}

/// The run file given with `-c`, or the defaults.
pub(super) fn config_of(config: Option<&Path>, settings: &[String]) -> Result<RunFile> {
    let run = match config {
        Some(path) => RunFile::load(path, settings),
        None => RunFile::from_str_at("", "command line", Path::new(""), settings),
    };
    run.map(limited)
}

/// A run file with the limit of memory that was typed.
fn limited(run: RunFile) -> RunFile {
    RunFile { memory: MEMORY.get().copied(), ..run }
}

/// Whether a path ends in one of these.
pub(super) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    extensions.contains(&extension(path).as_str())
}

/// A size as people type it: `500MB`, `2GiB`, `2G`, or plain bytes.
pub(super) fn bytes(option: &str, typed: &str) -> Result<u64> {
    let refuse = || {
        Error::input(
            option,
            format!("`{typed}` was expected to be a size, as in 2GiB, 500MB or 1000000000 (bytes)"),
        )
    };
    let typed = typed.trim();
    let digits = typed.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(typed.len());
    let (number, unit) = typed.split_at(digits);
    let factor = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "tb" => 1e12,
        "k" | "kib" => 1024.0,
        "m" | "mib" => 1024.0 * 1024.0,
        "g" | "gib" => 1024.0 * 1024.0 * 1024.0,
        "t" | "tib" => 1024.0 * 1024.0 * 1024.0 * 1024.0,
        _ => return Err(refuse()),
    };
    let bytes = number.parse::<f64>().map_err(|_| refuse())? * factor;
    if (1.0..1e18).contains(&bytes) { Ok(bytes as u64) } else { Err(refuse()) }
}

/// What was typed after `--memory`, bytes; the library takes it as an argument, with every run file.
static MEMORY: OnceLock<u64> = OnceLock::new();

/// Notes what was typed after `--memory`, if it was.
pub(super) fn limit_memory(size: Option<&str>) -> Result<()> {
    if let Some(size) = size {
        let _ = MEMORY.set(bytes("--memory", size)?);
    }
    Ok(())
}

/// Bytes that any one array of an input may take.
pub(super) fn reading_limit() -> u64 {
    memory_limit(MEMORY.get().copied()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::bytes;

    #[test]
    fn sizes_are_read_as_people_type_them() {
        for (typed, expected) in
            [("1000", 1000), ("2GiB", 2 << 30), ("1.5 MB", 1_500_000), ("3g", 3 << 30), ("64kib", 65_536)]
        {
            assert_eq!(bytes("--memory", typed).expect("a size"), expected, "{typed}");
        }
        for typed in ["", "G", "-1", "1.2.3MB", "5 apples", "0", "1e30TB", "999999999TB"] {
            assert!(bytes("--memory", typed).is_err(), "{typed}");
        }
    }
}
