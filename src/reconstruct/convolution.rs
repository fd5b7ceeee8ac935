//! Eq. 16: on a shared lattice the sum over microphones is a convolution, done by padded 2-D FFTs.
//!
//! `p − r` depends on the difference of indices alone, so one kernel `e^{−i2πf|p−r|/c}` per frequency and depth suffices
//! for every pair of voxel and microphone ([`SharedLattice`] says when). With a tolerance, the sweep is first compressed
//! to virtual tones for the volume, and these to skeleton tones for each slab of depths, so that Eq. 16 runs over tens
//! of tones instead of all; with tolerance 0 it runs over every one.

mod adjoint;
mod cost;
mod kernel_path;
mod lattice;
mod layout;
mod line;
mod literal;
mod near_field;
mod padded_axis;
mod plane;
mod pointwise;
mod slab_plan;
mod spectra;
mod workspace;

pub(super) use adjoint::adjoint;
pub(super) use lattice::SharedLattice;

use crate::acquisition::{CubeSource, Instrument, SomeTransmissions};
use crate::alloc::{Reused, try_with_capacity};
use crate::blocks::runs;
use crate::error::Result;
use crate::progress::{Observer, OfPart, advance};
use crate::reconstruct::compress::{
    HeldTones, KeptTones, SlabTones, StretchTones, SweepTones, Tones, VirtualTones,
};
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::job::Job;
use crate::reconstruct::numerics::GridPlaces;
use crate::reconstruct::volume::{Batch, Slab, SlabDriver};
use crate::reconstruct::{Method, ReconstructionInfo, no_room};
use crate::wave::simd::Lanes;
use layout::Layout;
use literal::Literal;
use near_field::{NearField, image_of_all};
use num_complex::Complex32;
use rayon::prelude::*;
use slab_plan::Slabs;
use std::sync::{Arc, OnceLock};
use workspace::Workspaces;

/// Bytes of data spectra in memory at a time when every frequency is summed.
const SPECTRA_BYTES: usize = 256 << 20;

/// How Eq. 16 is carried out for one job.
#[derive(Debug)]
pub(super) struct ConvolutionPlan {
    layout: Layout,
    /// What spreading leaves to the two compressions.
    compression: ErrorBudget,
    /// Where there is a tolerance: how depths are divided.
    slabs: Option<Slabs>,
    /// Where there is none: whether Eq. 16 is summed literally.
    literal: bool,
    /// What depths take that have no part in the lattice.
    near: near_field::NearFieldCost,
    /// The tones, once they are found.
    skeletons: OnceLock<Option<Skeletons>>,
}

impl ConvolutionPlan {
    /// How the kernels of a lattice are summed, to within what the lattice itself leaves of the budget.
    pub(super) fn new(
        instrument: &Instrument,
        places: GridPlaces,
        lattice: SharedLattice,
        budget: ErrorBudget,
    ) -> Self {
        let layout = Layout::new(lattice, places, instrument);
        let compression = budget.after(layout.lattice.error());
        let slabs = (compression.all() > 0.0).then(|| Slabs::new(instrument, &layout));
        let thickness = slabs.as_ref().map_or(1, |slabs| slabs.thickness);
        let near = near_field::NearFieldCost::new(
            instrument,
            layout.grid(),
            &layout.lattice.near,
            thickness,
            compression.virtual_tones(),
        );
        let literal = slabs.is_none() && Literal::is_faster(&layout, instrument.sweep.len());
        Self { layout, compression, slabs, literal, near, skeletons: OnceLock::new() }
    }

    /// The same in stretches of so many slabs. A refinement, whose adjoint takes the volume's tones, has none.
    pub(super) fn in_stretches(self, slabs: usize) -> Self {
        Self { slabs: self.slabs.map(|own| own.in_stretches(slabs)), ..self }
    }
}

/// What sums tones at any depth.
struct Depths<'a> {
    layout: &'a Layout,
    workspaces: Workspaces<'a>,
    /// Those that have no part in the lattice, by transmission.
    near: Vec<NearField<'a>>,
    batch: Batch,
    observer: &'a dyn Observer,
}

