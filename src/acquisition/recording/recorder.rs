//! A simulated recorder: the time signals of stepped tones, as an audio interface stores them.
//!
//! Of a cube each sample says how loud and how late a tone is at a microphone in the end. A real room needs a while for
//! that, which is modelled by one time constant: after each step the last tone falls and the new one rises exponentially.
//! Then come noise and the converter.

use super::options::place_of_key;
use super::{Latency, RecordingOptions, Reference, TestSignal, WavFormat};
use crate::acquisition::{DataCube, Instrument, Noise};
use crate::error::{Error, Result};
use crate::files::wav::{check_wav_size, write_wav};
use crate::progress::{Observer, advance, stage};
use crate::wave::interval::phasor_f64;
use num_complex::{Complex32, Complex64};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::Serialize;
use std::path::Path;

/// Amplitude of the reference, and the most of the microphones if their gain is chosen: half of full scale.
const LEVEL: f64 = 0.5;

/// Standard deviations of noise for which a chosen gain leaves room.
const NOISE_PEAK: f64 = 5.0;

/// Samples of a block, which has random numbers of its own; and frames at the most.
const BLOCK_SAMPLES: u64 = 1 << 18;
const BLOCK_FRAMES: u64 = 4096;

/// Blocks that are computed at once.
const AT_ONCE: u64 = 16;

/// How a recorder is simulated.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RecorderOptions {
    /// Samples per second of each channel, Hz.
    pub sample_rate: u32,
    /// How they are stored.
    pub format: WavFormat,
    /// Time constant with which the room follows the tones, s; 0: at once.
    pub decay: f64,
    /// Gain of the microphones' channels, dB. `None`: 0 in floating point, and in integers a whole number of dB with which
    /// the loudest sample is about half of full scale.
    pub gain_db: Option<f64>,
    /// White noise in the microphones' channels, which demodulated samples have at this ratio.
    pub noise: Option<Noise>,
}

crate::with_fields::with_fields! {
    RecorderOptions {
        with_sample_rate(sample_rate: u32),
        with_format(format: WavFormat),
        with_decay(decay: f64),
        with_gain_db(gain_db: Option<f64>),
        with_noise(noise: Option<Noise>),
    }
}

impl Default for RecorderOptions {
    /// 48 kHz, 24 bits, 2 ms, no noise.
    fn default() -> Self {
        Self { sample_rate: 48_000, format: WavFormat::Int24, decay: 0.002, gain_db: None, noise: None }
    }
}

/// The size of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct RecordingSize {
    /// Channels, including the reference.
    pub channels: u64,
    /// Samples of each channel.
    pub frames: u64,
    /// s.
    pub seconds: f64,
    /// Bytes of the file.
    pub bytes: u64,
}

impl RecordingSize {
    /// The size of the recording of an instrument's tones.
    ///
    /// # Errors
    /// A broadband signal; a length of tones that nobody said or that leaves nothing; a sample rate that is too low for the
    /// tones; channels that do not suit the array; a recording of more than 4 GiB.
    pub fn of(
        instrument: &Instrument,
        recording: &RecordingOptions,
        recorder: &RecorderOptions,
    ) -> Result<Self> {
        let rate = f64::from(recorder.sample_rate);
        if recording.signal != TestSignal::Tones {
            let problem = "is \"broadband\", and `simulate` writes tones; leave it out";
            return Err(Error::input(place_of_key("signal"), problem));
        }
        let dwell = recording.dwell.ok_or_else(|| {
            let problem = "is missing: how long does each tone sound, in s? 0.05 is usual indoors";
            Error::input(place_of_key("dwell"), problem)
        })?;
        let Latency::Seconds(latency) = recording.latency else {
            let problem = "is \"direct\", and a simulation has no direct wave; give it in s";
            return Err(Error::input(place_of_key("latency"), problem));
        };
        if rate <= 2.0 * instrument.sweep.stop() {
            let problem = format!(
                "is {rate}, and tones up to {} Hz need more than twice as many; 96000 would do up to 48 kHz",
                instrument.sweep.stop()
            );
            return Err(Error::input(place_of_key("sample_rate"), problem));
        }
        if recording.settling(dwell) >= dwell {
            return Err(Error::input(
                place_of_key("settling"),
                "leaves nothing of the tones; make it shorter",
            ));
        }
        let seconds = recording.start + dwell * instrument.sweep.len() as f64 + latency.max(0.0);
        // Rounding of the product adds no frame.
        let frames = (seconds * rate - 1e-6).ceil() as u64;
        let channels = Channels::of(recording, instrument.array.len())?.count as u64;
        let bytes = check_wav_size("the recording", frames, channels, recorder.format)?;
        Ok(Self { channels, frames, seconds: frames as f64 / rate, bytes })
    }
}

