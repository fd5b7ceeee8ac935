//! What receives depths as they are finished, and how they were computed.

use super::Correlation;
use crate::alloc::try_zeroed;
use crate::error::Result;
use crate::grid::{Volume, no_room_for};
use crate::reconstruct::{Method, Refinement};
use num_complex::Complex32;
use std::ops::Range;

/// How a volume was computed, and how exactly.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct ReconstructionInfo {
    /// The method that was used; never [`Method::Auto`].
    pub method: Method,
    /// A bound on the error of any voxel against Eq. 13, f32 rounding aside, in the volume's own units: the measured
    /// relative error of skeletons, spreading and range profiles times `Σ|w m| / Σw`. Of a refined volume, that of the volume
    /// of Eq. 13 that it began with.
    pub error_bound: f64,
    /// The amplitude that samples of random phases and of these powers leave at a voxel, `√Σ|w m|² / Σw`: a voxel below it
    /// shows nothing. `None` where amplitudes are not those of Eq. 13: of a compensated or refined volume.
    pub incoherent_level: Option<f64>,
    /// The amplitude of the strongest echo outside the grid with paths as long as those of the grid, as some of the microphones hear it,
    /// where it is so far above what the grid shows that this can only be its sidelobes; else `None`.
    pub outside_level: Option<f64>,
    /// How it was refined, if it was.
    pub refinement: Option<Refinement>,
    /// How microphones were correlated, if they were: voxels are then real, and not of Eq. 13.
    pub correlation: Option<Correlation>,
}

impl ReconstructionInfo {
    /// Of a volume that is not refined.
    pub(crate) const fn plain(method: Method, error_bound: f64) -> Self {
        Self {
            method,
            error_bound,
            incoherent_level: None,
            outside_level: None,
            refinement: None,
            correlation: None,
        }
    }
}

/// Receives depths as they are finished: memory, or a file that is written slab by slab.
pub trait VolumeSink: Send {
    /// Called once, before the first depth.
    ///
    /// # Errors
    /// I/O or memory errors of the sink.
    fn begin(&mut self, info: &ReconstructionInfo) -> Result<()>;

    /// Takes neighbouring depths from `first` on, `[plane, y, x]`; they come in ascending order, each once.
    ///
    /// # Errors
    /// See [`VolumeSink::begin`].
    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()>;

    /// The part of some depths outside of which the sink needs none of them: it has them from an interrupted run, or they
    /// are somebody else's. They need not be computed; where they are, they may be given to the sink all the same.
    fn wanted(&self, depths: Range<usize>) -> Range<usize> {
        depths
    }
}

/// Some depths without those at both ends that are not needed; empty if none is.
pub(crate) fn needed_among(depths: Range<usize>, is_needed: impl Fn(usize) -> bool) -> Range<usize> {
    let start = depths.clone().find(|depth| is_needed(*depth)).unwrap_or(depths.end);
    start..(start..depths.end).rfind(|depth| is_needed(*depth)).map_or(start, |last| last + 1)
}

/// A volume in memory.
impl VolumeSink for Volume {
    fn begin(&mut self, _: &ReconstructionInfo) -> Result<()> {
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        // Not before the first depths come, so that nothing is reserved for a job that is refused.
        if self.samples.is_empty() {
            self.samples = try_zeroed(self.grid.voxel_count()).ok_or_else(|| no_room_for(&self.grid))?;
        }
        self.samples[first * self.grid.plane_len()..][..planes.len()].copy_from_slice(planes);
        Ok(())
    }
}

/// A volume whose first depths come from an interrupted run, for tests of resuming.
#[cfg(test)]
pub(crate) struct ResumedVolume {
    pub(crate) volume: Volume,
    pub(crate) done: usize,
}

#[cfg(test)]
impl VolumeSink for ResumedVolume {
    fn begin(&mut self, info: &ReconstructionInfo) -> Result<()> {
        self.volume.begin(info)
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let last = first + planes.len() / self.volume.grid.plane_len();
        assert!(last > self.done, "depths {first}..{last} are already there");
        self.volume.take(first, planes)
    }

    fn wanted(&self, depths: Range<usize>) -> Range<usize> {
        depths.start.max(self.done).min(depths.end)..depths.end
    }
}
