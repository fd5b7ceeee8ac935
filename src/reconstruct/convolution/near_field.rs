//! Depths too near to the microphones to be spread for: Eq. 13 at their few tones, voxel by voxel.
//!
//! Within half a wave of the array a kernel bends too sharply for nodes between the microphones. Such depths are few, and
//! compressed to tones they cost a tenth of the direct sum.

use crate::acquisition::Instrument;
use crate::alloc::try_zeroed;
use crate::blocks::runs;
use crate::error::Result;
use crate::grid::{Grid, no_room_for};
use crate::progress::{Observer, advance};
use crate::reconstruct::compress::{SlabTones, Tones, VolumeTones, tones_for};
use crate::reconstruct::direct::{Sums, TOGETHER, image, lengths, sums_of_tones};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Depths that are summed without nodes.
pub(crate) struct NearField<'a> {
    instrument: &'a Instrument,
    grid: Grid,
    /// By slab of depths, sums over its tones.
    slabs: Vec<(Range<usize>, Sums<'static>)>,
}

impl<'a> NearField<'a> {
    /// For some depths of a grid, from the volume's tones at the microphones; `None` where there are none.
    ///
    /// # Errors
    /// The tones of their slabs do not fit in memory.
    pub(crate) fn new(
        instrument: &'a Instrument,
        grid: &Grid,
        depths: &Range<usize>,
        compressed: &VolumeTones,
        slabs: &[SlabTones],
    ) -> Result<Option<Self>> {
        let n_mic = instrument.array.len();
        let of_slab = |slab: &SlabTones| -> Option<Result<_>> {
            let planes = common(&slab.planes, depths);
            let sums = |tones: Tones| sums_of_tones(&tones.samples, tones.per_metre, n_mic);
            (!planes.is_empty()).then(|| Ok((planes, sums(slab.of(compressed, n_mic)?))))
        };
        let slabs: Vec<_> = slabs.iter().filter_map(of_slab).collect::<Result<_>>()?;
        Ok((!slabs.is_empty()).then(|| Self { instrument, grid: *grid, slabs }))
    }

    /// Sums the voxels of depth `iz`, `[y, x]`, if it is one of them; whether it is. Replaces what they are.
    ///
    /// Cost: some 30 operations per voxel, microphone and tone.
    ///
    /// # Errors
    /// [`crate::error::Error::Interrupted`].
    pub(crate) fn image(&self, iz: usize, voxels: &mut [Complex32], observer: &dyn Observer) -> Result<bool> {
        let Some((_, sums)) = self.slabs.iter().find(|(planes, _)| planes.contains(&iz)) else {
            return Ok(false);
        };
        let first = iz * self.grid.plane_len();
        let chunks = voxels.par_chunks_mut(TOGETHER).enumerate();
        chunks.try_for_each_init(
            || lengths(self.instrument.array.len()),
            |lengths, (chunk, voxels)| {
                let first = first + chunk * TOGETHER;
                image(self.instrument, Instrument::path_length_at, &self.grid, sums, first, voxels, lengths);
                advance(observer, 0)
            },
        )?;
        Ok(true)
    }
}

/// Sums the voxels of depth `iz`, `[y, x]`, over transmissions, if it is one of those that are too near; whether it is.
///
/// # Errors
/// [`crate::error::Error::Interrupted`]; a second plane does not fit in memory.
pub(crate) fn image_of_all(
    transmissions: &[NearField<'_>],
    iz: usize,
    voxels: &mut [Complex32],
    observer: &dyn Observer,
) -> Result<bool> {
    let Some((first, others)) = transmissions.split_first() else { return Ok(false) };
    if !first.image(iz, voxels, observer)? {
        return Ok(false);
    }
    if !others.is_empty() {
        let mut own = try_zeroed(voxels.len() as u64).ok_or_else(|| no_room_for(&first.grid))?;
        for other in others {
            other.image(iz, &mut own, observer)?;
            voxels.iter_mut().zip(&own).for_each(|(sum, own)| *sum += own);
        }
    }
    Ok(true)
}

/// What such depths take.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct NearFieldCost {
    pub(crate) operations: f64,
    /// Bytes of their samples.
    pub(crate) bytes: u64,
    /// Bytes that each thread has of its own.
    pub(crate) worker_bytes: u64,
}

impl NearFieldCost {
    /// By a fixed model, for slabs of this many depths; nothing without such depths.
    pub(crate) fn new(
        instrument: &Instrument,
        grid: &Grid,
        depths: &Range<usize>,
        thickness: usize,
        tolerance: f64,
    ) -> Self {
        let mut cost = Self::default();
        let microphones = instrument.array.len() as f64;
        for slab in runs(grid.z.count, thickness) {
            let near = common(&slab, depths);
            if near.is_empty() {
                continue;
            }
            let spread =
                instrument.sweep.bandwidth() * instrument.longest_path_interval(grid.box_of(slab)).duration();
            let tones = tones_for(spread, tolerance).min(instrument.sweep.len() as f64);
            let voxels = grid.plane_len() as f64 * near.len() as f64 * instrument.transmissions() as f64;
            cost.operations += voxels * microphones * (60.0 + 30.0 * tones);
            // As they are selected, and then in real and imaginary parts.
            let samples = (2.0 * tones * microphones) as u64 * instrument.transmissions() as u64;
            cost.bytes += samples * size_of::<Complex32>() as u64;
            cost.worker_bytes = (TOGETHER * size_of::<f64>() * instrument.array.len()) as u64;
        }
        cost
    }
}

/// What two ranges of depths have in common.
fn common(a: &Range<usize>, b: &Range<usize>) -> Range<usize> {
    a.start.max(b.start)..a.end.min(b.end)
}
