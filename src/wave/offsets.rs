//! Echoes at a tile of neighbouring microphones: the sums of the fast simulation.
//!
//! A reflector's path to a microphone of a tile differs by a few centimetres from its path to the tile's centre. This
//! offset is computed in f32 without cancellation; the path to the centre, in f64, is already included in the
//! amplitude's phase. The sums run over tones evenly spaced about a centre tone: one recurrence gives
//! `cos qθ` and `sin qθ`, and with them the tones q and −q together.

#![allow(clippy::inline_always)]

use super::simd::fused::fused;
use super::simd::{LANES, dispatched, sin_cos_turns, wrap_few};
use num_complex::Complex32;

/// Maximum number of tones on each side of the centre tone.
pub(crate) const MOST_PAIRS: usize = 40;

/// Maximum number of echoes per call: lanes are summed in f32, so the sums must stay short; more need several calls.
pub(crate) const MOST_ECHOES: usize = 2048;

/// Echoes per block, two per lane: with only one, every step of the recurrence would wait for the previous one.
pub(crate) const WIDE: usize = 2 * LANES;

/// A run of reflectors relative to a tile's centre, in planes of equal length, a multiple of [`WIDE`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Echoes<'a> {
    /// Phase step per tone at the centre of the tile, in cycles within ±½.
    pub(crate) turn: &'a [f32],
    /// Amplitude with the phase of the centre tone at the centre of the tile, real and imaginary.
    pub(crate) amplitude: [&'a [f32]; 2],
}

#[inline(always)]
fn exact_offsets_body(
    toward: [&[f32]; 3],
    distance: &[f32],
    microphone: [f32; 3],
    legs: f32,
    offsets: &mut [f32],
) {
    let [x, y, z] = toward;
    let n = offsets.len();
    assert!(x.len() == n && y.len() == n && z.len() == n && distance.len() == n, "planes of equal length");
    let [dx, dy, dz] = microphone;
    let square = dx * dx + dy * dy + dz * dz;
    let double = [2.0 * dx, 2.0 * dy, 2.0 * dz];
    for i in 0..n {
        // |q − d| − |q| = (|q − d|² − |q|²)/(|q − d| + |q|): nothing cancels as long as |d| is well below |q|.
        let more = square - (x[i] * double[0] + y[i] * double[1] + z[i] * double[2]);
        let there = (distance[i] * distance[i] + more).max(0.0).sqrt();
        offsets[i] = legs * more / (there + distance[i]);
    }
}

dispatched! {
    /// `legs·(|q − d| − |q|)` for reflectors at `q = toward` (m, three planes), `|q| = distance`, and a microphone at `d`,
    /// all from the tile's centre.
    ///
    /// The error is a few 10⁻⁷ of `|d|` where `|q| ≥ 2|d|`; closer ones need f64.
    ///
    /// # Panics
    /// When the planes differ in length.
    pub(crate) fn exact_offsets = exact_offsets_body(
        toward: [&[f32]; 3], distance: &[f32], microphone: [f32; 3], legs: f32, offsets: &mut [f32],
    )
}

#[inline(always)]
fn linear_offsets_body(toward: [&[f32]; 3], microphone: [f32; 3], legs: f32, offsets: &mut [f32]) {
    let [x, y, z] = toward;
    let n = offsets.len();
    assert!(x.len() == n && y.len() == n && z.len() == n, "planes of equal length");
    let [dx, dy, dz] = microphone.map(|d| -legs * d);
    for i in 0..n {
        offsets[i] = x[i] * dx + y[i] * dy + z[i] * dz;
    }
}

dispatched! {
    /// `−legs·q̂·d` for unit vectors `q̂ = toward` and a microphone at `d` from the tile's centre, m: the far field.
    ///
    /// # Panics
    /// When the planes differ in length.
    pub(crate) fn linear_offsets = linear_offsets_body(
        toward: [&[f32]; 3], microphone: [f32; 3], legs: f32, offsets: &mut [f32],
    )
}

/// The sum of all lanes, by repeated halving.
#[inline(always)]
fn across(mut lanes: [f32; LANES]) -> f64 {
    for half in [8, 4, 2, 1] {
        for l in 0..half {
            lanes[l] += lanes[l + half];
        }
    }
    f64::from(lanes[0])
}

