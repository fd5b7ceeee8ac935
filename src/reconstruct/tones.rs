//! Weighted samples at few frequencies: the sweep compressed for the whole volume, then again for each slab.
//!
//! Skeletons nest: the tones of a slab are found among those of the volume, so that the second compression is small.
//! Sums are done by fixed blocks of microphones, so threads do not change the bytes.

use super::Weights;
use super::skeleton::{Skeleton, greatest_error, skeleton};
use crate::acquisition::DataCube;
use crate::wave::interval::PathInterval;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par, c32, c64};
use num_complex::Complex32;
use rayon::prelude::*;

/// Columns of a product that one thread takes at a time.
const BLOCK: usize = 1024;

/// Weighted samples at a few frequencies.
#[derive(Debug, Clone)]
pub(super) struct Tones {
    /// f_q/c with the sign of the inverse, −1/m.
    pub(super) per_metre: Vec<f64>,
    /// `[Q, width]`: one row of microphones or nodes per tone.
    pub(super) samples: Vec<Complex32>,
}

/// A sweep compressed for one volume, to be compressed again for its slabs.
#[derive(Debug)]
pub(super) struct VolumeTones {
    pub(super) tones: Tones,
    /// The chosen frequencies, Hz.
    frequencies: Vec<f64>,
    skeleton: Skeleton,
}

/// How a slab's tones follow from the volume's.
#[derive(Debug)]
pub(super) struct SlabTones {
    chosen: Vec<usize>,
    weights: Mat<c32>,
    /// The greatest error of the two steps together, relative to one.
    pub(super) error: f64,
}

impl VolumeTones {
    /// Compresses a cube for all path lengths of `interval` to within `tolerance`.
    pub(super) fn compress(
        cube: &DataCube,
        weights: &Weights,
        interval: PathInterval,
        tolerance: f64,
    ) -> Self {
        let skeleton = skeleton(cube.sweep.frequencies(), interval, tolerance);
        let frequencies: Vec<f64> = skeleton.chosen().iter().map(|&n| cube.sweep.frequencies()[n]).collect();
        let w = Mat::<c32>::from_fn(frequencies.len(), cube.sweep.len(), |q, n| {
            let w = skeleton.weight(q, n) * f64::from(weights.frequency[n]);
            Complex32::new(w.re as f32, w.im as f32)
        });
        let mut samples = product(w.as_ref(), &cube.samples, cube.array.len());
        for row in samples.chunks_exact_mut(cube.array.len()) {
            for (m, w) in row.iter_mut().zip(&weights.microphone) {
                *m *= w;
            }
        }
        let per_metre = frequencies.iter().map(|f| -f / cube.sound_speed).collect();
        Self { tones: Tones { per_metre, samples }, frequencies, skeleton }
    }

    /// Finds the tones of a slab among those of the volume, so that both steps together stay within `tolerance`.
    pub(super) fn nest(&self, all: &[f64], interval: PathInterval, tolerance: f64) -> SlabTones {
        let mut step = 0.5 * tolerance;
        loop {
            let inner = skeleton(&self.frequencies, interval, step);
            let both: Mat<c64> = inner.weights() * self.skeleton.weights();
            let chosen: Vec<f64> = inner.chosen().iter().map(|&q| self.frequencies[q]).collect();
            let error = greatest_error(&interval, all, &chosen, both.as_ref());
            if error <= tolerance || inner.chosen().len() == self.frequencies.len() {
                let weights = Mat::from_fn(chosen.len(), self.frequencies.len(), |q, n| {
                    let w = inner.weight(q, n);
                    Complex32::new(w.re as f32, w.im as f32)
                });
                return SlabTones { chosen: inner.chosen().to_vec(), weights, error };
            }
            step /= 3.0;
        }
    }
}

impl SlabTones {
    /// Number of tones.
    pub(super) fn len(&self) -> usize {
        self.chosen.len()
    }

    /// The slab's tones from the volume's, whose rows are `width` wide.
    pub(super) fn of(&self, volume: &Tones, width: usize) -> Tones {
        Tones {
            per_metre: self.chosen.iter().map(|&q| volume.per_metre[q]).collect(),
            samples: product(self.weights.as_ref(), &volume.samples, width),
        }
    }
}

/// `w · samples`, with `samples` and the result in rows of `width`.
fn product(w: MatRef<'_, c32>, samples: &[Complex32], width: usize) -> Vec<Complex32> {
    let samples = MatRef::from_row_major_slice(samples, w.ncols(), width);
    let blocks: Vec<Mat<c32>> = (0..width.div_ceil(BLOCK))
        .into_par_iter()
        .map(|block| {
            let first = block * BLOCK;
            let columns = samples.subcols(first, BLOCK.min(width - first));
            let mut result = Mat::zeros(w.nrows(), columns.ncols());
            matmul(result.as_mut(), Accum::Replace, w, columns, Complex32::ONE, Par::Seq);
            result
        })
        .collect();
    let mut rows = vec![Complex32::ZERO; w.nrows() * width];
    for (block, result) in blocks.iter().enumerate() {
        for (row, out) in rows.chunks_exact_mut(width).enumerate() {
            for (column, value) in out[block * BLOCK..].iter_mut().take(result.ncols()).enumerate() {
                *value = result[(row, column)];
            }
        }
    }
    rows
}
