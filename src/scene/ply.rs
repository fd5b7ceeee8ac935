//! PLY, as text or binary of either byte order: vertices, faces of any number of corners, triangle strips.
//!
//! Read here because the crate for it trusts the numbers that a header declares (see [`crate::files::ply`]). Only
//! positions and corners are read.

mod source;

use glam::DVec3;

use super::files::MeshFile;
use super::material::Palette;
use super::surfaces::Surfaces;
use super::{Mesh, Up};
use crate::error::Result;
use crate::files::ply::{Element, Header};
use crate::text::quoted;
use source::Source;

/// Reads a PLY file. See [`Scene::load`](super::Scene::load).
pub(super) fn load<'a>(file: MeshFile<'a>, palette: &mut Palette<'_>) -> Result<Mesh<'a>> {
    file.refuse_sensor("a PLY")?;
    let bytes = file.read()?;
    let (header, length) = Header::read(&bytes, file.path)?;
    let mut source = Source::new(header.format, &bytes[length.bytes..], length.lines);
    let mut surfaces = Surfaces::new(file);
    let (mut vertices, mut faces, mut strips) = (Vertices::default(), Lists::default(), Lists::default());
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => {
                vertices.find_axes(element).map_err(|problem| file.refused(problem))?;
                read_rows(element, &mut source, file, &mut vertices)?;
            }
            name @ ("face" | "tristrips") => {
                let lists = if name == "face" { &mut faces } else { &mut strips };
                lists.find_list(element).map_err(|problem| file.refused(problem))?;
                // Every row has a triangle or more, and no more rows are read than the file can contain.
                surfaces.check_limit(source.rows_of(element))?;
                read_rows(element, &mut source, file, lists)?;
            }
            _ => read_rows(element, &mut source, file, &mut Unread)?,
        }
    }
    if let Some(rest) = source.rest() {
        file.warn(format_args!(
            "{rest} bytes follow the last element that its header declares; they are ignored"
        ));
    }
    if faces.ends.is_empty() && strips.ends.is_empty() && !vertices.found.is_empty() {
        return Err(file.refused(format!(
            "contains {} points but no faces, and only surfaces reflect sound: make a mesh of the points first (by \
             surface reconstruction, for example in MeshLab or CloudCompare)",
            vertices.found.len()
        )));
    }
    let material = palette.assign(None, "");
    let vertex = |index: i64, kind: &str, i: usize| {
        vertices.at(index).map_err(|problem| file.refused_at(format_args!("{kind} {i}"), problem))
    };
    let mut corners = Vec::new();
    // Each has two corners more than triangles.
    surfaces.reserve(faces.indices.len().saturating_sub(2 * faces.ends.len()))?;
    for (i, face) in faces.iter().enumerate() {
        corners.clear();
        for &index in face {
            corners.push(vertex(index, "face", i)?);
        }
        surfaces.add_face(&corners, material)?;
    }
    for (i, list) in strips.iter().enumerate() {
        // -1 ends a strip and begins the next.
        for strip in list.split(|&index| index == -1) {
            for (k, window) in strip.windows(3).enumerate() {
                // Every second triangle of a strip has the opposite winding.
                let order = if k % 2 == 0 { [0, 1, 2] } else { [0, 2, 1] };
                let mut corners = [DVec3::ZERO; 3];
                for (corner, k) in corners.iter_mut().zip(order) {
                    *corner = vertex(window[k], "tristrips", i)?;
                }
                surfaces.add(corners, material)?;
            }
        }
    }
    Ok(Mesh::new(file, surfaces, Up::None, None))
}

/// Receives the values of an element in the order of the file, row by row. Every method does nothing by default.
trait Rows {
    /// The next value of the row's property `property`; a list gives several.
    fn value(&mut self, _property: usize, _value: f64) -> RowResult<()> {
        Ok(())
    }
    /// The row has ended.
    fn end(&mut self) -> RowResult<()> {
        Ok(())
    }
    /// Reserves memory for this many rows; `false` when they do not fit.
    fn reserve(&mut self, _rows: usize) -> bool {
        true
    }
}

/// A result whose error says what is wrong, without the place.
type RowResult<T> = std::result::Result<T, String>;

