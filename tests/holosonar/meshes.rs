//! Meshes of many triangles in every format: a sphere with bumps, 2 m before the array.

use crate::support::data;
use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// Corners and the triangles between them, about `count` of them.
fn sphere(count: usize) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
    let rows = ((count / 4) as f64).sqrt().round() as usize;
    let columns = count / (2 * rows);
    let mut corners = Vec::new();
    for i in 0..=rows {
        for j in 0..=columns {
            let (u, v) = (PI * i as f64 / rows as f64, TAU * j as f64 / columns as f64);
            let radius = 0.5 + 0.03 * (7.0 * u).sin() * (9.0 * v).cos();
            let (ring, height) = (radius * u.sin(), radius * u.cos());
            corners.push([ring * v.cos(), height, 1.7 + ring * v.sin()].map(|x| x as f32));
        }
    }
    let mut triangles = Vec::new();
    for i in 0..rows {
        for j in 0..columns {
            let a = (i * (columns + 1) + j) as u32;
            let below = a + columns as u32 + 1;
            triangles.extend([[a, a + 1, below + 1], [a, below + 1, below]]);
        }
    }
    (corners, triangles)
}

fn bytes<'a>(numbers: impl IntoIterator<Item = &'a [f32; 3]>) -> Vec<u8> {
    numbers.into_iter().flatten().flat_map(|x| x.to_le_bytes()).collect()
}

/// A binary STL.
pub(crate) fn write_stl(path: &Path, count: usize) {
    let (corners, triangles) = sphere(count);
    let mut file = vec![0; 80];
    file.extend((triangles.len() as u32).to_le_bytes());
    for triangle in &triangles {
        file.extend([0; 12]);
        file.extend(bytes(triangle.map(|i| &corners[i as usize])));
        file.extend([0; 2]);
    }
    fs::write(path, file).unwrap();
}

/// An STL in text.
pub(crate) fn write_text_stl(path: &Path, count: usize) {
    let (corners, triangles) = sphere(count);
    let mut file = String::from("solid sphere\n");
    for triangle in &triangles {
        file += "facet normal 0 0 0\n outer loop\n";
        for [x, y, z] in triangle.map(|i| corners[i as usize]) {
            let _ = writeln!(file, "  vertex {x:e} {y:e} {z:e}");
        }
        file += " endloop\nendfacet\n";
    }
    fs::write(path, file + "endsolid sphere\n").unwrap();
}

/// A PLY, binary or in text.
pub(crate) fn write_ply(path: &Path, count: usize, text: bool) {
    let (corners, triangles) = sphere(count);
    let kind = if text { "ascii" } else { "binary_little_endian" };
    let header = format!(
        "ply\nformat {kind} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        corners.len(),
        triangles.len()
    );
    let mut file = header.into_bytes();
    if text {
        for [x, y, z] in &corners {
            file.extend(format!("{x} {y} {z}\n").bytes());
        }
        for [a, b, c] in &triangles {
            file.extend(format!("3 {a} {b} {c}\n").bytes());
        }
    } else {
        file.extend(bytes(&corners));
        for triangle in &triangles {
            file.push(3);
            file.extend(triangle.iter().flat_map(|i| i.to_le_bytes()));
        }
    }
    fs::write(path, file).unwrap();
}

/// An OBJ with normals, as most programs write it.
pub(crate) fn write_obj(path: &Path, count: usize) {
    let (corners, triangles) = sphere(count);
    let mut file = String::new();
    for [x, y, z] in &corners {
        writeln!(file, "v {x:.6} {y:.6} {z:.6}").unwrap();
    }
    for [x, y, z] in &corners {
        writeln!(file, "vn {x:.4} {y:.4} {z:.4}").unwrap();
    }
    for [a, b, c] in triangles.iter().map(|t| t.map(|i| i + 1)) {
        writeln!(file, "f {a}//{a} {b}//{b} {c}//{c}").unwrap();
    }
    fs::write(path, file).unwrap();
}

/// A GLB.
pub(crate) fn write_glb(path: &Path, count: usize) {
    let (corners, triangles) = sphere(count);
    let mut binary = bytes(&corners);
    let positions = binary.len();
    binary.extend(triangles.iter().flatten().flat_map(|i| i.to_le_bytes()));
    let indices = binary.len() - positions;
    let json = serde_json::json!({
        "asset": { "version": "2.0" }, "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
        "buffers": [{ "byteLength": binary.len() }],
        "bufferViews": [
            { "buffer": 0, "byteLength": positions },
            { "buffer": 0, "byteOffset": positions, "byteLength": indices }
        ],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": corners.len(), "type": "VEC3",
              "min": [-1.0, -1.0, 0.0], "max": [1.0, 1.0, 3.0] },
            { "bufferView": 1, "componentType": 5125, "count": 3 * triangles.len(), "type": "SCALAR" }
        ]
    });
    let mut file = glb(json.to_string(), Some(binary.len() as u32));
    file.extend(binary);
    fs::write(path, file).unwrap();
}

/// A GLB of this JSON, up to the bytes of a binary chunk of this length, if it has one.
pub(crate) fn glb(mut json: String, binary: Option<u32>) -> Vec<u8> {
    json.push_str(&" ".repeat(json.len().next_multiple_of(4) - json.len()));
    let length = 20 + json.len() as u32 + binary.map_or(0, |binary| 8 + binary);
    let mut file = b"glTF".to_vec();
    for word in [2, length, json.len() as u32] {
        file.extend(word.to_le_bytes());
    }
    file.extend([b"JSON", json.as_bytes()].concat());
    if let Some(binary) = binary {
        file.extend([&binary.to_le_bytes()[..], b"BIN\0"].concat());
    }
    file
}

/// The letter F as a GLB of one JSON chunk, its buffer inside as a data URI.
pub(crate) fn letter_glb() -> Vec<u8> {
    glb(fs::read_to_string(data("scenes/f.gltf")).unwrap(), None)
}
