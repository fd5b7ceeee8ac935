//! What is computed from it, written, and expected.

use crate::config::range::{Check, counts, finite, not_negative, positive, within};
use crate::config::reader::{Fault, joined};
use crate::config::wording::{nearest, quoted};
use crate::config::{DepthTable, ExpectTable, GridTable, OutputTable, ReconstructTable};
use crate::export::Fill;
use crate::grid::View;
use crate::metrics::{METRIC_NAMES, Measure, Metrics};

/// Largest side of a median filter, pixels.
const LARGEST_MEDIAN: u32 = 99;

/// Most pixels of a perspective view.
const MOST_PIXELS: f64 = 1e8;

/// Most seeds that one scene is run with.
const MOST_SEEDS: usize = 1000;

impl GridTable {
    pub(super) fn check(&self) -> Check {
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

impl ReconstructTable {
    pub(super) fn check(&self) -> Check {
        within("reconstruct.tolerance", self.tolerance, 0.0, 0.5, "a relative error from 0 (exact) to 0.5")
    }
}

impl DepthTable {
    pub(super) fn check(&self) -> Check {
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
        let contrast = "depth.return_contrast_db";
        within(contrast, self.return_contrast_db, 0.0, 60.0, "0 dB (none) to 60 dB")?;
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
        self.check_view()?;
        match self.fill {
            Fill::Depth(depth) => finite("depth.fill", &[depth]),
            Fill::Infinity | Fill::NaN => Ok(()),
        }
    }

    fn check_view(&self) -> Check {
        if self.view == View::Orthographic
            && let Some(key) = [("depth.fov", self.fov.is_some()), ("depth.pixels", self.pixels.is_some())]
                .iter()
                .find(|(_, is)| *is)
        {
            return Err(Fault {
                partners: &["depth.view"],
                ..Fault::new(
                    key.0,
                    "is of the perspective view alone; give view = \"perspective\" or leave it out",
                )
            });
        }
        if let Some(fov) = self.fov
            && !(fov > 0.0 && fov < 180.0)
        {
            return Err(Fault::new(
                "depth.fov",
                format!("found {fov:?}; expected degrees between 0 and 180"),
            ));
        }
        self.pixels.map_or(Ok(()), |pixels| counts("depth.pixels", &pixels, MOST_PIXELS))
    }
}

impl OutputTable {
    pub(super) fn check(&self) -> Check {
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

impl ExpectTable {
    pub(super) fn check(&self) -> Check {
        let twice = self.seeds.iter().enumerate().find(|(i, seed)| self.seeds[..*i].contains(seed));
        if let Some((_, seed)) = twice {
            return Err(Fault::new("expect.seeds", format!("names the seed {seed} twice")));
        }
        if self.seeds.len() > MOST_SEEDS {
            return Err(Fault::new("expect.seeds", format!("names more than {MOST_SEEDS} seeds")));
        }
        for (name, limit) in &self.limits {
            let path = joined("expect", name);
            if let Err(metric) = Measure::parse(name) {
                let meant = nearest(&metric, &METRIC_NAMES)
                    .map_or(".".to_owned(), |near| format!("; did you mean `{near}`?"));
                return Err(Fault::new(
                    path,
                    format!(
                        "unknown metric `{}`{meant} (Metrics: {}; `seeds`; of a material \"NAME:MATERIAL\", of the k-th \
                         surface \"NAME#K\".)",
                        quoted(&metric),
                        METRIC_NAMES.join(", ")
                    ),
                ));
            }
            if limit.min.is_none() && limit.max.is_none() {
                return Err(Fault::new(path, "sets no limit; expected { min = .. }, { max = .. } or both"));
            }
            // All but the errors are shares; 65 where 0.65 was meant would never be reached.
            let metric = name.split([':', '#']).next().unwrap_or_default();
            let (most, what) = if Metrics::is_length(metric) {
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
