//! The shapes of results: an [`Axis`], a [`Grid`] of voxels, a complex [`Volume`], a [`DepthMap`].
//!
//! The fastest axis is x everywhere: volumes are `[z, y, x]`, maps `[y, x]`. An image's column is x (right) and its
//! row is y (down), so no writer of images flips an axis.

mod view;
mod volume;

pub use view::{Raster, View};
pub use volume::{Volume, VolumeView};

use crate::alloc::try_filled;
use crate::error::{Error, Result};
use crate::wave::corners;
use glam::DVec3;
use num_complex::Complex32;
use serde::{Deserialize, Serialize};
use std::ops::Range;

/// Evenly spaced voxel centres along one axis, in m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// Centre of the first voxel, m.
    pub first: f64,
    /// Distance between neighbours, m; positive.
    pub pitch: f64,
    /// Number of voxels, at least 1.
    pub count: usize,
}

impl Axis {
    /// The axis from `first` to the last centre that does not exceed `last`: `⌊(last − first)/pitch + 10⁻⁶⌋ + 1`
    /// voxels.
    ///
    /// # Errors
    /// Numbers that are not finite, a pitch that is not positive or lost in the rounding of the ends, `last < first`,
    /// or more than 2³² voxels. The error's place is "axis"; [`Error::at`] puts a key there.
    ///
    /// ```
    /// let axis = holosonar::grid::Axis::spanning(-0.5, 0.5, 0.01)?;
    /// assert_eq!(axis.count, 101);
    /// # Ok::<(), holosonar::error::Error>(())
    /// ```
    pub fn spanning(first: f64, last: f64, pitch: f64) -> Result<Self> {
        if !(first.is_finite() && last.is_finite()) {
            return Err(refuse("the ends of an axis must be finite numbers of metres"));
        }
        if !(pitch.is_finite() && pitch > 0.0) {
            return Err(refuse(format!("the pitch must be a positive length, not {pitch} m")));
        }
        if last < first {
            return Err(refuse(format!(
                "the last voxel ({last} m) is before the first ({first} m); give [first, last]"
            )));
        }
        if pitch < first.abs().max(last.abs()) * 1e-9 {
            return Err(refuse(format!(
                "a pitch of {pitch} m is lost in the rounding of positions of {first} .. {last} m; lengths are in metres"
            )));
        }
        let intervals = ((last - first) / pitch + 1e-6).floor();
        if intervals >= f64::from(u32::MAX) {
            let problem = format!("{intervals:.3e} voxels along one axis are too many; use a larger pitch");
            return Err(refuse(problem));
        }
        Ok(Self { first, pitch, count: intervals as usize + 1 })
    }

    /// Centre of voxel `index`, m.
    pub fn position(&self, index: usize) -> f64 {
        self.first + self.pitch * index as f64
    }

    /// Centre of the last voxel, m.
    pub fn last(&self) -> f64 {
        self.position(self.count - 1)
    }

    /// Every centre in order, m.
    pub fn positions(&self) -> impl Iterator<Item = f64> + use<> {
        let axis = *self;
        (0..axis.count).map(move |i| axis.position(i))
    }

    /// The voxels whose centres are within `reach` of `position`, m.
    pub(crate) fn within(&self, position: f64, reach: f64) -> Range<usize> {
        let place = |position: f64| (position - self.first) / self.pitch;
        let first = place(position - reach).ceil().max(0.0);
        let end = (place(position + reach).floor() + 1.0).clamp(first, self.count.max(first as usize) as f64);
        first as usize..end as usize
    }

    /// The voxel whose cell contains `position`, if any.
    pub fn index_of(&self, position: f64) -> Option<usize> {
        let index = ((position - self.first) / self.pitch).round();
        (index >= 0.0 && index < self.count as f64).then_some(index as usize)
    }
}

/// The error for an axis.
fn refuse(problem: impl Into<String>) -> Error {
    Error::input("axis", problem)
}

/// A box of voxels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Grid {
    /// Columns, to the right.
    pub x: Axis,
    /// Rows, downwards.
    pub y: Axis,
    /// Depths, away from the array.
    pub z: Axis,
}

impl Grid {
    /// `[n_z, n_y, n_x]`.
    pub fn shape(&self) -> [usize; 3] {
        [self.z.count, self.y.count, self.x.count]
    }

    /// Number of voxels; saturates rather than overflow.
    pub fn voxel_count(&self) -> u64 {
        self.shape().iter().fold(1, |product: u64, &n| product.saturating_mul(n as u64))
    }

    /// Bytes of the voxels in memory, complex in single precision; saturates rather than overflow.
    pub fn volume_bytes(&self) -> u64 {
        self.voxel_count().saturating_mul(8)
    }

