//! Wavefront OBJ: faces of any number of corners, objects and groups, materials by name.
//!
//! `tobj` reads the geometry from a cleaned copy of the text, in which every line keeps its number, continued
//! lines are joined, and only positions, faces and names remain. Materials are numbered in the
//! copy, so that their names survive a missing MTL file.

mod mtl;

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

use glam::DVec3;

use super::files::{self, MeshFile};
use super::material::{Material, Palette};
use super::surfaces::Surfaces;
use super::{Mesh, Up};
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result};
use crate::text::quoted;

/// Reads an OBJ file. See [`Scene::load`](super::Scene::load).
pub(super) fn load<'a>(file: MeshFile<'a>, palette: &mut Palette<'_>) -> Result<Mesh<'a>> {
    file.refuse_sensor("an OBJ")?;
    let mut surfaces = Surfaces::new(file);
    let mut cleaned = {
        let bytes = file.read()?;
        // Names may be in any encoding; geometry is ASCII.
        let source = decoded(&bytes);
        clean(source.trim_start_matches('\u{feff}'), file, &surfaces)?
    };
    let metres_per_unit = cleaned.header;
    check_unit(metres_per_unit, file);
    if cleaned.free_form > 0 {
        file.warn(format_args!(
            "{} free-form surfaces (`surf`) are not supported; export the mesh as polygons",
            cleaned.free_form
        ));
    }
    declare_materials(&cleaned, file, palette)?;
    let models = read_models(&cleaned, file)?;
    cleaned.text = String::new();

    let mut corners = Vec::new();
    for model in models {
        let mesh = &model.mesh;
        let positions = mesh.positions.chunks_exact(3);
        let mut vertices =
            try_with_capacity(positions.len() as u64).ok_or_else(|| file.does_not_fit("its vertices"))?;
        vertices.extend(positions.map(DVec3::from_slice));
        if let Some(bad) = vertices.iter().find(|v| !v.is_finite()) {
            let problem = format!("has a vertex with a coordinate that is not finite: {bad}");
            return Err(file.refused_at(format_args!("object `{}`", quoted(&model.name)), problem));
        }
        surfaces.begin_part(owner(&model.name));
        let material = palette.assign(mesh.material_id, owner(&model.name));
        let mut rest = mesh.indices.as_slice();
        let all_triangles = if mesh.face_arities.is_empty() { mesh.indices.len() / 3 } else { 0 };
        let arities = mesh.face_arities.iter().copied().chain(std::iter::repeat_n(3, all_triangles));
        surfaces
            .reserve(mesh.indices.len().saturating_sub(2 * mesh.face_arities.len().max(all_triangles)))?;
        for arity in arities {
            let (face, after) = rest.split_at((arity as usize).min(rest.len()));
            rest = after;
            corners.clear();
            corners.extend(face.iter().map(|&i| vertices[i as usize]));
            surfaces.add_face(&corners, material)?;
        }
    }
    Ok(Mesh::new(file, surfaces, Up::Y, metres_per_unit))
}

/// The text of a file: UTF-16 where it begins with that mark, and otherwise UTF-8 or any other encoding of ASCII.
fn decoded(bytes: &[u8]) -> Cow<'_, str> {
    let wide = |of: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = bytes[2..].chunks_exact(2).map(|pair| of([pair[0], pair[1]])).collect();
        Cow::Owned(String::from_utf16_lossy(&units))
    };
    match bytes {
        [0xff, 0xfe, ..] => wide(u16::from_le_bytes),
        [0xfe, 0xff, ..] => wide(u16::from_be_bytes),
        _ => String::from_utf8_lossy(bytes),
    }
}

/// The name of an object; empty where `tobj` made one up.
fn owner(name: &str) -> &str {
    if name == "unnamed_object" { "" } else { name }
}

/// The line before the copy, from which `tobj` takes the materials.
const PREFIX: &str = "mtllib numbers\n";

/// The simplified text with unchanged line numbers, after the [`PREFIX`].
struct Cleaned {
    text: String,
    /// Material names, in the order of first use; `usemtl` gives indices into this list.
    materials: Vec<String>,
    libraries: Vec<String>,
    /// Metres per unit, from a header comment.
    header: Option<f64>,
    /// Number of free-form surfaces, which are ignored.
    free_form: usize,
}

