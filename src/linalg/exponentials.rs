//! Exponentials of a sweep as columns of real matrices.
//!
//! The basis of skeleton and virtual tones: `e^{−i2πfδ}` at sample delays δ about the middle of an interval, in f64.
//! Least squares on an interval that is symmetric about zero has real coefficients, so cos and sin of δ ≥ 0 suffice:
//! an error at −δ is the conjugate of that at δ. Matrices are therefore real, which takes a quarter of the work.

use super::Matrix;
use crate::wave::interval::{PathInterval, greater, phasor_f64};
use crate::wave::simd;
use num_complex::Complex64;

/// cos 2πfδ and below them sin 2πfδ, `[2·delays, frequencies]`: delays in s, frequencies in Hz.
pub(crate) fn waves(delays: &[f64], frequencies: &[f64]) -> Matrix {
    let mut all = Matrix::zeros(2 * delays.len(), frequencies.len());
    for (n, f) in frequencies.iter().enumerate() {
        let (cos, sin) = all.col_as_slice_mut(n).split_at_mut(delays.len());
        simd::waves(*f, delays, cos, sin);
    }
    all
}

/// Evenly spaced points per run; the phasors of a run are those of the first one times a phasor.
const RUN: usize = 32;

/// [`waves`] at `count` even delays from an interval's middle to its end.
pub(crate) fn even_waves(interval: &PathInterval, count: usize, frequencies: &[f64]) -> Matrix {
    let step = 0.5 * interval.duration() / (count - 1) as f64;
    let mut all = Matrix::zeros(2 * count, frequencies.len());
    for (n, f) in frequencies.iter().enumerate() {
        // By products, which drift by no more than about 10⁻¹³: a sine for every element would take longer than the
        // work that uses it.
        let turn = phasor_f64(f * step);
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

/// The maximum modulus of differences of [`waves`]; NaN if one is NaN.
pub(crate) fn max_modulus(differences: &Matrix) -> f64 {
    let square = |(cos, sin): (&f64, &f64)| cos * cos + sin * sin;
    let columns =
        (0..differences.ncols()).map(|n| differences.col_as_slice(n).split_at(differences.nrows() / 2));
    columns.flat_map(|(cos, sin)| cos.iter().zip(sin)).map(square).fold(0.0, greater).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn nan_is_the_greatest_of_all() {
        let of = |values: [f64; 4]| max_modulus(&Matrix::from_fn(4, 1, |k, _| values[k]));
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
                (&even, even_waves(&interval, 99, &frequencies)),
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
}
