//! Stepped tones: the complex amplitude of each, in the part of its time in which the room has settled.
//!
//! The least-squares fit of a tone and a constant is homodyne demodulation (Eqs. 1 to 3) for windows of any length: over
//! whole periods it is the same sum, and over others it knows what the mixer's second product would add.

use super::options::place_of_key;
use super::sources::{Clipped, RecordedFile, check_memory};
use super::{Demodulated, RecordingOptions};
use crate::acquisition::Sweep;
use crate::error::{Error, Result};
use crate::files::wav::WavFile;
use crate::wave::interval::phasor_f64;
use glam::{DMat3, DVec3};
use num_complex::Complex64;
use std::ops::Range;

/// Of an amplitude that is estimated, the noise that is allowed in a reference: the power of 10 dB below it.
const REFERENCE_SNR: f64 = 10.0;

/// A tone in one channel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Tone {
    /// `a` of `Re a e^{i2πft}`.
    pub(super) amplitude: Complex64,
    /// `E|n|²` of its error, from what the fit leaves over, if that is white.
    pub(super) noise: f64,
}

/// The least-squares fit of a tone of a known frequency, and a constant.
#[derive(Debug)]
pub(super) struct ToneFit {
    /// `e^{i2πft}` of each sample.
    waves: Vec<Complex64>,
    /// Inverse of the products of cosine, sine and constant.
    inverse: DMat3,
}

impl ToneFit {
    /// For `count` samples at times `first + k·interval`, s.
    pub(super) fn new(frequency: f64, first: f64, interval: f64, count: usize) -> Self {
        let waves: Vec<Complex64> =
            (0..count).map(|k| phasor_f64(frequency * (first + k as f64 * interval))).collect();
        let column = |wave: &Complex64| DVec3::new(wave.re, wave.im, 1.0);
        let products = waves
            .iter()
            .map(column)
            .fold(DMat3::ZERO, |sum, v| sum + DMat3::from_cols(v * v.x, v * v.y, v * v.z));
        Self { waves, inverse: products.inverse() }
    }

    /// Fits all channels of frames, `[frame, channel]`.
    pub(super) fn fit(&self, frames: &[f32], channels: usize) -> Vec<Tone> {
        // Products with cosine, sine and constant, and the power.
        let mut sums = vec![[0.0; 4]; channels];
        for (wave, frame) in self.waves.iter().zip(frames.chunks_exact(channels)) {
            for (sums, sample) in sums.iter_mut().zip(frame) {
                let sample = f64::from(*sample);
                sums[0] += sample * wave.re;
                sums[1] += sample * wave.im;
                sums[2] += sample;
                sums[3] += sample * sample;
            }
        }
        let freedom = self.waves.len().saturating_sub(3).max(1) as f64;
        sums.iter()
            .map(|[cos, sin, sum, power]| {
                let products = DVec3::new(*cos, *sin, *sum);
                let fitted = self.inverse * products;
                let left = (power - fitted.dot(products)).max(0.0) / freedom;
                let spread = self.inverse.x_axis.x + self.inverse.y_axis.y;
                Tone { amplitude: Complex64::new(fitted.x, -fitted.y), noise: left * spread }
            })
            .collect()
    }
}

/// The frames of a tone that are evaluated, and when the first of them is, s from the tone's beginning on.
fn window(begin: f64, [settling, dwell]: [f64; 2], rate: f64) -> (Range<u64>, f64) {
    // A frame on an edge counts, whichever way its time was rounded.
    let first = ((begin + settling) * rate - 1e-6).ceil().max(0.0);
    let end = ((begin + dwell) * rate - 1e-6).ceil().max(first);
    (first as u64..end as u64, first / rate - begin)
}

