//! `mesh.ply`: the surfaces of a scene, decimated, to be shown beside its image.

use super::header;
use super::reader::{LIST_OF_THREE, Ply};
use crate::error::{Error, Result};
use crate::export::Attribute;
use crate::files::ply::{Element, Property, Scalar};
use crate::files::write_atomically;
use crate::scene::{Scene, Triangle};
use crate::text::json_escape;
use crate::wave::bounding_box;
use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};
use std::io::Write;
use std::ops::Range;
use std::path::Path;

/// Maximum number of triangles of a decimated mesh, but for those of parts that would vanish.
const MOST_TRIANGLES: usize = 60_000;

/// Steps of the finest lattice along the longest side of the mesh: corners that are closer than this are one.
const FINEST: f64 = 65_535.0;

/// By how much a lattice is coarsened that leaves too many triangles.
const COARSENING: f64 = 1.15;

/// Maximum number of parts; those beyond it are one.
const MOST_PARTS: usize = 256;

/// Maximum length of a part's name in a file, with its escapes.
const LONGEST_NAME: usize = 150;

/// A part of a decimated mesh.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MeshPart {
    /// Its name; may be empty.
    pub name: String,
    /// Number of its triangles, which follow those of the parts before.
    pub triangles: usize,
}

/// The surfaces of a scene with at most about 60 000 triangles, in the array's axes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SceneMesh {
    /// Corners, m.
    pub vertices: Vec<[f32; 3]>,
    /// Indices of three vertices each, part by part.
    pub triangles: Vec<[u32; 3]>,
    /// The parts, in the order of their triangles.
    pub parts: Vec<MeshPart>,
}

impl SceneMesh {
    /// The surfaces of a scene. All vertices within a cell of a lattice become the first of them, and triangles that are
    /// then degenerate or repeat another one of their part are dropped; the lattice is the finest of a fixed series that
    /// leaves at most 60 000. A part that would vanish keeps its largest triangle. The same scene gives the same mesh.
    ///
    /// - Shape: vertices are some of those of the scene, and none is farther than a cell from where it was.
    /// - Cost: `O(n)` for each lattice that is tried, for about a second with ten million triangles; memory for the mesh
    ///   that remains.
    pub fn decimated(scene: &Scene) -> Self {
        let mut parts: Vec<(&str, Range<usize>)> =
            scene.parts().iter().map(|part| (part.name.as_str(), part.triangles.clone())).collect();
        let all = scene.triangles();
        if parts.is_empty() {
            parts.push(("", 0..all.len()));
        }
        if let Some((_, further)) = parts.get(MOST_PARTS - 1).filter(|_| parts.len() > MOST_PARTS) {
            let further = further.start..all.len();
            parts.truncate(MOST_PARTS - 1);
            parts.push(("further parts", further));
        }
        Self::of(all, &parts)
    }

    fn of(triangles: &[Triangle], parts: &[(&str, Range<usize>)]) -> Self {
        let Some((low, high)) = bounding_box(triangles.iter().flat_map(|t| t.vertices)) else {
            return Self::default();
        };
        let finest = ((high - low).max_element() / FINEST).max(f64::MIN_POSITIVE);
        let mut step = finest;
        if triangles.len() > MOST_TRIANGLES {
            // A cell of a surface has two triangles or less, so that this lattice is seldom too coarse.
            let area: f64 = triangles.iter().map(Triangle::area).sum();
            step = (area / MOST_TRIANGLES as f64).sqrt().max(finest);
        }
        loop {
            if let Some(mesh) = Self::on_lattice(triangles, parts, (low, step)) {
                return mesh;
            }
            step *= COARSENING;
        }
    }

