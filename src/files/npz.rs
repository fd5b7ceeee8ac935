//! `NumPy`'s `.npz`: numeric arrays and text, compatible with `numpy.load` and `numpy.savez`.
//!
//! [`NpzReader`] reads untrusted files: every declared size is checked against the file, against the
//! shape and against a limit in bytes before anything is inflated or allocated. [`write_npz`] stores plain
//! little-endian arrays in C order, so that files of the same arrays are bit-identical.
//!
//! The crates `npyz` 0.9 and `ndarray-npy` 0.10 are not used: both allocate whatever length a header declares, up to
//! 4 GiB, neither limits an array before it is inflated, and each depends on an older `zip`.

mod elements;
mod fingerprint;
mod header;
mod npy;
mod writer;

pub(in crate::files) use elements::{ComplexBlocks, ComplexReader, complex_reader, scalar_reader};
pub(in crate::files) use header::{Dtype, DtypeKind};
pub(crate) use npy::NpyReader;
pub(in crate::files) use writer::little_endian;
pub(crate) use writer::{NpzWriter, write_npz};

use crate::error::{Error, Result};
use crate::files::arrays::{self, does_not_fit, missing, place_of, too_large};
use crate::files::open_input;
use elements::characters;
use header::NpyHeader;
use num_complex::Complex32;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use zip::{CompressionMethod, ZipArchive};

/// The maximum factor by which deflate can compress.
const DEFLATE_AT_MOST: u64 = 1032;

/// An array in C order: the last axis is the fastest.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Array<T> {
    /// Sizes of the axes, slowest first; empty for a scalar.
    pub(crate) shape: Vec<usize>,
    /// The elements; their number is the product of the sizes.
    pub(crate) data: Vec<T>,
}

/// One array of the file: its name, and its header or what is wrong with it.
#[derive(Debug)]
struct Entry {
    name: String,
    index: usize,
    header: std::result::Result<NpyHeader, String>,
}

/// An open `.npz` file, of which only the headers have been read.
#[derive(Debug)]
pub(crate) struct NpzReader {
    path: PathBuf,
    limit_bytes: u64,
    archive: ZipArchive<BufReader<File>>,
    entries: Vec<Entry>,
}

impl NpzReader {
    /// Opens a file and reads the headers of its arrays. No array larger than `limit_bytes` in memory will be
    /// read from it.
    ///
    /// # Errors
    /// A file that is missing, truncated or not a zip archive, or that contains two arrays of one name. A fault of one
    /// array is reported only when that array is read.
    pub(crate) fn open(path: &Path, limit_bytes: u64) -> Result<Self> {
        let file = open_input(path)?;
        let on_disk = file.metadata().map_err(|error| Error::reading(path, error))?;
        let mut archive = ZipArchive::new(BufReader::new(file)).map_err(|error| {
            let expected = "expected a zip archive as numpy.savez writes it";
            Error::input(path.display(), format!("is not a complete .npz file ({error}); {expected}"))
        })?;
        if archive.has_duplicate_names() {
            let problem = "contains two arrays of the same name; each name may appear once";
            return Err(Error::input(path.display(), problem));
        }
        let entries = (0..archive.len())
            .filter_map(|index| {
                let name = archive.name_for_index(index)?.ok()?.strip_suffix(".npy")?.to_owned();
                let header = read_header(&mut archive, index, on_disk.len());
                Some(Entry { name, index, header })
            })
            .collect();
        Ok(Self { path: path.to_path_buf(), limit_bytes, archive, entries })
    }

