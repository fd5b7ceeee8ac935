//! `[import]`.

use crate::acquisition::{RawOffset, check_columns, check_formula};
use crate::config::range::{Check, ensure, file_name, finite};
use crate::config::reader::Fault;
use crate::config::{ImportTable, TypedFormulas, TypedPositions};

impl ImportTable {
    pub(super) fn check(&self) -> Check {
        self.samples.iter().try_for_each(|file| file_name("import.samples", Some(file)))?;
        file_name("import.frequencies", self.frequencies.as_ref())?;
        match &self.positions {
            Some(TypedPositions::File(file)) => file_name("import.positions", Some(file))?,
            Some(TypedPositions::Formulas(TypedFormulas { x, y, z })) => {
                for (key, formula) in [("x", x), ("y", y), ("z", z)] {
                    let at = format!("import.positions.{key}");
                    check_formula(formula)
                        .map_err(|problem| Fault::new(&at, format!("the formula of {key} {problem}")))?;
                }
            }
            None => {}
        }
        file_name("import.sources", self.sources.as_ref())?;
        match self.offset {
            Some(RawOffset::Both(offset)) => finite("import.offset", &[offset])?,
            Some(RawOffset::Planes(planes)) => finite("import.offset", &planes)?,
            Some(RawOffset::Mean(_)) | None => {}
        }
        ensure(self.arrays.len() <= 2, || {
            Fault::new("import.arrays", "found more than two; expected one, or two for I and Q")
        })?;
        ensure(self.phase_sign.is_none_or(|sign| sign.abs() == 1), || {
            Fault::new("import.phase_sign", "expected 1, or -1 if phases fall with the path")
        })?;
        if self.columns.is_empty() {
            return Ok(());
        }
        check_columns(&self.columns).map_err(|problem| Fault::new("import.columns", problem))
    }
}
