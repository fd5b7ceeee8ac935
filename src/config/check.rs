//! The checks of a run file beyond types: ranges, and keys that must agree with each other.

mod calibration;
mod coding;
mod import;
mod instrument;
mod measurement;
mod motion;
mod recording;
mod results;
mod scene;

pub(super) use measurement::square_root;

use super::RunFile;
use super::range::Check;

/// Maximum number of frequencies or microphones; larger ones are mistakes.
const MAX_SAMPLES: f64 = 1e8;

impl RunFile {
    /// Runs every check, table by table, until the first fault.
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
        self.import.check()?;
        self.recording.check()?;
        self.check_instrument()?;
        self.calibration.check()?;
        self.grid.check()?;
        self.reconstruct.check()?;
        self.refine.check()?;
        self.check_correlation()?;
        self.depth.check()?;
        self.check_interface()?;
        self.check_bounces()?;
        self.check_motion()?;
        self.check_coding()?;
        self.output.check()?;
        self.expect.check()
    }
}
