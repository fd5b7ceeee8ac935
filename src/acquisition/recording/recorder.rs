//! A simulated recorder: the time signals of stepped tones, as an audio interface stores them.
//!
//! What the microphones hear of each tone and its harmonics is that of the instrument before its mixer
//! ([`Electronics`]): how loud and how late it is in the end. A room needs a while for that: after each step the last tone
//! falls and the new one rises. Then come noise and the converter, whose samples may come late.

use super::options::place_of_key;
use super::schedule::Schedule;
use super::{Latency, RecordingOptions, Reference, TestSignal, WavFormat};
use crate::acquisition::electronics::{Converter, HeardTones};
use crate::acquisition::{DataCube, Electronics, Instrument, Noise};
use crate::error::{Error, Result};
use crate::files::wav::{check_wav_size, write_wav};
use crate::progress::{Observer, advance, stage};
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
    /// Time constant with which the room follows the tones, s; 0: at once. That of the electronics takes its place, if they
    /// have one.
    pub decay: f64,
    /// Gain of the microphones' channels, dB. `None`: 0 in floating point, and in integers a whole number of dB with which
    /// the loudest sample is about half of full scale.
    pub gain_db: Option<f64>,
    /// White noise in the microphones' channels, which demodulated samples have at this ratio.
    pub noise: Option<Noise>,
    /// What the electronics do, unless they are ideal: of them clock, decay, jitter and converter are the recorder's. The
    /// converter's full scale is an amplitude of the cube, and that of the file where it is not said; each frame is late by a
    /// random time of its own.
    pub electronics: Option<Electronics>,
}

crate::with_fields::with_fields! {
    RecorderOptions {
        with_sample_rate(sample_rate: u32),
        with_format(format: WavFormat),
        with_decay(decay: f64),
        with_gain_db(gain_db: Option<f64>),
        with_noise(noise: Option<Noise>),
        with_electronics(electronics: Option<Electronics>),
    }
}

impl Default for RecorderOptions {
    /// 48 kHz, 24 bits, 2 ms, no noise.
    fn default() -> Self {
        Self {
            sample_rate: 48_000,
            format: WavFormat::Int24,
            decay: 0.002,
            gain_db: None,
            noise: None,
            electronics: None,
        }
    }
}