/// Reads all rows of an element. Every value takes bytes in the file, so the work is bounded by its length,
/// whatever the header declares.
fn read_rows(
    element: &Element,
    source: &mut Source<'_>,
    file: MeshFile<'_>,
    rows: &mut impl Rows,
) -> Result<()> {
    if element.properties.is_empty() {
        return Ok(());
    }
    if !rows.reserve(source.rows_of(element)) {
        return Err(file.does_not_fit("its vertices and faces"));
    }
    for row in 0..element.count {
        read_row(element, source, rows).map_err(|problem| {
            let line = source.line().map_or(String::new(), |line| format!("line {line}, "));
            file.refused_at(format_args!("{line}{} {row}", element.name), problem)
        })?;
    }
    Ok(())
}

fn read_row(element: &Element, source: &mut Source<'_>, rows: &mut impl Rows) -> RowResult<()> {
    for (i, property) in element.properties.iter().enumerate() {
        let count = match property.count {
            None => 1,
            Some(scalar) => {
                let count = source.next(scalar)?;
                if count < 0.0 || count.fract() != 0.0 {
                    return Err(format!("has a list `{}` of {count} values", quoted(&property.name)));
                }
                count as u64
            }
        };
        for _ in 0..count {
            rows.value(i, source.next(property.scalar)?)?;
        }
    }
    rows.end()
}

/// An element that does not describe the surface.
struct Unread;

impl Rows for Unread {}

/// The positions, and which properties they are in.
#[derive(Debug, Default)]
struct Vertices {
    axes: [usize; 3],
    next: DVec3,
    found: Vec<DVec3>,
}

impl Vertices {
    fn find_axes(&mut self, element: &Element) -> RowResult<()> {
        for (axis, name) in self.axes.iter_mut().zip(["x", "y", "z"]) {
            let found = element.properties.iter().position(|p| p.name == name && p.count.is_none());
            *axis = found.ok_or_else(|| {
                format!("its vertices have no property `{name}`; x, y and z were expected, one number each")
            })?;
        }
        Ok(())
    }

    fn at(&self, index: i64) -> RowResult<DVec3> {
        let found = usize::try_from(index).ok().and_then(|i| self.found.get(i));
        found.copied().ok_or_else(|| {
            format!("refers to vertex {index}, but there are {}, counted from 0", self.found.len())
        })
    }
}

impl Rows for Vertices {
    fn value(&mut self, property: usize, value: f64) -> RowResult<()> {
        for (axis, place) in self.axes.into_iter().enumerate() {
            if place == property {
                self.next[axis] = value;
            }
        }
        Ok(())
    }

    fn end(&mut self) -> RowResult<()> {
        if !self.next.is_finite() {
            return Err(format!("has a coordinate that is not finite: {}", self.next));
        }
        self.found.push(self.next);
        Ok(())
    }

    fn reserve(&mut self, rows: usize) -> bool {
        self.found.try_reserve_exact(rows).is_ok()
    }
}

/// Lists of vertices, one after the other, and which property they are in.
#[derive(Debug, Default)]
struct Lists {
    list: usize,
    indices: Vec<i64>,
    /// Where in `indices` each list ends.
    ends: Vec<usize>,
}

impl Lists {
    fn find_list(&mut self, element: &Element) -> RowResult<()> {
        let found = element.corners().and_then(|list| element.properties.iter().position(|p| p == list));
        match found {
            Some(list) => self.list = list,
            None if element.count == 0 => {}
            None => {
                return Err(format!("its element `{}` needs a list `vertex_indices`", quoted(&element.name)));
            }
        }
        Ok(())
    }

    fn iter(&self) -> impl Iterator<Item = &[i64]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.indices[start..end])
    }
}

impl Rows for Lists {
    fn value(&mut self, property: usize, value: f64) -> RowResult<()> {
        if property == self.list {
            if value.fract() != 0.0 || value.abs() > f64::from(u32::MAX) {
                return Err(format!("refers to vertex {value}; a whole number was expected"));
            }
            self.indices
                .try_reserve(1)
                .map_err(|_| "does not fit in memory together with the previous ones".to_owned())?;
            self.indices.push(value as i64);
        }
        Ok(())
    }

    fn end(&mut self) -> RowResult<()> {
        self.ends.push(self.indices.len());
        Ok(())
    }

    fn reserve(&mut self, rows: usize) -> bool {
        self.ends.try_reserve_exact(rows).is_ok()
            && self.indices.try_reserve_exact(rows.saturating_mul(3)).is_ok()
    }
}

#[cfg(test)]
mod tests;
