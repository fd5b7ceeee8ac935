//! STL, as text or binary: triangles without materials, unit or names (except those of the solids of a text).
//!
//! Read here because `stl_io` 0.11 decides by the first word alone, which many binary files have too, stops after the
//! first of several solids, and cannot name the line of an error.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use glam::DVec3;

use super::material::Palette;
use super::surfaces::Surfaces;
use super::{LoadOptions, Mesh, Up, files};
use crate::error::{Error, Result};
use crate::progress::Observer;

/// Bytes before the first triangle of a binary file: 80 arbitrary ones, and the number of triangles.
const HEADER: usize = 84;
/// Bytes of one triangle: normal and three corners in f32, and two arbitrary bytes.
const RECORD: usize = 50;

/// Reads an STL file. See [`Scene::load`](super::Scene::load).
pub(super) fn load(
    path: &Path,
    options: &LoadOptions,
    palette: &mut Palette<'_>,
    observer: &dyn Observer,
) -> Result<Mesh> {
    options.refuse_sensor("an STL", path)?;
    let (file, length) = files::open(path)?;
    let mut file = BufReader::with_capacity(1 << 16, file);
    let start = file.fill_buf().map_err(|error| Error::reading(path, error))?;
    let count = triangle_count(start);
    let text = is_text(start, length);
    let metres_per_unit = options.needed_unit("an STL", path)?;
    let mut surfaces = Surfaces::new(path, options.memory);
    if text {
        read_text(file, path, palette, &mut surfaces, observer)?;
    } else {
        let Some(count) = count else {
            return Err(Error::input(
                path.display(),
                format!(
                    "is not an STL: its {length} bytes do not begin with `solid`, as a text does, and are fewer than \
                         the {HEADER} of a binary header"
                ),
            ));
        };
        read_binary(file, (count, length), path, palette, &mut surfaces, observer)?;
    }
    Ok(Mesh { surfaces, metres_per_unit, up: Up::None, sensor: None, camera: None })
}

/// Both kinds may begin with `solid`. A binary file is recognised by its `length`; one of another length is text
/// when it begins with `solid` and continues in printable characters.
fn is_text(bytes: &[u8], length: u64) -> bool {
    let binary_length = triangle_count(bytes).map(|count| HEADER as u64 + RECORD as u64 * u64::from(count));
    let start = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    let solid = start.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    let printable = |&byte: &u8| byte >= b' ' || byte.is_ascii_whitespace();
    solid && binary_length != Some(length) && start.iter().take(512).all(printable)
}

fn triangle_count(bytes: &[u8]) -> Option<u32> {
    bytes.get(80..HEADER).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}

/// Reads `count` triangles from the beginning of a file of `length` bytes.
fn read_binary(
    mut file: impl Read,
    (count, length): (u32, u64),
    path: &Path,
    palette: &mut Palette<'_>,
    surfaces: &mut Surfaces,
    observer: &dyn Observer,
) -> Result<()> {
    let records = length - HEADER as u64;
    let complete = records / RECORD as u64;
    if complete < u64::from(count) {
        return Err(Error::input(
            path.display(),
            format!(
                "is cut short, or is not an STL: {complete} of the {count} triangles that its header declares"
            ),
        ));
    }
    let material = palette.assign(None, "");
    surfaces.reserve(count as usize)?;
    let mut read = |bytes: &mut [u8]| file.read_exact(bytes).map_err(|error| Error::reading(path, error));
    read(&mut [0; HEADER])?;
    let mut record = [0; RECORD];
    for i in 0..count {
        read(&mut record)?;
        let number = |at: usize| {
            f64::from(f32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]]))
        };
        let corners = [12, 24, 36].map(|at| DVec3::new(number(at), number(at + 4), number(at + 8)));
        if let Some(bad) = corners.iter().find(|v| !v.is_finite()) {
            return Err(Error::input(
                format!("{}, triangle {i}", path.display()),
                format!("has a corner with a coordinate that is not finite: {bad}"),
            ));
        }
        surfaces.add(corners, material)?;
    }
    let left = records - u64::from(count) * RECORD as u64;
    if left > 0 {
        observer.warn(&format!(
            "{}: {left} bytes follow the {count} triangles that its header declares; they are ignored",
            path.display()
        ));
    }
    Ok(())
}

/// Reads a text line by line, since it is several times as long as its triangles in memory.
fn read_text(
    mut file: impl BufRead,
    path: &Path,
    palette: &mut Palette<'_>,
    surfaces: &mut Surfaces,
    observer: &dyn Observer,
) -> Result<()> {
    let mut material = None;
    let mut corners = Vec::new();
    let (mut in_facet, mut in_solid) = (false, false);
    let (mut bytes, mut number) = (Vec::new(), 0);
    while file.read_until(b'\n', &mut bytes).map_err(|error| Error::reading(path, error))? > 0 {
        number += 1;
        let refused = |problem: String| Error::input(format!("{}, line {number}", path.display()), problem);
        let line = String::from_utf8_lossy(&bytes);
        let line = line.trim_start_matches('\u{feff}').trim();
        let mut words = line.split_whitespace();
        while let Some(word) = words.next() {
            match word.to_ascii_lowercase().as_str() {
                "solid" => {
                    let name: Vec<_> = words.by_ref().collect();
                    material = Some(palette.assign(None, &name.join(" ")));
                    in_solid = true;
                }
                "endsolid" => {
                    words.by_ref().for_each(drop);
                    in_solid = false;
                }
                "facet" if in_facet => {
                    return Err(refused("begins a facet within another; `endfacet` was expected".to_owned()));
                }
                "facet" => in_facet = true,
                // The normal follows from the corners.
                "normal" => words.by_ref().take(3).for_each(drop),
                "outer" | "loop" => {}
                "vertex" => corners.push(vertex(words.by_ref()).ok_or_else(|| {
                    refused(format!("`{line}` must give three finite numbers, such as `vertex 0.1 0.2 0.3`"))
                })?),
                "endloop" => {
                    if corners.len() < 3 {
                        return Err(refused(format!(
                            "ends a loop of {} corners; a facet has three",
                            corners.len()
                        )));
                    }
                    let material = *material.get_or_insert_with(|| palette.assign(None, ""));
                    surfaces.add_face(&corners, material)?;
                    corners.clear();
                }
                "endfacet" => in_facet = false,
                _ => {
                    return Err(refused(format!(
                        "`{word}` is not a keyword of STL; solid, facet normal, outer loop, vertex, endloop, endfacet \
                         or endsolid was expected"
                    )));
                }
            }
        }
        bytes.clear();
    }
    if in_facet || !corners.is_empty() {
        return Err(Error::input(path.display(), "is cut short: it ends within a facet"));
    }
    if in_solid {
        observer.warn(&format!("{}: does not end with `endsolid`; it may be cut short", path.display()));
    }
    Ok(())
}

fn vertex<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<DVec3> {
    let mut number = || words.next()?.parse::<f64>().ok().filter(|n| n.is_finite());
    Some(DVec3::new(number()?, number()?, number()?))
}

#[cfg(test)]
mod tests;
