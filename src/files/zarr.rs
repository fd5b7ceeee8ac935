//! Zarr stores, version 3, in a folder: numeric arrays in chunks, each alone in a file or many in a shard.
//!
//! After the core specification of version 3 (zarr-specs.readthedocs.io/en/latest/v3/core) and those of its codecs `bytes`,
//! `gzip`, `crc32c`, `zstd` and `sharding_indexed`. [`ZarrStore`] reads untrusted stores: what metadata declare is checked
//! against a limit in bytes before anything is inflated or allocated, and no name in them becomes a path. [`ZarrWriter`]
//! writes shards as the elements come, so that stores of the same arrays are bit-identical.
//!
//! Read is what is written, and what other programs write by default: regular chunks of plain numbers of either endianness,
//! with or without `sharding_indexed`, `gzip`, `zstd` and `crc32c`, also with chunks that are missing. Version 2, other codecs
//! and other grids are refused by name.
//!
//! The crate `zarrs` 0.23 is not used for what it adds to a build: see Cargo.toml.

mod codec;
mod fingerprint;
mod layout;
mod metadata;
mod reader;
mod slab;
mod writer;

pub(crate) use layout::ShardLayout;
pub(crate) use reader::ZarrStore;
pub(crate) use writer::{
    ArraySpec, EncodedShards, ShardEncoder, ZarrNumber, ZarrWriter, write_group, write_small,
};

use crate::error::{Error, Result};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// The file of metadata in the folder of each group and array.
const METADATA: &str = "zarr.json";

/// The attribute that marks a store as one of this program's, which it may replace.
pub(crate) const MARK: &str = "holosonar";

/// The attribute that holds what is `meta` in an npz.
pub(crate) const META: &str = "meta";

/// Folders within folders that are looked into before a store is replaced; those written have five.
const DEEPEST: usize = 12;

/// Whether a folder may be replaced by a store: an empty one, or a store of this program with nothing else in it.
///
/// # Errors
/// Anything else, which is named.
pub(super) fn check_replaceable(folder: &Path) -> Result<()> {
    let refuse = |problem: String| Err(Error::input(folder.display(), problem));
    let listed = fs::read_dir(folder).map_err(|error| Error::writing(folder, error))?;
    if listed.count() == 0 {
        return Ok(());
    }
    let group = metadata::read_json(&folder.join(METADATA)).ok();
    let attributes = group.as_ref().map_or(&Value::Null, |group| &group["attributes"]);
    if !attributes[MARK].is_object() {
        return refuse(
            "is a folder that holosonar did not write, and is not replaced; remove it, or give another name"
                .into(),
        );
    }
    match foreign(folder, false, 0) {
        None => Ok(()),
        Some(name) => refuse(format!(
            "contains `{name}`, which is no part of a Zarr store, and is not replaced; move it, or give another name"
        )),
    }
}

/// A file in a store that no writer of Zarr would have put there.
fn foreign(folder: &Path, in_chunks: bool, depth: usize) -> Option<String> {
    let Ok(entries) = fs::read_dir(folder) else { return Some(folder.display().to_string()) };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let text = name.to_string_lossy();
        let is_number = !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
        let found = match entry.file_type() {
            Ok(kind) if kind.is_dir() && depth < DEEPEST && (!in_chunks || is_number) => {
                foreign(&entry.path(), in_chunks || text == "c", depth + 1)
            }
            Ok(kind) if kind.is_file() && (text == METADATA || in_chunks && is_number) => None,
            _ => Some(text.into_owned()),
        };
        if found.is_some() {
            return found;
        }
    }
    None
}

#[cfg(test)]
mod tests;
