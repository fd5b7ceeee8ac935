//! The run file: takes TOML text and `--set` overrides, gives what was typed, checked by itself, with every
//! default filled in.
//!
//! Nothing here knows what the stages want; turning a [`RunFile`] into their parameters comes later. What can
//! be judged from the text alone (names, types, ranges, keys that contradict each other) is judged here, with
//! the line at fault, so that no later message has to send a user back to it. Only the pipeline and the binary
//! see this module.
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
mod range;
mod reader;
mod resolve;
mod source;
mod tables;
#[cfg(test)]
mod tests;
mod wording;

pub use choices::{InputFile, Layout, Shading, Surface, VolumeFormat};
pub use tables::{
    ArrayTable, DepthTable, DetectionTable, ExpectTable, GridTable, Limit, MediumTable, OutputTable,
    ReconstructTable, ReflectorsTable, SceneTable, SweepTable,
};

#[cfg(feature = "cli")]
pub(crate) use wording::nearest;

use crate::error::{Error, Result};
use crate::scene::MaterialRule;
use reader::{Fault, Reader};
use serde::{Deserialize, Serialize};
use source::Source;
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// The annotated run file that `holosonar init` writes: it images `meshes/corner.obj` beside it.
pub const ANNOTATED: &str = include_str!("config/annotated.toml");

/// Bytes beyond which a file is taken for something else; run files have a few thousand.
const LARGEST: u64 = 1 << 20;

/// Everything a run file says, one field per table.
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
    /// What sound travels through.
    pub medium: MediumTable,
    /// The frequencies.
    pub sweep: SweepTable,
    /// Speaker and microphones.
    pub array: ArrayTable,
    /// What is measured.
    pub detection: DetectionTable,
    /// The voxels.
    pub grid: GridTable,
    /// How the volume is computed.
    pub reconstruct: ReconstructTable,
    /// How returns are found in it.
    pub depth: DepthTable,
    /// Which files are written.
    pub output: OutputTable,
    /// What the result is held to.
    pub expect: ExpectTable,
    /// Most bytes that a job of it may use; `None`: 80 % of what is free. No key of the file, since it is a matter of the
    /// computer and changes no result.
    #[serde(skip)]
    pub memory: Option<u64>,
}

impl RunFile {
    /// Reads the run file at `path`, then applies `overrides`, each `table.key=value`, in order.
    ///
    /// The value of an override is TOML; a bare word is text. Files it names are, like the run file's own,
    /// relative to the run file. Overriding one of two keys that exclude each other (`scene.translate` and
    /// `scene.fit`, `array.pitch` and `array.extent`, `medium.sound_speed` and `medium.temperature`) withdraws the other.
    ///
    /// # Errors
    /// A file that cannot be read or is no UTF-8, and everything [`RunFile::from_str_at`] refuses.
    pub fn load(path: &Path, overrides: &[String]) -> Result<Self> {
        let reading = |error| Error::reading(path, error);
        let place = path.display().to_string();
        let mut bytes = Vec::new();
        File::open(path).map_err(reading)?.take(LARGEST + 1).read_to_end(&mut bytes).map_err(reading)?;
        if bytes.len() as u64 > LARGEST {
            return Err(Error::input(place, "is larger than 1 MiB; a run file is a few kilobytes of TOML"));
        }
        let text = String::from_utf8(bytes).map_err(|error| {
            let byte = error.utf8_error().valid_up_to();
            Error::input(&place, format!("is not UTF-8 text (see byte {byte}); a run file is TOML in UTF-8"))
        })?;
        Self::from_str_at(&text, &place, path.parent().unwrap_or(Path::new("")), overrides)
    }

    /// Reads a run file's text; `place` names it in messages, and files it names are relative to `folder`.
    ///
    /// # Errors
    /// Text that is no TOML; unknown tables, keys and words; values of the wrong type or outside their range;
    /// keys that contradict each other. The message gives line, column and key, or the `--set` at fault.
    pub fn from_str_at(text: &str, place: &str, folder: &Path, overrides: &[String]) -> Result<Self> {
        let mut source = Source::parse(place, text)?;
        for typed in overrides {
            source.set(typed)?;
        }
        Self::read(&source).map_err(|fault| source.error(fault)).map(|mut run| {
            for file in [&mut run.scene.mesh, &mut run.array.file].into_iter().flatten() {
                file.locate(folder);
            }
            run
        })
    }

    /// The typed values, filled and checked.
    fn read(source: &Source) -> std::result::Result<Self, Fault> {
        let mut run = Self::deserialize(Reader::whole(&source.values))?;
        run.fill()?;
        run.check_all()?;
        Ok(run)
    }

    /// Checks a run file that was put together in memory as [`RunFile::load`] checks one that was typed.
    ///
    /// # Errors
    /// Values outside their range and keys that contradict each other; the message names the key.
    pub fn check(&self) -> Result<()> {
        self.check_all()
            .map_err(|fault| Error::input(format!("run file, key `{}`", fault.path), fault.problem))
    }

    /// The resolved run file as JSON, every default filled; what was left out is `null`.
    ///
    /// # Panics
    /// Never: every value has a JSON form (a number that is not finite becomes `null`).
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::to_value(self).expect("tables of numbers, words and lists have a JSON form")
    }

    /// The resolved run file as TOML, every default filled. Read at the same folder, it gives an equal
    /// [`RunFile`].
    ///
    /// # Panics
    /// Never: every value has a TOML form.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("tables of numbers, words and lists have a TOML form")
    }
}
