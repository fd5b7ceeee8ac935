//! Inputs of commands: their kind, by extension, and their run file.

use super::Overrides;
use crate::acquisition::{CubeFile, CubeSource};
use crate::config::{InputFile, RunFile, TypedKeys};
use crate::error::{Error, Result, gib};
use crate::files::extension;
use crate::pipeline::BareMesh;
use crate::plan::{address_space, memory_limit};
use crate::progress::Observer;
use crate::scene::{EXTENSIONS, why_no_mesh};
use crate::text::quoted;
use std::path::Path;
use std::sync::OnceLock;

/// The extensions of cubes and volumes that commands read.
pub(super) const ARRAYS: [&str; 2] = ["npz", "zarr"];

/// The run file of an input, and the mesh if the input is one without a run file.
pub(super) struct Input {
    pub(super) run: RunFile,
    pub(super) bare: Option<BareMesh>,
}

/// The run file of an input: its own, or the one that suits a mesh.
pub(super) fn run_of(input: &Path, overrides: &Overrides, observer: &dyn Observer) -> Result<Input> {
    let keys = overrides.keys()?;
    let bare = bare_mesh(input, &keys, observer)?;
    let run = match &bare {
        Some(bare) => bare.run.clone(),
        None => run_file_of(input, &keys)?,
    };
    Ok(Input { run, bare })
}

/// The mesh, if the input is one.
pub(crate) fn bare_mesh(
    input: &Path,
    overrides: &[String],
    observer: &dyn Observer,
) -> Result<Option<BareMesh>> {
    if !has_extension(input, &EXTENSIONS) {
        return Ok(None);
    }
    BareMesh::load(input, overrides, MEMORY.get().copied(), observer).map(Some)
}

/// The run file of an input that is no mesh.
pub(crate) fn run_file_of(input: &Path, overrides: &[String]) -> Result<RunFile> {
    if has_extension(input, &["toml"]) {
        return RunFile::load(input, overrides).map(with_memory_limit);
    }
    if !has_extension(input, &["csv"]) {
        let what = if input.is_dir() {
            "is a folder"
        } else if has_extension(input, &["wav"]) {
            "is a recording, of which `holosonar import` makes a cube"
        } else {
            why_no_mesh(&extension(input)).unwrap_or("is not an input of this command")
        };
        return Err(Error::input(
            input.display(),
            format!(
                "{what}; a run file (.toml), a mesh (.obj, .gltf, .glb, .stl, .ply) or a list of reflectors (.csv) was \
                 expected"
            ),
        ));
    }
    let (mut run, _) = RunFile::of_overrides(overrides)?;
    run.scene.mesh = Some(InputFile::new(input));
    Ok(with_memory_limit(run))
}

/// As [`run_of`], for an input that needs a scene: a missing scene is an error.
pub(super) fn scene_of(input: &Path, overrides: &Overrides, observer: &dyn Observer) -> Result<Input> {
    let found = run_of(input, overrides, observer)?;
    let table = if found.run.scene.parts.is_empty() { "[scene]" } else { "[[scene.parts]]" };
    let place = || format!("{}: {table} mesh", input.display());
    if found.run.scene.files().next().is_none() {
        return Err(Error::input(
            place(),
            "is missing; name a mesh (.obj, .gltf, .glb, .stl, .ply) or a list of reflectors (.csv)",
        ));
    }
    if let Some(mesh) = found.run.scene.files().find(|mesh| !mesh.path.exists())
        && has_extension(input, &["toml"])
    {
        let problem = "no such file; a path is relative to the run file's folder, unless it is absolute";
        return Err(Error::input(place(), format!("{}: {problem}", mesh.path.display())));
    }
    Ok(found)
}

/// The run file of an import: its own, or the one of a file of samples; and which keys were typed.
pub(super) fn measured_run_of(
    input: &Path,
    settings: &[String],
    is_run_file: bool,
) -> Result<(RunFile, TypedKeys)> {
    if is_run_file {
        return RunFile::load_with_keys(input, settings).map(|(run, typed)| (with_memory_limit(run), typed));
    }
    let (mut run, typed) = RunFile::of_overrides(settings)?;
    if !run.import.samples.is_empty() {
        let problem = "names the samples a second time; leave it out, or give a run file";
        return Err(Error::input("--set import.samples", problem));
    }
    run.import.samples = vec![InputFile::new(input)];
    Ok((with_memory_limit(run), typed))
}

/// What is imaged.
pub(super) enum JobInput {
    /// A cube, and its run file.
    Cube(Box<(RunFile, CubeFile)>),
    /// A scene.
    Scene(Box<Input>),
}

