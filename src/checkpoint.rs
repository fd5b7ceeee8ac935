//! Block k from disk or computed: what a long job has finished is kept beside its output, and taken up again.
//!
//! Takes the identity of a job ([`Identity`]: all that its result depends on) and the blocks that its stages finish;
//! gives back those of an earlier run of the same job. No stage knows of it: a simulation sees a [`Keeper`], a
//! reconstruction a [`VolumeSink`](crate::reconstruct::VolumeSink).
//!
//! The state of a job is one hidden file, named after its output and its identity: a *journal*, to which blocks are
//! appended with checksums. A process may be killed at any moment: what was being written is then no valid record, and
//! is computed again. The state of another job has another name and identity, so it is never mixed in. It is left alone
//! until a job with the same output succeeds, which removes both. No clock but the running time is looked at.
//!
//! Blocks are written when so many seconds have passed since the last time, and at most a fiftieth of the time is spent on
//! it. Nothing is forced to the disk: a killed process loses nothing of what it wrote, and after a power cut the checksums
//! tell what is whole.

mod identity;
mod journal;
mod volume;

pub use identity::Identity;
pub use volume::KeptVolume;

use crate::error::{Error, Result, gib};
use crate::files::free_space;
use crate::progress::{Event, Keeper, Observer};
use journal::Journal;
use num_complex::Complex32;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// What the names of all states end in.
const SUFFIX: &str = ".resume";

/// A run that is asked to stop may finish its block for so long; then the block is given up.
const PATIENCE: Duration = Duration::from_secs(5);

/// Bytes of a disk that are left beside the output.
const MARGIN: u64 = 1 << 20;

/// Running time for every second that writing blocks takes, at the least.
const SPARED: u32 = 50;

/// The stages whose blocks are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
enum Stage {
    Cube = 1,
    Volume = 2,
}

/// Where a job keeps its state, and how often.
#[derive(Debug)]
pub struct Checkpoint {
    place: Option<Place>,
    journal: Mutex<Option<Journal>>,
    /// Bytes that the output will take of the disk, and no state may.
    reserved: AtomicU64,
}

#[derive(Debug)]
struct Place {
    folder: PathBuf,
    /// Of the output; the state's begins with a dot and this.
    name: String,
    every: Duration,
}

impl Checkpoint {
    /// No state is kept, and none is looked for.
    pub fn off() -> Self {
        Self { place: None, journal: Mutex::new(None), reserved: AtomicU64::new(0) }
    }

    /// State in the folder `output` itself, kept every so often; zero: after every block.
    pub fn within(output: &Path, every: Duration) -> Self {
        Self::at(output.to_owned(), "holosonar".to_owned(), every)
    }

    /// State beside the file `output`, kept every so often; zero: after every block.
    pub fn beside(output: &Path, every: Duration) -> Self {
        let folder = output.parent().filter(|folder| !folder.as_os_str().is_empty());
        let name = output.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Self::at(folder.unwrap_or(Path::new(".")).to_owned(), name, every)
    }

    fn at(folder: PathBuf, name: String, every: Duration) -> Self {
        let place = Some(Place { folder, name, every });
        Self { place, journal: Mutex::new(None), reserved: AtomicU64::new(0) }
    }

    /// Refuses a job whose output takes more than the disk has, before any long work.
    ///
    /// # Errors
    /// [`Error::Io`] when fewer than `bytes` are free.
    pub fn need_space(&self, bytes: u64) -> Result<()> {
        let Some(place) = &self.place else { return Ok(()) };
        self.reserved.store(bytes, Ordering::Relaxed);
        match free_space(&place.folder) {
            Some(free) if free < bytes => Err(Error::io(
                place.folder.display(),
                format!(
                    "has {} free, and this job writes {} at the least; make room, write elsewhere, or make the grid smaller",
                    gib(free),
                    gib(bytes)
                ),
            )),
            _ => Ok(()),
        }
    }

    /// Takes up the state of the job of this identity, if there is one; else prepares to keep some.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] when another process is at this very job; [`Error::Io`] when its state cannot be read.
    pub fn open(&self, identity: &Identity, observer: &dyn Observer) -> Result<()> {
        let Some(place) = &self.place else { return Ok(()) };
        let own = place.state_of(identity);
        if place.states().iter().any(|path| *path != own) {
            observer.tell(&format!(
                "{} holds the state of an interrupted run with other inputs or parameters; it is not used, and goes when \
                 this run succeeds",
                place.folder.display()
            ));
        }
        let journal = Journal::open(own, identity)?;
        if journal.blocks() > 0 {
            observer.tell(&format!(
                "continuing an interrupted run: {} blocks of {} are at hand",
                journal.blocks(),
                gib(journal.bytes())
            ));
        } else if journal.was_damaged() {
            observer.tell(&format!("{} holds no whole block; beginning anew", journal.path().display()));
        }
        *self.journal() = Some(journal);
        Ok(())
    }

    fn journal(&self) -> MutexGuard<'_, Option<Journal>> {
        self.journal.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether anything is kept.
    fn every(&self) -> Option<Duration> {
        self.place.as_ref().map(|place| place.every)
    }

