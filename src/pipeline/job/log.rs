//! Records the seconds of each stage and the warnings of a run.

use crate::progress::{Event, Observer};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// An observer that passes everything on, and records warnings and times.
pub(in crate::pipeline) struct Log<'a> {
    inner: &'a dyn Observer,
    warnings: Mutex<Vec<String>>,
    timings: Mutex<Vec<(String, f64)>>,
}

impl<'a> Log<'a> {
    pub(in crate::pipeline) fn new(inner: &'a dyn Observer) -> Self {
        Self { inner, warnings: Mutex::default(), timings: Mutex::default() }
    }

    /// Runs a stage and records its duration.
    pub(in crate::pipeline) fn timed<T>(&self, stage: &str, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        let seconds = start.elapsed().as_secs_f64();
        self.timings.lock().unwrap_or_else(PoisonError::into_inner).push((stage.to_owned(), seconds));
        result
    }

    /// Timings and warnings, in order.
    pub(in crate::pipeline) fn finish(self) -> (Vec<(String, f64)>, Vec<String>) {
        let timings = self.timings.into_inner().unwrap_or_else(PoisonError::into_inner);
        (timings, self.warnings.into_inner().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Observer for Log<'_> {
    fn event(&self, event: Event<'_>) {
        self.inner.event(event);
    }

    fn note(&self, message: &str) {
        self.inner.note(message);
    }

    fn warn(&self, message: &str) {
        self.warnings.lock().unwrap_or_else(PoisonError::into_inner).push(message.to_owned());
        self.inner.warn(message);
    }

    fn tell(&self, message: &str) {
        self.inner.tell(message);
    }

    fn should_stop(&self) -> bool {
        self.inner.should_stop()
    }

    fn grace_period(&self, longest: Duration) {
        self.inner.grace_period(longest);
    }
}
