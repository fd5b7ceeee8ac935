//! Identifies the content of a store, of which all files are read.

use super::DEEPEST;
use super::reader::LINK;
use crate::error::{Error, Result};
use crate::files::input::open_regular;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Adds the files in a folder by name, size and hash.
pub(super) fn list(folder: &Path, name: &str, depth: usize, lines: &mut Vec<String>) -> Result<()> {
    for entry in fs::read_dir(folder).map_err(|error| Error::reading(folder, error))? {
        let entry = entry.map_err(|error| Error::reading(folder, error))?;
        let (path, kind) = (entry.path(), entry.file_type());
        let name = format!("{name}/{}", entry.file_name().to_string_lossy());
        match kind {
            Ok(kind) if kind.is_dir() && depth < DEEPEST => list(&path, &name, depth + 1, lines)?,
            Ok(kind) if kind.is_file() => lines.push(format!("{name:?} {}", hashed(&path)?)),
            _ => return Err(Error::input(path.display(), LINK)),
        }
    }
    Ok(())
}

/// The bytes of a file, and their hash.
fn hashed(path: &Path) -> Result<String> {
    let mut file = BufReader::with_capacity(1 << 16, open_regular(path)?);
    let (mut hasher, mut bytes) = (blake3::Hasher::new(), 0_u64);
    loop {
        let block = file.fill_buf().map_err(|error| Error::reading(path, error))?;
        let length = block.len();
        if length == 0 {
            return Ok(format!("{bytes} {}", hasher.finalize()));
        }
        hasher.update(block);
        bytes += length as u64;
        file.consume(length);
    }
}
