//! Typed arrays in the buffers of a glTF file: positions, indices, rotations, dense or sparse, with every range
//! checked.
//!
//! Values are read one at a time from the buffer, without a copy. Many primitives may therefore share one array, and
//! a thousand views of the same bytes take no extra memory.

use ::gltf::json;
use glam::{DQuat, DVec3};
use json::accessor::{ComponentType, GenericComponentType, IndexComponentType, Type};
use json::validation::Checked;

use super::container::Document;
use crate::error::{Error, Result};

/// Maximum length of an accessor without a buffer. It is all zeros and takes no bytes in the file, so the file's size
/// does not limit it.
const MOST_ZEROS: u64 = 1 << 24;

/// Bytes of the largest element: four 32-bit floats.
const LARGEST: usize = 16;

/// The values of an accessor: its dense part, or zeros, overlaid by the sparse part.
pub(super) struct Accessor<'a> {
    dense: Option<Strided<'a>>,
    /// Indices of the replaced values, ascending, and their replacements.
    sparse: Option<(Strided<'a>, Strided<'a>)>,
    count: usize,
    /// Bytes of a value.
    size: usize,
    kind: ComponentType,
    normalized: bool,
    place: String,
}

impl<'a> Accessor<'a> {
    /// Vertex positions: three 32-bit floats each, or bytes or shorts with KHR_mesh_quantization.
    pub(super) fn positions(document: &'a Document<'_>, index: usize) -> Result<Self> {
        let quantized = document.uses("KHR_mesh_quantization");
        let kinds = |kind| kind == ComponentType::F32 || quantized && kind != ComponentType::U32;
        let expected = "positions of three 32-bit floats, or of bytes or shorts in a file that declares the \
                        extension KHR_mesh_quantization";
        Self::new(document, index, Type::Vec3, kinds, expected)
    }

    /// Displacements or scales of instances.
    pub(super) fn offsets(document: &'a Document<'_>, index: usize) -> Result<Self> {
        let kinds = |kind| kind == ComponentType::F32;
        Self::new(document, index, Type::Vec3, kinds, "vectors of three 32-bit floats")
    }

    /// Rotations of instances.
    pub(super) fn quaternions(document: &'a Document<'_>, index: usize) -> Result<Self> {
        let kinds = |kind| matches!(kind, ComponentType::F32 | ComponentType::I8 | ComponentType::I16);
        let expected = "rotations of four 32-bit floats, bytes or shorts";
        Self::new(document, index, Type::Vec4, kinds, expected)
    }

    /// Vertex indices.
    pub(super) fn indices(document: &'a Document<'_>, index: usize) -> Result<Self> {
        let kinds = |kind| matches!(kind, ComponentType::U8 | ComponentType::U16 | ComponentType::U32);
        let expected = "indices: scalars of unsigned bytes, shorts or integers";
        Self::new(document, index, Type::Scalar, kinds, expected)
    }

    fn new(
        document: &'a Document<'_>,
        index: usize,
        shape: Type,
        kinds: impl Fn(ComponentType) -> bool,
        expected: &str,
    ) -> Result<Self> {
        let accessor = find(document, index)?;
        let place = document.place("accessor", index, accessor.name.as_ref());
        let kind = match (accessor.type_, accessor.component_type) {
            (Checked::Valid(found), Checked::Valid(GenericComponentType(kind)))
                if found == shape && kinds(kind) =>
            {
                kind
            }
            _ => return Err(Error::input(place, format!("must contain {expected}"))),
        };
        let (count, size) = (accessor.count.0, kind.size() * shape.multiplicity());
        let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
        let dense = match accessor.buffer_view {
            Some(view) => Some(Strided::new(document, view.value(), offset, count, size, &place)?),
            None if count <= MOST_ZEROS => None,
            None => {
                return Err(Error::input(place, format!("declares {count} values but has no buffer view")));
            }
        };
        let sparse = accessor.sparse.as_ref();
        let sparse = sparse.map(|sparse| replacements(document, sparse, count, size, &place)).transpose()?;
        let (count, normalized) = (count as usize, accessor.normalized);
        Ok(Self { dense, sparse, count, size, kind, normalized, place })
    }

    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// The bytes of value `i`, which must be below the count.
    fn get(&self, i: usize) -> &'a [u8] {
        if let Some((indices, values)) = &self.sparse
            && let Some(k) = indices.find(i)
        {
            return values.get(k);
        }
        match &self.dense {
            Some(dense) => dense.get(i),
            None => &[0; LARGEST][..self.size],
        }
    }

    /// # Errors
    /// A number that is not finite.
    pub(super) fn vector(&self, i: usize) -> Result<DVec3> {
        let vector = DVec3::from_array(self.numbers(i));
        self.finite(vector.is_finite(), i, &vector)?;
        Ok(vector)
    }

    /// # Errors
    /// A number that is not finite.
    pub(super) fn quaternion(&self, i: usize) -> Result<DQuat> {
        let rotation = DQuat::from_array(self.numbers(i));
        self.finite(rotation.is_finite(), i, &rotation)?;
        Ok(rotation)
    }

    /// An index, which is one unsigned number.
    pub(super) fn index(&self, i: usize) -> usize {
        unsigned(self.get(i)) as usize
    }

    fn finite(&self, is_finite: bool, i: usize, value: &dyn std::fmt::Display) -> Result<()> {
        if is_finite {
            return Ok(());
        }
        Err(Error::input(&self.place, format!("value {i} is not finite: {value}")))
    }

    /// The components of a value; `normalized` integers represent -1..1 or 0..1 (glTF 2.0 specification, 3.11).
    fn numbers<const N: usize>(&self, i: usize) -> [f64; N] {
        let (bytes, size) = (self.get(i), self.kind.size());
        std::array::from_fn(|axis| {
            let at = &bytes[axis * size..(axis + 1) * size];
            let (value, one) = match self.kind {
                ComponentType::I8 => (f64::from(at[0] as i8), 127.0),
                ComponentType::U8 => (f64::from(at[0]), 255.0),
                ComponentType::I16 => (f64::from(i16::from_le_bytes([at[0], at[1]])), 32_767.0),
                ComponentType::U16 => (f64::from(u16::from_le_bytes([at[0], at[1]])), 65_535.0),
                ComponentType::U32 => (f64::from(unsigned(at)), f64::from(u32::MAX)),
                ComponentType::F32 => return f64::from(f32::from_le_bytes([at[0], at[1], at[2], at[3]])),
            };
            if self.normalized { (value / one).max(-1.0) } else { value }
        })
    }
}

