//! The latency of a recording, as the direct wave from the speaker to the microphones tells it.

use crate::acquisition::Instrument;
use crate::error::{Error, Result};
use crate::wave::interval::phasor_f64;
use num_complex::{Complex32, Complex64};
use rustfft::FftPlanner;
use std::f64::consts::PI;

use super::options::place_of_key;

/// How many times as fine as 1/B the first search is.
const FINER: usize = 4;

/// Times before 0 that a latency may have, as a part of the time after which tones repeat.
const BEFORE: f64 = 0.125;

/// Narrowing by the golden ratio, this often, makes 1/B into 10⁻⁹ of it.
const NARROWINGS: usize = 44;

/// A latency that was found.
#[derive(Debug, Clone, Copy)]
pub(super) struct FoundLatency {
    /// s.
    pub(super) seconds: f64,
    /// The part of the samples' power that a wave of this delay explains, 0 to 1.
    pub(super) share: f64,
}

/// Lengths of the direct wave's paths, from the speaker to each microphone, m.
pub(super) fn direct_paths(instrument: &Instrument) -> Vec<f64> {
    let each = instrument.array.positions().iter().enumerate();
    each.map(|(i, r)| r.distance(instrument.geometry_of(i).source_of(*r))).collect()
}

/// Finds the delay, over that of the direct wave, at which the microphones have the most power together: there all direct
/// waves are, and echoes are not.
///
/// `samples` are `[n_f, n_mic]`; `around` is where to look, within a few 1/B, or anywhere before tones repeat after 1/δf.
///
/// # Errors
/// Frequencies that are fewer than 8 or not evenly spaced, silent samples.
pub(super) fn direct_latency(
    samples: &[Complex32],
    instrument: &Instrument,
    around: Option<f64>,
) -> Result<FoundLatency> {
    let sweep = &instrument.sweep;
    let n_f = sweep.len();
    let place = place_of_key("latency");
    let Some(step) = sweep.step().filter(|_| n_f >= 8) else {
        let problem = "is \"direct\", which needs 8 or more evenly spaced frequencies; give it in s";
        return Err(Error::input(place, problem));
    };
    // Samples of each microphone without its direct path, under a Hann window.
    let window: Vec<f64> = (0..n_f).map(|n| (PI * (n as f64 + 0.5) / n_f as f64).sin().powi(2)).collect();
    let paths = direct_paths(instrument);
    let columns: Vec<Vec<Complex64>> = paths
        .iter()
        .enumerate()
        .map(|(mic, path)| {
            let tone = |n: usize| {
                let m = samples[n * paths.len() + mic];
                let back = phasor_f64(-sweep.frequencies()[n] * path / instrument.sound_speed);
                Complex64::new(m.re.into(), m.im.into()) * back * window[n]
            };
            (0..n_f).map(tone).collect()
        })
        .collect();
    let cell = 1.0 / (sweep.bandwidth() + step);
    let mut at = around.unwrap_or_else(|| strongest(&columns, step));
    let power = |at: f64| -> f64 {
        let focused = |column: &Vec<Complex64>| {
            let turned = column.iter().zip(sweep.frequencies()).map(|(m, f)| m * phasor_f64(-f * at));
            turned.sum::<Complex64>().norm_sqr()
        };
        columns.iter().map(focused).sum()
    };
    // The main lobe is 4 cells wide under that window, so that one cell about its top has no other maximum.
    let (mut low, mut high) = (at - cell, at + cell);
    let ratio = (5_f64.sqrt() - 1.0) / 2.0;
    let inner = |low: f64, high: f64| [high - ratio * (high - low), low + ratio * (high - low)];
    let [mut a, mut b] = inner(low, high);
    let (mut power_a, mut power_b) = (power(a), power(b));
    for _ in 0..NARROWINGS {
        if power_a > power_b {
            (high, b, power_b) = (b, a, power_a);
            a = inner(low, high)[0];
            power_a = power(a);
        } else {
            (low, a, power_a) = (a, b, power_b);
            b = inner(low, high)[1];
            power_b = power(b);
        }
    }
    at = f64::midpoint(low, high);
    // By Schwarz's inequality this is the most that a wave could give.
    let weights: f64 = window.iter().sum();
    let all: f64 = columns
        .iter()
        .map(|column| {
            let weighted = column.iter().zip(&window).map(|(m, w)| m.norm_sqr() / w).sum::<f64>();
            weighted * weights
        })
        .sum();
    if all <= 0.0 {
        return Err(Error::input(place, "is \"direct\", and the recording is silent; give it in s"));
    }
    Ok(FoundLatency { seconds: at, share: power(at) / all })
}

