//! PLY files in every form, and as they should not be.
#![allow(clippy::unwrap_used)]

use glam::DVec3;

use super::super::fixtures::{clean, load_files, refusal};
use super::super::{LoadOptions, Scene, Unit};
use crate::error::Result;
use crate::named::assert_names;

fn metres() -> LoadOptions {
    LoadOptions::default().with_unit(Unit::Metre)
}

fn load_with(bytes: &[u8], options: &LoadOptions) -> (Result<Scene>, String) {
    load_files(&[("scan.ply", bytes)], options)
}

fn load(bytes: &[u8]) -> Scene {
    clean(load_with(bytes, &metres()))
}

fn refused(bytes: &[u8]) -> String {
    refusal(load_with(bytes, &metres()), "scan.ply")
}

/// A concave face of six corners and area 4, with colours and an unknown element.
const TEXT: &str = "ply\r\nformat ascii 1.0\ncomment made by händ\nobj_info num_cols 3\n\nelement origin 1\n\
                    property list uchar float axes\nelement vertex 6\nproperty double x\nproperty uchar red\n\
                    property float y\nproperty int z\nproperty float alpha\nelement face 1\n\
                    property uchar flags\nproperty list uchar int vertex_indices\nend_header\n\
                    3 1 2 3\n1 9 1 2 0.5\n0 9 1 2 0.5\n0 9 0 2 0.5\n3 9 0 2 0.5\n3 9 1e0 2\n 0.5\n1 9 3 2 0\n\
                    1 6 2 3 4 0 5 1\n";

#[test]
fn text_is_read_past_what_does_not_matter() {
    // Round 0,0; 3,0; 3,1; 1,1; 1,3; 0,1: a strip of 3 x 1 with a triangle on it.
    let scene = load(TEXT.as_bytes());
    assert!((scene.surface_area() - 4.0).abs() < 1e-12, "{}", scene.surface_area());
    assert_eq!(scene.bounds().unwrap(), (DVec3::new(0.0, 0.0, 2.0), DVec3::new(3.0, 3.0, 2.0)));
    assert_eq!(scene.materials()[0].name, "unnamed");
}

/// A rectangle of 2 x 300 as two faces, in either byte order.
fn binary(big: bool) -> Vec<u8> {
    let order = if big { "big" } else { "little" };
    let mut bytes = format!(
        "ply\nformat binary_{order}_endian 1.0\nelement vertex 4\nproperty float64 x\nproperty short y\n\
         property float z\nelement face 2\nproperty list uchar uint vertex_index\nproperty list ushort uchar more\n\
         end_header\n"
    )
    .into_bytes();
    let mut put = |little: &[u8]| {
        let mut word = little.to_vec();
        if big {
            word.reverse();
        }
        bytes.extend(word);
    };
    for (x, y) in [(0.5_f64, 0_i16), (2.5, 0), (2.5, -300), (0.5, -300)] {
        put(&x.to_le_bytes());
        put(&y.to_le_bytes());
        put(&1.5_f32.to_le_bytes());
    }
    for face in [[0_u32, 1, 2], [2, 3, 0]] {
        put(&[3]);
        for index in face {
            put(&index.to_le_bytes());
        }
        put(&2_u16.to_le_bytes());
        put(&[1]);
        put(&[2]);
    }
    bytes
}

#[test]
fn both_byte_orders_are_read_and_their_truncation_noticed() {
    for bytes in [binary(false), binary(true)] {
        let scene = load(&bytes);
        assert_eq!((scene.triangles().len(), scene.surface_area()), (2, 600.0));
        assert_eq!(scene.bounds().unwrap().0, DVec3::new(0.5, -300.0, 1.5));
        for length in 0..bytes.len() {
            let message = refused(&bytes[..length]);
            // An empty file, one that does not say that it is a PLY, or one that ends in the middle.
            let words = ["cut", "empty", "PLY"];
            assert!(words.iter().any(|word| message.contains(word)), "{length}: {message}");
        }
        let (scene, warnings) = load_with(&[&bytes[..], b"tail"].concat(), &metres());
        assert!(scene.is_ok());
        assert_names(warnings, &["scan.ply", "4 bytes"]);
    }
}

