//! Finds the depth map of a volume: where along each column the sound came from.
//!
//! A column by itself is speckle: its strongest voxel is somewhere near the surface. So peaks that stand out only tell
//! where to begin; a plane is then fitted to the power around each (module `patch`), which is depth and normal, and a
//! surface is what its neighbours continue (module `support`), up to its rim (module `rims`). Grating lobes are told from
//! surfaces by parts of the band (module `gate`). The literal way, one column at a time, remains for comparison (module
//! `column_pick`). This module has no access to the scene, so it cannot know the true depths.
//!
//! # Example
//! A column that peaks between two voxels; its power tells the depth:
//! ```
//! use holosonar::depth::{DepthOptions, Refine, locate_depth};
//! use holosonar::grid::{Axis, Grid, Volume};
//! use holosonar::num_complex::Complex32;
//!
//! let one = Axis { first: 0.0, pitch: 0.01, count: 1 };
//! let grid = Grid { x: one, y: one, z: Axis { first: 1.0, pitch: 0.01, count: 41 } };
//! let echo = |z: f64| Complex32::from((-0.5 * ((z - 1.204) / 0.01).powi(2)).exp() as f32);
//! let volume = Volume::new(grid, grid.z.positions().map(echo).collect());
//! let map = locate_depth(&volume, &DepthOptions::new(0.017))?;
//! assert!((map.picked.depth[0] - 1.204).abs() < 5e-4);
//!
//! // By the column alone; a single pixel has no neighbours for a median.
//! let literal = DepthOptions::new(0.017).with_refine(Refine::Column).with_median(1_usize);
//! assert!((locate_depth(&volume, &literal)?.picked.depth[0] - 1.204).abs() < 5e-4);
//! # Ok::<(), holosonar::error::Error>(())
//! ```

mod column_pick;
mod columns;
mod gate;
mod glints;
mod leak;
mod levels;
mod patch;
mod peaks;
mod power;
mod rims;
mod support;
mod surfaces;

use crate::choice::choice;
use crate::error::{Error, Result};
use crate::grid::{Axis, DepthMap, Grid, Raster, VolumeView};
use crate::progress::{Observer, Silent, stage};
use crate::wave::Resolution;
use crate::with_fields::with_fields;
use power::Power;
use serde::{Deserialize, Serialize};

choice! {
    /// Which peak of a column is its depth.
    #[derive(Default)]
    pub enum Pick: "pick" {
        /// The peak of maximum amplitude.
        #[default]
        Strongest = "strongest",
        /// The first peak above the threshold, front to back.
        First = "first",
    }
}

choice! {
    /// How a pixel's depth follows from the power around its strongest voxel.
    #[derive(Default)]
    pub enum Refine: "refine" {
        /// A plane fitted to the power of the neighbouring columns too: speckle averages out, and the plane's slope is
        /// the normal.
        #[default]
        Surface = "surface",
        /// Of its own column alone: the centroid of the power within ±2 range cells, then a median filter.
        Column = "column",
        /// The vertex of a parabola through the peak and its neighbours, then a median filter.
        Parabola = "parabola",
        /// The voxel's own depth, then a median filter.
        None = "none",
    }
}

/// The sidelobes of an array, as far as depth has to tell them from surfaces; by default those of a full lattice.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ArraySidelobes {
    /// The strongest within three lateral resolutions, dB.
    pub near_db: f64,
    /// Their mean power everywhere, dB: −10 log₁₀ N of N microphones with equal weights.
    pub mean_db: f64,
}

impl Default for ArraySidelobes {
    /// A rectangular lattice of 961 microphones without a window.
    fn default() -> Self {
        Self { near_db: -17.1, mean_db: -29.8 }
    }
}

/// Least confidence of a surface in an image of Eq. 13 and in a refined one, whose sidelobes are weaker, dB.
const CONFIDENCE_DB: [f64; 2] = [-5.6, -7.0];

/// Power of a surface at its rim below which it is taken away, against that further in, dB: of an image of Eq. 13, in which half of
/// the mean is left there, less what speckle may take; and of a refined one, which falls off more steeply.
const RIM_DB: [f64; 2] = [-5.8, -7.0];

/// By how much the least confidence is raised where few microphones leave strong sidelobes, per dB of these; and at the most, dB.
const RAISED: f64 = 1.3;
const MOST_RAISED_DB: f64 = 7.6;

