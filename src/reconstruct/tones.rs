//! Weighted samples at few frequencies: the sweep compressed for the whole volume, then again for each slab.
//!
//! Skeletons nest: the tones of a slab are found among those of the volume, so that the second compression is small.
//! Sums run over fixed blocks of frequencies and microphones, so neither threads nor memory change the bytes.

use super::no_room;
use super::skeleton::{greatest_error, skeleton};
use super::weights::Weights;
use crate::acquisition::CubeSource;
use crate::error::Result;
use crate::grid::{room, zeros};
use crate::progress::{Observer, advance, stage};
use crate::wave::interval::PathInterval;
use crate::wave::simd::leave_wide_registers;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par, c32, c64};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Columns of a product that one thread takes at a time.
const BLOCK: usize = 1024;

/// Frequencies read at a time. Part of the order of sums, so it is fixed.
pub(super) const FREQUENCIES: usize = 64;

/// Weighted samples at a few frequencies.
#[derive(Debug, Clone)]
pub(super) struct Tones {
    /// f_q/c with the sign of the inverse, −1/m.
    pub(super) per_metre: Vec<f64>,
    /// `[Q, width]`: one row of microphones or nodes per tone.
    pub(super) samples: Vec<Complex32>,
}

impl Tones {
    /// Room for so many tones, empty.
    ///
    /// # Errors
    /// They do not fit in memory.
    pub(super) fn room(tones: usize, width: usize) -> Result<Self> {
        let (count, nodes) = (tones as u64, width as u64);
        let samples = room(count.saturating_mul(nodes)).ok_or_else(|| no_room(count, nodes))?;
        Ok(Self { per_metre: Vec::with_capacity(tones), samples })
    }
}

/// A sweep compressed for one volume, to be compressed again for its slabs.
#[derive(Debug)]
pub(super) struct VolumeTones {
    pub(super) tones: Tones,
    /// `Σ|w m| / Σw`: what one unit of relative error comes to in the volume.
    pub(super) modulus: f64,
    /// The chosen frequencies, Hz.
    frequencies: Vec<f64>,
    /// Frequencies of the sweep at which errors are measured, Hz, and the weights that make them of the chosen ones.
    witnesses: Vec<f64>,
    at_witnesses: Mat<c64>,
}

/// How a slab's tones follow from the volume's.
#[derive(Debug)]
pub(super) struct SlabTones {
    /// The depths that share them.
    pub(super) planes: Range<usize>,
    chosen: Vec<usize>,
    weights: Mat<c32>,
    /// The greatest error of the two steps together, relative to one.
    pub(super) error: f64,
}

impl VolumeTones {
    /// Compresses a cube, block by block, for all path lengths of `interval` to within `tolerance`.
    pub(super) fn compress(
        source: &mut dyn CubeSource,
        weights: &Weights,
        interval: PathInterval,
        tolerance: f64,
        observer: &dyn Observer,
    ) -> Result<Self> {
        let setup = source.setup();
        let (n_f, n_mic) = (setup.sweep.len(), setup.array.len());
        let skeleton = skeleton(setup.sweep.frequencies(), interval, tolerance);
        let frequencies: Vec<f64> = skeleton.chosen().iter().map(|&n| setup.sweep.frequencies()[n]).collect();
        let per_metre = frequencies.iter().map(|f| -f / interval.sound_speed).collect();
        let w = Mat::<c32>::from_fn(frequencies.len(), n_f, |q, n| {
            let w = skeleton.weight(q, n) * f64::from(weights.frequency[n]);
            Complex32::new(w.re as f32, w.im as f32)
        });
        let (witnesses, at_witnesses) = skeleton.witnesses(setup.sweep.frequencies(), interval);
        drop(skeleton);
        let room = (frequencies.len() as u64).saturating_mul(n_mic as u64);
        let mut samples = zeros(room).ok_or_else(|| no_room(frequencies.len() as u64, n_mic as u64))?;
        let mut modulus = 0.0;
        stage(observer, "compressing the sweep", n_f as u64, || {
            source.visit(FREQUENCIES, &mut |range, block| {
                let moduli: Vec<f64> = block
                    .par_chunks_exact(n_mic)
                    .zip(range.clone())
                    .map(|(row, f)| weights.modulus(f, row))
                    .collect();
                modulus += moduli.iter().sum::<f64>();
                add_product(w.subcols(range.start, range.len()), block, n_mic, &mut samples);
                advance(observer, range.len() as u64)
            })
        })?;
        for row in samples.chunks_exact_mut(n_mic) {
            for (m, w) in row.iter_mut().zip(&weights.microphone) {
                *m *= w;
            }
        }
        Ok(Self { tones: Tones { per_metre, samples }, modulus, frequencies, witnesses, at_witnesses })
    }

