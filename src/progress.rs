//! How stages report: one [`Observer`], passed to every stage; only the binary displays it.

use crate::error::{Error, Result};
use std::time::Duration;

/// A report of a stage.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Event<'a> {
    /// A stage begins; `total` is its amount of work in units of its own (0: not known).
    Started {
        /// What the stage does, as a short present participle: "simulating".
        stage: &'a str,
        /// Units of work in all.
        total: u64,
    },
    /// `amount` more units of the running stage are done. May come from any thread.
    Advanced {
        /// Units of work done since the last report.
        amount: u64,
    },
    /// The running stage has ended.
    Finished,
}

/// Receives what the stages report. Every method does nothing by default.
pub trait Observer: Sync {
    /// Progress of a stage.
    fn event(&self, _event: Event<'_>) {}
    /// The result of a stage, on one line: "7403 reflectors, 11.4 mm apart".
    fn note(&self, _message: &str) {}
    /// Something that the user should know although the work continues; one sentence or two.
    fn warn(&self, _message: &str) {}
    /// Something about this very run that the user should know, on which no result depends and which no report contains.
    fn tell(&self, _message: &str) {}
    /// Whether the user has asked to stop; stages check it once per block of work.
    fn should_stop(&self) -> bool {
        false
    }
    /// How long the work that follows may take to stop after it was asked to, since it finishes and stores its block first;
    /// zero at first. An observer that ends the process by itself waits for as long.
    fn grace_period(&self, _longest: Duration) {}
}

/// An observer that ignores everything.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Observer for Silent {}

/// The observer of a part of a stage, which may stop it and hears nothing of it: progress is that of the whole.
pub(crate) struct OfPart<'a>(pub(crate) &'a dyn Observer);

impl Observer for OfPart<'_> {
    fn should_stop(&self) -> bool {
        self.0.should_stop()
    }
}

/// Runs `work` as one reported stage of `total` units.
///
/// # Errors
/// Those of `work`; [`Error::Interrupted`] when a stop was requested meanwhile.
pub(crate) fn stage<T>(
    observer: &dyn Observer,
    name: &str,
    total: u64,
    work: impl FnOnce() -> Result<T>,
) -> Result<T> {
    observer.event(Event::Started { stage: name, total });
    let result = work();
    observer.event(Event::Finished);
    if observer.should_stop() { Err(Error::Interrupted) } else { result }
}

/// Reports `amount` units of work.
///
/// # Errors
/// [`Error::Interrupted`] when a stop was requested.
pub(crate) fn advance(observer: &dyn Observer, amount: u64) -> Result<()> {
    observer.event(Event::Advanced { amount });
    if observer.should_stop() { Err(Error::Interrupted) } else { Ok(()) }
}
