//! Typed arrays in the buffers of a glTF file: positions and indices, dense or sparse, with every range checked.

use ::gltf::json;
use glam::DVec3;
use json::accessor::{ComponentType, GenericComponentType, IndexComponentType, Type};
use json::validation::Checked;

use super::container::Document;
use crate::error::{Error, Result};

/// An accessor without a buffer is all zeros and takes no room in the file, so its declared length is not
/// believed beyond this.
const MOST_ZEROS: u64 = 1 << 24;

/// Positions of vertices: three f32 each.
pub(super) fn positions(document: &Document, index: usize) -> Result<Vec<DVec3>> {
    let accessor = find(document, index)?;
    let place = || document.place("accessor", index, accessor.name.as_ref());
    let is_position = matches!(accessor.type_, Checked::Valid(Type::Vec3))
        && matches!(accessor.component_type, Checked::Valid(GenericComponentType(ComponentType::F32)));
    if !is_position {
        return Err(Error::input(
            place(),
            "should hold positions of three 32-bit floats; `gltf-transform dequantize in.glb out.glb` makes them so",
        ));
    }
    let read = |bytes: &[u8]| {
        let number =
            |i: usize| f64::from(f32::from_le_bytes([bytes[i], bytes[i + 1], bytes[i + 2], bytes[i + 3]]));
        DVec3::new(number(0), number(4), number(8))
    };
    let positions = values(document, accessor, &place, 12, DVec3::ZERO, read)?;
    match positions.iter().position(|p| !p.is_finite()) {
        Some(bad) => Err(Error::input(place(), format!("position {bad} is not finite: {}", positions[bad]))),
        None => Ok(positions),
    }
}

/// Numbers of vertices.
pub(super) fn indices(document: &Document, index: usize) -> Result<Vec<u32>> {
    let accessor = find(document, index)?;
    let place = || document.place("accessor", index, accessor.name.as_ref());
    match (accessor.type_, accessor.component_type) {
        (
            Checked::Valid(Type::Scalar),
            Checked::Valid(GenericComponentType(
                kind @ (ComponentType::U8 | ComponentType::U16 | ComponentType::U32),
            )),
        ) => values(document, accessor, &place, kind.size(), 0, unsigned),
        _ => Err(Error::input(place(), "should hold indices: scalars of unsigned bytes, shorts or integers")),
    }
}

/// A little-endian number of one to four bytes.
fn unsigned(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |number, &byte| number << 8 | u32::from(byte))
}

fn find(document: &Document, index: usize) -> Result<&json::Accessor> {
    document
        .root
        .accessors
        .get(index)
        .ok_or_else(|| Error::input(document.name(), format!("names accessor {index}, which is missing")))
}

/// The values of an accessor: its dense part, or zeros, with the sparse part put over it.
fn values<T: Copy>(
    document: &Document,
    accessor: &json::Accessor,
    place: &impl Fn() -> String,
    size: usize,
    zero: T,
    read: impl Fn(&[u8]) -> T,
) -> Result<Vec<T>> {
    let count = accessor.count.0;
    let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
    let mut values = match accessor.buffer_view {
        Some(view) => {
            let bytes = Strided::new(document, view.value(), offset, count, size, place)?;
            bytes.iter().map(&read).collect()
        }
        None if count <= MOST_ZEROS => vec![zero; count as usize],
        None => return Err(Error::input(place(), format!("declares {count} values and has no buffer view"))),
    };
    if let Some(sparse) = &accessor.sparse {
        let Checked::Valid(IndexComponentType(kind)) = sparse.indices.component_type else {
            return Err(Error::input(place(), "its sparse indices are of no unsigned type"));
        };
        let n = sparse.count.0;
        let (at, new) = (&sparse.indices, &sparse.values);
        let indices =
            Strided::new(document, at.buffer_view.value(), at.byte_offset.0, n, kind.size(), place)?;
        let replacements =
            Strided::new(document, new.buffer_view.value(), new.byte_offset.0, n, size, place)?;
        for (index, value) in indices.iter().map(unsigned).zip(replacements.iter()) {
            let Some(slot) = values.get_mut(index as usize) else {
                return Err(Error::input(
                    place(),
                    format!("its sparse part replaces value {index} of {count}"),
                ));
            };
            *slot = read(value);
        }
    }
    Ok(values)
}

/// `count` elements of `size` bytes, `stride` apart, known to lie within their buffer.
struct Strided<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
    count: usize,
}

impl<'a> Strided<'a> {
    fn new(
        document: &'a Document,
        view_index: usize,
        offset: u64,
        count: u64,
        size: usize,
        place: &impl Fn() -> String,
    ) -> Result<Self> {
        let refused = |problem: String| Error::input(place(), problem);
        let Some(view) = document.root.buffer_views.get(view_index) else {
            return Err(refused(format!("names buffer view {view_index}, which is missing")));
        };
        let Some(buffer) = document.buffers.get(view.buffer.value()) else {
            return Err(refused(format!("its buffer view {view_index} names a buffer that is missing")));
        };
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
        // In u128, where no product of what a file can declare overflows.
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

    fn iter(&self) -> impl Iterator<Item = &'a [u8]> {
        let (bytes, stride, size) = (self.bytes, self.stride, self.size);
        (0..self.count).map(move |i| &bytes[i * stride..i * stride + size])
    }
}
