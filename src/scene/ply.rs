//! PLY, as text or binary of either byte order: vertices, faces of any number of corners, triangle strips.
//!
//! Read here because the crate for it trusts the numbers that a header declares (see [`crate::files::ply`]). Only
//! positions and corners are read.

mod source;

use std::path::Path;

use glam::DVec3;

use super::files::does_not_fit;
use super::material::Palette;
use super::surfaces::Surfaces;
use super::{LoadOptions, Mesh, Up, files};
use crate::error::{Error, Result};
use crate::files::ply::{Element, Header};
use crate::progress::Observer;
use source::Source;

/// Reads a PLY file. See [`Scene::load`](super::Scene::load).
pub(super) fn load(
    path: &Path,
    options: &LoadOptions,
    palette: &mut Palette<'_>,
    observer: &dyn Observer,
) -> Result<Mesh> {
    options.refuse_sensor("a PLY", path)?;
    let bytes = files::read(path, options.memory)?;
    let (header, length) = Header::read(&bytes, path)?;
    let metres_per_unit = options.needed_unit("a PLY", path)?;
    let mut source = Source::new(header.format, &bytes[length.bytes..], length.lines);
    let mut surfaces = Surfaces::new(path, options.memory);
    let (mut vertices, mut faces, mut strips) = (Vertices::default(), Lists::default(), Lists::default());
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => {
                vertices.find_axes(element).map_err(|problem| Error::input(path.display(), problem))?;
                read_rows(element, &mut source, path, &mut vertices)?;
            }
            name @ ("face" | "tristrips") => {
                let lists = if name == "face" { &mut faces } else { &mut strips };
                lists.find_list(element).map_err(|problem| Error::input(path.display(), problem))?;
                // Every row has a triangle or more, and no more rows are read than the file can contain.
                surfaces.check_limit(source.rows_of(element))?;
                read_rows(element, &mut source, path, lists)?;
            }
            _ => read_rows(element, &mut source, path, &mut Unread)?,
        }
    }
    if let Some(rest) = source.rest() {
        observer.warn(&format!(
            "{}: {rest} bytes follow the last element that its header declares; they are ignored",
            path.display()
        ));
    }
    if faces.ends.is_empty() && strips.ends.is_empty() && !vertices.found.is_empty() {
        return Err(Error::input(
            path.display(),
            format!(
                "contains {} points but no faces, and only surfaces reflect sound: make a mesh of the points first (by \
                     surface reconstruction, for example in MeshLab or CloudCompare)",
                vertices.found.len()
            ),
        ));
    }
    let material = palette.assign(None, "");
    let place = |kind: &str, i: usize| format!("{}, {kind} {i}", path.display());
    let mut corners = Vec::new();
    // Each has two corners more than triangles.
    surfaces.reserve(faces.indices.len().saturating_sub(2 * faces.ends.len()))?;
    for (i, face) in faces.iter().enumerate() {
        corners.clear();
        for &index in face {
            corners.push(vertices.at(index).map_err(|problem| Error::input(place("face", i), problem))?);
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
                    *corner = vertices
                        .at(window[k])
                        .map_err(|problem| Error::input(place("tristrips", i), problem))?;
                }
                surfaces.add(corners, material)?;
            }
        }
    }
    Ok(Mesh { surfaces, metres_per_unit, up: Up::None, sensor: None, camera: None })
}

/// Receives the values of an element in the order of the file, row by row.
trait Rows {
    /// The next value of the row's property `property`; a list gives several.
    fn value(&mut self, property: usize, value: f64) -> Outcome<()>;
    /// The row has ended.
    fn end(&mut self) -> Outcome<()>;
    /// Reserves memory for this many rows; `false` when they do not fit.
    fn reserve(&mut self, rows: usize) -> bool;
}

/// A result whose error says what is wrong, without the place.
type Outcome<T> = std::result::Result<T, String>;

/// Reads all rows of an element. Every value takes bytes in the file, so the work is bounded by its length,
/// whatever the header declares.
fn read_rows(element: &Element, source: &mut Source<'_>, path: &Path, rows: &mut impl Rows) -> Result<()> {
    if element.properties.is_empty() {
        return Ok(());
    }
    if !rows.reserve(source.rows_of(element)) {
        return Err(does_not_fit(path.display(), "its vertices and faces"));
    }
    for row in 0..element.count {
        read_row(element, source, rows).map_err(|problem| {
            let line = source.line().map_or(String::new(), |line| format!(", line {line}"));
            Error::input(format!("{}{line}, {} {row}", path.display(), element.name), problem)
        })?;
    }
    Ok(())
}

fn read_row(element: &Element, source: &mut Source<'_>, rows: &mut impl Rows) -> Outcome<()> {
    for (i, property) in element.properties.iter().enumerate() {
        let count = match property.count {
            None => 1,
            Some(scalar) => {
                let count = source.next(scalar)?;
                if count < 0.0 || count.fract() != 0.0 {
                    return Err(format!("has a list `{}` of {count} values", property.name));
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

impl Rows for Unread {
    fn value(&mut self, _: usize, _: f64) -> Outcome<()> {
        Ok(())
    }

    fn end(&mut self) -> Outcome<()> {
        Ok(())
    }

    fn reserve(&mut self, _: usize) -> bool {
        true
    }
}

/// The positions, and which properties they are in.
#[derive(Debug, Default)]
struct Vertices {
    axes: [usize; 3],
    next: DVec3,
    found: Vec<DVec3>,
}

impl Vertices {
    fn find_axes(&mut self, element: &Element) -> Outcome<()> {
        for (axis, name) in self.axes.iter_mut().zip(["x", "y", "z"]) {
            let found = element.properties.iter().position(|p| p.name == name && p.count.is_none());
            *axis = found.ok_or_else(|| {
                format!("its vertices have no property `{name}`; x, y and z were expected, one number each")
            })?;
        }
        Ok(())
    }

    fn at(&self, index: i64) -> Outcome<DVec3> {
        let found = usize::try_from(index).ok().and_then(|i| self.found.get(i));
        found.copied().ok_or_else(|| {
            format!("refers to vertex {index}, but there are {}, counted from 0", self.found.len())
        })
    }
}

impl Rows for Vertices {
    fn value(&mut self, property: usize, value: f64) -> Outcome<()> {
        for (axis, place) in self.axes.into_iter().enumerate() {
            if place == property {
                self.next[axis] = value;
            }
        }
        Ok(())
    }

    fn end(&mut self) -> Outcome<()> {
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
    fn find_list(&mut self, element: &Element) -> Outcome<()> {
        let found = element.corners().and_then(|list| element.properties.iter().position(|p| p == list));
        match found {
            Some(list) => self.list = list,
            None if element.count == 0 => {}
            None => return Err(format!("its element `{}` needs a list `vertex_indices`", element.name)),
        }
        Ok(())
    }

    fn iter(&self) -> impl Iterator<Item = &[i64]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.indices[start..end])
    }
}

impl Rows for Lists {
    fn value(&mut self, property: usize, value: f64) -> Outcome<()> {
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

    fn end(&mut self) -> Outcome<()> {
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
