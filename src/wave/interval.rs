//! An interval of path lengths, and the tones of a sweep as functions on it.
//!
//! What stands under skeleton frequencies: the matrix `e^{−i2πfτ}` of tones on sample delays of an interval, in f64.

use faer::{Mat, c64};
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// An interval of path lengths and the speed that turns them into delays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathInterval {
    /// Least path length, m.
    pub shortest: f64,
    /// Greatest path length, m.
    pub longest: f64,
    /// c, m/s.
    pub sound_speed: f64,
}

impl PathInterval {
    /// Duration T of the interval, s.
    pub fn duration(&self) -> f64 {
        (self.longest - self.shortest).max(0.0) / self.sound_speed
    }

    /// Delay in the middle, s.
    pub(crate) fn middle(&self) -> f64 {
        f64::midpoint(self.shortest, self.longest) / self.sound_speed
    }

    /// How many Chebyshev points resolve a bandwidth (Hz) on the interval.
    pub(crate) fn points_for(&self, bandwidth: f64) -> usize {
        (1.7 * bandwidth * self.duration()).ceil() as usize + 36
    }

    /// `count` Chebyshev points of the interval, as delays about its middle, s.
    pub(crate) fn chebyshev(&self, count: usize) -> Vec<f64> {
        let half = 0.5 * self.duration();
        (0..count).map(|k| half * chebyshev_point(k, count)).collect()
    }

    /// `E[k, n] = e^{−i2π(f_n − carrier)(τ_k + later)}` at `count` even points of the interval as [`PathInterval::even`]
    /// gives them, and at any frequencies.
    pub(crate) fn even_tones(&self, count: usize, later: f64, frequencies: &[f64], carrier: f64) -> Mat<c64> {
        let (first, step) = (later - 0.5 * self.duration(), self.duration() / (count - 1) as f64);
        let mut all = Mat::zeros(count, frequencies.len());
        for (n, f) in frequencies.iter().enumerate() {
            // By products, which drift by no more than some 10⁻¹³: a sine for every element would take longer than what
            // it is used for.
            let [mut start, turn] = [first, step].map(|delay| turned((carrier - f) * delay));
            let mut short = [Complex64::ONE; RUN];
            for k in 1..RUN {
                short[k] = short[k - 1] * turn;
            }
            for elements in all.col_as_slice_mut(n).chunks_mut(RUN) {
                elements.iter_mut().zip(&short).for_each(|(z, short)| *z = start * short);
                start *= short[RUN - 1] * turn;
            }
        }
        all
    }

    /// `count` even points of the interval, both ends included, as delays about its middle, s.
    #[cfg(test)]
    pub(crate) fn even(&self, count: usize) -> Vec<f64> {
        let half = 0.5 * self.duration();
        (0..count).map(|k| half * (2.0 * k as f64 / (count - 1) as f64 - 1.0)).collect()
    }
}

/// The k-th of `count` Chebyshev points of −1 ..= 1, from the upper end downwards.
pub(crate) fn chebyshev_point(k: usize, count: usize) -> f64 {
    (PI * (k as f64 + 0.5) / count as f64).cos()
}

/// Even points whose phasors are one phasor times those of a short run.
const RUN: usize = 32;

/// `E[k, n] = e^{−i2π(f_n − carrier)τ_k}`, delays in s, frequencies in Hz.
pub(crate) fn tone_matrix(delays: &[f64], frequencies: &[f64], carrier: f64) -> Mat<c64> {
    let column = |frequency: f64| -> Vec<Complex64> {
        delays.iter().map(|delay| turned(-frequency * delay)).collect()
    };
    let mut all = Mat::zeros(delays.len(), frequencies.len());
    let (mut tone, mut step, mut turns) = (Vec::new(), 0.0, Vec::new());
    for (n, &f) in frequencies.iter().enumerate() {
        // Even steps turn each column into the next; now and then one is computed afresh, so that nothing drifts.
        if n % 64 == 0 {
            tone = column(f - carrier);
        } else {
            let next = f - frequencies[n - 1];
            if (next - step).abs() > 1e-9 * next {
                (step, turns) = (next, column(next));
            }
            for (z, turn) in tone.iter_mut().zip(&turns) {
                *z *= turn;
            }
        }
        all.col_as_slice_mut(n).copy_from_slice(&tone);
    }
    all
}

/// `e^{i2π·cycles}` in f64.
pub(crate) fn turned(cycles: f64) -> Complex64 {
    Complex64::cis(TAU * (cycles - cycles.round()))
}

/// The greater of two errors; NaN if one is NaN, so that a failed solution is never taken for a good one.
pub(crate) fn greater(a: f64, b: f64) -> f64 {
    if a >= b || a.is_nan() { a } else { b }
}

/// The greatest modulus of the elements; NaN if one is NaN.
pub(crate) fn greatest(matrix: &Mat<c64>) -> f64 {
    let squares = (0..matrix.ncols()).flat_map(|n| matrix.col_as_slice(n)).map(Complex64::norm_sqr);
    squares.fold(0.0, greater).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_is_the_greatest_of_all() {
        let of = |values: [f64; 3]| greatest(&Mat::from_fn(3, 1, |k, _| Complex64::from(values[k])));
        assert_eq!(of([1.0, -3.0, 2.0]), 3.0);
        for i in 0..3 {
            let mut values = [1.0, 2.0, 3.0];
            values[i] = f64::NAN;
            assert!(of(values).is_nan());
        }
    }

    #[test]
    fn tones_are_the_literal_ones_for_even_and_uneven_sweeps() {
        let interval = PathInterval { shortest: 1.0, longest: 3.0, sound_speed: 343.0 };
        let delays = interval.even(9);
        for uneven in [0.0, 3.7] {
            let frequencies: Vec<f64> =
                (0..300).map(|n| 10_000.0 + 10.0 * f64::from(n) + uneven * f64::from(n % 5)).collect();
            let all = tone_matrix(&delays, &frequencies, 11_000.0);
            let many = interval.even(99);
            let later = interval.even_tones(99, 0.007, &frequencies, 11_000.0);
            for (n, f) in frequencies.iter().enumerate().step_by(23) {
                for (k, delay) in many.iter().enumerate() {
                    let exact = Complex64::cis(-TAU * (f - 11_000.0) * (delay + 0.007));
                    assert!((later[(k, n)] - exact).norm() < 1e-10);
                }
            }
            for (n, f) in frequencies.iter().enumerate() {
                for (k, delay) in delays.iter().enumerate() {
                    let exact = Complex64::cis(-TAU * (f - 11_000.0) * delay);
                    assert!((all[(k, n)] - exact).norm() < 1e-10);
                }
            }
        }
    }
}
