//! What several processes of a job need and one of them finds, as the reflectors of a scene and the compressed sweep.

use super::journal::Journal;
use super::segment::{SegmentWriter, UnfinishedSegment};
use super::{Checkpoint, GracefulStop, Identity, Stage};
use crate::blocks::BlockStore;
use crate::error::{Error, Result};
use crate::progress::Observer;
use crate::reconstruct::CONVOLVED;
use num_complex::Complex32;
use std::path::PathBuf;

/// Blocks in a file of their own, which is named after their identity; like a segment it is never changed.
#[derive(Debug)]
pub(crate) struct SharedBlocks {
    stage: Stage,
    journal: Journal,
}

impl SharedBlocks {
    /// Samples of a block; 0 where there is none.
    pub(crate) fn samples(&self, k: u64) -> u64 {
        self.journal.samples(self.stage, k)
    }

    /// Fills `block`, which has as many samples; `false` where what is stored is damaged.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(crate) fn read(&mut self, k: u64, block: &mut [Complex32], observer: &dyn Observer) -> Result<bool> {
        self.journal.read(self.stage, k, block, observer)
    }
}

impl Checkpoint {
    /// The blocks of a stage that another process has shared under this identity, if there are any.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(crate) fn shared(
        &self,
        identity: &Identity,
        stage: Stage,
        observer: &dyn Observer,
    ) -> Result<Option<SharedBlocks>> {
        let Some(place) = &self.place else { return Ok(None) };
        self.shared_at(place.shared_of(identity), (identity, stage), observer)
    }

    /// The same of a file of another name.
    pub(super) fn shared_at(
        &self,
        path: PathBuf,
        (identity, stage): (&Identity, Stage),
        observer: &dyn Observer,
    ) -> Result<Option<SharedBlocks>> {
        let Some(place) = &self.place else { return Ok(None) };
        // One that is somebody else's is as good as none, of which the units beside it tell enough.
        let journal = Journal::read_only(path, identity, place.secrets.clone(), observer)?.kept_open();
        Ok(journal.has(stage, 0).then_some(SharedBlocks { stage, journal }))
    }

    /// Shares the blocks of a stage under an identity that stores them.
    ///
    /// # Errors
    /// They cannot be written.
    pub(crate) fn share(
        &self,
        identity: &Identity,
        (stage, blocks): (Stage, &[&[Complex32]]),
        observer: &dyn Observer,
    ) -> Result<()> {
        let Some(place) = &self.place else { return Ok(()) };
        let mut file = UnfinishedSegment::new(place, identity, 0, place.shared_of(identity))?;
        for (k, block) in (0..).zip(blocks) {
            file.append(stage, k, block, observer)?;
        }
        file.finish()
    }

    /// Whether a compressed sweep is stored that is to be convolved.
    pub(crate) fn lists_convolved_tones(&self) -> bool {
        self.lists(Stage::Tones, CONVOLVED)
    }

    /// Whether a compressed sweep is stored, intact or not: one that is not empty.
    pub(crate) fn lists_tones(&self) -> bool {
        self.segments().iter().any(|segment| segment.samples(Stage::Tones, 0) > 0)
    }
}

/// The compressed sweep of a job: that of another process, or this one's for others.
pub(crate) struct SharedTones<'a> {
    checkpoint: &'a Checkpoint,
    /// For a process that computes a unit of them.
    writer: Option<SegmentWriter<'a>>,
    stop: &'a GracefulStop<'a>,
    failed: Option<Error>,
    /// Whether those of another process were read.
    loaded: bool,
}

impl<'a> SharedTones<'a> {
    /// `stop` is the stage's observer.
    pub(crate) fn new(
        checkpoint: &'a Checkpoint,
        writer: Option<SegmentWriter<'a>>,
        stop: &'a GracefulStop<'a>,
    ) -> Self {
        Self { checkpoint, writer, stop, failed: None, loaded: false }
    }

    /// Ends a reconstruction; whether this process has computed a unit. One of a job that compresses nothing is empty, if it
    /// `is_missing`.
    ///
    /// # Errors
    /// Those of writing it.
    pub(crate) fn finish(self, is_missing: bool) -> Result<bool> {
        let Some(mut writer) = self.writer else { return Ok(false) };
        let waits = !writer.units.is_empty();
        if waits && is_missing && !self.loaded {
            writer.write(0, &[])?;
        }
        Ok(!waits || is_missing && !self.loaded)
    }
}

impl BlockStore for SharedTones<'_> {
    fn load(&mut self, k: u64, block: &mut [Complex32]) -> Result<bool> {
        let found = self.checkpoint.load(Stage::Tones, k, block, self.stop)?;
        self.loaded |= found;
        Ok(found)
    }

    fn keeps(&self) -> bool {
        self.writer.as_ref().is_some_and(|writer| !writer.units.is_empty())
    }

    /// The first block, by which others know that all are stored, comes last.
    fn save(&mut self, k: u64, block: &[Complex32]) {
        if let Some(writer) = self.writer.as_mut().filter(|_| self.failed.is_none()) {
            let written = if k == 0 { writer.write(k, block) } else { writer.write_with(0, (k, block)) };
            self.failed = written.err();
        }
    }

    fn flush(&mut self) -> Result<()> {
        self.failed.take().map_or(Ok(()), Err)
    }
}
