//! Eq. 13 in a frame that moves while the tones are played: every tone with speaker and microphones where they were in it.
//!
//! `Â(p) = w/(n_tx Σw_f Σw_r) Σ_n Σ_r w_n w_r m(n, r) e^{−i2πf_n·path(p + v t_n, r)/c}`, an image of each tone by any method, with the
//! instrument displaced by `−v t_n`, added up. It has no skeleton tones, and takes as long as Eq. 16 with every frequency.
//!
//! Where the tolerance allows, neighbouring tones are imaged together from where the middle one of them was played, with the
//! phase by which the others are late at the middle of the grid put right. What is left, of their delays δ, is
//! `2πf/c · (δ |σ − σ̄| + δ² |v|² (1/d_out + 1/d_back))`: the rates σ of paths that differ from that of the middle, σ̄, and the
//! curvature of the paths.

use super::Checked;
use super::parts::{PartOfGrid, in_slabs};
use super::transmissions::{end_slabs, expected, slab_bytes};
use crate::acquisition::{CubeSource, CubeView, Detection, Instrument, Sweep};
use crate::alloc::try_zeroed;
use crate::error::{Error, Result};
use crate::grid::{Grid, no_room_for};
use crate::progress::Observer;
use crate::reconstruct::plan::{Candidates, Estimates, estimate};
use crate::reconstruct::{Method, ReconstructOptions, ReconstructionInfo, VolumeSink, Weights, Window};
use crate::wave::{Geometry, Motion, phasor, rate_bounds};
use glam::DVec3;
use num_complex::Complex32;
use std::f64::consts::TAU;
use std::ops::Range;
use std::sync::OnceLock;

/// The share of the tolerance that tones which are imaged together may err by.
const SHARE: f64 = 0.3;

/// An instrument that moves, and how its tones are put together.
struct Moving<'a> {
    instrument: &'a Instrument,
    motion: Motion,
    /// Tones that are imaged together.
    together: usize,
    /// The middle of the grid, at which their phases are right, m.
    middle: DVec3,
    of_sweep: Vec<f64>,
    of_array: Vec<f64>,
    /// The image of a few tones.
    options: ReconstructOptions,
}

impl<'a> Moving<'a> {
    /// # Errors
    /// A velocity or times out of range; a refinement; an interface.
    fn new(
        instrument: &'a Instrument,
        grid: &Grid,
        options: &ReconstructOptions,
        motion: Motion,
    ) -> Result<Self> {
        let refused = |place: &str, problem: &str| Err(Error::input(place, problem));
        if !motion.is_valid() {
            let problem = "must be up to 1e4 m/s along each axis, with up to 1e4 s from one tone to the next";
            return refused("medium.velocity", problem);
        }
        if options.refine.is_some() {
            let problem =
                "has no adjoint in a frame that moves; use method = \"none\", or leave [medium] velocity out";
            return refused("refine.method", problem);
        }
        if instrument.interface.is_some() {
            let problem = "moves with the frame as well, which an interface before the array does not; leave one of them out";
            return refused("medium.velocity", problem);
        }
        let together = together(instrument, grid, motion, options.tolerance);
        let own = if together > 1 { (1.0 - SHARE) * options.tolerance } else { options.tolerance };
        let memory =
            options.memory.map(|memory| memory.saturating_sub(held_bytes(instrument, grid, together)));
        let (low, high) = grid.bounds();
        Ok(Self {
            instrument,
            motion,
            together,
            middle: low.midpoint(high),
            of_sweep: options.window.over_sweep(&instrument.sweep),
            of_array: options.window.over_array(&instrument.array),
            options: ReconstructOptions {
                memory,
                tolerance: own,
                ..ReconstructOptions::new(options.method, Window::None)
            },
        })
    }

    fn groups(&self) -> usize {
        self.of_sweep.len().div_ceil(self.together)
    }

    /// The number of a tone among all that are played; between two for the middle of some.
    fn played(&self, transmission: usize, tones: &Range<usize>) -> f64 {
        (transmission * self.of_sweep.len()) as f64 + 0.5 * (tones.start + tones.end - 1) as f64
    }

