//! `[coding]`: what tells loudspeakers apart, and what they cannot be told apart with.

use crate::acquisition::{CodeKind, MOST_CODED};
use crate::config::RunFile;
use crate::config::range::{Check, conflict, ensure, none_typed, within};
use crate::config::reader::Fault;

impl RunFile {
    pub(super) fn check_coding(&self) -> Check {
        let table = &self.coding;
        let Some(kind) = table.kind else {
            let typed = [
                ("coding.sequences", !table.sequences.is_empty()),
                ("coding.error", table.error != 0.0),
                ("coding.seed", table.seed.is_some()),
                ("calibration.decode", self.calibration.decode),
            ];
            return none_typed(&typed, |key| {
                let problem = "needs `kind` in [coding]: \"hadamard\", \"comb\" or \"sequences\"";
                Fault::new(key, problem).or_at(&["coding.kind"])
            });
        };
        within("coding.error", table.error, 0.0, 1.0, "an rms from 0 to 1, as 0.01")?;
        ensure((kind == CodeKind::Sequences) != table.sequences.is_empty(), || {
            let problem = "coding.sequences belongs to kind = \"sequences\", and only to it: a row for each sweep, as [[1, 1], [1, -1]]";
            Fault::new("coding.sequences", problem).or_at(&["coding.kind"])
        })?;
        ensure(table.sequences.len() <= MOST_CODED, || {
            Fault::new("coding.sequences", format!("has more than {MOST_CODED} rows"))
        })?;
        for amplitude in table.sequences.iter().flatten() {
            within("coding.sequences", *amplitude, -1.0, 1.0, "amplitudes from -1 to 1")?;
        }
        let moves = !self.scene_velocities().is_empty() || self.frame_motion().is_some();
        ensure(!moves, || {
            let why =
                "[coding] takes speakers that sound at once, and a velocity knows them one after another";
            conflict("coding.kind", &["scene.velocity", "medium.velocity"], why)
        })
    }
}
