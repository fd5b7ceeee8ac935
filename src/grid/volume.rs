//! Complex amplitudes on a grid: a [`Volume`] that owns them, and a [`VolumeView`] of samples that someone else owns, such as
//! a NumPy array. What only reads a volume takes a view, so that no caller has to copy gigabytes.

use super::Grid;
use num_complex::Complex32;

/// The reconstructed complex amplitude `Â(p)` on a grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Volume {
    /// Where the voxels are.
    pub grid: Grid,
    /// `[z, y, x]`; a unit reflector on a voxel peaks at 1.
    pub samples: Vec<Complex32>,
}

impl Volume {
    /// A volume of given samples.
    ///
    /// # Panics
    /// When there are not exactly as many samples as voxels.
    pub fn new(grid: Grid, samples: Vec<Complex32>) -> Self {
        assert_eq!(samples.len() as u64, grid.voxel_count(), "one sample per voxel");
        Self { grid, samples }
    }

    /// A view of all samples.
    pub fn view(&self) -> VolumeView<'_> {
        VolumeView { grid: self.grid, samples: &self.samples }
    }

    /// The samples of depth `iz`, `[y, x]`.
    pub fn plane(&self, iz: usize) -> &[Complex32] {
        self.view().plane(iz)
    }

    /// Maximum `|Â|`.
    pub fn peak(&self) -> f32 {
        self.view().peak()
    }
}

/// A volume whose samples are borrowed.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct VolumeView<'a> {
    /// Where the voxels are.
    pub grid: Grid,
    /// `[z, y, x]`.
    pub samples: &'a [Complex32],
}

impl<'a> VolumeView<'a> {
    /// A view of given samples.
    ///
    /// # Panics
    /// When there are not exactly as many samples as voxels.
    pub fn new(grid: Grid, samples: &'a [Complex32]) -> Self {
        assert_eq!(samples.len() as u64, grid.voxel_count(), "one sample per voxel");
        Self { grid, samples }
    }

    /// The samples of depth `iz`, `[y, x]`.
    pub fn plane(&self, iz: usize) -> &'a [Complex32] {
        let n = self.grid.plane_len();
        &self.samples[iz * n..(iz + 1) * n]
    }

    /// Maximum `|Â|`.
    pub fn peak(&self) -> f32 {
        self.samples.iter().map(Complex32::norm_sqr).fold(0.0, f32::max).sqrt()
    }
}

impl<'a> From<&'a Volume> for VolumeView<'a> {
    fn from(volume: &'a Volume) -> Self {
        volume.view()
    }
}