    /// The arrays' names, in the file's order.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.iter().map(|entry| entry.name.as_str())
    }

    /// Whether there is an array of this name.
    pub(crate) fn contains(&self, name: &str) -> bool {
        self.names().any(|other| other == name)
    }

    /// Sizes of an array's axes, slowest first.
    ///
    /// # Errors
    /// A missing array, or one whose header is malformed or disagrees with the bytes present.
    pub(crate) fn shape(&self, name: &str) -> Result<Vec<usize>> {
        Ok(self.header(name)?.1.shape)
    }

    /// Whether an array's elements are complex numbers.
    ///
    /// # Errors
    /// As [`NpzReader::shape`].
    pub(crate) fn dtype_is_complex(&self, name: &str) -> Result<bool> {
        Ok(self.header(name)?.1.dtype.kind == DtypeKind::Complex)
    }

    /// Whether an array's elements are unsigned integers.
    ///
    /// # Errors
    /// As [`NpzReader::shape`].
    pub(crate) fn dtype_is_unsigned(&self, name: &str) -> Result<bool> {
        Ok(self.header(name)?.1.dtype.kind == DtypeKind::Unsigned)
    }

    /// An array of complex numbers; real numbers get the imaginary part 0.
    ///
    /// # Errors
    /// A missing array, text in place of numbers, sizes that disagree or exceed the limit, damaged bytes.
    pub(crate) fn complex(&mut self, name: &str) -> Result<Array<Complex32>> {
        let (index, header) = self.header(name)?;
        let convert = self.complex_reader(name, header.dtype)?;
        self.array(name, index, header, convert)
    }

    /// How to read an array's elements as real numbers.
    fn scalar_reader(&self, name: &str, dtype: Dtype) -> Result<fn(&[u8]) -> f64> {
        scalar_reader(dtype).ok_or_else(|| self.fault(name, "contains text; numbers were expected"))
    }

    /// How to read an array's elements as complex numbers.
    fn complex_reader(&self, name: &str, dtype: Dtype) -> Result<ComplexReader> {
        self.scalar_reader(name, dtype)?;
        Ok(complex_reader(dtype))
    }

    /// All elements of an array, which `convert` appends from their bytes.
    fn array<T: Copy>(
        &mut self,
        name: &str,
        index: usize,
        header: NpyHeader,
        convert: impl Fn(Dtype, &[u8], &mut Vec<T>),
    ) -> Result<Array<T>> {
        let mut data = Vec::new();
        let place = place_of(&self.path, name);
        self.read(name, index, &header, [u64::MAX, size_of::<T>() as u64], |bytes| {
            header.reserve(&mut data).ok_or_else(|| does_not_fit(&place))?;
            convert(header.dtype, bytes, &mut data);
            Ok(())
        })?;
        header.array(data).ok_or_else(|| does_not_fit(&place))
    }

    /// Whether an array is stored in the order in which it is read, last axis fastest.
    pub(crate) fn in_order(&self, name: &str) -> bool {
        self.header(name).is_ok_and(|(_, header)| header.in_order())
    }

    /// Reads an array of complex numbers in blocks of `block` elements (the last may be shorter), in C order. Only one
    /// block is in memory at a time, and the limit applies to it alone, unless the array is in Fortran order.
    ///
    /// # Errors
    /// As [`NpzReader::complex`], and errors of `take`.
    ///
    /// # Panics
    /// When `block` is 0.
    pub(crate) fn complex_blocks(
        &mut self,
        name: &str,
        block: usize,
        mut take: impl FnMut(&mut [Complex32]) -> Result<()>,
    ) -> Result<()> {
        if !self.in_order(name) {
            return self.complex(name)?.data.chunks_mut(block).try_for_each(take);
        }
        let (index, header) = self.header(name)?;
        self.complex_reader(name, header.dtype)?;
        let mut blocks = ComplexBlocks::new(header.dtype, block, &mut take);
        let (place, elements) = (place_of(&self.path, name), header.elements().unwrap_or(u64::MAX));
        self.read(name, index, &header, [block as u64, 8], |bytes| {
            blocks.add(bytes, elements).ok_or_else(|| does_not_fit(&place))?
        })?;
        blocks.finish()
    }

    /// An array of real numbers in double precision.
    ///
    /// # Errors
    /// As [`NpzReader::complex`], and complex numbers.
    pub(crate) fn f64(&mut self, name: &str) -> Result<Array<f64>> {
        let (index, header) = self.header(name)?;
        if header.dtype.kind == DtypeKind::Complex {
            return Err(self.fault(name, "contains complex numbers; real numbers were expected"));
        }
        let scalar = self.scalar_reader(name, header.dtype)?;
        self.array(name, index, header, |dtype, bytes, data| {
            data.extend(bytes.chunks_exact(dtype.size as usize).map(scalar));
        })
    }

    /// A text: the bytes of its UTF-8 as `uint8`, or one `NumPy` string.
    ///
    /// # Errors
    /// A missing array, anything but one text, sizes that disagree or exceed the limit, damaged bytes.
    pub(crate) fn text(&mut self, name: &str) -> Result<String> {
        let (index, header) = self.header(name)?;
        let one_string = header.shape.is_empty() || header.shape == [1];
        let expected = match (header.dtype.kind, header.dtype.size) {
            (DtypeKind::Unsigned, 1) => header.shape.len() <= 1,
            (DtypeKind::Bytes | DtypeKind::Characters, _) => one_string,
            _ => false,
        };
        if !expected {
            return Err(self.fault(
                name,
                "is not a text; the bytes of a UTF-8 text as uint8, or one NumPy string, were expected",
            ));
        }
        let mut bytes = Vec::new();
        self.read(name, index, &header, [u64::MAX, 1], |block| {
            bytes.extend_from_slice(block);
            Ok(())
        })?;
        let text = if header.dtype.kind == DtypeKind::Characters {
            characters(&bytes, header.dtype.big_endian)
        } else {
            String::from_utf8(bytes).ok()
        };
        match text {
            // NumPy pads its strings with zeros.
            Some(text) => Ok(text.trim_end_matches('\0').to_owned()),
            None => Err(self.fault(name, "is not valid Unicode text; UTF-8 was expected")),
        }
    }

    /// Passes the array's bytes to `take` in blocks of whole elements, after checking that its sizes fit: at most
    /// `block` elements of `bytes_each` are in memory at a time.
    fn read(
        &mut self,
        name: &str,
        index: usize,
        header: &NpyHeader,
        [block, bytes_each]: [u64; 2],
        mut take: impl FnMut(&[u8]) -> Result<()>,
    ) -> Result<()> {
        let elements = header.elements().unwrap_or(u64::MAX);
        // Reordering needs the array in memory twice.
        let copies = if header.in_order() { 1 } else { 2 };
        let in_memory = block.min(elements).saturating_mul(bytes_each.max(header.dtype.size));
        let in_memory = in_memory.saturating_mul(copies);
        if in_memory > self.limit_bytes {
            return Err(self.fault(name, too_large(&header.shape, in_memory, self.limit_bytes)));
        }
        let size = header.dtype.size;
        let mut left = elements * size;
        if left == 0 {
            return Ok(());
        }
        let place = place_of(&self.path, name);
        let broken = |error: &dyn std::fmt::Display| {
            Error::input(&place, format!("is damaged or truncated ({error}); write or copy the file again"))
        };
        let mut entry = self.archive.by_index(index).map_err(|error| broken(&error))?;
        let mut skipped = vec![0; header.length as usize];
        entry.read_exact(&mut skipped).map_err(|error| broken(&error))?;
        let block_len = ((1 << 16) / size).max(1) * size;
        let mut block = vec![0; block_len.min(left) as usize];
        while left > 0 {
            let now = block_len.min(left) as usize;
            entry.read_exact(&mut block[..now]).map_err(|error| broken(&error))?;
            take(&block[..now])?;
            left -= now as u64;
        }
        // The checksum is compared when the end is met.
        match entry.read(&mut [0; 1]) {
            Ok(0) => Ok(()),
            Ok(_) => Err(broken(&"there are more bytes than its shape requires")),
            Err(error) => Err(broken(&error)),
        }
    }

    fn header(&self, name: &str) -> Result<(usize, NpyHeader)> {
        let Some(entry) = self.entries.iter().find(|entry| entry.name == name) else {
            return Err(self.fault(name, missing(self.names())));
        };
        match &entry.header {
            Ok(header) => Ok((entry.index, header.clone())),
            Err(problem) => Err(self.fault(name, problem.as_str())),
        }
    }

    fn fault(&self, name: &str, problem: impl Into<String>) -> Error {
        arrays::fault(&self.path, name, problem)
    }
}

