//! The bodies of the literal sums over an even sweep: forward by recurrence, inverse by Horner's rule.

use super::fused::fused;
use super::{LANES, RECURRENCE, sin_cos_turns, wrap_exact, wrap_fast};
use num_complex::Complex32;

/// Points that share every loaded sample.
const POINTS: usize = 4;

/// Samples m(f, r) in the layout of the inverse kernel: `[group of 16 microphones, f, 16]`, the last group padded with
/// zeros.
#[derive(Debug, Clone, Default)]
pub(crate) struct SweepSamples {
    re: Vec<[f32; LANES]>,
    im: Vec<[f32; LANES]>,
    frequencies: usize,
}

impl SweepSamples {
    /// Rearranges `sample(f, r)`.
    pub(crate) fn new(
        frequencies: usize,
        microphones: usize,
        sample: impl Fn(usize, usize) -> Complex32,
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

    /// Number of microphones, including padding; each point has as many lengths.
    pub(crate) fn padded_len(&self) -> usize {
        self.re.len() / self.frequencies.max(1) * LANES
    }
}

/// Reflectors in the layout of the summing kernels: complex amplitudes in two planes, padded to whole lanes.
#[derive(Debug, Clone, Default)]
pub(crate) struct Amplitudes {
    re: Vec<f32>,
    im: Vec<f32>,
}

impl Amplitudes {
    /// Splits complex amplitudes and pads them with zeros.
    pub(crate) fn new(amplitudes: impl ExactSizeIterator<Item = Complex32>) -> Self {
        let padded = amplitudes.len().next_multiple_of(LANES);
        let mut split = Self { re: Vec::with_capacity(padded), im: Vec::with_capacity(padded) };
        for a in amplitudes {
            split.re.push(a.re);
            split.im.push(a.im);
        }
        split.re.resize(padded, 0.0);
        split.im.resize(padded, 0.0);
        split
    }

    /// Number of amplitudes, including padding; the lengths passed with them are padded to it.
    pub(crate) fn padded_len(&self) -> usize {
        self.re.len()
    }
}

/// The frequencies of a stepped sweep over c, in cycles per metre: `start + n·step`, n < count.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Steps {
    /// First frequency over c, 1/m.
    pub(crate) start: f64,
    /// Frequency step over c, 1/m.
    pub(crate) step: f64,
    /// Number of frequencies.
    pub(crate) count: usize,
}

#[inline(always)]
pub(super) fn sum_over_sweep_body<const FMA: bool>(
    amplitudes: &Amplitudes,
    lengths: &[f64],
    steps: Steps,
    sums: &mut [[f64; 2]],
) {
    assert!(lengths.len() == amplitudes.re.len(), "one padded length per amplitude");
    assert!(sums.len() == steps.count, "one sum per frequency");
    let (a_re, _) = amplitudes.re.as_chunks::<LANES>();
    let (a_im, _) = amplitudes.im.as_chunks::<LANES>();
    let (lengths, _) = lengths.as_chunks::<LANES>();
    // The phasor of one step; a single frequency needs none.
    let turned: Vec<[[f32; LANES]; 2]> = lengths
        .iter()
        .map(|lengths| {
            let mut turned = [[0.0f32; LANES]; 2];
            if steps.count > 1 {
                for l in 0..LANES {
                    let (s, c) = sin_cos_exact(lengths[l] * steps.step);
                    (turned[0][l], turned[1][l]) = (c as f32, s as f32);
                }
            }
            turned
        })
        .collect();
    for (chunk, sums) in sums.chunks_mut(RECURRENCE).enumerate() {
        let start = steps.start + steps.step * (chunk * RECURRENCE) as f64;
        // Groups of 64 × 16 reflectors: f32 lane sums stay short, the running total is f64.
        for group in 0..lengths.len().div_ceil(64) {
            let range = group * 64..((group + 1) * 64).min(lengths.len());
            let mut lanes = [[[0.0f32; LANES]; 2]; RECURRENCE];
            for (((a_re, a_im), lengths), [w_re, w_im]) in a_re[range.clone()]
                .iter()
                .zip(&a_im[range.clone()])
                .zip(&lengths[range.clone()])
                .zip(&turned[range])
            {
                let mut turns = [0.0f32; LANES];
                for l in 0..LANES {
                    turns[l] = wrap_fast(lengths[l] * start);
                }
                // z starts at A·e^{i2πf·path/c} and is multiplied by w once per frequency step.
                let (mut z_re, mut z_im) = ([0.0f32; LANES], [0.0f32; LANES]);
                for l in 0..LANES {
                    let (s, c) = sin_cos_turns::<FMA>(turns[l]);
                    z_re[l] = fused::<FMA>(a_re[l], c, -a_im[l] * s);
                    z_im[l] = fused::<FMA>(a_re[l], s, a_im[l] * c);
                }
                for sum in &mut lanes[..sums.len()] {
                    for l in 0..LANES {
                        sum[0][l] += z_re[l];
                        sum[1][l] += z_im[l];
                    }
                    for l in 0..LANES {
                        let re = fused::<FMA>(z_re[l], w_re[l], -z_im[l] * w_im[l]);
                        z_im[l] = fused::<FMA>(z_re[l], w_im[l], z_im[l] * w_re[l]);
                        z_re[l] = re;
                    }
                }
            }
            for (total, lanes) in sums.iter_mut().zip(&lanes) {
                for part in 0..2 {
                    total[part] += f64::from(lanes[part].iter().sum::<f32>());
                }
            }
        }
    }
}

