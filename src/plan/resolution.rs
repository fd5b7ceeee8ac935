//! The width of a point's image, predicted without any data.
//!
//! Near a reflector at p every path length changes by `g_r·δ`, with `g_r` the gradient of the path to microphone r, so the
//! point-spread function along a direction e is the transform of one distribution, that of the spatial frequencies
//! `κ = f g_r·e/c`. It holds off the axis, for scans, for every window and for arrays that are not lattices, where the
//! textbook's `λ_c z/D` does not.

use crate::acquisition::Instrument;
use crate::reconstruct::Window;
use crate::wave::Geometry;
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Places of the distributions of slopes and of spatial frequencies. A place more or less shifts a phase by a few
/// thousandths of a turn within the main lobe.
const SLOPES: usize = 256;
const PLACES: usize = 2048;

/// Above this number tones are drawn together in as many places as there are of spatial frequencies.
const MOST_TONES: usize = 4096;

/// The point-spread function along one direction through its peak, as predicted.
#[derive(Debug, Clone)]
pub struct Profile {
    /// Weights of the spatial frequencies from `first` on, `pitch` cycles/m apart; their sum is 1.
    weights: Vec<f64>,
    pitch: f64,
    /// Width of the whole band of them, cycles/m.
    band: f64,
}

/// The weights of a window, which for a million microphones take longer than a profile.
pub(super) struct WindowWeights {
    sweep: Vec<f64>,
    array: Vec<f64>,
}

impl WindowWeights {
    pub(super) fn of(instrument: &Instrument, window: Window) -> Self {
        Self { sweep: window.over_sweep(&instrument.sweep), array: window.over_array(&instrument.array) }
    }
}

impl Instrument {
    /// The point-spread function of a reflector at `p` along `direction`; `None` where nothing changes along it.
    ///
    /// Cost: one pass over the microphones, over the tones, and over up to 4096 of these × 256.
    pub fn profile(&self, p: DVec3, direction: DVec3, window: Window) -> Option<Profile> {
        self.profile_by(p, direction, &WindowWeights::of(self, window))
    }

    fn profile_by(&self, p: DVec3, direction: DVec3, weights: &WindowWeights) -> Option<Profile> {
        let leg = |from: DVec3| (p - from).normalize_or_zero().dot(direction);
        let slopes_to = |geometry: Geometry| {
            let slope = move |(i, &r): (usize, &DVec3)| {
                let source = self.pair_sources.get(i).copied().unwrap_or_else(|| geometry.source_of(r));
                leg(source) + leg(r)
            };
            self.array.positions().par_iter().enumerate().map(slope).collect::<Vec<f64>>()
        };
        let slopes: Vec<f64> = self.geometries().flat_map(slopes_to).collect();
        let of_slopes =
            Histogram::of(SLOPES, slopes.iter().copied().zip(weights.array.iter().copied().cycle()));
        let tones = self.sweep.frequencies().iter().map(|f| f / self.sound_speed);
        let mut tones: Vec<(f64, f64)> = tones.zip(weights.sweep.iter().copied()).collect();
        if tones.len() > MOST_TONES {
            tones = Histogram::of(PLACES, tones.into_iter()).entries().collect();
        }
        let products = || {
            of_slopes
                .entries()
                .flat_map(|(slope, weight)| tones.iter().map(move |(tone, w)| (slope * tone, weight * w)))
        };
        let histogram = Histogram::of(PLACES, products());
        let total: f64 = histogram.weights.iter().sum();
        let band = histogram.pitch * (PLACES - 1) as f64;
        (band * self.wavelength() > 1e-6 && total > 0.0).then(|| Profile {
            weights: histogram.weights.iter().map(|w| w / total).collect(),
            pitch: histogram.pitch,
            band,
        })
    }

    /// Full widths of the point-spread function of a reflector at `p` along x, y and z where its amplitude falls
    /// `below_db` dB (3 or 6) below the peak, m.
    pub fn predicted_widths(&self, p: DVec3, window: Window, below_db: f64) -> [Option<f64>; 3] {
        self.widths_by(p, &WindowWeights::of(self, window), below_db)
    }

    pub(super) fn widths_by(&self, p: DVec3, weights: &WindowWeights, below_db: f64) -> [Option<f64>; 3] {
        DVec3::AXES.map(|axis| self.profile_by(p, axis, weights)?.width(below_db))
    }
}

impl Profile {
    /// Amplitude `t` m from the peak; 1 at the peak.
    pub fn amplitude(&self, t: f64) -> f64 {
        // Every phase against the first: a common phase is no matter.
        let [re, im] =
            self.weights.iter().enumerate().filter(|(_, w)| **w != 0.0).fold([0.0; 2], |[re, im], (i, w)| {
                let (sin, cos) = (TAU * i as f64 * self.pitch * t).sin_cos();
                [re + w * cos, im + w * sin]
            });
        re.hypot(im)
    }

