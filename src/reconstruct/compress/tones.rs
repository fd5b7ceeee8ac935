//! Weighted samples at few frequencies: the sweep compressed for the whole volume, then again for each slab.
//!
//! The two nest: the skeleton tones of a slab are found among the virtual tones of the volume.
//! Sums run over fixed blocks of frequencies and microphones, so neither threads nor memory change the bytes.

use super::kept::{KeptTones, NUMBERS};
use super::skeleton::{Skeleton, skeleton, tones_for};
use super::slabs::finders;
use super::virtual_tones::VirtualTones;
use crate::acquisition::{CubeSource, Sweep};
use crate::alloc::{try_with_capacity, try_zeroed};
use crate::error::Result;
use crate::linalg::add_product_of_rows;
use crate::progress::{Observer, advance, stage};
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::no_room;
use crate::reconstruct::window::Weights;
use crate::wave::interval::{PathInterval, greater, phasor_f64};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

/// Numbers that one thread writes at a time, several pages of them.
const ZEROS: usize = 1 << 16;

/// Frequencies are read in multiples of so many, whatever memory there is: their sums are part of the result's bytes.
pub(crate) const FREQUENCIES: usize = 64;

/// Frequencies read at a time: more where there are few microphones, since threads take time to wake.
pub(crate) fn frequencies_at_once(microphones: usize) -> usize {
    FREQUENCIES * ((1 << 18) / (FREQUENCIES * microphones)).clamp(1, 16)
}

/// Weighted samples at a few frequencies.
#[derive(Debug, Clone)]
pub(crate) struct Tones {
    /// f_q/c with the sign of the inverse, −1/m.
    pub(crate) per_metre: Vec<f64>,
    /// `[Q, width]`: one row of microphones or nodes per tone.
    pub(crate) samples: Vec<Complex32>,
}

impl Tones {
    /// Buffers for this many tones, empty.
    ///
    /// # Errors
    /// They do not fit in memory.
    pub(crate) fn with_capacity(tones: usize, width: usize) -> Result<Self> {
        let (count, nodes) = (tones as u64, width as u64);
        let samples = try_with_capacity(count.saturating_mul(nodes)).ok_or_else(|| no_room(count, nodes))?;
        Ok(Self { per_metre: Vec::with_capacity(tones), samples })
    }
}

/// The tones that a sweep is compressed to for one volume, whatever the samples are.
#[derive(Debug)]
pub(crate) struct SweepTones {
    found: VirtualTones,
    /// −f/c of each of them, 1/m.
    per_metre: Vec<f64>,
}

/// A cube compressed for one volume, to be compressed again for its slabs.
#[derive(Debug)]
pub(crate) struct VolumeTones {
    pub(crate) tones: Tones,
    /// `Σ|w m| / Σw`: what one unit of relative error comes to in the volume.
    pub(crate) modulus: f64,
    pub(crate) sweep: Arc<SweepTones>,
}

/// How a slab's tones follow from the volume's.
#[derive(Debug)]
pub(crate) struct SlabTones {
    /// The depths that share them.
    pub(crate) planes: Range<usize>,
    /// The delay in the middle of their paths, s.
    middle: f64,
    /// For delays about the middle, these or longer ones.
    skeleton: Arc<LateSkeleton>,
}

/// A skeleton among the tones of a volume, found when first needed: a process that has few of the slabs needs few.
#[derive(Debug)]
struct LateSkeleton {
    sweep: Arc<SweepTones>,
    interval: PathInterval,
    tolerance: f64,
    found: OnceLock<Skeleton>,
}

impl LateSkeleton {
    fn found(&self) -> &Skeleton {
        let find = || skeleton(self.sweep.found.frequencies(), self.interval, self.tolerance);
        self.found.get_or_init(find)
    }