#[test]
fn strips_are_wound_alike_and_broken_by_minus_one() {
    let strips = "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\n\
                  element tristrips 1\nproperty list int int vertex_indices\nend_header\n\
                  0 0 1 1 0 1 0 1 1 1 1 1 0 2 1 1 2 1\n9 0 1 2 3 -1 2 3 4 5\n";
    let scene = load(strips.as_bytes());
    assert_eq!((scene.triangles().len(), scene.surface_area()), (4, 2.0));
    assert!(scene.triangles().iter().all(|t| t.normal() == DVec3::Z));
}

#[test]
fn a_unit_is_needed_and_there_is_no_sensor() {
    let unitless = load_with(TEXT.as_bytes(), &LoadOptions::default()).0.unwrap_err().to_string();
    assert_names(unitless, &["scan.ply", "unit", "--unit"]);
    let options = LoadOptions { sensor: Some("node:a".parse().unwrap()), ..metres() };
    let error = load_with(TEXT.as_bytes(), &options).0.unwrap_err().to_string();
    assert_names(error, &["scan.ply", "PLY", "node"]);
}

#[test]
fn mistakes_name_their_place() {
    let changed = |from: &str, to: &str| {
        assert!(TEXT.contains(from), "{from}");
        refused(TEXT.replacen(from, to, 1).as_bytes())
    };
    for (from, to, words) in [
        ("ply\r", "plx\r", &["PLY", "`ply`"][..]),
        ("ascii 1.0", "ascii 2.0", &["line 2", "`ascii 2.0`"]),
        ("format ascii 1.0", "comment", &["line 17", "`format"]),
        ("vertex 6", "vertex many", &["line 8", "`many`", "`vertex`"]),
        ("vertex 6", "vertex -1", &["line 8", "`-1`"]),
        ("property double x", "property half x", &["line 9", "`property half x`"]),
        ("list uchar int vertex", "list uchar vertex", &["line 16", "`property list uchar vertex_indices`"]),
        ("element origin 1", "comment", &["line 7", "`element`"]),
        ("obj_info", "nonsense", &["line 4", "`nonsense num_cols 3`"]),
        ("end_header", "comment", &["line 18", "header"]),
        ("property float y", "property float h", &["property `y`"]),
        ("vertex_indices", "corners", &["`face`", "`vertex_indices`"]),
        ("0.5\n0 9 1", "0.5\nzero 9 1", &["line 20", "vertex 1", "`zero`"]),
        ("0.5\n0 9 1", "0.5\nnan 9 1", &["vertex 1", "finite"]),
        ("\n1 6 2", "\n1 -6 2", &["line 26", "face 0", "`vertex_indices`", "-6"]),
        ("\n1 6 2", "\n1 1e18 2", &["line 27", "face 0"]),
        ("5 1\n", "5 6\n", &["face 0", "vertex 6", "are 6"]),
        ("5 1\n", "5 -1\n", &["face 0", "vertex -1"]),
        ("5 1\n", "5 1.5\n", &["face 0", "vertex 1.5", "whole number"]),
        ("vertex 6", "vertex 99999999999999", &["vertex 7", "cut short"]),
        ("face 1", "face 99999999999999", &["face 1"]),
    ] {
        assert_names(changed(from, to), words);
    }
}

#[test]
fn elements_without_bytes_take_no_time() {
    let empty = "element nothing 18446744073709551615\nelement face 1";
    load(TEXT.replacen("element face 1", empty, 1).as_bytes());
}

#[test]
fn points_without_faces_are_told_from_an_empty_file() {
    let points = TEXT.replacen("face 1", "face 0", 1).replacen("1 6 2 3 4 0 5 1\n", "", 1);
    assert_names(refused(points.as_bytes()), &["6 points", "face"]);
    let empty = "ply\nformat ascii 1.0\nelement vertex 0\nproperty int x\nproperty int y\nproperty int z\nend_header\n";
    assert_names(refused(empty.as_bytes()), &["triangle"]);
    let thin = TEXT.replacen("1 6 2 3 4 0 5 1\n", "1 2 2 3\n", 1);
    assert_names(refused(thin.as_bytes()), &["triangle"]);
}