    /// Full width where the amplitude falls `below_db` dB below the peak, m.
    pub fn width(&self, below_db: f64) -> Option<f64> {
        let level = 10_f64.powf(-below_db / 20.0);
        let step = 0.05 / self.band;
        let beyond = (1..2000).map(|i| f64::from(i) * step).find(|t| self.amplitude(*t) < level)?;
        let (mut near, mut far) = (beyond - step, beyond);
        for _ in 0..30 {
            let middle = f64::midpoint(near, far);
            if self.amplitude(middle) < level { far = middle } else { near = middle }
        }
        Some(2.0 * far)
    }

    /// Distance of the first minimum beside the peak, m: where the main lobe ends.
    pub fn main_lobe(&self) -> Option<f64> {
        let step = 0.05 / self.band;
        let mut before = 1.0;
        for i in 1..2000 {
            let amplitude = self.amplitude(f64::from(i) * step);
            // A shoulder high up is still the main lobe.
            if amplitude > before && before < 0.5 {
                return Some(f64::from(i - 1) * step);
            }
            before = amplitude;
        }
        None
    }
}

/// Weights by value, each shared between the two nearest of evenly spaced places.
pub(super) struct Histogram {
    first: f64,
    pitch: f64,
    weights: Vec<f64>,
}

impl Histogram {
    pub(super) fn of(places: usize, values: impl Iterator<Item = (f64, f64)> + Clone) -> Self {
        let (low, high) =
            values.clone().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (value, _)| {
                (low.min(value), high.max(value))
            });
        let pitch = (high - low) / (places - 1) as f64;
        let mut weights = vec![0.0; places];
        for (value, weight) in values {
            let place = if pitch > 0.0 { (value - low) / pitch } else { 0.0 };
            let i = (place as usize).min(places - 2);
            let share = (place - i as f64).clamp(0.0, 1.0);
            weights[i] += weight * (1.0 - share);
            weights[i + 1] += weight * share;
        }
        Self { first: low, pitch, weights }
    }

    /// Every place with weight, and how much.
    pub(super) fn entries(&self) -> impl Iterator<Item = (f64, f64)> + Clone + '_ {
        let place = |i: usize| self.first + self.pitch * i as f64;
        self.weights.iter().enumerate().filter(|(_, w)| **w != 0.0).map(move |(i, w)| (place(i), *w))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::test_instrument;
    use super::*;
    use crate::acquisition::Detection;

    /// On the axis and without a window the textbook holds: 0.886 λ_c z/D across, 0.886 c/2B in depth.
    #[test]
    fn on_the_axis_widths_are_the_textbooks() {
        let instrument = &test_instrument(31, 0.5, 50.0, Detection::Quadrature);
        let p = DVec3::new(0.0, 0.0, 1.2);
        let [x, y, z] = instrument.predicted_widths(p, Window::None, 3.0).map(|w| w.expect("a width"));
        let lateral = 0.886 * instrument.wavelength() * p.z / 0.5;
        assert!((x / lateral - 1.0).abs() < 0.08 && (y / x - 1.0).abs() < 1e-6, "{x} {lateral}");
        let depth = 0.886 * 343.0 / 2e4;
        assert!((z / depth - 1.0).abs() < 0.05, "{z} {depth}");
        let wide = instrument.predicted_widths(p, Window::Taylor, 3.0)[0].expect("a width");
        assert!((wide / x - 1.25).abs() < 0.08, "a window widens: {wide} {x}");
        assert!(instrument.predicted_widths(p, Window::None, 6.0)[0].expect("a width") > 1.2 * x);
    }

    /// A literal sum over tones and microphones of the same linear phases.
    #[test]
    fn a_profile_is_the_sum_it_stands_for() {
        let instrument = &test_instrument(9, 0.4, 500.0, Detection::Quadrature);
        let (p, e) = (DVec3::new(0.3, -0.1, 0.9), DVec3::new(0.6, 0.0, 0.8));
        let profile = instrument.profile(p, e, Window::Hann).expect("a profile");
        let weights =
            (Window::Hann.over_sweep(&instrument.sweep), Window::Hann.over_array(&instrument.array));
        for t in [0.0, 0.004, 0.011, 0.03] {
            let (mut re, mut im, mut sum) = (0.0, 0.0, 0.0);
            for (f, w_f) in instrument.sweep.frequencies().iter().zip(&weights.0) {
                for (r, w_r) in instrument.array.positions().iter().zip(&weights.1) {
                    let slope = (p.normalize() + (p - *r).normalize()).dot(e);
                    let (sin, cos) = (TAU * f / 343.0 * slope * t).sin_cos();
                    (re, im, sum) = (re + w_f * w_r * cos, im + w_f * w_r * sin, sum + w_f * w_r);
                }
            }
            let literal = f64::hypot(re, im) / sum;
            assert!((profile.amplitude(t) - literal).abs() < 2e-3, "{t}: {literal}");
        }
    }
}
