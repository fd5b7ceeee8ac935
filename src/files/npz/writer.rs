//! Writes `.npz` files: plain little-endian arrays in C order, uncompressed and without times.

use crate::error::Result;
use crate::files::write_atomically;
use num_complex::Complex32;
use std::borrow::Cow;
use std::fs::File;
use std::io::{self, BufWriter, Seek, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System, ZipWriter};

/// The arrays of a file that is being written. Every method returns the errors of writing.
#[derive(Debug)]
pub(crate) struct NpzWriter<W: Write + Seek> {
    archive: ZipWriter<W>,
}

/// Writes an `.npz` file; `write` adds the arrays one after the other. Files of the same arrays are bit-identical.
///
/// # Errors
/// As [`write_atomically`]; a name that is given twice.
pub(crate) fn write_npz(
    path: &Path,
    write: impl FnOnce(&mut NpzWriter<BufWriter<&File>>) -> io::Result<()>,
) -> Result<()> {
    write_atomically(path, |out| {
        let file: &File = out.get_ref();
        let mut npz = NpzWriter::new(BufWriter::with_capacity(1 << 16, file));
        write(&mut npz)?;
        npz.finish()
    })
}

impl<W: Write + Seek> NpzWriter<W> {
    /// Begins a file.
    pub(crate) fn new(out: W) -> Self {
        Self { archive: ZipWriter::new(out) }
    }

    /// Ends the file.
    pub(crate) fn finish(self) -> io::Result<()> {
        self.archive.finish()?.flush()
    }

    /// Begins an array of complex64 of the given shape, whose elements follow by [`NpzWriter::append`].
    pub(crate) fn begin_complex(&mut self, name: &str, shape: &[usize]) -> io::Result<()> {
        let elements = shape.iter().fold(1u64, |product, &n| product.saturating_mul(n as u64));
        self.begin(name, "<c8", shape, elements.saturating_mul(8))
    }

    /// Adds elements to the array that was begun last.
    pub(crate) fn append(&mut self, data: &[Complex32]) -> io::Result<()> {
        self.archive.write_all(&little_endian(bytemuck::cast_slice::<_, f32>(data), f32::to_le_bytes))
    }

    /// Adds an array of complex64.
    ///
    /// # Panics
    /// When `data` does not hold exactly as many elements as `shape` says; likewise in the other methods.
    pub(crate) fn complex(&mut self, name: &str, shape: &[usize], data: &[Complex32]) -> io::Result<()> {
        let parts: &[f32] = bytemuck::cast_slice(data);
        self.array(name, "<c8", shape, data.len(), &little_endian(parts, f32::to_le_bytes))
    }

    /// Adds an array of float32.
    pub(crate) fn f32(&mut self, name: &str, shape: &[usize], data: &[f32]) -> io::Result<()> {
        self.array(name, "<f4", shape, data.len(), &little_endian(data, f32::to_le_bytes))
    }

    /// Adds an array of float64.
    pub(crate) fn f64(&mut self, name: &str, shape: &[usize], data: &[f64]) -> io::Result<()> {
        self.array(name, "<f8", shape, data.len(), &little_endian(data, f64::to_le_bytes))
    }

    /// Adds a text as the uint8 array of its UTF-8.
    pub(crate) fn text(&mut self, name: &str, text: &str) -> io::Result<()> {
        self.array(name, "|u1", &[text.len()], text.len(), text.as_bytes())
    }

    fn array(
        &mut self,
        name: &str,
        descr: &str,
        shape: &[usize],
        elements: usize,
        bytes: &[u8],
    ) -> io::Result<()> {
        assert_eq!(shape.iter().product::<usize>(), elements, "array `{name}`: the data must fill the shape");
        self.begin(name, descr, shape, bytes.len() as u64)?;
        self.archive.write_all(bytes)
    }

    fn begin(&mut self, name: &str, descr: &str, shape: &[usize], bytes: u64) -> io::Result<()> {
        let header = header(descr, shape);
        // Beyond 32 bits an entry needs its sizes in ZIP64 form, which must be known beforehand.
        let large = (header.len() as u64).saturating_add(bytes) >= u64::from(u32::MAX);
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .system(System::Unix)
            .unix_permissions(0o644)
            .large_file(large);
        self.archive.start_file(format!("{name}.npy"), options)?;
        self.archive.write_all(&header)
    }
}

/// An NPY header of version 1, padded as `NumPy` pads it so that the data start at a multiple of 64 bytes.
fn header(descr: &str, shape: &[usize]) -> Vec<u8> {
    let mut sizes = shape.iter().map(usize::to_string).collect::<Vec<_>>().join(", ");
    if shape.len() == 1 {
        // In Python the comma distinguishes a tuple of one from a number in parentheses.
        sizes.push(',');
    }
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({sizes}), }}");
    while (10 + text.len() + 1) % 64 != 0 {
        text.push(' ');
    }
    text.push('\n');
    let length = u16::try_from(text.len()).expect("a few axes take a few dozen characters");
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend_from_slice(&length.to_le_bytes());
    header.extend_from_slice(text.as_bytes());
    header
}

/// The numbers' little-endian bytes, without a copy on a little-endian machine.
pub(in crate::files) fn little_endian<const N: usize, T: bytemuck::NoUninit>(
    numbers: &[T],
    bytes_of: fn(T) -> [u8; N],
) -> Cow<'_, [u8]> {
    if cfg!(target_endian = "little") {
        Cow::Borrowed(bytemuck::cast_slice(numbers))
    } else {
        Cow::Owned(numbers.iter().flat_map(|&number| bytes_of(number)).collect())
    }
}
