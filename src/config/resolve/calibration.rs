//! From `[calibration]` to corrections.

use crate::acquisition::{Background, Calibration};
use crate::config::RunFile;
use crate::config::tables::MEAN;
use crate::plan::memory_limit;
use glam::DVec3;

impl RunFile {
    /// `[calibration]`.
    pub fn calibration(&self) -> Calibration {
        let table = &self.calibration;
        // What the system takes a while to tell is for files that are read.
        let reads = table.background.is_some() || table.response.is_some();
        let limit = reads.then(|| memory_limit(self.memory)).flatten();
        Calibration {
            mask: table.mask.clone(),
            code: self.source_code().filter(|_| table.decode),
            loudspeakers: self.array.sources.iter().flatten().copied().map(DVec3::from_array).collect(),
            background: table.background.as_ref().map(|background| match background.typed.as_str() {
                MEAN => Background::Mean,
                _ => Background::Cube(background.path.clone()),
            }),
            high_pass: table.high_pass,
            response: table.response.as_ref().map(|file| file.path.clone()),
            columns: table.columns.clone(),
            phase_sign: table.phase_sign.unwrap_or(1),
            delay: table.delay,
            gate: table.gate,
            tilt: table.tilt,
            memory: limit.unwrap_or(u64::MAX),
        }
    }
}
