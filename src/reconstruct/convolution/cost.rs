//! What Eq. 16 takes by one plan.

use super::literal::Literal;
use super::slab_plan::{STRETCHED, Slabs};
use super::{ConvolutionPlan, DEPTHS, SPECTRA_BYTES};
use crate::acquisition::Instrument;
use crate::blocks::runs;
use crate::reconstruct::compress::{CompressionCost, tones_for, volume_tones};
use crate::reconstruct::plan::cost::{COMPLEX, Cost, PRODUCT, complex_bytes};
use crate::reconstruct::volume::{Batch, SlabDriver};
use crate::wave::simd::LANES;
use num_complex::Complex32;
use std::ops::Range;

/// An operation of a transform takes as long as this many of a straight loop, its transpositions included.
const TRANSFORM: f64 = 1.4;

/// One on a line, where lanes are tones and everything stays in a cache, takes this part of that.
const ON_A_LINE: f64 = 0.2;

/// So does a product of spectra that are added up in memory.
const ADDED: f64 = 2.5;

/// Operations that it takes as long as to write a number to memory for the first time, for which pages are found and cleared;
/// up to so many find room in memory that the process has.
const FIRST_WRITTEN: f64 = 150.0;
const THERE: f64 = 1_048_576.0;

/// About what stretches leave to their slabs' tones, of what these may err by otherwise.
const LEFT_BY_STRETCHES: f64 = 0.3;

/// Operations of a kernel's phase.
const PHASE: f64 = 20.0;

/// Operations of a transform of `n` points.
fn transform(n: usize) -> f64 {
    TRANSFORM * 5.0 * n as f64 * (n as f64).log2()
}

/// Operations of the sum.
#[derive(Debug, Clone, Copy)]
struct Operations {
    /// Of a tone at one depth.
    pair: f64,
    /// Of a depth.
    depth: f64,
    /// Of a tone: the spectra of its samples, of all transmissions.
    spectra: f64,
}

