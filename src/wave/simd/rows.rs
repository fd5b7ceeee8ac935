//! Weighted sums of rows: what a place is made of, of all that is known at the nodes around it.

#![allow(clippy::inline_always)]

use super::fused::fused;
use super::{LANES, dispatched};

/// Numbers that are summed at a time, so that chains of dependent additions overlap; where there are as many, twice that.
pub(crate) const WIDE: usize = 2 * LANES;
const TWICE: usize = 2 * WIDE;

#[inline(always)]
fn weighted_rows_body<const FMA: bool>(weights: &[f32], rows: &[f32], stride: usize, sums: &mut [f32]) {
    assert!(sums.len().is_multiple_of(WIDE), "whole pairs of vectors");
    let (twice, rest) = sums.as_chunks_mut::<TWICE>();
    let done = twice.len() * TWICE;
    for (i, sums) in twice.iter_mut().enumerate() {
        *sums = some_sums::<FMA, TWICE>(weights, &rows[i * TWICE..], stride);
    }
    if let Ok(sums) = <&mut [f32; WIDE]>::try_from(rest) {
        *sums = some_sums::<FMA, WIDE>(weights, &rows[done..], stride);
    }
}

#[inline(always)]
fn some_sums<const FMA: bool, const N: usize>(weights: &[f32], rows: &[f32], stride: usize) -> [f32; N] {
    let mut lanes = [0.0f32; N];
    for (a, w) in weights.iter().enumerate() {
        let row = &rows[a * stride..][..N];
        for (lane, value) in lanes.iter_mut().zip(row) {
            *lane = fused::<FMA>(*w, *value, *lane);
        }
    }
    lanes
}

dispatched! {
    /// `sums[k] = Σ_a weights[a] rows[a, k]`, rows `stride` apart.
    ///
    /// # Panics
    /// Unless the sums are a multiple of [`WIDE`], and every row has as many numbers.
    pub(crate) fn weighted_rows = fused weighted_rows_body(weights: &[f32], rows: &[f32], stride: usize, sums: &mut [f32])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_those_of_rows_that_touch_or_are_apart() {
        // Pseudo-random numbers in ±½.
        let plane =
            |n: usize, k: f64| (0..n).map(|i| ((i as f64 * k).fract() - 0.5) as f32).collect::<Vec<f32>>();
        let width = 3 * WIDE;
        for stride in [width, width + 5] {
            let (weights, rows) = (plane(7, 0.618_034), plane(7 * stride, 0.754_878));
            let (mut sums, mut plain) = (vec![9.0; width], vec![0.0; width]);
            weighted_rows(&weights, &rows, stride, &mut sums);
            weighted_rows_body::<false>(&weights, &rows, stride, &mut plain);
            assert_eq!(sums, plain);
            for (k, got) in sums.iter().enumerate() {
                let wanted: f32 = weights.iter().enumerate().map(|(a, w)| w * rows[a * stride + k]).sum();
                assert!((got - wanted).abs() < 1e-6);
            }
        }
    }
}
