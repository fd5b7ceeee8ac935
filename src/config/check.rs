//! What a run file must fulfil beyond its types: ranges, and keys that must agree with each other.

use super::range::{Check, clash, counts, finite, named, not_negative, positive, within};
use super::reader::{Fault, joined};
use super::wording::{nearest, quoted};
use super::{
    Array, Depth, Detection, Expect, Fill, Geometry, GridTable, Layout, MaterialRule, Medium, Output,
    Reconstruct, Reflectors, RunFile, Scene, Sweep,
};
use crate::metrics::METRIC_NAMES;

/// Most frequencies, and most microphones, that anyone could mean.
const MOST_SAMPLES: f64 = 1e8;

/// Largest side of a median filter, pixels.
const LARGEST_MEDIAN: u32 = 99;

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

impl Scene {
    fn check(&self) -> Check {
        named("scene.mesh", self.mesh.as_ref())?;
        positive("scene.scale", self.scale)?;
        finite("scene.rotate", &self.rotate)?;
        finite("scene.translate", self.translate.as_ref().map_or(&[], |v| &v[..]))?;
        finite("scene.fit", self.fit.as_ref().map_or(&[], |v| &v[..]))?;
        if self.fit.is_some() && self.translate.is_some() {
            return Err(clash(
                "scene.fit",
                &["scene.translate"],
                "`fit` and `translate` both place the mesh",
            ));
        }
        let Some(sensor) = &self.sensor else { return Ok(()) };
        let name = sensor.strip_prefix("camera:").or_else(|| sensor.strip_prefix("node:"));
        if name.is_none_or(str::is_empty) {
            return Err(Fault::new(
                "scene.sensor",
                format!(
                    "found \"{}\"; expected \"camera:NAME\" or \"node:NAME\" of the glTF file",
                    quoted(sensor)
                ),
            ));
        }
        if self.fit.is_some() {
            return Err(clash(
                "scene.fit",
                &["scene.sensor"],
                "`fit` and `sensor` both say where the mesh stands",
            ));
        }
        Ok(())
    }
}

impl MaterialRule {
    fn check(&self, path: &str) -> Check {
        if self.name.is_empty() {
            return Err(Fault::new(joined(path, "name"), "is empty; \"*\" matches every name"));
        }
        for (key, share) in [("reflectance", self.reflectance), ("transmittance", self.transmittance)] {
            if let Some(share) = share {
                within(&joined(path, key), share, 0.0, 1.0, "a share of the amplitude from 0 to 1")?;
            }
        }
        Ok(())
    }
}

impl Reflectors {
    fn check(&self) -> Check {
        self.spacing.map_or(Ok(()), |spacing| positive("reflectors.spacing", spacing))?;
        not_negative("reflectors.roughness", self.roughness)
    }
}

impl Medium {
    fn check(&self) -> Check {
        positive("medium.sound_speed", self.sound_speed)
    }
}