/// Demodulates the tones of a file into the columns from `column` on.
///
/// # Errors
/// Times of the tones that are missing, impossible or beyond the file's end; a reference without its tones.
pub(super) fn demodulate(
    source: &mut RecordedFile,
    sweep: &Sweep,
    options: &RecordingOptions,
    limit: u64,
    (column, found): (usize, &mut Demodulated),
) -> Result<()> {
    let dwell = options.dwell.ok_or_else(|| {
        let problem =
            "is missing: how long does each tone sound, in s? And which part of it, `settling`, is dropped?";
        Error::input(place_of_key("dwell"), problem)
    })?;
    let settling = options.settling(dwell);
    let rate = source.file.sample_rate();
    let latency = options.known_latency();
    let begins = |n: usize| options.start + n as f64 * dwell;
    let windows = |n: usize, late: f64| window(begins(n) + late, [settling, dwell], rate);
    check_times(source, sweep, [begins(sweep.len()), latency], &windows)?;
    let longest = 2 + ((dwell - settling) * rate) as u64;
    let channels = source.file.channels();
    check_memory(&source.file, longest.saturating_mul(channels as u64 * 8 + 64), limit)?;
    let gain = 10_f64.powf(options.gain_db / 20.0);
    let mut clipped = Clipped::default();
    for (n, &frequency) in sweep.frequencies().iter().enumerate() {
        let (frames, first) = windows(n, latency);
        let count = (frames.end - frames.start) as usize;
        let block = source.file.read(frames.start, frames.end - frames.start)?;
        clipped.look(&source.file, &block);
        // Times are those since the tone was sent, also of microphones that are late.
        let tones = ToneFit::new(frequency, first + latency, 1.0 / rate, count).fit(&block, channels);
        let sent = reference(source, (frequency, n), windows(n, 0.0), options)?;
        for (place, channel) in source.microphones.iter().enumerate() {
            let tone = tones[*channel];
            // A tone that comes later has a lower phase, and that of a cube grows with the path.
            let m = (tone.amplitude / sent.amplitude).conj() / gain;
            let relative = tone.noise / (sent.amplitude.norm_sqr() * gain * gain)
                + m.norm_sqr() * sent.noise / sent.amplitude.norm_sqr();
            found.put(n, column + place, m, relative);
        }
    }
    found.warnings.extend(clipped.warning(source));
    Ok(())
}

/// The tone that was sent: as recorded, or a sine of amplitude 1.
fn reference(
    source: &mut RecordedFile,
    (frequency, n): (f64, usize),
    (frames, first): (Range<u64>, f64),
    options: &RecordingOptions,
) -> Result<Tone> {
    let dwell = options.dwell.unwrap_or_default();
    let Some((file, channel)) = source.sent() else {
        return Ok(Tone { amplitude: -Complex64::I, noise: 0.0 });
    };
    let count = frames.end - frames.start;
    let block = file.read(frames.start, count)?;
    let (rate, channels) = (file.sample_rate(), file.channels());
    let tone = ToneFit::new(frequency, first, 1.0 / rate, count as usize).fit(&block, channels)[channel];
    if tone.amplitude.norm_sqr() > REFERENCE_SNR * tone.noise {
        return Ok(tone);
    }
    let problem = format!(
        "has no tone of {frequency} Hz from {:.4} to {:.4} s in channel {channel}, counted from 0, where tone {} of the sweep \
         was sent; check recording.start, recording.dwell ({dwell} s) and recording.reference, and [sweep]",
        frames.start as f64 / rate,
        frames.end as f64 / rate,
        n + 1
    );
    Err(Error::input(file.path().display(), problem))
}

