//! Writes the arrays of a store as their elements come, one shard after the other.

use super::codec::{Codec, Place, encode, encode_index};
use super::{METADATA, ShardLayout};
use crate::files::npz::little_endian;
use num_complex::Complex32;
use rayon::prelude::*;
use serde_json::{Value, json};
use std::borrow::Cow;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A number as arrays hold it.
pub(crate) trait ZarrNumber: Sized + Sync {
    /// The name of the type, and the value of what is missing.
    const TYPE: &'static str;
    fn fill() -> Value;
    fn bytes(numbers: &[Self]) -> Cow<'_, [u8]>;
}

impl ZarrNumber for Complex32 {
    const TYPE: &'static str = "complex64";

    fn fill() -> Value {
        json!([0.0, 0.0])
    }

    fn bytes(numbers: &[Self]) -> Cow<'_, [u8]> {
        little_endian(bytemuck::cast_slice(numbers), f32::to_le_bytes)
    }
}

impl ZarrNumber for f32 {
    const TYPE: &'static str = "float32";

    fn fill() -> Value {
        json!(0.0)
    }

    fn bytes(numbers: &[Self]) -> Cow<'_, [u8]> {
        little_endian(numbers, f32::to_le_bytes)
    }
}

impl ZarrNumber for f64 {
    const TYPE: &'static str = "float64";

    fn fill() -> Value {
        json!(0.0)
    }

    fn bytes(numbers: &[Self]) -> Cow<'_, [u8]> {
        little_endian(numbers, f64::to_le_bytes)
    }
}

/// An array: the names of its axes, and what else is said of it.
#[derive(Debug, Clone)]
pub(crate) struct ArraySpec<'a> {
    /// One for each axis, slowest first.
    pub(crate) dimensions: &'a [&'a str],
    /// An object.
    pub(crate) attributes: Value,
    /// Whether chunks are compressed; else they have a checksum.
    pub(crate) zip: bool,
}

impl ArraySpec<'_> {
    fn codecs(&self) -> [Codec; 1] {
        // gzip has a checksum of its own.
        [if self.zip { Codec::Gzip } else { Codec::Crc32c }]
    }

    fn json<T: ZarrNumber>(&self, shape: &[usize], chunk: &[usize], codecs: &Value) -> Value {
        json!({
            "zarr_format": 3,
            "node_type": "array",
            "shape": shape,
            "data_type": T::TYPE,
            "chunk_grid": { "name": "regular", "configuration": { "chunk_shape": chunk } },
            "chunk_key_encoding": { "name": "default", "configuration": { "separator": "/" } },
            "fill_value": T::fill(),
            "codecs": codecs,
            "attributes": self.attributes,
            "dimension_names": self.dimensions,
        })
    }
}

/// How this and every other program on Earth stores numbers.
fn plain() -> Value {
    json!({ "name": "bytes", "configuration": { "endian": "little" } })
}

/// Writes the metadata of a group, whose folder is created if it is missing.
pub(crate) fn write_group(folder: &Path, attributes: &Value) -> io::Result<()> {
    write_json(folder, &json!({ "zarr_format": 3, "node_type": "group", "attributes": attributes }))
}

fn write_json(folder: &Path, json: &Value) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    fs::write(folder.join(METADATA), format!("{json:#}\n"))
}

/// Writes a short array as one chunk, without shards.
///
/// # Panics
/// When `data` does not hold exactly as many elements as `shape` says.
pub(crate) fn write_small<T: ZarrNumber>(
    folder: &Path,
    shape: &[usize],
    data: &[T],
    spec: &ArraySpec<'_>,
) -> io::Result<()> {
    assert_eq!(shape.iter().product::<usize>(), data.len(), "the data must fill the shape");
    let codecs = [Codec::Crc32c];
    let described = json!([plain(), { "name": "crc32c" }]);
    // A chunk has at least one element along each axis.
    let chunk: Vec<usize> = shape.iter().map(|&n| n.max(1)).collect();
    write_json(folder, &spec.json::<T>(shape, &chunk, &described))?;
    if data.is_empty() {
        return Ok(());
    }
    let mut path = folder.join("c");
    path.extend(shape.iter().map(|_| "0"));
    fs::create_dir_all(path.parent().unwrap_or(folder))?;
    fs::write(path, encode(T::bytes(data).into_owned(), &codecs)?)
}

/// An array that is written row after row, as many as its [`ShardLayout`] says in each shard. Chunks are compressed by rayon's
/// current threads; the bytes do not depend on how many there are, nor on how the rows come.
#[derive(Debug)]
pub(crate) struct ZarrWriter {
    folder: PathBuf,
    layout: ShardLayout,
    /// Bytes of an element.
    size: usize,
    codecs: [Codec; 1],
    /// The bytes of the rows of the shard that is not complete yet.
    waiting: Vec<u8>,
    /// Rows written in all, over all axes down to that of the rows.
    written: usize,
}