    /// The tones of every slab of so many `depths`, `thickness` at a time, whose path lengths `interval` tells.
    pub(super) fn slabs(
        &self,
        depths: usize,
        thickness: usize,
        interval: impl Fn(Range<usize>) -> PathInterval + Sync,
        tolerance: f64,
    ) -> Vec<SlabTones> {
        let slab = |first: usize| {
            let planes = first..(first + thickness).min(depths);
            self.nest(planes.clone(), interval(planes), tolerance)
        };
        (0..depths).into_par_iter().step_by(thickness).map(slab).collect()
    }

    /// Finds the tones of a slab among those of the volume, so that both steps together stay within `tolerance`.
    fn nest(&self, planes: Range<usize>, interval: PathInterval, tolerance: f64) -> SlabTones {
        let mut step = 0.5 * tolerance;
        loop {
            let inner = skeleton(&self.frequencies, interval, step);
            let both: Mat<c64> = inner.weights() * &self.at_witnesses;
            leave_wide_registers();
            let chosen: Vec<f64> = inner.chosen().iter().map(|&q| self.frequencies[q]).collect();
            let error = greatest_error(&interval, &self.witnesses, &chosen, both.as_ref());
            if error <= tolerance || inner.chosen().len() == self.frequencies.len() {
                let weights = Mat::from_fn(chosen.len(), self.frequencies.len(), |q, n| {
                    let w = inner.weight(q, n);
                    Complex32::new(w.re as f32, w.im as f32)
                });
                return SlabTones { planes, chosen: inner.chosen().to_vec(), weights, error };
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
    ///
    /// # Errors
    /// They do not fit in memory.
    pub(super) fn of(&self, volume: &Tones, width: usize) -> Result<Tones> {
        let mut tones = Tones::room(self.len(), width)?;
        self.select(volume, width, &mut tones);
        Ok(tones)
    }

    /// The same in place of others, in their room if they have enough.
    pub(super) fn select(&self, volume: &Tones, width: usize, tones: &mut Tones) {
        tones.samples.clear();
        tones.samples.resize(self.len() * width, Complex32::ZERO);
        add_product(self.weights.as_ref(), &volume.samples, width, &mut tones.samples);
        tones.per_metre.clear();
        tones.per_metre.extend(self.chosen.iter().map(|&q| volume.per_metre[q]));
    }
}

/// `rows += w · samples`, with `samples` and `rows` in rows of `width`.
fn add_product(w: MatRef<'_, c32>, samples: &[Complex32], width: usize, rows: &mut [Complex32]) {
    let samples = MatRef::from_row_major_slice(samples, w.ncols(), width);
    let mut blocks = Vec::with_capacity(width.div_ceil(BLOCK));
    let mut rest = MatMut::from_row_major_slice_mut(rows, w.nrows(), width);
    while rest.ncols() > BLOCK {
        let (block, others) = rest.split_at_col_mut(BLOCK);
        blocks.push(block);
        rest = others;
    }
    blocks.push(rest);
    blocks.into_par_iter().enumerate().for_each(|(index, block)| {
        let columns = samples.subcols(index * BLOCK, block.ncols());
        matmul(block, Accum::Add, w, columns, Complex32::ONE, Par::Seq);
        leave_wide_registers();
    });
}