#[inline(always)]
fn sum_over_tones_body<const FMA: bool>(
    echoes: Echoes<'_>,
    offsets: &[f32],
    per_metre: [f32; 2],
    sums: &mut [[f64; 2]],
) {
    let n = offsets.len();
    assert!(n <= MOST_ECHOES && n.is_multiple_of(WIDE), "whole blocks, and not too many");
    assert!(
        echoes.turn.len() == n && echoes.amplitude[0].len() == n && echoes.amplitude[1].len() == n,
        "one offset per echo"
    );
    let pairs = sums.len() / 2;
    assert!(sums.len() % 2 == 1 && pairs <= MOST_PAIRS, "an odd number of tones about a centre tone");
    let mut middle = [[0.0f32; LANES]; 2];
    // Per pair of tones: the sums of re z · cos qθ, im z · cos qθ, re z · sin qθ, im z · sin qθ.
    let mut lanes = [[[0.0f32; LANES]; 4]; MOST_PAIRS];
    let lanes = &mut lanes[..pairs];
    let (offsets, _) = offsets.as_chunks::<WIDE>();
    let (turn, _) = echoes.turn.as_chunks::<WIDE>();
    let (a_re, _) = echoes.amplitude[0].as_chunks::<WIDE>();
    let (a_im, _) = echoes.amplitude[1].as_chunks::<WIDE>();
    for (((offset, turn), a_re), a_im) in offsets.iter().zip(turn).zip(a_re).zip(a_im) {
        let (mut z_re, mut z_im, mut c1, mut s1) =
            ([0.0f32; WIDE], [0.0f32; WIDE], [0.0f32; WIDE], [0.0f32; WIDE]);
        for l in 0..WIDE {
            let (s, c) = sin_cos_turns::<FMA>(wrap_few(offset[l] * per_metre[0]));
            z_re[l] = fused::<FMA>(a_re[l], c, -a_im[l] * s);
            z_im[l] = fused::<FMA>(a_re[l], s, a_im[l] * c);
            (s1[l], c1[l]) = sin_cos_turns::<FMA>(fused::<FMA>(offset[l], per_metre[1], turn[l]));
        }
        for l in 0..LANES {
            middle[0][l] += z_re[l] + z_re[l + LANES];
            middle[1][l] += z_im[l] + z_im[l + LANES];
        }
        let (mut c, mut s) = (c1, s1);
        for sum in &mut *lanes {
            for l in 0..LANES {
                let h = l + LANES;
                sum[0][l] = fused::<FMA>(z_re[l], c[l], fused::<FMA>(z_re[h], c[h], sum[0][l]));
                sum[1][l] = fused::<FMA>(z_im[l], c[l], fused::<FMA>(z_im[h], c[h], sum[1][l]));
                sum[2][l] = fused::<FMA>(z_re[l], s[l], fused::<FMA>(z_re[h], s[h], sum[2][l]));
                sum[3][l] = fused::<FMA>(z_im[l], s[l], fused::<FMA>(z_im[h], s[h], sum[3][l]));
            }
            for l in 0..WIDE {
                let next = fused::<FMA>(c[l], c1[l], -s[l] * s1[l]);
                s[l] = fused::<FMA>(s[l], c1[l], c[l] * s1[l]);
                c[l] = next;
            }
        }
    }
    sums[pairs][0] += across(middle[0]);
    sums[pairs][1] += across(middle[1]);
    for (q, lanes) in lanes.iter().enumerate() {
        let [re_c, im_c] = [across(lanes[0]), across(lanes[1])];
        let [re_s, im_s] = [across(lanes[2]), across(lanes[3])];
        let (above, below) = (pairs + 1 + q, pairs - 1 - q);
        sums[above][0] += re_c - im_s;
        sums[above][1] += im_c + re_s;
        sums[below][0] += re_c + im_s;
        sums[below][1] += im_c - re_s;
    }
}

