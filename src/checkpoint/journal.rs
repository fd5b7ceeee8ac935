//! The file to which blocks are appended.
//!
//! The file begins with a heading of 32 bytes: `holosonar state\n`, the identity (u64), `0` and a checksum of the bytes before
//! it (u32). Records follow, each with a heading of 32 bytes (`stage`, `checksum of the samples`: u32; `block`, `bytes`: u64;
//! `0`, `checksum of the bytes before it`: u32) and the bytes of the samples. All numbers are little-endian, except the
//! samples, which are in the processor's own order (the processor is part of the identity). Reading stops at the first
//! invalid heading; blocks with invalid samples are computed again.

use super::{Identity, Stage};
use crate::error::{Error, Result};
use crate::files::NewFolders;
use num_complex::Complex32;
use std::collections::HashMap;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

const MAGIC: [u64; 2] = [u64::from_le_bytes(*b"holosona"), u64::from_le_bytes(*b"r state\n")];
const HEADING: usize = 32;

/// Where the samples of a block are.
#[derive(Debug, Clone, Copy)]
struct Record {
    offset: u64,
    bytes: u64,
    checksum: u32,
}

/// The open checkpoint of one job; the file is created with the first block.
#[derive(Debug)]
pub(super) struct Journal {
    pub(super) path: PathBuf,
    key: u64,
    file: Option<File>,
    records: HashMap<(u32, u64), Record>,
    /// Where the next record goes.
    end: u64,
    /// Whether no further blocks are written.
    pub(super) closed: bool,
    /// Whether there was a file without any intact block.
    pub(super) damaged: bool,
    /// The folders created for it, which are removed if it is the only file there and is not created after all.
    folders: NewFolders,
}

/// Opens and locks a checkpoint, and creates a missing one if `create`; the lock ends with the process, however that ends.
fn lock(path: &Path, create: bool) -> io::Result<Option<File>> {
    let file = OpenOptions::new().read(true).write(true).create(create).truncate(false).open(path)?;
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Ok(None),
        // Some file systems have no locks.
        _ => Ok(Some(file)),
    }
}

/// Whether another process uses a checkpoint.
pub(super) fn is_in_use(path: &Path) -> bool {
    matches!(lock(path, false), Ok(None))
}

/// Three words and their checksum.
fn heading(words: [u64; 3]) -> [u8; HEADING] {
    let mut heading = [0; HEADING];
    for (bytes, word) in heading.chunks_exact_mut(8).zip(words) {
        bytes.copy_from_slice(&word.to_le_bytes());
    }
    let checksum = crc32fast::hash(&heading[..HEADING - 4]);
    heading[HEADING - 4..].copy_from_slice(&checksum.to_le_bytes());
    heading
}

/// The words of an intact heading.
fn words_of(bytes: [u8; HEADING]) -> Option<[u64; 3]> {
    let word = |i: usize| u64::from_le_bytes(std::array::from_fn(|byte| bytes[8 * i + byte]));
    let words = [word(0), word(1), word(2)];
    (heading(words) == bytes).then_some(words)
}