    /// About how many tones it has.
    fn about_len(&self) -> usize {
        let bandwidth_duration = self.sweep.found.bandwidth() * self.interval.duration();
        (tones_for(bandwidth_duration, self.tolerance) as usize).clamp(1, self.sweep.len())
    }
}

impl SweepTones {
    /// Those for all path lengths of `interval`, to within their share of the budget.
    pub(crate) fn find(sweep: &Sweep, interval: PathInterval, budget: ErrorBudget) -> Arc<Self> {
        let found = VirtualTones::find(sweep, interval, budget.virtual_tones());
        let per_metre = found.frequencies().iter().map(|f| -f / interval.sound_speed).collect();
        Arc::new(Self { found, per_metre })
    }

    /// The same tones for delays about another middle, s, as far from it.
    pub(crate) fn about(&self, sweep: &Sweep, middle: f64) -> Arc<Self> {
        Arc::new(Self { found: self.found.about(sweep, middle), per_metre: self.per_metre.clone() })
    }

    /// Those for some of the paths, found among these as these are among the measured ones, from what they leave of a budget.
    pub(crate) fn narrowed(&self, interval: PathInterval, budget: ErrorBudget) -> Arc<Self> {
        Self::find(&self.as_sweep(), interval, self.left(budget))
    }

    /// These tones as measured ones.
    pub(crate) fn as_sweep(&self) -> Sweep {
        Sweep::from_frequencies(self.found.frequencies().to_vec()).expect("tones ascend within a sweep")
    }

    /// What they leave of a budget for tones that are made of them.
    pub(crate) fn left(&self, budget: ErrorBudget) -> ErrorBudget {
        budget.after(self.found.error).before(self.found.growth)
    }

    /// The error of what is made of them and errs by `error`.
    pub(crate) fn with(&self, error: f64) -> f64 {
        self.found.error + self.found.growth * error
    }

    /// Samples of these tones, found among those of a volume, from its samples, in the `room` of others.
    ///
    /// # Errors
    /// They do not fit in memory.
    pub(super) fn again(self: &Arc<Self>, volume: &VolumeTones, room: Vec<Complex32>) -> Result<VolumeTones> {
        let count = volume.sweep.len();
        let width = volume.tones.samples.len() / count;
        let mut samples = self.silence(width, room)?;
        // They are weighted once.
        let ones = Weights { frequency: vec![1.0; count], microphone: vec![1.0; width] };
        self.found.add(0..count, &volume.tones.samples, (&ones, false), &mut samples);
        self.found.finish(&ones, &mut samples);
        Ok(self.with_samples(samples, volume.modulus))
    }

    /// Samples of these tones at so many microphones, all zero, in the `room` of others.
    ///
    /// # Errors
    /// They do not fit in memory.
    pub(super) fn silence(&self, width: usize, mut room: Vec<Complex32>) -> Result<Vec<Complex32>> {
        room.clear();
        if room.capacity() < self.len() * width {
            let (tones, width) = (self.len() as u64, width as u64);
            room = try_with_capacity(tones.saturating_mul(width)).ok_or_else(|| no_room(tones, width))?;
        }
        room.resize(self.len() * width, Complex32::ZERO);
        Ok(room)
    }

    /// These tones with their samples.
    pub(super) fn with_samples(self: &Arc<Self>, samples: Vec<Complex32>, modulus: f64) -> VolumeTones {
        let tones = Tones { per_metre: self.per_metre.clone(), samples };
        VolumeTones { tones, modulus, sweep: Arc::clone(self) }
    }

    /// Their weights in the measured tones.
    pub(crate) fn virtual_tones(&self) -> &VirtualTones {
        &self.found
    }

    /// Number of tones.
    pub(crate) fn len(&self) -> usize {
        self.per_metre.len()
    }

