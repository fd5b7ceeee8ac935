//! The counts and errors from which the metrics are computed, of a whole map or of a group of surfaces.

use super::cloud::CloudScores;
use super::{Metrics, harmonic_mean, match_one_to_one, percentile};

/// What is known of a true surface at a pixel.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SurfaceFacts {
    /// |n_z|.
    pub(super) facing: Option<f64>,
    /// Whether it continues as a plane around the pixel.
    pub(super) interior: Option<bool>,
    /// Whether it answers loudly enough to be heard.
    pub(super) loud: bool,
}

/// Counts and errors of true surfaces; for a whole map, of pixels.
#[derive(Debug, Clone, Default)]
pub(super) struct ErrorCounts {
    surfaces: usize,
    hits: usize,
    /// Of surfaces whose normals are known, those that continue as a plane around the pixel, and how many were found.
    interior: usize,
    interior_hits: usize,
    /// Of those, the ones that are loud enough, and how many were found.
    audible: usize,
    audible_hits: usize,
    wrong: usize,
    /// Scored detections where there is no surface, and all of them.
    pub(super) on_empty: usize,
    pub(super) outside: usize,
    pub(super) singles: usize,
    pub(super) spurious: usize,
    pub(super) doubles: usize,
    pub(super) both: usize,
    errors: Vec<f64>,
    normal_errors: Vec<f64>,
    /// Errors of the front and of the back surface of two.
    pub(super) of_two: [Vec<f64>; 2],
}

impl ErrorCounts {
    /// Adds a true surface with the |error| of its detection, if there is one.
    pub(super) fn add_surface(&mut self, error: Option<f64>, facts: SurfaceFacts, resolution: f64) {
        self.surfaces += 1;
        let inside = usize::from(facts.interior == Some(true));
        let audible = if facts.loud { inside } else { 0 };
        self.interior += inside;
        self.audible += audible;
        let Some(error) = error else { return };
        if error < resolution {
            self.hits += 1;
            self.interior_hits += inside;
            self.audible_hits += audible;
        }
        self.wrong += usize::from(error > 2.0 * resolution);
        self.errors.push(error);
        self.normal_errors.extend(facts.facing.map(|facing| error * facing));
    }

    /// Adds the true depths of a pixel and the returns found there; shares are counted only if the result has several
    /// returns per pixel, and `spurious` tells whether no surface explains one of them.
    pub(super) fn add_returns(
        &mut self,
        truth: &[f64],
        found: &[f64],
        spurious: Option<&dyn Fn() -> bool>,
        resolution: f64,
    ) {
        let several = spurious.is_some();
        match truth.len() {
            1 if several => self.add_single(found, spurious),
            2 => {
                let matched = match_one_to_one(truth, found);
                let both = matched.iter().all(|error| error.is_some_and(|e| e < resolution));
                self.doubles += usize::from(several);
                self.both += usize::from(several && both);
                for (errors, error) in self.of_two.iter_mut().zip(matched) {
                    errors.extend(error);
                }
            }
            _ => {}
        }
    }

    /// Adds a pixel with one true surface.
    pub(super) fn add_single(&mut self, found: &[f64], spurious: Option<&dyn Fn() -> bool>) {
        self.singles += 1;
        self.spurious += usize::from(found.len() >= 2 && spurious.is_some_and(|spurious| spurious()));
    }

    pub(super) fn join(&mut self, other: Self) {
        self.surfaces += other.surfaces;
        self.hits += other.hits;
        self.interior += other.interior;
        self.interior_hits += other.interior_hits;
        self.audible += other.audible;
        self.audible_hits += other.audible_hits;
        self.wrong += other.wrong;
        self.on_empty += other.on_empty;
        self.outside += other.outside;
        self.singles += other.singles;
        self.spurious += other.spurious;
        self.doubles += other.doubles;
        self.both += other.both;
        self.errors.extend(other.errors);
        self.normal_errors.extend(other.normal_errors);
        for (mine, others) in self.of_two.iter_mut().zip(other.of_two) {
            mine.extend(others);
        }
    }

    /// The metrics; those of clouds of points are of a whole map only.
    pub(super) fn metrics(mut self, cloud: CloudScores) -> Metrics {
        let share = |part: usize, whole: usize| (whole > 0).then(|| part as f64 / whole as f64);
        let square: f64 = self.errors.iter().map(|e| e * e).sum();
        let completeness = share(self.hits, self.surfaces);
        let false_returns = share(self.wrong + self.on_empty, self.errors.len() + self.on_empty);
        let f1 = completeness.map(|found| harmonic_mean(found, 1.0 - false_returns.unwrap_or(1.0)));
        Metrics {
            completeness,
            completeness_interior: share(self.interior_hits, self.interior),
            audible_completeness: share(self.audible_hits, self.audible),
            false_returns,
            outside_returns: share(self.outside, self.errors.len() + self.outside),
            f1,
            f_score: cloud.f_scores[0],
            f_score_2: cloud.f_scores[1],
            chamfer_distance: cloud.chamfer,
            rmse: (!self.errors.is_empty()).then(|| (square / self.errors.len() as f64).sqrt()),
            p95_error: percentile(&mut self.errors, 0.95),
            median_error: percentile(&mut self.errors, 0.5),
            median_normal_error: percentile(&mut self.normal_errors, 0.5),
            two_returns: share(self.both, self.doubles),
            spurious_returns: share(self.spurious, self.singles),
            return1_median_error: percentile(&mut self.of_two[0], 0.5),
            return2_median_error: percentile(&mut self.of_two[1], 0.5),
        }
    }
}
