//! The body of the literal inverse sum over an even sweep, by Horner's rule.

use super::{LANES, RECURRENCE, Steps, sin_cos_turns, wrap_fast};

/// Points that share every sample that is loaded.
const POINTS: usize = 4;

/// Samples m(f, r) as the inverse kernel wants them: `[group of 16 microphones, f, 16]`, the last group filled with zeros.
#[derive(Debug, Clone, Default)]
pub struct SweepSamples {
    re: Vec<[f32; LANES]>,
    im: Vec<[f32; LANES]>,
    frequencies: usize,
}

impl SweepSamples {
    /// Rearranges `sample(f, r)`.
    pub fn new(
        frequencies: usize,
        microphones: usize,
        sample: impl Fn(usize, usize) -> num_complex::Complex32,
    ) -> Self {
        let count = frequencies * microphones.div_ceil(LANES);
        let mut split = Self { re: Vec::with_capacity(count), im: Vec::with_capacity(count), frequencies };
        for first in (0..microphones).step_by(LANES) {
            for f in 0..frequencies {
                let (mut re, mut im) = ([0.0; LANES], [0.0; LANES]);
                for l in 0..LANES.min(microphones - first) {
                    let m = sample(f, first + l);
                    (re[l], im[l]) = (m.re, m.im);
                }
                split.re.push(re);
                split.im.push(im);
            }
        }
        split
    }

    /// Number of microphones, padding included; as many lengths belong to each point.
    pub fn padded_len(&self) -> usize {
        self.re.len() / self.frequencies.max(1) * LANES
    }
}

#[inline(always)]
pub(super) fn weighted_sweep_body(
    samples: &SweepSamples,
    lengths: &[f64],
    steps: Steps,
    totals: &mut [[f64; 2]],
) {
    let width = samples.padded_len();
    assert!(steps.count == samples.frequencies, "one sample per frequency");
    assert!(lengths.len() == width * totals.len(), "one padded length per point and microphone");
    let groups = samples.re.chunks_exact(steps.count).zip(samples.im.chunks_exact(steps.count));
    // Groups are the outer loop: the samples of one stay in the second-level cache for all points.
    for (group, (re, im)) in groups.enumerate() {
        for (tile, totals) in totals.chunks_mut(POINTS).enumerate() {
            let mut here = [[0.0f64; LANES]; POINTS];
            for (p, here) in here.iter_mut().enumerate().take(totals.len()) {
                here.copy_from_slice(&lengths[(tile * POINTS + p) * width + group * LANES..][..LANES]);
            }
            let sums = sweep_sums(re, im, &here, steps);
            for (total, sums) in totals.iter_mut().zip(&sums) {
                for part in 0..2 {
                    total[part] += sums[part].iter().sum::<f64>();
                }
            }
        }
    }
}

/// `(sin, cos)` of so many turns to 10⁻¹⁰: what is repeated 64 times must not err by more than its f32 rounding.
#[inline(always)]
pub(crate) fn sin_cos_exact(cycles: f64) -> (f64, f64) {
    let t = std::f64::consts::PI * (cycles - ((cycles + ROUND) - ROUND));
    let u = -t * t;
    // Taylor series of sin t and cos t on |t| ≤ π/2, 1/n! step by step; then the double angle.
    let (mut s, mut c) = (1.0, 1.0);
    for k in (1..=8).rev() {
        s = 1.0 + s * u * (1.0 / f64::from(2 * k * (2 * k + 1)));
        c = 1.0 + c * u * (1.0 / f64::from(2 * k * (2 * k - 1)));
    }
    let s = s * t;
    (2.0 * s * c, 1.0 - 2.0 * s * s)
}

/// Adding and subtracting it rounds an f64 to a whole number.
const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 · 2^52

