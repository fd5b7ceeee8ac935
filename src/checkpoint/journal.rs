//! The file that blocks are appended to.
//!
//! A heading of 32 bytes: `holosonar state\n`, the identity, zeros, a checksum of the 24 bytes before. Then records, each
//! with a heading of 32 bytes (`stage`, `checksum of the samples`: u32; `block`, `bytes`: u64; `0`, `checksum of the
//! heading`: u32) and the samples' bytes. All numbers are little-endian, samples as the machine has them (its kind is in the
//! identity). The first heading that is not valid ends the file; samples that are not are computed again.

use super::{Identity, Stage};
use crate::error::{Error, Result};
use num_complex::Complex32;
use std::collections::HashMap;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

const MAGIC: &[u8; 16] = b"holosonar state\n";
const HEADING: usize = 32;

/// Where the samples of a block are.
#[derive(Debug, Clone, Copy)]
struct Record {
    offset: u64,
    bytes: u64,
    checksum: u32,
}

/// The open checkpoint of one job; no file is made before the first block is written.
#[derive(Debug)]
pub(super) struct Journal {
    path: PathBuf,
    key: u64,
    file: Option<File>,
    records: HashMap<(u32, u64), Record>,
    /// Where the next record goes.
    end: u64,
    /// Nothing more is written.
    closed: bool,
    damaged: bool,
}

/// Opens and locks a checkpoint, made if it is missing and `create`; the lock is released with the process, however it ends.
fn lock(path: &Path, create: bool) -> io::Result<Option<File>> {
    let file = OpenOptions::new().read(true).write(true).create(create).truncate(false).open(path)?;
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Ok(None),
        // Where there are no locks, there is nobody to ask.
        _ => Ok(Some(file)),
    }
}

/// Whether another process uses a checkpoint.
pub(super) fn is_in_use(path: &Path) -> bool {
    matches!(lock(path, false), Ok(None))
}

fn heading(key: u64) -> [u8; HEADING] {
    let mut heading = [0; HEADING];
    heading[..16].copy_from_slice(MAGIC);
    heading[16..24].copy_from_slice(&key.to_le_bytes());
    seal(&mut heading);
    heading
}

/// Ends a heading with its checksum.
fn seal(heading: &mut [u8; HEADING]) {
    let checksum = crc32fast::hash(&heading[..HEADING - 4]);
    heading[HEADING - 4..].copy_from_slice(&checksum.to_le_bytes());
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|i| bytes[at + i]))
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(std::array::from_fn(|i| bytes[at + i]))
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
        };
        let file = match lock(&journal.path, false) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(journal),
            Err(error) => {
                return Err(
                    Error::io(journal.path.display(), format!("cannot be read: {error}")).with_source(error)
                );
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
            "is in use: another process works on this very job; wait for it, or write elsewhere",
        )
    }

    fn find_records(&mut self, mut file: &File) -> io::Result<()> {
        let length = file.metadata()?.len();
        let mut bytes = [0; HEADING];
        file.read_exact(&mut bytes)?;
        if bytes != heading(self.key) {
            return Err(io::ErrorKind::InvalidData.into());
        }
        while self.end + HEADING as u64 <= length {
            file.seek(SeekFrom::Start(self.end))?;
            file.read_exact(&mut bytes)?;
            let mut sealed = bytes;
            seal(&mut sealed);
            let (offset, size) = (self.end + HEADING as u64, u64_at(&bytes, 16));
            let Some(end) = offset.checked_add(size).filter(|end| sealed == bytes && *end <= length) else {
                break;
            };
            let record = Record { offset, bytes: size, checksum: u32_at(&bytes, 4) };
            self.records.insert((u32_at(&bytes, 0), u64_at(&bytes, 8)), record);
            self.end = end;
        }
        Ok(())
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Number of blocks stored.
    pub(super) fn blocks(&self) -> usize {
        self.records.len()
    }

    /// Bytes of the blocks stored.
    pub(super) fn bytes(&self) -> u64 {
        self.records.values().map(|record| record.bytes).sum()
    }

    /// Whether there was a file of which nothing could be used.
    pub(super) fn was_damaged(&self) -> bool {
        self.damaged
    }

    /// Fills `block` with one that is stored; one that is damaged or of another length is dropped from the records.
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

    /// Whether nothing more is written.
    pub(super) fn is_closed(&self) -> bool {
        self.closed
    }

    /// Writes nothing more.
    pub(super) fn close(&mut self) {
        self.closed = true;
    }

    /// Appends a block. After a failure nothing more is written, and what was written before stays good.
    pub(super) fn append(&mut self, stage: Stage, k: u64, block: &[Complex32]) -> Result<()> {
        let written = self.try_append(stage, k, bytemuck::cast_slice(block));
        written.map_err(|error| {
            self.closed = true;
            if let Some(file) = &self.file {
                // An incomplete record would be noticed anyway; without it there is more room for the output.
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
                // The output's folder may be made only with the output itself.
                self.path.parent().map_or(Ok(()), fs::create_dir_all)?;
                lock(&self.path, true)?.ok_or(io::ErrorKind::WouldBlock)?
            };
            file.set_len(0)?;
            file.seek(SeekFrom::Start(0))?;
            file.write_all(&heading(self.key))?;
            self.file = Some(file);
        }
        let mut file = self.file.as_ref().ok_or(io::ErrorKind::NotFound)?;
        let checksum = crc32fast::hash(bytes);
        let mut heading = [0; HEADING];
        heading[..4].copy_from_slice(&(stage as u32).to_le_bytes());
        heading[4..8].copy_from_slice(&checksum.to_le_bytes());
        heading[8..16].copy_from_slice(&k.to_le_bytes());
        heading[16..24].copy_from_slice(&(bytes.len() as u64).to_le_bytes());
        seal(&mut heading);
        file.seek(SeekFrom::Start(self.end))?;
        file.write_all(&heading)?;
        file.write_all(bytes)?;
        let record = Record { offset: self.end + HEADING as u64, bytes: bytes.len() as u64, checksum };
        self.records.insert((stage as u32, k), record);
        self.end = record.offset + record.bytes;
        Ok(())
    }
}