#[inline(always)]
pub(super) fn weighted_sweep_body<const FMA: bool>(
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
            let sums = sweep_sums::<FMA>(re, im, &here, steps);
            for (total, sums) in totals.iter_mut().zip(&sums) {
                for part in 0..2 {
                    total[part] += sums[part].iter().sum::<f64>();
                }
            }
        }
    }
}

/// `(sin, cos)` of a phase in cycles to the accuracy of f64, by the half angle: no quadrant, no branch.
#[inline(always)]
pub(crate) fn sin_cos_exact(cycles: f64) -> (f64, f64) {
    let t = std::f64::consts::PI * wrap_exact(cycles);
    let u = t * t;
    let (mut s, mut c) = (0.0, 0.0);
    for k in (0..TERMS).rev() {
        s = s * u + SERIES[k][0];
        c = c * u + SERIES[k][1];
    }
    let s = s * t;
    (2.0 * s * c, 1.0 - 2.0 * s * s)
}

/// Terms of the Taylor series: on |t| ≤ π/2 the next are below 10⁻¹⁷.
const TERMS: usize = 12;

/// Coefficients of sin t and cos t, in powers of t².
const SERIES: [[f64; 2]; TERMS] = {
    let (mut series, mut last, mut k) = ([[0.0; 2]; TERMS], 1.0, 0);
    while k < TERMS {
        series[k] = [last / (2 * k + 1) as f64, last];
        last /= -(((2 * k + 1) * (2 * k + 2)) as f64);
        k += 1;
    }
    series
};

/// Numbers in f64 that are processed at a time.
const DOUBLES: usize = 8;

#[inline(always)]
pub(super) fn waves_body(frequency: f64, delays: &[f64], cos: &mut [f64], sin: &mut [f64]) {
    assert!(delays.len() == cos.len() && delays.len() == sin.len(), "one cosine and sine per delay");
    let (delays, rest) = delays.as_chunks::<DOUBLES>();
    let ((cos, last_cos), (sin, last_sin)) = (cos.as_chunks_mut::<DOUBLES>(), sin.as_chunks_mut::<DOUBLES>());
    for (delays, (cos, sin)) in delays.iter().zip(cos.iter_mut().zip(sin)) {
        for l in 0..DOUBLES {
            (sin[l], cos[l]) = sin_cos_exact(delays[l] * frequency);
        }
    }
    let (mut delays, mut cos, mut sin) = ([0.0; DOUBLES], [0.0; DOUBLES], [0.0; DOUBLES]);
    delays[..rest.len()].copy_from_slice(rest);
    for l in 0..DOUBLES {
        (sin[l], cos[l]) = sin_cos_exact(delays[l] * frequency);
    }
    last_cos.copy_from_slice(&cos[..rest.len()]);
    last_sin.copy_from_slice(&sin[..rest.len()]);
}

