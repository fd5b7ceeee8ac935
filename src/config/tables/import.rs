//! `[import]`: how a laboratory's files are read.

use crate::acquisition::{ArrayName, FrequencyUnit, ImportAxis, RawOffset, TraceColumn};
use crate::config::choices::InputFile;
use crate::scene::Unit;
use serde::de::value::SeqAccessDeserializer;
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt;

/// `[import]`: measured files, and what they do not say; frequencies, positions and the rest come from the other tables.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImportTable {
    /// One file or several: `.npy`, `.npz`; of one position each `.sNp`, `.csv`, also as a pattern of their names.
    #[serde(deserialize_with = "one_or_more")]
    pub samples: Vec<InputFile>,
    /// The array of the samples, by name or number; two are I and Q. Left out: the only ones.
    pub arrays: Vec<ArrayName>,
    /// What each axis is. Left out: the only order that suits the lengths.
    pub axes: Vec<ImportAxis>,
    /// Subtracted from raw numbers: a number, `[I, Q]`, or `"mean"`.
    pub offset: Option<RawOffset>,
    /// Name of an array in the npz, or a `.npy` or `.csv` file. Left out: those of the files, or `[sweep]`.
    pub frequencies: Option<InputFile>,
    /// Unit of these, and of those in CSV files; left out: Hz.
    pub frequency_unit: Option<FrequencyUnit>,
    /// Name of an array in the npz, or a `.npy` file, or formulas of x, y and z. Left out: names of files, or `[array]`.
    pub positions: Option<TypedPositions>,
    /// Name of an array in the npz, or a `.npy` or `.csv` file, of speakers that sounded one after another. Left out:
    /// `[array] sources` or `source`.
    pub sources: Option<InputFile>,
    /// Unit of the numbers in names of files.
    pub name_unit: Option<Unit>,
    /// The parameter of Touchstone files; left out: S11 of one port, S21 of two.
    pub parameter: Option<String>,
    /// The columns of CSV files; left out: their header.
    pub columns: Vec<TraceColumn>,
    /// -1 if phases fall with the path; left out: -1 of Touchstone files, else 1.
    pub phase_sign: Option<i32>,
}

impl ImportTable {
    /// Whether nothing of it was typed.
    pub(in crate::config) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// The files that it names, and the names of arrays, which are not files.
    pub(in crate::config) fn files_mut(&mut self) -> impl Iterator<Item = &mut InputFile> {
        let others = [&mut self.frequencies, &mut self.sources];
        let positions = self.positions.as_mut().and_then(|typed| match typed {
            TypedPositions::File(file) => Some(file),
            TypedPositions::Formulas(_) => None,
        });
        self.samples.iter_mut().chain(others.into_iter().filter_map(Option::as_mut)).chain(positions)
    }
}

/// Where positions come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a file, the name of an array, or formulas, as { x = \"0.003 * ix\", y = \"0.003 * iy\" }"
)]
pub enum TypedPositions {
    /// A file or the name of an array.
    File(InputFile),
    /// Formulas, of the indices that `[array] count` counts.
    Formulas(TypedFormulas),
}

/// Formulas of the positions, m.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TypedFormulas {
    /// To the right.
    pub x: String,
    /// Down.
    pub y: String,
    /// Into the scene.
    #[serde(default = "in_plane")]
    pub z: String,
}

fn in_plane() -> String {
    "0".to_owned()
}

/// Reads a list of files, or one.
fn one_or_more<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<InputFile>, D::Error> {
    struct Files;

    impl<'de> Visitor<'de> for Files {
        type Value = Vec<InputFile>;

        fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
            f.write_str("a file, or a list of files")
        }

        fn visit_str<E: Error>(self, file: &str) -> Result<Self::Value, E> {
            Ok(vec![InputFile::from(file.to_owned())])
        }

        fn visit_seq<A: SeqAccess<'de>>(self, list: A) -> Result<Self::Value, A::Error> {
            Vec::deserialize(SeqAccessDeserializer::new(list))
        }
    }

    deserializer.deserialize_any(Files)
}