/// Refuses windows that are too short, and tones beyond the end of a file.
fn check_times(
    source: &mut RecordedFile,
    sweep: &Sweep,
    [end, latency]: [f64; 2],
    windows: &dyn Fn(usize, f64) -> (Range<u64>, f64),
) -> Result<()> {
    let last = sweep.len() - 1;
    let short = |file: &WavFile, needed: u64| {
        let (has, rate) = (file.seconds(), file.sample_rate());
        let problem = format!(
            "lasts {has:.3} s, and {} tones need {:.3} s; check recording.start, recording.dwell and [sweep]",
            sweep.len(),
            needed as f64 / rate
        );
        Err(Error::input(file.path().display(), problem))
    };
    let rate = source.file.sample_rate();
    if !(end + latency.abs()).is_finite() || (end + latency.abs()) * rate > 2_f64.powi(52) {
        let problem = format!("{} tones end after {end:e} s, which no file lasts", sweep.len());
        return Err(Error::input(place_of_key("dwell"), problem));
    }
    let needed = windows(last, latency).0.end;
    if needed > source.file.frames() {
        return short(&source.file, needed);
    }
    if let Some((file, _)) = source.sent() {
        let needed = windows(last, 0.0).0.end;
        if needed > file.frames() {
            return short(file, needed);
        }
    }
    for (n, frequency) in sweep.frequencies().iter().enumerate() {
        for late in [latency, 0.0] {
            let (frames, first) = windows(n, late);
            let count = frames.end - frames.start;
            if (count as f64) < (rate / frequency).max(8.0) || first < -1e-9 {
                let problem = format!(
                    "leaves {count} samples of each tone; at least a period and 8 samples were expected: make `dwell` longer"
                );
                return Err(Error::input(place_of_key("settling"), problem));
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::mixer::homodyne;
    use super::*;

    /// Numbers that look random, within ±1.
    fn noise(count: usize) -> Vec<f32> {
        let mut state = 1_u32;
        let next = |_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 8_388_608.0 - 1.0
        };
        (0..count).map(next).collect()
    }

    #[test]
    fn over_whole_periods_the_fit_is_the_mixer() {
        let (rate, frequency, first) = (48_000.0, 12_300.0, 0.0123);
        // 1600 samples are 410 periods. Without a mean, which the fit takes away and the mixer does not.
        let mut samples = noise(1600);
        let mean = samples.iter().sum::<f32>() / 1600.0;
        for sample in &mut samples {
            *sample -= mean;
        }
        let fitted = ToneFit::new(frequency, first, 1.0 / rate, 1600).fit(&samples, 1)[0];
        let literal = homodyne(&samples, frequency, first, 1.0 / rate);
        // Relative to the sine that was sent.
        let relative = (fitted.amplitude / -Complex64::I).conj();
        assert!((relative - literal).norm() < 1e-9 && literal.norm() > 1e-4, "{relative} {literal}");
    }

    #[test]
    fn windows_of_any_length_give_the_tone_and_its_noise() {
        let (rate, frequency) = (44_100.0, 10_111.0);
        let exact = Complex64::from_polar(0.3, 1.1);
        for count in [97, 1000, 4411] {
            let tone = |k: usize| 0.2 + (exact * phasor_f64(frequency * (0.5 + k as f64 / rate))).re;
            let samples: Vec<f32> = (0..count).map(|k| tone(k) as f32).collect();
            let fitted = ToneFit::new(frequency, 0.5, 1.0 / rate, count).fit(&samples, 1)[0];
            assert!((fitted.amplitude - exact).norm() < 1e-7, "{count}: {fitted:?}");
            assert!(fitted.noise < 1e-14, "{fitted:?}");
            // Noise of variance 1/3, in the second of two channels.
            let noisy: Vec<f32> = samples.iter().zip(noise(count)).flat_map(|(s, n)| [*s, s + n]).collect();
            let fitted = ToneFit::new(frequency, 0.5, 1.0 / rate, count).fit(&noisy, 2);
            assert!((fitted[0].amplitude - exact).norm() < 1e-7);
            let expected = 4.0 / 3.0 / count as f64;
            let ratio = fitted[1].noise / expected;
            assert!((0.8..1.2).contains(&ratio), "{count}: {ratio}");
            assert!((fitted[1].amplitude - exact).norm_sqr() < 12.0 * expected, "{count}");
        }
    }

    #[test]
    fn a_window_begins_with_the_first_frame_within_it() {
        assert_eq!(window(0.0, [0.0, 0.01], 48_000.0), (0..480, 0.0));
        let (frames, first) = window(0.1, [0.02, 0.05], 44_100.0);
        assert_eq!(frames, 5292..6615);
        assert!((first - 0.02).abs() < 1e-12);
        let (frames, first) = window(0.000_01, [0.0, 0.001], 48_000.0);
        assert_eq!(frames, 1..49);
        assert!((first - (1.0 / 48_000.0 - 0.000_01)).abs() < 1e-15);
    }
}
