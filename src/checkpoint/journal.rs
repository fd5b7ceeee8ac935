//! The file to which blocks are appended.
//!
//! The file begins with a heading of 96 bytes: `holosonar state\n`, the version of the format (u64), `0` (u64), 32 zeros and
//! the [seal](super::seal) of the bytes before it. Records follow, each with such a heading (`stage`, `block`, `bytes`, `0`:
//! u64; the seal of the samples; the seal of the bytes before it) and the bytes of the samples. All numbers are
//! little-endian, except the samples, which are in the processor's own order (the processor is part of the identity).
//! Reading stops at the first invalid heading, or at a record that the job cannot have written; blocks with invalid samples
//! are computed again.
//!
//! Only a [private] file is read, and only this user can seal one; whatever else has its name is removed when the first
//! block is stored, and never written to.

use super::private::{self, Found, Others};
use super::seal::{HEADING, Heading, Seal, is_equal};
use super::{Identity, Stage, secret};
use crate::error::{Error, Result};
use crate::files::NewFolders;
use crate::progress::Observer;
use num_complex::Complex32;
use std::collections::HashMap;
use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Version of the format. The first had checksums that anybody could make.
const VERSION: u64 = 2;

const FILE_HEADING: Heading = Heading {
    words: [u64::from_le_bytes(*b"holosona"), u64::from_le_bytes(*b"r state\n"), VERSION, 0],
    samples: [0; 32],
};

/// Bytes that are read between two looks at whether to stop.
const PIECE: usize = 4 << 20;

/// Where the samples of a block are.
#[derive(Debug, Clone, Copy)]
struct Record {
    offset: u64,
    bytes: u64,
    seal: [u8; 32],
    /// Whether it was found intact in a file that has been open since then and is never written again.
    checked: bool,
}

/// The open checkpoint of one job; the file is created with the first block.
#[derive(Debug)]
pub(super) struct Journal {
    pub(super) path: PathBuf,
    identity: Identity,
    /// The folder of this user's secret.
    secrets: Option<PathBuf>,
    seal: Seal,
    /// The file, locked.
    file: Option<File>,
    /// Whether the file is this job's journal; if not, it is only locked until it is replaced.
    begun: bool,
    records: HashMap<(u32, u64), Record>,
    /// Where the next record goes.
    end: u64,
    /// Whether no further blocks are written.
    pub(super) closed: bool,
    /// The folders created for it, which are removed if it is the only file there and is not created after all.
    folders: NewFolders,
    /// What is wrong with the file that was found, and what follows, as a predicate.
    pub(super) problem: Option<String>,
    /// Whether a block with invalid samples was reported.
    reported: bool,
}

/// Locks a file until it is closed or the process ends, however that ends; `None` if another process has locked it.
fn locked(file: File) -> Option<File> {
    // Some file systems have no locks.
    (!matches!(file.try_lock(), Err(TryLockError::WouldBlock))).then_some(file)
}

/// Whether a checkpoint is this user's and no process uses it.
pub(super) fn is_abandoned(path: &Path) -> bool {
    let Found::Private(file) = private::open(path, Others::Read) else { return false };
    locked(file).is_some()
}

impl Journal {
    /// Opens the checkpoint of this identity, if there is one, and finds its records.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] when another process works on the same job; [`Error::Interrupted`].
    pub(super) fn open(
        path: PathBuf,
        identity: &Identity,
        secrets: Option<PathBuf>,
        observer: &dyn Observer,
    ) -> Result<Self> {
        let mut journal = Self::new(path, identity, secrets);
        match private::open(&journal.path, Others::Read) {
            Found::Nothing => {}
            Found::Other(problem) => journal.problem = Some(format!("{problem}; {FROM_SCRATCH}")),
            Found::Private(file) => {
                let file = locked(file).ok_or_else(|| journal.in_use())?;
                journal.problem = journal.find_records(&file, observer)?;
                journal.file = Some(file);
            }
        }
        Ok(journal)
    }

