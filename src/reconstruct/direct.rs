//! Eq. 13 as written: every voxel, microphone and frequency, with f64 totals. The oracle.

mod linear;

pub(super) use linear::linear;

use crate::acquisition::{CubeSource, Instrument};
use crate::error::Result;
use crate::grid::Grid;
use crate::progress::advance;
use crate::reconstruct::job::Job;
use crate::reconstruct::plan::cost::Cost;
use crate::reconstruct::volume::{Batch, SlabDriver};
use crate::reconstruct::window::Weights;
use crate::reconstruct::{Method, ReconstructionInfo, silence};
use crate::wave::simd::{LANES, Steps, SweepSamples, weighted_sum, weighted_sweep};
use glam::DVec3;
use num_complex::Complex32;
use rayon::prelude::*;

/// Voxels that are summed together, so that they share what is read of the samples.
pub(super) const TOGETHER: usize = 64;

/// Voxels that are worked on before they are passed on, or a plane of them: enough to keep every thread busy.
const AT_ONCE: usize = 64 * TOGETHER;

/// Operations for a voxel, whatever it is the sum of.
const OPERATIONS_PER_VOXEL: f64 = 700.0;

/// How a direct sum is carried out.
#[derive(Debug, Clone, Copy)]
pub(super) struct DirectPlan {
    grid: Grid,
    /// Depths that are worked on at a time.
    depths: usize,
}

impl DirectPlan {
    pub(super) fn new(grid: &Grid) -> Self {
        Self { grid: *grid, depths: AT_ONCE.div_ceil(grid.plane_len().max(1)).min(grid.z.count) }
    }

    /// With the memory of a batch for this many threads.
    pub(super) fn cost(&self, instrument: &Instrument, threads: usize) -> Cost<'static> {
        let n_mic = instrument.array.len();
        // Whole vectors of microphones.
        let each = n_mic.next_multiple_of(LANES) as f64;
        let per_term = if instrument.sweep.step().is_some() { 8.0 } else { 30.0 };
        let planes = SlabDriver::bytes(self.grid.plane_len() as u64, self.depths, self.grid.z.count);
        let samples = instrument.cube_bytes().saturating_mul(2).saturating_add(planes);
        let lengths = (TOGETHER * n_mic * size_of::<f64>()) as u64;
        Cost {
            operations: self.grid.voxel_count() as f64
                * (OPERATIONS_PER_VOXEL + each * (60.0 + per_term * instrument.sweep.len() as f64)),
            usual: Batch::of_threads(threads),
            bytes: Box::new(move |batch| {
                samples.saturating_add(lengths.saturating_mul(batch.workers as u64))
            }),
        }
    }
}

/// Gives the volume to the job's sink; any grid, any microphones. Cost: 8 operations per voxel, microphone and frequency
/// where the steps are even, else a phasor; holds all samples, twice while they are rearranged, and a few depths.
pub(super) fn direct(job: Job<'_>, plan: &DirectPlan) -> Result<ReconstructionInfo> {
    sum_over_paths(job, plan, Method::Direct, Instrument::path_length_at)
}

/// The same sum over path lengths of any kind.
fn sum_over_paths(
    job: Job<'_>,
    plan: &DirectPlan,
    method: Method,
    path_length: impl Fn(&Instrument, DVec3, usize) -> f64 + Sync,
) -> Result<ReconstructionInfo> {
    let Job { source, weights, grid, batch, sink, observer, .. } = job;
    let samples = weighted_samples(source, weights)?;
    let instrument = source.instrument();
    let sums = sums_of(&samples, instrument);
    drop(samples);
    let plane = grid.plane_len();
    let work = |depths: usize| (depths * plane) as u64;
    let driver = SlabDriver::even(grid, plan.depths, work, observer);
    let driver = SlabDriver { stage: "reconstructing (direct sum)", ..driver };
    driver.run(ReconstructionInfo::plain(method, 0.0), sink, |_, depths, planes| {
        let run = batch.least_run(planes.len().div_ceil(TOGETHER));
        planes.par_chunks_mut(TOGETHER).with_min_len(run).enumerate().try_for_each_init(
            || lengths(instrument.array.len()),
            |lengths, (chunk, voxels)| {
                let first = depths.start * plane + chunk * TOGETHER;
                image(instrument, &path_length, grid, &sums, first, voxels, lengths);
                advance(observer, voxels.len() as u64)
            },
        )
    })
}

