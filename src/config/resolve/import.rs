//! From `[import]`, and from what was typed of the measurement's tables, to an import.

use crate::acquisition::{FrequencyUnit, ImportOptions, PositionFormulas};
use crate::config::{ArrayLayout, InputFile, RunFile, TypedFormulas, TypedKeys, TypedPositions};
use crate::error::{Error, Result};
use crate::files::extension;
use crate::plan::memory_limit;
use glam::DVec3;
use std::path::PathBuf;

/// A file's path, or the name of an array as it was typed.
fn file_or_array(typed: &InputFile) -> PathBuf {
    let is_file = ["npy", "csv", "txt", "xml"].contains(&extension(&typed.path).as_str());
    if is_file { typed.path.clone() } else { PathBuf::from(&typed.typed) }
}

impl RunFile {
    /// Formulas of as many microphones as `[array] count` has.
    fn position_formulas(&self, typed: &TypedFormulas, keys: &TypedKeys) -> Result<PositionFormulas> {
        let both = ["pitch", "extent", "centre", "file"].map(|key| format!("array.{key}"));
        if let Some(both) = both.iter().find(|key| keys.contains(key)) {
            let problem = format!("and {both} both say where microphones are; keep one of them");
            return Err(Error::input("[import] positions", problem));
        }
        let Some(count) = self.array.count.filter(|_| keys.contains("array.count")) else {
            let problem = "are formulas, and nothing says of how many microphones; give count = [columns, rows] in [array]";
            return Err(Error::input("[import] positions", problem));
        };
        let TypedFormulas { x, y, z } = typed.clone();
        Ok(PositionFormulas { count: count.map(|n| n as usize), formulas: [x, y, z] })
    }

    /// `[import]`, and `[sweep]`, `[array]`, `[detection]` and `[medium]` as far as they were typed: defaults describe no
    /// measurement.
    ///
    /// # Errors
    /// As [`RunFile::sweep`] and [`RunFile::microphones`].
    pub fn import_options(&self, typed: &TypedKeys) -> Result<ImportOptions> {
        let table = &self.import;
        let any = |keys: &[&str]| keys.iter().any(|key| typed.contains(key));
        let all = |keys: &[&str]| keys.iter().all(|key| typed.contains(key));
        let mut options = ImportOptions::new(table.samples.iter().map(|file| file.path.clone()).collect());
        options.arrays.clone_from(&table.arrays);
        options.axes.clone_from(&table.axes);
        options.columns.clone_from(&table.columns);
        options.parameter.clone_from(&table.parameter);
        (options.offset, options.phase_sign) = (table.offset, table.phase_sign);
        options.frequency_unit = table.frequency_unit.unwrap_or(FrequencyUnit::Hertz);
        options.frequencies = table.frequencies.as_ref().map(file_or_array);
        match &table.positions {
            Some(TypedPositions::File(file)) => options.positions = Some(file_or_array(file)),
            Some(TypedPositions::Formulas(formulas)) => {
                options.formulas = Some(self.position_formulas(formulas, typed)?);
            }
            None => {}
        }
        options.name_unit = table.name_unit;
        if all(&["sweep.start", "sweep.stop", "sweep.step"]) {
            options.sweep = Some(self.sweep()?);
        }
        let sized = options.formulas.is_none()
            && any(&["array.count", "array.elements"])
            && any(&["array.pitch", "array.extent"]);
        if sized || self.array.layout == ArrayLayout::File {
            options.array = Some(self.microphones()?);
        }
        options.centre = typed.contains("array.centre").then(|| DVec3::from_array(self.array.centre));
        options.geometry = any(&["array.geometry", "array.source"]).then(|| self.geometry());
        let of_pairs = self.array.source_file.as_ref();
        options.source_file = table.sources.as_ref().or(of_pairs).map(file_or_array);
        let sources = self.array.sources.iter().flatten();
        options.sources = sources.map(|source| DVec3::from_array(*source)).collect();
        if options.source_file.is_some() {
            let both = ["array.source", "array.sources"].into_iter().find(|key| typed.contains(key));
            if let Some(both) = both {
                let problem = format!("and {both} both say where speakers are; keep one of them");
                return Err(Error::input("[import] sources", problem));
            }
        }
        options.detection = typed.contains("detection.kind").then_some(self.detection.kind);
        let speed = any(&["medium.sound_speed", "medium.temperature"]);
        options.sound_speed = speed.then(|| self.medium.speed());
        options.interface = self.medium.interface;
        options.recording = self.recording_options();
        options.memory = memory_limit(self.memory);
        Ok(options)
    }
}
