//! What every method is given: the samples, the voxels, and what takes the finished depths.

use super::VolumeSink;
use super::compress::KeptTones;
use super::error_budget::ErrorBudget;
use super::upsampling::InterpolationError;
use super::volume::Batch;
use super::window::Weights;
use crate::acquisition::CubeSource;
use crate::grid::Grid;
use crate::progress::Observer;

/// One reconstruction, whatever its method.
pub(crate) struct Job<'a> {
    /// The samples `m(f, r)`, and what they were measured with.
    pub(crate) source: &'a mut dyn CubeSource,
    /// Where the tones are kept that the samples are compressed to.
    pub(crate) kept: KeptTones<'a>,
    /// What turns samples into the summands of Eq. 13.
    pub(crate) weights: &'a Weights,
    /// The voxels.
    pub(crate) grid: &'a Grid,
    /// The error that any voxel of `grid` may have.
    pub(crate) budget: ErrorBudget,
    /// What becomes of it where the volume's voxels are interpolated from these.
    pub(crate) interpolation: InterpolationError,
    /// How much is worked on at a time.
    pub(crate) batch: Batch,
    /// Takes the depths as they are finished.
    pub(crate) sink: &'a mut dyn VolumeSink,
    /// Learns of the progress.
    pub(crate) observer: &'a dyn Observer,
}
