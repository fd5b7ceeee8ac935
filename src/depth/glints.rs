//! Pictures of mirrors: told from those of diffuse surfaces by their phase, and narrowed to the glints that they show.
//!
//! Reflectors of a diffuse surface answer with phases of their own, so that its image is speckle, whose phase is new in every
//! resolution cell. A mirror's keeps its phase across many cells; and where only its edges and corners send sound back, their
//! sidelobes, which lie elsewhere for every tone, outshine the rest. A weak place in speckle may be chance, for which
//! acceptance makes allowance. There is no chance in a glint: what is weak beside it is the width of its image.

use super::DepthOptions;
use super::leak::explained;
use super::power::Power;
use super::surfaces::Surface;
use crate::error::Result;
use crate::grid::{Raster, VolumeView, pixel_values};
use crate::wave::Aperture;
use num_complex::Complex64;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Evenness below which edges and corners of mirrors are shown, which have 0.36 at the most; of diffuse surfaces it is 0.5 to
/// 0.8, of a coarse scan, whose grating lobes are as strong as they are, 0.46.
const EVEN: f64 = 0.42;

/// Distance between phases that are compared, in lateral resolutions: speckle is new by then.
const LAG: f64 = 1.5;

/// Mean cosine of the phases' second differences above which they are a mirror's, and how many of its standard errors are
/// added for chance. Of speckle it is 0 to 0.1, of mirrors 0.4 to 0.9.
const COHERENT: f64 = 0.25;
const STANDARD_ERRORS: f64 = 1.2;

/// How far from the straight line between its neighbours a surface may be that is compared with them, in Δd.
const STRAIGHT: f64 = 2.0;

/// How much surer than speckle a glint has to be, dB.
const SURER_DB: f64 = 1.6;

/// How far from a stronger place the image of it is told from a surface, in lateral resolutions.
const APART: f64 = 0.6;

/// Whether the surfaces that were found are a mirror's, given the array's aperture and how evenly they fill the band.
///
/// # Errors
/// When a phase for every pixel does not fit in memory.
pub(super) fn are_shown(
    surfaces: &[Vec<Surface>],
    (aperture, evenness): (&Aperture, f64),
    volume: VolumeView<'_>,
    raster: &Raster,
    options: &DepthOptions,
) -> Result<bool> {
    let resolved = options.resolution.lateral(volume.grid.z.first);
    let counts = [volume.grid.x.count, volume.grid.y.count];
    if resolved.iter().zip(counts).any(|(cell, count)| cell.is_none() && count > 1) {
        return Ok(false); // what an array does not resolve is alike, mirror or not
    }
    if evenness < EVEN {
        return Ok(true);
    }
    let Some((coherence, cells)) = coherence(surfaces, aperture, volume, raster, options)? else {
        return Ok(false);
    };
    // The cosine of a random angle varies by 1/2.
    Ok(coherence > COHERENT + STANDARD_ERRORS * (0.5 / cells).sqrt())
}

/// Mean cosine of the second differences of the phase on surfaces, along x and y, and how many resolution cells it is from;
/// `None` where there is no difference.
///
/// A phase that changes evenly from place to place is a mirror's as well, since a depth may be a little off.
fn coherence(
    surfaces: &[Vec<Surface>],
    aperture: &Aperture,
    volume: VolumeView<'_>,
    raster: &Raster,
    options: &DepthOptions,
) -> Result<Option<(f64, f64)>> {
    let grid = volume.grid;
    let turn = TAU * aperture.centre_frequency() / aperture.sound_speed;
    // The phasor of a pixel's strongest surface, at its depth, and that depth.
    let phasor = |pixel: usize| {
        let patch = strongest(&surfaces[pixel])?.patch;
        let here = raster.point(pixel, patch.depth);
        let (ix, iy) = (grid.x.index_of(here.x)?, grid.y.index_of(here.y)?);
        let aside = [grid.x.position(ix) - here.x, grid.y.position(iy) - here.y];
        // Where the plane meets the column of voxels nearby.
        let depth = patch.depth + patch.slope[0] * aside[0] + patch.slope[1] * aside[1];
        let iz = grid.z.index_of(depth)?;
        let sample = volume.samples[(iz * grid.y.count + iy) * grid.x.count + ix];
        let sample = Complex64::new(f64::from(sample.re), f64::from(sample.im));
        let angle = turn * aperture.path_gradient(here) * (depth - grid.z.position(iz));
        (sample.norm() > 0.0).then(|| (sample / sample.norm() * Complex64::cis(-angle), patch.depth))
    };
    let mut phasors = pixel_values(None, raster.len())?;
    phasors.par_iter_mut().enumerate().for_each(|(pixel, value)| *value = phasor(pixel));
    let (mut sum, mut count, mut cells) = (0.0, 0usize, 0.0);
    for (pixel, middle) in phasors.iter().enumerate() {
        let Some((phase, depth)) = middle else { continue };
        let resolution = options.lateral_resolution(*depth, &grid);
        let metres = raster.view.metres_per_unit(*depth);
        let pitch = [raster.x.pitch * metres, raster.y.pitch * metres];
        let cell = [0, 1].map(|k: usize| (pitch[k] / resolution[k]).min(1.0));
        let place = [pixel % raster.x.count, pixel / raster.x.count];
        for (axis, (length, stride)) in
            [(raster.x.count, 1), (raster.y.count, raster.x.count)].into_iter().enumerate()
        {
            let lag = ((LAG * resolution[axis] / pitch[axis]).round() as usize).max(1);
            if place[axis] < lag || length - place[axis] <= lag {
                continue;
            }
            let beside = [pixel - lag * stride, pixel + lag * stride].map(|other| phasors[other]);
            let [Some((before, nearer)), Some((after, farther))] = beside else { continue };
            if (nearer + farther - 2.0 * depth).abs() < STRAIGHT * options.resolution.range {
                sum += (before * after * (phase * phase).conj()).re;
                count += 1;
                cells += cell[0] * cell[1];
            }
        }
    }
    Ok((count > 0).then(|| (sum / count as f64, cells)))
}

/// Takes away all but the glints: surfaces that are not sure enough, and what a stronger place explains by its main lobe.
/// Whatever is before or behind a strongest surface that is none goes, too.
pub(super) fn keep(surfaces: &mut [Vec<Surface>], smooth: &Power, raster: &Raster, options: &DepthOptions) {
    surfaces.par_iter_mut().enumerate().for_each(|(pixel, found)| {
        let Some(Surface { power, confidence, .. }) = strongest(found).copied() else { return };
        let glint = |surface: &Surface| {
            let here = raster.point(pixel, surface.patch.depth);
            !explained(smooth, here, surface.power, APART, |lobe| lobe, options)
        };
        found.retain(glint);
        let sure = confidence >= options.confidence_db + SURER_DB;
        if !sure || found.iter().all(|surface| surface.power != power) {
            found.clear();
        }
    });
}

/// The surface of most power.
fn strongest(surfaces: &[Surface]) -> Option<&Surface> {
    surfaces.iter().max_by(|a, b| a.power.total_cmp(&b.power))
}