impl Depths<'_> {
    /// Adds tones of all transmissions to the planes from `first` on, `[plane, y, x]`, each of so much work; `room` receives
    /// their spectra.
    fn add(
        &self,
        (transmissions, work): (&[Tones], usize),
        room: &mut Vec<Lanes>,
        first: usize,
        planes: &mut [Complex32],
    ) -> Result<()> {
        let per_metre = &transmissions[0].per_metre;
        if room.len() < self.layout.spectra_len(per_metre.len()) {
            // Not both at a time.
            *room = Vec::new();
            *room = self.layout.room(per_metre.len())?;
        }
        let spectra = self.layout.part(room, per_metre.len());
        self.layout.transform_into(transmissions, self.batch, spectra)?;
        let spectra = &*spectra;
        let planes = planes.par_chunks_mut(self.layout.grid().plane_len());
        let run = self.batch.least_run(planes.len());
        planes.with_min_len(run).enumerate().try_for_each(|(iz, voxels)| {
            if !image_of_all(&self.near, first + iz, voxels, self.observer)? {
                self.workspaces.with(|workspace| workspace.add(first + iz, per_metre, spectra, voxels))?;
            }
            advance(self.observer, work as u64)
        })
    }
}

/// Gives the volume to the job's sink by Eq. 16, over skeleton tones or every frequency.
///
/// Cost: per tone and depth, for each pair of sublattices one kernel of `n_x·n_y` phasors and its FFT, and one inverse
/// FFT per voxel sublattice (monostatic: one per depth). With a tolerance a sweep is some `B·T + 10` tones, T the
/// spread of delays within a slab.
pub(super) fn convolution(job: Job<'_>, plan: &ConvolutionPlan) -> Result<ReconstructionInfo> {
    match plan.skeletons(job.source.instrument()) {
        None => every_frequency(job, plan),
        Some(skeletons) => convolution_with(job, plan, skeletons),
    }
}

/// Depths that are worked on at a time when every frequency is summed: enough that the spectra of the samples, which
/// each such slab computes again, cost almost nothing.
const DEPTHS: usize = 32;

/// All frequencies in ascending order for each slab of depths, in blocks that bound the memory and change no sum.
fn every_frequency(job: Job<'_>, plan: &ConvolutionPlan) -> Result<ReconstructionInfo> {
    let layout = &plan.layout;
    let Job { source, weights, grid, batch, sink, observer, .. } = job;
    let instrument = source.instrument();
    let (count, n_mic) = (instrument.sweep.len(), instrument.array.len());
    let per_metre: Vec<f64> =
        instrument.sweep.frequencies().iter().map(|f| -f / instrument.sound_speed).collect();
    let block = batch.frequencies;
    let mut modulus = 0.0;
    source.visit(block, &mut |range, block| {
        let rows = range.clone().zip(block.chunks_exact(n_mic));
        modulus += rows.map(|(f, row)| weights.modulus(f, row)).sum::<f64>();
        Ok(())
    })?;
    let info = ReconstructionInfo::plain(Method::Convolution, layout.lattice.error() * modulus);
    let spreading = layout.lattice.spreading(&source.instrument().array);
    let literal = plan.literal.then(|| Literal::new(layout));
    let mut spectra = Vec::new();
    let focused = Depths { layout, workspaces: Workspaces::new(layout), near: Vec::new(), batch, observer };
    let driver = SlabDriver::even(grid, DEPTHS, |depths| (count * depths) as u64, observer);
    driver.run(info, sink, |_, depths, planes| {
        planes.fill(Complex32::ZERO);
        source.visit(block, &mut |range, block| {
            let (tones, width) = (range.len() as u64, n_mic as u64);
            let mut samples = try_with_capacity(tones * width).ok_or_else(|| no_room(tones, width))?;
            let rows = range.clone().zip(block.chunks_exact(n_mic));
            samples.extend(rows.flat_map(|(f, row)| weights.weighted(f, row)));
            let samples = spreading.onto_nodes(samples)?;
            let tones = Tones { per_metre: per_metre[range.clone()].to_vec(), samples };
            match &literal {
                Some(literal) => literal.add(&tones, batch, depths.start, planes, observer),
                None => focused.add((&[tones], range.len()), &mut spectra, depths.start, planes),
            }
        })
    })
}

/// The tones of a volume and of its slabs, whatever the samples are.
///
/// Transmissions have the same ones, so that they share the kernels: those for the transmission whose paths differ most,
/// each about the middle of its own paths.
#[derive(Debug)]
pub(super) struct Skeletons {
    transmissions: Vec<TransmissionTones>,
    /// Of spreading, relative to `Σ|w m| / Σw`.
    spreading: f64,
}

