//! OBJ files as programs write them, and as they should not be.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;

use glam::DVec3;

use super::super::fixtures::{clean, load_files, refusal};
use super::super::{LoadOptions, MaterialRule, Scene, Unit, Up};
use crate::error::{Error, Result};
use crate::named::assert_names;

const TRIANGLE: &str = "v 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 3\n";

fn metres() -> LoadOptions {
    LoadOptions::default().with_unit(Unit::Metre).with_up(Up::None)
}

/// Loads `obj`, with `files` in its folder; returns the scene and the warnings.
fn load_with(obj: &str, files: &[(&str, &str)], options: &LoadOptions) -> (Result<Scene>, String) {
    load_files(&[files, &[("mesh.obj", obj)]].concat(), options)
}

fn load(obj: &str) -> Scene {
    clean(load_with(obj, &[], &metres()))
}

fn refused(obj: &str) -> String {
    refusal(load_with(obj, &[], &metres()), "mesh.obj")
}

#[test]
fn a_unit_is_needed_and_may_be_in_the_header() {
    let unitless = load_with(TRIANGLE, &[], &LoadOptions::default()).0.unwrap_err().to_string();
    assert_names(unitless, &["mesh.obj", "--unit", "[scene]", "mm (1.00 mm)"]);
    let header = format!("# File units = millimeters\n#  1 unit = 1000.000000 mm\n{TRIANGLE}");
    assert_eq!(clean(load_with(&header, &[], &LoadOptions::default())).surface_area(), 0.5);
    let inches = LoadOptions::default().with_unit(Unit::Inch);
    let (scene, warnings) = load_with(&header, &[], &inches);
    assert!((scene.unwrap().surface_area() - 0.5 * 0.0254 * 0.0254).abs() < 1e-15);
    assert_names(warnings, &["mesh.obj", "`unit`", "1 m", "0.0254 m"]);
    assert_names(refused(&format!("# 1 unit = 3 cubits\n{TRIANGLE}")), &["line 1", "`# 1 unit = 3 cubits`"]);
}

#[test]
fn what_programs_write_is_read() {
    let text = "\u{feff}# made by hand\r\no a b\r\n  g front panel \r\nv 0 0 1 1 0 0 # red\r\nv 1 0 1\r\nv 2 2 2 2\r\n\
                v 0 1 \\\r\n  1\r\nvn 0 0 1\r\nvt 0 0\r\nvt oops\r\nusemtl\tm 1\r\nf 1/9/1 2//1 3/1 \\\r\n -1\r\nl 1 2\r\np 1\r\n";
    let scene = load(text);
    assert_eq!((scene.triangles().len(), scene.surface_area()), (2, 1.0));
    assert_eq!(scene.triangles()[0].normal(), DVec3::Z);
    assert_eq!(scene.materials()[0].name, "m 1");
}

#[test]
fn concave_faces_are_covered_exactly() {
    let l = "v 0 0 1\nv 3 0 1\nv 3 1 1\nv 1 1 1\nv 1 3 1\nv 0 3 1\nf 4 5 6 1 2 3\n";
    assert!((load(l).surface_area() - 5.0).abs() < 1e-12);
    let bow = "v 0 0 1\nv 1 1 1\nv 1 0 1\nv 0 1 1\nf 1 2 3 4\n";
    let (scene, warnings) = load_with(bow, &[], &metres());
    assert!(scene.is_ok());
    assert_names(warnings, &["mesh.obj", "1", "outline"]);
}

#[test]
fn materials_come_from_the_mtl_file_and_rules_override_them() {
    let obj = format!("mtllib a b.mtl\no pane\nusemtl glass\n{TRIANGLE}o wall\nusemtl brick\nf 1 2 3\n");
    let mtl = ("a b.mtl", "newmtl glass\nKd 0.1 0.2\nd 0.4\nnewmtl brick\nd 1\n");
    let (scene, warnings) = load_with(&obj, &[mtl], &metres());
    let scene = scene.unwrap();
    assert_names(warnings, &["mesh.obj", "`glass`", "light", "[[materials]]"]);
    let glass = &scene.materials()[scene.triangles()[0].material as usize];
    assert_eq!(
        (glass.reflectance, glass.transmittance, glass.source.as_str()),
        (0.99, 0.0, "MTL d, as glass")
    );
    assert_eq!((scene.materials()[1].name.as_str(), scene.materials()[1].reflectance), ("brick", 1.0));
    let rule =
        |name: &str| MaterialRule { name: name.into(), reflectance: Some(0.2), ..MaterialRule::default() };
    let options = LoadOptions { materials: vec![rule("wal?"), rule("steel*")], ..metres() };
    let (scene, warnings) = load_with(&obj, &[mtl], &options);
    let wall = &scene.as_ref().unwrap().materials()[1];
    assert_eq!((wall.reflectance, wall.source.as_str()), (0.2, "rule `wal?`"));
    assert_names(warnings, &["rule", "`steel*`", "`glass`"]);
}

