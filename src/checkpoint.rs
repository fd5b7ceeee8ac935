//! Checkpoints of long jobs: finished blocks are stored next to the output, and a run after an interruption resumes from
//! them.
//!
//! Takes the identity of a job (`Identity`: everything on which its result depends) and the blocks that its stages finish;
//! returns those of an interrupted run of the same job. The stages do not depend on it: a simulation uses a `BlockStore`,
//! a reconstruction a [`VolumeSink`](crate::reconstruct::VolumeSink).
//!
//! The checkpoint of a job is one hidden file, named after its output and its identity: a *journal*, to which blocks are
//! appended with checksums. A process may be killed at any moment: the block that it was writing is then not a valid
//! record, and is computed again. The checkpoint of another job has another name and identity, so that the two are never
//! mixed; it is deleted, with this job's own, when a job with the same output succeeds. No clock is used except the running
//! time.
//!
//! An output folder may be shared with people who are not trusted. Two things keep their samples out of a result. A journal
//! is a `private` file: ordinary, of this user, with one name, and nobody else may write it; nothing else of its name is
//! opened, followed or waited for. And its checksums are `seal`s, keyed with a `secret` of the user. The first holds where
//! there is no home for a secret; the second where the owner says nothing: a folder of somebody else's that the user has
//! unpacked or copied, a disk that has no owners.
//!
//! Blocks are written at a minimum interval, and writing takes at most a fiftieth of the running time; of a large volume,
//! what the first interval finished is computed again instead. Nothing is forced to the disk: a killed process loses nothing
//! that it wrote, and after a power failure the checksums show which records are intact.

#[cfg(fuzzing)]
#[doc(hidden)] // for `tests/fuzz`
pub mod fuzzing;
mod identity;
mod journal;
mod nodes;
mod private;
mod record;
mod seal;
mod secret;
mod segment;
mod shared;
mod store;
mod volume;

pub(crate) use identity::Identity;
pub(crate) use nodes::SharedNodes;
pub(crate) use record::Records;
#[cfg(feature = "python")]
pub(crate) use secret::of_user as users_secret;
pub(crate) use segment::{ListedTiles, SegmentWriter, UnitBlocks, WantedDepths, WantedTiles};
pub(crate) use shared::{SharedBlocks, SharedTones};
pub(crate) use store::{CheckpointStore, GracefulStop, Stage};
pub(crate) use volume::{BUFFER_BYTES, CheckpointedVolume};

use crate::error::{Error, Result, gib};
use crate::files::{check_is_no_input, free_space, is_input};
use crate::progress::Observer;
use journal::Journal;
use num_complex::Complex32;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The end of the name of every checkpoint.
const SUFFIX: &str = ".resume";

/// Bytes of the disk that remain free in addition to the output.
const MARGIN: u64 = 1 << 20;

/// Where a job stores its finished blocks, and how often; [`Checkpoint::off`] stores nothing.
///
/// [`Checkpoint::remove`] deletes them once the output is complete; if a checkpoint is dropped, the next run of the same job
/// by the same user resumes from them. What is stored is sealed with a secret of the user, which is created in
/// `$XDG_STATE_HOME/holosonar` or `~/.local/state/holosonar` when the first block is stored, if there is such a folder and
/// it can be written.
#[derive(Debug)]
pub struct Checkpoint {
    place: Option<Place>,
    journal: Mutex<Option<Journal>>,
    /// What other processes have computed.
    segments: Mutex<Vec<Journal>>,
    /// Bytes of the disk that are reserved for the output.
    reserved: AtomicU64,
}

#[derive(Debug)]
struct Place {
    folder: PathBuf,
    /// The output's name; the checkpoint's begins with a dot and this name.
    name: String,
    every: Duration,
    /// The folder of the user's secret.
    secrets: Option<PathBuf>,
}

impl Checkpoint {
    /// Nothing is stored, and nothing is resumed.
    pub const fn off() -> Self {
        Self::in_place(None)
    }

    /// In the folder `output` itself; blocks are stored at intervals of `every`, or with zero after every block.
    pub fn within(output: &Path, every: Duration) -> Self {
        Self::at(output.to_owned(), "holosonar".to_owned(), every)
    }

    /// In the same folder as the file `output`; blocks are stored at intervals of `every`, or with zero after every block.
    pub fn beside(output: &Path, every: Duration) -> Self {
        let folder = output.parent().filter(|folder| !folder.as_os_str().is_empty());
        let name = output.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Self::at(folder.unwrap_or(Path::new(".")).to_owned(), name, every)
    }

    fn at(folder: PathBuf, name: String, every: Duration) -> Self {
        Self::in_place(Some(Place { folder, name, every, secrets: secret::folder() }))
    }

    /// Whether nothing is stored.
    pub(crate) const fn is_off(&self) -> bool {
        self.place.is_none()
    }

    const fn in_place(place: Option<Place>) -> Self {
        Self {
            place,
            journal: Mutex::new(None),
            segments: Mutex::new(Vec::new()),
            reserved: AtomicU64::new(0),
        }
    }

