//! A measurement without its samples: all that formulas, plans and reconstructions need to know of it.

use super::{Detection, MicArray, Sweep};
use crate::grid::Grid;
use crate::wave::Geometry;
use crate::wave::interval::PathInterval;
use std::ops::Range;

/// What was, or is to be, measured with.
#[derive(Debug, Clone, Copy)]
pub struct Setup<'a> {
    /// The tones.
    pub sweep: &'a Sweep,
    /// The microphones.
    pub array: &'a MicArray,
    /// Fixed speaker or monostatic scan.
    pub geometry: Geometry,
    /// Quadrature or in-phase.
    pub detection: Detection,
    /// c, m/s.
    pub sound_speed: f64,
}

/// The same with its own sweep and array.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Instrument {
    /// The tones.
    pub sweep: Sweep,
    /// The microphones.
    pub array: MicArray,
    /// Fixed speaker or monostatic scan.
    pub geometry: Geometry,
    /// Quadrature or in-phase.
    pub detection: Detection,
    /// c, m/s.
    pub sound_speed: f64,
}

impl Instrument {
    /// The formulas' view of it.
    pub fn setup(&self) -> Setup<'_> {
        let Self { sweep, array, geometry, detection, sound_speed } = self;
        Setup { sweep, array, geometry: *geometry, detection: *detection, sound_speed: *sound_speed }
    }
}

impl Setup<'_> {
    /// A copy with its own sweep and array.
    pub fn to_instrument(&self) -> Instrument {
        Instrument {
            sweep: self.sweep.clone(),
            array: self.array.clone(),
            geometry: self.geometry,
            detection: self.detection,
            sound_speed: self.sound_speed,
        }
    }

    /// Wavelength at the centre of the band λ_c, m.
    pub fn wavelength(&self) -> f64 {
        self.sound_speed / self.sweep.centre()
    }

    /// Shortest wavelength λ_min, m.
    pub fn shortest_wavelength(&self) -> f64 {
        self.sound_speed / self.sweep.stop()
    }

    /// Range resolution Δd = c/2B, m (Eq. 10); `None` for a single tone.
    pub fn range_resolution(&self) -> Option<f64> {
        self.sweep.range_resolution(self.sound_speed)
    }

    /// Bounds on the path lengths between the voxels of a range of depths and the array: those of
    /// [`Geometry::path_bounds`].
    ///
    /// # Panics
    /// Without depths.
    pub(crate) fn path_interval(&self, grid: &Grid, depths: Range<usize>) -> PathInterval {
        let (low, high) = grid.bounds();
        let low = low.with_z(grid.z.position(depths.start));
        let high = high.with_z(grid.z.position(depths.end - 1));
        let [shortest, longest] = self.geometry.path_bounds((low, high), self.array.bounds());
        PathInterval { shortest, longest, sound_speed: self.sound_speed }
    }

    /// The same for all depths, m: least and greatest.
    pub fn path_bounds(&self, grid: &Grid) -> [f64; 2] {
        let all = self.path_interval(grid, 0..grid.z.count);
        [all.shortest, all.longest]
    }

    /// Bytes of all samples as they are held, complex in single precision; saturates rather than overflow.
    pub fn cube_bytes(&self) -> u64 {
        (self.sweep.len() as u64).saturating_mul(self.array.len() as u64).saturating_mul(8)
    }
}
