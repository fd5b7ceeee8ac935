//! Eq. 16: on a shared lattice the sum over microphones is a convolution, done by padded 2-D FFTs.
//!
//! `p − r` depends on the difference of indices alone, so one kernel `e^{−i2πf|p−r|/c}` per frequency and depth serves
//! every pair of voxel and microphone ([`SharedLattice`] says when). With a tolerance, the sweep is first compressed to
//! virtual tones for the volume, and these to skeleton tones for each slab of depths, so that Eq. 16 runs over tens of
//! tones instead of all; with tolerance 0 it runs over every one.

mod lattice;
mod layout;
mod line;
mod near_field;
mod padded_axis;
mod plane;
mod pointwise;
mod slab_plan;
mod spectra;
mod workspace;

pub(super) use lattice::SharedLattice;

use crate::acquisition::{CubeSource, Instrument};
use crate::alloc::{try_with_capacity, try_zeroed};
use crate::error::Result;
use crate::grid::Grid;
use crate::progress::{Observer, advance, stage};
use crate::reconstruct::compress::{SlabTones, Tones, VolumeTones, slabs_of};
use crate::reconstruct::volume::Batch;
use crate::reconstruct::volume::Handover;
use crate::reconstruct::window::Weights;
use crate::reconstruct::{Made, Method, VolumeSink, no_room, no_room_for};
use crate::wave::interval::greater;
use crate::wave::simd::Lanes;
use layout::Layout;
use near_field::Near;
use num_complex::Complex32;
use rayon::prelude::*;
use slab_plan::Slabs;
use workspace::Focuses;

/// Bytes of data spectra held at a time when every frequency is summed.
const SPECTRA_BYTES: usize = 256 << 20;

/// What suits so many threads then, where memory does not matter.
pub(super) fn usual_batch(layout: &Layout, frequencies: usize, threads: usize) -> Batch {
    let block = SPECTRA_BYTES / (layout.tone_len() * size_of::<Complex32>());
    Batch { frequencies: block.clamp(1, frequencies), ..Batch::of_threads(threads) }
}

/// The share of the tolerance that the first of the two compressions may use.
pub(super) const FIRST_SHARE: f64 = 0.3;

/// How Eq. 16 is carried out for one job.
#[derive(Debug)]
pub(super) struct Plan {
    pub(super) layout: Layout,
    /// Where there is a tolerance: how depths are divided.
    pub(super) slabs: Option<Slabs>,
    /// What depths take that have no part in the lattice.
    pub(super) near: near_field::Cost,
}

impl Plan {
    /// How the kernels of a lattice are summed, to within what the lattice itself leaves of `tolerance`.
    pub(super) fn new(setup: &Instrument, grid: &Grid, lattice: SharedLattice, tolerance: f64) -> Self {
        let layout = Layout::new(lattice, *grid, setup.geometry);
        let left = tolerance - layout.lattice.error();
        let slabs = (left > 0.0).then(|| Slabs::new(setup, &layout));
        let thickness = slabs.as_ref().map_or(1, |slabs| slabs.thickness);
        let near = near_field::Cost::new(setup, grid, &layout.lattice.near, thickness, FIRST_SHARE * left);
        Self { layout, slabs, near }
    }
}

/// What sums tones at any depth.
struct Depths<'a> {
    layout: &'a Layout,
    focuses: Focuses<'a>,
    /// Those that have no part in the lattice.
    near: Option<Near<'a>>,
    batch: Batch,
    observer: &'a dyn Observer,
}

impl Depths<'_> {
    /// Adds tones to the planes from `first` on, `[plane, y, x]`; `room` is for their spectra.
    fn add(&self, tones: &Tones, room: &mut [Lanes], first: usize, planes: &mut [Complex32]) -> Result<()> {
        let spectra = self.layout.part(room, tones.per_metre.len());
        self.layout.transform_into(&tones.samples, self.batch, spectra)?;
        let spectra = &*spectra;
        let planes = planes.par_chunks_mut(self.layout.grid.plane_len());
        let run = self.batch.least_run(planes.len());
        planes.with_min_len(run).enumerate().try_for_each(|(iz, voxels)| {
            let summed = match &self.near {
                Some(near) => near.image(first + iz, voxels, self.observer)?,
                None => false,
            };
            if !summed {
                self.focuses.with(|focus| focus.add(first + iz, &tones.per_metre, spectra, voxels))?;
            }
            advance(self.observer, tones.per_metre.len() as u64)
        })
    }
}

