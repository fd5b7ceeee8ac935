//! Eq. 16: on a shared lattice the sum over microphones is a convolution, done by padded 2-D FFTs.
//!
//! `p − r` depends on the difference of indices alone, so one kernel `e^{−i2πf|p−r|/c}` per frequency and depth serves
//! every pair of voxel and microphone ([`SharedLattice`] says when). With a tolerance, the sweep is first compressed to
//! virtual tones for the volume, and these to skeleton tones for each slab of depths, so that Eq. 16 runs over tens of
//! tones instead of all; with tolerance 0 it runs over every one.

use super::batch::Batch;
use super::focus::Focus;
use super::handover::Handover;
use super::lattice::SharedLattice;
use super::layout::Layout;
use super::skeleton::{candidates_for, tones_for};
use super::tones::{SlabTones, Tones, VolumeTones};
use super::weights::Weights;
use super::{Made, Method, VolumeSink, no_room, no_room_for};
use crate::acquisition::{CubeSource, Setup};
use crate::error::Result;
use crate::grid::{Grid, room, zeros};
use crate::progress::{Observer, advance, stage};
use crate::wave::interval::{PathInterval, greater};
use crate::wave::simd::{LANES, Lanes};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Bytes of data spectra held at a time when every frequency is summed.
const SPECTRA_BYTES: usize = 256 << 20;

/// The share of the tolerance that the first of the two compressions may use.
pub(super) const FIRST_SHARE: f64 = 0.3;

/// Adds tones to the planes from `first` on, `[plane, y, x]`; `room` is for their spectra.
fn add(
    layout: &Layout,
    tones: &Tones,
    room: &mut [Lanes],
    first: usize,
    planes: &mut [Complex32],
    batch: Batch,
    observer: &dyn Observer,
) -> Result<()> {
    let spectra = layout.part(room, tones.per_metre.len());
    layout.transform_into(&tones.samples, batch, spectra)?;
    let spectra = &*spectra;
    let planes = planes.par_chunks_mut(layout.grid.plane_len());
    let run = batch.least_run(planes.len());
    planes.with_min_len(run).enumerate().try_for_each_init(
        || Focus::new(layout),
        |focus, (iz, voxels)| {
            let focus = focus.as_mut().map_err(|error| error.clone())?;
            focus.add(first + iz, &tones.per_metre, spectra, voxels);
            advance(observer, tones.per_metre.len() as u64)
        },
    )
}

/// Gives the volume to `sink` by Eq. 16.
///
/// Cost: per tone and depth, for each pair of sub-lattices one kernel of `n_x·n_y` phasors and its FFT, and one inverse
/// FFT per voxel sub-lattice (monostatic: one per depth). With a tolerance a sweep is some `B·T + 10` tones, T the
/// spread of delays within a slab.
pub(super) fn convolution(
    source: &mut dyn CubeSource,
    weights: &Weights,
    (lattice, batch): (&SharedLattice, Batch),
    grid: &Grid,
    tolerance: f64,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<Made> {
    let layout = Layout::new(lattice, *grid, source.setup().geometry);
    let left = tolerance - lattice.error();
    if left <= 0.0 {
        every_frequency(source, weights, &layout, batch, sink, observer)
    } else {
        skeleton_frequencies(source, weights, (&layout, batch), left, sink, observer)
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
    let (setup, grid) = (source.setup(), &layout.grid);
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
    let mut planes = zeros((DEPTHS.min(depths) as u64).saturating_mul(grid.plane_len() as u64))
        .ok_or_else(|| no_room_for(grid))?;
    let mut spectra = layout.room(block)?;
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
                let mut samples = room(tones * width).ok_or_else(|| no_room(tones, width))?;
                let rows = range.clone().zip(block.chunks_exact(n_mic));
                samples.extend(rows.flat_map(|(f, row)| weights.weighted(f, row)));
                let samples = layout.lattice.onto_nodes(samples)?;
                let tones = Tones { per_metre: per_metre[range.clone()].to_vec(), samples };
                add(layout, &tones, &mut spectra, first, planes, batch, observer)
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
    (layout, batch): (&Layout, Batch),
    tolerance: f64,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<Made> {
    let (grid, depths) = (&layout.grid, layout.grid.z.count);
    let whole = source.setup().path_interval(grid, 0..depths);
    let mut compressed = VolumeTones::compress(source, weights, whole, FIRST_SHARE * tolerance, observer)?;
    compressed.tones.samples = layout.lattice.onto_nodes(std::mem::take(&mut compressed.tones.samples))?;
    let setup = source.setup();
    let thickness = slab_thickness(&setup, layout);
    let interval = |planes| setup.path_interval(grid, planes);
    let slabs = compressed.slabs(depths, thickness, interval, tolerance);
    let error = slabs.iter().map(|slab| slab.error).fold(0.0, greater) + layout.lattice.error();
    let made = Made { method: Method::Convolution, error_bound: error * compressed.modulus };
    let total = slabs.iter().map(|slab| (slab.len() * slab.planes.len()) as u64).sum();
    let plane_len = grid.plane_len();
    // Room for every slab that is worked on at a time, kept from one to the next: what is given back and asked for again
    // an allocator holds twice.
    let most = slabs.iter().map(SlabTones::len).max().unwrap_or(0);
    let room = |_| Ok((Tones::room(most, layout.lattice.width())?, layout.room(most)?));
    let rooms = (0..batch.slabs.min(slabs.len())).into_par_iter().map(room);
    let mut rooms = rooms.collect::<Result<Vec<_>>>()?;
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
                    slab.select(&compressed.tones, layout.lattice.width(), tones);
                    add(layout, tones, spectra, slab.planes.start, planes, batch, observer)
                })
            })?;
        }
        handover.finish()
    })?;
    Ok(made)
}

