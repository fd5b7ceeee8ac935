//! Meshes of ten kinds, taken bare: how much of each is found, and how much is shown where there is nothing.

use crate::bare::{FACES, corners};
use crate::binary::done_json;
use holosonar::glam::DVec3;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::fs;

/// A mesh as OBJ, with y up and z towards the array.
#[derive(Default)]
pub(crate) struct Mesh {
    vertices: Vec<DVec3>,
    faces: Vec<[usize; 4]>,
}

impl Mesh {
    /// Boxes between two corners each.
    pub(crate) fn boxes(all: &[[[f64; 3]; 2]]) -> Self {
        let mut mesh = Self::default();
        for ends in all {
            let n = mesh.vertices.len();
            mesh.vertices.extend(corners(ends).map(DVec3::from_array));
            mesh.faces.extend(FACES.map(|face| face.map(|corner| n + corner)));
        }
        mesh
    }

    /// A closed surface over two parameters from 0 to 1, of which both go round, or the second ends in points.
    fn surface([n, m]: [usize; 2], at: impl Fn(f64, f64) -> DVec3) -> Self {
        let vertices = (0..n * (m + 1)).map(|i| at((i % n) as f64 / n as f64, (i / n) as f64 / m as f64));
        let face = |i: usize| {
            let (u, v) = (i % n, i / n);
            let index = |u: usize, v: usize| u % n + n * v;
            [index(u, v), index(u + 1, v), index(u + 1, v + 1), index(u, v + 1)]
        };
        Self { vertices: vertices.collect(), faces: (0..n * m).map(face).collect() }
    }

    /// Turned about the y axis: radius and height over 0 to 1 from the lower end.
    fn turned(profile: impl Fn(f64) -> [f64; 2]) -> Self {
        Self::surface([64, 48], |u, v| {
            let [radius, height] = profile(v);
            let (sine, cosine) = (TAU * u).sin_cos();
            DVec3::new(radius * sine, height, radius * cosine)
        })
    }

    pub(crate) fn obj(&self) -> String {
        let mut text = String::new();
        for v in &self.vertices {
            let _ = writeln!(text, "v {} {} {}", v.x, v.y, v.z);
        }
        for [a, b, c, d] in self.faces.iter().map(|face| face.map(|corner| corner + 1)) {
            let _ = writeln!(text, "f {a} {b} {c} {d}");
        }
        text
    }
}

/// Name, size and mesh of each kind.
fn kinds() -> Vec<(&'static str, &'static str, Mesh)> {
    let tube = |path: &dyn Fn(f64) -> DVec3, thick: f64, turns: usize| {
        Mesh::surface([24, 96 * turns], |u, v| {
            let along = (path(v + 1e-4) - path(v - 1e-4)).normalize();
            let across = along.cross(DVec3::new(0.2, 0.3, 1.0)).normalize();
            let (sine, cosine) = (TAU * u).sin_cos();
            path(v) + thick * (cosine * across + sine * along.cross(across))
        })
    };
    let knot = |v: f64| {
        let (a, b) = (TAU * v, 1.5 * TAU * 2.0 * v);
        DVec3::new((2.0 + b.cos()) * (2.0 * a).cos(), (2.0 + b.cos()) * (2.0 * a).sin(), b.sin())
    };
    let ring = |v: f64| DVec3::new((TAU * v).cos(), (TAU * v).sin(), 0.3 * (2.0 * TAU * v).sin());
    let leg = |x: f64, z: f64| [[x, 0.0, z], [x + 0.06, 0.45, z + 0.06]];
    let seat = [[-0.25, 0.45, -0.25], [0.25, 0.5, 0.25]];
    let stool = [leg(-0.25, -0.25), leg(0.19, -0.25), leg(-0.22, 0.19), leg(0.16, 0.19), seat];
    let room = [
        [[-5.0, 0.0, -5.0], [5.0, 0.2, 5.0]],
        [[-5.0, 9.8, -5.0], [5.0, 10.0, 5.0]],
        [[-5.0, 0.0, -5.0], [5.0, 10.0, -4.8]],
        [[-5.0, 0.0, -5.0], [-4.8, 10.0, 5.0]],
        [[4.8, 0.0, -5.0], [5.0, 10.0, 5.0]],
        [[-3.5, 0.0, -3.0], [-0.5, 6.0, 0.0]],
        [[0.5, 0.0, 0.5], [3.5, 3.0, 3.5]],
    ];
    let house = [
        [[-7.0, 0.0, -5.0], [7.0, 8.0, 5.0]],
        [[-7.5, 8.0, -5.5], [7.5, 8.5, 5.5]],
        [[-2.0, 0.0, 5.0], [2.0, 4.0, 7.0]],
        [[4.0, 8.5, -2.0], [5.5, 11.0, 0.0]],
    ];
    let stairs: Vec<[[f64; 3]; 2]> =
        (0..6).map(|k| f64::from(k) * 0.17).map(|k| [[-0.5, 0.0, -k - 0.3], [0.5, k + 0.17, -k]]).collect();
    vec![
        ("ball", "12cm", Mesh::turned(|v| [(0.5 * TAU * v).sin(), -(0.5 * TAU * v).cos()])),
        ("vase", "30cm", Mesh::turned(|v| [(TAU * v * 0.5).sin() * (1.0 + 0.5 * (TAU * v).sin()), 3.0 * v])),
        (
            "bottle",
            "25cm",
            Mesh::turned(|v| {
                [0.4 * (v.min(1.0 - v) * 40.0).min(1.0) * if v > 0.7 { 0.4 } else { 1.0 }, 2.0 * v]
            }),
        ),
        ("knot", "60cm", tube(&knot, 0.4, 3)),
        ("ring", "40cm", tube(&ring, 0.15, 1)),
        ("stool", "50cm", Mesh::boxes(&stool)),
        ("stairs", "1m", Mesh::boxes(&stairs)),
        ("room", "55cm", Mesh::boxes(&room)),
        ("house", "15m", Mesh::boxes(&house)),
    ]
}

#[test]
#[ignore = "half a minute: meshes of ten kinds"]
fn bare_meshes_of_all_kinds_are_found_and_their_outlines_are_true() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let mut all: Vec<(&str, String)> = Vec::new();
    for (name, size, mesh) in kinds() {
        fs::write(path.join(format!("{name}.obj")), mesh.obj()).unwrap();
        all.push((name, format!("image {name}.obj --size {size}")));
    }
    let bracket = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/meshes/bracket.obj");
    all.push(("bracket", format!("image {bracket} --unit mm --up z --rotate 35,30,0")));
    let names = ["completeness", "false_returns", "outside_returns"];
    let mut scores: [Vec<f64>; 3] = [const { Vec::new() }; 3];
    for (name, words) in &all {
        let report = done_json(path, &format!("{words} -o {name}"));
        let found = names.map(|metric| report["metrics"][metric].as_f64().unwrap());
        println!("{name}: {found:.3?}");
        assert!(found[0] > 0.7 && found[1] < 0.2, "{name}: {found:?}");
        for (all, score) in scores.iter_mut().zip(found) {
            all.push(score);
        }
    }
    let [complete, wrong, outside] = scores.map(|mut scores| {
        scores.sort_by(f64::total_cmp);
        scores[scores.len() / 2]
    });
    assert!(complete > 0.9 && wrong < 0.05 && outside < 0.15, "{complete} {wrong} {outside}");
}