/// The tones about the middle of one transmission's paths.
#[derive(Debug)]
struct TransmissionTones {
    sweep: Arc<SweepTones>,
    stretches: StretchTones,
    slabs: Vec<SlabTones>,
}

impl ConvolutionPlan {
    /// The largest error of any voxel, relative to `Σ|w m| / Σw`.
    pub(super) fn error(&self, instrument: &Instrument) -> f64 {
        self.skeletons(instrument).map_or(self.layout.lattice.error(), Skeletons::error)
    }

    /// The tones for the instrument that it is of, found when first needed; `None` where every frequency is summed.
    pub(super) fn skeletons(&self, instrument: &Instrument) -> Option<&Skeletons> {
        self.skeletons.get_or_init(|| self.find_skeletons(instrument)).as_ref()
    }

    fn find_skeletons(&self, instrument: &Instrument) -> Option<Skeletons> {
        let Self { layout, compression, slabs: Some(division), .. } = self else { return None };
        let (places, thickness) = (&layout.places, division.thickness);
        let depths = places.grid().z.count;
        let interval = |planes| instrument.longest_path_interval(places.bounds(planes));
        let sweep = SweepTones::find(&instrument.sweep, interval(0..depths), *compression);
        let share = |longer, own, depths| division.share(longer, own, depths);
        // The tones of the longest stretch serve all, each about the middle of its own paths, and slabs share skeletons.
        let stretches = division.stretches(depths);
        let paths = stretches.iter().map(|planes| interval(planes.clone()));
        let longest = paths.max_by(|a, b| a.duration().total_cmp(&b.duration()));
        let narrowed = longest.map(|paths| sweep.narrowed(paths, *compression));
        let (tones, left) = match &narrowed {
            Some(tones) => (tones, sweep.left(*compression)),
            None => (&sweep, *compression),
        };
        let slabs = tones.slabs(runs(depths, thickness), interval, share, left);
        let middles =
            |planes| instrument.path_intervals(places.bounds(planes)).into_iter().map(|paths| paths.middle());
        let mut transmissions: Vec<_> = middles(0..depths)
            .map(|middle| TransmissionTones {
                sweep: sweep.about(&instrument.sweep, middle),
                stretches: StretchTones::new(division.stretch),
                slabs: Vec::with_capacity(slabs.len()),
            })
            .collect();
        if let Some(tones) = narrowed {
            let of_volume = sweep.as_sweep();
            for planes in stretches {
                for (transmission, middle) in transmissions.iter_mut().zip(middles(planes)) {
                    transmission.stretches.push(tones.about(&of_volume, middle));
                }
            }
        }
        for slab in &slabs {
            for (transmission, middle) in transmissions.iter_mut().zip(middles(slab.planes.clone())) {
                transmission.slabs.push(slab.about(middle));
            }
        }
        Some(Skeletons { transmissions, spreading: layout.lattice.error() })
    }
}

impl Skeletons {
    /// The largest error of spreading and of all compressions, relative to `Σ|w m| / Σw`, for which all slabs' tones are found.
    fn error(&self) -> f64 {
        let of_slabs = SlabTones::error(self.slabs());
        let TransmissionTones { sweep, stretches, .. } = &self.transmissions[0];
        if stretches.is_empty() { of_slabs + self.spreading } else { sweep.with(of_slabs) + self.spreading }
    }

    /// The volume's tones, and how the measured ones of a transmission are made of them.
    pub(super) fn virtual_tones(&self, transmission: usize) -> &VirtualTones {
        self.transmissions[transmission].sweep.virtual_tones()
    }

    /// Number of the volume's tones.
    pub(super) fn tones(&self) -> usize {
        self.transmissions[0].sweep.len()
    }

    /// The slabs of depths, with tones of the first transmission.
    fn slabs(&self) -> &[SlabTones] {
        &self.transmissions[0].slabs
    }

    /// Units of work of all slabs, which are found: tones times depths.
    pub(super) fn work(&self) -> u64 {
        SlabTones::find(self.slabs());
        self.slabs().iter().map(|slab| (slab.len() * slab.planes.len()) as u64).sum()
    }

