//! Several loudspeakers: the coherent sum of what each of them shows.
//!
//! `Â(p) = w/(n_tx Σw_f Σw_r) Σ_tx Σ_f Σ_r w_f w_r m(tx, f, r) e^{−i2πf(|p − s_tx| + |p − r|)/c}`
//!
//! is the mean of the images of the transmissions, each a job of its own by any method; by convolution some of them together,
//! which share the kernels `e^{−i2πf|p − r|/c}` of the way back. Depths are summed in slabs that are small beside a volume and
//! follow from the grid alone, so that the bytes depend on neither memory nor interruption.
//!
//! A path is the same from either of its ends, so that loudspeakers and microphones may change places: the sum then runs
//! over the microphones, where these are fewer and no window weighs them.

mod course;

use super::{Batch, Checked, Compensated, Gain};
use crate::acquisition::{CubeSource, DataCube, Instrument, MicArray, SomeTransmissions};
use crate::alloc::try_zeroed;
use crate::blocks::runs;
use crate::error::Result;
use crate::grid::{Axis, Grid, no_room_for};
use crate::progress::{Event, Observer, advance, stage};
use crate::reconstruct::compress::KeptTones;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::job::Job;
use crate::reconstruct::plan::{Candidates, Estimates, MethodPlan};
use crate::reconstruct::upsampling::InterpolationError;
use crate::reconstruct::window::Weights;
use crate::reconstruct::{
    Method, ReconstructOptions, ReconstructionInfo, VolumeSink, Window, carry_out, no_room,
};
use course::Course;
use num_complex::Complex32;
use std::ops::Range;
use std::sync::OnceLock;

/// Bytes of the depths that are summed at a time.
const SLAB_BYTES: u64 = 64 << 20;

/// The depths that are summed at a time.
pub(super) fn slabs(grid: &Grid) -> impl Iterator<Item = Range<usize>> {
    let (count, plane) = (grid.z.count, size_of::<Complex32>() as u64 * grid.plane_len() as u64);
    let thickness = ((SLAB_BYTES / plane.max(1)) as usize).clamp(1, count.max(1));
    runs(count, thickness)
}

/// These depths of a grid, as a grid of their own.
pub(super) fn part_of(grid: &Grid, depths: &Range<usize>) -> Grid {
    Grid { z: Axis { first: grid.z.position(depths.start), count: depths.len(), ..grid.z }, ..*grid }
}

/// The first slab, which is the longest, and the last, whose paths are: what takes most memory is one of them.
pub(super) fn end_slabs(grid: &Grid) -> impl Iterator<Item = Grid> {
    [slabs(grid).next(), slabs(grid).last()].into_iter().flatten().map(|depths| part_of(grid, &depths))
}

