//! `[recording]`.

use crate::acquisition::Latency;
use crate::config::range::{Check, ensure, file_name, not_negative, within};
use crate::config::reader::Fault;
use crate::config::{RecordingTable, ReferenceChannel};

impl RecordingTable {
    pub(super) fn check(&self) -> Check {
        within("recording.start", self.start, 0.0, 1e6, "a time in s, 0 or more")?;
        for (key, seconds) in [("recording.dwell", self.dwell), ("recording.response", self.response)] {
            seconds.map_or(Ok(()), |seconds| within(key, seconds, 1e-6, 1e4, "a time in s, as 0.05"))?;
        }
        self.settling.map_or(Ok(()), |settling| not_negative("recording.settling", settling))?;
        if let (Some(settling), Some(dwell)) = (self.settling, self.dwell) {
            ensure(settling < dwell, || {
                let problem = format!(
                    "drops {settling:?} s of tones that last {dwell:?} s; expected less, so that something is left"
                );
                Fault::new("recording.settling", problem).or_at(&["recording.dwell"])
            })?;
        }
        if let Some(ReferenceChannel::File(file)) = &self.reference {
            file_name("recording.reference", Some(file))?;
        }
        let mut sorted = self.microphones.clone();
        sorted.sort_unstable();
        ensure(sorted.windows(2).all(|pair| pair[0] != pair[1]), || {
            Fault::new("recording.microphones", "names a channel twice; expected one for each microphone")
        })?;
        let gain = self.gain_db.unwrap_or(0.0);
        within("recording.gain_db", gain, -200.0, 200.0, "a gain from -200 to 200 dB")?;
        if let Latency::Seconds(seconds) = self.latency {
            within("recording.latency", seconds, -1e3, 1e3, "a time in s, or \"direct\"")?;
        }
        let rate = f64::from(self.sample_rate);
        within("recording.sample_rate", rate, 1.0, 1e8, "samples per second, as 48000")?;
        within("recording.decay", self.decay, 0.0, 1e3, "a time in s, 0 or more")
    }
}
