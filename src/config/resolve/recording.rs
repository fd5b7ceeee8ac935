//! From `[recording]` to recordings that are read and written.

use crate::acquisition::{RecorderOptions, RecordingOptions, Reference};
use crate::config::{ReferenceChannel, RunFile};

impl RunFile {
    /// What `[recording]` says of a recording.
    pub fn recording_options(&self) -> RecordingOptions {
        let table = &self.recording;
        let mut options = RecordingOptions::default();
        (options.signal, options.start, options.dwell) = (table.signal, table.start, table.dwell);
        (options.settling, options.latency, options.response) =
            (table.settling, table.latency, table.response);
        options.microphones.clone_from(&table.microphones);
        options.gain_db = table.gain_db.unwrap_or(0.0);
        options.reference = table.reference.as_ref().map(|reference| match reference {
            ReferenceChannel::Channel(channel) => Reference::Channel(*channel as usize),
            ReferenceChannel::File(file) => Reference::File(file.path.clone()),
        });
        options
    }

    /// What `[recording]` and `[detection] snr_db` say of a recorder that is simulated.
    pub fn recorder_options(&self) -> RecorderOptions {
        let table = &self.recording;
        let mut options = RecorderOptions::default();
        (options.sample_rate, options.format, options.decay) = (table.sample_rate, table.format, table.decay);
        (options.gain_db, options.noise) = (table.gain_db, self.simulate_options().noise);
        options.electronics = self.electronics();
        options
    }
}