impl RecorderOptions {
    /// The time constant of the room, s.
    fn settling_time(&self) -> f64 {
        let electronics = self.electronics.as_ref().map_or(0.0, |electronics| electronics.decay);
        if electronics > 0.0 { electronics } else { self.decay }
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
    /// tones; electronics with numbers that mean nothing; channels that do not suit the array; a recording of more than 4 GiB.
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
        let electronics = recorder.electronics.clone().unwrap_or_default();
        electronics.check()?;
        let highest = electronics.sweep(instrument, 0, 1)?.stop();
        if rate <= 2.0 * highest {
            let problem = format!(
                "is {rate}, and tones up to {highest} Hz need more than twice as many; 96000 would do up to 48 kHz"
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

/// A recording in the making.
struct Recorder<'a> {
    heard: &'a HeardTones<'a>,
    schedule: Schedule,
    channels: Channels,
    rate: f64,
    latency: f64,
    decay: f64,
    /// By which amplitudes of a cube are multiplied.
    gain: f64,
    /// Standard deviation of the noise, and its seed.
    noise: (f64, u64),
    /// The same of the times of frames, s.
    jitter: (f64, u64),
    /// The converters of microphones and reference, if they do more than the file's format.
    converters: [Option<Converter>; 2],
}

impl Recorder<'_> {
    /// The frames of a block, `[frame, channel]`.
    fn block(&self, block: u64, frames: std::ops::Range<u64>) -> Vec<f32> {
        let HeardTones { instrument, harmonics } = self.heard;
        let n_mic = instrument.array.len();
        let stream = |seed: u64| {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(block);
            random
        };
        let [mut noise, mut lateness] = [self.noise.1, self.jitter.1].map(stream);
        let draw = |random: &mut ChaCha8Rng, deviation: f64| {
            let number: f64 = if deviation > 0.0 { StandardNormal.sample(random) } else { 0.0 };
            deviation * number
        };
        let [of_microphones, of_reference] = self.converters;
        let converted = |converter: Option<Converter>, value: f64| {
            converter.map_or(value, |converter| converter.convert(value)) as f32
        };
        let mut samples = vec![0.0; (frames.end - frames.start) as usize * self.channels.count];
        for (frame, values) in frames.zip(samples.chunks_exact_mut(self.channels.count)) {
            // One clock converts all channels.
            let time = frame as f64 / self.rate + draw(&mut lateness, self.jitter.0);
            let instant = self.schedule.at(time - self.latency, self.decay);
            // What the microphones hear of a tone and its harmonics, and the waves of these, by now.
            let waves: Vec<_> = harmonics
                .iter()
                .flat_map(|harmonic| {
                    self.schedule.waves(&harmonic.frequencies, &instant).map(|(tone, wave)| {
                        harmonic.samples.chunks_exact(n_mic).nth(tone).map(|row| (row, wave))
                    })
                })
                .flatten()
                .collect();
            for (mic, channel) in self.channels.microphones.iter().enumerate() {
                // Im m* e^{i2πft}: a sine, late by the phase of a cube's sample.
                let sines = waves
                    .iter()
                    .map(|(row, wave)| f64::from(row[mic].re) * wave.im - f64::from(row[mic].im) * wave.re);
                let value = self.gain * sines.sum::<f64>() + draw(&mut noise, self.noise.0);
                values[*channel] = converted(of_microphones, value);
            }
            if let Some(channel) = self.channels.reference {
                let [(_, sent), _] =
                    self.schedule.waves(&harmonics[0].frequencies, &self.schedule.at(time, 0.0));
                values[channel] = converted(of_reference, LEVEL * sent.im);
            }
        }
        samples
    }
}

/// Writes what a recorder stores of a cube, whose samples have both phases: for each tone of its sweep in turn what the
/// microphones hear, and what was sent. Returns the gain of the microphones' channels, dB.
///
/// The cube is what the microphones hear, with the bands of amplifier and microphone; harmonics, which need cubes of their own,
/// are in the recordings of scenes (`pipeline::record_scene`). The same cube gives the same bytes for any number of threads.
///
/// # Errors
/// As [`RecordingSize::of`]; electronics that a recording does not have; a file that cannot be written.
pub fn write_recording(
    path: &Path,
    cube: &DataCube,
    recording: &RecordingOptions,
    recorder: &RecorderOptions,
    observer: &dyn Observer,
) -> Result<f64> {
    let electronics = recorder.electronics.clone().unwrap_or_default();
    write_heard(path, &HeardTones::of_cube(cube, &electronics)?, recording, recorder, observer)
}

/// [`write_recording`] of tones and their harmonics.
///
/// # Errors
/// As [`write_recording`].
pub(crate) fn write_heard(
    path: &Path,
    heard: &HeardTones<'_>,
    recording: &RecordingOptions,
    recorder: &RecorderOptions,
    observer: &dyn Observer,
) -> Result<f64> {
    let HeardTones { instrument, harmonics } = heard;
    let size = RecordingSize::of(instrument, recording, recorder)?;
    let electronics = recorder.electronics.clone().unwrap_or_default();
    electronics.check_recording()?;
    let (rate, dwell) = (f64::from(recorder.sample_rate), recording.dwell.unwrap_or_default());
    // That of the tones, since their harmonics are no signal.
    let tones = &harmonics[0].samples;
    let power = tones.iter().map(|m| f64::from(m.norm_sqr())).sum::<f64>() / tones.len() as f64;
    let all = |i: usize| harmonics.iter().map(|harmonic| harmonic.samples[i].norm()).sum::<f32>();
    let loudest = (0..tones.len()).map(all).fold(0.0, f32::max);
    // A fit over N samples leaves 4/N of the noise's power in an amplitude.
    let window = (dwell - recording.settling(dwell)) * rate;
    let deviation =
        recorder.noise.map_or(0.0, |noise| (power / 10_f64.powf(noise.snr_db / 10.0) * window / 4.0).sqrt());
    let peak = f64::from(loudest) + NOISE_PEAK * deviation;
    let peak = electronics.adc_full_scale.map_or(peak, |full| peak.min(full));
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
    // Full scale of the file, as an amplitude of the cube.
    let converter = Converter::of(&electronics, || 1.0 / gain).map(|converter| converter.times(gain));
    let whole = electronics.clone().with_adc_full_scale(None);
    let machine = Recorder {
        heard,
        schedule: Schedule { count: instrument.sweep.len(), start: recording.start, dwell },
        channels: Channels::of(recording, instrument.array.len())?,
        rate,
        latency: recording.known_latency(),
        decay: recorder.settling_time(),
        gain,
        noise: (gain * deviation, recorder.noise.map_or(0, |noise| noise.seed)),
        jitter: (electronics.jitter, electronics.seed),
        converters: [converter, Converter::of(&whole, || 1.0)],
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
