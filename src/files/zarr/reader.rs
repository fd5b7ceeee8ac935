//! Reads the arrays of a store.

use super::codec::{IndexCoding, Place, decode, most_encoded};
use super::fingerprint::list;
use super::metadata::{ArrayMeta, product, read_json};
use super::slab::{ArrayRows, Odometer};
use super::{META, METADATA};
use crate::error::{Error, Result};
use crate::files::arrays::{does_not_fit, fault, missing, place_of, too_large};
use crate::files::input::{open_regular, record_folder};
use crate::files::npz::{Array, ComplexBlocks, DtypeKind, complex_reader, scalar_reader};
use num_complex::Complex32;
use serde_json::Value;
use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// The most files and the most chunks of an array, so that looking for those that are missing ends soon.
const MOST_FILES: u64 = 1 << 20;
const MOST_CHUNKS: u64 = 1 << 24;

/// More bytes than any computer addresses, of which sums and products with small numbers do not overflow.
const MOST_BYTES: u64 = 1 << 48;

/// Files that mark a store of version 2.
const VERSION_2: [&str; 4] = [".zgroup", ".zarray", ".zattrs", ".zmetadata"];

/// An open store, of which only the metadata have been read.
#[derive(Debug)]
pub(crate) struct ZarrStore {
    path: PathBuf,
    limit_bytes: u64,
    /// Of the group.
    attributes: Value,
    /// The arrays by name: their metadata, or what is wrong with them.
    entries: Vec<(String, Result<ArrayMeta>)>,
}

/// What is known of files of chunks: `None` of one that is missing, the places of the chunks of a shard.
type KnownFiles = HashMap<Vec<usize>, Option<Vec<Option<Place>>>>;

impl ZarrStore {
    /// Opens a store and reads the metadata of the arrays in its group. No array larger than `limit_bytes` in memory will be
    /// read from it. Links within it are not followed.
    ///
    /// # Errors
    /// A folder that is missing, or that is no group of version 3. A fault of one array is reported only when that array is
    /// read.
    pub(crate) fn open(path: &Path, limit_bytes: u64) -> Result<Self> {
        record_folder(path)?;
        let refuse = |problem: &str| Err(Error::input(path.display(), problem));
        let root = path.join(METADATA);
        let Ok(about) = fs::symlink_metadata(&root) else {
            return if VERSION_2.iter().any(|name| path.join(name).exists()) {
                refuse(
                    "is a Zarr store of version 2, and version 3 is read; `zarr migrate v3` of zarr-python converts it",
                )
            } else {
                refuse("contains no zarr.json; a Zarr store of version 3 was expected, unpacked in a folder")
            };
        };
        if about.is_symlink() {
            return refuse(LINK);
        }
        let group = read_json(&root)?;
        if group["node_type"] != "group" {
            return refuse("is no group of arrays; a store whose root is a group was expected");
        }
        let mut entries = Vec::new();
        for entry in fs::read_dir(path).map_err(|error| Error::reading(path, error))? {
            let entry = entry.map_err(|error| Error::reading(path, error))?;
            let Ok(name) = entry.file_name().into_string() else { continue };
            let metadata = entry.path().join(METADATA);
            if entry.file_type().is_ok_and(|kind| kind.is_symlink()) {
                entries.push((name.clone(), Err(fault(path, &name, LINK))));
            } else if fs::symlink_metadata(&metadata).is_ok_and(|about| about.is_file()) {
                match read_json(&metadata) {
                    Ok(json) if json["node_type"] == "group" => {}
                    Ok(json) => {
                        let parsed = ArrayMeta::parse(&json).map_err(|problem| fault(path, &name, problem));
                        entries.push((name, parsed));
                    }
                    Err(error) => entries.push((name, Err(error))),
                }
            }
        }
        entries.sort_by(|(a, _), (b, _)| a.cmp(b));
        Ok(Self { path: path.to_owned(), limit_bytes, attributes: group["attributes"].clone(), entries })
    }

