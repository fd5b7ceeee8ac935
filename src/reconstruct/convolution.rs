//! Eq. 16: on a shared lattice the sum over microphones is a convolution, done by padded 2-D FFTs.
//!
//! `p − r` depends on the difference of indices alone, so one kernel `e^{−i2πf|p−r|/c}` per frequency and depth serves
//! every pair of voxel and microphone ([`SharedLattice`] says when). With a tolerance, the sweep is first compressed to
//! skeleton frequencies for the volume, and again for each slab of depths, so that Eq. 16 runs over tens of tones
//! instead of all; with tolerance 0 it runs over every one.

use super::Weights;
use super::focus::Focus;
use super::lattice::SharedLattice;
use super::layout::Layout;
use super::tones::{SlabTones, Tones, VolumeTones};
use crate::acquisition::DataCube;
use crate::error::Result;
use crate::grid::{Grid, Volume};
use crate::progress::{Observer, advance, stage};
use crate::wave::interval::PathInterval;
use num_complex::Complex32;
use rayon::prelude::*;

/// Bytes of data spectra held at a time when every frequency is summed.
const SPECTRA_BYTES: usize = 256 << 20;

/// The share of the tolerance that the first of the two compressions may use.
const FIRST_SHARE: f64 = 0.3;

/// Adds tones to the planes from `first` on, `[plane, y, x]`.
fn add(
    layout: &Layout,
    tones: &Tones,
    first: usize,
    planes: &mut [Complex32],
    observer: &dyn Observer,
) -> Result<()> {
    let spectra = layout.spectra(&tones.samples);
    planes.par_chunks_mut(layout.grid.plane_len()).enumerate().try_for_each_init(
        || Focus::new(layout),
        |focus, (iz, voxels)| {
            focus.add(first + iz, &tones.per_metre, &spectra, voxels);
            advance(observer, tones.per_metre.len() as u64)
        },
    )
}

/// Fills `volume` by Eq. 16 and gives the error bound, relative to `Σ|w m| / Σw`.
///
/// Cost: per tone and depth, for each pair of sub-lattices one kernel of `n_x·n_y` phasors and its FFT, and one inverse
/// FFT per voxel sub-lattice (monostatic: one per depth). With a tolerance a sweep is some `B·T + 10` tones, T the
/// spread of delays within a slab.
pub(super) fn convolution(
    cube: &DataCube,
    weights: &Weights,
    lattice: &SharedLattice,
    tolerance: f64,
    volume: &mut Volume,
    observer: &dyn Observer,
) -> Result<f64> {
    let layout = Layout::new(lattice, volume.grid, cube.geometry);
    let left = tolerance - lattice.error();
    if left <= 0.0 {
        every_frequency(cube, weights, &layout, volume, observer).map(|()| lattice.error())
    } else {
        skeleton_frequencies(cube, weights, &layout, left, volume, observer)
            .map(|error| error + lattice.error())
    }
}

/// All frequencies in ascending order, in blocks that bound the memory and change no sum.
fn every_frequency(
    cube: &DataCube,
    weights: &Weights,
    layout: &Layout,
    volume: &mut Volume,
    observer: &dyn Observer,
) -> Result<()> {
    let count = cube.sweep.len();
    let block = (SPECTRA_BYTES / (layout.tone_len() * size_of::<Complex32>())).clamp(1, count);
    stage(observer, "reconstructing", (count * volume.grid.z.count) as u64, || {
        for first in (0..count).step_by(block) {
            let frequencies = first..(first + block).min(count);
            let samples = frequencies.clone().flat_map(|f| weights.weighted(cube, f)).collect();
            let per_metre =
                cube.sweep.frequencies()[frequencies].iter().map(|f| -f / cube.sound_speed).collect();
            let tones = Tones { per_metre, samples: layout.lattice.onto_nodes(samples) };
            add(layout, &tones, 0, &mut volume.samples, observer)?;
        }
        Ok(())
    })
}

/// Skeleton tones, slab by slab; gives the greatest error of any slab.
fn skeleton_frequencies(
    cube: &DataCube,
    weights: &Weights,
    layout: &Layout,
    tolerance: f64,
    volume: &mut Volume,
    observer: &dyn Observer,
) -> Result<f64> {
    let depths = volume.grid.z.count;
    let mut compressed = stage(observer, "compressing the sweep", 0, || {
        let interval = interval(cube, &volume.grid, 0..depths);
        Ok(VolumeTones::compress(cube, weights, interval, FIRST_SHARE * tolerance))
    })?;
    compressed.tones.samples = layout.lattice.onto_nodes(std::mem::take(&mut compressed.tones.samples));
    let thickness = slab_thickness(cube, layout);
    let starts: Vec<usize> = (0..depths).step_by(thickness).collect();
    let frequencies = cube.sweep.frequencies();
    let slabs: Vec<SlabTones> = starts
        .par_iter()
        .map(|&first| {
            let interval = interval(cube, &volume.grid, first..(first + thickness).min(depths));
            compressed.nest(frequencies, interval, tolerance)
        })
        .collect();
    let total = slabs
        .iter()
        .zip(&starts)
        .map(|(slab, first)| (slab.len() * thickness.min(depths - first)) as u64)
        .sum();
    stage(observer, "reconstructing", total, || {
        volume
            .samples
            .par_chunks_mut(thickness * volume.grid.plane_len())
            .zip(starts.par_iter().zip(&slabs))
            .try_for_each(|(planes, (&first, slab))| {
                let tones = slab.of(&compressed.tones, layout.lattice.width());
                add(layout, &tones, first, planes, observer)
            })
    })?;
    Ok(slabs.iter().map(|slab| slab.error).fold(0.0, f64::max))
}

/// The path lengths of a range of depths.
fn interval(cube: &DataCube, grid: &Grid, depths: std::ops::Range<usize>) -> PathInterval {
    let corners = grid.corners();
    let low = corners[0].with_z(grid.z.position(depths.start));
    let high = corners[7].with_z(grid.z.position(depths.end - 1));
    let [shortest, longest] = cube.geometry.path_bounds([low, high], cube.array.bounds().into());
    PathInterval { shortest, longest, sound_speed: cube.sound_speed }
}

/// The number of depths per slab that costs least by a fixed model, so that the same job always takes the same path.
///
/// Thin slabs need fewer tones each, but every slab pays for its own spectra and decomposition.
fn slab_thickness(cube: &DataCube, layout: &Layout) -> usize {
    let depths = layout.grid.z.count;
    let points = (layout.x.len() * layout.y.len()) as f64;
    // In transformed points per tone: a decomposition is checked at every frequency, its product runs over all nodes.
    let slab = (150 * cube.sweep.len() + 10 * layout.lattice.width()) as f64;
    let cost = |thickness: usize| -> f64 {
        (0..depths)
            .step_by(thickness)
            .map(|first| {
                let planes = thickness.min(depths - first);
                let interval = interval(cube, &layout.grid, first..first + planes);
                let tones =
                    (cube.sweep.bandwidth() * interval.duration() + 10.0).min(cube.sweep.len() as f64);
                let transforms = planes * layout.pairs() * 2 + layout.node_parts.len();
                tones * (transforms as f64 * points + slab)
            })
            .sum()
    };
    let candidates = [1, 2, 4, 8, 16, 32, 64];
    candidates
        .into_iter()
        .filter(|&thickness| thickness == 1 || thickness <= depths)
        .min_by(|&a, &b| cost(a).total_cmp(&cost(b)))
        .unwrap_or(1)
}
