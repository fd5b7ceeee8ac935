//! Segments: what other processes have computed of a job, one file for each unit of its work.
//!
//! A segment is a journal that is complete: it was written under a temporary name and renamed, and is never changed. So
//! nobody has to lock it, and a process that is killed leaves none. Whoever images the job takes up all that there are, and
//! computes what is missing. Two processes that compute the same unit write the same bytes, of which the later stay.

use super::journal::Journal;
use super::{Checkpoint, GracefulStop, Identity, Place, Stage};
use crate::alloc::try_zeroed;
use crate::blocks::BlockStore;
use crate::error::{Error, Result};
use crate::progress::Observer;
use crate::reconstruct::{ReconstructionInfo, VolumeSink, needed_among};
use num_complex::Complex32;
use std::collections::HashMap;
use std::fs;
use std::ops::Range;
use std::path::PathBuf;

/// The end of the name of a segment.
const SUFFIX: &str = ".unit";

/// The end of the name of nodes that two processes share: no unit, and of no use where these share no folder.
const NODES: &str = ".nodes";

/// The end of the name of one that is being written.
const UNFINISHED: &str = ".part";

/// The blocks of a unit of work.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct UnitBlocks {
    /// Its number in the job.
    pub(crate) unit: u64,
    /// Tiles of microphones, depths, or shards.
    pub(crate) blocks: Vec<u64>,
}

impl Place {
    fn segment_of(&self, identity: &Identity, unit: u64) -> PathBuf {
        self.folder.join(format!(".{}.{identity}.{unit}{SUFFIX}", self.name))
    }

    /// What all processes of a job need: of an identity of its own, and of no unit.
    pub(super) fn shared_of(&self, identity: &Identity) -> PathBuf {
        self.folder.join(format!(".{}.{identity}.shared{SUFFIX}", self.name))
    }

    /// What two processes of a job need, of an identity of its own.
    pub(super) fn nodes_of(&self, identity: &Identity) -> PathBuf {
        self.folder.join(format!(".{}.{identity}{NODES}", self.name))
    }

    /// A name that no other process has, on whatever host.
    fn unfinished_segment_of(&self, identity: &Identity, unit: u64) -> Result<PathBuf> {
        let mut random = [0; 8];
        getrandom::fill(&mut random).map_err(|error| Error::io(self.folder.display(), error.to_string()))?;
        let random = u64::from_le_bytes(random);
        Ok(self.folder.join(format!(".{}.{identity}.{unit}.{random:016x}{UNFINISHED}", self.name)))
    }

    /// The files of this job's segments, by unit, and the number of those of other jobs.
    fn segments(&self, identity: &Identity) -> (Vec<(u64, PathBuf)>, usize) {
        let head = format!(".{}.", self.name);
        let own = identity.to_string();
        let (mut found, mut others) = (Vec::new(), 0);
        for entry in fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            let name = entry.file_name();
            let Some(rest) = name.to_str().and_then(|name| name.strip_prefix(&head)?.strip_suffix(SUFFIX))
            else {
                continue;
            };
            let Some((key, unit)) = rest.split_once('.') else { continue };
            let Ok(unit) = unit.parse() else { continue };
            if key == own {
                found.push((unit, entry.path()));
            } else if Identity::is_written(key) {
                others += 1;
            }
        }
        found.sort();
        (found, others)
    }

    /// Whether a name after the output's is that of a segment, finished or not, or of nodes.
    pub(super) fn is_segment(rest: &str) -> bool {
        if rest.strip_suffix(NODES).is_some_and(Identity::is_written) {
            return true;
        }
        let key = rest.strip_suffix(SUFFIX).or_else(|| rest.strip_suffix(UNFINISHED));
        key.and_then(|key| key.split_once('.')).is_some_and(|(key, _)| Identity::is_written(key))
    }
}

