//! STL files as programs write them, and as they should not be.
#![allow(clippy::unwrap_used)]

use glam::DVec3;

use super::super::fixtures::{clean, load_files, refusal};
use super::super::{LoadOptions, MaterialRule, Scene, Unit, Up};
use crate::error::Result;
use crate::named::assert_names;

fn millimetres() -> LoadOptions {
    LoadOptions::default().with_unit(Unit::Millimetre).with_up(Up::None)
}

fn load_with(bytes: &[u8], options: &LoadOptions) -> (Result<Scene>, String) {
    load_files(&[("part.STL", bytes)], options)
}

fn refused(bytes: &[u8]) -> String {
    refusal(load_with(bytes, &millimetres()), "part.STL")
}

/// A binary file with the right triangle (0, 0), (3, 0), (0, 4) at each of some heights.
fn binary(header: &[u8], heights: &[f32]) -> Vec<u8> {
    let mut bytes = header.to_vec();
    bytes.resize(80, b' ');
    bytes.extend((heights.len() as u32).to_le_bytes());
    for &z in heights {
        // Many programs write no normal, or a wrong one.
        let numbers = [f32::NAN, 0.0, -1.0, 0.0, 0.0, z, 3.0, 0.0, z, 0.0, 4.0, z];
        bytes.extend(numbers.into_iter().flat_map(f32::to_le_bytes));
        bytes.extend([7, 7]);
    }
    bytes
}

fn facet(z: &str) -> String {
    format!(
        "facet normal 0 0 1\n outer loop\n  vertex 0 0 {z}\n  vertex 3 0 {z}\n  vertex 0 4 {z}\n endloop\nendfacet\n"
    )
}

#[test]
fn binary_files_are_read_whatever_their_header_begins_with() {
    for header in [&b""[..], b"solid of SolidWorks", b"solid\n", b"\x00\xff"] {
        let scene = clean(load_with(&binary(header, &[1.0, 2.0]), &millimetres()));
        assert_eq!(scene.triangles().len(), 2);
        assert!((scene.surface_area() - 2.0 * 6e-6).abs() < 1e-15);
        assert_eq!(scene.bounds().unwrap().1, DVec3::new(0.003, 0.004, 0.002));
        // The corners decide which side is which, not the normal that the file gives.
        assert_eq!(scene.triangles()[0].normal(), DVec3::Z);
        assert_eq!((scene.materials().len(), scene.materials()[0].name.as_str()), (1, "unnamed"));
    }
}

#[test]
fn text_may_be_untidy_and_hold_several_solids() {
    let text = format!(
        "\u{feff}  Solid front pänel\r\n{}ENDSOLID front pänel\r\nsolid back\n{}endsolid\n",
        facet("1").replace('\n', "\r\n").to_uppercase(),
        facet("2e0").replace('\n', " ")
    );
    let rule = MaterialRule { name: "b*".into(), reflectance: Some(0.5), ..MaterialRule::default() };
    let options = LoadOptions { materials: vec![rule], ..millimetres() };
    let scene = clean(load_with(text.as_bytes(), &options));
    assert_eq!(scene.triangles().len(), 2);
    let names: Vec<_> = scene.materials().iter().map(|m| (m.name.as_str(), m.reflectance)).collect();
    assert_eq!(names, [("front pänel", 1.0), ("back", 0.5)]);
    assert_eq!(scene.bounds().unwrap().0, DVec3::new(0.0, 0.0, 0.001));
}

#[test]
fn a_unit_is_needed_and_there_is_no_sensor() {
    let file = binary(b"", &[1.0]);
    let unitless = load_with(&file, &LoadOptions::default()).0.unwrap_err().to_string();
    assert_names(unitless, &["part.STL", "unit", "--unit"]);
    let options = LoadOptions { sensor: Some("camera:a".parse().unwrap()), up: None, ..millimetres() };
    assert_names(load_with(&file, &options).0.unwrap_err().to_string(), &["part.STL", "an STL", "camera"]);
}

#[test]
fn lengths_that_do_not_fit_are_noticed() {
    let whole = binary(b"", &[1.0, 2.0, 3.0]);
    for length in 0..whole.len() {
        let message = refused(&whole[..length]);
        assert!(message.contains("not an STL") || message.contains("cut"), "{length}: {message}");
    }
    assert_names(refused(&whole[..200]), &["2", "3 triangles", "header"]);
    let (scene, warnings) = load_with(&[&whole[..], b"tail"].concat(), &millimetres());
    assert_eq!(scene.unwrap().triangles().len(), 3);
    assert_names(warnings, &["part.STL", "4 bytes", "3 triangles"]);
    assert_names(refused(b""), &["part.STL", "0 bytes"]);
    let mut endless = binary(b"", &[]);
    endless[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    assert_names(refused(&endless), &["0", "4294967295 triangles"]);
    assert_names(refused(&binary(b"", &[])), &["part.STL", "triangle"]);
    assert_names(refused(&binary(b"", &[1.0, f32::INFINITY])), &["part.STL", "triangle 1", "finite"]);
}

#[test]
fn mistakes_in_text_name_their_line() {
    let good = format!("solid a\n{}endsolid a\n", facet("1"));
    let changed = |from: &str, to: &str| refused(good.replacen(from, to, 1).as_bytes());
    for (from, to, words) in [
        ("vertex 3 0 1", "vertex 3 0", &["line 5", "`vertex 3 0`"][..]),
        ("vertex 3 0 1", "vertex 3,0 0 1", &["line 5", "`vertex 3,0 0 1`"]),
        ("vertex 3 0 1", "vertex 3 nan 1", &["line 5", "`vertex 3 nan 1`"]),
        ("vertex 3 0 1", "", &["line 7", "2 corners"]),
        ("outer loop", "inner loop", &["line 3", "`inner`"]),
        ("endfacet", "facet", &["line 8", "facet"]),
    ] {
        assert_names(changed(from, to), words);
    }
    assert_names(refused(b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n"), &["part.STL", "facet"]);
    assert_names(refused(b"solid a\nendsolid a\n"), &["part.STL", "triangle"]);
    let (scene, warnings) = load_with(good.trim_end_matches("endsolid a\n").as_bytes(), &millimetres());
    assert!(scene.is_ok());
    assert_names(warnings, &["part.STL", "`endsolid`"]);
    // Characters of several bytes at places where words are cut.
    assert_names(refused("solid\nloop\u{3000}solid é\nloop\u{3000}é".as_bytes()), &["line 3", "`é`"]);
}
