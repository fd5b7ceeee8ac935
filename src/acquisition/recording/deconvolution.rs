//! Broadband signals: the response of the room by deconvolution with the signal that was sent, and its values at the tones.
//!
//! `H = Y X*/(|X|² + ε)`, of which the time that the room takes to answer is kept. NumPy's and this sign of a transform make
//! a delay's phase fall; that of a cube grows, so that samples are conjugated.

use super::options::place_of_key;
use super::sources::{Clipped, RecordedFile, check_memory};
use super::{Demodulated, RecordingOptions};
use crate::acquisition::Sweep;
use crate::error::{Error, Result};
use crate::wave::interval::phasor_f64;
use num_complex::Complex64;
use rayon::prelude::*;
use rustfft::{Fft, FftPlanner};
use std::f64::consts::PI;
use std::sync::Arc;

/// `ε` of the deconvolution, relative to the greatest `|X|²`: -60 dB.
const EPSILON: f64 = 1e-6;

/// The part of a unit echo that must be left at every tone; less says that the signal does not hold it.
const LEAST_LEFT: f64 = 0.5;

/// Of the response's length, how much before it is kept, too.
const LEAD: f64 = 0.25;

/// Of the response's length, how long it takes to fade in and out.
const FADE: f64 = 0.2;

/// Times before 0 that a response may begin at, as a part of the transform's length.
const BEFORE: f64 = 0.125;

/// Tones that are evaluated together.
const TOGETHER: usize = 8;

/// The transforms of a file, and the signal that was sent.
struct Deconvolution {
    forward: Arc<dyn Fft<f64>>,
    inverse: Arc<dyn Fft<f64>>,
    length: usize,
    rate: f64,
    /// `X*/(|X|² + ε)`, of positive frequencies alone, which gives the envelope of a response, and divided by the length.
    filter: Vec<Complex64>,
    /// `X`.
    sent: Vec<Complex64>,
}

/// Which part of a response is kept: weights of the samples from `first` on, which may be before 0.
struct Gate {
    first: i64,
    weights: Vec<f64>,
}

impl Gate {
    /// From `begin` on, `response` seconds long, with an edge on each side.
    fn new(begin: f64, response: f64, rate: f64) -> Self {
        let (lead, fade) = (LEAD * response, FADE * response);
        let first = ((begin - lead) * rate).floor();
        let count = ((response + lead + fade) * rate).ceil() as usize + 1;
        let edge = |distance: f64| (0.5 * PI * (distance / fade).clamp(0.0, 1.0)).sin().powi(2);
        let weight = |k: usize| {
            let time = (first + k as f64) / rate - begin;
            edge(time + lead) * edge(response + fade - time)
        };
        Self { first: first as i64, weights: (0..count).map(weight).collect() }
    }

    /// The same, later by so many samples.
    fn later(&self, by: i64) -> Self {
        Self { first: self.first + by, weights: self.weights.clone() }
    }
}

impl Deconvolution {
    /// Of a signal that was sent.
    fn new(signal: &[f64], length: usize, rate: f64) -> Self {
        let mut planner = FftPlanner::<f64>::new();
        let (forward, inverse) = (planner.plan_fft_forward(length), planner.plan_fft_inverse(length));
        let mut sent: Vec<Complex64> = signal.iter().map(|x| Complex64::from(*x)).collect();
        sent.resize(length, Complex64::ZERO);
        forward.process(&mut sent);
        let most = sent.iter().map(Complex64::norm_sqr).fold(0.0, f64::max);
        let one = |(k, x): (usize, &Complex64)| {
            let is_positive = k > 0 && k < length / 2;
            if is_positive {
                x.conj() / ((x.norm_sqr() + EPSILON * most) * length as f64)
            } else {
                Complex64::ZERO
            }
        };
        let filter = sent.iter().enumerate().map(one).collect();
        Self { forward, inverse, length, rate, filter, sent }
    }

