//! Time recordings: from what the microphones heard, sample by sample, to the samples of a cube.
//!
//! [`demodulate`] takes WAV files and what is known of them, and gives a complex amplitude for every tone of a sweep and
//! every microphone, relative to the signal that was sent, with its noise. Stepped tones are demodulated one by one as the
//! paper's receiver does it, and broadband signals deconvolved.

mod deconvolution;
mod latency;
#[cfg(test)]
mod mixer;
mod options;
mod recorder;
mod schedule;
mod sources;
#[cfg(test)]
mod tests;
mod tones;

pub use crate::files::wav::WavFormat;
pub use options::{DirectWord, Latency, RecordingOptions, Reference, TestSignal};
pub(crate) use recorder::write_heard;
pub use recorder::{RecorderOptions, RecordingSize, write_recording};

use super::{DataCube, Instrument};
use crate::error::Result;
use crate::wave::interval::phasor_f64;
use latency::{FoundLatency, direct_latency, direct_paths};
use num_complex::{Complex32, Complex64};
use serde_json::{Map, Value, json};
use sources::{RecordedFile, check_files};
use std::path::PathBuf;

/// Below this share of the samples' power, a direct wave is perhaps none.
const LEAST_SHARE: f64 = 0.1;

/// Samples of a cube, and what was found on the way.
#[derive(Debug)]
pub(super) struct Demodulated {
    n_mic: usize,
    /// `[n_f, n_mic]`, with phase sign +1.
    pub(super) samples: Vec<Complex32>,
    /// Mean power of each tone over the microphones, and that of its noise, which may be unknown: NaN.
    powers: Vec<[f64; 2]>,
    /// What was not said.
    pub(super) guesses: Vec<String>,
    /// What is probably wrong.
    pub(super) warnings: Vec<String>,
    /// What is reported.
    pub(super) facts: Map<String, Value>,
}

impl Demodulated {
    /// Stores the sample of a tone and a microphone, and the power of its noise.
    fn put(&mut self, tone: usize, mic: usize, value: Complex64, noise: f64) {
        self.samples[tone * self.n_mic + mic] = Complex32::new(value.re as f32, value.im as f32);
        let [power, noises] = &mut self.powers[tone];
        *power += value.norm_sqr() / self.n_mic as f64;
        *noises += noise / self.n_mic as f64;
    }

    /// The signal-to-noise ratio of each tone's samples, dB; `None` where the noise is unknown or 0.
    fn snr_db(&self) -> Vec<Option<f64>> {
        let one = |[power, noise]: &[f64; 2]| {
            // The noise has its power in the samples, too.
            let ratio = (power - noise).max(0.0) / noise;
            let db = 10.0 * ratio.max(1e-4).log10();
            (db.is_finite()).then_some((db * 100.0).round() / 100.0)
        };
        self.powers.iter().map(one).collect()
    }
}

