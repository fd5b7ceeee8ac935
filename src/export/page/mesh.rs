//! The mesh of a page: vertices in 16 bits of each side of their box.

use super::payload::pack;
use crate::export::points_ply::SceneMesh;
use serde_json::{Value, json};

/// The maximum of a coordinate.
const LARGEST: f32 = 65_535.0;

/// The corners of the box in m, the vertices as shares of it, the triangles as numbers of vertices, part by part, and the
/// names of the parts.
pub(super) fn packed(mesh: &SceneMesh) -> Value {
    let ends = |pick: fn(f32, f32) -> f32, none: f32| {
        mesh.vertices.iter().fold([none; 3], |end, vertex| [0, 1, 2].map(|i| pick(end[i], vertex[i])))
    };
    let (low, high) = (ends(f32::min, f32::INFINITY), ends(f32::max, f32::NEG_INFINITY));
    let share = |i: usize, x: f32| match high[i] - low[i] {
        size if size > 0.0 => ((x - low[i]) / size * LARGEST).round() as u16,
        _ => 0,
    };
    let shares = mesh.vertices.iter().flat_map(|vertex| [0, 1, 2].map(|i| share(i, vertex[i])));
    let parts = mesh.parts.iter().map(|part| json!({ "name": part.name, "triangles": part.triangles }));
    json!({
        "low": low,
        "high": high,
        "vertices": pack(&shares.flat_map(u16::to_le_bytes).collect::<Vec<u8>>()),
        "triangles": pack(&mesh.triangles.iter().flatten().flat_map(|corner| corner.to_le_bytes()).collect::<Vec<u8>>()),
        "parts": parts.collect::<Vec<_>>(),
    })
}