    /// The keeper of a simulation's blocks.
    pub fn cube<'a>(&'a self, observer: &'a Patient<'a>) -> KeptCube<'a> {
        KeptCube { pace: Pace::new(self, observer) }
    }

    /// What is kept and how to go on from it, in words; `None` when nothing is.
    pub fn how_to_continue(&self) -> Option<String> {
        let journal = self.journal();
        let journal = journal.as_ref().filter(|journal| journal.blocks() > 0)?;
        Some(format!(
            "{} finished blocks are kept in {}: the same command goes on from there",
            journal.blocks(),
            journal.path().display()
        ))
    }

    /// Removes the state, and what other runs with this output left, now that the output is complete.
    pub fn remove(self) {
        // State that cannot be removed does no harm: it is of an identity that is checked.
        let Some(place) = &self.place else { return };
        drop(self.journal().take());
        for path in place.states() {
            if !journal::is_in_use(&path) {
                let _ = fs::remove_file(path);
            }
        }
    }

    /// What a block in the journal holds, if it is there and whole.
    fn recall(&self, stage: Stage, k: u64, block: &mut Vec<Complex32>) -> bool {
        self.journal().as_mut().is_some_and(|journal| journal.read(stage, k, block))
    }

    /// Appends blocks to the journal; a disk that takes no more is told of once, and ends the keeping.
    fn write(&self, stage: Stage, k: u64, block: &[Complex32], observer: &dyn Observer) {
        let mut journal = self.journal();
        let (Some(journal), Some(place)) = (journal.as_mut(), &self.place) else { return };
        if journal.is_closed() {
            return;
        }
        let needed = (size_of_val(block) as u64)
            .saturating_add(self.reserved.load(Ordering::Relaxed))
            .saturating_add(MARGIN);
        let problem = if free_space(&place.folder).is_some_and(|free| free < needed) {
            journal.close();
            format!("{} has no room for more than the output", place.folder.display())
        } else {
            let Err(problem) = journal.append(stage, k, block) else { return };
            problem.to_string()
        };
        observer.tell(&format!("{problem}; going on without keeping more"));
    }
}

impl Place {
    fn state_of(&self, identity: &Identity) -> PathBuf {
        self.folder.join(format!(".{}.{identity}{SUFFIX}", self.name))
    }

    /// All states of this output, of whatever job.
    fn states(&self) -> Vec<PathBuf> {
        let head = format!(".{}.", self.name);
        let is_state = |name: &str| {
            let key = name.strip_prefix(&head).and_then(|rest| rest.strip_suffix(SUFFIX));
            key.is_some_and(Identity::is_written)
        };
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        entries.filter(|entry| entry.file_name().to_str().is_some_and(is_state)).map(|e| e.path()).collect()
    }
}

/// An observer for stages whose blocks are kept: asked to stop, it lets a block end first, if that does not take long.
pub struct Patient<'a> {
    inner: &'a dyn Observer,
    /// Whether anything is kept at all.
    waits: bool,
    asked: OnceLock<Instant>,
    /// What was finished when the user asked to stop is kept; what is being worked on meanwhile is not waited for.
    saved: AtomicBool,
}

impl std::fmt::Debug for Patient<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Patient").field("waits", &self.waits).finish_non_exhaustive()
    }
}

impl<'a> Patient<'a> {
    /// An observer that hands everything on.
    pub fn new(checkpoint: &Checkpoint, inner: &'a dyn Observer) -> Self {
        Self {
            inner,
            waits: checkpoint.place.is_some(),
            asked: OnceLock::new(),
            saved: AtomicBool::new(false),
        }
    }
}

impl Observer for Patient<'_> {
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
        self.inner.should_stop() && (at_once() || self.asked.get_or_init(Instant::now).elapsed() > PATIENCE)
    }
}

/// When blocks are to be written.
struct Pace<'a> {
    checkpoint: &'a Checkpoint,
    observer: &'a Patient<'a>,
    every: Option<Duration>,
    last: Instant,
    /// Since when blocks are being written.
    writing: Option<Instant>,
    /// How long to wait at least, for what the last time took.
    spared: Duration,
}

impl<'a> Pace<'a> {
    fn new(checkpoint: &'a Checkpoint, observer: &'a Patient<'a>) -> Self {
        let every = checkpoint.every();
        Self { checkpoint, observer, every, last: Instant::now(), writing: None, spared: Duration::ZERO }
    }

    /// Whether it is time; then [`Pace::rest`] must follow.
    fn is_due(&mut self) -> bool {
        let Some(every) = self.every else { return false };
        let enough = every.is_zero() || self.last.elapsed() >= every.max(self.spared);
        let due = enough || self.observer.inner.should_stop();
        self.writing = due.then(Instant::now);
        due
    }

    fn write(&self, stage: Stage, k: u64, block: &[Complex32]) {
        self.checkpoint.write(stage, k, block, self.observer);
    }

    /// Ends the writing; [`Error::Interrupted`] when the user wants to stop.
    fn rest(&mut self) -> Result<()> {
        if let Some(begun) = self.writing.take() {
            self.spared = begun.elapsed() * SPARED;
        }
        self.last = Instant::now();
        if !self.observer.inner.should_stop() {
            return Ok(());
        }
        self.observer.saved.store(true, Ordering::Relaxed);
        Err(Error::Interrupted)
    }
}

/// Keeps the tiles of a simulated cube.
pub struct KeptCube<'a> {
    pace: Pace<'a>,
}

impl std::fmt::Debug for KeptCube<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("KeptCube")
    }
}

impl Keeper for KeptCube<'_> {
    fn recall(&mut self, k: u64, block: &mut [Complex32]) -> Result<bool> {
        let mut found = Vec::new();
        if !self.pace.checkpoint.recall(Stage::Cube, k, &mut found) || found.len() != block.len() {
            return Ok(false);
        }
        block.copy_from_slice(&found);
        Ok(true)
    }

    fn is_due(&mut self) -> bool {
        self.pace.is_due()
    }

    fn keep(&mut self, k: u64, block: &[Complex32]) -> Result<()> {
        self.pace.write(Stage::Cube, k, block);
        Ok(())
    }

    fn kept(&mut self) -> Result<()> {
        self.pace.rest()
    }
}

#[cfg(test)]
mod tests;
