//! The run file: takes TOML text and `--set` overrides, gives a checked [`RunFile`] with every default filled in.
//!
//! Everything that can be judged from the text alone (names, types, ranges, keys that contradict each other) is checked
//! here, and errors name the line at fault. `resolve` turns the keys into the parameters of the stages, which do not see
//! the run file: only the pipeline and the command line use this module.
//!
//! # Example
//! ```
//! use holosonar::config::RunFile;
//! use std::path::Path;
//!
//! let text = "[scene]\nmesh = \"part.glb\"\n[sweep]\nstep = 40.0\n";
//! let run = RunFile::from_str_at(text, "part.toml", Path::new("scenes"), &["sweep.stop=15000".to_owned()])?;
//! assert_eq!((run.sweep.start, run.sweep.stop, run.sweep.step), (10_000.0, 15_000.0, 40.0));
//! let refusal = RunFile::from_str_at("[sweep]\nsteps = 40.0\n", "part.toml", Path::new(""), &[]).unwrap_err();
//! assert!(refusal.to_string().starts_with("part.toml:2:1") && refusal.to_string().contains("`step`"));
//! # Ok::<(), holosonar::error::Error>(())
//! ```

mod check;
mod choices;
mod fill;
mod measured;
mod mesh_run;
mod range;
mod reader;
mod resolve;
mod source;
mod tables;
#[cfg(test)]
mod tests;
mod wording;

pub use choices::{ArrayLayout, InputFile, RefineMethod, Shading, SurfaceKind, VolumeFormat};
pub use source::TypedKeys;
pub use tables::{
    ArrayTable, CalibrationTable, CodingTable, DepthTable, DetectionTable, ExpectTable, GridTable,
    ImportTable, InstrumentTable, Limit, MediumTable, OutputTable, ReconstructTable, RecordingTable,
    ReferenceChannel, RefineTable, ReflectorsTable, ScenePart, SceneTable, SweepTable, TypedFormulas,
    TypedPositions,
};

pub(crate) use mesh_run::MeshRun;

use crate::error::{Error, Result};
use crate::files::open_input;
use crate::scene::MaterialRule;
use crate::text::quoted;
use reader::{Fault, ValueDeserializer};
use serde::{Deserialize, Serialize};
use source::ParsedRunFile;
use std::io::Read;
use std::path::Path;

/// The annotated run file that `holosonar init` writes: it images `meshes/corner.obj` in the same folder.
pub const ANNOTATED: &str = include_str!("config/annotated.toml");

/// Maximum size of a run file, bytes; real ones have a few thousand.
const MAX_BYTES: u64 = 1 << 20;

/// The content of a run file, one field per table.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RunFile {
    /// What is imaged.
    pub scene: SceneTable,
    /// Materials by name; the first rule that matches wins.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub materials: Vec<MaterialRule>,
    /// How surfaces become reflectors.
    pub reflectors: ReflectorsTable,
    /// The medium of propagation.
    pub medium: MediumTable,
    /// The frequencies.
    pub sweep: SweepTable,
    /// Speaker and microphones.
    pub array: ArrayTable,
    /// How several speakers that sound at once are told apart.
    #[serde(skip_serializing_if = "CodingTable::is_default")]
    pub coding: CodingTable,
    /// What is measured, and how accurately.
    pub detection: DetectionTable,
    /// Measured files to be imported.
    #[serde(skip_serializing_if = "ImportTable::is_default")]
    pub import: ImportTable,
    /// How recordings are made.
    #[serde(skip_serializing_if = "RecordingTable::is_default")]
    pub recording: RecordingTable,
    /// What the electronics of a simulation do.
    #[serde(skip_serializing_if = "InstrumentTable::is_default")]
    pub instrument: InstrumentTable,
    /// How a measured cube is corrected.
    #[serde(skip_serializing_if = "CalibrationTable::is_default")]
    pub calibration: CalibrationTable,
    /// The voxels.
    pub grid: GridTable,
    /// How the volume is computed.
    pub reconstruct: ReconstructTable,
    /// Whether and how the volume is refined.
    pub refine: RefineTable,
    /// How returns are found in the volume.
    pub depth: DepthTable,
    /// Which files are written.
    pub output: OutputTable,
    /// The limits that the metrics must keep.
    pub expect: ExpectTable,
    /// Maximum memory of a job, bytes; `None`: 80 % of what is free. Not a key of the file, since it depends on the computer
    /// and changes no result.
    #[serde(skip)]
    pub memory: Option<u64>,
}

