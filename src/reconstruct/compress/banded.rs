//! The product that compresses a sweep: every measured tone is added to a few neighbouring virtual ones, with real weights.
//!
//! Samples are first demodulated to delays about the middle of the volume's, which makes weights real; the sums are
//! modulated back when all are added. Moduli are summed on the way, so that samples are read once, and along
//! rows, as memory gives them fastest. Sums run in a fixed order at any vector width and number of threads.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

use crate::wave::simd::fused::fused;
use crate::wave::simd::{LANES, dispatched};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Microphones and measured tones of a tile, which stays in a cache between the two steps.
const TILE: usize = 256;
const TONES: usize = 32;

/// Sums that registers hold at a time.
const SUMS: usize = 4;

/// From this many microphones on, threads share these, about this many each; below, they share the measured tones.
const WIDE: usize = 1024;
const MOST_COLUMNS: usize = 1024;
const PART: usize = 128;

/// Between these, squares neither overflow nor vanish beside each other in f32.
const MODEST: Range<f32> = 1e-15..1e15;

/// Measured tones that go to a few virtual ones, and how.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Banded<'a> {
    /// The first virtual tone of each.
    pub(crate) first: &'a [usize],
    /// Number of virtual tones that each goes to.
    pub(crate) taps: usize,
    /// Their weights, `[tones, taps]`.
    pub(crate) weights: &'a [f32],
    /// What samples of each are multiplied by before.
    pub(crate) turns: &'a [Complex32],
    /// What moduli of each count, signs aside; nothing where they are not asked for.
    pub(crate) window: Option<&'a [f32]>,
}

/// Turned samples of one tone in a tile, padded with zeros: so that those of one microphone are not a power of two apart, of
/// which a cache holds but a few.
type Turned = [f32; 2 * TILE + LANES];

impl Banded<'_> {
    /// Adds measured samples `[tones, n_mic]` to virtual ones, in rows of `n_mic`; gives the sum of their weighted moduli,
    /// those of microphones by `microphones`.
    pub(crate) fn add(&self, samples: &[Complex32], microphones: &[f32], rows: &mut [Complex32]) -> f64 {
        let n_mic = microphones.len();
        let touched = self.touched();
        let rows = &mut rows[touched.start * n_mic..touched.end * n_mic];
        if n_mic >= WIDE {
            self.add_by_microphones(samples, microphones, rows)
        } else {
            self.add_by_tones(samples, microphones, rows)
        }
    }

    /// The virtual tones that these go to.
    fn touched(&self) -> Range<usize> {
        self.first[0]..self.first[self.first.len() - 1] + self.taps
    }

    /// Some of the measured tones.
    fn part(&self, tones: Range<usize>) -> Self {
        Self {
            first: &self.first[tones.clone()],
            weights: &self.weights[tones.start * self.taps..tones.end * self.taps],
            turns: &self.turns[tones.clone()],
            window: self.window.map(|window| &window[tones]),
            ..*self
        }
    }

    fn add_by_microphones(&self, samples: &[Complex32], microphones: &[f32], rows: &mut [Complex32]) -> f64 {
        let n_mic = microphones.len();
        // A few for each thread, but no scraps.
        let columns = (n_mic / 8).next_multiple_of(TILE).min(MOST_COLUMNS);
        let mut blocks: Vec<Vec<&mut [Complex32]>> =
            (0..n_mic.div_ceil(columns)).map(|_| Vec::new()).collect();
        for row in rows.chunks_exact_mut(n_mic) {
            for (block, part) in blocks.iter_mut().zip(row.chunks_mut(columns)) {
                block.push(part);
            }
        }
        let sum = |(index, block)| self.block(samples, microphones, index * columns, block);
        let moduli: Vec<f64> = blocks.into_par_iter().enumerate().map(sum).collect();
        moduli.iter().sum()
    }

    fn add_by_tones(&self, samples: &[Complex32], microphones: &[f32], rows: &mut [Complex32]) -> f64 {
        let n_mic = microphones.len();
        let parts = (0..self.first.len()).into_par_iter().step_by(PART).map(|start| {
            let tones = start..(start + PART).min(self.first.len());
            let (part, samples) = (self.part(tones.clone()), &samples[tones.start * n_mic..]);
            let mut own = vec![Complex32::ZERO; part.touched().len() * n_mic];
            let modulus = part.block(samples, microphones, 0, own.chunks_exact_mut(n_mic).collect());
            (part.touched().start - self.first[0], own, modulus)
        });
        let parts: Vec<_> = parts.collect();
        for (first, own, _) in &parts {
            rows[first * n_mic..].iter_mut().zip(own).for_each(|(to, sum)| *to += sum);
        }
        parts.iter().map(|(.., modulus)| modulus).sum()
    }

    /// The same for as many microphones from `start` on as `rows`, all that are touched, have.
    fn block(
        &self,
        samples: &[Complex32],
        microphones: &[f32],
        start: usize,
        mut rows: Vec<&mut [Complex32]>,
    ) -> f64 {
        let (n_mic, width) = (microphones.len(), rows[0].len());
        let mut turned: Vec<Turned> = vec![[0.0; 2 * TILE + LANES]; TONES];
        let mut modulus = 0.0;
        for first in (0..width).step_by(TILE) {
            let columns = first..width.min(first + TILE);
            let place = start + columns.start..start + columns.end;
            let mut rows: Vec<&mut [f32]> =
                rows.iter_mut().map(|row| bytemuck::cast_slice_mut(&mut row[columns.clone()])).collect();
            for tones in (0..self.first.len()).step_by(TONES) {
                let part = self.part(tones..(tones + TONES).min(self.first.len()));
                for (n, turned) in (tones..).zip(&mut turned).take(part.first.len()) {
                    let samples = &samples[n * n_mic..][place.clone()];
                    turn(samples, self.turns[n], turned);
                    if let Some(window) = self.window {
                        let mut sum = 0.0;
                        sum_moduli(samples, &microphones[place.clone()], &mut sum);
                        modulus += f64::from(window[n].abs()) * sum;
                    }
                }
                add(&part, self.first[0], &turned, &mut rows);
            }
        }
        modulus
    }
}

