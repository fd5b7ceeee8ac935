//! The shipped meshes have the shapes that their scenes describe.
#![allow(clippy::unwrap_used)]

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::DVec3;

use super::{LoadOptions, Scene, Sensor, Unit, Up};
use crate::named::Warnings;

fn mesh(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/meshes").join(name)
}

/// Loads without a warning.
fn load(name: &str, options: &LoadOptions) -> Scene {
    let warnings = Warnings::default();
    let scene = Scene::load_with(&mesh(name), options, &warnings).unwrap();
    assert!(warnings.list().is_empty());
    scene
}

fn near(a: DVec3, b: DVec3) -> bool {
    (a - b).length() < 1e-6
}

#[test]
fn corner_is_three_square_plates_at_right_angles() {
    let scene = load("corner.obj", &LoadOptions::default().with_up(Up::None));
    assert_eq!(scene.triangles().len(), 6);
    assert!((scene.surface_area() - 3.0 * 0.72 * 0.72).abs() < 1e-8);
    let normals: Vec<_> = scene.triangles().iter().map(super::Triangle::normal).collect();
    assert!(normals[0].dot(normals[2]).abs() < 1e-8 && normals[2].dot(normals[4]).abs() < 1e-8);
    let (low, high) = scene.bounds().unwrap();
    assert!((high.z - 2.2).abs() < 1e-9 && (low.z - (2.2 - 2.0 * 0.72 / 3.0_f64.sqrt())).abs() < 1e-8);
    // It opens to the array: the vertex is seen from the origin, and nothing is behind it.
    let vertex = DVec3::new(0.0, 0.0, 2.2);
    assert_eq!(scene.transmittance(DVec3::ZERO, vertex), 1.0);
    assert_eq!(scene.transmittance(DVec3::ZERO, 2.0 * vertex), 0.0);
}

#[test]
fn corner2_is_two_plates_about_an_upright_edge() {
    let scene = load("corner2.obj", &LoadOptions::default().with_up(Up::None));
    assert_eq!(scene.triangles().len(), 4);
    let (low, high) = scene.bounds().unwrap();
    assert_eq!((low, high), (DVec3::new(-0.6, -0.6, 1.5), DVec3::new(0.6, 0.6, 2.1)));
    let crossings = scene.crossings(DVec3::ZERO, DVec3::new(0.0, 0.0, 3.0));
    assert_eq!(crossings.len(), 1);
    assert!((crossings[0].distance - 2.1).abs() < 1e-12);
    assert!(scene.triangles().iter().all(|t| t.normal().z.abs() > 0.5));
}

#[test]
fn transparent_foreground_shows_the_backdrop_through_its_plate() {
    let scene = load("transparent_foreground.gltf", &LoadOptions::default());
    assert_eq!(scene.triangles().len(), 8);
    let (low, high) = scene.bounds().unwrap();
    assert!(near(low, DVec3::new(-0.6, -0.6, 1.2)) && near(high, DVec3::new(0.6, 0.6, 1.8)));
    let by_name = |name: &str| scene.materials().iter().find(|m| m.name == name).unwrap();
    let (plate, backdrop) = (by_name("plate"), by_name("backdrop"));
    assert_eq!((plate.reflectance, plate.transmittance, plate.source.as_str()), (0.4, 0.6, "glTF extras"));
    assert_eq!((backdrop.reflectance, backdrop.transmittance), (1.0, 0.0));
    // Through the plate, next to it, through the step face.
    let seen = |x: f64, y: f64| -> Vec<f64> {
        let (from, to) = (DVec3::new(x, y, 0.0), DVec3::new(x, y, 3.0));
        scene.crossings(from, to).iter().map(|c| (c.distance * 1e6).round() / 1e6).collect()
    };
    assert_eq!(seen(-0.2, 0.1), [1.2, 1.8]);
    assert_eq!(seen(-0.5, 0.1), [1.8]);
    assert_eq!(seen(0.4, -0.5), [1.65]);
    assert_eq!(scene.transmittance(DVec3::ZERO, DVec3::new(-0.2, 0.1, 1.7)), 0.6);
    assert_eq!(scene.transmittance(DVec3::new(0.1, 0.0, 1.7), DVec3::new(0.3, 0.0, 1.7)), 0.0);
    // The front of every face is towards the array.
    assert!(scene.triangles().iter().filter(|t| t.normal().z.abs() > 0.5).all(|t| t.normal().z < 0.0));
}