/// Parameters of [`locate_depth`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct DepthOptions {
    /// Δd = c/2B and, where the aperture is known, the lateral resolution; without it that is taken to be two voxels, and
    /// nothing is known of grating lobes.
    pub resolution: Resolution,
    /// Which peak.
    pub pick: Pick,
    /// From peak to depth.
    pub refine: Refine,
    /// Minimum amplitude of the picked return, dB against the 99th percentile of the columns' maxima; `None` for −14 dB of
    /// columns, and for surfaces that of all returns, since confidence decides.
    pub threshold_db: Option<f64>,
    /// Minimum amplitude of any return; 0 for none. What is far weaker than the samples add up to by chance is the sidelobes
    /// of what is outside the grid: [`ReconstructionInfo`](crate::reconstruct::ReconstructionInfo)`::incoherent_level`.
    pub floor: f64,
    /// Amplitude of the strongest echo outside the grid, 0 where it is not known: where it is far above what the volume shows,
    /// surfaces are compared with it, since they may be its sidelobes;
    /// [`ReconstructionInfo`](crate::reconstruct::ReconstructionInfo)`::outside_level`.
    pub outside: f64,
    /// Minimum confidence of a surface, dB; see [`locate_depth`].
    pub confidence_db: f64,
    /// Where a surface ends its power is so much below that further in, dB: what is weaker at its rim is the width of the
    /// point spread; −∞ lets it stand.
    pub rim_db: f64,
    /// Whether what is in one part of the band only, as grating lobes are, is taken for weaker, and mirrors are told by their
    /// phase; not in a volume without phases.
    pub gate: bool,
    /// Maximum number of surfaces per pixel; below 2 only the picked one.
    pub returns: usize,
    /// Minimum smoothed power of a return, dB against the 99th percentile of the columns' maxima.
    pub return_threshold_db: f64,
    /// Minimum smoothed power of a further return, dB against its own column's maximum.
    pub return_gate_db: f64,
    /// How far a further return must stand out, dB: above the median of the power around it, and above the valley
    /// between it and every stronger return; 0 requires nothing.
    pub return_contrast_db: f64,
    /// Minimum distance between returns, in Δd.
    pub separation: f64,
    /// Gaussian σ of the power in which returns are found: along x and y in lateral resolutions, along z in Δd.
    pub smoothing: [f64; 3],
    /// Sidelobes that a weaker peak beside a stronger one may be.
    pub sidelobes: ArraySidelobes,
    /// Side of the median filter of columns, pixels, odd; 1 for none.
    pub median: usize,
    /// The pixels; `None` for the grid's own columns.
    pub raster: Option<Raster>,
}

with_fields! {
    DepthOptions {
        with_resolution(resolution: Resolution),
        with_pick(pick: Pick),
        with_refine(refine: Refine),
        with_threshold_db(threshold_db: Option<f64>),
        with_floor(floor: f64),
        with_outside(outside: f64),
        with_confidence_db(confidence_db: f64),
        with_rim_db(rim_db: f64),
        with_gate(gate: bool),
        with_returns(returns: usize),
        with_return_threshold_db(return_threshold_db: f64),
        with_return_gate_db(return_gate_db: f64),
        with_return_contrast_db(return_contrast_db: f64),
        with_separation(separation: f64),
        with_smoothing(smoothing: [f64; 3]),
        with_sidelobes(sidelobes: ArraySidelobes),
        with_median(median: usize),
        with_raster(raster: Option<Raster>),
    }
}

impl DepthOptions {
    /// The same for the sidelobes of an array, in an image of Eq. 13 or a `refined` one: many microphones leave weak sidelobes
    /// everywhere, few strong ones, above which a surface has to stand.
    #[must_use]
    pub fn adapted_to(self, sidelobes: ArraySidelobes, refined: bool) -> Self {
        let raised = sidelobes.mean_db - ArraySidelobes::default().mean_db;
        let image = usize::from(refined);
        let confidence_db = CONFIDENCE_DB[image] + (RAISED * raised).clamp(0.0, MOST_RAISED_DB);
        Self { confidence_db, rim_db: RIM_DB[image], sidelobes, ..self }
    }

    /// The default options for a [`Resolution`], or a range resolution alone in m.
    pub fn new(resolution: impl Into<Resolution>) -> Self {
        Self {
            resolution: resolution.into(),
            pick: Pick::Strongest,
            refine: Refine::Surface,
            threshold_db: None,
            floor: 0.0,
            outside: 0.0,
            confidence_db: CONFIDENCE_DB[0],
            rim_db: RIM_DB[0],
            gate: true,
            returns: 2,
            return_threshold_db: -24.0,
            return_gate_db: -16.0,
            return_contrast_db: 8.0,
            separation: 1.5,
            smoothing: [0.5; 3],
            sidelobes: ArraySidelobes::default(),
            median: 3,
            raster: None,
        }
    }

    /// The lateral resolution along x and y at depth `z`, m; along an axis of which nothing is known, two voxels.
    fn lateral_resolution(&self, z: f64, grid: &Grid) -> [f64; 2] {
        let [x, y] = self.resolution.lateral(z);
        [x.unwrap_or(2.0 * grid.x.pitch), y.unwrap_or(2.0 * grid.y.pitch)]
    }

    /// Number of surfaces that are searched for in a column, one behind another even where only one is wanted.
    fn surfaces(&self) -> usize {
        self.returns.max(2)
    }

