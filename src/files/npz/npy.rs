//! Plain `.npy` files: one array, or several that were saved to one file one after the other.

use super::elements::{ComplexReader, any_complex, scalar_reader};
use super::header::{DtypeKind, NpyHeader};
use super::{Array, does_not_fit};
use crate::error::{Error, Result};
use crate::files::open_input;
use num_complex::Complex32;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// The most arrays of one file; more are mistakes.
const MOST_ARRAYS: usize = 1 << 12;

/// An open `.npy` file, of which only the headers have been read.
#[derive(Debug)]
pub(crate) struct NpyReader {
    path: PathBuf,
    limit_bytes: u64,
    file: BufReader<File>,
    /// Header and place in the file of each array.
    arrays: Vec<(NpyHeader, u64)>,
}

impl NpyReader {
    /// Opens a file and reads the headers of its arrays. No array larger than `limit_bytes` in memory will be read from it.
    ///
    /// # Errors
    /// A missing file, headers that are malformed, arrays that the file is too short for, bytes after the last array.
    pub(crate) fn open(path: &Path, limit_bytes: u64) -> Result<Self> {
        let file = open_input(path)?;
        let reading = |error| Error::reading(path, error);
        let on_disk = file.metadata().map_err(reading)?.len();
        let mut file = BufReader::new(file);
        let mut arrays = Vec::new();
        let mut at = 0_u64;
        while at < on_disk || arrays.is_empty() {
            let refuse = |problem: String| Err(Error::input(place_of(path, arrays.len()), problem));
            if arrays.len() == MOST_ARRAYS {
                return refuse(format!("is one too many; at most {MOST_ARRAYS} are read from a file"));
            }
            file.seek(SeekFrom::Start(at)).map_err(reading)?;
            let header = match NpyHeader::read(&mut file) {
                Ok(header) => header,
                Err(problem) => return refuse(format!("{problem}; a .npy file of numpy.save was expected")),
            };
            let bytes = header.elements().and_then(|n| n.checked_mul(header.dtype.size));
            let end = bytes.and_then(|bytes| at.checked_add(header.length)?.checked_add(bytes));
            match end.filter(|end| *end <= on_disk) {
                None => {
                    return refuse(format!(
                        "has the shape {:?} of {}-byte elements, more than the {} bytes that are left of the file; it is \
                         truncated, or its header is wrong",
                        header.shape,
                        header.dtype.size,
                        on_disk.saturating_sub(at + header.length)
                    ));
                }
                Some(end) => {
                    let begin = at + header.length;
                    arrays.push((header, begin));
                    at = end;
                }
            }
        }
        Ok(Self { path: path.to_path_buf(), limit_bytes, file, arrays })
    }

    /// Number of arrays.
    pub(crate) fn len(&self) -> usize {
        self.arrays.len()
    }

    /// Sizes of the axes of array `index`, slowest first.
    ///
    /// # Panics
    /// Without such an array; likewise the other methods.
    pub(crate) fn shape(&self, index: usize) -> &[usize] {
        &self.arrays[index].0.shape
    }

    /// Whether the elements are complex numbers.
    pub(crate) fn dtype_is_complex(&self, index: usize) -> bool {
        self.arrays[index].0.dtype.kind == DtypeKind::Complex
    }

    /// Whether the elements are unsigned integers.
    pub(crate) fn dtype_is_unsigned(&self, index: usize) -> bool {
        self.arrays[index].0.dtype.kind == DtypeKind::Unsigned
    }

    /// An array of complex numbers; real numbers get the imaginary part 0.
    ///
    /// # Errors
    /// Text in place of numbers, an array larger than the limit, a file that cannot be read.
    pub(crate) fn complex(&mut self, index: usize) -> Result<Array<Complex32>> {
        let convert: ComplexReader = any_complex;
        self.read(index, |header, bytes, data| convert(header.dtype, bytes, data))
    }

    /// An array of real numbers in double precision.
    ///
    /// # Errors
    /// As [`NpyReader::complex`], and complex numbers.
    pub(crate) fn f64(&mut self, index: usize) -> Result<Array<f64>> {
        if self.dtype_is_complex(index) {
            let problem = "contains complex numbers; real numbers were expected";
            return Err(Error::input(place_of(&self.path, index), problem));
        }
        self.read(index, |header, bytes, data| {
            if let Some(scalar) = scalar_reader(header.dtype) {
                data.extend(bytes.chunks_exact(header.dtype.size as usize).map(scalar));
            }
        })
    }