/// Buffers for the path lengths that [`image`] computes.
pub(super) fn lengths(microphones: usize) -> Vec<f64> {
    vec![0.0; TOGETHER * microphones.next_multiple_of(LANES)]
}

/// Sums up to [`TOGETHER`] voxels, the first of which is the `first` of the grid, into their places.
pub(super) fn image(
    instrument: &Instrument,
    path_length: impl Fn(&Instrument, DVec3, usize) -> f64,
    grid: &Grid,
    sums: &Sums,
    first: usize,
    voxels: &mut [Complex32],
    lengths: &mut [f64],
) {
    let padded = instrument.array.len().next_multiple_of(LANES);
    for (i, lengths) in lengths.chunks_exact_mut(padded).enumerate().take(voxels.len()) {
        let (row, ix) = ((first + i) / grid.x.count, (first + i) % grid.x.count);
        let p = grid.position(ix, row % grid.y.count, row / grid.y.count);
        for (microphone, length) in lengths[..instrument.array.len()].iter_mut().enumerate() {
            *length = path_length(instrument, p, microphone);
        }
    }
    let mut totals = [[0.0; 2]; TOGETHER];
    let totals = &mut totals[..voxels.len()];
    sums(&lengths[..voxels.len() * padded], totals);
    for (voxel, total) in voxels.iter_mut().zip(totals) {
        *voxel = Complex32::new(total[0] as f32, total[1] as f32);
    }
}

/// All samples with their weights, `[n_f, n_mic]`.
fn weighted_samples(source: &mut dyn CubeSource, weights: &Weights) -> Result<Vec<Complex32>> {
    let mut samples = silence(source.instrument().sweep.len(), source.instrument().array.len())?;
    source.visit(1, &mut |range, row| {
        let to = &mut samples[range.start * row.len()..][..row.len()];
        to.iter_mut().zip(weights.weighted(range.start, row)).for_each(|(to, m)| *to = m);
        Ok(())
    })?;
    Ok(samples)
}

/// Sums over samples of a few voxels, given by their padded path lengths.
pub(super) type Sums<'a> = Box<dyn Fn(&[f64], &mut [[f64; 2]]) + Sync + 'a>;

/// The sums that suit a sweep: by recurrence where its steps are even, else frequency by frequency.
fn sums_of<'a>(samples: &[Complex32], instrument: &'a Instrument) -> Sums<'a> {
    let (n_f, n_mic, c) = (instrument.sweep.len(), instrument.array.len(), instrument.sound_speed);
    if let Some(step) = instrument.sweep.step() {
        let steps = Steps { start: -instrument.sweep.start() / c, step: -step / c, count: n_f };
        let samples = SweepSamples::new(n_f, n_mic, |f, r| samples[f * n_mic + r]);
        return Box::new(move |lengths, totals| weighted_sweep(&samples, lengths, steps, totals));
    }
    sums_of_tones(samples, instrument.sweep.frequencies().iter().map(|f| -f / c).collect(), n_mic)
}

/// Sums over any tones, tone by tone, of samples `[tones, n_mic]`.
pub(super) fn sums_of_tones<'a>(samples: &[Complex32], per_metre: Vec<f64>, n_mic: usize) -> Sums<'a> {
    let split = |row: &[Complex32]| -> [Vec<f32>; 2] {
        [row.iter().map(|m| m.re).collect(), row.iter().map(|m| m.im).collect()]
    };
    let samples: Vec<[Vec<f32>; 2]> = samples.chunks_exact(n_mic).map(split).collect();
    Box::new(move |lengths, totals| {
        for (lengths, total) in lengths.chunks_exact(n_mic.next_multiple_of(LANES)).zip(totals) {
            for (per_metre, [re, im]) in per_metre.iter().zip(&samples) {
                weighted_sum(*per_metre, &lengths[..n_mic], [re, im], total);
            }
        }
    })
}
