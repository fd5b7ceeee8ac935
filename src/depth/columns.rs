//! The power along a pixel's ray, depth by depth.

use super::power::Power;
use crate::error::Result;
use crate::grid::{Axis, Raster, View, pixel_values};
use glam::DVec3;
use rayon::prelude::*;

/// Pixels that are searched together.
const TOGETHER: usize = 32;

/// Power, read along the rays of pixels.
///
/// A ray meets each of the volume's depths once, so depth stays planar and only x and y are interpolated. The
/// (bilinear) interpolation is one of *power*: the complex amplitude rotates by many cycles from voxel to voxel, so its
/// interpolation would cancel unless it were first demodulated with the array's path lengths, which a volume file need
/// not contain. Surfaces are located and smoothed by the power of their speckle in any case. Beyond the outermost voxel
/// centres the power is 0.
#[derive(Debug, Clone, Copy)]
pub(super) struct RayColumns<'a> {
    power: &'a Power,
    raster: &'a Raster,
}

impl<'a> RayColumns<'a> {
    pub(super) fn new(power: &'a Power, raster: &'a Raster) -> Self {
        Self { power, raster }
    }

    /// Gives every pixel's column, one power per depth, to `take`, with what is to be found of it.
    pub(super) fn each<T: Send>(&self, found: &mut [T], take: impl Fn(usize, &[f32], &mut T) + Sync) {
        let straight = self.raster.view == View::Orthographic;
        found.par_chunks_mut(TOGETHER).enumerate().for_each_init(Vec::new, |column, (chunk, found)| {
            for (i, found) in found.iter_mut().enumerate() {
                let pixel = chunk * TOGETHER + i;
                if straight {
                    take(pixel, self.power.column(pixel), found);
                } else {
                    column.resize(self.power.grid.z.count, 0.0);
                    self.read(pixel, column);
                    take(pixel, column, found);
                }
            }
        });
    }

    /// Gives the column of one pixel to `take`.
    pub(super) fn of<T>(&self, pixel: usize, take: impl FnOnce(&[f32]) -> T) -> T {
        if self.raster.view == View::Orthographic {
            return take(self.power.column(pixel));
        }
        let mut column = vec![0.0; self.power.grid.z.count];
        self.read(pixel, &mut column);
        take(&column)
    }

    /// Fills `column` with the powers along the ray of a pixel.
    fn read(&self, pixel: usize, column: &mut [f32]) {
        let grid = &self.power.grid;
        let ray = self.raster.ray(pixel);
        let origin = self.raster.point(pixel, 0.0);
        for ((iz, value), z) in column.iter_mut().enumerate().zip(grid.z.positions()) {
            *value = self.power.at(origin + ray * z, iz).unwrap_or(0.0);
        }
    }

    /// The maximum of every pixel's column, and the index of its depth.
    ///
    /// # Errors
    /// When they do not fit in memory.
    pub(super) fn maxima(&self) -> Result<Vec<(f32, usize)>> {
        let mut maxima = pixel_values((0.0f32, 0), self.raster.len())?;
        self.each(&mut maxima, |_, column, maximum| {
            for (index, power) in column.iter().enumerate() {
                if *power > maximum.0 {
                    *maximum = (*power, index);
                }
            }
        });
        Ok(maxima)
    }
}

impl Power {
    /// The power at a point's x and y, at depth `iz`, between voxels; `None` outside the grid.
    fn at(&self, p: DVec3, iz: usize) -> Option<f32> {
        let (x, y) = (place(&self.grid.x, p.x)?, place(&self.grid.y, p.y)?);
        let row = |iy: usize| {
            let at = |ix: usize| self.column(iy * self.grid.x.count + ix)[iz];
            at(x.0) + (at(x.1) - at(x.0)) * x.2
        };
        Some((row(y.0) + (row(y.1) - row(y.0)) * y.2).max(0.0))
    }
}

/// The voxels on both sides of a position, and the share of the second; `None` beyond the ends.
fn place(axis: &Axis, position: f64) -> Option<(usize, usize, f32)> {
    let place = (position - axis.first) / axis.pitch;
    let last = (axis.count - 1) as f64;
    // A ray along the edge of the grid is inside it in spite of rounding.
    if !(-1e-6..=last + 1e-6).contains(&place) {
        return None;
    }
    let place = place.clamp(0.0, last);
    let below = place.floor() as usize;
    Some((below, (below + 1).min(axis.count - 1), place.fract() as f32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;

    #[test]
    fn power_is_interpolated_where_the_ray_passes() {
        let axis = |first, count| Axis { first, pitch: 0.1, count };
        let grid = Grid { x: axis(-0.2, 5), y: axis(-0.1, 3), z: axis(1.0, 2) };
        // Power 1, 2, .. along x at the first depth, and four times that at the second.
        let values = (0..30).map(|i| ((i / 2 % 5 + 1) * [1, 4][i % 2]) as f32).collect();
        let power = Power { grid, values };
        let slopes = |first, count| Axis { first, pitch: 0.15, count };
        let raster = Raster { view: View::Perspective, x: slopes(-0.15, 3), y: slopes(0.03, 1) };
        let mut column = [0.0; 2];
        for (pixel, slope) in [(0, -0.15), (1, 0.0), (2, 0.15)] {
            let expected = [1.0, 1.1].map(|z| (slope * z + 0.2) / 0.1 + 1.0);
            RayColumns::new(&power, &raster).read(pixel, &mut column);
            assert!((f64::from(column[0]) - expected[0]).abs() < 1e-5, "{column:?}");
            assert!((f64::from(column[1]) - 4.0 * expected[1]).abs() < 1e-5, "{column:?}");
        }
        let aside = Raster { y: slopes(0.095, 1), ..raster };
        RayColumns::new(&power, &aside).read(1, &mut column);
        assert!(
            column[0] > 0.0 && column[1] == 0.0,
            "the ray leaves the grid between the depths: {column:?}"
        );
    }
}
