//! What a job costs by each method: operations and bytes by closed formulas, never by a clock.
//!
//! The same counts choose the method, so the same job always takes the same path.

use crate::acquisition::Instrument;
use crate::grid::Grid;
use crate::reconstruct::compress::{
    DENSER, frequencies_at_once, slabs_of, tones_for, virtual_tone_count, witnesses_for,
};
use crate::reconstruct::convolution::{self, usual_batch};
use crate::reconstruct::volume::{Batch, SlabDriver};
use crate::reconstruct::{Method, ReconstructOptions, backprojection, direct};
use crate::wave::interval::PathInterval;
use serde::Serialize;

/// What one method would take for a job.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Estimate {
    /// The method; never [`Method::Auto`].
    pub method: Method,
    /// Why it cannot be used here, if so.
    pub obstacle: Option<String>,
    /// Floating-point operations, to within a factor of two.
    pub operations: f64,
    /// Bytes at the peak beside the samples that the source holds, and beside the volume: within
    /// [`ReconstructOptions::memory`], or where as little as possible is worked on at a time.
    pub bytes: u64,
    /// What `bytes` are of.
    #[serde(skip)]
    pub(crate) batch: Batch,
}

/// What every method would take for a job, and which one is chosen.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Estimates {
    /// One estimate for each method but [`Method::Auto`].
    pub methods: Vec<Estimate>,
    /// The place in `methods` of the one that [`reconstruct`](crate::reconstruct::reconstruct()) takes.
    pub chosen: usize,
}

impl Estimates {
    /// The estimate of the method that [`reconstruct`](crate::reconstruct::reconstruct()) takes.
    pub fn chosen(&self) -> &Estimate {
        &self.methods[self.chosen]
    }

    /// The estimate of a method; `None` for [`Method::Auto`].
    pub fn of(&self, method: Method) -> Option<&Estimate> {
        self.methods.iter().find(|estimate| estimate.method == method)
    }
}

/// The estimates for a job, whatever `options.method` says; that of [`of_convolution`] is known.
pub(crate) fn estimates(
    instrument: &Instrument,
    grid: &Grid,
    options: &ReconstructOptions,
    convolution: Result<Estimate, String>,
    backprojection: Option<&backprojection::Plan>,
    threads: usize,
) -> Vec<Estimate> {
    let convolution = convolution.unwrap_or_else(|obstacle| impossible(Method::Convolution, obstacle));
    let backprojection = match backprojection {
        Some(plan) => of_backprojection(instrument, options, plan, threads),
        None if options.tolerance > 0.0 => impossible(
            Method::Backprojection,
            "of no use here, where convolution is far faster; ask for it by name to see its cost".to_owned(),
        ),
        None => impossible(
            Method::Backprojection,
            "0 leaves no room for interpolation; give a tolerance above 0 (1e-6, say)".to_owned(),
        ),
    };
    let direct = of_direct(instrument, grid, options, threads);
    // The same sum over other path lengths.
    let linear = Estimate { method: Method::Linear, ..direct.clone() };
    vec![convolution, backprojection, direct, linear]
}

fn impossible(method: Method, obstacle: String) -> Estimate {
    let (obstacle, operations) = (Some(obstacle), f64::INFINITY);
    Estimate { method, obstacle, operations, bytes: 0, batch: Batch::LEAST }
}

/// Operations of a complex multiplication and addition.
const PRODUCT: f64 = 8.0;

/// An operation of a transform takes as long as so many of a straight loop.
const TRANSFORM: f64 = 2.0;

/// Bytes of a complex number in single precision.
const COMPLEX: u64 = 8;

/// Taps of a tone's interpolator, about.
const TAPS: f64 = 12.0;

/// What a compression to so many virtual `tones` takes: operations, and bytes for their weights.
fn compression(instrument: &Instrument, tones: f64) -> (f64, u64) {
    let (n_f, n_mic) = (instrument.sweep.len() as f64, instrument.array.len() as f64);
    let found = n_f * (10.0 * TAPS * TAPS + 40.0 * TAPS);
    // A sample is turned, its modulus taken, and it goes to a few tones with real weights.
    let summed = 2.0 * PRODUCT + 0.5 * PRODUCT * TAPS.min(tones);
    (found + summed * n_f * n_mic, (n_f * 10.0 * TAPS * 8.0) as u64)
}

/// Bytes that a thread takes to find a slab's tones among the volume's: both at delays, and their difference.
fn nesting(instrument: &Instrument, of_volume: f64, slab: &PathInterval) -> u64 {
    let bandwidth = instrument.sweep.bandwidth();
    let witnesses = witnesses_for(bandwidth * slab.duration()).min(of_volume);
    (3.0 * 8.0 * (DENSER * slab.points_for(bandwidth)) as f64 * witnesses) as u64
}

/// Bytes of a block of frequencies as it is read.
fn block_bytes(instrument: &Instrument) -> u64 {
    let frequencies = frequencies_at_once(instrument.array.len()).min(instrument.sweep.len());
    COMPLEX * (frequencies as u64).saturating_mul(instrument.array.len() as u64)
}

