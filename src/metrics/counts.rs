//! The counts and errors from which the metrics are computed, of a whole map or of a group of surfaces.

use super::{Metrics, match_one_to_one, percentile};

/// Counts and errors of true surfaces; for a whole map, of pixels.
#[derive(Debug, Clone, Default)]
pub(super) struct ErrorCounts {
    surfaces: usize,
    hits: usize,
    wrong: usize,
    /// Scored detections where there is no surface.
    pub(super) on_empty: usize,
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
    /// Adds a true surface with the |error| of its detection, if there is one, and |n_z|.
    pub(super) fn add_surface(&mut self, error: Option<f64>, facing: Option<f64>, resolution: f64) {
        self.surfaces += 1;
        let Some(error) = error else { return };
        self.hits += usize::from(error < resolution);
        self.wrong += usize::from(error > 2.0 * resolution);
        self.errors.push(error);
        self.normal_errors.extend(facing.map(|facing| error * facing));
    }

    /// Adds the true depths of a pixel and the returns found there; shares are counted only if the result has `several`
    /// returns per pixel.
    pub(super) fn add_returns(&mut self, truth: &[f64], found: &[f64], several: bool, resolution: f64) {
        match truth.len() {
            1 if several => {
                self.singles += 1;
                self.spurious += usize::from(found.len() >= 2);
            }
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

    pub(super) fn join(&mut self, other: Self) {
        self.surfaces += other.surfaces;
        self.hits += other.hits;
        self.wrong += other.wrong;
        self.on_empty += other.on_empty;
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

    pub(super) fn metrics(mut self) -> Metrics {
        let share = |part: usize, whole: usize| (whole > 0).then(|| part as f64 / whole as f64);
        let square: f64 = self.errors.iter().map(|e| e * e).sum();
        Metrics {
            completeness: share(self.hits, self.surfaces),
            false_returns: share(self.wrong + self.on_empty, self.errors.len() + self.on_empty),
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