/// Copies the statements that matter. Refuses more triangles than `surfaces` accepts before it allocates a list of them.
fn clean(source: &str, file: MeshFile<'_>, surfaces: &Surfaces<'_>) -> Result<Cleaned> {
    let mut text = String::new();
    text.try_reserve_exact(PREFIX.len() + source.len()).map_err(|_| file.does_not_fit("its lines"))?;
    text.push_str(PREFIX);
    let mut materials: Vec<String> = Vec::new();
    let mut places = HashMap::new();
    let (mut libraries, mut header, mut free_form, mut triangles) = (Vec::new(), None, 0, 0);
    let mut lines = source.lines().enumerate();
    while let Some((number, line)) = lines.next() {
        let mut line = Cow::Borrowed(line.trim());
        let mut joined = 0;
        while !line.starts_with('#') && line.ends_with('\\') {
            let longer = line.to_mut();
            longer.pop();
            longer.push(' ');
            let Some((_, next)) = lines.next() else { break };
            longer.push_str(next.trim());
            joined += 1;
        }
        let line = line.trim();
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        match keyword {
            "v" => {
                // Colours may follow the position; a fourth number alone is a weight.
                let numbers: Vec<_> = uncommented(rest).split_whitespace().collect();
                let kept = if numbers.len() == 4 { 4 } else { numbers.len().min(3) };
                text.push_str("v ");
                text.push_str(&numbers[..kept].join(" "));
            }
            "f" => {
                // Only the first of v/vt/vn matters, and the others may be out of range.
                text.push('f');
                let mut corners = 0_usize;
                for corner in uncommented(rest).split_whitespace() {
                    text.push(' ');
                    text.push_str(corner.split('/').next().unwrap_or_default());
                    corners += 1;
                }
                triangles += corners.saturating_sub(2);
                surfaces.check_limit(triangles)?;
            }
            "o" | "g" => text.extend([keyword, " ", rest]),
            "usemtl" => {
                let next = materials.len();
                let place = *places.entry(rest.to_owned()).or_insert(next);
                if place == next {
                    materials.push(rest.to_owned());
                }
                text.push_str("usemtl ");
                text.push_str(&place.to_string());
            }
            "mtllib" if !rest.is_empty() => libraries.push(rest.to_owned()),
            "surf" => free_form += 1,
            _ if line.starts_with('#') && header.is_none() => {
                header = header_unit(line).map_err(|problem| at_line(file, number + 1, problem))?;
            }
            _ => {}
        }
        text.extend(std::iter::repeat_n('\n', 1 + joined));
    }
    Ok(Cleaned { text, materials, libraries, header, free_form })
}

fn uncommented(rest: &str) -> &str {
    rest.split('#').next().unwrap_or_default()
}

fn at_line(file: MeshFile<'_>, line: usize, problem: impl Into<String>) -> Error {
    file.refused_at(format_args!("line {line}"), problem)
}

/// Metres per unit from a comment such as `# 1 unit = 1000.000000 mm`, as some CAD programs write it.
fn header_unit(comment: &str) -> std::result::Result<Option<f64>, String> {
    let lower = comment.trim_start_matches('#').trim().to_ascii_lowercase();
    let Some(definition) = lower.strip_prefix("1 unit") else { return Ok(None) };
    let Some(definition) = definition.trim_start().strip_prefix('=') else { return Ok(None) };
    let mut words = definition.split_whitespace();
    let number = words.next().and_then(|w| w.parse::<f64>().ok()).filter(|n| n.is_finite() && *n > 0.0);
    let metres = match words.next().unwrap_or_default() {
        "m" | "meter" | "meters" | "metre" | "metres" => Some(1.0),
        "cm" | "centimeter" | "centimeters" | "centimetre" | "centimetres" => Some(0.01),
        "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => Some(0.001),
        "in" | "inch" | "inches" => Some(0.0254),
        "ft" | "foot" | "feet" => Some(0.3048),
        _ => None,
    };
    match (number, metres) {
        (Some(number), Some(metres)) => Ok(Some(number * metres)),
        _ => Err(format!(
            "`{}` should have the form `# 1 unit = 1000.0 mm` (m, cm, mm, in or ft)",
            quoted(comment)
        )),
    }
}

/// Warns where the file's header and the options disagree on the unit.
fn check_unit(header: Option<f64>, file: MeshFile<'_>) {
    if let (Some(asked), Some(header)) = (file.options.unit.map(super::Unit::metres), header)
        && (asked / header - 1.0).abs() > 1e-9
    {
        file.warn(format_args!(
            "its header says 1 unit = {header} m, but `unit` says {asked} m; `unit` is used"
        ));
    }
}