/// Of Eq. 16 by such a plan.
pub(crate) fn of_convolution(
    instrument: &Instrument,
    grid: &Grid,
    options: &ReconstructOptions,
    plan: &convolution::Plan,
    threads: usize,
) -> Estimate {
    let layout = &plan.layout;
    let lattice = &layout.lattice;
    let (depths, plane) = (grid.z.count, (grid.x.count as u64).saturating_mul(grid.y.count as u64));
    let points = layout.points() as f64;
    // Phases, two transforms with what symmetry and pruning save of them, the product and the sum.
    let pair = points * (20.0 + TRANSFORM * 7.5 * points.log2()) * layout.pairs() as f64;
    let spectra = points * (TRANSFORM * 5.0 * points.log2()) * layout.node_parts.len() as f64;
    let scratch = 12 * layout.points().saturating_mul(layout.node_parts.len()) as u64;
    let scratch = |batch: Batch| scratch.saturating_mul(batch.workers as u64);
    let Some(slabs) = &plan.slabs else {
        let n_f = instrument.sweep.len() as f64;
        // Spectra, and the samples that they are made of, as they are read and weighted.
        let [spectra_of_tone, of_worker] = plan.plain_bytes();
        let tone = spectra_of_tone + COMPLEX * 2 * instrument.array.len() as u64;
        let planes = SlabDriver::bytes(plane, convolution::DEPTHS, depths);
        let bytes = |batch: Batch| {
            let spectra = tone.saturating_mul(batch.frequencies as u64);
            let scratch = of_worker.saturating_mul(batch.workers as u64);
            spectra.saturating_add(scratch).saturating_add(planes)
        };
        let operations = n_f * (depths as f64 * pair + spectra);
        let usual = usual_batch(layout, instrument.sweep.len(), threads);
        return possible(Method::Convolution, operations, options, usual, bytes);
    };
    let (thickness, of_first) = (slabs.thickness, plan.compression.virtual_tones());
    let whole = instrument.path_interval(grid, 0..depths);
    let of_volume = virtual_tone_count(&instrument.sweep, &whole, of_first) as f64;
    let width = lattice.width() as f64;
    let (mut operations, bytes_finding) = compression(instrument, of_volume);
    let nesting = nesting(instrument, of_volume, &instrument.path_interval(grid, 0..thickness.min(depths)));
    let mut most = 0.0f64;
    for planes in slabs_of(depths, thickness) {
        let duration = instrument.path_interval(grid, planes.clone()).duration();
        let of_slab = tones_for(instrument.sweep.bandwidth() * duration, of_first).min(of_volume);
        operations += of_slab * (planes.len() as f64 * pair + spectra + PRODUCT * of_volume * width);
        most = most.max(of_slab);
    }
    operations += plan.near.operations;
    let complex = |n: f64| (n * COMPLEX as f64) as u64;
    let microphones = complex(of_volume * instrument.array.len() as f64);
    let nodes = complex(of_volume * width);
    let both = if lattice.spreads() { microphones.saturating_add(nodes) } else { nodes };
    let slab = complex(most * (width + layout.tone_len() as f64));
    let compressing = microphones.saturating_add(block_bytes(instrument)).saturating_add(bytes_finding);
    let before = compressing.max(both);
    let bytes = |batch: Batch| {
        let planes = SlabDriver::bytes(plane, batch.slabs * thickness, depths);
        let focusing = slab.saturating_mul(batch.slabs as u64).saturating_add(scratch(batch));
        let focusing = focusing.saturating_add(planes);
        let nesting = nesting.saturating_mul(batch.workers.min(depths.div_ceil(thickness)) as u64);
        let near = plan.near.worker_bytes.saturating_mul(batch.workers as u64);
        let focusing = nodes.saturating_add(focusing).saturating_add(near).saturating_add(nesting);
        before.max(focusing).saturating_add(plan.near.bytes)
    };
    possible(Method::Convolution, operations, options, slabs.usual_batch(layout, threads), bytes)
}

/// The estimate of a method that can be used, in batches that keep to the memory there is.
fn possible(
    method: Method,
    operations: f64,
    options: &ReconstructOptions,
    usual: Batch,
    bytes: impl Fn(Batch) -> u64,
) -> Estimate {
    let batch = usual.within(options.memory, &bytes);
    Estimate { method, obstacle: None, operations, bytes: bytes(batch), batch }
}

fn of_backprojection(
    instrument: &Instrument,
    options: &ReconstructOptions,
    plan: &backprojection::Plan,
    threads: usize,
) -> Estimate {
    let tones = plan.virtual_tones(instrument) as f64;
    let (compressing, finding) = compression(instrument, tones);
    let held = (tones * instrument.array.len() as f64 * COMPLEX as f64) as u64;
    let before = finding.saturating_add(held).saturating_add(block_bytes(instrument));
    let focusing = held.saturating_mul(2).saturating_add(plan.bytes());
    let bytes = |batch: Batch| {
        before.max(focusing.saturating_add((batch.workers as u64).saturating_mul(plan.worker_bytes())))
    };
    let operations = plan.operations() + compressing;
    possible(Method::Backprojection, operations, options, Batch::of_threads(threads), bytes)
}

fn of_direct(instrument: &Instrument, grid: &Grid, options: &ReconstructOptions, threads: usize) -> Estimate {
    let planes = SlabDriver::bytes(grid.plane_len() as u64, direct::depths_at_once(grid), grid.z.count);
    let samples = instrument.cube_bytes().saturating_mul(2).saturating_add(planes);
    let lengths = (64 * instrument.array.len()) as u64 * COMPLEX;
    let bytes = |batch: Batch| samples.saturating_add(lengths.saturating_mul(batch.workers as u64));
    possible(Method::Direct, direct::operations(instrument, grid), options, Batch::of_threads(threads), bytes)
}