impl ConvolutionPlan {
    /// With the memory of a batch for this many threads.
    pub(in crate::reconstruct) fn cost(&self, instrument: &Instrument, threads: usize) -> Cost<'_> {
        match &self.slabs {
            None => self.cost_of_every_frequency(instrument, threads),
            Some(slabs) => self.cost_of_skeletons(instrument, slabs, threads),
        }
    }

    fn operations(&self) -> Operations {
        let Operations { pair, depth, spectra } = self.counted_operations();
        let each = if self.layout.line.is_some() { ON_A_LINE } else { 1.0 };
        Operations { pair: each * pair, depth: each * depth, spectra: each * spectra }
    }

    /// The same as on a plane, where they take longer.
    fn counted_operations(&self) -> Operations {
        let layout = &self.layout;
        let (x, y, points) = (&layout.x, &layout.y, layout.points() as f64);
        let (kernels, images) = (layout.pairs() as f64, layout.voxel_parts.len() as f64);
        let transmissions = layout.transmissions() as f64;
        let spectra =
            transmissions * layout.node_parts.len() as f64 * TRANSFORM * 5.0 * points * points.log2();
        // A kernel that is even needs half of the phases, and of the transforms across.
        let lags = [x.lags() as f64, y.lags() as f64];
        let kernel = PHASE * lags[0] * lags[1] + lags[1] * transform(x.len()) + lags[0] * transform(y.len());
        // Rows without voxels are left out.
        let rows = layout.voxel_parts.iter().map(|part| part[1].count.next_multiple_of(LANES)).max();
        let rows = if layout.line.is_some() { y.len() } else { rows.unwrap_or(1) };
        let image = images * (x.len() as f64 * transform(y.len()) + rows as f64 * transform(x.len()));
        let product = PRODUCT * points;
        if layout.scans() {
            // Tones add up before they are transformed back.
            return Operations { pair: kernels * (kernel + ADDED * product), depth: image, spectra };
        }
        let outer = (PHASE + PRODUCT) * layout.grid().plane_len() as f64;
        // The kernel is that of all transmissions.
        let each = kernels * product + image + outer;
        Operations { pair: kernels * kernel + transmissions * each, depth: 0.0, spectra }
    }

    /// Bytes of each thread's buffers.
    fn worker_bytes(&self) -> u64 {
        let layout = &self.layout;
        let columns = 12 * layout.points().saturating_mul(layout.node_parts.len()) as u64;
        if layout.transmissions() == 1 {
            return columns;
        }
        // Kernels that are kept, and the paths from every loudspeaker.
        let kept = layout.points().saturating_mul(layout.node_parts.len() * size_of::<Complex32>()) as u64;
        let most = layout.voxel_parts.iter().map(|part| part[0].count * part[1].count).max().unwrap_or(0);
        let outward = (most * layout.transmissions() * size_of::<f64>()) as u64;
        columns.saturating_add(kept).saturating_add(outward)
    }

    /// Where every frequency is summed: bytes of one frequency's spectra, and of each thread's buffers.
    fn plain_bytes(&self) -> [u64; 2] {
        let layout = &self.layout;
        if self.literal {
            Literal::new(layout).bytes()
        } else {
            [(layout.tone_len() * size_of::<Complex32>()) as u64, self.worker_bytes()]
        }
    }

    fn cost_of_every_frequency(&self, instrument: &Instrument, threads: usize) -> Cost<'_> {
        let (n_f, grid) = (instrument.sweep.len(), self.layout.grid());
        let depths = grid.z.count;
        let Operations { pair, depth, spectra } = self.operations();
        // Of one frequency: spectra, and the samples that they are made of, as they are read and weighted.
        let [spectra_bytes, worker] = self.plain_bytes();
        let frequency = spectra_bytes + COMPLEX * 2 * instrument.array.len() as u64;
        let footprints = self.layout.lattice.footprint_bytes(&instrument.array);
        let planes = SlabDriver::bytes(grid.plane_len() as u64, DEPTHS, depths).saturating_add(footprints);
        let block = SPECTRA_BYTES / (self.layout.tone_len() * size_of::<Complex32>());
        Cost {
            operations: n_f as f64 * (depths as f64 * pair + spectra) + depths as f64 * depth,
            usual: Batch { frequencies: block.clamp(1, n_f), ..Batch::of_threads(threads) },
            bytes: Box::new(move |batch| {
                let spectra = frequency.saturating_mul(batch.frequencies as u64);
                let buffers = worker.saturating_mul(batch.workers as u64);
                spectra.saturating_add(buffers).saturating_add(planes)
            }),
        }
    }

    /// The tones that those of slabs are made of, and what these leave them to err by; the stretches, and the operations of making
    /// and spreading their tones.
    fn of_slabs(
        &self,
        instrument: &Instrument,
        slabs: &Slabs,
        of_volume: f64,
        spread: &impl Fn(Range<usize>) -> f64,
    ) -> (f64, f64, usize, f64) {
        let depths = self.layout.grid().z.count;
        let transmissions = self.layout.transmissions() as f64;
        let spreading = transmissions * self.layout.lattice.spreading_operations(&instrument.array);
        let (stretches, tolerance) = (slabs.stretches(depths), self.compression.virtual_tones());
        if stretches.is_empty() {
            return (of_volume, tolerance, 1, spreading * of_volume);
        }
        let count = stretches.len();
        let own = volume_tones(stretches.into_iter().map(spread).fold(0.0, f64::max)).min(of_volume);
        let stretched = STRETCHED * PRODUCT * of_volume * transmissions * instrument.array.len() as f64;
        (own, tolerance * LEFT_BY_STRETCHES, count, count as f64 * (stretched + spreading * own))
    }

    fn cost_of_skeletons(&self, instrument: &Instrument, slabs: &Slabs, threads: usize) -> Cost<'_> {
        let (layout, grid) = (&self.layout, self.layout.grid());
        let (depths, thickness) = (grid.z.count, slabs.thickness);
        let interval = |depths| instrument.longest_path_interval(layout.places.bounds(depths));
        let transmissions = layout.transmissions() as f64;
        let Operations { pair, depth, spectra } = self.operations();
        let compression = CompressionCost::new(instrument, &interval(0..depths), self.compression);
        let of_volume = compression.tones;
        let width = transmissions * layout.lattice.width() as f64;
        let spread = |planes| instrument.sweep.bandwidth() * interval(planes).duration();
        let (held, tolerance, stretches, made) = self.of_slabs(instrument, slabs, of_volume, &spread);
        let mut operations =
            transmissions * compression.operations + self.near.operations + depths as f64 * depth + made;
        let mut most = 0.0f64;
        for planes in runs(depths, thickness) {
            let tones = tones_for(spread(planes.clone()), tolerance).min(held);
            operations += slabs.in_whole_lanes(tones) * (planes.len() as f64 * pair + spectra)
                + tones * PRODUCT * held * width;
            most = most.max(tones);
        }
        let spreads = layout.lattice.spreads();
        let of_nodes = if spreads { stretches as f64 * held * width } else { 0.0 };
        let of_slab = most * (width + layout.tone_len() as f64);
        operations += FIRST_WRITTEN * (of_nodes + of_slab - THERE).max(0.0);
        let nodes = complex_bytes(held * width);
        // Transmissions are compressed, and spread, one after another.
        let of_others = |all: u64| all / layout.transmissions() as u64 * (layout.transmissions() as u64 - 1);
        let footprints = layout.lattice.footprint_bytes(&instrument.array);
        let at_microphones = complex_bytes(held * instrument.array.len() as f64);
        let spreading = if spreads { at_microphones.saturating_add(footprints) } else { 0 };
        // Where there are stretches, the volume's tones stay at the microphones.
        let (volume, others) = if stretches > 1 {
            let volume = compression.samples.saturating_mul(layout.transmissions() as u64);
            (volume.saturating_add(spreading), of_others(volume))
        } else {
            (0, of_others(nodes))
        };
        let before = compression.peak.max(spreading.saturating_add(nodes - of_others(nodes)));
        let before = before.saturating_add(others);
        let each = slabs.stretch;
        let slab = complex_bytes(most * (width + layout.tone_len() as f64));
        let skeleton = compression.skeleton_bytes(&interval(0..thickness.min(depths)));
        let bytes = move |batch: Batch| {
            let planes = SlabDriver::bytes(grid.plane_len() as u64, batch.slabs * thickness, depths);
            let buffers = self.worker_bytes().saturating_add(self.near.worker_bytes);
            let skeletons = skeleton.saturating_mul(batch.workers.min(depths.div_ceil(thickness)) as u64);
            let at_once = batch.slabs.div_ceil(each).saturating_add(1).min(stretches);
            let focusing = nodes
                .saturating_mul(at_once as u64)
                .saturating_add(volume)
                .saturating_add(slab.saturating_mul(batch.slabs as u64))
                .saturating_add(buffers.saturating_mul(batch.workers as u64))
                .saturating_add(planes)
                .saturating_add(skeletons);
            before.max(focusing).saturating_add(self.near.bytes)
        };
        Cost { operations, usual: slabs.usual_batch(layout, threads), bytes: Box::new(bytes) }
    }
}