    fn read<T: Copy>(
        &mut self,
        index: usize,
        convert: impl Fn(&NpyHeader, &[u8], &mut Vec<T>),
    ) -> Result<Array<T>> {
        let place = place_of(&self.path, index);
        let (header, begin) = self.arrays[index].clone();
        if scalar_reader(header.dtype).is_none() {
            return Err(Error::input(place, "contains text; numbers were expected"));
        }
        let elements = header.elements().unwrap_or(u64::MAX);
        let copies = if header.in_order() { 1 } else { 2 };
        let in_memory = elements.saturating_mul(copies * size_of::<T>() as u64);
        if in_memory > self.limit_bytes {
            let problem = format!(
                "has the shape {:?} and needs {in_memory} bytes, more than the limit of {}; --memory sets another",
                header.shape, self.limit_bytes
            );
            return Err(Error::input(place, problem));
        }
        let reading = |error| Error::reading(&self.path, error);
        self.file.seek(SeekFrom::Start(begin)).map_err(reading)?;
        let mut data = Vec::new();
        let size = header.dtype.size;
        let block_len = ((1 << 16) / size).max(1) * size;
        let mut left = elements * size;
        let mut block = vec![0; block_len.min(left) as usize];
        while left > 0 {
            let now = block_len.min(left) as usize;
            self.file.read_exact(&mut block[..now]).map_err(reading)?;
            header.reserve(&mut data).ok_or_else(|| does_not_fit(&place))?;
            convert(&header, &block[..now], &mut data);
            left -= now as u64;
        }
        header.array(data).ok_or_else(|| does_not_fit(&place))
    }
}

fn place_of(path: &Path, index: usize) -> String {
    if index == 0 { path.display().to_string() } else { format!("{}, array {index}", path.display()) }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    /// An array as `numpy.save` writes it.
    fn npy(kind: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n");
        [b"\x93NUMPY\x01\x00".as_slice(), &(text.len() as u16).to_le_bytes(), text.as_bytes(), data].concat()
    }

    fn open(bytes: &[u8], limit: u64) -> Result<NpyReader> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        std::fs::write(&path, bytes).unwrap();
        NpyReader::open(&path, limit)
    }

    #[test]
    fn several_arrays_of_one_file_are_read_in_any_order() {
        let halves: Vec<u8> = [0.5_f64, -1.5].iter().flat_map(|v| v.to_be_bytes()).collect();
        let bytes = [npy("<u2", "(2, 1)", &[1, 0, 0, 8]), npy(">f8", "(2,)", &halves)].concat();
        let mut file = open(&bytes, 1 << 10).unwrap();
        assert_eq!((file.len(), file.shape(0), file.shape(1)), (2, [2, 1].as_slice(), [2].as_slice()));
        assert!(file.dtype_is_unsigned(0) && !file.dtype_is_unsigned(1) && !file.dtype_is_complex(1));
        assert_eq!(file.f64(1).unwrap().data, [0.5, -1.5]);
        assert_eq!(file.complex(0).unwrap().data, [1.0, 2048.0].map(|re| Complex32::new(re, 0.0)));
    }

    #[test]
    fn what_a_header_promises_is_checked_against_the_file_and_the_limit() {
        for (bytes, parts) in [
            (npy("<f4", "(3,)", &[0; 8]), &["a.npy", "[3]", "8 bytes"][..]),
            (npy("<f4", "(4294967296, 4294967296, 4294967296)", &[]), &["a.npy", "truncated"]),
            ([npy("<f4", "(1,)", &[0; 4]), vec![7; 30]].concat(), &["array 1", "numpy.save"]),
            (Vec::new(), &["a.npy", "truncated"]),
        ] {
            assert_names(open(&bytes, 1 << 20).unwrap_err().to_string(), parts);
        }
        let mut text = open(&npy("<U1", "(1,)", &[65, 0, 0, 0]), 1 << 20).unwrap();
        assert_names(text.f64(0).unwrap_err().to_string(), &["text"]);
        let mut large = open(&npy("|u1", "(100,)", &[0; 100]), 799).unwrap();
        assert_names(large.f64(0).unwrap_err().to_string(), &["800 bytes", "799", "--memory"]);
    }
}
