//! Named arrays of a file or a store: whatever reads cubes and volumes reads them from an npz and from Zarr alike.

use super::is_store;
use super::npz::{Array, NpzReader};
use super::zarr::ZarrStore;
use crate::error::{Error, Result};
use crate::text::quoted;
use num_complex::Complex32;
use std::path::Path;

/// An open npz or Zarr store, by the extension of its name; of either only the headers have been read.
#[derive(Debug)]
pub(crate) enum ArrayFile {
    /// `.npz`, or any other extension.
    Npz(Box<NpzReader>),
    /// `.zarr`.
    Zarr(ZarrStore),
}

/// Calls a method of either.
macro_rules! either {
    ($self:expr, $file:ident => $call:expr) => {
        match $self {
            ArrayFile::Npz($file) => $call,
            ArrayFile::Zarr($file) => $call,
        }
    };
}

impl ArrayFile {
    /// Opens a file. No array larger than `limit_bytes` in memory will be read from it.
    ///
    /// # Errors
    /// As [`NpzReader::open`] and [`ZarrStore::open`].
    pub(crate) fn open(path: &Path, limit_bytes: u64) -> Result<Self> {
        if is_store(path) {
            return ZarrStore::open(path, limit_bytes).map(Self::Zarr);
        }
        NpzReader::open(path, limit_bytes).map(Box::new).map(Self::Npz)
    }

    /// The arrays' names.
    pub(crate) fn names(&self) -> Vec<&str> {
        either!(self, file => file.names().collect())
    }

    /// Whether there is an array of this name; `meta` of a store is an attribute.
    pub(crate) fn contains(&self, name: &str) -> bool {
        either!(self, file => file.contains(name))
    }

    /// Sizes of an array's axes, slowest first.
    ///
    /// # Errors
    /// A missing array, or one whose header is malformed; likewise in the other methods.
    pub(crate) fn shape(&self, name: &str) -> Result<Vec<usize>> {
        either!(self, file => file.shape(name))
    }

    /// Whether an array's elements are complex numbers.
    pub(crate) fn dtype_is_complex(&self, name: &str) -> Result<bool> {
        either!(self, file => file.dtype_is_complex(name))
    }

    /// Whether an array's elements are unsigned integers.
    pub(crate) fn dtype_is_unsigned(&self, name: &str) -> Result<bool> {
        either!(self, file => file.dtype_is_unsigned(name))
    }

    /// An array of complex numbers; real numbers get the imaginary part 0.
    pub(crate) fn complex(&mut self, name: &str) -> Result<Array<Complex32>> {
        either!(self, file => file.complex(name))
    }

    /// The same in blocks of `block` elements, in C order.
    ///
    /// # Panics
    /// When `block` is 0.
    pub(crate) fn complex_blocks(
        &mut self,
        name: &str,
        block: usize,
        take: impl FnMut(&mut [Complex32]) -> Result<()>,
    ) -> Result<()> {
        either!(self, file => file.complex_blocks(name, block, take))
    }

    /// Bytes that reading an array in blocks takes besides the block.
    pub(crate) fn bytes_beside_block(&self, name: &str) -> u64 {
        match self {
            // In a Fortran array the first axis varies fastest, so its blocks are scattered over the whole file.
            Self::Npz(file) if file.in_order(name) => 0,
            Self::Npz(file) => {
                let sizes = file.shape(name).unwrap_or_default();
                sizes.iter().fold(16, |bytes: u64, n| bytes.saturating_mul(*n as u64))
            }
            Self::Zarr(store) => store.bytes_beside_block(name),
        }
    }

    /// An array of real numbers in double precision.
    pub(crate) fn f64(&mut self, name: &str) -> Result<Array<f64>> {
        either!(self, file => file.f64(name))
    }

    /// A text; of a store, the attribute `meta`.
    pub(crate) fn text(&mut self, name: &str) -> Result<String> {
        either!(self, file => file.text(name))
    }

    /// Everything in the file by name, size and checksum.
    pub(crate) fn fingerprint(&mut self) -> Result<String> {
        either!(self, file => file.fingerprint())
    }
}

/// An invalid array of a file.
pub(crate) fn fault(path: &Path, name: &str, problem: impl Into<String>) -> Error {
    Error::input(place_of(path, name), problem)
}

/// The place of an array in messages.
pub(crate) fn place_of(path: &Path, name: &str) -> String {
    format!("{}, array `{name}`", path.display())
}

/// What is wrong with an array that is not among those present.
pub(super) fn missing<'n>(names: impl Iterator<Item = &'n str>) -> String {
    let present: Vec<_> = names.take(20).map(|name| format!("`{}`", quoted(name))).collect();
    let present = if present.is_empty() { "no arrays".to_owned() } else { present.join(", ") };
    format!("is missing; the file contains {present}")
}

/// What is wrong with an array that is larger than the limit.
pub(super) fn too_large(shape: &[usize], needed: u64, limit: u64) -> String {
    format!(
        "has the shape {shape:?} and needs {needed} bytes, more than the limit of {limit}; raise the limit or use a smaller \
         array"
    )
}

/// The error for an array that does not fit in memory.
pub(super) fn does_not_fit(place: &str) -> Error {
    Error::out_of_memory(format!("{place} does not fit in memory; use a smaller array, or free some memory"))
}