/// The sums over all frequencies, lane by lane, real and imaginary.
#[inline(always)]
fn sweep_sums(
    re: &[[f32; LANES]],
    im: &[[f32; LANES]],
    lengths: &[[f64; LANES]; POINTS],
    steps: Steps,
) -> [[[f64; LANES]; 2]; POINTS] {
    let mut sums = [[[0.0f64; LANES]; 2]; POINTS];
    let (mut w_re, mut w_im) = ([[0.0f32; LANES]; POINTS], [[0.0f32; LANES]; POINTS]);
    for p in 0..POINTS {
        for l in 0..LANES {
            let (s, c) = sin_cos_exact(lengths[p][l] * steps.step);
            (w_re[p][l], w_im[p][l]) = (c as f32, s as f32);
        }
    }
    for (chunk, (re, im)) in re.chunks(RECURRENCE).zip(im.chunks(RECURRENCE)).enumerate() {
        // m₀ + w(m₁ + w(m₂ + …)), w one step's turn; then all of it is turned to the first frequency.
        let (mut a_re, mut a_im) = ([[0.0f32; LANES]; POINTS], [[0.0f32; LANES]; POINTS]);
        for (re, im) in re.iter().zip(im).rev() {
            for p in 0..POINTS {
                for l in 0..LANES {
                    let turned = a_re[p][l] * w_re[p][l] - a_im[p][l] * w_im[p][l] + re[l];
                    a_im[p][l] = a_re[p][l] * w_im[p][l] + a_im[p][l] * w_re[p][l] + im[l];
                    a_re[p][l] = turned;
                }
            }
        }
        let start = steps.start + steps.step * (chunk * RECURRENCE) as f64;
        for p in 0..POINTS {
            let (mut turns, mut turned) = ([0.0f32; LANES], [[0.0f32; LANES]; 2]);
            for l in 0..LANES {
                turns[l] = wrap_fast(lengths[p][l] * start);
            }
            for l in 0..LANES {
                let (s, c) = sin_cos_turns(turns[l]);
                turned[0][l] = a_re[p][l] * c - a_im[p][l] * s;
                turned[1][l] = a_re[p][l] * s + a_im[p][l] * c;
            }
            for part in 0..2 {
                for l in 0..LANES {
                    sums[p][part][l] += f64::from(turned[part][l]);
                }
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wave::phasor;
    use crate::wave::simd::weighted_sweep;
    use num_complex::{Complex32, Complex64};

    #[test]
    fn the_inverse_sum_is_the_literal_one_in_every_instruction_set() {
        let fraction = |i: usize, k: f64| (i as f64 * k).fract();
        for (frequencies, microphones, points) in [(1, 1, 1), (64, 16, 4), (201, 37, 9)] {
            let m = |f: usize, r: usize| {
                let i = f * microphones + r;
                Complex32::new(fraction(i, 0.618_034) as f32 - 0.5, fraction(i, 0.754_878) as f32 - 0.5)
            };
            let samples = SweepSamples::new(frequencies, microphones, m);
            let width = samples.padded_len();
            let lengths: Vec<f64> = (0..points * width).map(|i| 0.3 + 11.0 * fraction(i, 0.569_84)).collect();
            let steps = Steps { start: -10_000.0 / 343.0, step: -20.0 / 343.0, count: frequencies };
            let (mut totals, mut plain) = (vec![[0.0; 2]; points], vec![[0.0; 2]; points]);
            weighted_sweep(&samples, &lengths, steps, &mut totals);
            weighted_sweep_body(&samples, &lengths, steps, &mut plain);
            assert_eq!(totals, plain);
            for (p, total) in totals.iter().enumerate() {
                let mut exact = Complex64::ZERO;
                for r in 0..microphones {
                    for f in 0..frequencies {
                        let k = steps.start + steps.step * f as f64;
                        let term = m(f, r) * phasor(k * lengths[p * width + r]);
                        exact += Complex64::new(term.re.into(), term.im.into());
                    }
                }
                let error = (exact - Complex64::new(total[0], total[1])).norm();
                assert!(error < 2e-7 * (frequencies * microphones) as f64 + 1e-6, "point {p}: {error:e}");
            }
        }
    }
}
