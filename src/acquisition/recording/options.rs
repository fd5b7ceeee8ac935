//! What is known of a recording: the signal that was sent, when, and which channel holds what.

use crate::choice::choice;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

choice! {
    /// What the speaker was given.
    pub enum TestSignal: "signal" {
        /// The tones of the sweep, one after another.
        Tones = "tones",
        /// A chirp, a logarithmic sweep, or anything else that holds all tones of the sweep at once; it must be recorded, too.
        Broadband = "broadband",
    }
}

/// Where the signal is that the speaker was given.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reference {
    /// In a channel, counted from 0, of each file.
    Channel(usize),
    /// In a file of one channel, which begins when each of the recordings does.
    File(PathBuf),
}

choice! {
    /// The word for a latency that is found.
    pub enum DirectWord: "latency" {
        /// By the direct wave.
        Direct = "direct",
    }
}

/// By how much the microphones' channels are later than the reference, without the way through the air.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "`latency` was expected to be a time in s, or \"direct\"")]
pub enum Latency {
    /// s.
    Seconds(f64),
    /// As the direct wave tells, whose path from the speaker to each microphone is known.
    Found(DirectWord),
}

/// How a recording was made.
///
/// # Example
/// ```
/// use holosonar::acquisition::{RecordingOptions, Reference};
///
/// let options = RecordingOptions::tones(0.05).with_settling(Some(0.02)).with_reference(Some(Reference::Channel(0)));
/// assert_eq!(options.dwell, Some(0.05));
/// ```
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RecordingOptions {
    /// What was sent.
    pub signal: TestSignal,
    /// When the first tone begins, s from the recording's first sample.
    pub start: f64,
    /// How long each tone sounds, s; `None`: nobody said it, and tones need it.
    pub dwell: Option<f64>,
    /// How much of that is dropped at the beginning, until the room is as loud as it gets, s; `None`: half.
    pub settling: Option<f64>,
    /// What was sent, as it was recorded. `None`: sines of amplitude 1 that begin with each tone.
    pub reference: Option<Reference>,
    /// The microphones' channels, counted from 0, in the order of the array; empty: all but the reference's.
    pub microphones: Vec<usize>,
    /// Gain of the microphones' channels relative to the reference, dB; samples are divided by it.
    pub gain_db: f64,
    /// How late the microphones' channels are.
    pub latency: Latency,
    /// Of a broadband signal: how long the room answers, s; what comes later is noise. `None`: until paths become ambiguous,
    /// 1/δf.
    pub response: Option<f64>,
}

crate::with_fields::with_fields! {
    RecordingOptions {
        with_start(start: f64),
        with_settling(settling: Option<f64>),
        with_reference(reference: Option<Reference>),
        with_microphones(microphones: Vec<usize>),
        with_gain_db(gain_db: f64),
        with_latency(latency: Latency),
        with_response(response: Option<f64>),
    }
}

impl RecordingOptions {
    /// Tones of `dwell` seconds each.
    pub fn tones(dwell: f64) -> Self {
        Self { dwell: Some(dwell), ..Self::default() }
    }

    /// A broadband signal, in `reference`.
    pub fn broadband(reference: Reference) -> Self {
        Self { signal: TestSignal::Broadband, reference: Some(reference), ..Self::default() }
    }

    /// How much of each tone is dropped, s.
    pub(crate) fn settling(&self, dwell: f64) -> f64 {
        self.settling.unwrap_or(dwell / 2.0)
    }

    /// The latency that is known beforehand, s.
    pub(super) fn known_latency(&self) -> f64 {
        match self.latency {
            Latency::Seconds(seconds) => seconds,
            Latency::Found(_) => 0.0,
        }
    }
}

impl Default for RecordingOptions {
    /// Tones that begin with the recording, without a reference.
    fn default() -> Self {
        Self {
            signal: TestSignal::Tones,
            start: 0.0,
            dwell: None,
            settling: None,
            reference: None,
            microphones: Vec::new(),
            gain_db: 0.0,
            latency: Latency::Seconds(0.0),
            response: None,
        }
    }
}

/// The place of an error in a key of `[recording]`.
pub(super) fn place_of_key(key: &str) -> String {
    format!("[recording] {key}")
}