/// A little-endian number of one to four bytes.
fn unsigned(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |number, &byte| number << 8 | u32::from(byte))
}

/// The accessor with this index.
pub(super) fn find<'a>(document: &'a Document<'_>, index: usize) -> Result<&'a json::Accessor> {
    document
        .root
        .accessors
        .get(index)
        .ok_or_else(|| document.file.refused(format!("refers to accessor {index}, which does not exist")))
}

/// The sparse part of an accessor, checked to be in order and within range.
fn replacements<'a>(
    document: &'a Document<'_>,
    sparse: &json::accessor::sparse::Sparse,
    count: u64,
    size: usize,
    place: &str,
) -> Result<(Strided<'a>, Strided<'a>)> {
    let Checked::Valid(IndexComponentType(kind)) = sparse.indices.component_type else {
        return Err(Error::input(place, "its sparse indices must be of an unsigned integer type"));
    };
    let n = sparse.count.0;
    let (at, new) = (&sparse.indices, &sparse.values);
    let indices = Strided::new(document, at.buffer_view.value(), at.byte_offset.0, n, kind.size(), place)?;
    let values = Strided::new(document, new.buffer_view.value(), new.byte_offset.0, n, size, place)?;
    document.spend(n, place)?;
    let mut least = 0;
    for k in 0..indices.count {
        let index = u64::from(unsigned(indices.get(k)));
        let refused = |why| Err(Error::input(place, format!("its sparse part replaces value {index}{why}")));
        if index >= count {
            return refused(format!(", counted from 0, of {count}"));
        }
        if index < least {
            return refused(format!(" after {}; the indices must ascend", least - 1));
        }
        least = index + 1;
    }
    Ok((indices, values))
}

/// `count` elements of `size` bytes, `stride` apart, checked to be within their buffer.
struct Strided<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
    count: usize,
}

impl<'a> Strided<'a> {
    fn new(
        document: &'a Document<'_>,
        view_index: usize,
        offset: u64,
        count: u64,
        size: usize,
        place: &str,
    ) -> Result<Self> {
        let refused = |problem: String| Error::input(place, problem);
        let Some(view) = document.root.buffer_views.get(view_index) else {
            return Err(refused(format!("refers to buffer view {view_index}, which does not exist")));
        };
        let buffer = document.buffers.get(view.buffer.value()).ok_or_else(|| {
            refused(format!("its buffer view {view_index} refers to a buffer that does not exist"))
        })?;
        let start = view.byte_offset.map_or(0, |offset| offset.0);
        let bytes = start
            .checked_add(view.byte_length.0)
            .and_then(|end| buffer.get(usize::try_from(start).ok()?..usize::try_from(end).ok()?));
        let Some(bytes) = bytes else {
            return Err(refused(format!(
                "its buffer view {view_index} ends beyond the {} bytes of its buffer",
                buffer.len()
            )));
        };
        let stride = view.byte_stride.map_or(size, |stride| stride.0);
        if stride < size {
            return Err(refused(format!("its buffer view {view_index} has a stride of {stride} bytes")));
        }
        // In u128, where no product of declared numbers overflows.
        let needed = match count {
            0 => 0,
            _ => u128::from(offset) + u128::from(count - 1) * stride as u128 + size as u128,
        };
        if needed > bytes.len() as u128 {
            return Err(refused(format!(
                "needs {needed} bytes of buffer view {view_index}, which has {}; the file may be cut short",
                bytes.len()
            )));
        }
        let bytes = if count == 0 { &[] } else { &bytes[offset as usize..] };
        Ok(Self { bytes, stride, size, count: count as usize })
    }

    fn get(&self, i: usize) -> &'a [u8] {
        &self.bytes[i * self.stride..i * self.stride + self.size]
    }

    /// The position of an unsigned number among ascending ones.
    fn find(&self, number: usize) -> Option<usize> {
        let (mut low, mut high) = (0, self.count);
        while low < high {
            let middle = low + (high - low) / 2;
            match (unsigned(self.get(middle)) as usize).cmp(&number) {
                std::cmp::Ordering::Less => low = middle + 1,
                std::cmp::Ordering::Greater => high = middle,
                std::cmp::Ordering::Equal => return Some(middle),
            }
        }
        None
    }
}
