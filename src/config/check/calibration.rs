//! `[calibration]`.

use crate::acquisition::check_columns;
use crate::config::CalibrationTable;
use crate::config::range::{Check, ensure, file_name, finite, positive};
use crate::config::reader::Fault;

impl CalibrationTable {
    pub(super) fn check(&self) -> Check {
        file_name("calibration.background", self.background.as_ref())?;
        file_name("calibration.response", self.response.as_ref())?;
        self.high_pass.iter().try_for_each(|diameter| positive("calibration.high_pass", *diameter))?;
        finite("calibration.delay", &[self.delay])?;
        finite("calibration.tilt", &self.tilt)?;
        if let Some([from, to]) = self.gate {
            finite("calibration.gate", &[from, to])?;
            ensure(from < to, || {
                Fault::new(
                    "calibration.gate",
                    format!("found [{from}, {to}]; expected the shorter path first"),
                )
            })?;
        }
        ensure(self.phase_sign.is_none_or(|sign| sign.abs() == 1), || {
            Fault::new("calibration.phase_sign", "expected 1, or -1 if phases fall with the path")
        })?;
        if self.columns.is_empty() {
            return Ok(());
        }
        check_columns(&self.columns).map_err(|problem| Fault::new("calibration.columns", problem))
    }
}