    /// Pixels of one depth.
    ///
    /// # Panics
    /// When the product overflows `usize`; a planned job never reaches that.
    pub fn plane_len(&self) -> usize {
        self.x.count.checked_mul(self.y.count).expect("the plan bounds the grid's size")
    }

    /// Centre of voxel (`ix`, `iy`, `iz`), m.
    pub fn position(&self, ix: usize, iy: usize, iz: usize) -> DVec3 {
        DVec3::new(self.x.position(ix), self.y.position(iy), self.z.position(iz))
    }

    /// The eight corners of the box of voxel centres, m.
    pub fn corners(&self) -> [DVec3; 8] {
        corners(self.bounds())
    }

    /// Places all over the box of voxel centres, so many along x, y and z but one where it is flat, its faces among
    /// them, m.
    pub(crate) fn sampled(&self, count: [usize; 3]) -> impl Iterator<Item = DVec3> + use<> {
        let axes = [self.x, self.y, self.z];
        let along = move |axis: usize, i: usize| {
            let part = i as f64 / (count[axis] - 1).max(1) as f64;
            axes[axis].first + (axes[axis].last() - axes[axis].first) * part
        };
        let [n_x, n_y, n_z] = std::array::from_fn(|axis| if axes[axis].count == 1 { 1 } else { count[axis] });
        (0..n_x * n_y * n_z)
            .map(move |i| DVec3::new(along(0, i % n_x), along(1, i / n_x % n_y), along(2, i / n_x / n_y)))
    }

    /// First and last voxel, m.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let of = |end: fn(&Axis) -> f64| DVec3::new(end(&self.x), end(&self.y), end(&self.z));
        (of(|axis| axis.first), of(Axis::last))
    }

    /// The same of a range of depths, which is not empty.
    pub(crate) fn box_of(&self, depths: Range<usize>) -> (DVec3, DVec3) {
        let (low, high) = self.bounds();
        (low.with_z(self.z.position(depths.start)), high.with_z(self.z.position(depths.end - 1)))
    }
}

/// The error for a grid that does not fit in memory, as a whole or in the depths that are processed at a time.
pub(crate) fn no_room_for(grid: &Grid) -> Error {
    Error::out_of_memory(format!(
        "a volume of {} voxels does not fit in memory; use a smaller grid or a larger pitch",
        grid.voxel_count()
    ))
}

/// Rejects planes, from depth `first` on, with a voxel whose power is not finite in single precision: no depth could be
/// located in them.
pub(crate) fn check_voxels(place: &str, grid: &Grid, first: usize, planes: &[Complex32]) -> Result<()> {
    let Some(bad) = planes.iter().position(|voxel| !voxel.norm_sqr().is_finite()) else { return Ok(()) };
    let (row, x) = (bad / grid.x.count, bad % grid.x.count);
    let (z, y) = (first + row / grid.y.count, row % grid.y.count);
    Err(Error::input(
        place,
        format!(
            "the voxel [{z}, {y}, {x}] is {}, beyond single precision, in which its power is computed; amplitudes of the \
             order of 1 are usual: divide the samples by their largest",
            planes[bad]
        ),
    ))
}

/// The same value for every pixel, or an error when the map does not fit in memory.
pub(crate) fn pixel_values<T: Clone>(value: T, pixels: usize) -> Result<Vec<T>> {
    try_filled(value, pixels as u64).ok_or_else(|| {
        Error::out_of_memory(format!(
            "a map of {pixels} pixels does not fit in memory; request fewer, or free some memory"
        ))
    })
}

/// One surface per pixel, `[y, x]`; a pixel without one has NaN in `depth` and 0 in `strength`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DepthLayer {
    /// Planar depth along +z, m.
    pub depth: Vec<f32>,
    /// Amplitude, linear, in the units of the volume.
    pub strength: Vec<f32>,
    /// Where it is known (ground truth): distance from the surface per error in depth. That is `|n · d|` of the unit
    /// normal and the pixel's ray with d_z = 1; in the orthographic view `|n_z|`.
    pub facing: Option<Vec<f32>>,
    /// Where it is known (ground truth): what the surface is made of, 1 for the first of [`DepthMap::materials`], 0
    /// where there is nothing.
    pub material: Option<Vec<u32>>,
    /// Confidence of a further return, dB, as [`DepthMap::confidence`]; NaN where there is nothing.
    pub confidence: Option<Vec<f32>>,
    /// Where it is known: standard error of the depth, m; NaN where there is nothing.
    pub error: Option<Vec<f32>>,
    /// Where it is known: unit normal that faces the array; NaN where there is nothing.
    pub normal: Option<Vec<[f32; 3]>>,
}