    /// Refuses a job whose output of `bytes` does not fit on the disk, before any long work.
    ///
    /// # Errors
    /// [`Error::Io`] when fewer bytes are free.
    pub(crate) fn check_space(&self, bytes: u64) -> Result<()> {
        let Some(place) = &self.place else { return Ok(()) };
        self.reserved.store(bytes, Ordering::Relaxed);
        match free_space(&place.folder) {
            Some(free) if free < bytes => Err(Error::io(
                place.folder.display(),
                format!(
                    "has {} free, and this job writes at least {}; free some space, write elsewhere, or make the grid smaller",
                    gib(free),
                    gib(bytes)
                ),
            )),
            _ => Ok(()),
        }
    }

    /// Opens the checkpoint of the job with this identity, if there is one; otherwise prepares a new one. One that is damaged
    /// or not this user's is reported.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] when another process is working on the same job; [`Error::Interrupted`].
    pub(crate) fn open(&self, identity: &Identity, observer: &dyn Observer) -> Result<()> {
        let Some(place) = &self.place else { return Ok(()) };
        let own = place.checkpoint_of(identity);
        check_is_no_input(&own)?;
        let is_other =
            |path: &PathBuf| *path != own && path.extension().is_some_and(|end| end == &SUFFIX[1..]);
        if place.checkpoints().iter().any(is_other) {
            observer.tell(&format!(
                "{} holds the checkpoint of an interrupted run with other inputs or parameters; it is not used, and is \
                 deleted when this run succeeds",
                place.folder.display()
            ));
        }
        let mut journal = Journal::open(own, identity, place.secrets.clone(), observer)?;
        self.take_segments(identity, observer)?;
        let units = self.segments().len();
        if units > 0 {
            observer.tell(&format!("taking up {units} units that other processes have computed"));
            // While their blocks are read there is a journal, at which a second process notices this one.
            journal.claim(observer)?;
        }
        if let Some(problem) = &journal.problem {
            observer.tell(&format!("{} {problem}", journal.path.display()));
        }
        if journal.blocks() > 0 {
            observer.tell(&format!(
                "resuming an interrupted run: {} blocks of {} are stored",
                journal.blocks(),
                gib(journal.bytes())
            ));
        }
        *self.journal() = Some(journal);
        Ok(())
    }

    fn journal(&self) -> MutexGuard<'_, Option<Journal>> {
        self.journal.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn segments(&self) -> MutexGuard<'_, Vec<Journal>> {
        self.segments.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The interval at which blocks are stored; `None` when they are not.
    fn every(&self) -> Option<Duration> {
        self.place.as_ref().map(|place| place.every)
    }

    /// What is stored and how to resume from it, in words; `None` when nothing is stored.
    pub fn how_to_continue(&self) -> Option<String> {
        let journal = self.journal();
        let journal = journal.as_ref().filter(|journal| journal.blocks() > 0)?;
        Some(format!(
            "{} finished blocks are stored in {}; the same command resumes from there",
            journal.blocks(),
            journal.path.display()
        ))
    }

    /// Deletes the checkpoint, and those of other jobs with this output, when the output is complete.
    pub fn remove(self) {
        // A checkpoint that cannot be deleted does no harm: its identity is checked before it is used.
        let Some(place) = &self.place else { return };
        drop(self.journal().take());
        for path in place.checkpoints() {
            if !is_input(&path) && journal::is_abandoned(&path) {
                let _ = fs::remove_file(path);
            }
        }
    }

    /// Fills `block` from the journal; `false` if the journal has no intact block of this length.
    fn load(&self, stage: Stage, k: u64, block: &mut [Complex32], observer: &dyn Observer) -> Result<bool> {
        if let Some(journal) = self.journal().as_mut()
            && journal.read(stage, k, block, observer)?
        {
            return Ok(true);
        }
        for segment in self.segments().iter_mut().filter(|segment| segment.has(stage, k)) {
            if segment.read(stage, k, block, observer)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Appends a block to the journal. A full disk is reported once, and no further blocks are stored.
    fn save(&self, stage: Stage, k: u64, block: &[Complex32], observer: &dyn Observer) {
        let mut journal = self.journal();
        let (Some(journal), Some(place)) = (journal.as_mut(), &self.place) else { return };
        if journal.closed {
            return;
        }
        let needed = (size_of_val(block) as u64)
            .saturating_add(self.reserved.load(Ordering::Relaxed))
            .saturating_add(MARGIN);
        let problem = if free_space(&place.folder).is_some_and(|free| free < needed) {
            journal.closed = true;
            format!("{} has no space for more than the output", place.folder.display())
        } else {
            let Err(problem) = journal.append(stage, k, block, observer) else { return };
            problem.to_string()
        };
        observer.tell(&format!("{problem}; the run continues, and no further blocks are stored"));
    }
}

impl Place {
    fn checkpoint_of(&self, identity: &Identity) -> PathBuf {
        self.folder.join(format!(".{}.{identity}{SUFFIX}", self.name))
    }

    /// All checkpoints of this output, of any job of this user.
    fn checkpoints(&self) -> Vec<PathBuf> {
        let head = format!(".{}.", self.name);
        let is_checkpoint = |name: &str| {
            name.strip_prefix(&head).is_some_and(|rest| {
                rest.strip_suffix(SUFFIX).is_some_and(Identity::is_written) || Self::is_segment(rest)
            })
        };
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        entries
            .filter(|entry| entry.file_name().to_str().is_some_and(is_checkpoint))
            .map(|entry| entry.path())
            .filter(|path| private::is_private(path))
            .collect()
    }
}

#[cfg(test)]
mod tests;
#[cfg(all(test, unix))]
mod hostile_tests;