dispatched! {
    /// Adds `Σ_j A_j e^{i2π·centre·offset_j} e^{i2πq(turn_j + step·offset_j)}` to `sums[K + q]` (real, imaginary) for q = −K … K;
    /// `per_metre` is `[centre, step]`, 1/m, and there are 2K + 1 sums.
    ///
    /// Cost: about 80 operations per echo and 7 per echo and tone.
    ///
    /// # Panics
    /// When the planes differ in length or hold more than [`MOST_ECHOES`], or K exceeds [`MOST_PAIRS`].
    pub(crate) fn sum_over_tones = fused sum_over_tones_body(
        echoes: Echoes<'_>, offsets: &[f32], per_metre: [f32; 2], sums: &mut [[f64; 2]],
    )
}

#[inline(always)]
fn rotate_and_add_body(phasors: &[Complex32], sums: &[f32], totals: &mut [f32]) {
    assert!(sums.len() == totals.len() && sums.len().is_multiple_of(2 * phasors.len()), "one row per phasor");
    let width = sums.len() / phasors.len();
    for ((phasor, sums), totals) in
        phasors.iter().zip(sums.chunks_exact(width)).zip(totals.chunks_exact_mut(width))
    {
        let (sum_re, sum_im) = sums.split_at(width / 2);
        let (total_re, total_im) = totals.split_at_mut(width / 2);
        // Whole lanes first: without them the compiler checks for overlaps on every row.
        let ((total_re, rest_re), (total_im, rest_im)) =
            (total_re.as_chunks_mut::<LANES>(), total_im.as_chunks_mut::<LANES>());
        let ((sum_re, last_re), (sum_im, last_im)) =
            (sum_re.as_chunks::<LANES>(), sum_im.as_chunks::<LANES>());
        for (((total_re, total_im), re), im) in total_re.iter_mut().zip(total_im).zip(sum_re).zip(sum_im) {
            for l in 0..LANES {
                total_re[l] += phasor.re * re[l] - phasor.im * im[l];
                total_im[l] += phasor.re * im[l] + phasor.im * re[l];
            }
        }
        for (((total_re, total_im), re), im) in rest_re.iter_mut().zip(rest_im).zip(last_re).zip(last_im) {
            *total_re += phasor.re * re - phasor.im * im;
            *total_im += phasor.re * im + phasor.im * re;
        }
    }
}