    /// Compresses a cube, block by block, unless it is kept as it would be then.
    pub(crate) fn compress(
        self: &Arc<Self>,
        (source, weights): (&mut dyn CubeSource, &Weights),
        kept: &mut KeptTones<'_>,
        observer: &dyn Observer,
    ) -> Result<VolumeTones> {
        let (n_f, n_mic) = (source.instrument().sweep.len(), source.instrument().array.len());
        let (tones, width) = (self.len() as u64, n_mic as u64);
        let room = tones.saturating_mul(width).saturating_add(NUMBERS as u64);
        let mut samples = try_zeroed(room).ok_or_else(|| no_room(tones, width))?;
        let modulus = if let Some(modulus) = kept.load(&mut samples)? {
            modulus
        } else {
            // What a store that was cut off has left goes. Besides, a page that is read before it is written is mapped twice,
            // and every processor told of it.
            samples.par_chunks_mut(ZEROS).for_each(|some| some.fill(Complex32::ZERO));
            let (mut modulus, length) = (0.0, samples.len() - NUMBERS);
            stage(observer, "compressing the sweep", n_f as u64, || {
                source.visit(frequencies_at_once(n_mic), &mut |range, block| {
                    modulus += self.found.add(range.clone(), block, (weights, true), &mut samples[..length]);
                    advance(observer, range.len() as u64)
                })
            })?;
            self.found.finish(weights, &mut samples[..length]);
            kept.save(&mut samples, modulus)?;
            modulus
        };
        samples.truncate(samples.len() - NUMBERS);
        Ok(self.with_samples(samples, modulus))
    }

    /// The tones of slabs of these depths, whose path lengths `interval` tells, each found when it is needed.
    ///
    /// About the middle of an interval, weights depend on its duration alone: a slab takes the skeleton of one before it
    /// where `share` says so, of the durations of both, times the bandwidth, and of its own depths.
    pub(crate) fn slabs(
        self: &Arc<Self>,
        planes: impl Iterator<Item = Range<usize>>,
        interval: impl Fn(Range<usize>) -> PathInterval,
        share: impl Fn(f64, f64, usize) -> bool,
        budget: ErrorBudget,
    ) -> Vec<SlabTones> {
        let planes: Vec<_> = planes.collect();
        let intervals: Vec<_> = planes.iter().map(|planes| interval(planes.clone())).collect();
        let bandwidth = self.found.bandwidth();
        let spreads =
            intervals.iter().zip(&planes).map(|(i, planes)| (bandwidth * i.duration(), planes.len()));
        let finders = finders(&spreads.collect::<Vec<_>>(), share);
        let tolerance = self.left(budget).all();
        let mut slabs: Vec<SlabTones> = Vec::with_capacity(planes.len());
        for ((i, planes), finder) in planes.into_iter().enumerate().zip(finders) {
            let own = || {
                let (sweep, interval) = (Arc::clone(self), intervals[i]);
                Arc::new(LateSkeleton { sweep, interval, tolerance, found: OnceLock::new() })
            };
            let skeleton = slabs.get(finder).map_or_else(own, |finder| Arc::clone(&finder.skeleton));
            slabs.push(SlabTones { planes, middle: intervals[i].middle(), skeleton });
        }
        slabs
    }
}

impl VolumeTones {
    /// Compresses a cube, unless it is kept so, for all path lengths of `interval` to within its share of the budget.
    pub(crate) fn compress(
        (source, weights): (&mut dyn CubeSource, &Weights),
        kept: &mut KeptTones<'_>,
        (interval, budget): (PathInterval, ErrorBudget),
        observer: &dyn Observer,
    ) -> Result<Self> {
        SweepTones::find(&source.instrument().sweep, interval, budget).compress(
            (source, weights),
            kept,
            observer,
        )
    }

    /// The same for some of the microphones, in this order.
    ///
    /// # Errors
    /// They do not fit in memory.
    pub(crate) fn of_microphones(&self, microphones: &[usize]) -> Result<Self> {
        let rows = self.tones.per_metre.len();
        let mut tones = Tones::with_capacity(rows, microphones.len())?;
        tones.per_metre.clone_from(&self.tones.per_metre);
        for row in self.tones.samples.chunks_exact(self.tones.samples.len() / rows.max(1)) {
            tones.samples.extend(microphones.iter().map(|r| row[*r]));
        }
        Ok(Self { tones, modulus: self.modulus, sweep: Arc::clone(&self.sweep) })
    }
}

