//! The grid, the reconstruction, the depth map, the output files and the expected metrics.

use super::MAX_SAMPLES;
use crate::acquisition::Detection;
use crate::config::range::{
    Check, conflict, counts, ensure, expect, finite, none_typed, not_negative, positive, tolerance, within,
};
use crate::config::reader::{Fault, joined};
use crate::config::{
    DepthTable, ExpectTable, GridTable, OutputTable, ReconstructTable, RefineMethod, RefineTable, RunFile,
};
use crate::export::Fill;
use crate::grid::View;
use crate::metrics::{METRIC_NAMES, Measure, Metrics};
use crate::reconstruct::{MOST_STEPS, Method};
use crate::text::{nearest, quoted};

/// Maximum side of a median filter, pixels.
const MAX_MEDIAN: u32 = 99;

/// Maximum number of pixels of a perspective view.
const MAX_PIXELS: f64 = 1e8;

/// Maximum number of seeds that one scene is run with.
const MAX_SEEDS: usize = 1000;

impl GridTable {
    pub(super) fn check(&self) -> Check {
        if let Some(count) = self.count {
            counts("grid.count", &count, f64::INFINITY)?;
            ensure(self.x.is_some() && self.y.is_some() && self.z.is_some(), || {
                Fault::new("grid.count", "`count` also needs x, y and z")
            })?;
        }
        self.pitch.into_iter().flatten().try_for_each(|pitch| positive("grid.pitch", pitch))?;
        for (axis, (key, ends)) in
            [("grid.x", self.x), ("grid.y", self.y), ("grid.z", self.z)].into_iter().enumerate()
        {
            let Some([first, last]) = ends else { continue };
            finite(key, &[first, last])?;
            ensure(last >= first, || {
                let problem = format!(
                    "the last voxel ({last:?} m) precedes the first ({first:?} m); give [first, last]"
                );
                Fault::new(key, problem)
            })?;
            ensure(key != "grid.z" || first >= 0.0, || {
                let problem =
                    format!("the grid is behind the array (first depth {first:?} m); expected 0 or more");
                Fault::new(key, problem)
            })?;
            let Some(pitch) = self.pitch.map(|pitch| pitch[axis]) else { continue };
            let voxels = ((last - first) / pitch + 1e-6).floor() + 1.0;
            ensure(voxels <= f64::from(u32::MAX), || {
                let problem = format!("{voxels:.3e} voxels along one axis are too many; use a larger pitch");
                Fault::new(key, problem).or_at(&["grid.pitch"])
            })?;
            let Some(count) = self.count.map(|count| count[axis]) else { continue };
            ensure(voxels == f64::from(count), || {
                let problem = format!(
                    "{first:?} to {last:?} m at a pitch of {pitch:?} m are {voxels} voxels, and `count` says {count}; \
                     leave one of the three out"
                );
                Fault::new(key, problem).or_at(&["grid.count", "grid.pitch"])
            })?;
        }
        Ok(())
    }
}

impl ReconstructTable {
    pub(super) fn check(&self) -> Check {
        tolerance("reconstruct.tolerance", self.tolerance)?;
        let Some(tones) = self.sub_band else { return Ok(()) };
        ensure(self.method == Method::Correlation, || {
            let problem = "belongs to method = \"correlation\"; give that, or leave it out";
            Fault::new("reconstruct.sub_band", problem).or_at(&["reconstruct.method"])
        })?;
        ensure(tones >= 1 && f64::from(tones) <= MAX_SAMPLES, || {
            let problem =
                format!("found {tones}; expected 1, each tone by itself, to the number of frequencies");
            Fault::new("reconstruct.sub_band", problem)
        })
    }
}

impl RunFile {
    /// What has no phases between microphones, or is no sum of them.
    pub(super) fn check_correlation(&self) -> Check {
        if self.reconstruct.method != Method::Correlation {
            return Ok(());
        }
        let (refined, in_phase) =
            (self.refine.method != RefineMethod::None, self.detection.kind == Detection::InPhase);
        ensure(!refined, || {
            let why = "a refinement fits a sum of samples, and reconstruct.method = \"correlation\" sums products of them";
            conflict("refine.method", &["reconstruct.method"], why)
        })?;
        ensure(!in_phase, || {
            let why = "\"correlation\" takes phases between microphones, which detection.kind = \"in-phase\" does not have";
            conflict("reconstruct.method", &["detection.kind"], why)
        })?;
        let several = self.array.sources.as_ref().is_some_and(|sources| sources.len() > 1);
        ensure(!(several && self.reconstruct.compensate), || {
            let why = "the powers of several loudspeakers are added, and their voxels have no single factor";
            conflict("reconstruct.compensate", &["reconstruct.method"], why)
        })
    }
}

impl RefineTable {
    pub(super) fn check(&self) -> Check {
        ensure((1..=MOST_STEPS as u32).contains(&self.steps), || {
            Fault::new("refine.steps", format!("found {}; expected 1 to {MOST_STEPS}", self.steps))
        })?;
        let sparsity = (0.0..1.0).contains(&self.sparsity);
        expect("refine.sparsity", self.sparsity, sparsity, "a part of the largest amplitude, 0 to below 1")?;
        not_negative("refine.noise", self.noise.unwrap_or(0.0))
    }
}

