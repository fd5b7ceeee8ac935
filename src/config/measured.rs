//! What a run file says about a cube, whose file knows its instrument itself.

use super::{RunFile, TypedKeys};
use crate::acquisition::InstrumentChanges;
use crate::error::{Error, Result};
use glam::DVec3;

/// Tables and keys of a simulation, and what says the same of a cube.
const OF_SCENES: [(&str, &str); 10] = [
    ("scene", "a cube has no scene"),
    ("materials", "a cube has no scene"),
    ("reflectors", "a cube has no scene"),
    ("expect", "a cube has no truth; `compare` scores its depth map against one"),
    ("import", "a cube is imported already"),
    ("recording", "a cube is made of its recording already; `import` makes another"),
    ("instrument", "the samples are what was measured"),
    ("sweep", "the frequencies are in the cube"),
    ("detection", "the samples are what was detected"),
    ("array", "the microphones are in the cube; only array.centre and array.source can be changed"),
];

/// The same of `[medium]`, most of which can be changed.
const OF_SIMULATION: [&str; 2] = ["medium.spreading", "medium.absorption"];

/// Keys that replace what a cube's file says.
const SPEED: [&str; 4] = ["medium.sound_speed", "medium.temperature", "medium.humidity", "medium.pressure"];
const INTERFACE: [&str; 3] = ["medium.interface", "medium.interface.depth", "medium.interface.sound_speed"];
const SOURCE: &str = "array.source";
const CENTRE: &str = "array.centre";
const DWELL: &str = "recording.dwell";

impl RunFile {
    /// What overrides replace of a cube's instrument: the speeds of sound, as typed or of the air, an interface, and the places of speaker
    /// and array. What the file says of them is that of the scene it simulates, and replaces nothing.
    ///
    /// # Errors
    /// Overrides that change nothing of a cube, with the reason.
    pub fn overridden_instrument(&self, typed: &TypedKeys) -> Result<InstrumentChanges> {
        for key in typed.overridden() {
            let table = key.split(['.', '[']).next().unwrap_or_default();
            let place = || format!("--set {key}");
            if table == "coding" && !self.calibration.decode {
                let problem = "changes nothing here: the cube is taken for decoded; with calibration.decode=true it is decoded";
                return Err(Error::input(place(), problem));
            }
            if OF_SIMULATION.contains(&key) {
                let problem =
                    "changes what is simulated; what is measured is corrected by reconstruct.compensate";
                return Err(Error::input(place(), problem));
            }
            let why = OF_SCENES.iter().find(|(name, _)| *name == table);
            if let Some((_, why)) = why.filter(|_| key != table && ![SOURCE, CENTRE, DWELL].contains(&key)) {
                return Err(Error::input(place(), format!("changes nothing here: {why}")));
            }
        }
        Ok(self.instrument_where(|key| typed.is_overridden(key)))
    }

    /// What the file itself says of them.
    pub fn written_instrument(&self, typed: &TypedKeys) -> InstrumentChanges {
        self.instrument_where(|key| typed.contains(key) && !typed.is_overridden(key))
    }

    fn instrument_where(&self, is_meant: impl Fn(&str) -> bool) -> InstrumentChanges {
        InstrumentChanges {
            sound_speed: SPEED.iter().any(|key| is_meant(key)).then(|| self.medium.speed()),
            source: is_meant(SOURCE).then(|| DVec3::from_array(self.array.source)),
            interface: INTERFACE.iter().any(|key| is_meant(key)).then_some(self.medium.interface).flatten(),
            centre: is_meant(CENTRE).then(|| DVec3::from_array(self.array.centre)),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    fn changes(overrides: &[&str]) -> Result<InstrumentChanges> {
        let overrides: Vec<String> = overrides.iter().map(|&typed| typed.to_owned()).collect();
        let (run, typed) = RunFile::of_overrides(&overrides).unwrap();
        run.overridden_instrument(&typed)
    }

    #[test]
    fn only_what_is_typed_changes_a_cube() {
        assert_eq!(
            changes(&["grid.z=[1,2]", "reconstruct.window=hann"]).unwrap(),
            InstrumentChanges::default()
        );
        let warm = changes(&["medium.temperature=30"]).unwrap();
        assert!(warm.sound_speed.is_some_and(|c| (c - 350.2).abs() < 0.1) && warm.source.is_none());
        let typed = changes(&["array.centre=[0,0,-0.1]", "array.source=[0.0,0.2,0]"]).unwrap();
        assert_eq!((typed.source, typed.centre), (Some(DVec3::Y * 0.2), Some(DVec3::Z * -0.1)));
        assert_eq!(typed.sound_speed, None);
    }

    #[test]
    fn overrides_without_an_effect_are_refused() {
        for (typed, named) in [
            ("sweep.step=40", "frequencies"),
            ("array.count=[4,4]", "array.centre"),
            ("scene.up=y", "no scene"),
            ("medium.spreading=true", "reconstruct.compensate"),
            ("detection.snr_db=3", "detected"),
            ("expect.completeness.min=0.5", "compare"),
        ] {
            let error = changes(&[typed]).unwrap_err().to_string();
            assert_names(error, &[typed.split(['=', '.']).next().unwrap(), named]);
        }
    }
}
