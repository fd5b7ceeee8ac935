//! STL, as text or binary: triangles without materials, unit or names (except those of the solids of a text).
//!
//! Read here because `stl_io` 0.11 decides by the first word alone, which many binary files have too, stops after the
//! first of several solids, and cannot name the line of an error.

use std::io::{BufRead, BufReader, Read};

use glam::DVec3;

use super::files::{self, MeshFile};
use super::material::Palette;
use super::surfaces::Surfaces;
use super::{Mesh, Up};
use crate::error::{Error, Result};
use crate::text::quoted;

/// Bytes before the first triangle of a binary file: 80 arbitrary ones, and the number of triangles.
const HEADER: usize = 84;
/// Bytes of one triangle: normal and three corners in f32, and two arbitrary bytes.
const RECORD: usize = 50;

/// Reads an STL file. See [`Scene::load`](super::Scene::load).
pub(super) fn load<'a>(file: MeshFile<'a>, palette: &mut Palette<'_>) -> Result<Mesh<'a>> {
    file.refuse_sensor("an STL")?;
    let (opened, length) = files::open(file.path)?;
    let mut input = BufReader::with_capacity(1 << 16, opened);
    let start = input.fill_buf().map_err(|error| Error::reading(file.path, error))?;
    let count = triangle_count(start);
    let text = is_text(start, length);
    let mut surfaces = Surfaces::new(file);
    if text {
        read_text(input, file, palette, &mut surfaces)?;
    } else {
        let count = count.ok_or_else(|| {
            file.refused(format!(
                "is not an STL: its {length} bytes do not begin with `solid`, as a text does, and are fewer than \
                 the {HEADER} of a binary header"
            ))
        })?;
        read_binary(input, (count, length), file, palette, &mut surfaces)?;
    }
    Ok(Mesh::new(file, surfaces, Up::Z, None))
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
    bytes.get(80..)?.first_chunk().map(|count| u32::from_le_bytes(*count))
}

/// Reads `count` triangles from the beginning of a file of `length` bytes.
fn read_binary(
    mut input: impl Read,
    (count, length): (u32, u64),
    file: MeshFile<'_>,
    palette: &mut Palette<'_>,
    surfaces: &mut Surfaces<'_>,
) -> Result<()> {
    let records = length - HEADER as u64;
    let complete = records / RECORD as u64;
    if complete < u64::from(count) {
        return Err(file.refused(format!(
            "is cut short, or is not an STL: {complete} of the {count} triangles that its header declares"
        )));
    }
    let material = palette.assign(None, "");
    surfaces.reserve(count as usize)?;
    let mut read =
        |bytes: &mut [u8]| input.read_exact(bytes).map_err(|error| Error::reading(file.path, error));
    read(&mut [0; HEADER])?;
    let mut record = [0; RECORD];
    for i in 0..count {
        read(&mut record)?;
        let number = |at: usize| f64::from(f32::from_le_bytes(std::array::from_fn(|k| record[at + k])));
        let corners = [12, 24, 36].map(|at| DVec3::new(number(at), number(at + 4), number(at + 8)));
        if let Some(bad) = corners.iter().find(|v| !v.is_finite()) {
            let problem = format!("has a corner with a coordinate that is not finite: {bad}");
            return Err(file.refused_at(format_args!("triangle {i}"), problem));
        }
        surfaces.add(corners, material)?;
    }
    let left = records - u64::from(count) * RECORD as u64;
    if left > 0 {
        file.warn(format_args!(
            "{left} bytes follow the {count} triangles that its header declares; they are ignored"
        ));
    }
    Ok(())
}

/// Reads a text line by line, since it is several times as long as its triangles in memory.
fn read_text(
    mut input: impl BufRead,
    file: MeshFile<'_>,
    palette: &mut Palette<'_>,
    surfaces: &mut Surfaces<'_>,
) -> Result<()> {
    let mut material = None;
    let mut corners = Vec::new();
    let (mut in_facet, mut in_solid) = (false, false);
    let (mut bytes, mut number) = (Vec::new(), 0);
    while input.read_until(b'\n', &mut bytes).map_err(|error| Error::reading(file.path, error))? > 0 {
        number += 1;
        let refused = |problem: String| file.refused_at(format_args!("line {number}"), problem);
        let line = String::from_utf8_lossy(&bytes);
        let line = line.trim_start_matches('\u{feff}').trim();
        let mut words = line.split_whitespace();
        while let Some(word) = words.next() {
            match word.to_ascii_lowercase().as_str() {
                "solid" => {
                    let name: Vec<_> = words.by_ref().collect();
                    let name = name.join(" ");
                    surfaces.begin_part(&name);
                    material = Some(palette.assign(None, &name));
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
                    refused(format!(
                        "`{}` must give three finite numbers, such as `vertex 0.1 0.2 0.3`",
                        quoted(line)
                    ))
                })?),
                "endloop" => {
                    if corners.len() < 3 {
                        let count = corners.len();
                        return Err(refused(format!("ends a loop of {count} corners; a facet has three")));
                    }
                    let material = *material.get_or_insert_with(|| palette.assign(None, ""));
                    surfaces.add_face(&corners, material)?;
                    corners.clear();
                }
                "endfacet" => in_facet = false,
                _ => {
                    return Err(refused(format!(
                        "`{}` is not a keyword of STL; solid, facet normal, outer loop, vertex, endloop, endfacet or \
                         endsolid was expected",
                        quoted(word)
                    )));
                }
            }
        }
        bytes.clear();
    }
    if in_facet || !corners.is_empty() {
        return Err(file.refused("is cut short: it ends within a facet"));
    }
    if in_solid {
        file.warn("does not end with `endsolid`; it may be cut short");
    }
    Ok(())
}

fn vertex<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<DVec3> {
    let mut number = || words.next()?.parse::<f64>().ok().filter(|n| n.is_finite());
    Some(DVec3::new(number()?, number()?, number()?))
}

#[cfg(test)]
mod tests;
