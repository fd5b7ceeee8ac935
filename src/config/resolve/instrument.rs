//! From `[instrument]` to the electronics of a simulation.

use crate::acquisition::Electronics;
use crate::config::RunFile;

impl RunFile {
    /// `[instrument]`, with the times of `[recording]`; `None` where they are ideal.
    pub fn electronics(&self) -> Option<Electronics> {
        let table = &self.instrument;
        let recording = self.recording_options();
        let mut electronics = Electronics::default()
            .with_amplifier_band(table.amplifier_band)
            .with_harmonics_db(table.harmonics_db.clone())
            .with_microphone_band(table.microphone_band)
            .with_mixer(table.mixer)
            .with_quadrature(table.quadrature)
            .with_quadrature_error(table.quadrature_error)
            .with_filter(table.filter)
            .with_dwell(recording.dwell)
            .with_settling(recording.dwell.map_or(0.0, |dwell| recording.settling(dwell)))
            .with_decay(table.decay)
            .with_jitter(table.jitter)
            .with_clock_error(table.clock_error)
            .with_clock_drift(table.clock_drift)
            .with_adc_bits(table.adc_bits)
            .with_adc_full_scale(table.adc_full_scale)
            // A random stream of its own.
            .with_seed(u64::from(table.seed) ^ 0x6a69_7474_6572_0000);
        electronics.low_pass = table.low_pass.unwrap_or(electronics.low_pass);
        (!electronics.elements().is_empty()).then_some(electronics)
    }
}
