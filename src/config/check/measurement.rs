//! The medium, the sweep, the array and the detection.

use super::MAX_SAMPLES;
use crate::acquisition::{MOST_SOURCES, PropagationModel};
use crate::config::range::{
    Check, conflict, counts, ensure, file_name, finite, none_typed, not_negative, positive, tolerance, within,
};
use crate::config::reader::Fault;
use crate::config::{ArrayLayout, ArrayTable, DetectionTable, MediumTable, RunFile, SweepTable};
use crate::scene::FARTHEST;
use crate::wave::{GeometryKind, Interface, SOUND_SPEEDS};

impl MediumTable {
    pub(super) fn check(&self) -> Check {
        if let Some(speed) = self.sound_speed {
            let [least, most] = SOUND_SPEEDS;
            within("medium.sound_speed", speed, least, most, "a speed from 0.01 to 1e9 m/s (air has 343)")?;
        }
        let Some(air) = self.air() else {
            let of_air = [
                ("medium.humidity", self.humidity.is_some()),
                ("medium.pressure", self.pressure.is_some()),
                ("medium.absorption", self.absorption),
            ];
            return none_typed(&of_air, |key| {
                let problem = "belongs to air of a known temperature; give `temperature` too, in degrees Celsius, in \
                               place of `sound_speed`";
                Fault::new(key, problem)
            });
        };
        ensure(self.sound_speed.is_none(), || {
            let why = "the speed of sound follows from the temperature";
            conflict("medium.temperature", &["medium.sound_speed"], why)
        })?;
        within("medium.temperature", air.temperature, -50.0, 60.0, "degrees Celsius from -50 to 60")?;
        within("medium.humidity", air.humidity, 0.0, 100.0, "a relative humidity from 0 to 100 %")?;
        let pressures = "a pressure from 1e4 to 1e6 Pa (sea level has 101325)";
        within("medium.pressure", air.pressure, 1e4, 1e6, pressures)?;
        let water = air.water();
        ensure(water <= 0.25, || {
            let problem = format!("{:.0} % of that air would be water; expected 25 % at most", 100.0 * water);
            Fault::new("medium.humidity", problem).or_at(&["medium.temperature", "medium.pressure"])
        })
    }
}

impl RunFile {
    /// What an interface excludes: only paths are bent there.
    pub(super) fn check_interface(&self) -> Check {
        let Some(Interface { depth, sound_speed }) = self.medium.interface else { return Ok(()) };
        let [least, most] = SOUND_SPEEDS;
        let speeds = "a speed from 0.01 to 1e9 m/s (steel has 5900)";
        within("medium.interface.sound_speed", sound_speed, least, most, speeds)?;
        positive("medium.interface.depth", depth)?;
        within("medium.interface.depth", depth, 0.0, FARTHEST, "a depth within 1e9 m")?;
        let array = &self.array;
        let excluded = [
            ("medium.spreading", self.medium.spreading),
            ("medium.absorption", self.medium.absorption),
            ("array.speaker_radius", array.speaker_radius > 0.0),
            ("array.microphone_radius", array.microphone_radius > 0.0),
            ("detection.model", self.detection.model == PropagationModel::Linear),
            ("reconstruct.compensate", self.reconstruct.compensate),
        ];
        none_typed(&excluded, |key| {
            conflict(
                key,
                &["medium.interface"],
                "only the paths are known beyond an interface, not what is lost there",
            )
        })
    }
}

