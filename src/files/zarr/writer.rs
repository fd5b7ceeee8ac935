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

/// Encoded shards of a volume's arrays, which somebody has made before; see [`ShardEncoder`].
pub(crate) trait EncodedShards: Sync {
    /// The bytes of a shard by its number; `None` where there are none that can be used.
    fn shard(&self, number: u64) -> Option<Vec<u8>>;
}

/// Those of one array: where they are, and the number of each along the axis of the rows.
pub(crate) type ShardsOfArray<'a> = (&'a dyn EncodedShards, Vec<u64>);

/// Encodes the shards of an array, each by itself. Chunks are compressed by rayon's current threads; the bytes do not depend
/// on how many there are.
#[derive(Debug)]
pub(crate) struct ShardEncoder {
    layout: ShardLayout,
    /// Bytes of an element.
    size: usize,
    codecs: [Codec; 1],
}

impl ShardEncoder {
    /// Of an array of this shape, with chunks that are compressed or else have a checksum.
    ///
    /// # Panics
    /// As [`ShardLayout::new`].
    pub(crate) fn new<T: ZarrNumber>(shape: &[usize], zip: bool) -> Self {
        // gzip has a checksum of its own.
        let codecs = [if zip { Codec::Gzip } else { Codec::Crc32c }];
        Self { layout: ShardLayout::new(shape, size_of::<T>()), size: size_of::<T>(), codecs }
    }

    pub(crate) fn layout(&self) -> &ShardLayout {
        &self.layout
    }

    /// The metadata of the array.
    fn json<T: ZarrNumber>(&self, spec: &ArraySpec<'_>) -> Value {
        let described = match self.codecs {
            [Codec::Gzip] => {
                json!({ "name": "gzip", "configuration": { "level": flate2::Compression::default().level() } })
            }
            _ => json!({ "name": "crc32c" }),
        };
        let shards = json!([{ "name": "sharding_indexed", "configuration": {
            "chunk_shape": self.layout.chunk,
            "codecs": [plain(), described],
            "index_codecs": [plain(), { "name": "crc32c" }],
            "index_location": "end",
        } }]);
        spec.json::<T>(&self.layout.shape, &self.layout.shard(), &shards)
    }

    /// The bytes of a shard, chunk by chunk and then the index, from those of its rows.
    pub(crate) fn encode(&self, rows: &[u8]) -> io::Result<Vec<Vec<u8>>> {
        let across = &self.layout.chunks()[self.layout.slow + 1..];
        let mut encoded: Vec<Vec<u8>> = (0..across.iter().product())
            .into_par_iter()
            .map(|flat| encode(self.chunk(rows, across, flat), &self.codecs))
            .collect::<io::Result<_>>()?;
        let mut places: Vec<Place> = Vec::with_capacity(encoded.len());
        let mut end = 0;
        for chunk in &encoded {
            places.push((end, chunk.len() as u64));
            end += chunk.len() as u64;
        }
        encoded.push(encode_index(&places));
        Ok(encoded)
    }

    /// The bytes of a chunk of these rows; 0 where it exceeds the array.
    fn chunk(&self, rows_of_shard: &[u8], across: &[usize], flat: usize) -> Vec<u8> {
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
        let slabs = rows_of_shard.len() / (rows * columns * self.size);
        for (z, row) in (0..slabs).flat_map(|z| (0..chunk_rows.min(rows - top)).map(move |row| (z, row))) {
            let from = ((z * rows + top + row) * columns + left) * self.size;
            let to = (z * chunk_rows + row) * chunk_columns * self.size;
            bytes[to..to + run].copy_from_slice(&rows_of_shard[from..from + run]);
        }
        bytes
    }
}

/// An array that is written row after row, as many as its [`ShardLayout`] says in each shard. The bytes do not depend on how
/// the rows come.
pub(crate) struct ZarrWriter<'a> {
    folder: PathBuf,
    encoder: ShardEncoder,
    /// Shards that need not be encoded again.
    encoded: Option<ShardsOfArray<'a>>,
    /// The bytes of the rows of the shard that is not complete yet.
    waiting: Vec<u8>,
    /// Rows written in all, over all axes down to that of the rows.
    written: usize,
}

impl<'a> ZarrWriter<'a> {
    /// Begins an array in a folder of its own.
    ///
    /// # Panics
    /// As [`ShardLayout::new`].
    pub(crate) fn create<T: ZarrNumber>(
        folder: &Path,
        shape: &[usize],
        spec: &ArraySpec<'_>,
    ) -> io::Result<Self> {
        let encoder = ShardEncoder::new::<T>(shape, spec.zip);
        write_json(folder, &encoder.json::<T>(spec))?;
        Ok(Self { folder: folder.to_owned(), encoder, encoded: None, waiting: Vec::new(), written: 0 })
    }

    /// Takes what shards it can from these.
    pub(crate) fn take_from(&mut self, encoded: Option<ShardsOfArray<'a>>) {
        self.encoded = encoded;
    }

    /// Adds rows: everything along the last axes.
    ///
    /// # Panics
    /// When these are no whole rows of elements of the array's type.
    pub(crate) fn append<T: ZarrNumber>(&mut self, numbers: &[T]) -> io::Result<()> {
        let ShardEncoder { layout, size, .. } = &self.encoder;
        assert_eq!(size_of::<T>(), *size, "the type of the array");
        let (row, all, most) = (layout.row(), layout.shape[layout.slow], layout.chunk[layout.slow]);
        let bytes = most * row * size;
        assert!(numbers.len().is_multiple_of(row), "whole rows");
        for numbers in numbers.chunks_exact(row) {
            if self.waiting.capacity() == 0 {
                self.waiting.try_reserve_exact(bytes)?;
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
        let layout = &self.encoder.layout;
        let rows: usize = layout.shape[..=layout.slow].iter().product();
        assert_eq!((self.written, self.waiting.len()), (rows, 0), "all rows");
    }

    /// Writes the shard whose rows are waiting.
    fn shard(&mut self) -> io::Result<()> {
        let ShardLayout { shape, chunk, slow } = &self.encoder.layout;
        // The last of the rows that are waiting, along all axes down to theirs.
        let mut rest = self.written - 1;
        let mut at = vec![0; shape.len()];
        for axis in (0..=*slow).rev() {
            at[axis] = rest % shape[axis] / chunk[axis];
            rest /= shape[axis];
        }
        let encoded = self.encoded.as_ref().and_then(|(shards, numbers)| shards.shard(numbers[at[*slow]]));
        let encoded = match encoded {
            Some(shard) => vec![shard],
            None => self.encoder.encode(&self.waiting)?,
        };
        let mut path = self.folder.join("c");
        path.extend(at.iter().map(usize::to_string));
        fs::create_dir_all(path.parent().unwrap_or(&self.folder))?;
        let mut file = io::BufWriter::new(fs::File::create(path)?);
        encoded.iter().try_for_each(|bytes| io::Write::write_all(&mut file, bytes))?;
        self.waiting.clear();
        io::Write::flush(&mut file)
    }
}