    /// Bytes that [`locate_depth`] takes besides a volume: its power, that smoothed and a copy, or that of parts of the band.
    pub(crate) fn search_bytes(&self, grid: &Grid) -> u64 {
        let powers = |n: u64| grid.voxel_count().saturating_mul(n * size_of::<f32>() as u64);
        let pixels = self
            .raster
            .map_or((grid.x.count as u64).saturating_mul(grid.y.count as u64), |raster| raster.len() as u64);
        let surfaces = pixels.saturating_mul(surfaces::BYTES_PER_PIXEL);
        let search = match (self.refine, self.resolution.aperture.filter(|_| self.gate)) {
            (Refine::Surface, Some(_)) => {
                powers(1).saturating_add(powers(2).max(gate::bytes(grid, self.resolution.range)))
            }
            (Refine::Surface, None) => powers(3),
            _ => powers(if self.returns >= 2 { 2 } else { 1 }),
        };
        search.saturating_add(surfaces)
    }
}

/// Places along an axis within `reach` of a position, m, of which only so many are visited that `cell`, a resolution, has
/// some: the cost of a neighbourhood must not grow with voxels far finer than what they show.
fn visited(axis: &Axis, position: f64, reach: f64, cell: f64) -> impl Iterator<Item = usize> + Clone + use<> {
    let all = axis.within(position, reach);
    let stride = stride(cell / axis.pitch);
    let middle = ((position - axis.first) / axis.pitch).round().max(all.start as f64) as usize;
    (all.start + (middle - all.start) % stride..all.end).step_by(stride)
}

/// Of how many neighbours one is visited, where a resolution is so many wide.
fn stride(neighbours: f64) -> usize {
    const VISITED: f64 = 0.4;
    (VISITED * neighbours).max(1.0) as usize
}

/// Finds a depth, an amplitude and a confidence for every pixel, and its further returns; of surfaces also normals and the
/// standard errors of depth.
///
/// Confidence is the level of the peak against the 99th percentile of the columns' maxima plus half of its contrast to its
/// column's median beyond the noise, at most 20 dB of it. A picture of mirrors, which is told from speckle by its phase, is
/// narrowed to the glints that it shows.
///
/// - Shapes: the volume is `[z, y, x]`, the map `[y, x]`.
/// - Cost: a few passes over the volume, and some 2000 voxels per step of each fit; three volumes of f32 in memory.
///
/// # Errors
/// A range resolution that is not positive, an even median; [`Error::OutOfMemory`] when the passes do not fit in memory.
pub fn locate_depth<'v>(volume: impl Into<VolumeView<'v>>, options: &DepthOptions) -> Result<DepthMap> {
    locate_depth_with(volume, options, &Silent)
}

/// [`locate_depth`], reporting its progress to `observer`, which may stop it.
///
/// # Errors
/// As [`locate_depth`]; `Error::Interrupted` when the observer asks to stop.
pub fn locate_depth_with<'v>(
    volume: impl Into<VolumeView<'v>>,
    options: &DepthOptions,
    observer: &dyn Observer,
) -> Result<DepthMap> {
    locate_depth_beside(volume.into(), options, &mut || Ok(0.0), observer).map(|(map, _)| map)
}

/// What a picture looks like to whoever searches it for surfaces.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Looks {
    /// Whether an echo from outside the grid is so far above the volume that it counts.
    pub(crate) outshone: bool,
    /// Whether it shows glints of mirrors.
    pub(crate) mirrors: bool,
}

/// The same, finding the strongest echo outside the grid, where it is not known, by `outside`: only where the volume looks like its
/// sidelobes. Tells what it looks like, too.
///
/// # Errors
/// As [`locate_depth_with`]; those of `outside`.
pub(crate) fn locate_depth_beside(
    volume: VolumeView<'_>,
    options: &DepthOptions,
    outside: &mut (dyn FnMut() -> Result<f64> + Send),
    observer: &dyn Observer,
) -> Result<(DepthMap, Looks)> {
    let range = options.resolution.range;
    if !(range > 0.0 && range.is_finite()) {
        return Err(Error::input(
            "sweep",
            "depth needs a bandwidth: the range resolution c/2B must be a positive length",
        ));
    }
    if options.median.is_multiple_of(2) {
        return Err(Error::input("depth.median", format!("must be odd, not {}", options.median)));
    }
    let grid = volume.grid;
    let raster = options.raster.unwrap_or_else(|| Raster::of_grid(&grid));
    stage(observer, "locating depth", 0, || {
        let ((picked, confidence, returns), looks) = match options.refine {
            Refine::Surface => surfaces::locate(volume, &raster, options, outside)?,
            _ => (column_pick::locate(Power::of(volume)?, &raster, options)?, Looks::default()),
        };
        Ok((DepthMap { confidence, returns, ..DepthMap::new(raster, picked) }, looks))
    })
}

#[cfg(test)]
mod tests;