impl SweepTable {
    pub(super) fn check(&self) -> Check {
        let Self { start, stop, step } = *self;
        positive("sweep.start", start)?;
        positive("sweep.stop", stop)?;
        positive("sweep.step", step)?;
        ensure(stop >= start, || {
            let problem = format!("the sweep stops at {stop:?} Hz, before its start at {start:?} Hz");
            Fault::new("sweep.stop", problem).or_at(&["sweep.start"])
        })?;
        let band = stop - start;
        let steps = band / step;
        let fault = |problem| Fault::new("sweep.step", problem).or_at(&["sweep.start", "sweep.stop"]);
        ensure(steps <= MAX_SAMPLES, || {
            fault(format!("{steps:.3e} frequencies are too many; use a larger step"))
        })?;
        let whole = steps.round();
        ensure((whole * step - band).abs() <= 1e-6 * band, || {
            let fix = if whole < 1.0 {
                format!("step = {band:?}")
            } else {
                format!("stop = {:?}, or step = {:?}", start + whole * step, band / whole)
            };
            fault(format!(
                "the band from {start:?} to {stop:?} Hz is {steps:.4} steps of {step:?} Hz; expected a whole \
                 number of steps: {fix}"
            ))
        })
    }
}

impl ArrayTable {
    pub(super) fn check(&self) -> Check {
        for coordinate in self.source {
            within("array.source", coordinate, -FARTHEST, FARTHEST, "a position within 1e9 m")?;
        }
        finite("array.centre", &self.centre)?;
        self.check_sources()?;
        self.count.map_or(Ok(()), |count| counts("array.count", &count, MAX_SAMPLES))?;
        self.elements.map_or(Ok(()), |elements| counts("array.elements", &[elements], MAX_SAMPLES))?;
        self.spacing.map_or(Ok(()), |spacing| not_negative("array.spacing", spacing))?;
        ensure(self.count.is_none() || self.elements.is_none(), || {
            let why = "`elements` and `count` both give the number of microphones";
            conflict("array.elements", &["array.count"], why)
        })?;
        self.pitch.into_iter().flatten().try_for_each(|pitch| positive("array.pitch", pitch))?;
        self.extent.into_iter().flatten().try_for_each(|extent| not_negative("array.extent", extent))?;
        ensure(self.pitch.is_none() || self.extent.is_none(), || {
            conflict("array.extent", &["array.pitch"], "`extent` and `pitch` both give the array's size")
        })?;
        let count = self.count.filter(|_| self.layout == ArrayLayout::Grid);
        for (extents, counts) in self.extent.into_iter().zip(count) {
            for axis in 0..2 {
                let (along, extent, count) = (["x", "y"][axis], extents[axis], counts[axis]);
                ensure((extent > 0.0) == (count > 1), || {
                    let problem = if count > 1 {
                        format!("{count} microphones along {along} span more than 0 m")
                    } else {
                        let mut others = extents;
                        others[axis] = 0.0;
                        format!(
                            "one microphone along {along} spans 0, not {extent:?} m; write extent = {others:?}"
                        )
                    };
                    Fault::new("array.extent", problem).or_at(&["array.count"])
                })?;
            }
        }
        for (key, value) in [
            ("array.speaker_radius", self.speaker_radius),
            ("array.microphone_radius", self.microphone_radius),
            ("array.position_error", self.position_error),
        ] {
            within(key, value, 0.0, 1e3, "a length in metres, 0 or more")?;
        }
        within("array.gain_error_db", self.gain_error_db, 0.0, 60.0, "an rms from 0 to 60 dB")?;
        within("array.phase_error", self.phase_error, 0.0, 360.0, "an rms from 0 to 360 degrees")?;
        self.check_layout()
    }

