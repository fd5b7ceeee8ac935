//! How long a measurement takes: the tones of all sweeps one after another, at all places of a scan.

use crate::acquisition::{Instrument, TestSignal};
use crate::choice::choice;
use crate::grid::Grid;
use serde::{Deserialize, Serialize};
use std::fmt;

choice! {
    /// Where the time of a tone comes from.
    pub enum ToneTime: "tone time" {
        /// It is given, as `[recording] dwell`.
        Given = "dwell",
        /// The shortest that hears the whole grid: until the last echo has come, and as long again, but at least ten periods of
        /// the lowest tone.
        Paths = "paths",
        /// All tones sound at once: until the room has answered, and a period of the step.
        Broadband = "broadband",
    }
}

/// How long a measurement takes, without what moving and switching takes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct AcquisitionTime {
    /// All of it, s.
    pub seconds: f64,
    /// Tones of a sweep that sound one after another: 1 where all sound at once.
    pub tones: usize,
    /// Sweeps at each place: one for each loudspeaker, or those of their code, or twice as many where both phases take one each.
    pub sweeps: f64,
    /// Places of a scan, or 1 of an array.
    pub places: usize,
    /// Time of a tone, s.
    pub tone_seconds: f64,
    /// Where that comes from.
    pub tone_time: ToneTime,
}

/// Periods of the lowest tone that are integrated over: Eq. 3 needs many.
const PERIODS: f64 = 10.0;

/// What a run file says of the time of its tones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TypedTimes {
    /// Of each tone, s.
    pub(crate) dwell: Option<f64>,
    /// Tones one after another, or all at once.
    pub(crate) signal: TestSignal,
    /// Of all at once: how long the room answers, s; left out: 1/step.
    pub(crate) response: Option<f64>,
    /// Sweeps at each place.
    pub(crate) sweeps: f64,
}

impl AcquisitionTime {
    /// That of an instrument before a grid.
    pub(crate) fn of(instrument: &Instrument, grid: &Grid, typed: &TypedTimes) -> Self {
        let sweep = &instrument.sweep;
        let (mut tones, sweeps) = (sweep.len(), typed.sweeps);
        let (tone_seconds, tone_time) = match (typed.signal, typed.dwell) {
            (TestSignal::Broadband, _) => {
                let mean = sweep.bandwidth() / (tones.max(2) - 1) as f64;
                let period = 1.0 / sweep.step().unwrap_or(mean).max(f64::MIN_POSITIVE);
                tones = 1;
                (typed.response.unwrap_or(period) + period, ToneTime::Broadband)
            }
            (TestSignal::Tones, Some(dwell)) => (dwell, ToneTime::Given),
            (TestSignal::Tones, None) => {
                let [_, longest] = instrument.path_bounds(grid);
                let settling = longest / instrument.sound_speed;
                (settling + settling.max(PERIODS / sweep.start()), ToneTime::Paths)
            }
        };
        let places = if instrument.is_scan() { instrument.array.len() } else { 1 };
        let seconds = tones as f64 * sweeps * places as f64 * tone_seconds;
        Self { seconds, tones, sweeps, places, tone_seconds, tone_time }
    }
}

/// As in `7.4 s: 251 tones of 29.5 ms (as the longest path of the grid needs)`.
impl fmt::Display for AcquisitionTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { seconds, tones, sweeps, places, tone_seconds, tone_time } = *self;
        write!(f, "{seconds:.1} s: ")?;
        if places > 1 {
            write!(f, "{places} places x ")?;
        }
        if sweeps != 1.0 {
            write!(f, "{sweeps} sweeps x ")?;
        }
        let milliseconds = 1e3 * tone_seconds;
        match tone_time {
            ToneTime::Given => write!(f, "{tones} tones of {milliseconds:.1} ms, as [recording] dwell says"),
            ToneTime::Paths => write!(
                f,
                "{tones} tones of {milliseconds:.1} ms, the least by the longest path ([recording] dwell sets another)"
            ),
            ToneTime::Broadband => {
                write!(f, "all tones at once in {milliseconds:.1} ms, by [recording] response and the step")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acquisition::{MicArray, Sweep};
    use crate::grid::Axis;
    use crate::wave::Geometry;
    use glam::DVec3;

    #[test]
    fn acquisition_takes_the_tones_of_all_sweeps_and_places() {
        let array = MicArray::rectangular([5, 4], [0.02; 2], DVec3::ZERO).expect("valid");
        let instrument = Instrument::new(Sweep::stepped(1e3, 2e3, 100.0).expect("valid"), array);
        let one = |first: f64| Axis { first, pitch: 0.1, count: 1 };
        let grid = Grid { x: one(0.0), y: one(0.0), z: one(1.715) };
        let (signal, at_once) = (TestSignal::Tones, TestSignal::Broadband);
        let typed = TypedTimes { dwell: None, signal, response: None, sweeps: 1.0 };
        let time = |typed: &TypedTimes| AcquisitionTime::of(&instrument, &grid, typed);
        // There and back, 3.43 m to the microphones on average, takes 10 ms: ten periods of 1 kHz, too.
        let least = time(&typed);
        assert!((least.tone_seconds - 0.02).abs() < 1e-4, "{least}");
        assert_eq!((least.tones, least.places, least.tone_time), (11, 1, ToneTime::Paths));
        assert_eq!(least.seconds, 11.0 * least.tone_seconds);
        let given = time(&TypedTimes { dwell: Some(0.05), sweeps: 4.0, ..typed });
        assert!((given.seconds - 11.0 * 4.0 * 0.05).abs() < 1e-12 && given.tone_time == ToneTime::Given);
        let all = time(&TypedTimes { signal: at_once, ..typed });
        assert!((all.seconds - 0.02).abs() < 1e-12 && all.tones == 1, "{all}");
        let answered = TypedTimes { signal: at_once, response: Some(0.5), dwell: Some(1.0), ..typed };
        let answered = time(&answered);
        assert!((answered.seconds - 0.51).abs() < 1e-12, "{answered}");
        let scan = instrument.clone().with_geometry(Geometry::Monostatic);
        let scanned = AcquisitionTime::of(&scan, &grid, &TypedTimes { dwell: Some(0.05), ..typed });
        assert!((scanned.seconds - 20.0 * 11.0 * 0.05).abs() < 1e-12 && scanned.places == 20);
        assert!(scanned.to_string().starts_with("11.0 s: 20 places x 11 tones of 50.0 ms"), "{scanned}");
    }
}