    /// The most tones of a slab whose tones are found.
    fn most_found(&self) -> usize {
        self.slabs().iter().filter_map(SlabTones::len_if_found).max().unwrap_or(0)
    }
}

/// Gives the volume to the job's sink by Eq. 16 over skeleton tones, slab by slab.
pub(super) fn convolution_with(
    job: Job<'_>,
    plan: &ConvolutionPlan,
    skeletons: &Skeletons,
) -> Result<ReconstructionInfo> {
    let layout = &plan.layout;
    let Job { source, mut kept, weights, grid, interpolation, batch, sink, observer, .. } = job;
    let slabs = skeletons.slabs();
    let instrument = source.instrument().clone();
    let alone: Vec<Instrument> =
        (0..skeletons.transmissions.len()).map(|index| instrument.transmission(index)).collect();
    let spreading = layout.lattice.spreading(&instrument.array);
    let find_error = || skeletons.error();
    let mut kept = KeptTones { find_error: Some(&find_error), ..kept.lent() };
    let (mut near, mut compressed) = (Vec::new(), Vec::new());
    let compress =
        |index: usize, source: &mut dyn CubeSource, kept: &mut KeptTones<'_>, observer: &dyn Observer| {
            let source = &mut SomeTransmissions::one(source, index);
            skeletons.transmissions[index].sweep.compress((source, weights), kept, observer)
        };
    for (index, (alone, tones)) in alone.iter().zip(&skeletons.transmissions).enumerate() {
        let compress = |kept: &mut KeptTones<'_>| {
            let volume = compress(index, source, kept, observer)?;
            near.extend(NearField::new(alone, grid, &layout.lattice.near, &volume, &tones.slabs)?);
            Ok(volume)
        };
        let onto_nodes = |samples| spreading.onto_nodes(samples);
        let microphones = instrument.array.len();
        compressed.push(HeldTones::new(&tones.stretches, microphones, &mut kept, compress, onto_nodes)?);
    }
    let modulus: f64 = compressed.iter().map(|held| held.modulus).sum();
    let error_bound = interpolation.with(*kept.error.get_or_init(find_error)) * modulus;
    let plane_len = grid.plane_len();
    // Threads share out what slabs that are worked on at a time need.
    let (rooms, width) = (Reused::new(), layout.lattice.width());
    let room = |most| {
        let tones = alone.iter().map(|_| Tones::with_capacity(most, width));
        Ok((tones.collect::<Result<Vec<_>>>()?, layout.room(most)?))
    };
    let work: Vec<usize> = slabs.iter().map(SlabTones::about_len).collect();
    let focused = Depths { layout, workspaces: Workspaces::new(layout), near, batch, observer };
    let of_driver = |(slab, work): (&SlabTones, &usize)| {
        let depths = slab.planes.clone();
        Slab { work: (work * depths.len()) as u64, depths }
    };
    let driver = SlabDriver::new(grid, slabs.iter().zip(&work).map(of_driver).collect(), observer);
    let driver = SlabDriver { at_once: batch.slabs, divisible: true, ..driver };
    let info = ReconstructionInfo::plain(Method::Convolution, error_bound);
    driver.run(info, sink, |part, depths, mut planes| {
        planes.fill(Complex32::ZERO);
        for (index, held) in compressed.iter_mut().enumerate() {
            let own = &mut KeptTones::default();
            held.hold(&part, &mut kept, || compress(index, source, own, &OfPart(observer)))?;
        }
        let of_slab = |slab: usize| {
            let own = &slabs[slab].planes;
            let [first, end] = [own.start.max(depths.start), own.end.min(depths.end)];
            let (own, rest) = std::mem::take(&mut planes).split_at_mut((end - first) * plane_len);
            planes = rest;
            (slab, first, own)
        };
        SlabTones::find(&slabs[part.clone()]);
        let most = skeletons.most_found();
        let of_slabs: Vec<_> = part.map(of_slab).collect();
        of_slabs.into_par_iter().try_for_each(|(slab, first, planes)| {
            rooms.with(
                || room(most),
                |(tones, spectra)| {
                    let volumes = skeletons.transmissions.iter().zip(&compressed).zip(&mut *tones);
                    for ((transmission, held), tones) in volumes {
                        transmission.slabs[slab].select(held.of(slab), width, tones);
                    }
                    focused.add((tones, work[slab]), spectra, first, planes)
                },
            )
        })
    })
}
