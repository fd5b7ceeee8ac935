//! Surfaces among their neighbours: lone ones go, holes are filled.

use super::patch::TangentPlane;
use super::surfaces::Surface;
use super::{DepthOptions, stride};
use crate::error::Result;
use crate::grid::{Grid, Raster, pixel_values};
use glam::DVec2;
use rayon::prelude::*;

/// How far across a neighbour counts that fills a surface in, in lateral resolutions; the eight that adjoin always do.
const REACH: f64 = 2.5;

/// The same where a surface is only not to be alone: the image of a point is as wide.
const ALONE_REACH: f64 = 1.0;

/// The most neighbours to one side that are visited.
const MOST_REACH: usize = 12;

/// How far from a plane a surface may be that continues it, in lateral resolutions, as a slope blurs, or else Δd.
const SLOPES: f64 = 0.4;

/// Share of the neighbours that a surface must continue in.
const ENOUGH: f64 = 0.2;

/// The same of a surface that is filled in, and of one that is filled in beside another.
const ENOUGH_TO_FILL: [f64; 2] = [0.25, 0.3];

/// How far to one side the neighbours of a surface may be that is filled in: 0 all around, 1 in one direction. Outside a
/// straight rim they fill half a disc, for which it is 0.64, and no rim may grow.
const ASIDE: f64 = 0.6;

/// Least power of a surface that is filled in beside another, over that of the other.
const FAINTEST: f32 = 0.01;

/// Which pixels are around another.
#[derive(Clone, Copy)]
pub(super) enum Around {
    /// Within so many lateral resolutions, and the eight that adjoin.
    Adjoining(f64),
    /// Within so many lateral resolutions, and the four that share a side.
    Disc(f64),
}

/// The surfaces around a pixel.
pub(super) struct Neighbours<'a> {
    /// How many pixels are around.
    all: usize,
    /// Those that have surfaces.
    found: Vec<(usize, &'a [Surface])>,
    raster: &'a Raster,
    /// Lateral resolution, m.
    cell: [f64; 2],
    /// How far from a plane a surface may be that continues it, m.
    within: f64,
}

impl<'a> Neighbours<'a> {
    pub(super) fn of(
        pixel: usize,
        depth: f64,
        surfaces: &'a [Vec<Surface>],
        raster: &'a Raster,
        which: Around,
        (grid, options): (&Grid, &DepthOptions),
    ) -> Self {
        let cell = options.lateral_resolution(depth, grid);
        let metres = raster.view.metres_per_unit(depth);
        let pixels =
            [(raster.x, cell[0]), (raster.y, cell[1])].map(|(axis, cell)| cell / (axis.pitch * metres));
        let strides = pixels.map(stride);
        let (Around::Adjoining(resolutions) | Around::Disc(resolutions)) = which;
        let radius = [0, 1].map(|k: usize| (resolutions * pixels[k] / strides[k] as f64).max(1.0));
        let reach = radius.map(|radius| (radius as usize).min(MOST_REACH));
        let (n_x, n_y) = (raster.x.count, raster.y.count);
        let (x, y) = (pixel % n_x, pixel / n_x);
        let around = |at: usize, k: usize, count: usize| {
            let (steps, stride) = (reach[k].min(at / strides[k]), strides[k]);
            (at - steps * stride
                ..at.saturating_add(reach[k].saturating_mul(stride)).saturating_add(1).min(count))
                .step_by(stride)
        };
        let (mut all, mut found) = (0, Vec::new());
        for j in around(y, 1, n_y) {
            for i in around(x, 0, n_x) {
                let steps = [i.abs_diff(x) / strides[0], j.abs_diff(y) / strides[1]];
                let near = match which {
                    Around::Adjoining(_) => {
                        let part = |k: usize| (steps[k] as f64 / (reach[k] as f64 + 0.5)).powi(2);
                        steps[0].max(steps[1]) <= 1 || part(0) + part(1) <= 1.0
                    }
                    Around::Disc(_) => {
                        let part = |k: usize| (steps[k] as f64 / radius[k]).powi(2);
                        part(0) + part(1) <= 1.0
                    }
                };
                if near && steps != [0, 0] {
                    all += 1;
                    let there = &surfaces[j * n_x + i];
                    if !there.is_empty() {
                        found.push((j * n_x + i, there.as_slice()));
                    }
                }
            }
        }
        let within = options.resolution.range.max(SLOPES * cell[0].max(cell[1]));
        Self { all, found, raster, cell, within }
    }