impl Checkpoint {
    /// Takes up the segments of this job; those of others are reported.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(crate) fn take_segments(&self, identity: &Identity, observer: &dyn Observer) -> Result<()> {
        let Some(place) = &self.place else { return Ok(()) };
        let (found, others) = place.segments(identity);
        if others > 0 {
            observer.tell(&format!(
                "{} holds {others} units of other work: of another job, of a run file that was changed, of another version of \
                 the program, or from a processor of another kind (this one has {}); they are not used",
                place.folder.display(),
                crate::wave::simd::Level::of_processor().as_str()
            ));
        }
        let mut segments = Vec::with_capacity(found.len());
        for (_, path) in found {
            let segment = Journal::read_only(path, identity, place.secrets.clone(), observer)?;
            if let Some(problem) = &segment.problem {
                observer.tell(&format!("{} {problem}", segment.path.display()));
            }
            segments.push(segment);
        }
        *self.segments() = segments;
        Ok(())
    }

    /// Whether the blocks of a unit are all stored, intact or not.
    pub(crate) fn lists_unit(&self, stage: Stage, unit: &UnitBlocks) -> bool {
        unit.blocks.iter().all(|k| self.lists(stage, *k))
    }

    /// The same of one block.
    pub(super) fn lists(&self, stage: Stage, k: u64) -> bool {
        self.segments().iter().any(|segment| segment.has(stage, k))
    }

    /// Whether the blocks of a unit are all stored, and intact: all are read.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(crate) fn has_unit(&self, stage: Stage, unit: &UnitBlocks, observer: &dyn Observer) -> Result<bool> {
        for k in &unit.blocks {
            if self.stored(stage, *k, observer)?.is_none() {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// A block of a segment, whatever its length, if there is one that is intact and fits in memory.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(crate) fn stored(
        &self,
        stage: Stage,
        k: u64,
        observer: &dyn Observer,
    ) -> Result<Option<Vec<Complex32>>> {
        for segment in self.segments().iter_mut().filter(|segment| segment.has(stage, k)) {
            let Some(mut block) = try_zeroed(segment.samples(stage, k)) else { continue };
            if segment.read(stage, k, &mut block, observer)? {
                return Ok(Some(block));
            }
        }
        Ok(None)
    }
}

/// The segment that is being written; it is deleted unless it is finished.
pub(super) struct UnfinishedSegment {
    journal: Option<Journal>,
    path: PathBuf,
}

impl UnfinishedSegment {
    /// One that is to have this path, for blocks of this identity.
    pub(super) fn new(place: &Place, identity: &Identity, unit: u64, path: PathBuf) -> Result<Self> {
        let unfinished = place.unfinished_segment_of(identity, unit)?;
        Ok(Self { journal: Some(Journal::new(unfinished, identity, place.secrets.clone())), path })
    }

    pub(super) fn append(
        &mut self,
        stage: Stage,
        k: u64,
        block: &[Complex32],
        observer: &dyn Observer,
    ) -> Result<()> {
        self.journal.as_mut().map_or(Ok(()), |journal| journal.append(stage, k, block, observer))
    }

    /// Gives it its name.
    pub(super) fn finish(mut self) -> Result<()> {
        self.journal.take().map_or(Ok(()), |journal| journal.rename(&self.path))
    }
}

impl Drop for UnfinishedSegment {
    fn drop(&mut self) {
        if let Some(journal) = self.journal.take() {
            // One that cannot be deleted is deleted with the checkpoint of the job.
            let _ = fs::remove_file(&journal.path);
        }
    }
}

/// Writes the blocks of units into their segments.
pub(crate) struct SegmentWriter<'a> {
    checkpoint: &'a Checkpoint,
    identity: &'a Identity,
    stage: Stage,
    /// The unit of every block that is wanted and not written yet.
    pub(super) units: HashMap<u64, u64>,
    unfinished: HashMap<u64, UnfinishedSegment>,
    observer: &'a dyn Observer,
}

impl<'a> SegmentWriter<'a> {
    /// Of these units of a stage.
    pub(crate) fn new(
        checkpoint: &'a Checkpoint,
        identity: &'a Identity,
        (stage, units): (Stage, &[UnitBlocks]),
        observer: &'a dyn Observer,
    ) -> Self {
        let units = units.iter().flat_map(|unit| unit.blocks.iter().map(|k| (*k, unit.unit))).collect();
        Self { checkpoint, identity, stage, units, unfinished: HashMap::new(), observer }
    }

    /// Writes a block, unless it is of no unit that is wanted; the last of a unit finishes its segment.
    pub(crate) fn write(&mut self, k: u64, block: &[Complex32]) -> Result<()> {
        let Some(unit) = self.units.remove(&k) else { return Ok(()) };
        let Some(segment) = self.appended(unit, (k, block))? else { return Ok(()) };
        if self.units.values().any(|other| *other == unit) {
            self.unfinished.insert(unit, segment);
            return Ok(());
        }
        segment.finish()
    }

