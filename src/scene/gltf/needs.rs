//! What reading a glTF file will take, by the counts in its JSON.

use std::collections::HashMap;
use std::io::{BufReader, Read};

use serde::Deserialize;
use serde_json::Value;

use super::super::needs::{Glimpse, MeshNeeds};

/// The numbers of a file that say how much there is of it; all else is passed over.
#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Outline {
    scene: usize,
    scenes: Vec<Scene>,
    nodes: Vec<Node>,
    meshes: Vec<Mesh>,
    accessors: Vec<Accessor>,
    buffers: Vec<Buffer>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Scene {
    nodes: Vec<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Node {
    mesh: Option<usize>,
    children: Vec<usize>,
    extensions: HashMap<String, Value>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Mesh {
    primitives: Vec<Primitive>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Primitive {
    attributes: HashMap<String, usize>,
    indices: Option<usize>,
    mode: Option<u64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Accessor {
    count: u64,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Buffer {
    byte_length: u64,
}

/// A longer JSON holds its buffers itself, as most of it, and is not looked through.
const LONGEST: u64 = 1 << 26;

/// Bytes of a file for each triangle of it: where three vertices of 12 bytes make six triangles, with 32-bit indices.
const PER_TRIANGLE: u64 = 18;

/// Counts the triangles of the scene's nodes.
pub(in super::super) fn needs(glimpse: &mut Glimpse) -> Option<MeshNeeds> {
    let file = glimpse.length;
    let start = glimpse.bytes(0, 20);
    let (from, text) = match start.get(12..16) {
        Some(&[a, b, c, d]) if start.starts_with(b"glTF") => {
            (20, u64::from(u32::from_le_bytes([a, b, c, d])))
        }
        _ => (if start.starts_with(super::container::BOM) { 3 } else { 0 }, file),
    };
    let embedded =
        MeshNeeds { triangles: file * 3 / 4 / PER_TRIANGLE, reading: file * 3, ..MeshNeeds::default() };
    if text.min(file) > LONGEST {
        return Some(embedded);
    }
    let json = BufReader::new(glimpse.from(from)?).take(text);
    let outline: Outline = serde_json::from_reader(json).ok()?;
    let buffers = outline.buffers.iter().fold(0, |sum: u64, buffer| sum.saturating_add(buffer.byte_length));
    // The typed JSON holds as much as its text and some more.
    let reading =
        buffers.saturating_add(text.saturating_mul(4)).max(file.saturating_add(text.saturating_mul(3)));
    Some(MeshNeeds { triangles: outline.triangles(), counted: true, reading, ..MeshNeeds::default() })
}

impl Outline {
    /// Triangles of all nodes that are shown; saturates rather than overflow.
    fn triangles(&self) -> u64 {
        let mut left = match self.scenes.get(self.scene) {
            Some(scene) => scene.nodes.clone(),
            None => (0..self.nodes.len()).collect(),
        };
        let mut visited = vec![false; self.nodes.len()];
        let mut triangles: u64 = 0;
        while let Some(index) = left.pop() {
            let Some(node) = self.nodes.get(index) else { continue };
            if std::mem::replace(&mut visited[index], true) {
                continue;
            }
            left.extend(&node.children);
            let mesh = node.mesh.and_then(|mesh| self.meshes.get(mesh));
            let of_mesh = mesh.map_or(0, |mesh| self.triangles_of(mesh));
            triangles = triangles.saturating_add(of_mesh.saturating_mul(self.copies(node)));
        }
        triangles
    }

    fn triangles_of(&self, mesh: &Mesh) -> u64 {
        let count =
            |accessor: Option<usize>| accessor.and_then(|a| self.accessors.get(a)).map_or(0, |a| a.count);
        let of = |primitive: &Primitive| {
            let corners = count(primitive.indices.or(primitive.attributes.get("POSITION").copied()));
            match primitive.mode.unwrap_or(4) {
                4 => corners / 3,
                5 | 6 => corners.saturating_sub(2),
                _ => 0,
            }
        };
        mesh.primitives.iter().map(of).fold(0, u64::saturating_add)
    }

    /// How often a node shows its mesh.
    fn copies(&self, node: &Node) -> u64 {
        let attributes =
            node.extensions.get(super::instances::NAME).and_then(|e| e.get("attributes")?.as_object());
        let accessor = attributes.and_then(|all| all.values().next()?.as_u64());
        let accessor = accessor.and_then(|index| self.accessors.get(usize::try_from(index).ok()?));
        accessor.map_or(1, |accessor| accessor.count)
    }
}
