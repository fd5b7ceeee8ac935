//! The letter F reads as an F: left is left, up is up, in the truth and in the image, whatever the mesh's axes.
//!
//! An image's column is x (right) and its row y (down), as seen from behind the array.

use crate::support::data;
use glam::DVec3;
use holosonar::config::RunFile;
use holosonar::export::depth_exr::read_depth_map;
use holosonar::grid::DepthMap;
use holosonar::pipeline::{JobOptions, image_scene, truth_of_scene, write_depth};
use std::fmt::Write;
use std::path::Path;

/// Points of the picture (x right, y down, m) on the F's stem and bars, and off them.
const ON: [[f64; 2]; 5] = [[-0.2, -0.4], [-0.2, 0.4], [0.2, -0.4], [0.15, 0.0], [-0.2, 0.2]];
const OFF: [[f64; 2]; 4] = [[0.2, 0.4], [0.05, 0.35], [0.05, -0.2], [0.3, 0.1]];

const INSTRUMENT: &str = r"
[sweep]
step = 40.0
[array]
count = [31, 31]
extent = [1.0, 1.0]
[grid]
x = [-0.5, 0.5]
y = [-0.6, 0.6]
pitch = [0.03333333333333333, 0.03333333333333333, 0.01]
";

fn run_file(folder: &Path, scene: &str, z: [f64; 2]) -> RunFile {
    let text = format!("[scene]\n{scene}\n{INSTRUMENT}z = {z:?}\n");
    RunFile::from_str_at(&text, "test", folder, &[]).unwrap()
}

/// How many of the 3 × 3 pixels about (x, y), m, show a surface at `depth`.
fn seen(map: &DepthMap, [x, y]: [f64; 2], depth: f32, tolerance: f32) -> usize {
    let (column, row) = (map.x.index_of(x).unwrap(), map.y.index_of(y).unwrap());
    (0..9)
        .map(|i| map.picked.depth[(row + i / 3 - 1) * map.x.count + column + i % 3 - 1])
        .filter(|z| (z - depth).abs() < tolerance)
        .count()
}

/// The F at a depth, or its mirror image (`side` = −1).
fn reads_as_f(map: &DepthMap, side: f64, depth: f32, tolerance: f32, what: &str) {
    // Speckle leaves a few dark pixels on a surface.
    for [x, y] in ON {
        let seen = seen(map, [side * x, y], depth, tolerance);
        assert!(seen >= 4, "{what}: only {seen} of 9 pixels about ({x}, {y})");
    }
    for [x, y] in OFF {
        let seen = seen(map, [side * x, y], depth, tolerance);
        assert!(seen <= 1, "{what}: {seen} of 9 pixels about ({x}, {y})");
    }
}

/// The truth, through its file.
fn truth(run: &RunFile) -> DepthMap {
    let (facts, map) = truth_of_scene(run, &JobOptions::default()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("truth.exr");
    write_depth(&path, &map, run, &facts).unwrap();
    let read = read_depth_map(&path, 1 << 30).unwrap();
    assert!(read.axes_known);
    read.map
}

/// The F of three rectangles as an OBJ, with each picture point (x right, y down) at `place` of it.
fn obj(place: impl Fn(f64, f64) -> DVec3) -> String {
    let mut text = String::new();
    for [left, top, right, bottom] in
        [[-0.3, -0.5, -0.1, 0.5], [-0.1, -0.5, 0.3, -0.3], [-0.1, -0.1, 0.2, 0.1]]
    {
        for (x, y) in [(left, top), (right, top), (right, bottom), (left, bottom)] {
            let p = place(x, y);
            writeln!(text, "v {} {} {}", p.x, p.y, p.z).unwrap();
        }
        text.push_str("f -4 -3 -2 -1\n");
    }
    text
}

#[test]
fn a_gltf_reads_from_the_origin_along_its_minus_z() {
    let run = run_file(&data("scenes"), "mesh = \"f.gltf\"", [1.9, 2.1]);
    reads_as_f(&truth(&run), 1.0, 2.0, 1e-6, "glTF");
}

#[test]
fn an_obj_reads_in_each_of_its_axes() {
    let folder = tempfile::tempdir().unwrap();
    let text = |name: &str, text: String| std::fs::write(folder.path().join(name), text).unwrap();
    text("none.obj", obj(|x, y| DVec3::new(x, y, 2.0)));
    text("y.obj", obj(|x, y| DVec3::new(x, -y, -2.0)));
    text("z.obj", obj(|x, y| DVec3::new(x, 2.0, -y)));
    for up in ["none", "y", "z"] {
        let scene = format!("mesh = \"{up}.obj\"\nunit = \"m\"\nup = \"{up}\"");
        reads_as_f(&truth(&run_file(folder.path(), &scene, [1.9, 2.1])), 1.0, 2.0, 1e-6, up);
    }
    // Left out, y is up in an OBJ.
    let run = run_file(folder.path(), "mesh = \"y.obj\"\nunit = \"m\"", [1.9, 2.1]);
    reads_as_f(&truth(&run), 1.0, 2.0, 1e-6, "default");
}

#[test]
fn a_camera_behind_the_letter_sees_it_mirrored_as_if_placed_by_hand() {
    let image = |scene: &str| truth(&run_file(&data("scenes"), scene, [2.9, 3.1]));
    let by_hand = image("mesh = \"f.gltf\"\nrotate = [0.0, 180.0, 0.0]\ntranslate = [0.0, 0.0, 5.0]");
    reads_as_f(&by_hand, -1.0, 3.0, 1e-5, "placed by hand");
    for sensor in ["camera:Camera.001", "camera:Behind", "node:Behind"] {
        let seen = image(&format!("mesh = \"f.gltf\"\nsensor = \"{sensor}\""));
        reads_as_f(&seen, -1.0, 3.0, 1e-5, sensor);
        for (a, b) in seen.picked.depth.iter().zip(&by_hand.picked.depth) {
            assert!((a.is_nan() && b.is_nan()) || (a - b).abs() < 1e-5, "{sensor}: {a} {b}");
        }
    }
}

#[test]
fn the_image_reads_as_the_truth_does() {
    let run = run_file(&data("scenes"), "mesh = \"f.gltf\"", [1.85, 2.15]);
    let outcome = image_scene(&run, &JobOptions::default()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    holosonar::pipeline::write_outputs(&run, &outcome, folder.path(), &JobOptions::default()).unwrap();
    let read = |name: &str| read_depth_map(&folder.path().join(name), 1 << 30).unwrap().map;
    reads_as_f(&read("truth.exr"), 1.0, 2.0, 1e-6, "truth");
    reads_as_f(&read("depth.exr"), 1.0, 2.0, 0.02, "image");
}