/// Which channel is what.
#[derive(Debug)]
struct Channels {
    count: usize,
    reference: Option<usize>,
    microphones: Vec<usize>,
}

impl Channels {
    fn of(recording: &RecordingOptions, n_mic: usize) -> Result<Self> {
        let reference = match &recording.reference {
            None => None,
            Some(Reference::Channel(channel)) => Some(*channel),
            Some(Reference::File(_)) => {
                let problem =
                    "is a file, and `simulate` writes it into a channel; give its number, counted from 0";
                return Err(Error::input(place_of_key("reference"), problem));
            }
        };
        let typed = &recording.microphones;
        let microphones: Vec<usize> = if typed.is_empty() {
            (0..).filter(|channel| reference != Some(*channel)).take(n_mic).collect()
        } else {
            typed.clone()
        };
        let all = microphones.iter().copied().chain(reference);
        let count = all.max().map_or(0, |last| last.saturating_add(1));
        if microphones.len() != n_mic || reference.is_some_and(|channel| microphones.contains(&channel)) {
            let problem = format!(
                "has {} channels, and [array] has {n_mic} microphones; one each was expected, none of them the reference",
                microphones.len()
            );
            return Err(Error::input(place_of_key("microphones"), problem));
        }
        // A channel far beyond the others would be a file of silence.
        if count > n_mic + 1024 {
            let problem = format!("names channel {}, and there are {n_mic} microphones", count - 1);
            return Err(Error::input(place_of_key("reference"), problem));
        }
        Ok(Self { count, reference, microphones })
    }
}

/// At a time, the tone that sounds and the one before it: how loud they are by now, and their phases.
struct Instant {
    /// Number of the tone that sounds, counted from 0; in silence before the first, and after the last as far as it is heard.
    tone: usize,
    rising: Complex64,
    falling: Complex64,
}

/// The tones of a recording, whatever hears them.
struct Schedule<'a> {
    frequencies: &'a [f64],
    start: f64,
    dwell: f64,
}

impl Schedule<'_> {
    /// What sounds at `time`, s, where tones follow their steps with the time constant `decay`.
    fn at(&self, time: f64, decay: f64) -> Instant {
        let since = time - self.start;
        let tone = (since / self.dwell).floor();
        let last = self.frequencies.len() as f64;
        if since < 0.0 || tone > last {
            return Instant { tone: 0, rising: Complex64::ZERO, falling: Complex64::ZERO };
        }
        let within = since - tone * self.dwell;
        let left = if decay > 0.0 { (-within / decay).exp() } else { 0.0 };
        let tone = tone as usize;
        let wave = |tone: usize, since: f64| {
            self.frequencies.get(tone).map_or(Complex64::ZERO, |f| phasor_f64(f * since))
        };
        let falling = if tone == 0 { Complex64::ZERO } else { wave(tone - 1, within + self.dwell) * left };
        Instant { tone, rising: wave(tone, within) * (1.0 - left), falling }
    }
}

/// `Im m* e^{i2πft}`: a sine, late by the phase of a cube's sample.
fn late_sine(m: Complex32, wave: Complex64) -> f64 {
    f64::from(m.re) * wave.im - f64::from(m.im) * wave.re
}

/// A recording in the making.
struct Recorder<'a> {
    cube: &'a DataCube,
    schedule: Schedule<'a>,
    channels: Channels,
    rate: f64,
    latency: f64,
    decay: f64,
    /// By which samples of the cube are multiplied.
    gain: f64,
    /// Standard deviation of the noise, and its seed.
    noise: (f64, u64),
}