    /// The response of which these are the samples; the times before 0 are at its end.
    fn response(&self, samples: impl Iterator<Item = f32>) -> Vec<Complex64> {
        let mut column: Vec<Complex64> = samples.map(|y| Complex64::from(f64::from(y))).collect();
        column.resize(self.length, Complex64::ZERO);
        self.forward.process(&mut column);
        self.filtered(column)
    }

    fn filtered(&self, mut column: Vec<Complex64>) -> Vec<Complex64> {
        column.iter_mut().zip(&self.filter).for_each(|(y, filter)| *y *= filter);
        self.inverse.process(&mut column);
        column
    }

    /// What becomes of an echo in the middle of the gate at each tone: 1, unless the signal or the gate lack something.
    fn left(&self, gate: &Gate, sweep: &Sweep) -> Vec<Complex64> {
        let middle = gate.first + gate.weights.len() as i64 / 2;
        let cycles = |k: usize| -(k as f64) * middle as f64 / self.length as f64;
        let delayed = self.sent.iter().enumerate().map(|(k, x)| x * phasor_f64(cycles(k))).collect();
        let echo = self.filtered(delayed);
        let found = self.at_tones(&echo, gate, sweep);
        let delay = |f: &f64| phasor_f64(f * middle as f64 / self.rate);
        found.iter().zip(sweep.frequencies()).map(|(m, f)| m * delay(f)).collect()
    }

    /// The spectrum of a gated response at the tones, `Σ_t w h e^{-i2πft}`, several tones at a time.
    fn at_tones(&self, response: &[Complex64], gate: &Gate, sweep: &Sweep) -> Vec<Complex64> {
        let at = |k: usize| (gate.first + k as i64).rem_euclid(self.length as i64) as usize;
        let gated: Vec<Complex64> =
            gate.weights.iter().enumerate().map(|(k, weight)| response[at(k)] * weight).collect();
        let mut found = Vec::with_capacity(sweep.len());
        for tones in sweep.frequencies().chunks(TOGETHER) {
            let each = |n: usize| -tones.get(n).copied().unwrap_or_default() / self.rate;
            let turns: [Complex64; TOGETHER] = std::array::from_fn(|n| phasor_f64(each(n)));
            let mut waves: [Complex64; TOGETHER] =
                std::array::from_fn(|n| phasor_f64(each(n) * gate.first as f64));
            let mut sums = [Complex64::ZERO; TOGETHER];
            for value in &gated {
                for n in 0..TOGETHER {
                    sums[n] += value * waves[n];
                    waves[n] *= turns[n];
                }
            }
            found.extend_from_slice(&sums[..tones.len()]);
        }
        found
    }
}

/// How long the response is that is kept, s.
fn response_length(sweep: &Sweep, options: &RecordingOptions) -> Result<f64> {
    let known = options.response.or_else(|| sweep.step().filter(|_| sweep.len() > 1).map(|step| 1.0 / step));
    known.ok_or_else(|| {
        let problem =
            "is missing: how long does the room answer, in s? Evenly spaced frequencies would tell, 1/step";
        Error::input(place_of_key("response"), problem)
    })
}

/// The samples of a file, and its deconvolution.
fn prepare(source: &mut RecordedFile, limit: u64) -> Result<(Vec<f32>, Deconvolution)> {
    let (frames, channels) = (source.file.frames(), source.file.channels() as u64);
    let place = source.file.path().display().to_string();
    let sent_frames = source.sent().map_or(0, |(file, _)| file.frames());
    let length = frames.max(sent_frames).saturating_add(1).next_power_of_two();
    // Samples, the transforms of the signal, and on each thread a response and the scratch of its transform.
    let each = 16 * (3 + 3 * rayon::current_num_threads() as u64);
    check_memory(&source.file, (frames * channels * 4).saturating_add(length.saturating_mul(each)), limit)?;
    let samples = source.file.read(0, frames)?;
    let rate = source.file.sample_rate();
    let missing = || {
        let problem = "is missing: a broadband signal must be recorded, too; give the number of its channel, from 0, or its \
                       file";
        Error::input(place_of_key("reference"), problem)
    };
    let (file, channel) = source.sent().ok_or_else(missing)?;
    let every = file.channels();
    let sent = file.read(0, sent_frames)?;
    let signal: Vec<f64> = sent.chunks_exact(every).map(|frame| f64::from(frame[channel])).collect();
    if signal.iter().all(|x| *x == 0.0) {
        return Err(Error::input(
            place,
            format!("has a reference that is silent, channel {channel}, from 0"),
        ));
    }
    Ok((samples, Deconvolution::new(&signal, length as usize, rate)))
}