impl SlabTones {
    /// The same tones for delays about another middle, s, as far from it.
    pub(crate) fn about(&self, middle: f64) -> Self {
        Self { planes: self.planes.clone(), middle, skeleton: Arc::clone(&self.skeleton) }
    }

    /// Finds the tones of slabs, which are in order.
    pub(crate) fn find(slabs: &[Self]) {
        let finders: Vec<_> = slabs.chunk_by(|a, b| Arc::ptr_eq(&a.skeleton, &b.skeleton)).collect();
        finders.into_par_iter().for_each(|slabs| _ = slabs[0].skeleton.found());
    }

    /// Number of tones.
    pub(crate) fn len(&self) -> usize {
        self.skeleton.found().chosen().len()
    }

    /// The same, if they are found.
    pub(crate) fn len_if_found(&self) -> Option<usize> {
        self.skeleton.found.get().map(|found| found.chosen().len())
    }

    /// The same, or about that many while they are not found.
    pub(crate) fn about_len(&self) -> usize {
        self.len_if_found().unwrap_or_else(|| self.skeleton.about_len())
    }

    /// A bound of the two steps' error together, relative to one, in any of these slabs, which are all found.
    pub(crate) fn error(slabs: &[Self]) -> f64 {
        Self::find(slabs);
        let error = |slab: &Self| slab.skeleton.sweep.with(slab.skeleton.found().error());
        slabs.iter().map(error).fold(0.0, greater)
    }

    /// −f/c of each of them, 1/m.
    pub(crate) fn per_metre(&self, sweep: &SweepTones) -> Vec<f64> {
        self.skeleton.found().chosen().iter().map(|&q| sweep.per_metre[q]).collect()
    }

    /// The slab's tones from the volume's, whose rows are `width` wide.
    ///
    /// # Errors
    /// They do not fit in memory.
    pub(crate) fn of(&self, volume: &VolumeTones, width: usize) -> Result<Tones> {
        let mut tones = Tones::with_capacity(self.len(), width)?;
        self.select(volume, width, &mut tones);
        Ok(tones)
    }

    /// The same in place of others, in their room if they have enough.
    pub(crate) fn select(&self, volume: &VolumeTones, width: usize, tones: &mut Tones) {
        tones.samples.clear();
        tones.samples.resize(self.len() * width, Complex32::ZERO);
        let weight = self.weights(&volume.sweep);
        add_product_of_rows(weight, &volume.tones.samples, width, &mut tones.samples);
        tones.per_metre = self.per_metre(&volume.sweep);
    }

    /// The adjoint of [`SlabTones::select`]: adds what the slab's tones are to the volume's, both in rows of `width`.
    pub(crate) fn add_to(
        &self,
        sweep: &SweepTones,
        slab: &[Complex32],
        width: usize,
        volume: &mut [Complex32],
    ) {
        let weight = self.weights(sweep);
        add_product_of_rows(|k, q| weight(q, k).conj(), slab, width, volume);
    }

    /// W: the weight of the volume's tone k in the slab's tone q.
    fn weights<'a>(&'a self, sweep: &SweepTones) -> impl Fn(usize, usize) -> Complex32 + use<'a> {
        let skeleton = self.skeleton.found();
        let chosen = skeleton.chosen();
        let turns: Vec<_> = sweep.found.frequencies().iter().map(|f| phasor_f64(f * self.middle)).collect();
        move |q, k| {
            let w = skeleton.about_middle(q, k) * turns[chosen[q]] * turns[k].conj();
            Complex32::new(w.re as f32, w.im as f32)
        }
    }
}
