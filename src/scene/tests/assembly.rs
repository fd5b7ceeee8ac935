//! Scenes of several files: places, names, materials, limits.
#![allow(clippy::unwrap_used)]

use super::{BYTES_PER_TRIANGLE, CommonMaterial, LoadOptions, MaterialRule, PartFile, Scene, Unit, Up};
use crate::error::Result;
use crate::named::{Warnings, assert_names};
use glam::DVec3;
use std::path::Path;

/// A square with corners at 0 and 1 in the plane z = 0, of two objects with materials of their own.
const SQUARE: &str =
    "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\no lower\nusemtl steel\nf 1 2 3\no upper\nusemtl rubber\nf 1 3 4\n";
const TRIANGLE: &str = "solid t\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0 0 2\nvertex 2 0 0\nendloop\nendfacet\nendsolid t\n";

fn part(folder: &Path, (file, name): (&str, &str), options: LoadOptions) -> PartFile {
    PartFile { path: folder.join(file), name: name.to_owned(), options, material: None }
}

/// An OBJ square of 20 cm, and an STL triangle of 20 mm, 1 m further right.
fn parts(folder: &Path) -> [PartFile; 2] {
    std::fs::write(folder.join("square.obj"), SQUARE).unwrap();
    std::fs::write(folder.join("triangle.stl"), TRIANGLE).unwrap();
    let options = LoadOptions::default;
    let shift = options().with_unit(Unit::Centimetre).with_translate(DVec3::X);
    [
        part(folder, ("square.obj", "board"), options().with_size(0.2).with_up(Up::None)),
        part(folder, ("triangle.stl", "fin"), shift),
    ]
}

fn assembled(parts: &[PartFile], options: &LoadOptions) -> (Result<Scene>, Vec<String>) {
    let warnings = Warnings::default();
    let scene = Scene::assemble(parts, options, &warnings);
    (scene, warnings.list())
}

#[test]
fn every_part_has_its_own_place_and_all_move_together() {
    let folder = tempfile::tempdir().unwrap();
    let parts = parts(folder.path());
    let (scene, warnings) = assembled(&parts, &LoadOptions::default());
    let scene = scene.unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    let named: Vec<_> = scene.parts().iter().map(|p| (p.name.as_str(), p.triangles.clone())).collect();
    assert_eq!(named, [("board", 0..2), ("fin", 2..3)]);
    // STL has z up: its third coordinate is up in the array's frame, where y points down.
    let (low, high) = scene.bounds().unwrap();
    assert!((low - DVec3::new(0.0, -0.02, 0.0)).length() < 1e-12, "{low}");
    assert!((high - DVec3::new(1.02, 0.2, 0.0)).length() < 1e-12, "{high}");
    let whole = LoadOptions::default().with_scale(0.5).with_rotate(DVec3::Z * 90.0).with_fit(DVec3::Z);
    let (low, high) = assembled(&parts, &whole).0.unwrap().bounds().unwrap();
    assert!((low + high - 2.0 * DVec3::Z).length() < 1e-12);
    assert!((high - low - DVec3::new(0.11, 0.51, 0.0)).length() < 1e-12, "{}", high - low);
}

#[test]
fn materials_are_named_after_parts_and_rules_find_them_by_those_names() {
    let folder = tempfile::tempdir().unwrap();
    let [board, fin] = parts(folder.path());
    let fin = PartFile { material: Some(CommonMaterial::Glass), ..fin };
    let rule = |name: &str| MaterialRule {
        name: name.to_owned(),
        transmittance: Some(0.25),
        ..MaterialRule::default()
    };
    let shares = |rules: &[MaterialRule]| {
        let (scene, warnings) =
            assembled(&[board.clone(), fin.clone()], &LoadOptions::default().with_materials(rules));
        let scene = scene.unwrap();
        let of = |triangle: usize| &scene.materials()[scene.triangles()[triangle].material as usize];
        let named = [0, 1, 2].map(|i| (of(i).name.clone(), of(i).reflectance, of(i).transmittance));
        (named, warnings.join("\n"), of(2).source.clone())
    };
    let named = |name: &str, reflectance, transmittance| (name.to_owned(), reflectance, transmittance);
    let (materials, warnings, source) = shares(&[]);
    assert_eq!(
        materials,
        [named("board/steel", 1.0, 0.0), named("board/rubber", 1.0, 0.0), named("fin", 0.99, 0.0)]
    );
    assert_names(&warnings, &[]);
    assert_names(&source, &["glass", "part"]);
    // A rule comes before the part's own material, and may name either a part or a material of a file.
    let (materials, ..) = shares(&[rule("fin"), rule("rubber")]);
    assert_eq!([materials[0].2, materials[1].2, materials[2].2], [0.0, 0.25, 0.25]);
    let (_, warnings, _) = shares(&[rule("keel")]);
    assert_names(&warnings, &["[[scene.parts]]", "`keel`", "`board`", "`fin`", "`steel`"]);
}

#[test]
fn faults_name_the_part_and_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let [board, fin] = parts(folder.path());
    let refused = |parts: &[PartFile], options: &LoadOptions| {
        let error = assembled(parts, options).0.unwrap_err();
        assert_eq!(error.exit_status(), 2, "{error}");
        error.to_string()
    };
    let options = LoadOptions::default();
    let with = |options| PartFile { options, ..fin.clone() };
    let unitless = refused(&[board.clone(), with(options.clone())], &options);
    assert_names(unitless, &["part `fin`", "triangle.stl", "--size"]);
    let zero = refused(&[with(options.clone().with_scale(0.0))], &options);
    assert_names(zero, &["part `fin`", "scale", "0"]);
    let far = with(options.clone().with_unit(Unit::Metre).with_scale(1e10));
    assert_names(refused(&[board.clone(), far], &options), &["[[scene.parts]]", "triangle 2", "scale"]);
    std::fs::write(folder.path().join("square.obj"), "v 0 0 x\nf 1 1 1\n").unwrap();
    assert_names(refused(&[board], &options), &["part `board`", "square.obj", "line 1", "`x`"]);
    for options in [options.clone().with_unit(Unit::Metre), options.with_up(Up::Y)] {
        assert_names(refused(&[], &options), &["parts", "each"]);
    }
}

#[test]
fn the_memory_limit_is_that_of_all_parts() {
    let folder = tempfile::tempdir().unwrap();
    let parts = parts(folder.path());
    let limited = |triangles: u64| {
        let bytes = triangles * BYTES_PER_TRIANGLE;
        assembled(&parts, &LoadOptions::default().with_memory(bytes)).0
    };
    assert_eq!(limited(3).unwrap().triangles().len(), 3);
    assert_names(limited(2).unwrap_err().to_string(), &["part `fin`", "memory"]);
}

#[test]
fn the_parts_of_one_file_are_its_objects() {
    let folder = tempfile::tempdir().unwrap();
    let [board, fin] = parts(folder.path());
    let names = |part: &PartFile| {
        let scene = Scene::load(&part.path, &part.options).unwrap();
        let covered: usize = scene.parts().iter().map(|part| part.triangles.len()).sum();
        assert_eq!(covered, scene.triangles().len());
        scene.parts().iter().map(|part| part.name.clone()).collect::<Vec<_>>()
    };
    assert_eq!((names(&board), names(&fin)), (vec!["lower".into(), "upper".into()], vec!["t".to_owned()]));
    std::fs::write(&board.path, "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\no\nf 1 2 3\n").unwrap();
    assert_eq!(names(&board), ["square"], "the file's name for what has none");
}
