//! The adjoint of Eq. 16 over skeleton tones: what a volume lets the microphones hear.
//!
//! Where Eq. 16 makes voxels of samples, `Â(p) = Σ_q Σ_r m̂_q(r) e^{−i2πf_q·path(p, r)/c}`, its adjoint makes samples of voxels,
//! `m̂_q(r) = Σ_p A(p) e^{i2πf_q·path(p, r)/c}`, by the same lattice, kernels and skeletons in the opposite order, so that the
//! two are adjoint to within rounding. The kernel depends on `p − r` alone, so the sum over the voxels of a depth is a
//! correlation with it. Depths add up before the transform back: the voxels' spectra are multiplied with the kernels' and
//! added, tone by tone, over all depths of a slab. Conjugate voxels go in and conjugate samples come out, so that the
//! phasors are those of Eq. 16.

mod line;
mod plane;
mod spectra;

use super::workspace::Workspaces;
use super::{ConvolutionPlan, Skeletons};
use crate::acquisition::Instrument;
use crate::error::Result;
use crate::progress::{Observer, advance};
use crate::reconstruct::compress::SlabTones;
use crate::reconstruct::silence;
use crate::reconstruct::volume::Batch;
use crate::wave::simd::{LANES, Lanes};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Samples of the volume's tones at the microphones, `[transmission, tone, n_mic]`, from some depths of voxels `[z, y, x]`.
///
/// Cost: as [`convolution`](super::convolution) without the compression: per tone and depth, for each pair of sublattices
/// one kernel and its transform, and one transform per voxel sublattice.
///
/// # Errors
/// They do not fit in memory; [`Error::Interrupted`](crate::error::Error::Interrupted).
pub(in crate::reconstruct) fn adjoint(
    plan: &ConvolutionPlan,
    skeletons: &Skeletons,
    instrument: &Instrument,
    batch: Batch,
    (depths, voxels): (Range<usize>, &[Complex32]),
    observer: &dyn Observer,
) -> Result<Vec<Complex32>> {
    let layout = &plan.layout;
    let (slabs, width, transmissions) = (skeletons.slabs(), layout.lattice.width(), &skeletons.transmissions);
    let zeros = |tones: usize| silence(tones * transmissions.len(), width);
    SlabTones::find(slabs);
    let most = skeletons.most_found();
    let at_once = batch.slabs.min(slabs.len());
    let rooms = (0..at_once).into_par_iter().map(|_| Ok((layout.room(most)?, zeros(most)?)));
    let mut rooms: Vec<(Vec<Lanes>, Vec<Complex32>)> = rooms.collect::<Result<_>>()?;
    let workspaces = Workspaces::for_adjoint(layout);
    // Tones that one thread takes for all depths of a slab: their sums are in the order of the depths, whoever takes them.
    let together = most.div_ceil(2 * batch.workers).max(1);
    let together = if layout.line.is_some() { together.next_multiple_of(LANES) } else { together };
    let plane_len = layout.grid().plane_len();
    let mut volume = zeros(skeletons.tones())?;
    let sweep = &transmissions[0].sweep;
    for first in (0..slabs.len()).step_by(at_once) {
        let some = first..(first + at_once).min(slabs.len());
        slabs[some.clone()].par_iter().zip(&mut rooms).try_for_each(|(slab, (spectra, nodes))| {
            let per_metre = slab.per_metre(sweep);
            let spectra = layout.part(spectra, per_metre.len());
            spectra.fill(Lanes::ZERO);
            let parts = spectra.par_chunks_mut(layout.spectra_len(together));
            parts.zip(per_metre.par_chunks(together)).try_for_each(|(spectra, per_metre)| {
                for iz in slab.planes.clone() {
                    let voxels = &voxels[iz * plane_len..][..plane_len];
                    // Sparse volumes have many depths without anything.
                    if depths.contains(&iz) && voxels.iter().any(|a| *a != Complex32::ZERO) {
                        workspaces.with(|workspace| workspace.correlate(iz, per_metre, voxels, spectra))?;
                    }
                    advance(observer, per_metre.len() as u64)?;
                }
                Ok(())
            })?;
            let nodes = nodes.chunks_exact_mut(per_metre.len() * width).take(transmissions.len());
            nodes.enumerate().try_for_each(|(i, nodes)| layout.nodes_of((i, spectra), batch, nodes))
        })?;
        for (slab, (_, nodes)) in some.zip(&rooms) {
            let nodes = nodes.chunks_exact(slabs[slab].len() * width);
            let volumes = volume.chunks_exact_mut(sweep.len() * width);
            for ((transmission, nodes), volume) in transmissions.iter().zip(nodes).zip(volumes) {
                transmission.slabs[slab].add_to(&transmission.sweep, nodes, width, volume);
            }
        }
    }
    layout.lattice.spreading(&instrument.array).onto_microphones(volume)
}