    /// The arrays' names.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.iter().map(|(name, _)| name.as_str())
    }

    /// Whether there is an array of this name, or the attribute `meta`.
    pub(crate) fn contains(&self, name: &str) -> bool {
        self.names().any(|other| other == name) || name == META && !self.attributes[META].is_null()
    }

    /// Sizes of an array's axes, slowest first.
    ///
    /// # Errors
    /// A missing array, or one whose metadata are malformed; likewise in the other methods.
    pub(crate) fn shape(&self, name: &str) -> Result<Vec<usize>> {
        Ok(self.meta(name)?.shape.clone())
    }

    /// Whether an array's elements are complex numbers.
    pub(crate) fn dtype_is_complex(&self, name: &str) -> Result<bool> {
        Ok(self.meta(name)?.dtype.kind == DtypeKind::Complex)
    }

    /// Whether an array's elements are unsigned integers.
    pub(crate) fn dtype_is_unsigned(&self, name: &str) -> Result<bool> {
        Ok(self.meta(name)?.dtype.kind == DtypeKind::Unsigned)
    }

    /// An array of complex numbers; real numbers get the imaginary part 0.
    ///
    /// # Errors
    /// A missing array, sizes that exceed the limit, damaged chunks; likewise in the other methods.
    pub(crate) fn complex(&self, name: &str) -> Result<Array<Complex32>> {
        let dtype = self.meta(name)?.dtype;
        let convert = complex_reader(dtype);
        self.array(name, |bytes, data| convert(dtype, bytes, data))
    }

    /// The same in blocks of `block` elements, of which the last may be shorter.
    ///
    /// # Panics
    /// When `block` is 0.
    pub(crate) fn complex_blocks(
        &self,
        name: &str,
        block: usize,
        take: impl FnMut(&mut [Complex32]) -> Result<()>,
    ) -> Result<()> {
        let meta = self.meta(name)?;
        let mut blocks = ComplexBlocks::new(meta.dtype, block, take);
        let (place, elements) = (place_of(&self.path, name), meta.elements().unwrap_or(u64::MAX));
        self.read(name, [block as u64, 8], |bytes| {
            blocks.add(bytes, elements).ok_or_else(|| does_not_fit(&place))?
        })?;
        blocks.finish()
    }

    /// An array of real numbers in double precision.
    pub(crate) fn f64(&self, name: &str) -> Result<Array<f64>> {
        let dtype = self.meta(name)?.dtype;
        if dtype.kind == DtypeKind::Complex {
            return Err(fault(&self.path, name, "contains complex numbers; real numbers were expected"));
        }
        let scalar = scalar_reader(dtype)
            .ok_or_else(|| fault(&self.path, name, "is of a type that is not supported"))?;
        self.array(name, |bytes, data| data.extend(bytes.chunks_exact(dtype.size as usize).map(scalar)))
    }

    /// The attribute of this name: a text, or JSON as text.
    pub(crate) fn text(&self, name: &str) -> Result<String> {
        match &self.attributes[name] {
            Value::Null => Err(Error::input(
                format!("{}, attribute `{name}`", self.path.display()),
                "is missing from the group's attributes",
            )),
            Value::String(text) => Ok(text.clone()),
            other => Ok(other.to_string()),
        }
    }

    /// Every file of the store by name, size and hash of its bytes, one per line. Cost: all files are read.
    pub(crate) fn fingerprint(&self) -> Result<String> {
        let mut lines = Vec::new();
        list(&self.path, "", 0, &mut lines)?;
        lines.sort();
        Ok(lines.join("\n"))
    }

    /// Bytes that reading an array takes besides what is made of it: one row of chunks, and a chunk as it is in the file and
    /// inflated.
    pub(crate) fn bytes_beside_block(&self, name: &str) -> u64 {
        self.meta(name).map_or(0, slab_bytes)
    }

    fn meta(&self, name: &str) -> Result<&ArrayMeta> {
        match self.entries.iter().find(|(other, _)| other == name) {
            Some((_, Ok(meta))) => Ok(meta),
            Some((_, Err(error))) => Err(error.clone()),
            None => Err(fault(&self.path, name, missing(self.names()))),
        }
    }

    /// All elements of an array, which `convert` appends from their bytes.
    fn array<T>(&self, name: &str, convert: impl Fn(&[u8], &mut Vec<T>)) -> Result<Array<T>> {
        let meta = self.meta(name)?;
        let mut data = Vec::new();
        let place = place_of(&self.path, name);
        self.read(name, [u64::MAX, size_of::<T>() as u64], |bytes| {
            if data.capacity() == 0 {
                let count = meta.elements().and_then(|count| usize::try_from(count).ok());
                count
                    .and_then(|count| data.try_reserve_exact(count).ok())
                    .ok_or_else(|| does_not_fit(&place))?;
            }
            convert(bytes, &mut data);
            Ok(())
        })?;
        Ok(Array { shape: meta.shape.clone(), data })
    }

    /// Passes the array's bytes to `take`, some rows along its first axis at a time, after checking that its sizes fit: at
    /// most `block` elements of `bytes_each` are in memory besides.
    fn read(
        &self,
        name: &str,
        [block, bytes_each]: [u64; 2],
        mut take: impl FnMut(&[u8]) -> Result<()>,
    ) -> Result<()> {
        let meta = self.meta(name)?;
        let refuse = |problem: String| Err(fault(&self.path, name, problem));
        let elements = meta.elements().unwrap_or(u64::MAX);
        let needed = block.min(elements).saturating_mul(bytes_each.max(meta.dtype.size));
        let needed = needed.saturating_add(slab_bytes(meta));
        // What overflows is beyond any limit, also where there is none.
        if needed > self.limit_bytes || needed > MOST_BYTES {
            return refuse(too_large(&meta.shape, needed, self.limit_bytes));
        }
        let Some(&rows) = meta.shape.first() else {
            return refuse("is a single number; an array was expected".into());
        };
        for (size, most) in [(&meta.file, MOST_FILES), (&meta.chunk, MOST_CHUNKS)] {
            let found = product(&counts(&meta.shape, size)).unwrap_or(u64::MAX);
            if found > most {
                return refuse(format!(
                    "is in {found} pieces of {size:?}; at most {most} are read: use larger ones"
                ));
            }
        }
        if elements == 0 {
            return Ok(());
        }
        let mut slab = ArrayRows::new(meta, rows).ok_or_else(|| does_not_fit(&place_of(&self.path, name)))?;
        let mut known = KnownFiles::new();
        for first in (0..rows).step_by(meta.chunk[0]) {
            if first % meta.file[0] == 0 {
                known.clear();
            }
            slab.begin(first, rows);
            self.fill(name, meta, &mut slab, &mut known)?;
            take(slab.bytes())?;
        }
        Ok(())
    }

    /// Fills a slab from the files that it crosses.
    fn fill(
        &self,
        name: &str,
        meta: &ArrayMeta,
        slab: &mut ArrayRows<'_>,
        known: &mut KnownFiles,
    ) -> Result<()> {
        let (in_file, row) = (counts(&meta.file, &meta.chunk), slab.first % meta.file[0] / meta.chunk[0]);
        let mut across = counts(&meta.shape, &meta.file);
        across[0] = 1;
        for mut at in Odometer::new(&across) {
            at[0] = slab.first / meta.file[0];
            let key = meta.keys.name(&at);
            let broken = |problem: String| {
                let again = "; write or copy the store again";
                fault(&self.path, name, format!("has a damaged chunk {key}: {problem}{again}"))
            };
            if matches!(known.get(&at), Some(None)) {
                continue;
            }
            let Some(mut file) = self.open_within(name, &key)? else {
                known.insert(at, None);
                continue;
            };
            let length = file.metadata().map_err(|error| Error::reading(&self.path, error))?.len();
            if let (Some(coding), false) = (meta.index, known.contains_key(&at)) {
                let places = self.index(meta, coding, &mut file, length).map_err(broken)?;
                known.insert(at.clone(), Some(places));
            }
            // Without them the file is one chunk.
            let places = known.get(&at).and_then(Option::as_ref);
            let start: Vec<usize> = at.iter().zip(&meta.file).map(|(i, size)| i * size).collect();
            let mut within = in_file.clone();
            within[0] = 1;
            for mut inner in Odometer::new(&within) {
                inner[0] = row;
                let place = match places {
                    Some(places) => {
                        let flat = inner.iter().zip(&in_file).fold(0, |flat, (i, n)| flat * n + i);
                        let Some(place) = places.get(flat).copied().flatten() else { continue };
                        place
                    }
                    None => (0, length),
                };
                let origin: Vec<usize> =
                    start.iter().zip(&inner).zip(&meta.chunk).map(|((s, i), size)| s + i * size).collect();
                // Chunks of a shard that begin outside the array are never read.
                if origin.iter().zip(&meta.shape).all(|(o, n)| o < n) {
                    let bytes = chunk(meta, &mut file, place, length).map_err(broken)?;
                    slab.copy(&bytes, &origin);
                }
            }
        }
        Ok(())
    }

    /// The index of a shard.
    fn index(
        &self,
        meta: &ArrayMeta,
        coding: IndexCoding,
        file: &mut File,
        length: u64,
    ) -> std::result::Result<Vec<Option<Place>>, String> {
        let in_file = counts(&meta.file, &meta.chunk);
        let bytes = product(&in_file).and_then(|chunks| coding.bytes(chunks));
        let bytes = bytes.filter(|bytes| *bytes <= length.min(self.limit_bytes));
        let bytes =
            bytes.ok_or_else(|| format!("its {length} bytes do not hold the index of {in_file:?} chunks"))?;
        let from = if coding.at_end { length - bytes } else { 0 };
        coding.decode(bytes_at(file, (from, bytes))?)
    }

    /// A file below an array's folder, `None` if it is missing.
    fn open_within(&self, name: &str, key: &str) -> Result<Option<File>> {
        let mut path = self.path.join(name);
        for word in key.split('/') {
            path.push(word);
            match fs::symlink_metadata(&path) {
                Ok(about) if about.is_symlink() => return Err(fault(&self.path, name, LINK)),
                Ok(_) => {}
                Err(_) => return Ok(None),
            }
        }
        open_regular(&path).map(Some)
    }
}

