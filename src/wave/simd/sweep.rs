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
        let mut turns = [0.0f32; LANES];
        for l in 0..LANES {
            turns[l] = wrap_fast(lengths[p][l] * steps.step);
        }
        for l in 0..LANES {
            (w_im[p][l], w_re[p][l]) = sin_cos_turns(turns[l]);
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
