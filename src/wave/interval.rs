//! An interval of path lengths, and the frequencies of a sweep as functions on it.
//!
//! Skeletons and virtual tones are sampled at delays about the middle of such an interval, in f64.

use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// An interval of path lengths and the speed that converts them into delays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PathInterval {
    /// Minimum path length, m.
    pub(crate) shortest: f64,
    /// Maximum path length, m.
    pub(crate) longest: f64,
    /// c, m/s.
    pub(crate) sound_speed: f64,
}

impl PathInterval {
    /// Duration T of the interval, s.
    pub(crate) fn duration(&self) -> f64 {
        (self.longest - self.shortest).max(0.0) / self.sound_speed
    }

    /// Delay in the middle, s.
    pub(crate) fn middle(&self) -> f64 {
        f64::midpoint(self.shortest, self.longest) / self.sound_speed
    }

    /// Number of Chebyshev points that resolve a bandwidth (Hz) on the interval.
    pub(crate) fn points_for(&self, bandwidth: f64) -> usize {
        (1.7 * bandwidth * self.duration()).ceil() as usize + 36
    }

    /// The later `count` of twice as many Chebyshev points of the interval, as delays after its middle, s.
    pub(crate) fn chebyshev(&self, count: usize) -> Vec<f64> {
        let half = 0.5 * self.duration();
        (0..count).map(|k| half * chebyshev_point(k, 2 * count)).collect()
    }
}

/// The k-th of `count` Chebyshev points of −1 ..= 1, from the upper end downwards.
pub(crate) fn chebyshev_point(k: usize, count: usize) -> f64 {
    (PI * (k as f64 + 0.5) / count as f64).cos()
}

/// `e^{i2π·cycles}` in f64.
pub(crate) fn phasor_f64(cycles: f64) -> Complex64 {
    Complex64::cis(TAU * (cycles - cycles.round()))
}

/// The larger of two errors; NaN if one is NaN, so that a failed solution is never taken for a good one.
pub(crate) fn greater(a: f64, b: f64) -> f64 {
    if a >= b || a.is_nan() { a } else { b }
}
