//! Several loudspeakers: the coherent sum of what each of them shows.
//!
//! `Â(p) = w/(n_tx Σw_f Σw_r) Σ_tx Σ_f Σ_r w_f w_r m(tx, f, r) e^{−i2πf(|p − s_tx| + |p − r|)/c}`
//!
//! is the mean of the images of the transmissions, each a job of its own by any method. Depths are summed in slabs that are
//! small beside a volume and follow from the grid alone, so that the bytes depend on neither memory nor interruption.
//!
//! A path is the same from either of its ends, so that loudspeakers and microphones may change places: the sum then runs
//! over the microphones, where these are fewer and no window weighs them.

use super::{Checked, Gain};
use crate::acquisition::{CubeSource, DataCube, Instrument, MicArray, OneTransmission};
use crate::alloc::try_zeroed;
use crate::blocks::{BlockStore, NoStore};
use crate::error::Result;
use crate::grid::{Axis, Grid, no_room_for};
use crate::progress::{Event, Observer, advance, stage};
use crate::reconstruct::plan::{Candidates, Estimate, Estimates, estimate};
use crate::reconstruct::window::Weights;
use crate::reconstruct::{
    Method, ReconstructOptions, ReconstructionInfo, VolumeSink, Window, by_candidates, no_room,
};
use num_complex::Complex32;
use std::ops::Range;
use std::sync::OnceLock;

/// Bytes of the depths that are summed at a time.
const SLAB_BYTES: u64 = 64 << 20;

/// The depths that are summed at a time.
pub(super) fn slabs(grid: &Grid) -> impl Iterator<Item = Range<usize>> {
    let (count, plane) = (grid.z.count, size_of::<Complex32>() as u64 * grid.plane_len() as u64);
    let thickness = ((SLAB_BYTES / plane.max(1)) as usize).clamp(1, count.max(1));
    (0..count).step_by(thickness).map(move |first| first..(first + thickness).min(count))
}

/// These depths of a grid, as a grid of their own.
pub(super) fn part_of(grid: &Grid, depths: &Range<usize>) -> Grid {
    Grid { z: Axis { first: grid.z.position(depths.start), count: depths.len(), ..grid.z }, ..*grid }
}

/// A refinement fits the echoes of one loudspeaker.
fn refuse_refinement(instrument: &Instrument, options: &ReconstructOptions) -> Result<()> {
    if options.refine.is_none() { Ok(()) } else { instrument.need_one_source("refine.method") }
}

/// The instrument with microphones for loudspeakers and loudspeakers for microphones, where its sum has fewer terms.
fn reversed(instrument: &Instrument, options: &ReconstructOptions) -> Result<Option<Instrument>> {
    let sources = instrument.sources();
    let weighs_places = options.window != Window::None || options.compensate;
    if weighs_places || instrument.array.len() >= sources.len() {
        return Ok(None);
    }
    // As many as there are before the first of another row.
    let columns = sources.iter().take_while(|s| s.y == sources[0].y).count();
    let array = if sources.len().is_multiple_of(columns) {
        MicArray::from_rows([sources.len() / columns, columns], sources)?
    } else {
        MicArray::from_positions(sources)?
    };
    instrument.clone().with_array(array).with_sources(instrument.array.positions()).map(Some)
}

/// The samples in the order of the reversed instrument, `[n_mic, n_f, n_tx]`.
fn turned(source: &mut dyn CubeSource, reversed: Instrument) -> Result<DataCube> {
    let (n_f, n_tx, n_mic) = (reversed.sweep.len(), reversed.array.len(), reversed.transmissions());
    let bytes = reversed.cube_bytes() / size_of::<Complex32>() as u64;
    let mut samples = try_zeroed(bytes).ok_or_else(|| no_room((n_f * n_tx) as u64, n_mic as u64))?;
    for tx in 0..n_tx {
        source.visit_transmission(tx, BLOCK, &mut |range, block| {
            for (f, row) in range.zip(block.chunks_exact(n_mic)) {
                row.iter().enumerate().for_each(|(r, m)| samples[(r * n_f + f) * n_tx + tx] = *m);
            }
            Ok(())
        })?;
    }
    DataCube::new(reversed, samples)
}

/// What all loudspeakers show together.
///
/// # Errors
/// Those of one transmission; a refinement.
pub(in crate::reconstruct) fn sum_of_transmissions(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    refuse_refinement(source.instrument(), options)?;
    if let Some(reversed) = reversed(source.instrument(), options)? {
        return sum(&mut &turned(source, reversed)?, grid, options, sink, observer);
    }
    sum(source, grid, options, sink, observer)
}