#[inline(always)]
fn turn_body(samples: &[Complex32], by: Complex32, turned: &mut Turned) {
    for (to, m) in turned.as_chunks_mut::<2>().0.iter_mut().zip(samples) {
        *to = [m.re * by.re - m.im * by.im, m.re * by.im + m.im * by.re];
    }
}

dispatched! {
    /// Turns samples.
    fn turn = turn_body(samples: &[Complex32], by: Complex32, turned: &mut Turned)
}

#[inline(always)]
fn sum_moduli_body(samples: &[Complex32], microphones: &[f32], modulus: &mut f64) {
    // Bits of positive numbers are in the order of the numbers.
    let bits =
        samples.iter().fold(0, |most: u32, m| most.max(m.re.abs().to_bits()).max(m.im.abs().to_bits()));
    if !MODEST.contains(&f32::from_bits(bits)) {
        let modulus_of = |m: &Complex32| f64::from(m.re).hypot(f64::from(m.im));
        *modulus = samples.iter().zip(microphones).map(|(m, w)| modulus_of(m) * f64::from(w.abs())).sum();
        return;
    }
    let modulus_of = |m: &Complex32, w: f32| (m.re * m.re + m.im * m.im).sqrt() * w.abs();
    let ((whole, rest), (weights, weights_of_rest)) =
        (samples.as_chunks::<LANES>(), microphones.as_chunks::<LANES>());
    let mut sums = [0.0f32; LANES];
    for (samples, weights) in whole.iter().zip(weights) {
        for l in 0..LANES {
            let (m, w): (&Complex32, f32) = (&samples[l], weights[l]);
            sums[l] += modulus_of(m, w);
        }
    }
    for (sum, (m, w)) in sums.iter_mut().zip(rest.iter().zip(weights_of_rest)) {
        *sum += modulus_of(m, *w);
    }
    *modulus = sums.iter().map(|sum| f64::from(*sum)).sum();
}

dispatched! {
    /// The sum of weighted moduli.
    fn sum_moduli = sum_moduli_body(samples: &[Complex32], microphones: &[f32], modulus: &mut f64)
}

#[inline(always)]
fn add_body<const FMA: bool>(part: &Banded<'_>, row: usize, turned: &[Turned], rows: &mut [&mut [f32]]) {
    let (first, taps) = (part.first, part.taps);
    let (low, high) = (first[0], first[first.len() - 1] + taps);
    // A few virtual tones at a time, which stay in registers for all measured ones that go to any of them.
    for few in (low..high).step_by(SUMS) {
        let from = first.partition_point(|first| first + taps <= few);
        let to = first.partition_point(|first| *first < few + SUMS);
        let mut weights = [[0.0f32; SUMS]; TONES];
        for (n, weights) in (from..to).zip(&mut weights) {
            let own = &part.weights[n * taps..][..taps];
            for (k, weight) in weights.iter_mut().enumerate() {
                *weight =
                    (few + k).checked_sub(first[n]).and_then(|tap| own.get(tap)).copied().unwrap_or(0.0);
            }
        }
        let (weights, turned) = (&weights[..to - from], &turned[from..to]);
        let rows = &mut rows[few - row..high - row];
        match rows.len() {
            1 => add_to::<FMA, 1>(weights, turned, rows),
            2 => add_to::<FMA, 2>(weights, turned, rows),
            3 => add_to::<FMA, 3>(weights, turned, rows),
            _ => add_to::<FMA, SUMS>(weights, turned, rows),
        }
    }
}

