//! Rims of surfaces: what an image shows beyond them is the width of the array's point spread.
//!
//! The image of a surface that ends has half of its mean power at the end, and less beyond, but more than the level above which
//! returns are accepted. There a surface is taken away while it is weaker than that; nowhere else, since speckle is as weak.

use super::DepthOptions;
use super::support::{Around, Neighbours};
use super::surfaces::Surface;
use crate::error::Result;
use crate::grid::{Grid, Raster, pixel_values};
use rayon::prelude::*;

/// How far around a surface its neighbours tell whether it is at a rim, in lateral resolutions.
const NEAR: f64 = 0.7;

/// Less than this share of them continues a surface at a rim.
const AT_RIM: f64 = 0.7;

/// Of what is narrow all is at a rim: only what is continued less than so much of the most within [`RIDGE`] goes.
const BELOW_RIDGE: f64 = 0.9;
const RIDGE: f64 = 0.5;

/// Surfaces that are as far out, by their share to within this and so many resolutions, are averaged against speckle.
const ALIKE: f64 = 0.12;
const ALONG: f64 = 1.0;

/// Surfaces continued by at least this share are not at a rim; those within so many resolutions, enough for speckle to average
/// out, say how strong the surface is.
const INNER: f64 = 0.85;
const INNER_REACH: f64 = 8.0;

/// The fewest of them that can say so.
const FEWEST_INNER: usize = 3;

/// Takes away the surfaces that are beyond a rim.
///
/// # Errors
/// When a number for every surface does not fit in memory.
pub(super) fn trim(
    surfaces: &mut [Vec<Surface>],
    raster: &Raster,
    (grid, options): (&Grid, &DepthOptions),
) -> Result<()> {
    let left = 10_f64.powf(options.rim_db / 10.0);
    let mut continued: Vec<Vec<f32>> = pixel_values(Vec::new(), raster.len())?;
    let found: &[Vec<Surface>] = surfaces;
    let around = |pixel: usize, surface: &Surface, resolutions: f64| {
        let which = Around::Disc(resolutions);
        Neighbours::of(pixel, surface.patch.depth, found, raster, which, (grid, options))
    };
    continued.par_iter_mut().enumerate().for_each(|(pixel, shares)| {
        let share = |surface: &Surface| around(pixel, surface, NEAR).support(pixel, &surface.patch).0 as f32;
        shares.extend(found[pixel].iter().map(share));
    });
    let beyond = |pixel: usize, k: usize| {
        let (surface, share) = (&found[pixel][k], f64::from(continued[pixel][k]));
        if share >= AT_RIM {
            return false;
        }
        // Shares and powers of the surface as it continues so far around.
        let others = |resolutions: f64| {
            let others: Vec<_> =
                around(pixel, surface, resolutions).continuing(pixel, &surface.patch).collect();
            others
                .into_iter()
                .map(|(other, k)| (f64::from(continued[other][k]), f64::from(found[other][k].power)))
        };
        if share >= BELOW_RIDGE * others(RIDGE).map(|(share, _)| share).fold(share, f64::max) {
            return false;
        }
        let inner: Vec<f64> =
            others(INNER_REACH).filter(|(share, _)| *share >= INNER).map(|(_, power)| power).collect();
        let alike = others(ALONG).filter(|(other, _)| (other - share).abs() < ALIKE).map(|(_, power)| power);
        let alike: Vec<f64> = alike.chain([f64::from(surface.power)]).collect();
        inner.len() >= FEWEST_INNER && mean(&alike) < left * mean(&inner)
    };
    let mut gone: Vec<Vec<bool>> = pixel_values(Vec::new(), raster.len())?;
    gone.par_iter_mut()
        .enumerate()
        .for_each(|(pixel, gone)| gone.extend((0..found[pixel].len()).map(|k| beyond(pixel, k))));
    surfaces.par_iter_mut().zip(gone).for_each(|(surfaces, gone)| {
        let mut gone = gone.into_iter();
        surfaces.retain(|_| !gone.next().unwrap_or(false));
    });
    Ok(())
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}