/// How many pieces of a size there are along each axis.
fn counts(shape: &[usize], size: &[usize]) -> Vec<usize> {
    shape.iter().zip(size).map(|(n, size)| n.div_ceil(*size)).collect()
}

/// Why a link is refused.
pub(super) const LINK: &str = "is or contains a link, which is not followed within a store; copy the store with what its links refer to";

/// Bytes of a row of chunks, and twice those of a chunk.
fn slab_bytes(meta: &ArrayMeta) -> u64 {
    let [chunk, shape] =
        [&meta.chunk, &meta.shape].map(|sizes| sizes.iter().map(|&n| n as u64).collect::<Vec<_>>());
    let bytes = |sizes: &[u64]| sizes.iter().fold(meta.dtype.size, |bytes, n| bytes.saturating_mul(*n));
    let rows = chunk.first().copied().unwrap_or(1).min(shape.first().copied().unwrap_or(1));
    let slab = bytes(shape.get(1..).unwrap_or_default()).saturating_mul(rows);
    slab.saturating_add(bytes(&chunk).saturating_mul(2))
}

/// A chunk at a place in a file of `length` bytes.
fn chunk(
    meta: &ArrayMeta,
    file: &mut File,
    (offset, bytes): Place,
    length: u64,
) -> std::result::Result<Vec<u8>, String> {
    let expected = product(&meta.chunk).and_then(|n| n.checked_mul(meta.dtype.size)).unwrap_or(u64::MAX);
    if offset.checked_add(bytes).is_none_or(|end| end > length) {
        return Err(format!("bytes {offset} and the {bytes} after it are beyond its end, {length}"));
    }
    if bytes > most_encoded(expected) {
        return Err(format!("it takes {bytes} bytes, and its {expected} need fewer"));
    }
    decode(bytes_at(file, (offset, bytes))?, &meta.codecs, expected as usize)
}

/// Bytes of a file, which has as many.
fn bytes_at(file: &mut File, (offset, bytes): Place) -> std::result::Result<Vec<u8>, String> {
    let mut out = Vec::new();
    let read = file.seek(SeekFrom::Start(offset)).and_then(|_| file.take(bytes).read_to_end(&mut out));
    read.map_err(|error| format!("it cannot be read ({error})"))?;
    if out.len() as u64 == bytes { Ok(out) } else { Err("it ends early".into()) }
}