    /// The neighbours that continue a plane at a pixel: which pixels, and which of their surfaces.
    pub(super) fn continuing(
        &self,
        pixel: usize,
        patch: &TangentPlane,
    ) -> impl Iterator<Item = (usize, usize)> {
        let here = self.raster.point(pixel, patch.depth);
        self.found.iter().filter_map(move |(other, found)| {
            let continues = |there: &Surface| {
                let offset = self.raster.point(*other, there.patch.depth) - here;
                (offset.z - patch.slope[0] * offset.x - patch.slope[1] * offset.y).abs() < self.within
            };
            found.iter().position(continues).map(|k| (*other, k))
        })
    }

    /// The share of neighbours that continue a plane at a pixel, and how far to one side they are, 0 to 1.
    pub(super) fn support(&self, pixel: usize, patch: &TangentPlane) -> (f64, f64) {
        let here = self.raster.point(pixel, patch.depth);
        let (mut count, mut sum) = (0usize, DVec2::ZERO);
        for (other, _) in self.continuing(pixel, patch) {
            count += 1;
            let aside = self.raster.point(other, patch.depth) - here;
            sum += DVec2::new(aside.x / self.cell[0], aside.y / self.cell[1]).normalize_or_zero();
        }
        if self.all == 0 {
            return (1.0, 0.0); // a single column has no neighbours that could contradict it
        }
        (count as f64 / self.all as f64, sum.length() / count.max(1) as f64)
    }

    /// Depths that enough neighbours have to fill a surface in, those of most neighbours first, m.
    fn depths(&self) -> Vec<f64> {
        let mut depths: Vec<f64> =
            self.found.iter().flat_map(|(_, found)| found.iter().map(|found| found.patch.depth)).collect();
        depths.sort_by(f64::total_cmp);
        let near = |z: f64| depths.iter().filter(|other| (*other - z).abs() < 1.5 * self.within).count();
        let mut counted: Vec<(usize, f64)> = depths.iter().map(|z| (near(*z), *z)).collect();
        counted.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.total_cmp(&b.1)));
        let mut common: Vec<f64> = Vec::new();
        for (count, z) in counted {
            let apart = common.iter().all(|other| (other - z).abs() >= 3.0 * self.within);
            if apart && count as f64 >= ENOUGH_TO_FILL[0] * self.all as f64 {
                common.push(z);
            }
        }
        common
    }
}

/// The surfaces that enough neighbours continue, and those that are missing among neighbours on all sides: a null of speckle
/// is a hole, a rim is not. `strongest` gives the depth of a pixel's maximum power, m; `fill` makes a surface near a depth.
///
/// # Errors
/// When the surfaces do not fit in memory.
pub(super) fn supported(
    surfaces: &[Vec<Surface>],
    strongest: impl Fn(usize) -> f64 + Sync,
    raster: &Raster,
    (grid, options): (&Grid, &DepthOptions),
    fill: impl Fn(usize, f64) -> Option<Surface> + Sync,
) -> Result<Vec<Vec<Surface>>> {
    let least = options.separation * options.resolution.range;
    let mut supported: Vec<Vec<Surface>> = pixel_values(Vec::new(), raster.len())?;
    supported.par_iter_mut().enumerate().for_each(|(pixel, kept)| {
        let own = &surfaces[pixel];
        let depth = own.first().map_or_else(|| strongest(pixel), |surface| surface.patch.depth);
        let around = |reach: f64| {
            Neighbours::of(pixel, depth, surfaces, raster, Around::Adjoining(reach), (grid, options))
        };
        let power = own.iter().map(|surface| surface.power).fold(0.0, f32::max);
        let near = around(ALONE_REACH);
        kept.extend(own.iter().filter(|surface| near.support(pixel, &surface.patch).0 >= ENOUGH));
        if !own.is_empty() && !kept.iter().any(|surface| surface.power == power) {
            kept.clear(); // whatever is behind or before a false surface is none either
            return;
        }
        let around = around(REACH);
        if (around.found.len() as f64) < ENOUGH_TO_FILL[0] * around.all as f64 {
            return;
        }
        let alone = Some(strongest(pixel)).filter(|_| kept.is_empty());
        for depth in alone.into_iter().chain(around.depths()) {
            let new = |depth: f64, kept: &[Surface]| {
                kept.len() < options.surfaces()
                    && kept.iter().all(|surface| (surface.patch.depth - depth).abs() >= least)
            };
            if !new(depth, kept) {
                continue;
            }
            let Some(filled) = fill(pixel, depth) else { continue };
            let (share, aside) = around.support(pixel, &filled.patch);
            let enough = ENOUGH_TO_FILL[usize::from(!kept.is_empty())];
            if share >= enough
                && aside <= ASIDE
                && filled.power >= FAINTEST * power
                && new(filled.patch.depth, kept)
            {
                kept.push(filled);
            }
        }
        kept.sort_by(|a, b| a.patch.depth.total_cmp(&b.patch.depth));
    });
    Ok(supported)
}