/// Reads recordings, the channels of whose microphones are in the order of the array, file after file.
///
/// Stepped tones take the memory of a tone's window; a broadband signal takes that of a file.
///
/// # Errors
/// Files that are no recordings, have other channels, end too early or do not fit in memory; times and references with
/// which the tones are not where they are said to be.
pub(super) fn demodulate(
    files: &[PathBuf],
    instrument: &Instrument,
    options: &RecordingOptions,
    limit: u64,
) -> Result<Demodulated> {
    let (n_f, n_mic, highest) = (instrument.sweep.len(), instrument.array.len(), instrument.sweep.stop());
    let described = check_files(files, n_mic, highest, options)?;
    let mut found = Demodulated {
        n_mic,
        samples: DataCube::allocate([1, n_f, n_mic])?,
        powers: vec![[0.0; 2]; n_f],
        guesses: Vec::new(),
        warnings: Vec::new(),
        facts: Map::new(),
    };
    let mut begin = options.known_latency();
    let is_direct = matches!(options.latency, Latency::Found(_));
    let is_broadband = options.signal == TestSignal::Broadband;
    if is_direct && is_broadband {
        begin = first_arrival(files, instrument, options, limit)?;
    }
    let mut column = 0;
    for path in files {
        let mut source = RecordedFile::open(path, highest, options)?;
        match options.signal {
            TestSignal::Tones => {
                tones::demodulate(&mut source, &instrument.sweep, options, limit, (column, &mut found))?;
            }
            TestSignal::Broadband => {
                let to = (column, begin, &mut found);
                deconvolution::demodulate(&mut source, &instrument.sweep, options, limit, to)?;
            }
        }
        column += source.microphones.len();
    }
    let latency = if is_direct {
        let around = is_broadband.then_some(begin);
        let direct = direct_latency(&found.samples, instrument, around)?;
        found.tell_direct(direct);
        direct.seconds
    } else {
        begin
    };
    for (row, frequency) in found.samples.chunks_exact_mut(n_mic).zip(instrument.sweep.frequencies()) {
        let back = phasor_f64(-frequency * latency);
        let back = Complex32::new(back.re as f32, back.im as f32);
        for m in row {
            *m *= back;
        }
    }
    found.report(&described, instrument, options, latency);
    Ok(found)
}

/// When the direct wave of a broadband signal arrives, beyond the time of its path, to a sample or so, s.
fn first_arrival(
    files: &[PathBuf],
    instrument: &Instrument,
    options: &RecordingOptions,
    limit: u64,
) -> Result<f64> {
    let delays: Vec<f64> =
        direct_paths(instrument).iter().map(|path| path / instrument.sound_speed).collect();
    let (mut power, mut rate, mut column) = (Vec::new(), 0.0, 0);
    for path in files {
        let mut source = RecordedFile::open(path, instrument.sweep.stop(), options)?;
        let own = &delays[column..];
        deconvolution::add_envelopes(&mut source, limit, own, (&mut power, &mut rate))?;
        column += source.microphones.len();
    }
    Ok(deconvolution::strongest(&power, rate))
}

impl Demodulated {
    /// Reports the direct wave.
    fn tell_direct(&mut self, direct: FoundLatency) {
        let share = (direct.share * 1e4).round() / 1e4;
        self.facts.insert("direct_wave_share".into(), json!(share));
        if direct.share < LEAST_SHARE {
            self.warnings.push(format!(
                "the strongest wave that fits the paths from speaker to microphones, {:.3} ms late, explains {:.0} % of the \
                 power: it may be an echo; give recording.latency in s if it is known",
                1e3 * direct.seconds,
                100.0 * direct.share
            ));
        }
    }

    /// Reports what was found and what was guessed.
    fn report(&mut self, described: &str, instrument: &Instrument, options: &RecordingOptions, latency: f64) {
        if options.signal == TestSignal::Tones {
            if let (None, Some(dwell)) = (options.settling, options.dwell) {
                self.guesses.push(format!("settling = {}: half of each tone", options.settling(dwell)));
            }
            if options.reference.is_none() {
                self.guesses.push(
                    "reference: none, so that each tone was a sine of amplitude 1 that began with it, in time with the recording"
                        .to_owned(),
                );
            }
        }
        let snr = self.snr_db();
        let mut known: Vec<(f64, f64)> = snr
            .iter()
            .zip(instrument.sweep.frequencies())
            .filter_map(|(snr, frequency)| snr.map(|snr| (snr, *frequency)))
            .collect();
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        let facts = &mut self.facts;
        facts.insert("recorded".into(), json!(described));
        facts.insert("signal".into(), json!(options.signal));
        facts.insert("latency_s".into(), json!(latency));
        if let (Some(least), Some(median)) = (known.first(), known.get(known.len() / 2)) {
            facts.insert("snr_db".into(), json!(median.0));
            facts.insert("least_snr_db".into(), json!(least.0));
            facts.insert("least_snr_at_hz".into(), json!(least.1));
            facts.insert("snr_db_of_tones".into(), json!(snr));
        }
    }
}