impl Journal {
    /// Opens the checkpoint of this identity, if there is one, and finds its records.
    pub(super) fn open(path: PathBuf, identity: &Identity) -> Result<Self> {
        let key = identity.key();
        let mut journal = Self {
            path,
            key,
            file: None,
            records: HashMap::new(),
            end: HEADING as u64,
            closed: false,
            damaged: false,
            folders: NewFolders::default(),
        };
        let file = match lock(&journal.path, false) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(journal),
            Err(error) => {
                let problem = format!("cannot be read: {error}");
                return Err(Error::io(journal.path.display(), problem).with_source(error));
            }
            Ok(None) => return Err(journal.in_use()),
            Ok(Some(file)) => file,
        };
        journal.damaged = journal.find_records(&file).is_err() || journal.records.is_empty();
        journal.file = Some(file);
        Ok(journal)
    }

    fn in_use(&self) -> Error {
        Error::input(
            self.path.display(),
            "is in use: another process is working on the same job; wait for it, or write elsewhere",
        )
    }

    fn find_records(&mut self, mut file: &File) -> io::Result<()> {
        let length = file.metadata()?.len();
        let mut bytes = [0; HEADING];
        file.read_exact(&mut bytes)?;
        if words_of(bytes) != Some([MAGIC[0], MAGIC[1], self.key]) {
            return Err(io::ErrorKind::InvalidData.into());
        }
        while self.end + HEADING as u64 <= length {
            file.seek(SeekFrom::Start(self.end))?;
            file.read_exact(&mut bytes)?;
            let Some([stage_and_checksum, k, bytes]) = words_of(bytes) else { break };
            let record = Record {
                offset: self.end + HEADING as u64,
                bytes,
                checksum: (stage_and_checksum >> 32) as u32,
            };
            let Some(end) = record.offset.checked_add(bytes).filter(|end| *end <= length) else { break };
            self.records.insert((stage_and_checksum as u32, k), record);
            self.end = end;
        }
        Ok(())
    }

    /// Number of blocks stored.
    pub(super) fn blocks(&self) -> usize {
        self.records.len()
    }

    /// Bytes of the blocks stored.
    pub(super) fn bytes(&self) -> u64 {
        self.records.values().map(|record| record.bytes).sum()
    }

    /// Fills `block` with a stored one; a record that is damaged or of another length is removed.
    pub(super) fn read(&mut self, stage: Stage, k: u64, block: &mut [Complex32]) -> bool {
        let key = (stage as u32, k);
        let Some(record) = self.records.get(&key).copied() else { return false };
        let intact = self.read_record(record, block).is_some();
        if !intact {
            self.records.remove(&key);
        }
        intact
    }

    fn read_record(&self, record: Record, block: &mut [Complex32]) -> Option<()> {
        let mut file = self.file.as_ref()?;
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(block);
        if bytes.len() as u64 != record.bytes {
            return None;
        }
        file.seek(SeekFrom::Start(record.offset)).ok()?;
        file.read_exact(bytes).ok()?;
        (crc32fast::hash(bytes) == record.checksum).then_some(())
    }

    /// Appends a block. After a failure nothing more is written, and earlier blocks remain valid.
    pub(super) fn append(&mut self, stage: Stage, k: u64, block: &[Complex32]) -> Result<()> {
        let written = self.try_append(stage, k, bytemuck::cast_slice(block));
        written.map_err(|error| {
            self.closed = true;
            if self.records.is_empty() && self.file.take().is_some() {
                let _ = fs::remove_file(&self.path);
            } else if let Some(file) = &self.file {
                // An incomplete record would be detected anyway; without it the output has more space.
                let _ = file.set_len(self.end);
            }
            if error.kind() == io::ErrorKind::WouldBlock {
                return self.in_use();
            }
            Error::writing(&self.path, error)
        })
    }

    fn try_append(&mut self, stage: Stage, k: u64, bytes: &[u8]) -> io::Result<()> {
        if self.records.is_empty() && self.end == HEADING as u64 {
            let mut file = if let Some(file) = self.file.take() {
                file
            } else {
                // The output's folder may not exist before the output itself.
                self.folders = self.path.parent().map(NewFolders::create).transpose()?.unwrap_or_default();
                lock(&self.path, true)?.ok_or(io::ErrorKind::WouldBlock)?
            };
            file.set_len(0)?;
            file.seek(SeekFrom::Start(0))?;
            file.write_all(&heading([MAGIC[0], MAGIC[1], self.key]))?;
            self.file = Some(file);
        }
        let mut file = self.file.as_ref().ok_or(io::ErrorKind::NotFound)?;
        let checksum = crc32fast::hash(bytes);
        let record = Record { offset: self.end + HEADING as u64, bytes: bytes.len() as u64, checksum };
        let stage_and_checksum = u64::from(stage as u32) | u64::from(checksum) << 32;
        file.seek(SeekFrom::Start(self.end))?;
        file.write_all(&heading([stage_and_checksum, k, record.bytes]))?;
        file.write_all(bytes)?;
        self.records.insert((stage as u32, k), record);
        self.end = record.offset + record.bytes;
        Ok(())
    }
}