/// The scene or the cube that an input is; only a cube takes a run file by `-c`.
pub(super) fn job_of(
    input: &Path,
    config: Option<&Path>,
    overrides: &Overrides,
    observer: &dyn Observer,
) -> Result<JobInput> {
    if has_extension(input, &ARRAYS) {
        let cube = cube_of(input, config, &overrides.keys()?, observer)?;
        return Ok(JobInput::Cube(Box::new(cube)));
    }
    if config.is_some() {
        let problem = "is only for a cube (.npz or .zarr); the run file of a scene is the input itself";
        return Err(Error::input("--config", problem));
    }
    Ok(JobInput::Scene(Box::new(scene_of(input, overrides, observer)?)))
}

/// Refuses an input, by its extension, that the command does not read.
pub(super) fn check_kind(input: &Path, what: &str, maker: &str) -> Result<()> {
    if has_extension(input, &ARRAYS) || !input.exists() {
        return Ok(());
    }
    Err(Error::input(
        input.display(),
        format!(
            "was expected to be {what} (.npz or .zarr), as `holosonar {maker}` writes it; give run files with -c"
        ),
    ))
}

/// A cube, and its run file given with `-c`; overrides of its instrument are applied.
pub(super) fn cube_of(
    cube: &Path,
    config: Option<&Path>,
    settings: &[String],
    observer: &dyn Observer,
) -> Result<(RunFile, CubeFile)> {
    let (run, typed) = match config {
        Some(path) => RunFile::load_with_keys(path, settings),
        None => RunFile::of_overrides(settings),
    }?;
    let cube = opened_cube(cube, (&run, &typed), observer)?;
    Ok((with_memory_limit(run), cube))
}

/// A cube, of which a run file's overrides change the instrument.
pub(crate) fn opened_cube(
    cube: &Path,
    (run, typed): (&RunFile, &TypedKeys),
    observer: &dyn Observer,
) -> Result<CubeFile> {
    let cube = CubeFile::open(cube, reading_limit())?;
    let cube = cube.changed(&run.overridden_instrument(typed)?)?;
    // A simulated cube remembers the run file that it was made with, which may place its array by other means.
    let made_with = |run: &RunFile| cube.provenance()["run"]["array"] == run.to_json()["array"];
    let mut written = run.written_instrument(typed);
    if made_with(run) {
        (written.source, written.centre) = (None, None);
    }
    if let Ok((_, differences)) = cube.instrument().changed(&written) {
        for difference in differences {
            observer.warn(&format!(
                "the run file says {difference}; the cube's own is used, unless --set replaces it"
            ));
        }
    }
    cube.questions().iter().for_each(|question| observer.warn(question));
    Ok(cube)
}

/// The run file given with `-c`, or the defaults.
pub(super) fn config_of(config: Option<&Path>, settings: &[String]) -> Result<RunFile> {
    let run = match config {
        Some(path) => RunFile::load(path, settings),
        None => RunFile::of_overrides(settings).map(|(run, _)| run),
    };
    run.map(with_memory_limit)
}

/// A run file with the memory limit of the command line.
fn with_memory_limit(run: RunFile) -> RunFile {
    RunFile { memory: MEMORY.get().copied(), ..run }
}

/// Whether a path has one of these extensions.
pub(super) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    extensions.contains(&extension(path).as_str())
}

/// A size as people type it: `500MB`, `2GiB`, `2G`, or plain bytes.
pub(crate) fn bytes(option: &str, typed: &str) -> Result<u64> {
    let problem =
        format!("`{}` was expected to be a size, as in 2GiB, 500MB or 1000000000 (bytes)", quoted(typed));
    let refusal = Error::input(option, problem);
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
        _ => return Err(refusal),
    };
    let bytes = number.parse::<f64>().map_or(f64::NAN, |number| number * factor);
    if (1.0..1e18).contains(&bytes) { Ok(bytes as u64) } else { Err(refusal) }
}

/// The value of `--memory`, bytes; the library receives it with every run file.
static MEMORY: OnceLock<u64> = OnceLock::new();

/// Stores the value of `--memory`, if there is one.
pub(super) fn limit_memory(size: Option<&str>) -> Result<()> {
    if let Some(size) = size {
        let _ = MEMORY.set(bytes("--memory", size)?);
    }
    Ok(())
}

/// Addresses that any job takes besides its arrays: tables of libraries, stacks and heaps of threads.
const AT_WORK: u64 = 48 << 20;

/// Refuses to begin where `ulimit -v` leaves too little for any job; to be called once the threads run.
pub(super) fn check_addresses() -> Result<()> {
    match address_space() {
        Some(left) if left < AT_WORK => Err(Error::io(
            "memory",
            format!(
                "{} of this process's address space are left, and any job takes {}; raise `ulimit -v`, or run fewer threads \
                 with -j",
                gib(left),
                gib(AT_WORK)
            ),
        )),
        _ => Ok(()),
    }
}

/// Maximum bytes of any single array of an input.
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
