//! Cells of neighbouring reflectors at the microphones around them: offsets of the paths, and sums of tones turned by the
//! delay of a cell.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

use super::simd::fused::fused;
use super::simd::rows::WIDE;
use super::simd::{LANES, Lanes, dispatched, transpose};

#[inline(always)]
fn cell_offsets_body(
    beside: [&[f32]; 3],
    microphone: [f32; 3],
    distance: f32,
    legs: f32,
    offsets: &mut [f32],
) {
    let [x, y, z] = beside;
    let n = offsets.len();
    assert!(x.len() == n && y.len() == n && z.len() == n, "planes of equal length");
    let [qx, qy, qz] = microphone.map(|q| 2.0 * q);
    let square = distance * distance;
    for i in 0..n {
        // |q − d| − |q|, without cancellation as long as |d| is well below |q|.
        let more = x[i] * x[i] + y[i] * y[i] + z[i] * z[i] - (x[i] * qx + y[i] * qy + z[i] * qz);
        let there = (square + more).max(0.0).sqrt();
        offsets[i] = legs * more / (there + distance);
    }
}

dispatched! {
    /// `legs·(|q − d| − |q|)` for reflectors at `d = beside` (m, three planes) and a `microphone` at `q`, both from the cell's
    /// centre; `distance` is `|q|`.
    ///
    /// The error is a few 10⁻⁷ of `|d|` where `|q| ≥ 2|d|`.
    ///
    /// # Panics
    /// When the planes differ in length.
    pub(crate) fn cell_offsets = cell_offsets_body(
        beside: [&[f32]; 3], microphone: [f32; 3], distance: f32, legs: f32, offsets: &mut [f32],
    )
}

/// A phasor per microphone, real and imaginary parts, in whole blocks of [`LANES`].
pub(crate) type PhasorPlanes<'a> = [&'a [f32]; 2];

#[inline(always)]
fn turn_and_add_body<const FMA: bool>(
    centre: PhasorPlanes<'_>,
    step: PhasorPlanes<'_>,
    sums: &[f32],
    totals: &mut [f32],
) {
    let width = centre[0].len();
    assert!(width.is_multiple_of(LANES) && sums.len() == totals.len(), "whole blocks, and a sum per total");
    assert!(
        centre[1].len() == width && step[0].len() == width && step[1].len() == width,
        "planes of equal length"
    );
    let tones = sums.len() / (2 * width);
    assert!(tones % 2 == 1 && sums.len() == tones * 2 * width, "an odd number of tones about a centre tone");
    let pairs = tones / 2;
    for block in (0..width).step_by(LANES) {
        let lanes = |plane: &[f32]| -> [f32; LANES] { std::array::from_fn(|l| plane[block + l]) };
        let (c_re, c_im) = (lanes(centre[0]), lanes(centre[1]));
        let s_re = lanes(step[0]);
        for up in [true, false] {
            let mut s_im = lanes(step[1]);
            if !up {
                s_im = s_im.map(|s| -s);
            }
            let (mut z_re, mut z_im) = (c_re, c_im);
            for k in usize::from(!up)..=pairs {
                if k > 0 {
                    for l in 0..LANES {
                        let next = fused::<FMA>(z_re[l], s_re[l], -z_im[l] * s_im[l]);
                        z_im[l] = fused::<FMA>(z_im[l], s_re[l], z_re[l] * s_im[l]);
                        z_re[l] = next;
                    }
                }
                let at = if up { pairs + k } else { pairs - k } * 2 * width + block;
                let (sum_re, sum_im) = (&sums[at..at + LANES], &sums[at + width..at + width + LANES]);
                let (total_re, total_im) = totals[at..at + width + LANES].split_at_mut(width);
                for l in 0..LANES {
                    let re = fused::<FMA>(-z_im[l], sum_im[l], total_re[l]);
                    total_re[l] = fused::<FMA>(z_re[l], sum_re[l], re);
                    let im = fused::<FMA>(z_im[l], sum_re[l], total_im[l]);
                    total_im[l] = fused::<FMA>(z_re[l], sum_im[l], im);
                }
            }
        }
    }
}

dispatched! {
    /// `totals[K + q] += centre · step^q · sums[K + q]` for q = −K … K, a number per microphone: `[tone][2 × microphones]`, all
    /// real parts of a tone and then all imaginary ones.
    ///
    /// # Panics
    /// When the planes differ in length, are not whole blocks, or the number of tones is even.
    pub(crate) fn turn_and_add = fused turn_and_add_body(
        centre: PhasorPlanes<'_>, step: PhasorPlanes<'_>, sums: &[f32], totals: &mut [f32],
    )
}