/// Gives the volume to `sink` by Eq. 16.
///
/// Cost: per tone and depth, for each pair of sub-lattices one kernel of `n_x·n_y` phasors and its FFT, and one inverse
/// FFT per voxel sub-lattice (monostatic: one per depth). With a tolerance a sweep is some `B·T + 10` tones, T the
/// spread of delays within a slab.
pub(super) fn convolution(
    source: &mut dyn CubeSource,
    weights: &Weights,
    (plan, batch): (&Plan, Batch),
    tolerance: f64,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<Made> {
    let layout = &plan.layout;
    match &plan.slabs {
        None => every_frequency(source, weights, layout, batch, sink, observer),
        Some(slabs) => {
            let left = tolerance - layout.lattice.error();
            skeleton_frequencies(source, weights, (layout, slabs, batch), left, sink, observer)
        }
    }
}

/// Depths that are worked on at a time when every frequency is summed: so many that the spectra of the samples, which
/// each such slab computes anew, cost next to nothing.
pub(super) const DEPTHS: usize = 32;

/// All frequencies in ascending order for each slab of depths, in blocks that bound the memory and change no sum.
fn every_frequency(
    source: &mut dyn CubeSource,
    weights: &Weights,
    layout: &Layout,
    batch: Batch,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<Made> {
    let (setup, grid) = (source.instrument(), &layout.grid);
    let (count, n_mic) = (setup.sweep.len(), setup.array.len());
    let per_metre: Vec<f64> = setup.sweep.frequencies().iter().map(|f| -f / setup.sound_speed).collect();
    let block = batch.frequencies;
    let mut modulus = 0.0;
    source.visit(block, &mut |range, block| {
        let rows = range.clone().zip(block.chunks_exact(n_mic));
        modulus += rows.map(|(f, row)| weights.modulus(f, row)).sum::<f64>();
        Ok(())
    })?;
    let made = Made { method: Method::Convolution, error_bound: layout.lattice.error() * modulus };
    let depths = grid.z.count;
    let mut planes = try_zeroed((DEPTHS.min(depths) as u64).saturating_mul(grid.plane_len() as u64))
        .ok_or_else(|| no_room_for(grid))?;
    let (mut spectra, spreading) =
        (layout.room(block)?, layout.lattice.spreading(&source.instrument().array));
    let focused = Depths { layout, focuses: Focuses::new(layout), near: None, batch, observer };
    sink.begin(&made)?;
    stage(observer, "reconstructing", (count * depths) as u64, || {
        for first in (0..depths).step_by(DEPTHS) {
            let last = (first + DEPTHS).min(depths);
            if last <= sink.done() {
                advance(observer, (count * (last - first)) as u64)?;
                continue;
            }
            let planes = &mut planes[..(last - first) * grid.plane_len()];
            planes.fill(Complex32::ZERO);
            source.visit(block, &mut |range, block| {
                let (tones, width) = (range.len() as u64, n_mic as u64);
                let mut samples = try_with_capacity(tones * width).ok_or_else(|| no_room(tones, width))?;
                let rows = range.clone().zip(block.chunks_exact(n_mic));
                samples.extend(rows.flat_map(|(f, row)| weights.weighted(f, row)));
                let samples = spreading.onto_nodes(samples)?;
                let tones = Tones { per_metre: per_metre[range.clone()].to_vec(), samples };
                focused.add(&tones, &mut spectra, first, planes)
            })?;
            sink.take(first, planes)?;
        }
        Ok(())
    })?;
    Ok(made)
}

/// Skeleton tones, slab by slab.
fn skeleton_frequencies(
    source: &mut dyn CubeSource,
    weights: &Weights,
    (layout, division, batch): (&Layout, &Slabs, Batch),
    tolerance: f64,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<Made> {
    let (grid, depths) = (&layout.grid, layout.grid.z.count);
    let whole = source.instrument().path_interval(grid, 0..depths);
    let mut compressed = VolumeTones::compress(source, weights, whole, FIRST_SHARE * tolerance, observer)?;
    let setup = source.instrument();
    let thickness = division.thickness;
    let interval = |planes| setup.path_interval(grid, planes);
    let share = |longer, own, depths| division.share(longer, own, depths);
    let slabs = compressed.slabs(slabs_of(depths, thickness), interval, share, tolerance);
    let error = slabs.iter().map(|slab| slab.error).fold(0.0, greater) + layout.lattice.error();
    let near = Near::new(setup, grid, &layout.lattice.near, &compressed, &slabs)?;
    let samples = std::mem::take(&mut compressed.tones.samples);
    compressed.tones.samples = layout.lattice.spreading(&setup.array).onto_nodes(samples)?;
    let made = Made { method: Method::Convolution, error_bound: error * compressed.modulus };
    let total = slabs.iter().map(|slab| (slab.len() * slab.planes.len()) as u64).sum();
    let plane_len = grid.plane_len();
    // Room for every slab that is worked on at a time, kept from one to the next: what is given back and asked for again
    // an allocator holds twice.
    let most = slabs.iter().map(SlabTones::len).max().unwrap_or(0);
    let room = |_| Ok((Tones::with_capacity(most, layout.lattice.width())?, layout.room(most)?));
    let rooms = (0..batch.slabs.min(slabs.len())).into_par_iter().map(room);
    let mut rooms = rooms.collect::<Result<Vec<_>>>()?;
    let focused = Depths { layout, focuses: Focuses::new(layout), near, batch, observer };
    sink.begin(&made)?;
    let mut handover = Handover::new(sink, grid, batch.slabs * thickness)?;
    stage(observer, "reconstructing", total, || {
        let done = slabs.partition_point(|slab| slab.planes.end <= handover.done());
        let skipped = slabs[..done].iter().map(|slab| (slab.len() * slab.planes.len()) as u64);
        advance(observer, skipped.sum())?;
        for slabs in slabs[done..].chunks(batch.slabs) {
            let first = slabs[0].planes.start;
            let end = slabs[slabs.len() - 1].planes.end;
            handover.next(first, end - first, |planes| {
                planes.fill(Complex32::ZERO);
                let planes_of_slabs = planes.par_chunks_mut(thickness * plane_len).zip(slabs);
                planes_of_slabs.zip(&mut rooms).try_for_each(|((planes, slab), (tones, spectra))| {
                    slab.select(&compressed, layout.lattice.width(), tones);
                    focused.add(tones, spectra, slab.planes.start, planes)
                })
            })?;
        }
        handover.finish()
    })?;
    Ok(made)
}
