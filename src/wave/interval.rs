//! An interval of path lengths, and the tones of a sweep as functions on it.
//!
//! What stands under skeleton and virtual tones: `e^{−i2πfδ}` at sample delays δ about the middle of an interval, in f64.
//! Least squares on an interval that is symmetric about zero has real coefficients, and then cos and sin of δ ≥ 0 say all:
//! an error at −δ is the conjugate of that at δ. So matrices are real, and a quarter of the work.

use crate::wave::simd::{self, leave_wide_registers};
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{Mat, Par};
use num_complex::Complex64;
use std::f64::consts::{PI, TAU};

/// An interval of path lengths and the speed that turns them into delays.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PathInterval {
    /// Least path length, m.
    pub(crate) shortest: f64,
    /// Greatest path length, m.
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

    /// How many Chebyshev points resolve a bandwidth (Hz) on the interval.
    pub(crate) fn points_for(&self, bandwidth: f64) -> usize {
        (1.7 * bandwidth * self.duration()).ceil() as usize + 36
    }

    /// The later `count` of twice as many Chebyshev points of the interval, as delays after its middle, s.
    pub(crate) fn chebyshev(&self, count: usize) -> Vec<f64> {
        let half = 0.5 * self.duration();
        (0..count).map(|k| half * chebyshev_point(k, 2 * count)).collect()
    }

    /// [`waves`] at `count` even delays from the interval's middle to its end.
    pub(crate) fn even_waves(&self, count: usize, frequencies: &[f64]) -> Mat<f64> {
        let step = 0.5 * self.duration() / (count - 1) as f64;
        let mut all = Mat::zeros(2 * count, frequencies.len());
        for (n, f) in frequencies.iter().enumerate() {
            // By products, which drift by no more than some 10⁻¹³: a sine for every element would take longer than what
            // it is used for.
            let turn = turned(f * step);
            let (mut start, mut short) = (Complex64::ONE, [Complex64::ONE; RUN]);
            for k in 1..RUN {
                short[k] = short[k - 1] * turn;
            }
            let (cos, sin) = all.col_as_slice_mut(n).split_at_mut(count);
            for (cos, sin) in cos.chunks_mut(RUN).zip(sin.chunks_mut(RUN)) {
                for ((cos, sin), short) in cos.iter_mut().zip(sin).zip(&short) {
                    let z = start * short;
                    (*cos, *sin) = (z.re, z.im);
                }
                start *= short[RUN - 1] * turn;
            }
        }
        all
    }
}

/// The k-th of `count` Chebyshev points of −1 ..= 1, from the upper end downwards.
pub(crate) fn chebyshev_point(k: usize, count: usize) -> f64 {
    (PI * (k as f64 + 0.5) / count as f64).cos()
}

/// Even points whose phasors are one phasor times those of a short run.
const RUN: usize = 32;

