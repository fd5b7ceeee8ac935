//! The values of a volume along a pixel's ray, depth by depth.

use crate::error::Result;
use crate::grid::{Axis, Grid, Raster, View, pixel_values};
use rayon::prelude::*;
use std::ops::Range;

/// Pixels whose columns are read together: a line of the cache for each depth.
const TOGETHER: usize = 32;

/// Values on a grid, `[z, y, x]`, read along the rays of pixels.
///
/// A ray meets each of the volume's depths once, so depth stays planar and only x and y are interpolated. The
/// (bilinear) interpolation is one of *power*: the complex amplitude rotates by many cycles from voxel to voxel, so its
/// interpolation would cancel unless it were first demodulated with the array's path lengths, which a volume file need
/// not contain. Surfaces are located and smoothed by the power of their speckle in any case. Beyond the outermost voxel
/// centres the value is 0.
#[derive(Debug, Clone, Copy)]
pub(super) struct RayColumns<'a> {
    values: &'a [f32],
    grid: &'a Grid,
    raster: &'a Raster,
    /// Whether the values are amplitudes, whose squares are powers.
    amplitude: bool,
}

impl<'a> RayColumns<'a> {
    pub(super) fn of_amplitude(values: &'a [f32], grid: &'a Grid, raster: &'a Raster) -> Self {
        Self { values, grid, raster, amplitude: true }
    }

    pub(super) fn of_power(values: &'a [f32], grid: &'a Grid, raster: &'a Raster) -> Self {
        Self { values, grid, raster, amplitude: false }
    }

    /// Gives every pixel's column, one value per depth, to `take`, with what is to be found of it.
    pub(super) fn each<T: Send>(&self, found: &mut [T], take: impl Fn(usize, &[f32], &mut T) + Sync) {
        let depths = self.grid.z.count;
        found.par_chunks_mut(TOGETHER).enumerate().for_each_init(Vec::new, |columns, (chunk, found)| {
            let first = chunk * TOGETHER;
            columns.resize(found.len() * depths, 0.0);
            self.read(first..first + found.len(), columns);
            for ((i, found), column) in found.iter_mut().enumerate().zip(columns.chunks_exact(depths)) {
                take(first + i, column, found);
            }
        });
    }

    /// Fills `columns` with the values along the rays of some pixels, `[pixel, depth]`.
    fn read(&self, pixels: Range<usize>, columns: &mut [f32]) {
        let depths = self.grid.z.count;
        if self.raster.view == View::Orthographic {
            for (depth, slice) in self.values.chunks_exact(self.grid.plane_len()).enumerate() {
                for (column, value) in columns.chunks_exact_mut(depths).zip(&slice[pixels.clone()]) {
                    column[depth] = *value;
                }
            }
            return;
        }
        for (pixel, column) in pixels.zip(columns.chunks_exact_mut(depths)) {
            self.read_ray(pixel, column);
        }
    }

    /// Fills `column` with the values along the ray of a pixel of a perspective view.
    fn read_ray(&self, pixel: usize, column: &mut [f32]) {
        let plane = self.grid.plane_len();
        let ray = self.raster.ray(pixel);
        for ((value, z), slice) in
            column.iter_mut().zip(self.grid.z.positions()).zip(self.values.chunks_exact(plane))
        {
            let (Some(x), Some(y)) = (place(&self.grid.x, ray.x * z), place(&self.grid.y, ray.y * z)) else {
                *value = 0.0;
                continue;
            };
            let power = |value: f32| if self.amplitude { value * value } else { value };
            let row = |iy: usize| {
                let at = |ix: usize| power(slice[iy * self.grid.x.count + ix]);
                at(x.0) + (at(x.1) - at(x.0)) * x.2
            };
            let power = row(y.0) + (row(y.1) - row(y.0)) * y.2;
            *value = if self.amplitude { power.max(0.0).sqrt() } else { power.max(0.0) };
        }
    }

    /// The maximum value of every pixel's column.
    ///
    /// # Errors
    /// When they do not fit in memory.
    pub(super) fn maxima(&self) -> Result<Vec<f32>> {
        let mut maxima = pixel_values(0.0f32, self.raster.len())?;
        if self.raster.view == View::Orthographic {
            const PIXELS: usize = 4096;
            maxima.par_chunks_mut(PIXELS).enumerate().for_each(|(chunk, maxima)| {
                for slice in self.values.chunks_exact(self.grid.plane_len()) {
                    for (maximum, value) in maxima.iter_mut().zip(&slice[chunk * PIXELS..]) {
                        *maximum = maximum.max(*value);
                    }
                }
            });
            return Ok(maxima);
        }
        self.each(&mut maxima, |_, column, maximum| *maximum = column.iter().copied().fold(0.0, f32::max));
        Ok(maxima)
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

    #[test]
    fn power_is_interpolated_where_the_ray_passes() {
        let axis = |first, count| Axis { first, pitch: 0.1, count };
        let grid = Grid { x: axis(-0.2, 5), y: axis(-0.1, 3), z: axis(1.0, 2) };
        // Power 1, 2, .. along x at the first depth, and four times that at the second.
        let power: Vec<f32> = (0..30).map(|i| ((i % 5 + 1) * if i < 15 { 1 } else { 4 }) as f32).collect();
        let amplitude: Vec<f32> = power.iter().map(|p| p.sqrt()).collect();
        let slopes = |first, count| Axis { first, pitch: 0.15, count };
        let raster = Raster { view: View::Perspective, x: slopes(-0.15, 3), y: slopes(0.03, 1) };
        let mut column = [0.0; 2];
        for (pixel, slope) in [(0, -0.15), (1, 0.0), (2, 0.15)] {
            let expected = [1.0, 1.1].map(|z| (slope * z + 0.2) / 0.1 + 1.0);
            RayColumns::of_power(&power, &grid, &raster).read_ray(pixel, &mut column);
            assert!((f64::from(column[0]) - expected[0]).abs() < 1e-5, "{column:?}");
            assert!((f64::from(column[1]) - 4.0 * expected[1]).abs() < 1e-5, "{column:?}");
            RayColumns::of_amplitude(&amplitude, &grid, &raster).read_ray(pixel, &mut column);
            assert!((f64::from(column[1]) - (4.0 * expected[1]).sqrt()).abs() < 1e-5, "{column:?}");
        }
        let aside = Raster { y: slopes(0.095, 1), ..raster };
        RayColumns::of_power(&power, &grid, &aside).read_ray(1, &mut column);
        assert!(
            column[0] > 0.0 && column[1] == 0.0,
            "the ray leaves the grid between the depths: {column:?}"
        );
    }
}