/// The sums over all frequencies, lane by lane, real and imaginary.
#[inline(always)]
fn sweep_sums<const FMA: bool>(
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
        // m₀ + w(m₁ + w(m₂ + …)), w the phasor of one step; the sum is then rotated to the first frequency.
        // One array for each point: the compiler treats an array of them as a matrix, and scatters it, 25 times slower.
        let zeros = [0.0f32; LANES];
        let (mut a_re, mut a_im) = ((zeros, zeros, zeros, zeros), (zeros, zeros, zeros, zeros));
        let turn = |[a_re, a_im]: [f32; 2], p: usize, l: usize, [re, im]: [f32; 2]| {
            let turned = fused::<FMA>(-a_im, w_im[p][l], re);
            let aside = fused::<FMA>(a_im, w_re[p][l], im);
            [fused::<FMA>(a_re, w_re[p][l], turned), fused::<FMA>(a_re, w_im[p][l], aside)]
        };
        for (re, im) in re.iter().zip(im).rev() {
            for l in 0..LANES {
                let sample = [re[l], im[l]];
                [a_re.0[l], a_im.0[l]] = turn([a_re.0[l], a_im.0[l]], 0, l, sample);
                [a_re.1[l], a_im.1[l]] = turn([a_re.1[l], a_im.1[l]], 1, l, sample);
                [a_re.2[l], a_im.2[l]] = turn([a_re.2[l], a_im.2[l]], 2, l, sample);
                [a_re.3[l], a_im.3[l]] = turn([a_re.3[l], a_im.3[l]], 3, l, sample);
            }
        }
        let a_re: [[f32; LANES]; POINTS] = [a_re.0, a_re.1, a_re.2, a_re.3];
        let a_im: [[f32; LANES]; POINTS] = [a_im.0, a_im.1, a_im.2, a_im.3];
        let start = steps.start + steps.step * (chunk * RECURRENCE) as f64;
        for p in 0..POINTS {
            let (mut turns, mut turned) = ([0.0f32; LANES], [[0.0f32; LANES]; 2]);
            for l in 0..LANES {
                turns[l] = wrap_fast(lengths[p][l] * start);
            }
            for l in 0..LANES {
                let (s, c) = sin_cos_turns::<FMA>(turns[l]);
                turned[0][l] = fused::<FMA>(a_re[p][l], c, -a_im[p][l] * s);
                turned[1][l] = fused::<FMA>(a_re[p][l], s, a_im[p][l] * c);
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
    use crate::wave::interval::phasor_f64;
    use crate::wave::phasor;
    use crate::wave::simd::{waves, weighted_sweep};
    use num_complex::Complex64;

    #[test]
    fn waves_are_exact_to_the_last_digits_and_bit_identical_in_every_instruction_set() {
        for count in [0, 1, 7, 8, 9, 37] {
            let delays: Vec<f64> = (0..count).map(|k| f64::from(k) * 0.618_034 - 7.0).collect();
            let zeros = vec![0.0; delays.len()];
            for frequency in [0.0, 0.25, -1.3, 1234.567] {
                let [mut cos, mut sin, mut plain_cos, mut plain_sin] = [(); 4].map(|()| zeros.clone());
                waves(frequency, &delays, &mut cos, &mut sin);
                waves_body(frequency, &delays, &mut plain_cos, &mut plain_sin);
                assert_eq!((&cos, &sin), (&plain_cos, &plain_sin));
                for ((delay, cos), sin) in delays.iter().zip(cos).zip(sin) {
                    let expected = phasor_f64(frequency * delay);
                    let error = (Complex64::new(cos, sin) - expected).norm();
                    assert!(error < 1e-15, "{frequency} x {delay}: {error:e}");
                }
            }
        }
    }

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
            weighted_sweep_body::<false>(&samples, &lengths, steps, &mut plain);
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