impl DepthLayer {
    /// A surface with nothing in it, for `pixels` pixels.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`] when it does not fit in memory.
    pub fn empty(pixels: usize) -> Result<Self> {
        let (depth, strength) = (pixel_values(f32::NAN, pixels)?, pixel_values(0.0, pixels)?);
        Ok(Self { depth, strength, ..Self::default() })
    }
}

/// Depth and amplitude per pixel: reconstructed, or the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthMap {
    /// The unit of the axes: metres, or slopes.
    pub view: View,
    /// Columns.
    pub x: Axis,
    /// Rows.
    pub y: Axis,
    /// The one return picked for each pixel.
    pub picked: DepthLayer,
    /// Confidence of the picked return, dB; NaN where nothing was accepted. Empty for truth.
    pub confidence: Vec<f32>,
    /// All accepted returns, front to back; entry k is the k-th of every pixel. May be empty.
    pub returns: Vec<DepthLayer>,
    /// Names of the materials, to which [`DepthLayer::material`] refers from 1; empty where none is known.
    pub materials: Vec<String>,
}

impl DepthMap {
    /// A map of these pixels with nothing but its picked surface.
    pub fn new(raster: Raster, picked: DepthLayer) -> Self {
        let Raster { view, x, y } = raster;
        let (confidence, returns, materials) = Default::default();
        Self { view, x, y, picked, confidence, returns, materials }
    }

    /// Rejects a map with a return at no finite depth or of no finite strength, which only a mistake of ours can cause.
    pub(crate) fn check(&self) -> Result<()> {
        let finite = |layer: &DepthLayer| {
            let mut returns = layer.depth.iter().zip(&layer.strength);
            returns.all(|(z, strength)| z.is_nan() || (z.is_finite() && strength.is_finite()))
        };
        if finite(&self.picked) && self.returns.iter().all(finite) {
            return Ok(());
        }
        let problem = "has a return that is not finite and is not written; please report this as a bug";
        Err(Error::input("depth map", problem))
    }

    /// `[n_y, n_x]`.
    pub fn shape(&self) -> [usize; 2] {
        [self.y.count, self.x.count]
    }

    /// Bytes that its values take.
    pub(crate) fn held_bytes(&self) -> u64 {
        let values = |layer: &DepthLayer| {
            let known = [
                layer.facing.is_some(),
                layer.material.is_some(),
                layer.confidence.is_some(),
                layer.error.is_some(),
            ];
            2 + known.into_iter().filter(|is| *is).count() + if layer.normal.is_some() { 3 } else { 0 }
        };
        let layers: usize = self.returns.iter().chain([&self.picked]).map(values).sum();
        (size_of::<f32>() * (layers * self.len() + self.confidence.len())) as u64
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.picked.depth.len()
    }

    /// Whether the map has no pixels at all.
    pub fn is_empty(&self) -> bool {
        self.picked.depth.is_empty()
    }

    /// Number of pixels with an accepted return.
    pub fn accepted(&self) -> usize {
        self.picked.depth.iter().filter(|z| !z.is_nan()).count()
    }

    /// Its pixels.
    pub fn raster(&self) -> Raster {
        Raster { view: self.view, x: self.x, y: self.y }
    }

    /// Position of the picked return of pixel `index`, m; NaN where there is none.
    pub fn point(&self, index: usize) -> DVec3 {
        self.raster().point(index, f64::from(self.picked.depth[index]))
    }

    /// Range `|p|` of the picked return at pixel `index` from the array's origin, m; NaN where there is none.
    pub fn range(&self, index: usize) -> f64 {
        self.point(index).length()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_ends_at_the_largest_centre_that_fits() {
        let axis = Axis::spanning(-0.5, 0.5, 0.008).expect("valid");
        assert_eq!(axis.count, 126);
        assert!(axis.last() <= 0.5 + 1e-9);
        assert_eq!(Axis::spanning(0.0, 0.3, 0.1).expect("valid").count, 4, "rounding does not lose one");
        assert_eq!(Axis::spanning(1.0, 1.0, 0.1).expect("valid").count, 1);
    }

    #[test]
    fn absurd_axes_are_refused() {
        for (first, last, pitch) in
            [(0.0, 1.0, 0.0), (1.0, 0.0, 0.1), (f64::NAN, 1.0, 0.1), (0.0, 1e30, 1e-9), (1e30, 1e30, 0.1)]
        {
            assert!(Axis::spanning(first, last, pitch).is_err(), "{first} {last} {pitch}");
        }
    }

    #[test]
    fn a_position_falls_into_its_own_cell() {
        let axis = Axis { first: -1.0, pitch: 0.25, count: 9 };
        for i in 0..9 {
            assert_eq!(axis.index_of(axis.position(i) + 0.1), Some(i));
        }
        assert_eq!(axis.index_of(1.2), None);
    }
}