/// Adds the power of a file's responses, each microphone's earlier by its `delays`, s; `rate` is the sample rate.
///
/// # Errors
/// As [`demodulate`].
pub(super) fn add_envelopes(
    source: &mut RecordedFile,
    limit: u64,
    delays: &[f64],
    (power, rate): (&mut Vec<f64>, &mut f64),
) -> Result<()> {
    let (samples, deconvolution) = prepare(source, limit)?;
    let length = deconvolution.length;
    if power.is_empty() {
        power.resize(length, 0.0);
        *rate = deconvolution.rate;
    }
    if power.len() != length || *rate != deconvolution.rate {
        let problem = "is as long as others, or has another sample rate; with a latency of \"direct\" they must be alike";
        return Err(Error::input(source.file.path().display(), problem));
    }
    let channels = source.file.channels();
    for (channel, delay) in source.microphones.iter().zip(delays) {
        let response = deconvolution.response(samples.iter().skip(*channel).step_by(channels).copied());
        let early = (delay * deconvolution.rate).round() as usize % length;
        power.iter_mut().enumerate().for_each(|(k, sum)| *sum += response[(k + early) % length].norm_sqr());
    }
    Ok(())
}

/// The time of the most power, s; the last eighth of the times is before 0.
pub(super) fn strongest(power: &[f64], rate: f64) -> f64 {
    let peak = (0..power.len()).max_by(|a, b| power[*a].total_cmp(&power[*b])).unwrap_or(0) as f64;
    let length = power.len() as f64;
    (if peak > (1.0 - BEFORE) * length { peak - length } else { peak }) / rate
}

