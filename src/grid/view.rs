//! The rays along which the pixels of a map look.

use super::{Axis, Grid};
use crate::choice::choice;
use crate::error::{Error, Result};
use glam::DVec3;

choice! {
    /// The unit of a map's axes, and so the ray along which a pixel looks. Depth is planar, along +z, in both views.
    #[derive(Default)]
    pub enum View: "view" {
        /// Along +z: the axes are the volume's own x and y, m.
        #[default]
        Orthographic = "orthographic",
        /// From the origin, as a camera there that looks along +z: the axes are the slopes x/z and y/z.
        Perspective = "perspective",
    }
}

impl View {
    /// The length of one unit of a map's axes at depth `z`, m.
    pub(crate) fn metres_per_unit(self, z: f64) -> f64 {
        match self {
            Self::Orthographic => 1.0,
            Self::Perspective => z,
        }
    }
}

/// The pixels of a map: a view, and the centres of columns and rows in it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Raster {
    /// The unit of the axes.
    pub view: View,
    /// Columns.
    pub x: Axis,
    /// Rows, downwards.
    pub y: Axis,
}

impl Raster {
    /// One pixel per column of voxels.
    pub fn of_grid(grid: &Grid) -> Self {
        Self { view: View::Orthographic, x: grid.x, y: grid.y }
    }

    /// The square pixels of a camera with a vertical field of view in degrees, as glTF's `yfov`; `[columns, rows]`.
    ///
    /// # Errors
    /// A field of view that is not between 0 and 180 degrees; no pixels, or more than 2³² in all.
    pub fn camera(vertical_field_of_view: f64, [columns, rows]: [usize; 2]) -> Result<Self> {
        if !(vertical_field_of_view > 0.0 && vertical_field_of_view < 180.0) {
            let angle = format!("a field of view of {vertical_field_of_view} degrees");
            return Err(Error::input("camera", angle + " is impossible; expected one between 0 and 180"));
        }
        let pixels = columns as u128 * rows as u128;
        if pixels == 0 || pixels > u128::from(u32::MAX) {
            let problem = format!("{columns} x {rows} pixels are not an image; expected fewer than 2^32");
            return Err(Error::input("camera", problem));
        }
        let pitch = 2.0 * (0.5 * vertical_field_of_view).to_radians().tan() / rows as f64;
        let axis = |count: usize| Axis { first: -0.5 * pitch * (count - 1) as f64, pitch, count };
        Ok(Self { view: View::Perspective, x: axis(columns), y: axis(rows) })
    }

    /// Number of pixels.
    pub fn len(&self) -> usize {
        self.x.count * self.y.count
    }

    /// Whether there are no pixels at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Where pixel `index` looks at depth `z`, m.
    pub fn point(&self, index: usize, z: f64) -> DVec3 {
        let (x, y) = (self.x.position(index % self.x.count), self.y.position(index / self.x.count));
        match self.view {
            View::Orthographic => DVec3::new(x, y, z),
            View::Perspective => DVec3::new(x * z, y * z, z),
        }
    }

    /// Displacement of pixel `index` per metre of depth: its ray, with z = 1.
    pub fn ray(&self, index: usize) -> DVec3 {
        self.point(index, 1.0) - self.point(index, 0.0)
    }

    /// Horizontal and vertical field of view to the outer edges of the pixels, degrees; `None` for parallel rays.
    pub fn field_of_view(&self) -> Option<[f64; 2]> {
        let angle = |axis: &Axis| {
            let (low, high) = (axis.first - 0.5 * axis.pitch, axis.last() + 0.5 * axis.pitch);
            (high.atan() - low.atan()).to_degrees()
        };
        (self.view == View::Perspective).then(|| [angle(&self.x), angle(&self.y)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_looks_through_its_pixels_centres() {
        let camera = Raster::camera(90.0, [4, 2]).expect("valid");
        // 90 degrees over two rows: slopes -1 .. 1, so the rows look along -1/2 and 1/2.
        assert!((camera.point(0, 2.0) - DVec3::new(-3.0, -1.0, 2.0)).length() < 1e-12);
        assert!((camera.ray(7) - DVec3::new(1.5, 0.5, 1.0)).length() < 1e-12);
        let [across, up] = camera.field_of_view().expect("perspective");
        assert!((up - 90.0).abs() < 1e-9 && (across - 2.0 * 2f64.atan().to_degrees()).abs() < 1e-9);
        for (fov, pixels) in [(0.0, [4, 4]), (180.0, [4, 4]), (f64::NAN, [4, 4]), (60.0, [0, 4])] {
            assert!(Raster::camera(fov, pixels).is_err(), "{fov} {pixels:?}");
        }
    }
}