/// cos 2πfδ and under them sin 2πfδ, `[2·delays, frequencies]`: delays in s, frequencies in Hz.
pub(crate) fn waves(delays: &[f64], frequencies: &[f64]) -> Mat<f64> {
    let mut all = Mat::zeros(2 * delays.len(), frequencies.len());
    for (n, f) in frequencies.iter().enumerate() {
        let (cos, sin) = all.col_as_slice_mut(n).split_at_mut(delays.len());
        simd::waves(*f, delays, cos, sin);
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

/// The greatest modulus of differences of [`waves`]; NaN if one is NaN.
pub(crate) fn greatest(differences: &Mat<f64>) -> f64 {
    let square = |(cos, sin): (&f64, &f64)| cos * cos + sin * sin;
    let columns =
        (0..differences.ncols()).map(|n| differences.col_as_slice(n).split_at(differences.nrows() / 2));
    columns.flat_map(|(cos, sin)| cos.iter().zip(sin)).map(square).fold(0.0, greater).sqrt()
}

/// Least squares in the columns of one matrix, factored once.
#[derive(Debug, Clone)]
pub(crate) struct LeastSquares {
    q: Mat<f64>,
    r: Mat<f64>,
}

impl LeastSquares {
    /// For weights of the columns of `basis`, which are independent.
    pub(crate) fn new(basis: &Mat<f64>) -> Self {
        // By an explicit Q: for many right-hand sides a product is far cheaper than as many reflections.
        let qr = basis.qr();
        let (q, r) = (qr.compute_thin_Q(), qr.thin_R().to_owned());
        leave_wide_registers();
        Self { q, r }
    }

    /// For weights that stay small where columns are nearly dependent: their squares count `damping`² times beside those
    /// of the residual, and so what is left of that is at most `damping` times their size.
    pub(crate) fn damped(basis: &Mat<f64>, damping: f64) -> Self {
        let (rows, columns) = basis.shape();
        let damped = Mat::from_fn(rows + columns, columns, |k, a| match k.checked_sub(rows) {
            None => basis[(k, a)],
            Some(below) => {
                if below == a {
                    damping
                } else {
                    0.0
                }
            }
        });
        let Self { q, r } = Self::new(&damped);
        Self { q: q.subrows(0, rows).to_owned(), r }
    }

    /// The weights, `[columns of the basis, columns]`, for which `basis · weights` is nearest to `columns`.
    pub(crate) fn solve(&self, columns: &Mat<f64>) -> Mat<f64> {
        let mut weights = self.q.transpose() * columns;
        solve_upper_triangular_in_place(self.r.as_ref(), weights.as_mut(), Par::Seq);
        leave_wide_registers();
        weights
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_is_the_greatest_of_all() {
        let of = |values: [f64; 4]| greatest(&Mat::from_fn(4, 1, |k, _| values[k]));
        assert_eq!(of([1.0, -3.0, 2.0, 4.0]), 5.0);
        for i in 0..4 {
            let mut values = [1.0, 2.0, 3.0, 4.0];
            values[i] = f64::NAN;
            assert!(of(values).is_nan());
        }
    }

    #[test]
    fn waves_are_the_literal_ones_for_even_and_uneven_sweeps() {
        let interval = PathInterval { shortest: 1.0, longest: 3.0, sound_speed: 343.0 };
        let even: Vec<f64> = (0..99).map(|k| interval.duration() / 196.0 * f64::from(k)).collect();
        for uneven in [0.0, 3.7] {
            let frequencies: Vec<f64> =
                (0..300).map(|n| 10.0 * f64::from(n) + uneven * f64::from(n % 5) - 1_000.0).collect();
            for (delays, all) in [
                (&interval.chebyshev(17), waves(&interval.chebyshev(17), &frequencies)),
                (&even, interval.even_waves(99, &frequencies)),
            ] {
                assert_eq!(all.shape(), (2 * delays.len(), 300));
                for (n, f) in frequencies.iter().enumerate() {
                    for (k, delay) in delays.iter().enumerate() {
                        let (sin, cos) = (TAU * f * delay).sin_cos();
                        let (re, im) = (all[(k, n)], all[(delays.len() + k, n)]);
                        assert!((re - cos).hypot(im - sin) < 1e-10);
                    }
                }
            }
        }
    }

    #[test]
    fn damped_weights_are_small_where_columns_are_nearly_the_same() {
        let delays: Vec<f64> = (0..12).map(|k| f64::from(k) / 24.0).collect();
        let right = waves(&delays, &[0.9]);
        for spacing in [0.4, 1e-3, 1e-7, 0.0] {
            let basis = waves(&delays, &[1.0 - spacing, 1.0, 1.0 + spacing]);
            let weights = LeastSquares::damped(&basis, 1e-9).solve(&right);
            assert!((0..3).all(|a| weights[(a, 0)].abs() < 1e7), "{weights:?}");
            let left = greatest(&(&basis * &weights - &right));
            let plain = PI * 0.1;
            assert!(left < if spacing > 0.1 { 0.05 } else { plain }, "{spacing}: {left}");
            if spacing > 1e-4 {
                let exact = LeastSquares::new(&basis).solve(&right);
                assert!(greatest(&(&basis * (&weights - &exact))) < 1e-6);
            }
        }
    }
}