/// Deconvolves a file's microphones into the columns from `column` on; responses begin at `begin`, s.
///
/// # Errors
/// A signal that is missing, silent, or lacks tones of the sweep; a file that does not fit in memory.
pub(super) fn demodulate(
    source: &mut RecordedFile,
    sweep: &Sweep,
    options: &RecordingOptions,
    limit: u64,
    (column, begin, found): (usize, f64, &mut Demodulated),
) -> Result<()> {
    let response = response_length(sweep, options)?;
    let place = source.file.path().display().to_string();
    let (samples, deconvolution) = prepare(source, limit)?;
    let mut clipped = Clipped::default();
    clipped.look(&source.file, &samples);
    found.warnings.extend(clipped.warning(source));
    let longest = deconvolution.length as f64 * (1.0 - BEFORE) / deconvolution.rate;
    // What is shorter than the response is kept as a whole.
    let kept = response.min((longest - begin) / (1.0 + LEAD + FADE));
    if kept * deconvolution.rate < 16.0 {
        let problem = format!("leaves {kept:.6} s of the response of {place}; check recording.latency");
        return Err(Error::input(place_of_key("response"), problem));
    }
    let gate = Gate::new(begin, kept, deconvolution.rate);
    let left = deconvolution.left(&gate, sweep);
    if let Some(lacking) = left.iter().position(|left| left.norm() < LEAST_LEFT) {
        let problem = format!(
            "has a reference that hardly holds {} Hz; sweep from below {} Hz to above {} Hz",
            sweep.frequencies()[lacking],
            sweep.start(),
            sweep.stop()
        );
        return Err(Error::input(place, problem));
    }
    // The noise is that of the stretch behind the response.
    let behind = gate.later(gate.weights.len() as i64);
    let end = (behind.first + behind.weights.len() as i64) as f64 / deconvolution.rate;
    let noise_is_known = end < longest;
    let gain = 10_f64.powf(options.gain_db / 20.0);
    let channels = source.file.channels();
    let columns: Vec<[Vec<Complex64>; 2]> = source
        .microphones
        .par_iter()
        .map(|channel| {
            let response = deconvolution.response(samples.iter().skip(*channel).step_by(channels).copied());
            let at = |gate: &Gate| deconvolution.at_tones(&response, gate, sweep);
            [at(&gate), if noise_is_known { at(&behind) } else { Vec::new() }]
        })
        .collect();
    for (place, [values, noise]) in columns.iter().enumerate() {
        for (n, value) in values.iter().enumerate() {
            let m = (value / left[n]).conj() / gain;
            let noise = noise.get(n).map_or(f64::NAN, |noise| (noise / left[n] / gain).norm_sqr());
            found.put(n, column + place, m, noise);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// A linear chirp from `from` to `to` Hz, and zeros.
    fn chirp([from, to]: [f64; 2], seconds: f64, rate: f64, count: usize) -> Vec<f64> {
        let sample = |k: usize| {
            let t = k as f64 / rate;
            let cycles = from * t + 0.5 * (to - from) / seconds * t * t;
            let edge = (t.min(seconds - t) / (0.05 * seconds)).clamp(0.0, 1.0);
            0.5 * edge * (TAU * cycles).sin()
        };
        (0..count).map(sample).collect()
    }

    #[test]
    fn blocks_of_tones_are_the_transform_as_written() {
        let sweep = Sweep::stepped(900.0, 1900.0, 100.0).expect("valid");
        let signal = chirp([500.0, 3000.0], 0.05, 8000.0, 400);
        let deconvolution = Deconvolution::new(&signal, 1024, 8000.0);
        let response = deconvolution.response(signal.iter().map(|x| *x as f32));
        let gate = Gate::new(0.001, 0.02, 8000.0);
        assert!(gate.first < 0 && gate.weights.iter().all(|w| (0.0..=1.0).contains(w)));
        let fast = deconvolution.at_tones(&response, &gate, &sweep);
        for (f, fast) in sweep.frequencies().iter().zip(fast) {
            let literal: Complex64 = (0..gate.weights.len())
                .map(|k| {
                    let t = gate.first + k as i64;
                    let value = response[t.rem_euclid(1024) as usize] * gate.weights[k];
                    value * Complex64::cis(-TAU * f * t as f64 / 8000.0)
                })
                .sum();
            assert!((fast - literal).norm() < 1e-12, "{f}: {fast} {literal}");
        }
    }

    #[test]
    fn a_delay_has_its_phase_also_at_the_ends_of_the_band() {
        let (rate, count) = (48_000.0, 24_000);
        let sweep = Sweep::stepped(10e3, 14e3, 62.5).expect("valid");
        // The chirp ends where the sweep does.
        let signal = chirp([9.8e3, 14.2e3], 0.3, rate, count);
        let deconvolution = Deconvolution::new(&signal, 32_768, rate);
        let delay = 217;
        let late: Vec<f32> =
            std::iter::repeat_n(0.0, delay).chain(signal.iter().map(|x| *x as f32)).take(count).collect();
        let response = deconvolution.response(late.into_iter());
        let gate = Gate::new(0.0, 0.016, rate);
        let left = deconvolution.left(&gate, &sweep);
        for ((f, m), left) in
            sweep.frequencies().iter().zip(deconvolution.at_tones(&response, &gate, &sweep)).zip(&left)
        {
            let expected = Complex64::cis(-TAU * f * delay as f64 / rate);
            assert!((m / left - expected).norm() < 0.02, "{f}: {} {expected}, {left}", m / left);
        }
    }
}
