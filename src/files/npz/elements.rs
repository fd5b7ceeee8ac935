//! Elements of an NPY array: bytes in, numbers and characters out.

use super::Array;
use super::header::{Dtype, DtypeKind, NpyHeader};
use crate::error::Result;
use num_complex::Complex32;

/// Appends the elements that are encoded in bytes of a type.
pub(in crate::files) type ComplexReader = fn(Dtype, &[u8], &mut Vec<Complex32>);

/// How to read an array's elements as complex numbers.
pub(in crate::files) fn complex_reader(dtype: Dtype) -> ComplexReader {
    let plain = Dtype { kind: DtypeKind::Complex, size: 8, big_endian: false };
    if dtype == plain { plain_complex } else { any_complex }
}

/// Gathers elements of any number type in blocks of `block`, of which the last may be shorter.
pub(in crate::files) struct ComplexBlocks<F> {
    dtype: Dtype,
    block: usize,
    waiting: Vec<Complex32>,
    take: F,
}

impl<F: FnMut(&mut [Complex32]) -> Result<()>> ComplexBlocks<F> {
    /// Begins with no element.
    pub(in crate::files) fn new(dtype: Dtype, block: usize, take: F) -> Self {
        assert!(block > 0, "blocks of nothing");
        Self { dtype, block, waiting: Vec::new(), take }
    }

    /// Adds the bytes of whole elements of an array of `elements`; `None` where there is no memory for a block.
    pub(in crate::files) fn add(&mut self, mut bytes: &[u8], elements: u64) -> Option<Result<()>> {
        let (convert, size) = (complex_reader(self.dtype), self.dtype.size as usize);
        if self.waiting.capacity() == 0 {
            self.waiting.try_reserve_exact(self.block.min(usize::try_from(elements).ok()?)).ok()?;
        }
        while !bytes.is_empty() {
            let room = (self.block - self.waiting.len()) * size;
            let (now, rest) = bytes.split_at(room.min(bytes.len()));
            convert(self.dtype, now, &mut self.waiting);
            bytes = rest;
            if self.waiting.len() == self.block {
                if let Err(error) = (self.take)(&mut self.waiting) {
                    return Some(Err(error));
                }
                self.waiting.clear();
            }
        }
        Some(Ok(()))
    }

    /// Passes on what is left.
    pub(in crate::files) fn finish(mut self) -> Result<()> {
        if self.waiting.is_empty() { Ok(()) } else { (self.take)(&mut self.waiting) }
    }
}

/// Appends little-endian complex64 elements: what this crate and most of `NumPy`'s users write.
pub(super) fn plain_complex(_: Dtype, bytes: &[u8], numbers: &mut Vec<Complex32>) {
    numbers.extend(bytes.as_chunks::<8>().0.iter().map(|&[a, b, c, d, e, f, g, h]| {
        Complex32::new(f32::from_le_bytes([a, b, c, d]), f32::from_le_bytes([e, f, g, h]))
    }));
}

/// Appends elements of any number type; real numbers get the imaginary part 0.
pub(super) fn any_complex(dtype: Dtype, bytes: &[u8], numbers: &mut Vec<Complex32>) {
    let Some(scalar) = scalar_reader(dtype) else { return };
    let size = dtype.size as usize;
    numbers.extend(bytes.chunks_exact(size).map(|element| {
        let (re, im) = match dtype.kind {
            DtypeKind::Complex => (scalar(&element[..size / 2]), scalar(&element[size / 2..])),
            _ => (scalar(element), 0.0),
        };
        Complex32::new(re as f32, im as f32)
    }));
}

/// How to read one real number of an array of this type; `None` for text.
pub(in crate::files) fn scalar_reader(dtype: Dtype) -> Option<fn(&[u8]) -> f64> {
    fn first<const N: usize>(bytes: &[u8]) -> [u8; N] {
        *bytes.first_chunk().expect("elements of the type's size")
    }
    macro_rules! reader {
        ($number:ty) => {
            Some(if dtype.big_endian {
                |bytes| <$number>::from_be_bytes(first(bytes)) as f64
            } else {
                |bytes| <$number>::from_le_bytes(first(bytes)) as f64
            })
        };
    }
    // Both parts of a complex number are read by the same function as a real one.
    #[allow(clippy::cast_lossless, clippy::unnecessary_cast)]
    match (dtype.kind, dtype.size) {
        (DtypeKind::Float, 4) | (DtypeKind::Complex, 8) => reader!(f32),
        (DtypeKind::Float, 8) | (DtypeKind::Complex, 16) => reader!(f64),
        (DtypeKind::Signed, 1) => reader!(i8),
        (DtypeKind::Signed, 2) => reader!(i16),
        (DtypeKind::Signed, 4) => reader!(i32),
        (DtypeKind::Signed, 8) => reader!(i64),
        (DtypeKind::Unsigned, 1) => reader!(u8),
        (DtypeKind::Unsigned, 2) => reader!(u16),
        (DtypeKind::Unsigned, 4) => reader!(u32),
        (DtypeKind::Unsigned, 8) => reader!(u64),
        _ => None,
    }
}

impl NpyHeader {
    /// Whether the last axis is the fastest.
    pub(super) fn in_order(&self) -> bool {
        !self.fortran || self.shape.len() <= 1
    }

    /// The elements as they were read, rearranged in C order; `None` when a copy does not fit in memory.
    pub(super) fn array<T: Copy>(self, data: Vec<T>) -> Option<Array<T>> {
        let data = if self.in_order() { data } else { c_order(&data, &self.shape)? };
        Some(Array { shape: self.shape, data })
    }

    /// Reserves memory for all elements, once the first is read and so their number is known to be within the limit.
    pub(super) fn reserve<T>(&self, data: &mut Vec<T>) -> Option<()> {
        if data.capacity() > 0 {
            return Some(());
        }
        data.try_reserve_exact(usize::try_from(self.elements()?).ok()?).ok()
    }
}

/// Elements stored with the first axis fastest, rearranged with the last axis fastest; `None` when they do not fit in
/// memory a second time.
fn c_order<T: Copy>(fortran: &[T], shape: &[usize]) -> Option<Vec<T>> {
    let mut strides = Vec::with_capacity(shape.len());
    let mut stride = 1;
    for &n in shape {
        strides.push(stride);
        stride *= n;
    }
    let mut index = vec![0; shape.len()];
    let mut position = 0;
    let mut ordered = Vec::new();
    ordered.try_reserve_exact(fortran.len()).ok()?;
    ordered.extend((0..fortran.len()).map(|_| {
        let element = fortran[position];
        for axis in (0..shape.len()).rev() {
            index[axis] += 1;
            position += strides[axis];
            if index[axis] < shape[axis] {
                break;
            }
            position -= strides[axis] * shape[axis];
            index[axis] = 0;
        }
        element
    }));
    Some(ordered)
}

/// The text of `NumPy`'s four-byte characters.
pub(super) fn characters(bytes: &[u8], big_endian: bool) -> Option<String> {
    bytes
        .chunks_exact(4)
        .map(|c| {
            let code = [c[0], c[1], c[2], c[3]];
            char::from_u32(if big_endian { u32::from_be_bytes(code) } else { u32::from_le_bytes(code) })
        })
        .collect()
}
