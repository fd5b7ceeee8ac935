//! `[recording]`: time signals, as `simulate` writes them and `import` reads them.

use crate::acquisition::{Latency, TestSignal, WavFormat};
use crate::config::choices::InputFile;
use serde::{Deserialize, Serialize};

/// `[recording]`: what was sent, when, which channel holds what; and what a simulated recorder adds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingTable {
    /// Tones one after another, or all at once.
    pub signal: TestSignal,
    /// Of the first tone, s.
    pub start: f64,
    /// Of each tone, s.
    pub dwell: Option<f64>,
    /// Dropped at the beginning of each tone, s; left out: half of it.
    pub settling: Option<f64>,
    /// What was sent: a channel, or a file of one channel. Left out: sines of amplitude 1.
    pub reference: Option<ReferenceChannel>,
    /// Channels of the microphones, counted from 0; left out: all others.
    pub microphones: Vec<usize>,
    /// Gain of the microphones' channels, dB. Left out: 0; of a simulation, what fills half of the scale.
    pub gain_db: Option<f64>,
    /// By how much the microphones' channels are late, s, or `"direct"`.
    pub latency: Latency,
    /// Of a broadband signal: how long the room answers, s; left out: 1/step.
    pub response: Option<f64>,
    /// Of a simulation, Hz.
    pub sample_rate: u32,
    /// Of a simulation.
    pub format: WavFormat,
    /// Of a simulation: the time constant with which the room follows the tones, s.
    pub decay: f64,
}

/// Where the reference is.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "`reference` was expected to be the number of a channel, counted from 0, or a file"
)]
pub enum ReferenceChannel {
    /// In this channel, counted from 0.
    Channel(u32),
    /// In a file of its own.
    File(InputFile),
}

impl RecordingTable {
    /// Whether nothing of it was typed.
    pub(in crate::config) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// The file that it may name.
    pub(in crate::config) fn files_mut(&mut self) -> impl Iterator<Item = &mut InputFile> {
        self.reference.iter_mut().filter_map(|reference| match reference {
            ReferenceChannel::File(file) => Some(file),
            ReferenceChannel::Channel(_) => None,
        })
    }
}

impl Default for RecordingTable {
    fn default() -> Self {
        Self {
            signal: TestSignal::Tones,
            start: 0.0,
            dwell: None,
            settling: None,
            reference: None,
            microphones: Vec::new(),
            gain_db: None,
            latency: Latency::Seconds(0.0),
            response: None,
            sample_rate: 48_000,
            format: WavFormat::Int24,
            decay: 0.002,
        }
    }
}