    /// Finds the records of a finished file that is never written again: it is not locked, and open only while it is read.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(super) fn read_only(
        path: PathBuf,
        identity: &Identity,
        secrets: Option<PathBuf>,
        observer: &dyn Observer,
    ) -> Result<Self> {
        let mut journal = Self { closed: true, ..Self::new(path, identity, secrets) };
        match private::open(&journal.path, Others::Read) {
            // Another process has taken it up and deleted it.
            Found::Nothing => {}
            Found::Other(problem) => journal.problem = Some(format!("{problem}; {NOT_USED}")),
            Found::Private(file) => journal.problem = journal.find_records(&file, observer)?,
        }
        Ok(journal)
    }

    /// The same, open as long as this is there: what is read again is not checked again.
    pub(super) fn kept_open(self) -> Self {
        let file = match private::open(&self.path, Others::Read) {
            Found::Private(file) => Some(file),
            Found::Nothing | Found::Other(_) => None,
        };
        Self { file, ..self }
    }

    /// Without any records, and without a file until the first.
    pub(super) fn new(path: PathBuf, identity: &Identity, secrets: Option<PathBuf>) -> Self {
        let seal = Seal::new(secrets.as_deref().and_then(secret::read), identity);
        Self {
            path,
            identity: identity.clone(),
            secrets,
            seal,
            file: None,
            begun: false,
            records: HashMap::new(),
            end: HEADING as u64,
            closed: false,
            folders: NewFolders::default(),
            problem: None,
            reported: false,
        }
    }

    /// Creates the file if there is none yet, so that no other process works on the same job.
    ///
    /// # Errors
    /// As [`Journal::open`]; [`Error::Io`].
    pub(super) fn claim(&mut self, observer: &dyn Observer) -> Result<()> {
        let begun = if self.begun { Ok(()) } else { self.begin(observer) };
        begun.map_err(|error| self.failure(error))
    }

    /// Gives the complete file its name, in place of an older one.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub(super) fn rename(mut self, path: &Path) -> Result<()> {
        self.file = None;
        fs::rename(&self.path, path).map_err(|error| Error::writing(path, error))
    }

    fn failure(&self, error: io::Error) -> Error {
        if error.kind() == io::ErrorKind::WouldBlock {
            self.in_use()
        } else {
            Error::writing(&self.path, error)
        }
    }

    /// Samples of a stored block.
    pub(super) fn samples(&self, stage: Stage, k: u64) -> u64 {
        self.records.get(&(stage as u32, k)).map_or(0, |record| record.bytes / size_of::<Complex32>() as u64)
    }

    /// Whether a block is stored, intact or not.
    pub(super) fn has(&self, stage: Stage, k: u64) -> bool {
        self.records.contains_key(&(stage as u32, k))
    }

    fn in_use(&self) -> Error {
        Error::input(
            self.path.display(),
            "is in use: another process is working on the same job; wait for it, or write elsewhere",
        )
    }

    /// Finds the records up to the first that is incomplete or invalid; returns what is wrong.
    fn find_records(&mut self, mut file: &File, observer: &dyn Observer) -> Result<Option<String>> {
        let mut bytes = [0; HEADING];
        let length = file.metadata().map_or(0, |metadata| metadata.len());
        if file.read_exact(&mut bytes).is_err() || self.seal.read(&bytes) != Some(FILE_HEADING) {
            let problem = "is damaged, or was not written by this user for this job";
            return Ok(Some(format!("{problem}; {FROM_SCRATCH}")));
        }
        self.begun = true;
        while self.end + HEADING as u64 <= length {
            if observer.should_stop() {
                return Err(Error::Interrupted);
            }
            let read = file.seek(SeekFrom::Start(self.end)).and_then(|_| file.read_exact(&mut bytes));
            let record = read.ok().and_then(|()| self.record(&bytes));
            let Some((key, record)) = record.filter(|_| self.records.try_reserve(1).is_ok()) else {
                let blocks = self.records.len();
                return Ok(Some(format!(
                    "is damaged after its first {blocks} blocks; the others are computed again"
                )));
            };
            let Some(end) = record.offset.checked_add(record.bytes).filter(|end| *end <= length) else {
                // The process was killed while it wrote this.
                break;
            };
            self.records.insert(key, record);
            self.end = end;
        }
        Ok(None)
    }

    /// The record of a heading at the end, if it is intact and the job's own.
    fn record(&self, bytes: &[u8; HEADING]) -> Option<((u32, u64), Record)> {
        let Heading { words: [stage, k, bytes, _], samples } = self.seal.read(bytes)?;
        let record = Record { offset: self.end + HEADING as u64, bytes, seal: samples, checked: false };
        self.identity.stores(stage, k, bytes).then_some(((stage as u32, k), record))
    }

    /// Number of blocks stored.
    pub(super) fn blocks(&self) -> usize {
        self.records.len()
    }

    /// Bytes of the blocks stored.
    pub(super) fn bytes(&self) -> u64 {
        self.records.values().map(|record| record.bytes).sum()
    }

    /// Fills `block` with a stored one; a record that is damaged or of another length is removed, and reported.
    ///
    /// # Errors
    /// [`Error::Interrupted`].
    pub(super) fn read(
        &mut self,
        stage: Stage,
        k: u64,
        block: &mut [Complex32],
        observer: &dyn Observer,
    ) -> Result<bool> {
        let key = (stage as u32, k);
        let Some(record) = self.records.get(&key).copied() else { return Ok(false) };
        let intact = self.read_record(record, bytemuck::cast_slice_mut(block), observer)?;
        if intact {
            let checked = self.closed && self.file.is_some();
            self.records.insert(key, Record { checked, ..record });
        } else {
            self.records.remove(&key);
            if !std::mem::replace(&mut self.reported, true) {
                let path = self.path.display();
                observer.tell(&format!("{path} holds damaged blocks; they are computed again"));
            }
        }
        Ok(intact)
    }

    fn read_record(&self, record: Record, bytes: &mut [u8], observer: &dyn Observer) -> Result<bool> {
        if bytes.len() as u64 != record.bytes {
            return Ok(false);
        }
        let opened;
        let mut file = if let Some(file) = &self.file {
            file
        } else {
            let Found::Private(file) = private::open(&self.path, Others::Read) else { return Ok(false) };
            opened = file;
            &opened
        };
        if file.seek(SeekFrom::Start(record.offset)).is_err() {
            return Ok(false);
        }
        let mut hasher = self.seal.hasher();
        for piece in bytes.chunks_mut(PIECE) {
            if observer.should_stop() {
                return Err(Error::Interrupted);
            }
            if file.read_exact(piece).is_err() {
                return Ok(false);
            }
            if !record.checked {
                hasher.update(piece);
            }
        }
        Ok(record.checked || is_equal(&hasher.finalize(), &record.seal))
    }

    /// Appends a block. After a failure nothing more is written, and earlier blocks remain valid.
    ///
    /// # Errors
    /// As [`Journal::open`]; [`Error::Io`].
    pub(super) fn append(
        &mut self,
        stage: Stage,
        k: u64,
        block: &[Complex32],
        observer: &dyn Observer,
    ) -> Result<()> {
        let begun = if self.begun { Ok(()) } else { self.begin(observer) };
        let written = begun.and_then(|()| self.try_append(stage, k, bytemuck::cast_slice(block)));
        written.map_err(|error| {
            self.closed = true;
            if self.begun && self.records.is_empty() && self.file.take().is_some() {
                let _ = fs::remove_file(&self.path);
            } else if let Some(file) = self.file.as_ref().filter(|_| self.begun) {
                // An incomplete record would be detected anyway; without it the output has more space.
                let _ = file.set_len(self.end);
            }
            self.failure(error)
        })
    }

    /// Creates the file, in place of whatever has its name and is not this job's journal.
    fn begin(&mut self, observer: &dyn Observer) -> io::Result<()> {
        // The output's folder may not exist before the output itself.
        self.folders = self.path.parent().map(NewFolders::create).transpose()?.unwrap_or_default();
        // A journal that another process began in the meantime is not replaced.
        if self.file.is_none()
            && let Found::Private(file) = private::open(&self.path, Others::Read)
        {
            self.file = Some(locked(file).ok_or(io::ErrorKind::WouldBlock)?);
        }
        if let Err(error) = fs::remove_file(&self.path)
            && error.kind() != io::ErrorKind::NotFound
        {
            return Err(error);
        }
        let secret = self.secrets.as_deref().map(secret::read_or_create).transpose();
        let secret = secret.unwrap_or_else(|error| {
            observer.note(&format!("checkpoints are not sealed with a secret of this user: {error}"));
            None
        });
        self.seal = Seal::new(secret, &self.identity);
        let mut file = locked(private::create(&self.path)?).ok_or(io::ErrorKind::WouldBlock)?;
        file.write_all(&self.seal.write(&FILE_HEADING))?;
        self.file = Some(file);
        self.begun = true;
        Ok(())
    }

    fn try_append(&mut self, stage: Stage, k: u64, bytes: &[u8]) -> io::Result<()> {
        let mut file = self.file.as_ref().ok_or(io::ErrorKind::NotFound)?;
        let (offset, seal) = (self.end + HEADING as u64, self.seal.of(bytes));
        let record = Record { offset, bytes: bytes.len() as u64, seal, checked: false };
        let heading = Heading { words: [stage as u64, k, record.bytes, 0], samples: seal };
        // What an interrupted run left incomplete must not follow this record.
        file.set_len(self.end)?;
        file.seek(SeekFrom::Start(self.end))?;
        file.write_all(&self.seal.write(&heading))?;
        file.write_all(bytes)?;
        self.records.insert((stage as u32, k), record);
        self.end = record.offset + record.bytes;
        Ok(())
    }
}

/// What follows from a file that is not a journal of this job.
const NOT_USED: &str = "it is not used";
const FROM_SCRATCH: &str = "it is not used, and the run starts from the beginning";