#[test]
fn a_missing_mtl_file_is_a_warning_and_names_still_match() {
    let obj = format!("mtllib gone.mtl\nmtllib ../../etc/passwd\nusemtl glass\n{TRIANGLE}");
    let rule = MaterialRule { name: "glass".into(), transmittance: Some(0.5), ..MaterialRule::default() };
    let options = LoadOptions { materials: vec![rule], ..metres() };
    let (scene, warnings) = load_with(&obj, &[], &options);
    assert_eq!(scene.unwrap().materials()[0].transmittance, 0.5);
    assert_names(warnings, &["gone.mtl", "`../../etc/passwd`", "folder"]);
    let bad = load_with(&obj, &[("gone.mtl", "newmtl glass\nd 7\n")], &metres()).0.unwrap_err();
    assert_names(bad.to_string(), &["gone.mtl", "line 2", "`d 7`", "0 to 1"]);
}

#[test]
fn bad_geometry_names_its_place() {
    assert_names(refused("v 0 0\nf 1 1 1"), &["mesh.obj", "line 1", "`v`"]);
    assert_names(refused("v 0 0 0\nv 1 x 0"), &["mesh.obj", "line 2", "`v`"]);
    assert_names(refused("v 0 0 0\n\\\nf a b c"), &["mesh.obj", "line 2", "`f`"]);
    let beyond = refused(&format!("{TRIANGLE}f 1 2 3\nf 1 2 4\n"));
    assert_names(beyond, &["mesh.obj", "line 6", "corner 4", "3 vertices"]);
    assert_names(refused(&format!("{TRIANGLE}f 0 1 2\n")), &["line 5", "corner 0"]);
    assert_names(refused(&format!("{TRIANGLE}f -9 1 2\n")), &["line 5", "corner -9"]);
    let overflow = "f 1/9223372036854775807/9223372036854775807 2/-9223372036854775808 3\n";
    assert_eq!(load(&format!("{TRIANGLE}{overflow}")).triangles().len(), 2);
    for bad in ["nan", "inf", "1e999"] {
        let message = refused(&format!("o the nose\nv 0 0 {bad}\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"));
        assert_names(message, &["mesh.obj", "object", "`the nose`", "vertex"]);
    }
    let far = refused("v 0 0 2e9\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    assert_names(far, &["mesh.obj", "triangle 0", "1e9 m"]);
}

#[test]
fn nothing_to_image_is_an_error_and_flat_triangles_are_left_out() {
    for empty in ["", "# nothing\n", "v 0 0 0\nv 1 0 0\nf 1 2\nf\n", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n"] {
        assert_names(refused(empty), &["mesh.obj", "triangle"]);
    }
    let (scene, warnings) = load_with(&format!("{TRIANGLE}f 1 1 2\nf 2 3 3\n"), &[], &metres());
    assert_eq!(scene.unwrap().triangles().len(), 1);
    assert_names(warnings, &["mesh.obj", "2", "3 triangles", "area"]);
}

#[test]
fn folders_missing_files_and_other_formats_are_refused() {
    let refused = |path: &Path| Scene::load(path, &metres()).unwrap_err();
    let folder = tempfile::tempdir().unwrap();
    assert_names(refused(&folder.path().join("a.obj")).to_string(), &["a.obj", "file"]);
    let unknown = refused(&folder.path().join("a.step")).to_string();
    assert_names(unknown, &["a.step", ".obj", ".gltf", ".glb", ".stl", ".ply"]);
    let named = folder.path().join("b.obj");
    fs::create_dir(&named).unwrap();
    assert_names(refused(&named).to_string(), &["b.obj", "folder"]);
    let options = LoadOptions { sensor: Some("node:a".parse().unwrap()), up: None, ..metres() };
    let error = load_with(TRIANGLE, &[], &options).0.unwrap_err();
    assert!(matches!(error, Error::InvalidInput { .. }));
    assert_names(error.to_string(), &["mesh.obj", "OBJ", "glTF"]);
}

#[test]
fn damaged_text_gives_an_error_or_a_scene_but_never_a_panic() {
    let good = "mtllib m.mtl\no a\nusemtl g\nv 0 0 1\nv 1 0 1\nv 1 1 1 1\nv .5 .2 1\nf 1/1/1 2//2 3 4\nusemtl h\nf -3 -2 -1\n";
    let spare = b"0123456789-/.\\ \n#vfeognaui\xff";
    let mut state = 1_u64;
    for _ in 0..400 {
        let mut bytes = good.as_bytes().to_vec();
        for _ in 0..4 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let (at, with) = ((state >> 33) as usize % bytes.len(), (state >> 20) as usize % spare.len());
            bytes[at] = spare[with];
        }
        let text = String::from_utf8_lossy(&bytes);
        let _ = load_with(&text, &[("m.mtl", &text)], &metres());
    }
}

#[test]
fn text_may_be_utf_16_and_a_bad_number_is_quoted() {
    for (mark, bytes_of) in
        [([0xff, 0xfe], u16::to_le_bytes as fn(u16) -> [u8; 2]), ([0xfe, 0xff], u16::to_be_bytes)]
    {
        let text = format!("# Würfel 悪\r\n{TRIANGLE}");
        let bytes: Vec<u8> = text.encode_utf16().flat_map(bytes_of).collect();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("wide.obj");
        fs::write(&path, [&mark[..], &bytes].concat()).unwrap();
        assert_eq!(Scene::load(&path, &metres()).unwrap().surface_area(), 0.5);
    }
    assert_names(refused("v 0 0 1\nv 1 O.5 1\n"), &["line 2", "three numbers", "`O.5`"]);
    assert_names(refused("v 0 0 1\nv 1 0\n"), &["line 2", "three numbers"]);
    assert_names(refused("v 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 drei\n"), &["line 4", "`f 1 2 3`", "`drei`"]);
}