/// The instrument with microphones for loudspeakers and loudspeakers for microphones, where its sum has fewer terms.
fn reversed(instrument: &Instrument, options: &ReconstructOptions) -> Result<Option<Instrument>> {
    let sources = instrument.sources();
    let several = instrument.transmissions() > 1;
    let weighs_places = options.window != Window::None || options.compensate;
    if !several || weighs_places || instrument.array.len() >= sources.len() {
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

/// The cube with microphones and loudspeakers in each other's places, where that is less work.
///
/// # Errors
/// Those of the source; its samples do not fit in memory.
pub(in crate::reconstruct) fn turned_round(
    source: &mut dyn CubeSource,
    options: &ReconstructOptions,
) -> Result<Option<DataCube>> {
    match reversed(source.instrument(), options)? {
        Some(reversed) => turned(source, reversed).map(Some),
        None => Ok(None),
    }
}

/// What all loudspeakers show together.
///
/// # Errors
/// Those of one transmission.
pub(in crate::reconstruct) fn sum_of_transmissions(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    let instrument = source.instrument().clone();
    let (count, plane) = (instrument.transmissions(), grid.plane_len());
    // One method for all of them.
    let course = Course::new(&instrument, grid, options, rayon::current_num_threads())?;
    let method = course.estimates.chosen().method;
    let (_, warning) = course.first.choose(&instrument.transmission(0), grid, options.method)?;
    if let Some(warning) = warning {
        observer.warn(&warning);
    }
    let memory = options.memory.map(|memory| memory.saturating_sub(slab_bytes(grid)));
    let options = ReconstructOptions { method, memory, ..*options };
    let groups: Vec<_> = runs(count, course.group).collect();
    let planned = |depths: &Range<usize>, which: &Range<usize>| {
        Planned::new(&instrument.some_transmissions(which.clone()), &part_of(grid, depths), &options)
    };
    // Those of convolution are found before: how large the error is has to be known at the first depth.
    let mut plans: Vec<Vec<Planned>> = Vec::new();
    if method == Method::Convolution {
        let of_slab = |depths: Range<usize>| groups.iter().map(|which| planned(&depths, which)).collect();
        plans = slabs(grid).map(of_slab).collect::<Result<_>>()?;
    }
    let weights = Weights::new(&instrument, options.window);
    let errors = groups.iter().enumerate().map(|(group, _)| match method {
        Method::Direct | Method::Linear => 0.0,
        Method::Convolution => plans.iter().map(|plans| plans[group].error).fold(0.0, f64::max),
        _ => options.tolerance,
    });
    let errors: Vec<_> = groups.iter().cloned().zip(errors).collect();
    let info = expected(source, grid, (&options, &weights), &errors)?;
    let level = info.incoherent_level.map(OnceLock::from);
    let sink: &mut dyn VolumeSink = &mut Checked { grid: *grid, incoherent_level: level.as_ref(), sink };
    sink.begin(&info)?;
    stage(observer, "reconstructing", (count * grid.z.count) as u64, || {
        for (slab, depths) in slabs(grid).enumerate() {
            if sink.wanted(depths.clone()).is_empty() {
                advance(observer, (count * depths.len()) as u64)?;
                continue;
            }
            let part = part_of(grid, &depths);
            let mut total = try_zeroed(part.voxel_count()).ok_or_else(|| no_room_for(grid))?;
            for (group, which) in groups.iter().enumerate() {
                let found;
                let planned = if let Some(plans) = plans.get(slab) {
                    &plans[group]
                } else {
                    found = planned(&depths, which)?;
                    &found
                };
                let mut sum = AddedTo { total: &mut total, plane, transmissions: which.len(), observer };
                let some = &mut SomeTransmissions::of(source, which.clone());
                let gain = options.compensate.then(|| Gain::new(some.instrument(), &part));
                let sink = &mut Compensated::new(gain, &mut sum);
                planned.carry_out(some, (&part, &weights), &options, sink, &Unreported(observer))?;
            }
            sink.take(depths.start, &total)?;
        }
        Ok(())
    })?;
    Ok(info)
}

/// Frequencies that are visited at a time for their power alone.
const BLOCK: usize = 32;

/// What is known before the sum: the bound on its error, by the relative errors of groups of transmissions, and the level of
/// its samples.
pub(super) fn expected(
    source: &mut dyn CubeSource,
    grid: &Grid,
    (options, weights): (&ReconstructOptions, &Weights),
    errors: &[(Range<usize>, f64)],
) -> Result<ReconstructionInfo> {
    let instrument = source.instrument().clone();
    let n_mic = instrument.array.len();
    let (mut bound, mut power) = (0.0, 0.0);
    for (which, error) in errors {
        for index in which.clone() {
            let mut modulus = 0.0;
            source.visit_transmission(index, BLOCK, &mut |frequencies, samples| {
                for (f, row) in frequencies.zip(samples.chunks_exact(n_mic)) {
                    modulus += weights.modulus(f, row);
                    power += weights.power(f, row);
                }
                Ok(())
            })?;
            let plain = ReconstructionInfo::plain(options.method, error * modulus);
            let gain = options.compensate.then(|| Gain::new(&instrument.transmission(index), grid));
            bound += gain.map_or(plain, |gain| gain.info(&plain)).error_bound;
        }
    }
    let incoherent_level = (!options.compensate).then(|| power.sqrt());
    Ok(ReconstructionInfo { incoherent_level, ..ReconstructionInfo::plain(options.method, bound) })
}

/// How a group of transmissions is summed within a slab of depths.
struct Planned {
    plan: MethodPlan,
    batch: Batch,
    /// Of a convolution over skeleton tones: the largest error of a voxel, relative to `Σ|w m| / Σw`.
    error: f64,
}

impl Planned {
    fn new(instrument: &Instrument, grid: &Grid, options: &ReconstructOptions) -> Result<Self> {
        let candidates = Candidates::only(options.method, instrument, grid, options)?;
        let batch = candidates.chosen(options.method).batch;
        let (plan, _) = candidates.choose(instrument, grid, options.method)?;
        let error = match &plan {
            MethodPlan::Convolution(sampled) => {
                let interpolation = sampled.upsampling.as_ref().map_or(InterpolationError::NONE, |u| u.error);
                interpolation.with(sampled.plan.error(instrument))
            }
            _ => 0.0,
        };
        Ok(Self { plan, batch, error })
    }

    fn carry_out(
        &self,
        source: &mut dyn CubeSource,
        (grid, weights): (&Grid, &Weights),
        options: &ReconstructOptions,
        sink: &mut dyn VolumeSink,
        observer: &dyn Observer,
    ) -> Result<()> {
        let (budget, interpolation) = (ErrorBudget::new(options.tolerance), InterpolationError::NONE);
        let batch = self.batch;
        let kept = KeptTones::default();
        let job = Job { source, kept, weights, grid, budget, interpolation, batch, sink, observer };
        carry_out(&self.plan, job).map(|_| ())
    }
}

/// Bytes of the depths that are summed.
pub(super) fn slab_bytes(grid: &Grid) -> u64 {
    let depths = slabs(grid).map(|depths| depths.len()).max().unwrap_or(0);
    (depths * grid.plane_len() * size_of::<Complex32>()) as u64
}

/// What each method would take for the sum over all loudspeakers.
pub(in crate::reconstruct) fn estimates_of_transmissions(
    instrument: &Instrument,
    grid: &Grid,
    options: &ReconstructOptions,
    threads: usize,
) -> Result<Estimates> {
    let turned = reversed(instrument, options)?;
    let held = turned.as_ref().map_or(0, Instrument::cube_bytes);
    let held = if options.refine.is_some() { held } else { held.saturating_add(slab_bytes(grid)) };
    let instrument = turned.as_ref().unwrap_or(instrument);
    let options = ReconstructOptions { memory: options.memory.map(|m| m.saturating_sub(held)), ..*options };
    let Estimates { mut methods, chosen } = if options.refine.is_some() || instrument.transmissions() == 1 {
        Candidates::new(instrument, grid, &options, threads)?.into_estimates(options.method)
    } else {
        Course::new(instrument, grid, &options, threads)?
            .with_longest_slab(instrument, grid, &options, threads)?
    };
    for estimate in methods.iter_mut().filter(|estimate| estimate.obstacle.is_none()) {
        estimate.bytes = estimate.bytes.saturating_add(held);
    }
    Ok(Estimates { methods, chosen })
}

/// A sink that adds what it is given to a slab.
struct AddedTo<'a> {
    total: &'a mut [Complex32],
    plane: usize,
    /// How many have been added up in what it is given.
    transmissions: usize,
    observer: &'a dyn Observer,
}

impl VolumeSink for AddedTo<'_> {
    fn begin(&mut self, _: &ReconstructionInfo) -> Result<()> {
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let total = &mut self.total[first * self.plane..][..planes.len()];
        total.iter_mut().zip(planes).for_each(|(total, a)| *total += a);
        advance(self.observer, (self.transmissions * planes.len() / self.plane) as u64)
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
