//! The blocks of one stage in the journal: when they are written, and how long a stop waits for them.

use super::Checkpoint;
use crate::blocks::BlockStore;
use crate::error::{Error, Result};
use crate::progress::{Event, Observer};
use num_complex::Complex32;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long a run may take to finish its block after a stop was requested; then the block is abandoned.
const GRACE_PERIOD: Duration = Duration::from_secs(5);

/// Minimum running time per time spent on writing blocks.
const TIME_PER_WRITING: u32 = 50;

/// The stages whose blocks are stored; each numbers its blocks separately.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
pub(crate) enum Stage {
    /// The simulation; its blocks are tiles of microphones.
    Cube = 1,
    /// The reconstruction; its blocks are depths.
    Volume = 2,
    /// The refinement; its blocks are parts of what it has after a step.
    Refinement = 3,
    /// The reconstruction's sweep, compressed; one block.
    Tones = 4,
    /// The reflectors of a scene; see `pipeline`'s job.
    Reflectors = 5,
    /// The numbers of a simulation's tiles; one block.
    Tiles = 6,
    /// Encoded shards of a volume's Zarr store; see `pipeline`'s job.
    Shards = 7,
    /// Nodes about a boundary between the depths of two processes.
    Nodes = 8,
}

/// An observer that delays a stop until the block in progress is finished and saved, within [`GRACE_PERIOD`].
pub(crate) struct GracefulStop<'a> {
    inner: &'a dyn Observer,
    /// Whether blocks are saved at all.
    waits: bool,
    /// When the request to stop was first noticed.
    requested: OnceLock<Instant>,
    /// Whether all blocks that were finished before the request are saved; those in progress are then not waited for.
    saved: AtomicBool,
}

impl<'a> GracefulStop<'a> {
    /// An observer that passes everything on to `inner`.
    pub(crate) fn new(checkpoint: &Checkpoint, inner: &'a dyn Observer) -> Self {
        let waits = checkpoint.every().is_some();
        inner.grace_period(if waits { GRACE_PERIOD } else { Duration::ZERO });
        Self { inner, waits, requested: OnceLock::new(), saved: AtomicBool::new(false) }
    }
}

impl GracefulStop<'_> {
    /// Ends a job whose blocks are saved, if a stop was requested.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(super) fn give_up_if_asked(&self) -> Result<()> {
        if !self.inner.should_stop() {
            return Ok(());
        }
        self.saved.store(true, Ordering::Relaxed);
        Err(Error::Interrupted)
    }
}

impl Drop for GracefulStop<'_> {
    fn drop(&mut self) {
        self.inner.grace_period(Duration::ZERO);
    }
}

impl Observer for GracefulStop<'_> {
    fn event(&self, event: Event<'_>) {
        self.inner.event(event);
    }

    fn warn(&self, message: &str) {
        self.inner.warn(message);
    }

    fn note(&self, message: &str) {
        self.inner.note(message);
    }

    fn tell(&self, message: &str) {
        self.inner.tell(message);
    }

    fn should_stop(&self) -> bool {
        let at_once = || !self.waits || self.saved.load(Ordering::Relaxed);
        self.inner.should_stop()
            && (at_once() || self.requested.get_or_init(Instant::now).elapsed() > GRACE_PERIOD)
    }
}

/// The blocks of one stage of a job.
pub(crate) struct CheckpointStore<'a> {
    checkpoint: &'a Checkpoint,
    stage: Stage,
    stop: &'a GracefulStop<'a>,
    every: Option<Duration>,
    /// When the last blocks were written, or the stage began.
    last: Instant,
    /// Whether any were; if not, and unless they are due, the stage is younger than an interval.
    pub(super) wrote: bool,
    /// When the current writing of blocks began.
    writing: Option<Instant>,
    /// Minimum pause before the next writing, in proportion to the duration of the last.
    pause: Duration,
}

impl<'a> CheckpointStore<'a> {
    /// The blocks of `stage`; `stop` is the stage's observer.
    pub(crate) fn new(checkpoint: &'a Checkpoint, stage: Stage, stop: &'a GracefulStop<'a>) -> Self {
        let (every, last) = (checkpoint.every(), Instant::now());
        Self { checkpoint, stage, stop, every, last, wrote: false, writing: None, pause: Duration::ZERO }
    }

    /// Whether blocks are stored at all.
    pub(super) fn is_on(&self) -> bool {
        self.every.is_some()
    }
}

impl BlockStore for CheckpointStore<'_> {
    fn load(&mut self, k: u64, block: &mut [Complex32]) -> Result<bool> {
        // Nothing is being computed that a stop would have to wait for.
        self.checkpoint.load(self.stage, k, block, self.stop.inner)
    }

    /// Also `true` as soon as a stop is requested.
    fn is_due(&mut self) -> bool {
        let Some(every) = self.every else { return false };
        let enough = every.is_zero() || self.last.elapsed() >= every.max(self.pause);
        let due = enough || self.stop.inner.should_stop();
        self.writing = due.then(Instant::now);
        due
    }

    fn save(&mut self, k: u64, block: &[Complex32]) {
        self.checkpoint.save(self.stage, k, block, self.stop);
    }

    fn flush(&mut self) -> Result<()> {
        if let Some(start) = self.writing.take() {
            self.pause = start.elapsed() * TIME_PER_WRITING;
        }
        (self.last, self.wrote) = (Instant::now(), true);
        self.stop.give_up_if_asked()
    }
}