    /// The mesh with its vertices merged on the lattice of this origin and step, unless it has too many triangles.
    fn on_lattice(
        triangles: &[Triangle],
        parts: &[(&str, Range<usize>)],
        (origin, step): (DVec3, f64),
    ) -> Option<Self> {
        let mut mesh = Self::default();
        let mut index_of = FxHashMap::default();
        let mut present = FxHashSet::default();
        for (name, range) in parts {
            let triangles = &triangles[range.clone()];
            let before = mesh.triangles.len();
            present.clear();
            for triangle in triangles {
                let cells = triangle.vertices.map(|v| ((v - origin) / step).round().as_u64vec3());
                let [a, b, c] = cells;
                if a == b || b == c || c == a {
                    continue;
                }
                let corners = [0, 1, 2].map(|k| {
                    *index_of.entry(cells[k]).or_insert_with(|| mesh.add_vertex(triangle.vertices[k]))
                });
                let mut sorted = corners;
                sorted.sort_unstable();
                if present.insert(sorted) {
                    mesh.triangles.push(corners);
                    if mesh.triangles.len() > MOST_TRIANGLES {
                        return None;
                    }
                }
            }
            if mesh.triangles.len() == before {
                let largest = triangles.iter().max_by(|a, b| a.area().total_cmp(&b.area()));
                if let Some(largest) = largest.filter(|triangle| triangle.area() > 0.0) {
                    let corners = largest.vertices.map(|vertex| mesh.add_vertex(vertex));
                    mesh.triangles.push(corners);
                }
            }
            let triangles = mesh.triangles.len() - before;
            mesh.parts.push(MeshPart { name: (*name).to_owned(), triangles });
        }
        Some(mesh)
    }

    fn add_vertex(&mut self, vertex: DVec3) -> u32 {
        self.vertices.push(vertex.to_array().map(|x| x as f32));
        (self.vertices.len() - 1) as u32
    }

    /// Writes vertices `x`, `y`, `z` in m as float32, and faces of three `vertex_indices` with `part`, the number of their
    /// part, counted from 0; the name of each part is a comment such as `part 0 "body"`, as in JSON.
    ///
    /// # Errors
    /// As `write_atomically`.
    pub fn write(&self, path: &Path, attributes: &[(String, Attribute)]) -> Result<()> {
        let floats = ["x", "y", "z"].map(|name| (Scalar::F32, name));
        let mut header = header(self.vertices.len(), &floats, "Mesh of the scene, decimated", attributes);
        let names = self.parts.iter().enumerate();
        header.comments.extend(names.map(|(k, part)| format!("part {k} {}", quoted_name(&part.name))));
        let property = |name: &str, count, scalar| Property { name: name.to_owned(), count, scalar };
        let properties = vec![
            property("vertex_indices", Some(Scalar::U8), Scalar::I32),
            property("part", None, Scalar::I32),
        ];
        let count = self.triangles.len() as u64;
        header.elements.push(Element { name: "face".to_owned(), count, properties });
        write_atomically(path, |out| {
            write!(out, "{header}")?;
            for value in self.vertices.iter().flatten() {
                out.write_all(&value.to_le_bytes())?;
            }
            let mut triangles = self.triangles.iter();
            for (number, part) in self.parts.iter().enumerate() {
                for corners in triangles.by_ref().take(part.triangles) {
                    out.write_all(&[3])?;
                    for value in corners.iter().copied().chain([number as u32]) {
                        out.write_all(&value.to_le_bytes())?;
                    }
                }
            }
            Ok(())
        })
    }

    /// Reads a file written by [`SceneMesh::write`], of at most `limit_bytes`.
    ///
    /// # Errors
    /// A missing or damaged file, or another mesh.
    pub fn read(path: &Path, limit_bytes: u64) -> Result<Self> {
        let fault = |problem: &str| {
            Error::input(
                path.display(),
                format!("{problem}; the mesh of a scene, as `holosonar image` writes it, was expected"),
            )
        };
        let ply = Ply::read_mesh(path, limit_bytes)?;
        let vertices =
            ply.vertices.columns(["x", "y", "z"]).ok_or_else(|| fault("has no vertices x, y, z"))?;
        let vertices: Vec<[f32; 3]> = vertices.into_iter().map(|v| v.map(|x| x as f32)).collect();
        if !vertices.iter().flatten().all(|x| x.is_finite()) {
            return Err(fault("has a vertex that is not finite"));
        }
        let [length, a, b, c] = LIST_OF_THREE;
        let faces = ply.triangles.and_then(|faces| faces.columns([length, a, b, c, "part"]));
        let faces = faces.ok_or_else(|| fault("has no faces with their `part`"))?;
        let mut parts: Vec<MeshPart> =
            names(&ply.comments).map(|name| MeshPart { name, triangles: 0 }).collect();
        let mut triangles = Vec::with_capacity(faces.len());
        let mut current = 0;
        for [length, a, b, c, part] in faces {
            let corners = [a, b, c];
            let known = |index: &f64| (0.0..vertices.len() as f64).contains(index);
            if length != 3.0 || !corners.iter().all(known) {
                return Err(fault("has a face that is not three of its vertices"));
            }
            if !(f64::from(current)..parts.len() as f64).contains(&part) {
                return Err(fault("has a face of a part that it does not name, or parts out of order"));
            }
            current = part as u32;
            parts[current as usize].triangles += 1;
            triangles.push(corners.map(|index| index as u32));
        }
        Ok(Self { vertices, triangles, parts })
    }
}