/// Adds measured tones to the first K rows.
#[inline(always)]
fn add_to<const FMA: bool, const K: usize>(
    weights: &[[f32; SUMS]],
    turned: &[Turned],
    rows: &mut [&mut [f32]],
) {
    let rows = rows.first_chunk_mut::<K>().expect("as many rows");
    let len = rows[0].len();
    let whole = len - len % LANES;
    for at in (0..whole).step_by(LANES) {
        let mut sums = [[0.0f32; LANES]; K];
        for k in 0..K {
            sums[k] = *rows[k][at..].first_chunk().expect("whole lanes");
        }
        add_lanes::<FMA, K>(weights, turned, at, &mut sums);
        for k in 0..K {
            *rows[k][at..].first_chunk_mut().expect("whole lanes") = sums[k];
        }
    }
    if whole < len {
        let mut sums = [[0.0f32; LANES]; K];
        for k in 0..K {
            sums[k][..len - whole].copy_from_slice(&rows[k][whole..]);
        }
        add_lanes::<FMA, K>(weights, turned, whole, &mut sums);
        for k in 0..K {
            rows[k][whole..].copy_from_slice(&sums[k][..len - whole]);
        }
    }
}

/// The same for the lanes at one place of the tile.
#[inline(always)]
fn add_lanes<const FMA: bool, const K: usize>(
    weights: &[[f32; SUMS]],
    turned: &[Turned],
    at: usize,
    sums: &mut [[f32; LANES]; K],
) {
    for (turned, weights) in turned.iter().zip(weights) {
        let turned: &[f32; LANES] = turned[at..].first_chunk().expect("tiles are whole lanes");
        for k in 0..K {
            for l in 0..LANES {
                sums[k][l] = fused::<FMA>(weights[k], turned[l], sums[k][l]);
            }
        }
    }
}

dispatched! {
    /// Adds a tile of turned samples to the virtual tones from `row` on.
    fn add = fused add_body(part: &Banded<'_>, row: usize, turned: &[Turned], rows: &mut [&mut [f32]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex64;

    /// Numbers between −½ and ½ that look random.
    fn number(i: usize, k: f64) -> f32 {
        (i as f64 * k).fract() as f32 - 0.5
    }

    fn wide(z: Complex32) -> Complex64 {
        Complex64::new(z.re.into(), z.im.into())
    }

    #[test]
    fn the_product_is_the_literal_one_at_any_width_and_scale() {
        for (n_mic, tones, taps, scale) in [
            (1, 3, 1, 1.0),
            (5, 70, 2, 1e-25),
            (255, 300, 7, 1.0),
            (300, 129, 12, 1e25),
            (1024, 64, 13, 1e-33),
            (1300, 40, 4, 1.0),
        ] {
            let first: Vec<usize> = (0..tones).map(|n| 3 + n / 5).collect();
            let weights: Vec<f32> = (0..tones * taps).map(|i| number(i, 0.618_034)).collect();
            let complex = |i: usize| Complex32::new(number(i, 0.754_878), number(i, 0.569_84));
            let turns: Vec<Complex32> = (0..tones).map(|n| complex(n + 7)).collect();
            let window: Vec<f32> = (0..tones).map(|n| number(n, 0.41)).collect();
            let microphones: Vec<f32> = (0..n_mic).map(|r| number(r + 1, 0.37)).collect();
            let samples: Vec<Complex32> = (0..tones * n_mic).map(|i| complex(i) * scale).collect();
            let banded =
                Banded { first: &first, taps, weights: &weights, turns: &turns, window: Some(&window) };
            let count = first[tones - 1] + taps + 2;
            let before = |i: usize| complex(i + 1) * scale;
            let mut rows: Vec<Complex32> = (0..count * n_mic).map(before).collect();
            let modulus = banded.add(&samples, &microphones, &mut rows);

            let mut expected: Vec<Complex64> = (0..count * n_mic).map(|i| wide(before(i))).collect();
            let mut expected_modulus = 0.0;
            for n in 0..tones {
                for r in 0..n_mic {
                    let m = wide(samples[n * n_mic + r]);
                    expected_modulus += f64::from((window[n] * microphones[r]).abs()) * m.norm();
                    for a in 0..taps {
                        let w = wide(turns[n]) * f64::from(weights[n * taps + a]);
                        expected[(first[n] + a) * n_mic + r] += w * m;
                    }
                }
            }
            let worst = rows.iter().zip(&expected).map(|(a, b)| (wide(*a) - b).norm()).fold(0.0, f64::max);
            let most = expected.iter().map(|z| z.norm()).fold(0.0, f64::max);
            assert!(worst <= 2e-6 * most, "{n_mic} x {tones}, {taps} taps: {worst:e} of {most:e}");
            let error = (modulus - expected_modulus).abs() / expected_modulus;
            assert!(error < 1e-5, "{n_mic} x {tones}: moduli {error:e}");
        }
    }
}