/// Where the mean power over the microphones is greatest, to a fraction of 1/B, s.
fn strongest(columns: &[Vec<Complex64>], step: f64) -> f64 {
    let n_f = columns.first().map_or(0, Vec::len);
    let length = (FINER * n_f).next_power_of_two();
    let transform = FftPlanner::<f64>::new().plan_fft_forward(length);
    let mut power = vec![0.0; length];
    for column in columns {
        let mut column = column.clone();
        column.resize(length, Complex64::ZERO);
        // The transform of exp(+i2πfτ) has its peak at τ.
        transform.process(&mut column);
        power.iter_mut().zip(&column).for_each(|(sum, value)| *sum += value.norm_sqr());
    }
    let peak = (0..length).max_by(|a, b| power[*a].total_cmp(&power[*b])).unwrap_or(0);
    let fraction = peak as f64 / length as f64;
    (if fraction > 1.0 - BEFORE { fraction - 1.0 } else { fraction }) / step
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::acquisition::{MicArray, Sweep};
    use crate::named::assert_names;
    use crate::wave::Geometry;
    use glam::DVec3;

    /// A direct wave that comes `latency` seconds late, and an echo of 0.3.
    fn heard(instrument: &Instrument, latency: f64) -> Vec<Complex32> {
        let c = instrument.sound_speed;
        let paths = direct_paths(instrument);
        let all = instrument.sweep.frequencies().iter().flat_map(|f| {
            let echo = |r: &DVec3| {
                let path = DVec3::new(0.1, 0.2, 1.5).length() + r.distance(DVec3::new(0.1, 0.2, 1.5));
                0.3 * phasor_f64(f * (path / c + latency))
            };
            let direct = paths.iter().map(|path| phasor_f64(f * (path / c + latency)));
            direct.zip(instrument.array.positions()).map(|(wave, r)| wave + echo(r)).collect::<Vec<_>>()
        });
        all.map(|m| Complex32::new(m.re as f32, m.im as f32)).collect()
    }

    #[test]
    fn the_direct_wave_tells_the_latency_also_beside_an_echo() {
        let array = MicArray::rectangular([5, 4], [0.1, 0.08], DVec3::ZERO).unwrap();
        let sweep = Sweep::stepped(10e3, 14e3, 50.0).unwrap();
        let source = Geometry::FixedSource { source: DVec3::new(0.4, 0.0, 0.0) };
        let instrument = Instrument::new(sweep, array.clone()).with_geometry(source);
        for latency in [0.0, 0.003_217, 0.011_1, -0.000_7] {
            let found = direct_latency(&heard(&instrument, latency), &instrument, None).unwrap();
            // 1 μs is 4° at 12 kHz, and 0.17 mm of depth.
            assert!((found.seconds - latency).abs() < 1e-6, "{latency}: {found:?}");
            assert!((0.8..1.0).contains(&found.share), "{found:?}");
            let near =
                direct_latency(&heard(&instrument, latency), &instrument, Some(latency + 5e-5)).unwrap();
            assert!((near.seconds - found.seconds).abs() < 1e-9, "{near:?} {found:?}");
        }
        let few = Instrument::new(Sweep::stepped(10e3, 10.2e3, 50.0).unwrap(), array);
        let error = direct_latency(&[Complex32::ONE; 100], &few, None).unwrap_err();
        assert_names(error.to_string(), &["[recording] latency", "8", "in s"]);
        let silent = vec![Complex32::ZERO; 81 * 20];
        assert_names(direct_latency(&silent, &instrument, None).unwrap_err().to_string(), &["silent"]);
    }
}