impl RunFile {
    /// Reads the run file at `path`, then applies `overrides`, each `table.key=value`, in order.
    ///
    /// The value of an override is TOML; a bare word is text. Files that it names are relative to the run file. Overriding one of two keys that exclude each other (`scene.translate` and
    /// `scene.fit`, `array.pitch` and `array.extent`, `medium.sound_speed` and `medium.temperature`) removes the other.
    ///
    /// # Errors
    /// A file that cannot be read or is not UTF-8, and the errors of [`RunFile::from_str_at`].
    pub fn load(path: &Path, overrides: &[String]) -> Result<Self> {
        Self::load_with_keys(path, overrides).map(|(run, _)| run)
    }

    /// As [`RunFile::load`], and which keys were typed.
    ///
    /// # Errors
    /// As [`RunFile::load`].
    pub fn load_with_keys(path: &Path, overrides: &[String]) -> Result<(Self, TypedKeys)> {
        let reading = |error| Error::reading(path, error);
        let place = path.display().to_string();
        let mut bytes = Vec::new();
        open_input(path)?.take(MAX_BYTES + 1).read_to_end(&mut bytes).map_err(reading)?;
        if bytes.len() as u64 > MAX_BYTES {
            return Err(Error::input(place, "is larger than 1 MiB; a run file is a few kilobytes of TOML"));
        }
        let text = String::from_utf8(bytes).map_err(|error| {
            let byte = error.utf8_error().valid_up_to();
            Error::input(&place, format!("is not UTF-8 text (see byte {byte}); a run file is TOML in UTF-8"))
        })?;
        Self::read_at(&text, &place, path.parent().unwrap_or(Path::new("")), overrides)
    }

    /// Reads a run file's text; `place` names it in messages, and files it names are relative to `folder`.
    ///
    /// # Errors
    /// Text that is not TOML; unknown tables, keys and words; values of the wrong type or outside their range;
    /// keys that contradict each other. The message names line, column and key, or the `--set` at fault.
    pub fn from_str_at(text: &str, place: &str, folder: &Path, overrides: &[String]) -> Result<Self> {
        Self::read_at(text, place, folder, overrides).map(|(run, _)| run)
    }

    /// The run file of overrides alone, whose files are relative to the working folder, and which keys were typed.
    ///
    /// # Errors
    /// As [`RunFile::from_str_at`].
    pub fn of_overrides(overrides: &[String]) -> Result<(Self, TypedKeys)> {
        Self::read_at("", "command line", Path::new(""), overrides)
    }

    /// As [`RunFile::from_str_at`], and which keys were typed.
    pub(crate) fn read_at(
        text: &str,
        place: &str,
        folder: &Path,
        overrides: &[String],
    ) -> Result<(Self, TypedKeys)> {
        let mut parsed = ParsedRunFile::parse(place, text)?;
        overrides.iter().try_for_each(|typed| parsed.set(typed))?;
        let mut run = Self::read(&parsed.values).map_err(|fault| parsed.error(fault))?;
        let files = run
            .scene
            .files_mut()
            .chain(run.array.file.as_mut())
            .chain(run.array.source_file.as_mut())
            .chain(run.import.files_mut());
        for file in files.chain(run.recording.files_mut()).chain(run.calibration.files_mut()) {
            file.locate(folder);
        }
        Ok((run, parsed.typed()))
    }

    /// The values, filled and checked.
    fn read(values: &toml::Value) -> std::result::Result<Self, Fault> {
        let mut run = Self::deserialize(ValueDeserializer::root(values))?;
        run.fill()?;
        run.check_all()?;
        Ok(run)
    }

    /// Checks a run file that was built in memory, as [`RunFile::load`] checks one from a file.
    ///
    /// # Errors
    /// Values outside their range and keys that contradict each other; the message names the key.
    pub fn check(&self) -> Result<()> {
        self.check_all()
            .map_err(|fault| Error::input(format!("run file, key `{}`", quoted(&fault.path)), fault.problem))
    }

    /// The resolved run file as JSON, every default filled; keys without a value are `null`.
    ///
    /// # Panics
    /// Never: every value has a JSON form (a number that is not finite becomes `null`).
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::to_value(self).expect("tables of numbers, words and lists have a JSON form")
    }

    /// The resolved run file as TOML, every default filled. Read in the same folder, it gives an equal [`RunFile`].
    ///
    /// # Panics
    /// Never: every value has a TOML form.
    pub fn to_toml(&self) -> String {
        // By way of a table: every serializer is compiled for every table of the run file.
        let table = toml::Table::try_from(self).and_then(|table| toml::to_string(&table));
        table.expect("tables of numbers, words and lists have a TOML form")
    }
}