impl Sweep {
    fn check(&self) -> Check {
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
    fn check(&self) -> Check {
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
    fn check(&self) -> Check {
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

impl GridTable {
    fn check(&self) -> Check {
        if let Some(count) = self.count {
            counts("grid.count", &count, f64::INFINITY)?;
            if self.x.is_none() || self.y.is_none() || self.z.is_none() {
                return Err(Fault::new("grid.count", "`count` needs x, y and z beside it"));
            }
        }
        for pitch in self.pitch.into_iter().flatten() {
            positive("grid.pitch", pitch)?;
        }
        for (axis, (key, ends)) in
            [("grid.x", self.x), ("grid.y", self.y), ("grid.z", self.z)].into_iter().enumerate()
        {
            let Some([first, last]) = ends else { continue };
            finite(key, &[first, last])?;
            if last < first {
                return Err(Fault::new(
                    key,
                    format!(
                        "the last voxel ({last:?} m) lies before the first ({first:?} m); give [first, last]"
                    ),
                ));
            }
            if key == "grid.z" && first < 0.0 {
                return Err(Fault::new(
                    key,
                    format!("the grid lies behind the array (first depth {first:?} m); expected 0 or more"),
                ));
            }
            let Some(pitch) = self.pitch.map(|pitch| pitch[axis]) else { continue };
            let voxels = ((last - first) / pitch + 1e-6).floor() + 1.0;
            let fault = |problem: String| Fault { partners: &["grid.pitch"], ..Fault::new(key, problem) };
            if voxels > f64::from(u32::MAX) {
                return Err(fault(format!(
                    "{voxels:.3e} voxels along one axis are too many; use a larger pitch"
                )));
            }
            if let Some(count) = self.count.map(|count| count[axis])
                && voxels != f64::from(count)
            {
                return Err(Fault {
                    partners: &["grid.count", "grid.pitch"],
                    ..Fault::new(
                        key,
                        format!(
                            "{first:?} to {last:?} m at a pitch of {pitch:?} m are {voxels} voxels, and `count` says \
                             {count}; leave one of the three out"
                        ),
                    )
                });
            }
        }
        Ok(())
    }
}

impl Reconstruct {
    fn check(&self) -> Check {
        within("reconstruct.tolerance", self.tolerance, 0.0, 0.5, "a relative error from 0 (exact) to 0.5")
    }
}

impl Depth {
    fn check(&self) -> Check {
        for (key, level) in [
            ("depth.threshold_db", self.threshold_db),
            ("depth.return_threshold_db", self.return_threshold_db),
            ("depth.return_gate_db", self.return_gate_db),
        ] {
            if !(level.is_finite() && level <= 0.0) {
                return Err(Fault::new(
                    key,
                    format!("found {level:?}; expected 0 dB or less, such as -14.0"),
                ));
            }
        }
        if !(1..=16).contains(&self.returns) {
            return Err(Fault::new("depth.returns", format!("found {}; expected 1 to 16", self.returns)));
        }
        positive("depth.separation", self.separation)?;
        for sigma in self.smoothing {
            not_negative("depth.smoothing", sigma)?;
        }
        if self.median.is_multiple_of(2) || self.median > LARGEST_MEDIAN {
            return Err(Fault::new(
                "depth.median",
                format!(
                    "found {}; expected an odd number of pixels up to {LARGEST_MEDIAN}, 1 for none",
                    self.median
                ),
            ));
        }
        match self.fill {
            Fill::Depth(depth) => finite("depth.fill", &[depth]),
            Fill::Inf | Fill::Nan => Ok(()),
        }
    }
}

impl Output {
    fn check(&self) -> Check {
        for (index, format) in self.formats.iter().enumerate() {
            if self.formats[..index].contains(format) {
                return Err(Fault::new(
                    format!("output.formats[{index}]"),
                    "names a format for the second time",
                ));
            }
        }
        Ok(())
    }
}

impl Expect {
    fn check(&self) -> Check {
        for (name, limit) in &self.limits {
            let path = joined("expect", name);
            if !METRIC_NAMES.contains(&name.as_str()) {
                let meant = nearest(name, &METRIC_NAMES)
                    .map_or(".".to_owned(), |near| format!("; did you mean `{near}`?"));
                return Err(Fault::new(
                    path,
                    format!(
                        "unknown metric `{}`{meant} (Metrics: {}.)",
                        quoted(name),
                        METRIC_NAMES.join(", ")
                    ),
                ));
            }
            if limit.min.is_none() && limit.max.is_none() {
                return Err(Fault::new(path, "sets no limit; expected { min = .. }, { max = .. } or both"));
            }
            // All but the errors are shares; 65 where 0.65 was meant would never be reached.
            let (most, what) = if name.ends_with("error") || name == "rmse" {
                (f64::MAX, "an error in metres, 0 or more")
            } else {
                (1.0, "a share from 0 to 1")
            };
            for (key, bound) in [("min", limit.min), ("max", limit.max)] {
                if let Some(bound) = bound {
                    within(&joined(&path, key), bound, 0.0, most, what)?;
                }
            }
            if let (Some(min), Some(max)) = (limit.min, limit.max)
                && min > max
            {
                return Err(Fault::new(path, format!("nothing is at least {min:?} and at most {max:?}")));
            }
        }
        Ok(())
    }
}
