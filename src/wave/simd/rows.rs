//! Weighted sums of rows: what a place is made of, of all that is known at the nodes around it.

#![allow(clippy::inline_always)]

use super::fused::fused;
use super::{LANES, dispatched};

/// Numbers that are summed at a time, so that chains of dependent additions overlap; where there are as many, twice that.
pub(crate) const WIDE: usize = 2 * LANES;
const TWICE: usize = 2 * WIDE;

/// Numbers from the first on that a cache line begins with, up to [`LANES`] fewer: a vector that lies in two lines takes longer
/// to read, a sum of such rows a third.
pub(crate) fn aligned(numbers: &[f32]) -> &[f32] {
    &numbers[before_line(numbers)..]
}

/// The same, to be changed.
pub(crate) fn aligned_mut(numbers: &mut [f32]) -> &mut [f32] {
    let first = before_line(numbers);
    &mut numbers[first..]
}

/// Numbers before the first that a cache line begins with.
fn before_line(numbers: &[f32]) -> usize {
    numbers.as_ptr().align_offset(size_of::<[f32; LANES]>()).min(LANES).min(numbers.len())
}

#[inline(always)]
fn weighted_rows_body<const FMA: bool>(
    places: &[(usize, &[f32])],
    rows: &[f32],
    stride: usize,
    sums: &mut [f32],
) {
    let width = sums.len() / places.len().max(1);
    assert!(sums.len() == width * places.len() && width.is_multiple_of(WIDE), "whole pairs of vectors");
    for first in (0..width).step_by(TWICE) {
        for ((from, weights), sums) in places.iter().zip(sums.chunks_exact_mut(width)) {
            let (rows, sums) = (&rows[from + first..], &mut sums[first..]);
            if let Some(sums) = sums.first_chunk_mut::<TWICE>() {
                *sums = some_sums::<FMA, TWICE>(weights, rows, stride);
            } else if let Some(sums) = sums.first_chunk_mut::<WIDE>() {
                *sums = some_sums::<FMA, WIDE>(weights, rows, stride);
            }
        }
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
    /// `sums[p, k] = Σ_a weights_p[a] rows[first_p + a stride + k]` for some places, told by their first number and weights:
    /// of those that are made of almost the same rows, the same numbers are read one after the other.
    ///
    /// # Panics
    /// Unless the sums of a place are a multiple of [`WIDE`], and every row has as many numbers.
    pub(crate) fn weighted_rows = fused weighted_rows_body(
        places: &[(usize, &[f32])], rows: &[f32], stride: usize, sums: &mut [f32],
    )
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
            let (weights, rows) = (plane(12, 0.618_034), plane(8 * stride, 0.754_878));
            let places = [(0, &weights[..7]), (stride, &weights[5..]), (0, &weights[4..5])];
            for places in [&places[..1], &places] {
                let (mut sums, mut plain) =
                    (vec![9.0; places.len() * width], vec![0.0; places.len() * width]);
                weighted_rows(places, &rows, stride, &mut sums);
                weighted_rows_body::<false>(places, &rows, stride, &mut plain);
                assert_eq!(sums, plain);
                for ((first, weights), sums) in places.iter().zip(sums.chunks_exact(width)) {
                    for (k, got) in sums.iter().enumerate() {
                        let row = |a: usize| rows[first + a * stride + k];
                        let wanted: f32 = weights.iter().enumerate().map(|(a, w)| w * row(a)).sum();
                        assert!((got - wanted).abs() < 1e-6);
                    }
                }
            }
        }
    }
}