impl ZarrWriter {
    /// Begins an array in a folder of its own.
    ///
    /// # Panics
    /// As [`ShardLayout::new`].
    pub(crate) fn create<T: ZarrNumber>(
        folder: &Path,
        shape: &[usize],
        spec: &ArraySpec<'_>,
    ) -> io::Result<Self> {
        let layout = ShardLayout::new(shape, size_of::<T>());
        let codecs = spec.codecs();
        let described = match codecs {
            [Codec::Gzip] => {
                json!({ "name": "gzip", "configuration": { "level": flate2::Compression::default().level() } })
            }
            _ => json!({ "name": "crc32c" }),
        };
        let shards = json!([{ "name": "sharding_indexed", "configuration": {
            "chunk_shape": layout.chunk,
            "codecs": [plain(), described],
            "index_codecs": [plain(), { "name": "crc32c" }],
            "index_location": "end",
        } }]);
        write_json(folder, &spec.json::<T>(shape, &layout.shard(), &shards))?;
        let size = size_of::<T>();
        Ok(Self { folder: folder.to_owned(), layout, size, codecs, waiting: Vec::new(), written: 0 })
    }

    /// Adds rows: everything along the last axes.
    ///
    /// # Panics
    /// When these are no whole rows of elements of the array's type.
    pub(crate) fn append<T: ZarrNumber>(&mut self, numbers: &[T]) -> io::Result<()> {
        assert_eq!(size_of::<T>(), self.size, "the type of the array");
        let (row, all) = (self.layout.row(), self.layout.shape[self.layout.slow]);
        let most = self.layout.chunk[self.layout.slow];
        assert!(numbers.len().is_multiple_of(row), "whole rows");
        for numbers in numbers.chunks_exact(row) {
            if self.waiting.capacity() == 0 {
                self.waiting.try_reserve_exact(most * row * self.size)?;
            }
            self.waiting.extend_from_slice(&T::bytes(numbers));
            self.written += 1;
            let along = self.written % all;
            if along.is_multiple_of(most) {
                self.shard()?;
            }
        }
        Ok(())
    }

    /// Ends the array.
    ///
    /// # Panics
    /// When rows are missing.
    pub(crate) fn finish(self) {
        let rows: usize = self.layout.shape[..=self.layout.slow].iter().product();
        assert_eq!((self.written, self.waiting.len()), (rows, 0), "all rows");
    }

    /// Writes the shard whose rows are waiting.
    fn shard(&mut self) -> io::Result<()> {
        let ShardLayout { shape, chunk, slow } = &self.layout;
        let counts = self.layout.chunks();
        let across = &counts[slow + 1..];
        let encoded: Vec<Vec<u8>> = (0..across.iter().product())
            .into_par_iter()
            .map(|flat| encode(self.chunk(across, flat), &self.codecs))
            .collect::<io::Result<_>>()?;
        let mut places: Vec<Place> = Vec::with_capacity(encoded.len());
        let mut end = 0;
        for chunk in &encoded {
            places.push((end, chunk.len() as u64));
            end += chunk.len() as u64;
        }
        // The last of the rows that are waiting, along all axes down to theirs.
        let mut rest = self.written - 1;
        let mut at = vec![0; shape.len()];
        for axis in (0..=*slow).rev() {
            at[axis] = rest % shape[axis] / chunk[axis];
            rest /= shape[axis];
        }
        let mut path = self.folder.join("c");
        path.extend(at.iter().map(usize::to_string));
        fs::create_dir_all(path.parent().unwrap_or(&self.folder))?;
        let mut file = io::BufWriter::new(fs::File::create(path)?);
        for bytes in encoded.iter().chain([&encode_index(&places)]) {
            io::Write::write_all(&mut file, bytes)?;
        }
        self.waiting.clear();
        io::Write::flush(&mut file)
    }

    /// The bytes of a chunk of the rows that are waiting; 0 where it exceeds the array.
    fn chunk(&self, across: &[usize], flat: usize) -> Vec<u8> {
        let ShardLayout { shape, chunk, slow } = &self.layout;
        let (shape, sizes) = (&shape[slow + 1..], &chunk[slow + 1..]);
        // One or two axes: of one, as if there were another of length 1.
        let [rows, columns] = match *shape {
            [n] => [1, n],
            [rows, columns] => [rows, columns],
            _ => unreachable!("a layout of one or two axes within a row"),
        };
        let ([chunk_rows, chunk_columns], per_row) = match *sizes {
            [n] => ([1, n], across[0]),
            [a, b] => ([a, b], across[1]),
            _ => unreachable!("as many sizes as axes"),
        };
        let (top, left) = (flat / per_row * chunk_rows, flat % per_row * chunk_columns);
        let run = chunk_columns.min(columns - left) * self.size;
        let mut bytes = vec![0; chunk[*slow] * chunk_rows * chunk_columns * self.size];
        let slabs = self.waiting.len() / (rows * columns * self.size);
        for (z, row) in (0..slabs).flat_map(|z| (0..chunk_rows.min(rows - top)).map(move |row| (z, row))) {
            let from = ((z * rows + top + row) * columns + left) * self.size;
            let to = (z * chunk_rows + row) * chunk_columns * self.size;
            bytes[to..to + run].copy_from_slice(&self.waiting[from..from + run]);
        }
        bytes
    }
}
