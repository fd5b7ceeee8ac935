//! What it is measured with.

use super::MOST_SAMPLES;
use crate::config::range::{Check, clash, counts, finite, named, not_negative, positive, within};
use crate::config::reader::Fault;
use crate::config::{ArrayTable, DetectionTable, Layout, MediumTable, SweepTable};
use crate::wave::GeometryKind;

impl MediumTable {
    pub(super) fn check(&self) -> Check {
        self.sound_speed.map_or(Ok(()), |speed| positive("medium.sound_speed", speed))?;
        let Some(air) = self.air() else {
            let idle = [
                ("medium.humidity", self.humidity.is_some()),
                ("medium.pressure", self.pressure.is_some()),
                ("medium.absorption", self.absorption),
            ];
            return match idle.into_iter().find(|(_, typed)| *typed) {
                Some((key, _)) => Err(Fault::new(
                    key,
                    "belongs to air of a known temperature; give `temperature` too, in degrees Celsius, in place of \
                     `sound_speed`",
                )),
                None => Ok(()),
            };
        };
        if self.sound_speed.is_some() {
            return Err(clash(
                "medium.temperature",
                &["medium.sound_speed"],
                "the speed of sound follows from the temperature",
            ));
        }
        within("medium.temperature", air.temperature, -50.0, 60.0, "degrees Celsius from -50 to 60")?;
        within("medium.humidity", air.humidity, 0.0, 100.0, "a relative humidity from 0 to 100 %")?;
        within(
            "medium.pressure",
            air.pressure,
            1e4,
            1e6,
            "a pressure from 1e4 to 1e6 Pa (sea level has 101325)",
        )?;
        if air.water() > 0.25 {
            return Err(Fault {
                partners: &["medium.temperature", "medium.pressure"],
                ..Fault::new(
                    "medium.humidity",
                    format!("{:.0} % of that air would be water; expected 25 % at most", 100.0 * air.water()),
                )
            });
        }
        Ok(())
    }
}

impl SweepTable {
    pub(super) fn check(&self) -> Check {
        let Self { start, stop, step } = *self;
        positive("sweep.start", start)?;
        positive("sweep.stop", stop)?;
        positive("sweep.step", step)?;
        if stop < start {
            return Err(Fault {
                partners: &["sweep.start"],
                ..Fault::new(
                    "sweep.stop",
                    format!("the sweep stops at {stop:?} Hz, before its start at {start:?} Hz"),
                )
            });
        }
        let band = stop - start;
        let steps = band / step;
        let fault = |problem: String| Fault {
            partners: &["sweep.start", "sweep.stop"],
            ..Fault::new("sweep.step", problem)
        };
        if steps > MOST_SAMPLES {
            return Err(fault(format!("{steps:.3e} frequencies are too many; use a larger step")));
        }
        let whole = steps.round();
        if (whole * step - band).abs() > 1e-6 * band {
            let mend = if whole < 1.0 {
                format!("step = {band:?}")
            } else {
                format!("stop = {:?}, or step = {:?}", start + whole * step, band / whole)
            };
            return Err(fault(format!(
                "the band from {start:?} to {stop:?} Hz is {steps:.4} steps of {step:?} Hz; expected a whole \
                 number of steps: {mend}"
            )));
        }
        Ok(())
    }
}

impl ArrayTable {
    pub(super) fn check(&self) -> Check {
        finite("array.source", &self.source)?;
        finite("array.centre", &self.centre)?;
        if self.geometry == GeometryKind::Monostatic && self.source != [0.0; 3] {
            return Err(clash(
                "array.source",
                &["array.geometry"],
                "a monostatic scan has no speaker of its own",
            ));
        }
        if let Some(count) = &self.count {
            counts("array.count", count, MOST_SAMPLES)?;
        }
        if let Some(elements) = self.elements {
            counts("array.elements", &[elements], MOST_SAMPLES)?;
        }
        if let Some(spacing) = self.spacing {
            not_negative("array.spacing", spacing)?;
        }
        if self.count.is_some() && self.elements.is_some() {
            return Err(clash(
                "array.elements",
                &["array.count"],
                "`elements` and `count` both give the number of microphones",
            ));
        }
        for pitch in self.pitch.into_iter().flatten() {
            positive("array.pitch", pitch)?;
        }
        for extent in self.extent.into_iter().flatten() {
            not_negative("array.extent", extent)?;
        }
        if self.pitch.is_some() && self.extent.is_some() {
            return Err(clash(
                "array.extent",
                &["array.pitch"],
                "`extent` and `pitch` both give the array's size",
            ));
        }
        let count = self.count.filter(|_| self.layout == Layout::Grid);
        for (extent, count) in self.extent.into_iter().flatten().zip(count.into_iter().flatten()) {
            if (extent > 0.0) != (count > 1) {
                return Err(Fault {
                    partners: &["array.count"],
                    ..Fault::new(
                        "array.extent",
                        format!(
                            "{count} microphones cannot span {extent:?} m; one microphone spans 0, several span \
                             more"
                        ),
                    )
                });
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

    fn check_layout(&self) -> Check {
        named("array.file", self.file.as_ref())?;
        let idle = |key: &str, why: &str| Err(clash(key, &["array.layout"], why));
        if self.file.is_some() && self.layout != Layout::File {
            return idle("array.file", "a file of microphones needs `layout = \"file\"`");
        }
        for (key, typed) in [("array.spacing", self.spacing.is_some()), ("array.seed", self.seed.is_some())] {
            if typed && self.layout != Layout::Random {
                return idle(key, "it scatters microphones at random, which needs `layout = \"random\"`");
            }
        }
        match (self.layout, self.elements) {
            (Layout::File, _) => self.check_file_layout(),
            (Layout::Grid, Some(elements)) if square_root(elements).is_none() => {
                let side = f64::from(elements).sqrt().round().max(1.0) as u32;
                Err(Fault {
                    partners: &["array.layout"],
                    ..Fault::new(
                        "array.elements",
                        format!(
                            "{elements} microphones make no square grid; expected a square such as {}, or `count = [x, y]`, \
                             or layout \"spiral\" or \"random\"",
                            side.saturating_mul(side)
                        ),
                    )
                })
            }
            _ => Ok(()),
        }
    }

    fn check_file_layout(&self) -> Check {
        if self.file.is_none() {
            return Err(Fault::new(
                "array.layout",
                "layout \"file\" needs the key `file`, a CSV with the header x,y,z in metres or an Acoular XML",
            ));
        }
        let idle = [
            ("array.pitch", self.pitch.is_some()),
            ("array.extent", self.extent.is_some()),
            ("array.count", self.count.is_some()),
            ("array.elements", self.elements.is_some()),
            ("array.centre", self.centre != Self::before_filling().centre),
        ];
        match idle.into_iter().find(|(_, typed)| *typed) {
            Some((key, _)) => {
                Err(clash(key, &["array.layout"], "with layout \"file\" the positions are the file's own"))
            }
            None => Ok(()),
        }
    }
}

/// The side of a square of so many, if they make one.
pub(in crate::config) fn square_root(elements: u32) -> Option<u32> {
    let side = f64::from(elements).sqrt().round() as u32;
    (side.checked_mul(side) == Some(elements)).then_some(side)
}

impl DetectionTable {
    pub(super) fn check(&self) -> Check {
        within(
            "detection.tolerance",
            self.tolerance,
            0.0,
            0.5,
            "a relative error from 0 (every term) to 0.5",
        )?;
        self.snr_db.map_or(Ok(()), |snr| finite("detection.snr_db", &[snr]))
    }
}
