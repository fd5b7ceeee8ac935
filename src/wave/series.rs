//! Chebyshev series: smooth factors of one variable, evaluated in f32, block by block.

#![allow(clippy::inline_always)]

use super::simd::{LANES, dispatched};
use std::f64::consts::PI;

/// A function of one variable on an interval as a Chebyshev series.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Series {
    coefficients: Vec<f32>,
    middle: f32,
    per_half: f32,
}

/// Number of nodes at which a function is sampled. Its series has at most half as many terms, so the others show its error.
const NODES: usize = 96;

/// Bound of the sum of the terms that are left out.
const NEGLIGIBLE: f64 = 3e-8;

impl Series {
    /// The series of `f` on `[low, high]` to within 3·10⁻⁸ (f32 aside); `None` if it needs more than 48 terms.
    pub(crate) fn fit(f: impl Fn(f64) -> f64, low: f64, high: f64) -> Option<Self> {
        let (middle, half) = (f64::midpoint(low, high), 0.5 * (high - low));
        let angle = |i: usize| PI * (i as f64 + 0.5) / NODES as f64;
        let values: Vec<f64> = (0..NODES).map(|i| f(middle + half * angle(i).cos())).collect();
        let mut coefficients: Vec<f64> = (0..NODES)
            .map(|k| {
                let wave = values.iter().enumerate().map(|(i, v)| v * (k as f64 * angle(i)).cos());
                wave.sum::<f64>() * if k == 0 { 1.0 } else { 2.0 } / NODES as f64
            })
            .collect();
        let mut left_out = 0.0;
        while coefficients.len() > 1 {
            left_out += coefficients[coefficients.len() - 1].abs();
            if left_out > NEGLIGIBLE || left_out.is_nan() {
                break;
            }
            coefficients.pop();
        }
        let fine = coefficients.len() <= NODES / 2 && coefficients.iter().all(|c| c.is_finite());
        fine.then(|| Self {
            coefficients: coefficients.iter().map(|c| *c as f32).collect(),
            middle: middle as f32,
            per_half: if half > 0.0 { (1.0 / half) as f32 } else { 0.0 },
        })
    }

    /// Multiplies each factor by the series at its `x`.
    ///
    /// # Panics
    /// When the lengths of the planes differ or are not multiples of 16.
    pub(crate) fn multiply(&self, x: &[f32], factors: &mut [f32]) {
        multiply_series(&self.coefficients, [self.middle, self.per_half], x, factors);
    }
}

#[inline(always)]
fn multiply_series_body(coefficients: &[f32], place: [f32; 2], x: &[f32], factors: &mut [f32]) {
    assert!(x.len() == factors.len() && x.len().is_multiple_of(LANES), "whole lanes of equal length");
    let (x, _) = x.as_chunks::<LANES>();
    let (factors, _) = factors.as_chunks_mut::<LANES>();
    let Some((first, rest)) = coefficients.split_first() else { return };
    for (x, factors) in x.iter().zip(factors) {
        // Clenshaw's recurrence, which is stable in f32.
        let (mut t, mut b1, mut b2) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
        for l in 0..LANES {
            t[l] = (x[l] - place[0]) * place[1];
        }
        for c in rest.iter().rev() {
            for l in 0..LANES {
                let b = 2.0 * t[l] * b1[l] - b2[l] + c;
                b2[l] = b1[l];
                b1[l] = b;
            }
        }
        for l in 0..LANES {
            factors[l] *= t[l] * b1[l] - b2[l] + first;
        }
    }
}

dispatched! {
    /// `factors *= Σ c_k T_k((x − middle) · per_half)`, element by element.
    fn multiply_series = multiply_series_body(
        coefficients: &[f32], place: [f32; 2], x: &[f32], factors: &mut [f32],
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wave::piston::piston;

    #[test]
    fn a_series_is_the_function_on_its_interval() {
        let checked = |f: &dyn Fn(f64) -> f64, low: f64, high: f64| {
            let series = Series::fit(f, low, high).expect("smooth");
            let n = 10 * LANES;
            let x: Vec<f32> =
                (0..n).map(|i| (low + (high - low) * i as f64 / (n - 1) as f64) as f32).collect();
            let mut factors = vec![2.0; n];
            series.multiply(&x, &mut factors);
            let mut plain = vec![2.0; n];
            multiply_series_body(&series.coefficients, [series.middle, series.per_half], &x, &mut plain);
            assert_eq!(factors, plain, "every instruction set gives bit-identical results");
            for (x, got) in x.iter().zip(factors) {
                let error = (f64::from(got) / 2.0 - f(f64::from(*x))).abs();
                assert!(error < 1e-6, "{x}: {error:e}");
            }
        };
        checked(&|x| (-x).exp(), -0.3, 0.3);
        checked(&|x| piston(12.0 * x.sqrt()), 0.0, 1.0);
        checked(&|_| 1.0, 2.0, 2.0);
        assert_eq!(Series::fit(|_| 1.0, 0.0, 1.0).expect("constant").coefficients.len(), 1);
    }

    #[test]
    fn functions_that_need_too_many_terms_are_refused() {
        assert!(Series::fit(|x| (300.0 * x).cos(), -1.0, 1.0).is_none());
        assert!(Series::fit(|x| 1.0 / x.abs(), -1.0, 1.0).is_none());
        assert!(Series::fit(|_| f64::NAN, -1.0, 1.0).is_none());
    }
}