    /// The keys that only some geometries have.
    fn check_sources(&self) -> Check {
        let fixed = self.geometry == GeometryKind::FixedSource;
        ensure(fixed || self.source == [0.0; 3], || {
            conflict("array.source", &["array.geometry"], "a scan has no speaker of its own")
        })?;
        if let Some(sources) = &self.sources {
            ensure(fixed, || {
                conflict(
                    "array.sources",
                    &["array.geometry"],
                    "the speaker of a scan moves with the microphone",
                )
            })?;
            ensure(self.source == [0.0; 3], || {
                conflict("array.sources", &["array.source"], "both say where speakers are")
            })?;
            ensure((1..=MOST_SOURCES).contains(&sources.len()), || {
                let problem = format!(
                    "{} speakers are not possible; expected 1 to {MOST_SOURCES}, as [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]",
                    sources.len()
                );
                Fault::new("array.sources", problem)
            })?;
            for coordinate in sources.iter().flatten() {
                within("array.sources", *coordinate, -FARTHEST, FARTHEST, "positions within 1e9 m")?;
            }
        }
        for coordinate in self.source_offset.into_iter().flatten() {
            within("array.source_offset", coordinate, -FARTHEST, FARTHEST, "an offset within 1e9 m")?;
        }
        let pair = self.geometry == GeometryKind::Pair;
        file_name("array.source_file", self.source_file.as_ref())?;
        ensure(!pair || self.source_offset.is_some() || self.source_file.is_some(), || {
            let problem = "geometry \"pair\" needs `source_offset`, from the microphone to the speaker, as [0.05, 0.0, 0.0], or \
                           `source_file`, a file of a speaker for each microphone";
            Fault::new("array.geometry", problem)
        })?;
        ensure(self.source_offset.is_none() || self.source_file.is_none(), || {
            conflict(
                "array.source_offset",
                &["array.source_file"],
                "both say where the speakers of pairs are",
            )
        })?;
        ensure(pair || self.source_file.is_none(), || {
            let why = "a file of a speaker for each microphone needs `geometry = \"pair\"`";
            conflict("array.source_file", &["array.geometry"], why)
        })?;
        ensure(pair || self.source_offset.is_none(), || {
            let why = "an offset from microphone to speaker needs `geometry = \"pair\"`";
            conflict("array.source_offset", &["array.geometry"], why)
        })
    }

    /// The keys that only some layouts have.
    fn check_layout(&self) -> Check {
        file_name("array.file", self.file.as_ref())?;
        let unused = |why: &'static str| move |key: &'static str| conflict(key, &["array.layout"], why);
        if self.layout == ArrayLayout::File {
            ensure(self.file.is_some(), || {
                let problem = "layout \"file\" needs the key `file`, a CSV with the header x,y,z in metres or an \
                               Acoular XML";
                Fault::new("array.layout", problem)
            })?;
        } else {
            let of_file = [("array.file", self.file.is_some())];
            none_typed(&of_file, unused("a file of microphones needs `layout = \"file\"`"))?;
        }
        if self.layout != ArrayLayout::Random {
            let of_random = [("array.spacing", self.spacing.is_some()), ("array.seed", self.seed.is_some())];
            let why = "it scatters microphones at random, which needs `layout = \"random\"`";
            none_typed(&of_random, unused(why))?;
        }
        match (self.layout, self.elements) {
            (ArrayLayout::File, _) => {
                let of_others = [
                    ("array.pitch", self.pitch.is_some()),
                    ("array.extent", self.extent.is_some()),
                    ("array.count", self.count.is_some()),
                    ("array.elements", self.elements.is_some()),
                    ("array.centre", self.centre != Self::before_filling().centre),
                ];
                none_typed(&of_others, unused("with layout \"file\" the positions are the file's own"))
            }
            (ArrayLayout::Grid, Some(elements)) => ensure(square_root(elements).is_some(), || {
                let side = f64::from(elements).sqrt().round().max(1.0) as u32;
                let problem = format!(
                    "{elements} microphones make no square grid; expected a square such as {}, or `count = [x, y]`, \
                     or layout \"spiral\" or \"random\"",
                    side.saturating_mul(side)
                );
                Fault::new("array.elements", problem).or_at(&["array.layout"])
            }),
            _ => Ok(()),
        }
    }
}

/// The side of a square of this many microphones, if they make one.
pub(in crate::config) fn square_root(elements: u32) -> Option<u32> {
    let side = f64::from(elements).sqrt().round() as u32;
    (side.checked_mul(side) == Some(elements)).then_some(side)
}

impl DetectionTable {
    pub(super) fn check(&self) -> Check {
        tolerance("detection.tolerance", self.tolerance)?;
        self.snr_db
            .map_or(Ok(()), |snr| within("detection.snr_db", snr, -200.0, 400.0, "from -200 to 400 dB"))
    }
}