    /// Writes a block of no number of its own into the segment of one that comes `later`, unless that is of no unit that is
    /// wanted.
    pub(super) fn write_with(&mut self, later: u64, block: (u64, &[Complex32])) -> Result<()> {
        let Some(unit) = self.units.get(&later).copied() else { return Ok(()) };
        if let Some(segment) = self.appended(unit, block)? {
            self.unfinished.insert(unit, segment);
        }
        Ok(())
    }

    /// The segment of a unit with one more block.
    fn appended(&mut self, unit: u64, (k, block): (u64, &[Complex32])) -> Result<Option<UnfinishedSegment>> {
        let Some(place) = &self.checkpoint.place else { return Ok(None) };
        let mut segment = if let Some(segment) = self.unfinished.remove(&unit) {
            segment
        } else {
            UnfinishedSegment::new(place, self.identity, unit, place.segment_of(self.identity, unit))?
        };
        segment.append(self.stage, k, block, self.observer)?;
        Ok(Some(segment))
    }
}

/// The tiles of a simulation of which some are computed for their segments, by `plans` that may be stored.
pub(crate) struct WantedTiles<'a> {
    writer: SegmentWriter<'a>,
    plans: &'a mut dyn BlockStore,
    stop: &'a GracefulStop<'a>,
    failed: Option<Error>,
}

impl<'a> WantedTiles<'a> {
    pub(crate) fn new(
        writer: SegmentWriter<'a>,
        plans: &'a mut dyn BlockStore,
        stop: &'a GracefulStop<'a>,
    ) -> Self {
        Self { writer, plans, stop, failed: None }
    }
}

impl BlockStore for WantedTiles<'_> {
    fn load(&mut self, k: u64, block: &mut [Complex32]) -> Result<bool> {
        self.plans.load(k, block)
    }

    fn skips(&mut self, k: u64) -> bool {
        !self.writer.units.contains_key(&k)
    }

    fn is_due(&mut self) -> bool {
        true
    }

    fn save(&mut self, k: u64, block: &[Complex32]) {
        if self.failed.is_none() {
            self.failed = self.writer.write(k, block).err();
        }
    }

    fn flush(&mut self) -> Result<()> {
        // Here the segments are the result: without them nothing is worth computing.
        self.failed.take().map_or(Ok(()), Err)?;
        self.stop.give_up_if_asked()
    }
}

/// Computes nothing, and lists the tiles that there are, and the plans by which they are simulated.
#[derive(Debug, Default)]
pub(crate) struct ListedTiles {
    pub(crate) tiles: Vec<u64>,
    pub(crate) plans: Vec<(u64, Vec<Complex32>)>,
}

impl BlockStore for ListedTiles {
    fn skips(&mut self, k: u64) -> bool {
        self.tiles.push(k);
        true
    }

    fn keeps(&self) -> bool {
        true
    }

    fn save(&mut self, k: u64, plan: &[Complex32]) {
        self.plans.push((k, plan.to_vec()));
    }
}

/// The depths of a volume of which some are computed for their segments.
pub(crate) struct WantedDepths<'a> {
    writer: SegmentWriter<'a>,
    /// Samples of a depth.
    plane_len: usize,
    stop: &'a GracefulStop<'a>,
}

impl<'a> WantedDepths<'a> {
    pub(crate) fn new(writer: SegmentWriter<'a>, plane_len: usize, stop: &'a GracefulStop<'a>) -> Self {
        Self { writer, plane_len, stop }
    }
}

impl VolumeSink for WantedDepths<'_> {
    fn begin(&mut self, _: &ReconstructionInfo) -> Result<()> {
        Ok(())
    }

    fn take(&mut self, first: usize, planes: &[Complex32]) -> Result<()> {
        let planes = planes.chunks_exact(self.plane_len);
        (first as u64..).zip(planes).try_for_each(|(depth, plane)| self.writer.write(depth, plane))?;
        self.stop.give_up_if_asked()
    }

    fn wanted(&self, depths: Range<usize>) -> Range<usize> {
        needed_among(depths, |depth| self.writer.units.contains_key(&(depth as u64)))
    }
}

#[cfg(test)]
mod tests;