/// Declares every material that a face uses, in the order of their numbers. A missing MTL file is a
/// warning, because the geometry does not depend on it.
fn declare_materials(cleaned: &Cleaned, file: MeshFile<'_>, palette: &mut Palette<'_>) -> Result<()> {
    let mut found: HashMap<String, Material> = HashMap::new();
    for library in &cleaned.libraries {
        // Either one name with spaces, or several names.
        let whole = files::beside(file.path, library).is_ok_and(|p| p.is_file());
        let names = if whole { vec![library.as_str()] } else { library.split_whitespace().collect() };
        for name in names {
            let path = match files::beside(file.path, name) {
                Ok(path) => path,
                Err(refusal) => {
                    file.warn(format_args!("mtllib {refusal}; ignored"));
                    continue;
                }
            };
            let library = MeshFile { path: &path, ..file };
            match library.read() {
                Ok(bytes) => {
                    let text = String::from_utf8_lossy(&bytes);
                    // Of duplicate names the first is used.
                    for material in mtl::parse(text.trim_start_matches('\u{feff}'), library)? {
                        found.entry(material.name.clone()).or_insert(material);
                    }
                }
                Err(error) => file.warn(format_args!("materials count as opaque: {error}")),
            }
        }
    }
    for name in &cleaned.materials {
        palette.declare(found.remove(name).unwrap_or_else(|| Material::opaque(name)));
    }
    Ok(())
}

fn read_models(cleaned: &Cleaned, file: MeshFile<'_>) -> Result<Vec<tobj::Model>> {
    let options = tobj::LoadOptions { ignore_points: true, ignore_lines: true, ..Default::default() };
    // The names in the copy are numbers, which this library resolves to themselves.
    let numbers = || (0..cleaned.materials.len()).map(|i| i.to_string());
    let library = |_: &Path| {
        let materials = numbers().map(|name| tobj::Material { name, ..Default::default() }).collect();
        Ok((materials, numbers().enumerate().map(|(i, name)| (name, i)).collect()))
    };
    let text = &cleaned.text;
    let mut rest = text.as_bytes();
    let result = tobj::load_obj_buf(&mut rest, &options, library);
    let consumed = text.len() - rest.len();
    // Every line that was read ended with a newline; one of them is the prefix.
    let line = text[..consumed].lines().count().saturating_sub(1);
    let (line, problem) = match result {
        Ok((models, _)) => return Ok(models),
        Err(tobj::LoadError::FaceVertexOutOfBounds) => {
            let (line, index, count) =
                first_index_beyond(&cleaned.text[PREFIX.len()..]).unwrap_or((line, 0, 0));
            let group = format!("only {count} vertices precede the end of its group");
            (line, format!("a face refers to corner {index}, but {group}"))
        }
        Err(tobj::LoadError::PositionParseError) => {
            let culprit = culprit(text, line, |word| word.parse::<f64>().is_ok());
            (line, format!("a vertex `v` needs three numbers{culprit}"))
        }
        Err(tobj::LoadError::FaceParseError) => {
            let culprit = culprit(text, line, |word| word.parse::<i64>().is_ok());
            (line, format!("a face `f` must list vertex numbers such as `f 1 2 3`{culprit}"))
        }
        Err(error) => (line, format!("is not valid OBJ: {error}")),
    };
    Err(at_line(file, line, problem))
}

/// The first word of a line that is no number, quoted for a message, if there is one.
fn culprit(text: &str, line: usize, is_number: impl Fn(&str) -> bool) -> String {
    let words = text.lines().nth(line).unwrap_or_default().split_whitespace().skip(1);
    let mut wrong = words.filter(|word| !is_number(word));
    wrong.next().map_or_else(String::new, |word| format!("; `{}` is none", quoted(word)))
}

/// Line, index and number of vertices so far of the first face that refers to a missing vertex.
fn first_index_beyond(text: &str) -> Option<(usize, i64, i64)> {
    let total = text.lines().filter(|line| line.starts_with("v ")).count() as i64;
    let mut before = 0;
    for (i, line) in text.lines().enumerate() {
        before += i64::from(line.starts_with("v "));
        let face = line.strip_prefix("f ").unwrap_or_default();
        let mut corners = face.split_whitespace().filter_map(|w| w.parse().ok());
        if let Some(index) = corners.find(|&k: &i64| k == 0 || k > total || k < -before) {
            return Some((i + 1, index, before));
        }
    }
    None
}

#[cfg(test)]
mod tests;
