//! `[instrument]`, with the times of `[recording]` that it needs.

use crate::acquisition::{MOST_HARMONICS, OutputFilter};
use crate::config::RunFile;
use crate::config::range::{Check, conflict, ensure, within};
use crate::config::reader::Fault;

impl RunFile {
    pub(super) fn check_instrument(&self) -> Check {
        let table = &self.instrument;
        for (key, band) in [
            ("instrument.amplifier_band", table.amplifier_band),
            ("instrument.microphone_band", table.microphone_band),
        ] {
            let Some([low, high]) = band else { continue };
            within(key, low, 0.0, 1e12, "[lower, upper] corner in Hz, as [100.0, 20000.0]")?;
            within(key, high, 1e-3, 1e12, "[lower, upper] corner in Hz, as [100.0, 20000.0]")?;
            ensure(low < high, || {
                Fault::new(
                    key,
                    format!("the lower corner, {low:?} Hz, is not below the upper one, {high:?} Hz"),
                )
            })?;
        }
        ensure(table.harmonics_db.len() <= MOST_HARMONICS, || {
            let problem =
                format!("has {} levels; expected {MOST_HARMONICS} at most", table.harmonics_db.len());
            Fault::new("instrument.harmonics_db", problem)
        })?;
        for level in &table.harmonics_db {
            within(
                "instrument.harmonics_db",
                *level,
                -300.0,
                0.0,
                "levels from -300 to 0 dB, as [-60.0, -40.0]",
            )?;
        }
        within("instrument.quadrature_error", table.quadrature_error, -90.0, 90.0, "from -90 to 90 degrees")?;
        if let Some(corner) = table.low_pass {
            within("instrument.low_pass", corner, 1e-6, 1e12, "a corner in Hz, as 10")?;
        }
        let is_low_pass = table.filter == OutputFilter::LowPass;
        ensure(is_low_pass || table.low_pass.is_none(), || {
            let why = "a corner belongs to `filter = \"low-pass\"`";
            conflict("instrument.low_pass", &["instrument.filter"], why)
        })?;
        within("instrument.decay", table.decay, 0.0, 1e3, "a time in s, 0 or more")?;
        within("instrument.jitter", table.jitter, 0.0, 1.0, "a time in s, as 1e-7")?;
        within("instrument.clock_error", table.clock_error, -1e5, 1e5, "parts per million, as 20")?;
        within("instrument.clock_drift", table.clock_drift, -1e5, 1e5, "parts per million per s, as 0.5")?;
        if let Some(bits) = table.adc_bits {
            within("instrument.adc_bits", bits.into(), 1.0, 24.0, "from 1 to 24 bits")?;
        }
        if let Some(full) = table.adc_full_scale {
            within("instrument.adc_full_scale", full, 1e-30, 1e30, "an amplitude, greater than 0")?;
        }
        ensure(table.decay == 0.0 || table.filter != OutputFilter::Ideal, || {
            let problem = "needs `filter = \"integration\"` or \"low-pass\": over a time without end everything settles";
            Fault::new("instrument.decay", problem)
        })?;
        for (key, needs) in [
            ("instrument.filter", table.filter != OutputFilter::Ideal),
            ("instrument.clock_drift", table.clock_drift != 0.0),
        ] {
            ensure(!needs || self.recording.dwell.is_some(), || {
                let problem =
                    "needs to know how long each tone sounds: give `dwell` in [recording], in s, as 0.05";
                Fault::new(key, problem)
            })?;
        }
        Ok(())
    }
}