impl Recorder<'_> {
    /// The frames of a block, `[frame, channel]`.
    fn block(&self, block: u64, frames: std::ops::Range<u64>) -> Vec<f32> {
        let n_mic = self.cube.instrument.array.len();
        let row = |tone: usize| self.cube.samples.get(tone * n_mic..(tone + 1) * n_mic);
        let mut random = ChaCha8Rng::seed_from_u64(self.noise.1);
        random.set_stream(block);
        let mut samples = vec![0.0; (frames.end - frames.start) as usize * self.channels.count];
        for (frame, values) in frames.zip(samples.chunks_exact_mut(self.channels.count)) {
            let time = frame as f64 / self.rate;
            let heard = self.schedule.at(time - self.latency, self.decay);
            let now = row(heard.tone);
            let before = heard.tone.checked_sub(1).and_then(row);
            for (mic, channel) in self.channels.microphones.iter().enumerate() {
                let rising = now.map_or(0.0, |m| late_sine(m[mic], heard.rising));
                let falling = before.map_or(0.0, |m| late_sine(m[mic], heard.falling));
                let noise: f64 = if self.noise.0 > 0.0 { StandardNormal.sample(&mut random) } else { 0.0 };
                values[*channel] = (self.gain * (rising + falling) + self.noise.0 * noise) as f32;
            }
            if let Some(channel) = self.channels.reference {
                values[channel] = (LEVEL * self.schedule.at(time, 0.0).rising.im) as f32;
            }
        }
        samples
    }
}

/// Writes what a recorder stores of a cube, whose samples have both phases: for each tone of its sweep in turn what the
/// microphones hear, and what was sent. Returns the gain of the microphones' channels, dB.
///
/// The same cube gives the same bytes for any number of threads.
///
/// # Errors
/// As [`RecordingSize::of`]; a file that cannot be written.
pub fn write_recording(
    path: &Path,
    cube: &DataCube,
    recording: &RecordingOptions,
    recorder: &RecorderOptions,
    observer: &dyn Observer,
) -> Result<f64> {
    let instrument = &cube.instrument;
    let size = RecordingSize::of(instrument, recording, recorder)?;
    let (rate, dwell) = (f64::from(recorder.sample_rate), recording.dwell.unwrap_or_default());
    let power: f64 = cube.samples.iter().map(|m| f64::from(m.norm_sqr())).sum();
    let power = power / cube.samples.len() as f64;
    let loudest = cube.samples.iter().map(|m| m.norm()).fold(0.0, f32::max);
    // A fit over N samples leaves 4/N of the noise's power in an amplitude.
    let window = (dwell - recording.settling(dwell)) * rate;
    let deviation =
        recorder.noise.map_or(0.0, |noise| (power / 10_f64.powf(noise.snr_db / 10.0) * window / 4.0).sqrt());
    let peak = f64::from(loudest) + NOISE_PEAK * deviation;
    let gain_db = recorder.gain_db.unwrap_or_else(|| {
        let is_free = recorder.format == WavFormat::Float32 || peak <= 0.0;
        if is_free { 0.0 } else { (-20.0 * peak.log10()).floor() }
    });
    let gain = LEVEL * 10_f64.powf(gain_db / 20.0);
    if gain * peak > 1.0 && recorder.format != WavFormat::Float32 {
        observer.warn(&format!(
            "the microphones are cut off at full scale; recording.gain_db = {} would be as loud as possible",
            (-20.0 * (LEVEL * peak).log10()).floor()
        ));
    }
    let machine = Recorder {
        cube,
        schedule: Schedule { frequencies: instrument.sweep.frequencies(), start: recording.start, dwell },
        channels: Channels::of(recording, instrument.array.len())?,
        rate,
        latency: recording.known_latency(),
        decay: recorder.decay,
        gain,
        noise: (gain * deviation, recorder.noise.map_or(0, |noise| noise.seed)),
    };
    let length = (BLOCK_SAMPLES / size.channels.max(1)).clamp(1, BLOCK_FRAMES);
    let blocks = size.frames.div_ceil(length);
    let header = (size.channels as u16, recorder.sample_rate, recorder.format);
    stage(observer, "writing the recording", blocks, || {
        write_wav(path, header, |put| {
            for first in (0..blocks).step_by(AT_ONCE as usize) {
                let some = first..(first + AT_ONCE).min(blocks);
                let count = some.end - some.start;
                let one = |block: u64| {
                    machine.block(block, block * length..((block + 1) * length).min(size.frames))
                };
                let ready: Vec<Vec<f32>> = some.into_par_iter().map(one).collect();
                ready.iter().try_for_each(|samples| put(samples))?;
                advance(observer, count)?;
            }
            Ok(())
        })
    })?;
    Ok(gain_db)
}