impl DepthTable {
    pub(super) fn check(&self) -> Check {
        for (key, level) in [
            ("depth.threshold_db", self.threshold_db.unwrap_or(0.0)),
            ("depth.rim_db", self.rim_db.unwrap_or(0.0)),
            ("depth.return_threshold_db", self.return_threshold_db),
            ("depth.return_gate_db", self.return_gate_db),
        ] {
            within(key, level, f64::MIN, 0.0, "0 dB or less, such as -14.0")?;
        }
        finite("depth.confidence_db", &[self.confidence_db.unwrap_or(0.0)])?;
        ensure((1..=16).contains(&self.returns), || {
            Fault::new("depth.returns", format!("found {}; expected 1 to 16", self.returns))
        })?;
        let contrast = "depth.return_contrast_db";
        within(contrast, self.return_contrast_db, 0.0, 60.0, "0 dB (none) to 60 dB")?;
        positive("depth.separation", self.separation)?;
        self.smoothing.iter().try_for_each(|sigma| not_negative("depth.smoothing", *sigma))?;
        let Self { median, .. } = *self;
        ensure(!median.is_multiple_of(2) && median <= MAX_MEDIAN, || {
            let expected = format!("an odd number of pixels up to {MAX_MEDIAN}, 1 for none");
            Fault::new("depth.median", format!("found {median}; expected {expected}"))
        })?;
        self.check_view()?;
        match self.fill {
            Fill::Depth(depth) => finite("depth.fill", &[depth]),
            Fill::Infinity | Fill::NaN => Ok(()),
        }
    }

    fn check_view(&self) -> Check {
        if self.view == View::Orthographic {
            let of_perspective = [("depth.fov", self.fov.is_some()), ("depth.pixels", self.pixels.is_some())];
            none_typed(&of_perspective, |key| {
                let problem =
                    "applies only to the perspective view; give view = \"perspective\" or leave it out";
                Fault::new(key, problem).or_at(&["depth.view"])
            })?;
        }
        if let Some(fov) = self.fov {
            expect("depth.fov", fov, fov > 0.0 && fov < 180.0, "degrees between 0 and 180")?;
        }
        self.pixels.map_or(Ok(()), |pixels| counts("depth.pixels", &pixels, MAX_PIXELS))
    }
}

impl OutputTable {
    pub(super) fn check(&self) -> Check {
        within(
            "output.vdb_threshold_db",
            self.vdb_threshold_db,
            f64::MIN,
            0.0,
            "0 dB or less, such as -40.0",
        )?;
        let mut formats = self.formats.iter().enumerate();
        let twice = formats.find(|(index, format)| self.formats[..*index].contains(format));
        twice.map_or(Ok(()), |(index, _)| {
            Err(Fault::new(format!("output.formats[{index}]"), "names a format for the second time"))
        })
    }
}

impl ExpectTable {
    pub(super) fn check(&self) -> Check {
        let twice = self.seeds.iter().enumerate().find(|(i, seed)| self.seeds[..*i].contains(seed));
        let fault = |problem: String| Fault::new("expect.seeds", problem);
        twice.map_or(Ok(()), |(_, seed)| Err(fault(format!("names the seed {seed} twice"))))?;
        ensure(self.seeds.len() <= MAX_SEEDS, || fault(format!("names more than {MAX_SEEDS} seeds")))?;
        for (name, limit) in &self.limits {
            let path = joined("expect", name);
            Measure::parse(name).map_err(|metric| {
                let meant = nearest(&metric, &METRIC_NAMES)
                    .map_or(".".to_owned(), |near| format!("; did you mean `{near}`?"));
                let problem = format!(
                    "unknown metric `{}`{meant} (Metrics: {}; `seeds`; of a material \"NAME:MATERIAL\", of the k-th \
                     surface \"NAME#K\".)",
                    quoted(&metric),
                    METRIC_NAMES.join(", ")
                );
                Fault::new(&*path, problem)
            })?;
            let fault = |problem: String| Fault::new(&*path, problem);
            ensure(limit.min.is_some() || limit.max.is_some(), || {
                fault("sets no limit; expected { min = .. }, { max = .. } or both".to_owned())
            })?;
            // All metrics except lengths are fractions; 65 where 0.65 was meant would never be reached.
            let metric = name.split([':', '#']).next().unwrap_or_default();
            let (max, what) = if Metrics::is_length(metric) {
                (f64::MAX, "an error in metres, 0 or more")
            } else {
                (1.0, "a share from 0 to 1")
            };
            for (key, bound) in [("min", limit.min), ("max", limit.max)] {
                bound.map_or(Ok(()), |bound| within(&joined(&path, key), bound, 0.0, max, what))?;
            }
            if let (Some(min), Some(max)) = (limit.min, limit.max) {
                ensure(min <= max, || fault(format!("nothing is at least {min:?} and at most {max:?}")))?;
            }
        }
        Ok(())
    }
}