    /// What some tones were measured with, where it was in the middle of them as the frame sees it.
    fn of_tones(&self, transmission: usize, tones: Range<usize>) -> Result<Instrument> {
        let by = self.motion.displacement(self.played(transmission, &tones));
        let frequencies = self.instrument.sweep.frequencies()[tones].to_vec();
        let mut one =
            self.instrument.transmission(transmission).with_sweep(Sweep::from_frequencies(frequencies)?);
        if let Geometry::FixedSource { source } = one.geometry {
            one.geometry = Geometry::FixedSource { source: source - by };
        }
        let moved = one.array.positions().iter().map(|r| *r - by).collect();
        one.array = one.array.with_positions(moved)?;
        Ok(one)
    }

    /// The tones in the middle of the sweep, which stand for all that are imaged together.
    fn typical(&self) -> Range<usize> {
        let first = self.groups() / 2 * self.together;
        first..(first + self.together).min(self.of_sweep.len())
    }

    /// The weighted samples of some tones, `[f, n_mic]`, as if all of them were played in the middle.
    fn weighted(
        &self,
        (transmission, tones): (usize, Range<usize>),
        samples: &[Complex32],
        to: &mut Vec<Complex32>,
    ) {
        to.clear();
        let (own, centre) = (self.instrument.transmission(transmission), self.instrument.array.centre());
        let path = |played: f64| own.path_length(self.middle + self.motion.displacement(played), centre);
        let together = path(self.played(transmission, &tones));
        for (f, row) in tones.zip(samples.chunks_exact(self.of_array.len())) {
            let of_tone = self.of_sweep[f];
            if self.together == 1 {
                to.extend(row.iter().zip(&self.of_array).map(|(m, w)| m * ((of_tone * w) as f32)));
                continue;
            }
            let late = path(self.played(transmission, &(f..f + 1))) - together;
            let turn = phasor(-self.instrument.sweep.frequencies()[f] * late / self.instrument.sound_speed);
            to.extend(row.iter().zip(&self.of_array).map(|(m, w)| m * turn * ((of_tone * w) as f32)));
        }
    }
}

/// Bytes of a slab and its voxels, and of the samples of a few tones.
fn held_bytes(instrument: &Instrument, grid: &Grid, together: usize) -> u64 {
    let samples = (together * instrument.array.len() * size_of::<Complex32>()) as u64;
    slab_bytes(grid).saturating_add(samples)
}

/// How many tones may be imaged together for a tolerance.
fn together(instrument: &Instrument, grid: &Grid, motion: Motion, tolerance: f64) -> usize {
    let n_f = instrument.sweep.len();
    if motion.velocity == DVec3::ZERO || motion.dwell == 0.0 {
        return n_f;
    }
    let fixed = matches!(instrument.geometry, Geometry::FixedSource { .. });
    // A real sample cannot be turned; and the legs of a scan are left to themselves.
    if instrument.detection == Detection::InPhase || !fixed || tolerance <= 0.0 {
        return 1;
    }
    let played = (instrument.transmissions() * n_f) as f64 - 1.0;
    let ends = [motion.displacement(0.0), motion.displacement(played)];
    let ((low, high), (near, far)) = (grid.bounds(), instrument.array.bounds());
    let [first, last] = [ends[0].min(ends[1]), ends[0].max(ends[1])];
    let voxels = (low + first, high + last);
    let rates = |(near, far): (DVec3, DVec3)| rate_bounds(motion.velocity, (voxels.0 - far, voxels.1 - near));
    let gap = |(near, far): (DVec3, DVec3)| (voxels.0 - far).max(near - voxels.1).max(DVec3::ZERO).length();
    let back = (near, far);
    let Some(out) = instrument.source_bounds() else { return 1 };
    let spread = [out, back].into_iter().map(rates).map(|[least, most]| most - least).sum::<f64>();
    let curvature = motion.velocity.length_squared() * (1.0 / gap(out) + 1.0 / gap(back));
    let error = |tones: usize| {
        let late = 0.5 * (tones - 1) as f64 * motion.dwell;
        TAU * instrument.sweep.stop() / instrument.sound_speed * late * (spread + late * curvature)
    };
    let (mut fits, mut beyond) = (1, n_f + 1);
    while beyond - fits > 1 {
        let middle = usize::midpoint(fits, beyond);
        // An infinite curvature times no delay is no number, and does not fit either.
        if error(middle) <= SHARE * tolerance { fits = middle } else { beyond = middle }
    }
    fits
}