/// Reads one array's header and checks its declared size against its shape and the size of the file.
fn read_header(
    archive: &mut ZipArchive<BufReader<File>>,
    index: usize,
    bytes_on_disk: u64,
) -> std::result::Result<NpyHeader, String> {
    let mut entry = archive.by_index(index).map_err(|error| format!("cannot be read ({error})"))?;
    let (packed, unpacked) = (entry.compressed_size(), entry.size());
    let possible = match entry.compression() {
        CompressionMethod::Stored => packed,
        CompressionMethod::Deflated => packed.saturating_mul(DEFLATE_AT_MOST),
        method => {
            return Err(format!(
                "is compressed with {method}; only stored and deflated arrays are supported"
            ));
        }
    };
    if packed > bytes_on_disk || unpacked > possible {
        return Err(format!(
            "declares {unpacked} bytes, which its {packed} bytes in a file of {bytes_on_disk} cannot contain"
        ));
    }
    let header = NpyHeader::read(&mut entry)?;
    let needed = header
        .elements()
        .and_then(|n| n.checked_mul(header.dtype.size))
        .and_then(|bytes| bytes.checked_add(header.length));
    if needed == Some(unpacked) {
        Ok(header)
    } else {
        Err(format!(
            "has the shape {:?} of {}-byte elements, which does not match its {unpacked} bytes",
            header.shape, header.dtype.size
        ))
    }
}

#[cfg(test)]
mod tests;
