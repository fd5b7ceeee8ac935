//! What a run file must fulfil beyond its types: ranges, and keys that must agree with each other.

mod measurement;
mod results;
mod scene;

pub(super) use measurement::square_root;

use super::RunFile;
use super::range::Check;

/// Most frequencies, microphones or voxels along an axis that anyone could mean.
const MOST_SAMPLES: f64 = 1e8;

impl RunFile {
    /// Every check, table by table; the first fault ends it.
    pub(super) fn check_all(&self) -> Check {
        self.scene.check()?;
        for (index, rule) in self.materials.iter().enumerate() {
            rule.check(&format!("materials[{index}]"))?;
        }
        self.reflectors.check()?;
        self.medium.check()?;
        self.sweep.check()?;
        self.array.check()?;
        self.detection.check()?;
        self.grid.check()?;
        self.reconstruct.check()?;
        self.depth.check()?;
        self.output.check()?;
        self.expect.check()
    }
}