/// The volume of a frame that moves.
///
/// # Errors
/// Those of [`Moving::new`], and of an image of a few tones.
pub(in crate::reconstruct) fn in_motion(
    source: &mut dyn CubeSource,
    grid: &Grid,
    (options, motion): (&ReconstructOptions, Motion),
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    let instrument = source.instrument().clone();
    let moving = Moving::new(&instrument, grid, options, motion)?;
    let typical = moving.of_tones(0, moving.typical())?;
    let candidates = Candidates::new(&typical, grid, &moving.options, rayon::current_num_threads())?;
    let method = candidates.chosen(options.method).method;
    if let (_, Some(warning)) = candidates.choose(&typical, grid, options.method)? {
        observer.warn(&warning);
    }
    let error = if matches!(method, Method::Direct | Method::Linear) { 0.0 } else { options.tolerance };
    let weights = Weights::new(&instrument, options.window);
    let of_all = [(0..instrument.transmissions(), error)];
    let info = expected(source, grid, (&ReconstructOptions { method, ..*options }, &weights), &of_all)?;
    let level = info.incoherent_level.map(OnceLock::from);
    let sink: &mut dyn VolumeSink = &mut Checked { grid: *grid, incoherent_level: level.as_ref(), sink };
    sink.begin(&info)?;
    let (n_tx, n_mic) = (instrument.transmissions(), moving.of_array.len());
    let all = moving.of_sweep.iter().sum::<f64>() * moving.of_array.iter().sum::<f64>() * n_tx as f64;
    in_slabs(grid, sink, ("reconstructing in motion", n_tx * moving.groups()), observer, &mut |part| {
        let mut total = try_zeroed(part.grid.voxel_count()).ok_or_else(|| no_room_for(grid))?;
        let mut samples_of = Vec::new();
        for transmission in 0..n_tx {
            source.visit_transmission(transmission, moving.together, &mut |tones, samples| {
                let own = moving.of_tones(transmission, tones.clone())?;
                // Of the mean that an image is, its share in that of all.
                let share = ((tones.len() * n_mic) as f64 / all) as f32;
                moving.weighted((transmission, tones), samples, &mut samples_of);
                let tones = CubeView::new(&own, &samples_of)?;
                add(part, (method, &moving), tones, &mut total, share, options.compensate)
            })?;
        }
        Ok(total)
    })?;
    Ok(info)
}

/// Adds a share of the image of a few tones.
fn add(
    part: &PartOfGrid<'_>,
    (method, moving): (Method, &Moving<'_>),
    tones: CubeView<'_>,
    total: &mut [Complex32],
    share: f32,
    compensate: bool,
) -> Result<()> {
    let options = ReconstructOptions { compensate, ..moving.options };
    part.add((method, &options), tones, total, |sum, a| *sum += a * share)
}

/// What each method would take for a frame that moves: so many times what it takes for tones that are imaged together.
pub(in crate::reconstruct) fn estimates_in_motion(
    instrument: &Instrument,
    grid: &Grid,
    (options, motion): (&ReconstructOptions, Motion),
    threads: usize,
) -> Result<Estimates> {
    let moving = Moving::new(instrument, grid, options, motion)?;
    let typical = moving.of_tones(0, moving.typical())?;
    let found = estimate(&typical, grid, &moving.options, threads)?;
    let mut methods = found.methods;
    for part in end_slabs(grid).filter(|part| part != grid) {
        let of_part = estimate(&typical, &part, &moving.options, threads)?.methods;
        methods.iter_mut().zip(of_part).for_each(|(all, part)| all.bytes = all.bytes.max(part.bytes));
    }
    let times = (instrument.transmissions() * moving.groups()) as f64;
    let held = held_bytes(instrument, grid, moving.together);
    for method in &mut methods {
        method.operations *= times;
        method.bytes = if method.obstacle.is_none() { method.bytes.saturating_add(held) } else { 0 };
    }
    Ok(Estimates { methods, chosen: found.chosen })
}

#[cfg(test)]
mod tests;