/// Depths per thread that are worked on before they are handed on: enough to keep every thread busy.
const PLANES_PER_THREAD: usize = 8;

/// As many slabs as take no more numbers than this are worked on at a time anyway, with about so many tones each: threads
/// take time to wake.
const SMALL: usize = 1 << 20;
const TONES: usize = 32;

/// What suits so many threads where memory does not matter.
pub(super) fn usual_batch(layout: &Layout, thickness: usize, frequencies: usize, threads: usize) -> Batch {
    let slab = (layout.tone_len() + layout.lattice.width()) * TONES + layout.grid.plane_len() * thickness;
    let at_once = (PLANES_PER_THREAD * threads / thickness).max(SMALL / slab).max(1);
    Batch {
        slabs: at_once.min(layout.grid.z.count.div_ceil(thickness)),
        frequencies: (SPECTRA_BYTES / (layout.tone_len() * size_of::<Complex32>())).clamp(1, frequencies),
        workers: threads.max(1),
    }
}

/// What skeletons usually may err by.
const USUAL: f64 = 3e-5;

/// The number of depths per slab that costs least by a fixed model, so that the same job always takes the same path.
///
/// Thin slabs need fewer tones each, but every slab pays for its own spectra and decomposition.
pub(super) fn slab_thickness(setup: &Setup, layout: &Layout) -> usize {
    let depths = layout.grid.z.count;
    let points = layout.points() as f64;
    let paths: Vec<PathInterval> =
        (0..depths).map(|iz| setup.path_interval(&layout.grid, iz..iz + 1)).collect();
    // Depths are in order, and so are their paths.
    let bandwidth_duration = |planes: Range<usize>| {
        let paths = PathInterval { shortest: paths[planes.start].shortest, ..paths[planes.end - 1] };
        setup.sweep.bandwidth() * paths.duration()
    };
    let of_volume = (2.0 * bandwidth_duration(0..depths) + 8.0).min(setup.sweep.len() as f64);
    // In transformed points: a decomposition, by its rows and columns, and for a tone its product over all nodes.
    let decomposed = |spread: f64| {
        let rows = 1.7 * spread + 36.0;
        4e4 + 0.18 * rows * rows * candidates_for(spread).min(of_volume)
    };
    let product = 0.05 * of_volume * layout.lattice.width() as f64;
    // On a line, sixteen tones cost what one does.
    let lanes = if layout.line.is_some() { LANES as f64 } else { 1.0 };
    let cost = |thickness: usize| -> f64 {
        (0..depths)
            .step_by(thickness)
            .map(|first| {
                let planes = thickness.min(depths - first);
                let spread = bandwidth_duration(first..first + planes);
                let tones = tones_for(spread, USUAL).min(of_volume);
                let transforms = (planes * layout.pairs() * 2 + layout.node_parts.len()) as f64;
                (tones / lanes).ceil() * lanes * transforms * points + tones * product + decomposed(spread)
            })
            .sum()
    };
    let candidates = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128];
    candidates
        .into_iter()
        .filter(|&thickness| thickness == 1 || thickness <= depths)
        .min_by(|&a, &b| cost(a).total_cmp(&cost(b)))
        .unwrap_or(1)
}
