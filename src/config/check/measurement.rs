//! What it is measured with.

use super::MOST_SAMPLES;
use crate::config::range::{Check, clash, counts, finite, named, not_negative, positive, within};
use crate::config::reader::Fault;
use crate::config::{Array, Detection, Geometry, Layout, Medium, Sweep};

impl Medium {
    pub(super) fn check(&self) -> Check {
        positive("medium.sound_speed", self.sound_speed)
    }
}

impl Sweep {
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

impl Array {
    pub(super) fn check(&self) -> Check {
        finite("array.source", &self.source)?;
        finite("array.centre", &self.centre)?;
        if self.geometry == Geometry::Monostatic && self.source != [0.0; 3] {
            return Err(clash(
                "array.source",
                &["array.geometry"],
                "a monostatic scan has no speaker of its own",
            ));
        }
        counts("array.count", &self.count, MOST_SAMPLES)?;
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
        for (extent, count) in self.extent.into_iter().flatten().zip(self.count) {
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
        self.check_layout()
    }

    fn check_layout(&self) -> Check {
        named("array.file", self.file.as_ref())?;
        match (self.layout, &self.file) {
            (Layout::Grid, None) => Ok(()),
            (Layout::Grid, Some(_)) => {
                Err(clash("array.file", &["array.layout"], "a file of microphones needs `layout = \"file\"`"))
            }
            (Layout::File, None) => Err(Fault::new(
                "array.layout",
                "layout \"file\" needs the key `file`, a CSV with the header x,y,z in metres",
            )),
            (Layout::File, Some(_)) => {
                let plain = Self::before_filling();
                let idle = [
                    ("array.pitch", self.pitch.is_some()),
                    ("array.extent", self.extent.is_some()),
                    ("array.count", self.count != plain.count),
                    ("array.centre", self.centre != plain.centre),
                ];
                match idle.into_iter().find(|(_, typed)| *typed) {
                    Some((key, _)) => Err(clash(
                        key,
                        &["array.layout"],
                        "with layout \"file\" the positions are the file's own",
                    )),
                    None => Ok(()),
                }
            }
        }
    }
}

impl Detection {
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