dispatched! {
    /// Adds `phasor · sums` to `totals`, row by row: a row holds all real parts, then all imaginary ones.
    ///
    /// # Panics
    /// Unless there are as many rows as phasors in both.
    pub(crate) fn rotate_and_add = rotate_and_add_body(phasors: &[Complex32], sums: &[f32], totals: &mut [f32])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wave::phasor;

    /// Pseudo-random numbers in ±½.
    fn plane(n: usize, k: f64) -> Vec<f32> {
        (0..n).map(|i| ((i as f64 * k).fract() - 0.5) as f32).collect()
    }

    #[test]
    fn offsets_are_the_differences_of_the_paths() {
        let n = 999;
        let [x, y, z] = [plane(n, 0.618_034), plane(n, 0.754_878), plane(n, 0.569_84)];
        for scale in [0.2, 4.0, 1e6] {
            let toward = [&x, &y, &z].map(|x| x.iter().map(|x| x * scale).collect::<Vec<f32>>());
            let length = |i: usize, d: [f32; 3]| -> f64 {
                (0..3).map(|a| (f64::from(toward[a][i]) - f64::from(d[a])).powi(2)).sum::<f64>().sqrt()
            };
            let distance: Vec<f32> = (0..n).map(|i| length(i, [0.0; 3]) as f32).collect();
            let toward = [&toward[0][..], &toward[1], &toward[2]];
            for d in [[0.01, -0.02, 0.005], [0.0, 0.0, 0.0], [0.03, 0.0, 0.0]] {
                let (mut exact, mut linear) = (vec![0.0; n], vec![0.0; n]);
                exact_offsets(toward, &distance, d, 2.0, &mut exact);
                linear_offsets(toward, d, 2.0, &mut linear);
                let size = d.iter().map(|d| d * d).sum::<f32>().sqrt();
                for i in 0..n {
                    let dot: f64 = (0..3).map(|a| f64::from(toward[a][i]) * f64::from(d[a])).sum();
                    assert!(
                        (f64::from(linear[i]) + 2.0 * dot).abs() < 1e-6 * f64::from(scale * size) + 1e-30
                    );
                    if distance[i] >= 2.0 * size {
                        let wanted = 2.0 * (length(i, d) - length(i, [0.0; 3]));
                        // Far away the f64 difference itself cancels.
                        let bound = 1e-6 * f64::from(size) + 1e-15 * f64::from(scale);
                        assert!((f64::from(exact[i]) - wanted).abs() <= bound, "{i} {} {wanted}", exact[i]);
                    }
                }
            }
        }
    }

    #[test]
    fn tones_about_the_centre_are_the_literal_sums() {
        for (n, pairs) in [(32, 0), (96, 1), (2048, 12), (320, MOST_PAIRS)] {
            let (turn, offsets) = (plane(n, 0.618_034), plane(n, 0.324_718));
            let turn: Vec<f32> = turn.iter().map(|t| 0.7 * t).collect();
            let amplitude = [plane(n, 0.754_878), plane(n, 0.569_84)];
            let echoes = Echoes { turn: &turn, amplitude: [&amplitude[0], &amplitude[1]] };
            let mut sums = vec![[0.25, -1.0]; 2 * pairs + 1];
            sum_over_tones(echoes, &offsets, [5.0, 0.3], &mut sums);
            let scale: f32 = amplitude[0].iter().zip(&amplitude[1]).map(|(a, b)| a.hypot(*b)).sum();
            for (i, sum) in sums.iter().enumerate() {
                let q = i as f64 - pairs as f64;
                let exact: Complex32 = (0..n)
                    .map(|j| {
                        let cycles = 5.0 * f64::from(offsets[j])
                            + q * (f64::from(turn[j]) + 0.3 * f64::from(offsets[j]));
                        Complex32::new(amplitude[0][j], amplitude[1][j]) * phasor(cycles)
                    })
                    .sum();
                let got = Complex32::new((sum[0] - 0.25) as f32, (sum[1] + 1.0) as f32);
                assert!((got - exact).norm() < 5e-6 * scale, "n {n} tone {q}: {got} {exact}");
            }
        }
    }

    #[test]
    fn rows_are_rotated_and_added() {
        let (phasors, width) = ([phasor(0.1), phasor(-0.3)], 74);
        let (sums, mut totals) = (plane(2 * width, 0.618_034), plane(2 * width, 0.754_878));
        let before = totals.clone();
        rotate_and_add(&phasors, &sums, &mut totals);
        for (row, phasor) in phasors.iter().enumerate() {
            for i in 0..width / 2 {
                let (re, im) = (row * width + i, row * width + width / 2 + i);
                let exact =
                    Complex32::new(before[re], before[im]) + phasor * Complex32::new(sums[re], sums[im]);
                assert!((exact - Complex32::new(totals[re], totals[im])).norm() < 1e-6);
            }
        }
    }

    #[test]
    fn every_instruction_set_gives_bit_identical_results() {
        let n = 480;
        let planes: Vec<Vec<f32>> = [0.618, 0.754, 0.569, 0.32, 0.41].map(|k| plane(n, k)).into();
        let distance = vec![1.5; n];
        let toward = [&planes[0][..], &planes[1], &planes[2]];
        let (mut a, mut b) = (vec![0.0; n], vec![0.0; n]);
        exact_offsets(toward, &distance, [0.01, 0.02, 0.0], 1.0, &mut a);
        exact_offsets_body(toward, &distance, [0.01, 0.02, 0.0], 1.0, &mut b);
        assert_eq!(a, b);
        linear_offsets(toward, [0.01, 0.02, 0.0], 1.0, &mut a);
        linear_offsets_body(toward, [0.01, 0.02, 0.0], 1.0, &mut b);
        assert_eq!(a, b);
        let echoes = Echoes { turn: &planes[3], amplitude: [&planes[4], &planes[0]] };
        let (mut a, mut b) = ([[0.0; 2]; 21], [[0.0; 2]; 21]);
        sum_over_tones(echoes, &planes[1], [3.0, 0.2], &mut a);
        sum_over_tones_body::<false>(echoes, &planes[1], [3.0, 0.2], &mut b);
        assert_eq!(a, b);
        let run = |add: fn(&[Complex32], &[f32], &mut [f32])| {
            let mut totals = planes[1].clone();
            add(&[phasor(0.2), phasor(0.7)], &planes[0], &mut totals);
            totals
        };
        assert_eq!(run(rotate_and_add), run(rotate_and_add_body));
    }
}
