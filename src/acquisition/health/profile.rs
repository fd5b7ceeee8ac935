//! The range profile: the inverse transform of a microphone's samples over frequency, its mean power, its peaks and its
//! noise.

use super::quantile;
use crate::acquisition::profile::{ProfilePeak, SweepTransform, decibels, local_maxima, unambiguous_path};
use crate::acquisition::{Detection, Instrument};
use num_complex::Complex32;
use serde::Serialize;
use std::f64::consts::TAU;

/// The mean over microphones of the power of their range profiles.
///
/// The profile of a microphone is `Σ_f w_f m(f) e^{−i2πf·path/c} / Σ w_f` with a Blackman–Harris window, whose sidelobes are
/// 92 dB down: a single echo of amplitude 1 peaks at 1 in quadrature, at ¼ of the power in phase.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct MeanProfile {
    /// The longest path that the step of the frequencies tells apart, m: c/δf in quadrature, beyond which paths begin anew,
    /// and half of that in phase, beyond which they run back.
    pub unambiguous_path: f64,
    /// From one value to the next, m of range; the first is at 0. Range here is half of the path.
    pub range_pitch: f64,
    /// Mean power, n_f values over the unambiguous path; in phase the first half of them.
    pub power: Vec<f64>,
    /// The strongest peaks, at most five, strongest first; those within 40 dB of the first and 6 dB above the median.
    pub peaks: Vec<ProfilePeak>,
}

/// The noise of a cube.
///
/// Echoes end somewhere, noise that is independent between tones does not: it has the same power at all paths. So the noise
/// is the 25 % quantile of the mean range profile, corrected for how far the quantile of a mean of exponentially distributed
/// powers lies below their mean. The signal is the mean |m|² less the noise. It is too pessimistic where echoes or sounds
/// that all microphones hear alike fill three quarters of the unambiguous path.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct NoiseEstimate {
    /// Mean |signal|² against mean |noise|² per sample, dB, as `detection.snr_db` of a simulation; `None` where there is
    /// no more power than noise.
    pub snr_db: Option<f64>,
    /// Whether the true ratio is that or more: the lowest quarter of the profile is not level, so it is not noise alone, or
    /// it is as low as the window's sidelobes.
    pub at_least: bool,
    /// The noise's rms of a sample (of both phases in quadrature).
    pub noise_rms: f64,
}

/// Fewer tones give no profile: the peak of an echo would be half of it.
const FEWEST_TONES: usize = 16;

/// The share of the profile that is taken for noise.
const NOISE_SHARE: f64 = 0.25;

/// The noise is level if the 5 % quantile lies at most this much farther below than that of noise alone would, dB.
const LEVEL_DB: f64 = 1.5;

/// Sidelobes of the window, with a margin, dB.
const SIDELOBES_DB: f64 = -85.0;

/// Peaks that are shown: how many, how far below the first, and how far above the median, dB.
const PEAKS: (usize, f64, f64) = (5, 40.0, 6.0);

/// Why there is no range profile.
pub(super) fn obstacle(instrument: &Instrument, microphones: usize) -> Option<&'static str> {
    let sweep = &instrument.sweep;
    if sweep.len() < FEWEST_TONES {
        Some("fewer than 16 frequencies do not tell echoes from noise")
    } else if sweep.step().is_none() {
        Some(
            "the frequencies are not evenly spaced, so that sidelobes hide the noise and no path is ambiguous",
        )
    } else if microphones == 0 {
        Some("no microphone has usual samples that fit in memory")
    } else {
        None
    }
}

/// The four-term Blackman–Harris window of `n` samples.
pub(super) fn window(n: usize) -> Vec<f64> {
    let cosines = |i: usize| {
        let turn = TAU * (i as f64 + 0.5) / n as f64;
        0.35875 - 0.48829 * turn.cos() + 0.14128 * (2.0 * turn).cos() - 0.01168 * (3.0 * turn).cos()
    };
    (0..n).map(cosines).collect()
}

/// The mean profile of `columns`, `[microphone, n_f]`.
pub(super) fn mean(instrument: &Instrument, columns: &[Complex32]) -> MeanProfile {
    let n_f = instrument.sweep.len();
    let transform = SweepTransform::new(instrument, &window(n_f), 1);
    let mut power = transform.mean_power(columns);
    let mut path = unambiguous_path(instrument);
    let range_pitch = path / n_f as f64 / 2.0;
    if instrument.detection == Detection::InPhase {
        power.truncate(n_f / 2 + 1);
        path *= 0.5;
    }
    MeanProfile { unambiguous_path: path, range_pitch, peaks: peaks(&power, range_pitch), power }
}

/// The strongest local maxima.
fn peaks(power: &[f64], pitch: f64) -> Vec<ProfilePeak> {
    let (most, below, above) = PEAKS;
    let floor = quantile(power.iter().copied(), 0.5).and_then(decibels).unwrap_or(f64::NEG_INFINITY) + above;
    let mut peaks = local_maxima(power, pitch, floor);
    let strongest = peaks.first().map_or(0.0, |peak| peak.level_db);
    peaks.retain(|peak| peak.level_db >= strongest - below);
    peaks.truncate(most);
    peaks
}

/// The noise of the microphones with these columns.
pub(super) fn noise(profile: &MeanProfile, columns: &[Complex32], instrument: &Instrument) -> NoiseEstimate {
    let n_f = instrument.sweep.len();
    let window = window(n_f);
    let (sum, squares) = window.iter().fold((0.0, 0.0), |(sum, squares), w| (sum + w, squares + w * w));
    // White noise of power 1 per sample has this power in the profile.
    let per_sample = squares / (sum * sum);
    let averaged = (columns.len() / n_f) as f64;
    let at = |share: f64| quantile(profile.power.iter().copied(), share).unwrap_or(0.0);
    let noise = at(NOISE_SHARE) / mean_quantile(averaged, -0.674_49);
    let lowest = at(0.05) / mean_quantile(averaged, -1.644_85);
    let level = decibels(noise / lowest).is_some_and(|db| db <= LEVEL_DB);
    let noise = noise / per_sample;
    let square = |m: &Complex32| f64::from(m.re).powi(2) + f64::from(m.im).powi(2);
    let power = columns.iter().map(square).sum::<f64>() / columns.len() as f64;
    // Of one echo, sidelobes look like noise this far below it.
    let deepest = -SIDELOBES_DB + 10.0 * per_sample.log10();
    let snr_db = decibels((power - noise) / noise).unwrap_or(if noise == 0.0 { deepest } else { f64::NAN });
    NoiseEstimate {
        snr_db: Some(snr_db.min(deepest)).filter(|_| !snr_db.is_nan()),
        at_least: !snr_db.is_nan() && (!level || snr_db >= deepest),
        noise_rms: noise.sqrt(),
    }
}

/// A quantile of the mean of `n` exponentially distributed numbers of mean 1, by Wilson and Hilferty's cube root; `normal`
/// is that of the normal distribution.
fn mean_quantile(n: f64, normal: f64) -> f64 {
    let root = 1.0 - 1.0 / (9.0 * n) + normal / (3.0 * n.sqrt());
    // For a single one the root of the lowest quantile is the least accurate, 0.34 instead of 0.37, but positive.
    root.powi(3)
}
