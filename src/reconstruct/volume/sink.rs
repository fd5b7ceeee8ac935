//! Where depths go as they are finished, and what is known of them.

use crate::alloc::try_zeroed;
use crate::error::Result;
use crate::grid::{Volume, no_room_for};
use crate::reconstruct::Method;
use num_complex::Complex32;

/// How a volume was come by.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Made {
    /// The method that was used; never [`Method::Auto`].
    pub method: Method,
    /// A bound on the error of any voxel against Eq. 13, f32 rounding aside, in the volume's own units: the measured
    /// relative error of skeletons and spreading times `Σ|w m| / Σw`.
    pub error_bound: f64,
}

/// Where depths go as they are finished: memory, or a file that is written slab by slab.
pub trait VolumeSink: Send {
    /// Told once, before the first depth.
    ///
    /// # Errors
    /// What writing comes to; so do the others.
    fn begin(&mut self, made: &Made) -> Result<()>;

    /// Takes neighbouring depths from `first` on, `[plane, y, x]`; they come in ascending order, each once.
    ///
    /// # Errors
    /// See [`VolumeSink::begin`].
    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()>;

    /// Depths that the sink has already from the first on, of an earlier run; they need not come again.
    fn done(&self) -> usize {
        0
    }
}

/// A volume held whole.
impl VolumeSink for Volume {
    fn begin(&mut self, _: &Made) -> Result<()> {
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        // Not before: a volume that comes whole is not held twice.
        if self.samples.is_empty() {
            self.samples = try_zeroed(self.grid.voxel_count()).ok_or_else(|| no_room_for(&self.grid))?;
        }
        self.samples[first * self.grid.plane_len()..][..planes.len()].copy_from_slice(planes);
        Ok(())
    }
}