/// A name as JSON in ASCII, cut off where it would be too long for a comment.
fn quoted_name(name: &str) -> String {
    let mut quoted = String::from('"');
    for c in name.chars() {
        let escaped = match c {
            '"' | '\\' => format!("\\{c}"),
            ' '..='~' => c.to_string(),
            _ => json_escape(c),
        };
        if quoted.len() + escaped.len() > LONGEST_NAME {
            break;
        }
        quoted += &escaped;
    }
    quoted + "\""
}

/// The names of the parts in the comments of a file, in order.
fn names(comments: &[String]) -> impl Iterator<Item = String> {
    let named = comments.iter().filter_map(|comment| comment.strip_prefix("part "));
    named.enumerate().map_while(|(k, part)| {
        let name = part.strip_prefix(&k.to_string())?.strip_prefix(' ')?;
        serde_json::from_str(name).ok()
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::scene::{LoadOptions, Unit};

    /// A sphere of `2 n²` triangles around a point.
    fn sphere(centre: DVec3, radius: f64, n: usize) -> Vec<Triangle> {
        let at = |i: usize, j: usize| {
            let turn = std::f64::consts::PI / n as f64;
            let (polar, around) = (turn * i as f64, 2.0 * turn * j as f64);
            let [x, y] = [around.cos(), around.sin()].map(|share| share * polar.sin());
            centre + radius * DVec3::new(x, y, polar.cos())
        };
        let square = |i: usize, j: usize| {
            [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
        };
        let squares = (0..n * n).flat_map(|k| square(k / n, k % n));
        squares.map(|vertices| Triangle { vertices, material: 0 }).collect()
    }

    fn bounds(mesh: &SceneMesh) -> (DVec3, DVec3) {
        bounding_box(mesh.vertices.iter().map(|v| DVec3::from(v.map(f64::from)))).unwrap()
    }

    fn area(mesh: &SceneMesh) -> f64 {
        let corner = |index: u32| DVec3::from(mesh.vertices[index as usize].map(f64::from));
        mesh.triangles.iter().map(|t| Triangle { vertices: t.map(corner), material: 0 }.area()).sum()
    }

    #[test]
    fn a_small_mesh_keeps_every_triangle_but_those_that_show_nothing() {
        let [a, b, c, d] =
            [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, 1.5]].map(DVec3::from);
        let vertices = [[a, b, c], [b, d, c], [c, a, b], [a, a, b], [a, b, a + 1e-9]];
        let triangles = vertices.map(|vertices| Triangle { vertices, material: 0 });
        let mesh = SceneMesh::of(&triangles, &[("wall", 0..5)]);
        assert_eq!(mesh.triangles, [[0, 1, 2], [1, 3, 2]], "repeated and degenerate ones are dropped");
        assert_eq!(mesh.vertices, [a, b, c, d].map(|v| v.to_array().map(|x| x as f32)));
        assert_eq!(SceneMesh::of(&[], &[]), SceneMesh::default());
    }

    #[test]
    fn a_large_mesh_is_decimated_to_the_budget_in_its_bounds_and_its_parts() {
        let mut triangles = sphere(DVec3::new(0.1, -0.2, 2.0), 0.5, 400);
        let big = triangles.len();
        triangles.extend(sphere(DVec3::new(0.1, 0.45, 2.0), 1e-4, 4));
        let parts = [("ball", 0..big), ("dot", big..triangles.len())];
        let mesh = SceneMesh::of(&triangles, &parts);
        assert!((20_000..=MOST_TRIANGLES + 1).contains(&mesh.triangles.len()), "{}", mesh.triangles.len());
        assert_eq!(mesh.parts[0].name, "ball");
        assert_eq!(mesh.parts[1], MeshPart { name: "dot".into(), triangles: 1 }, "it would vanish");
        assert_eq!(mesh.parts.iter().map(|part| part.triangles).sum::<usize>(), mesh.triangles.len());
        let (low, high) = bounds(&mesh);
        let cell = 0.02;
        assert!((low - DVec3::new(-0.4, -0.7, 1.5)).abs().max_element() < cell, "{low}");
        assert!((high - DVec3::new(0.6, 0.4501, 2.5)).abs().max_element() < cell, "{high}");
        assert!((area(&mesh) / std::f64::consts::PI - 1.0).abs() < 0.01, "{}", area(&mesh));
        let of_scene: FxHashSet<[u32; 3]> = triangles
            .iter()
            .flat_map(|t| t.vertices.map(|v| v.to_array().map(|x| (x as f32).to_bits())))
            .collect();
        assert!(
            mesh.vertices.iter().all(|v| of_scene.contains(&v.map(f32::to_bits))),
            "no vertex is made up"
        );
        assert_eq!(mesh, SceneMesh::of(&triangles, &parts), "the same each time");
    }

    #[test]
    fn parts_are_those_of_the_scene_up_to_a_number() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("parts.obj");
        for (count, last) in [(1, "part 0"), (MOST_PARTS, "part 255"), (MOST_PARTS + 9, "further parts")] {
            let part = |k: usize| format!("o part {k}\nv {k} 0 1\nv {k} 1 1\nv {k} 0 2\nf -3 -2 -1\n");
            std::fs::write(&path, (0..count).map(part).collect::<String>()).unwrap();
            let options = LoadOptions::default().with_unit(Some(Unit::Metre));
            let mesh = SceneMesh::decimated(&Scene::load(&path, &options).unwrap());
            assert_eq!((mesh.triangles.len(), mesh.parts.len()), (count, count.min(MOST_PARTS)));
            let further = 1 + count.saturating_sub(MOST_PARTS);
            assert_eq!(mesh.parts.last(), Some(&MeshPart { name: last.into(), triangles: further }));
        }
    }

    #[test]
    fn a_mesh_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mesh.ply");
        let triangles = [sphere(DVec3::Z, 0.5, 4), sphere(DVec3::Z * 2.0, 0.25, 4)].concat();
        let long = "x".repeat(500);
        let parts = [("Würfel \"1\"\n𝄞", 0..32), ("", 32..40), (&long, 40..64)];
        let mesh = SceneMesh::of(&triangles, &parts);
        mesh.write(&path, &[]).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let mut read = SceneMesh::read(&path, 1 << 20).unwrap();
        let name = std::mem::replace(&mut read.parts[2].name, long.clone());
        assert!(long.starts_with(&name) && name.len() > 100, "cut off");
        assert_eq!(read, mesh);
        let options = LoadOptions::default().with_unit(Some(Unit::Metre));
        let scene = Scene::load(&path, &options).unwrap();
        assert_eq!(scene.triangles().len(), mesh.triangles.len(), "it is a mesh like any other");
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert_eq!(SceneMesh::read(&path, 1 << 20).unwrap_err().exit_status(), 2, "cut at {length}");
        }
        std::fs::write(&path, &whole).unwrap();
        assert!(SceneMesh::read(&path, 100).unwrap_err().to_string().contains("limit"));
        let header = whole.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let face = header + 12 * mesh.vertices.len();
        for (at, value, problem) in [
            (face, 4, "three of its vertices"),
            (face + 4, 0x7f, "three of its vertices"),
            (face + 13, 9, "part"),
            (face + 17 * 40 + 13, 0, "part"),
            (header + 3, 0x7f, "not finite"),
        ] {
            let mut damaged = whole.clone();
            damaged[at] = value;
            if at == header + 3 {
                damaged[header + 2] = 0xff;
            }
            std::fs::write(&path, &damaged).unwrap();
            let error = SceneMesh::read(&path, 1 << 20).unwrap_err().to_string();
            assert!(error.contains(problem), "{at}: {error}");
        }
    }
}