/// Columns of a few microphones exchanged with them: `to[column][stride]`, from `[microphone][width]`, which are at most
/// [`LANES`] microphones, and a width of whole pairs of blocks.
pub(crate) fn microphones_last(from: &[f32], width: usize, to: &mut [f32], stride: usize) {
    let (mut tile, mut turned) = ([Lanes::ZERO; LANES], [Lanes::ZERO; LANES]);
    for column in (0..width).step_by(WIDE) {
        for (lanes, row) in tile.iter_mut().zip(from.chunks_exact(width)) {
            lanes.re.copy_from_slice(&row[column..column + LANES]);
            lanes.im.copy_from_slice(&row[column + LANES..column + WIDE]);
        }
        transpose(&tile, &mut turned);
        for (l, lanes) in turned.iter().enumerate() {
            to[(column + l) * stride..][..LANES].copy_from_slice(&lanes.re);
            to[(column + LANES + l) * stride..][..LANES].copy_from_slice(&lanes.im);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wave::phasor;
    use num_complex::Complex32;

    /// Pseudo-random numbers in ±½.
    fn plane(n: usize, k: f64) -> Vec<f32> {
        (0..n).map(|i| ((i as f64 * k).fract() - 0.5) as f32).collect()
    }

    #[test]
    fn offsets_are_the_differences_of_the_legs() {
        let planes = [0.618_034, 0.754_878, 0.569_84].map(|k| plane(999, k));
        let beside = [&planes[0][..], &planes[1], &planes[2]];
        for q in [[0.3f32, -0.5, 2.5], [1.8, 0.2, 0.1], [30.0, 4.0, -90.0]] {
            let length = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
            let distance = length(q.map(f64::from));
            let (mut offsets, mut plain) = (vec![0.0; 999], vec![0.0; 999]);
            cell_offsets(beside, q, distance as f32, 2.0, &mut offsets);
            cell_offsets_body(beside, q, distance as f32, 2.0, &mut plain);
            assert_eq!(offsets, plain);
            for i in 0..999 {
                let away = std::array::from_fn(|a| f64::from(q[a]) - f64::from(planes[a][i]));
                let wanted = 2.0 * (length(away) - distance);
                assert!((f64::from(offsets[i]) - wanted).abs() < 2e-6, "{} {wanted}", offsets[i]);
            }
        }
    }

    #[test]
    fn sums_are_turned_and_added() {
        let (width, pairs) = (2 * LANES, 3);
        let turns = [plane(width, 0.618_034), plane(width, 0.324_718)];
        let planes = turns.each_ref().map(|turns| {
            let all: Vec<Complex32> = turns.iter().map(|t| phasor(f64::from(*t))).collect();
            [all.iter().map(|z| z.re).collect::<Vec<f32>>(), all.iter().map(|z| z.im).collect()]
        });
        let [centre, step] = planes.each_ref().map(|[re, im]| [&re[..], &im[..]]);
        let sums = plane((2 * pairs + 1) * 2 * width, 0.754_878);
        let before = plane(sums.len(), 0.569_84);
        let (mut totals, mut plain) = (before.clone(), before.clone());
        turn_and_add(centre, step, &sums, &mut totals);
        turn_and_add_body::<false>(centre, step, &sums, &mut plain);
        assert_eq!(totals, plain);
        for q in 0..=2 * pairs {
            for i in 0..width {
                let cycles = f64::from(turns[0][i]) + (q as f64 - pairs as f64) * f64::from(turns[1][i]);
                let number =
                    |all: &[f32]| Complex32::new(all[2 * q * width + i], all[(2 * q + 1) * width + i]);
                let wanted = number(&before) + phasor(cycles) * number(&sums);
                assert!((number(&totals) - wanted).norm() < 2e-6, "{q} {i}");
            }
        }
    }

    #[test]
    fn columns_and_microphones_are_exchanged() {
        let (width, stride, count) = (2 * WIDE, 3 * LANES, 11);
        let from = plane(count * width, 0.618_034);
        let mut to = vec![7.0; width * stride];
        microphones_last(&from, width, &mut to[LANES..], stride);
        for column in 0..width {
            for mic in 0..count {
                assert_eq!(to[column * stride + LANES + mic], from[mic * width + column]);
            }
            assert_eq!(to[column * stride], 7.0);
        }
    }
}