fn sum(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    let instrument = source.instrument().clone();
    let (count, plane) = (instrument.transmissions(), grid.plane_len());
    // One method for all of them, that of the first.
    let first = instrument.transmission(0);
    let candidates = Candidates::new(&first, grid, options, rayon::current_num_threads())?;
    let method = candidates.chosen(options.method).method;
    let (_, warning) = candidates.choose(&first, grid, options.method)?;
    if let Some(warning) = warning {
        observer.warn(&warning);
    }
    let info = expected(source, grid, (options, method))?;
    let memory = options.memory.map(|memory| memory.saturating_sub(slab_bytes(grid)));
    let options = ReconstructOptions { method, memory, ..*options };
    let level = info.incoherent_level.map(OnceLock::from);
    let sink: &mut dyn VolumeSink = &mut Checked { grid: *grid, incoherent_level: level.as_ref(), sink };
    sink.begin(&info)?;
    stage(observer, "reconstructing", (count * grid.z.count) as u64, || {
        for depths in slabs(grid) {
            if sink.wanted(depths.clone()).is_empty() {
                advance(observer, (count * depths.len()) as u64)?;
                continue;
            }
            let part = part_of(grid, &depths);
            let mut total = try_zeroed(part.voxel_count()).ok_or_else(|| no_room_for(grid))?;
            for index in 0..count {
                let share = (count as f32).recip();
                let mut sum = AddedTo { total: &mut total, plane, share, observer };
                let one = &mut OneTransmission::new(source, index);
                let plan = Candidates::only(method, one.instrument(), &part, &options)?;
                let sinks: (&mut dyn VolumeSink, &mut dyn BlockStore) = (&mut sum, &mut NoStore);
                by_candidates(one, (&part, plan), &options, sinks, &Unreported(observer))?;
            }
            sink.take(depths.start, &total)?;
        }
        Ok(())
    })?;
    Ok(info)
}

/// Frequencies that are visited at a time for their power alone.
const BLOCK: usize = 32;

/// What is known before the sum: the bound on its error, as far as the tolerance allows, and the level of its samples.
pub(super) fn expected(
    source: &mut dyn CubeSource,
    grid: &Grid,
    (options, method): (&ReconstructOptions, Method),
) -> Result<ReconstructionInfo> {
    let instrument = source.instrument().clone();
    let (count, n_mic) = (instrument.transmissions(), instrument.array.len());
    let weights = Weights::new(&instrument, options.window);
    let summed = matches!(method, Method::Direct | Method::Linear);
    let tolerance = if summed { 0.0 } else { options.tolerance };
    let (mut bound, mut power) = (0.0, 0.0);
    for index in 0..count {
        let mut modulus = 0.0;
        source.visit_transmission(index, BLOCK, &mut |frequencies, samples| {
            for (f, row) in frequencies.zip(samples.chunks_exact(n_mic)) {
                modulus += weights.modulus(f, row);
                power += weights.power(f, row);
            }
            Ok(())
        })?;
        let plain = ReconstructionInfo::plain(method, tolerance * modulus / count as f64);
        let gain = options.compensate.then(|| Gain::new(&instrument.transmission(index), grid));
        bound += gain.map_or(plain, |gain| gain.info(&plain)).error_bound;
    }
    let incoherent_level = (!options.compensate).then(|| power.sqrt() / count as f64);
    Ok(ReconstructionInfo { incoherent_level, ..ReconstructionInfo::plain(method, bound) })
}

/// Bytes of the depths that are summed.
pub(super) fn slab_bytes(grid: &Grid) -> u64 {
    let depths = slabs(grid).map(|depths| depths.len()).max().unwrap_or(0);
    (depths * grid.plane_len() * size_of::<Complex32>()) as u64
}

/// What each method would take for the sum over all loudspeakers: so many times what the first one takes.
pub(in crate::reconstruct) fn estimates_of_transmissions(
    instrument: &Instrument,
    grid: &Grid,
    options: &ReconstructOptions,
    threads: usize,
) -> Result<Estimates> {
    refuse_refinement(instrument, options)?;
    let turned = reversed(instrument, options)?;
    let held = slab_bytes(grid).saturating_add(turned.as_ref().map_or(0, Instrument::cube_bytes));
    let instrument = turned.as_ref().unwrap_or(instrument);
    let options = ReconstructOptions { memory: options.memory.map(|m| m.saturating_sub(held)), ..*options };
    let times = instrument.transmissions() as f64;
    let first = instrument.transmission(0);
    let found = estimate(&first, grid, &options, threads)?;
    // The memory is that of the longest slab, the last one's paths being the longest, too.
    let deepest = slabs(grid).last().map(|depths| part_of(grid, &depths)).filter(|part| part != grid);
    let longest = slabs(grid).next().map(|depths| part_of(grid, &depths)).filter(|part| part != grid);
    let mut methods = found.methods;
    for part in [longest, deepest].into_iter().flatten() {
        let of_part = estimate(&first, &part, &options, threads)?.methods;
        methods.iter_mut().zip(of_part).for_each(|(all, part)| all.bytes = all.bytes.max(part.bytes));
    }
    let each = |estimate: Estimate| Estimate {
        operations: estimate.operations * times,
        bytes: if estimate.obstacle.is_none() { estimate.bytes.saturating_add(held) } else { 0 },
        ..estimate
    };
    Ok(Estimates { methods: methods.into_iter().map(each).collect(), chosen: found.chosen })
}

/// A sink that adds a share of what it is given to a slab.
struct AddedTo<'a> {
    total: &'a mut [Complex32],
    plane: usize,
    share: f32,
    observer: &'a dyn Observer,
}

impl VolumeSink for AddedTo<'_> {
    fn begin(&mut self, _: &ReconstructionInfo) -> Result<()> {
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let total = &mut self.total[first * self.plane..][..planes.len()];
        total.iter_mut().zip(planes).for_each(|(total, a)| *total += a * self.share);
        advance(self.observer, (planes.len() / self.plane) as u64)
    }
}

/// The jobs of transmissions within one stage, which counts their depths: what they report themselves is left out.
struct Unreported<'a>(&'a dyn Observer);

impl Observer for Unreported<'_> {
    fn event(&self, _: Event<'_>) {}

    fn should_stop(&self) -> bool {
        self.0.should_stop()
    }
}

#[cfg(test)]
mod tests;
