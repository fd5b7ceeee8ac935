//! Weighted samples at few frequencies: the sweep compressed for the whole volume, then again for each slab.
//!
//! The two nest: the skeleton tones of a slab are found among the virtual tones of the volume.
//! Sums run over fixed blocks of frequencies and microphones, so neither threads nor memory change the bytes.

use super::no_room;
use super::skeleton::skeleton;
use super::virtual_tones::VirtualTones;
use super::weights::Weights;
use crate::acquisition::CubeSource;
use crate::error::Result;
use crate::grid::{room, zeros};
use crate::progress::{Observer, advance, stage};
use crate::wave::interval::PathInterval;
use crate::wave::simd::leave_wide_registers;
use faer::linalg::matmul::matmul;
use faer::prelude::ReborrowMut;
use faer::{Accum, Mat, MatMut, MatRef, Par, c32};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Columns of a product that one thread takes at a time, at the least and at the most.
const BLOCK: [usize; 2] = [64, 1024];

/// Samples whose moduli one thread sums at a time.
const SUMMED: usize = 1 << 14;

/// Frequencies of one product. Part of the order of sums, so it is fixed.
pub(super) const FREQUENCIES: usize = 64;

/// Frequencies read at a time: several products where there are few microphones, since threads take time to wake.
pub(super) fn frequencies_at_once(microphones: usize) -> usize {
    FREQUENCIES * ((1 << 18) / (FREQUENCIES * microphones)).clamp(1, 16)
}

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
    /// Their frequencies, Hz.
    frequencies: Vec<f64>,
    /// The greatest error of a measured tone made of them, relative to one.
    error: f64,
    /// By how much errors of their own can grow in it.
    growth: f64,
}

/// How a slab's tones follow from the volume's.
#[derive(Debug)]
pub(super) struct SlabTones {
    /// The depths that share them.
    pub(super) planes: Range<usize>,
    chosen: Vec<usize>,
    weights: Mat<c32>,
    /// A bound of the two steps' error together, relative to one.
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
        let found = VirtualTones::find(setup.sweep, interval, tolerance);
        let frequencies = found.frequencies().to_vec();
        let per_metre = frequencies.iter().map(|f| -f / interval.sound_speed).collect();
        let room = (frequencies.len() as u64).saturating_mul(n_mic as u64);
        let mut samples = zeros(room).ok_or_else(|| no_room(frequencies.len() as u64, n_mic as u64))?;
        let mut modulus = 0.0;
        stage(observer, "compressing the sweep", n_f as u64, || {
            source.visit(frequencies_at_once(n_mic), &mut |range, block| {
                let moduli: Vec<f64> = block
                    .par_chunks_exact(n_mic)
                    .with_min_len(SUMMED / n_mic + 1)
                    .zip(range.clone())
                    .map(|(row, f)| weights.modulus(f, row))
                    .collect();
                modulus += moduli.iter().sum::<f64>();
                let products: Vec<_> = (range.clone())
                    .step_by(FREQUENCIES)
                    .map(|first| found.weights(first..(first + FREQUENCIES).min(range.end), weights))
                    .collect();
                let products: Vec<_> = products.iter().map(|(tones, w)| (tones.start, w.as_ref())).collect();
                add_products(&products, block, n_mic, &mut samples);
                advance(observer, range.len() as u64)
            })
        })?;
        for row in samples.chunks_exact_mut(n_mic) {
            for (m, w) in row.iter_mut().zip(&weights.microphone) {
                *m *= w;
            }
        }
        let VirtualTones { error, growth, .. } = found;
        Ok(Self { tones: Tones { per_metre, samples }, modulus, frequencies, error, growth })
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
        let inner = skeleton(&self.frequencies, interval, (tolerance - self.error) / self.growth);
        let weights = Mat::from_fn(inner.chosen().len(), self.frequencies.len(), |q, k| {
            let w = inner.weight(q, k);
            Complex32::new(w.re as f32, w.im as f32)
        });
        let error = self.error + self.growth * inner.error();
        SlabTones { planes, chosen: inner.chosen().to_vec(), weights, error }
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
        add_products(&[(0, self.weights.as_ref())], &volume.samples, width, &mut tones.samples);
        tones.per_metre.clear();
        tones.per_metre.extend(self.chosen.iter().map(|&q| volume.per_metre[q]));
    }
}

/// For each `(first, w)` in turn `rows[first ..] += w · samples`, with the next of `samples`; these and `rows` are in rows of
/// `width`.
fn add_products(
    products: &[(usize, MatRef<'_, c32>)],
    samples: &[Complex32],
    width: usize,
    rows: &mut [Complex32],
) {
    let samples = MatRef::from_row_major_slice(samples, samples.len() / width, width);
    // A few for each thread, but no scraps.
    let columns = (width / 8).next_multiple_of(BLOCK[0]).clamp(BLOCK[0], BLOCK[1]);
    let mut blocks = Vec::with_capacity(width.div_ceil(columns));
    let mut rest = MatMut::from_row_major_slice_mut(rows, rows.len() / width, width);
    while rest.ncols() > columns {
        let (block, others) = rest.split_at_col_mut(columns);
        blocks.push(block);
        rest = others;
    }
    blocks.push(rest);
    blocks.into_par_iter().enumerate().for_each(|(index, mut block)| {
        let mut from = samples.subcols(index * columns, block.ncols());
        for (first, w) in products {
            let (these, others) = from.split_at_row(w.ncols());
            let rows = block.rb_mut().subrows_mut(*first, w.nrows());
            matmul(rows, Accum::Add, w, these, Complex32::ONE, Par::Seq);
            from = others;
        }
        leave_wide_registers();
    });
}