#[test]
fn bracket_is_a_closed_solid() {
    let options = LoadOptions { unit: Some(Unit::Millimetre), up: Some(Up::Z), ..LoadOptions::default() };
    let scene = load("bracket.obj", &options);
    assert!(scene.triangles().len() < 400, "{}", scene.triangles().len());
    let (low, high) = scene.bounds().unwrap();
    assert!(near(high - low, DVec3::new(0.24, 0.24, 0.2)), "{}", high - low);
    // Every edge has one triangle on either side; the two traverse it in opposite directions.
    let key = |v: DVec3| v.to_array().map(|c| (c * 1e7).round() as i64);
    let mut edges = HashMap::new();
    for t in scene.triangles() {
        let k = t.vertices.map(key);
        for (a, b) in [(k[0], k[1]), (k[1], k[2]), (k[2], k[0])] {
            *edges.entry((a, b)).or_insert(0) += 1;
        }
    }
    assert!(edges.iter().all(|(&(a, b), &n)| n == 1 && edges.get(&(b, a)) == Some(&1)));
    // Outward normals give a positive volume, that of the plates and the rib without the holes.
    let volume: f64 =
        scene.triangles().iter().map(|t| t.vertices[0].dot(t.vertices[1].cross(t.vertices[2])) / 6.0).sum();
    let hole = 8.0 * 0.018 * 0.018 * (std::f64::consts::TAU / 16.0).sin();
    let expected = 0.24 * 0.2 * 0.02 + 0.24 * 0.02 * 0.22 + 0.5 * 0.12 * 0.18 * 0.02 - 2.0 * hole * 0.02;
    assert!((volume - expected).abs() < 1e-8, "{volume} {expected}");
    // A closed solid is left as often as it is entered, and a bolt hole goes through.
    for k in 0..200 {
        let (s, c) = (f64::from(k) * 0.7).sin_cos();
        let from = 0.5 * (low + high) + DVec3::new(c, s, 0.3 * c);
        let to = 0.5 * (low + high) - DVec3::new(c, 0.9 * s, -0.2 * s);
        assert_eq!(scene.crossings(from, to).len() % 2, 0);
    }
    let through = |x: f64| scene.crossings(DVec3::new(x, -1.0, 0.12), DVec3::new(x, 1.0, 0.12)).len();
    assert_eq!((through(0.065), through(-0.065), through(0.1)), (0, 0, 2));
}

#[test]
fn the_letter_reads_from_the_array_and_is_mirrored_from_behind() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/scenes/f.gltf");
    let hit = |scene: &Scene, x: f64, y: f64, depth: f64| {
        let crossings = scene.crossings(DVec3::new(x, y, 0.0), DVec3::new(x, y, 10.0));
        assert!(crossings.iter().all(|c| (c.distance - depth).abs() < 1e-6));
        !crossings.is_empty()
    };
    let scene = Scene::load(&path, &LoadOptions::default()).unwrap();
    // y points down: the long arm is at the top (y < 0), the stem at the left, nothing at the lower right.
    assert!(hit(&scene, 0.25, -0.4, 2.0) && hit(&scene, -0.2, 0.4, 2.0) && hit(&scene, 0.15, 0.0, 2.0));
    assert!(!hit(&scene, 0.25, 0.0, 2.0) && !hit(&scene, 0.2, 0.4, 2.0));
    assert!(scene.camera().is_none());
    for sensor in ["camera:Behind", "camera:Camera.001", "node:Behind"] {
        let sensor: Sensor = sensor.parse().unwrap();
        let scene = Scene::load(&path, &LoadOptions::default().with_sensor(sensor)).unwrap();
        assert!(hit(&scene, -0.25, -0.4, 3.0) && hit(&scene, 0.2, 0.4, 3.0) && !hit(&scene, -0.2, 0.4, 3.0));
        let camera = scene.camera().unwrap();
        assert!((camera.vertical_field_of_view - 28.6479).abs() < 1e-3);
        assert_eq!(camera.aspect_ratio, Some(1.5));
    }
}
