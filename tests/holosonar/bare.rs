//! Meshes without a run file: where they go, before which array, and what is said about it.

use crate::bare_kinds::Mesh;
use crate::binary::{done, done_json, json_file, refused, run};
use crate::named::assert_names;
use holosonar::glam::DVec3;
use holosonar::pipeline::BareMesh;
use holosonar::progress::Silent;
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

/// A lamp of three boxes, 30 units wide and 50 high: a foot, a pole and a shade to one side. As OBJ with y up, and as STL with
/// z up.
const BOXES: [[[f64; 3]; 2]; 3] = [
    [[-15.0, 0.0, -15.0], [15.0, 6.0, 15.0]],
    [[-3.0, 6.0, -3.0], [3.0, 50.0, 3.0]],
    [[3.0, 36.0, -6.0], [15.0, 50.0, 6.0]],
];

/// Corners of a face of the unit cube, seen from outside counterclockwise.
pub(crate) const FACES: [[usize; 4]; 6] =
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];

/// Of the box between two corners, all eight.
pub(crate) fn corners(ends: &[[f64; 3]; 2]) -> [[f64; 3]; 8] {
    std::array::from_fn(|i| std::array::from_fn(|k| ends[(i >> k) & 1][k]))
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut stl = "solid lamp\n".to_owned();
    for ends in &BOXES {
        let corners = corners(ends);
        for face in FACES {
            for triangle in [[0, 1, 2], [0, 2, 3]] {
                stl += "facet normal 0 0 0\nouter loop\n";
                for [x, y, z] in triangle.map(|k| corners[face[k]]) {
                    let _ = writeln!(stl, "vertex {x} {} {y}", -z);
                }
                stl += "endloop\nendfacet\n";
            }
        }
    }
    fs::write(folder.path().join("lamp.obj"), Mesh::boxes(&BOXES).obj()).unwrap();
    fs::write(folder.path().join("lamp.stl"), stl + "endsolid\n").unwrap();
    fs::write(folder.path().join("plate.obj"), "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 4 3 2\n").unwrap();
    folder
}

fn loaded(path: &Path, overrides: &[&str]) -> BareMesh {
    let overrides: Vec<String> = overrides.iter().map(ToString::to_string).collect();
    BareMesh::load(path, &overrides, None, &Silent).unwrap()
}

#[test]
fn a_mesh_stands_upright_before_an_array_of_its_size() {
    let folder = folder();
    for name in ["lamp.obj", "lamp.stl"] {
        let bare = loaded(&folder.path().join(name), &["scene.unit=cm"]);
        let (low, high) = bare.scene.bounds().unwrap();
        // The foot is down, where y is larger, and the shade to the right.
        assert!((high - low - DVec3::new(0.3, 0.5, 0.3)).length() < 1e-9, "{name}: {low} {high}");
        let at_the_foot =
            bare.scene.triangles().iter().flat_map(|t| t.vertices).filter(|v| v.y > high.y - 0.07);
        let widest = at_the_foot.map(|v| v.x.abs()).fold(0.0, f64::max);
        assert!((widest - 0.15).abs() < 1e-9, "{name}: {widest}");
        let shade = bare.scene.triangles().iter().flat_map(|t| t.vertices).filter(|v| v.y < high.y - 0.4);
        assert!(shade.map(|v| v.x).fold(0.0, f64::min) > -0.04, "{name}");
        let (array, diagonal) = (bare.run.microphones().unwrap(), (high - low).length());
        assert!((array.extent().x - 1.8 * diagonal).abs() < 0.01 && array.len() == 101 * 101);
        assert!((0.5 * (low.z + high.z) - 0.9 * diagonal).abs() < 0.002);
        assert!(bare.hints.is_empty(), "{:?}", bare.hints);
    }
}

#[test]
fn a_picture_of_a_mesh_is_good_and_its_run_file_makes_the_same() {
    let folder = folder();
    let path = folder.path();
    let report = done_json(path, "image lamp.obj --size 50cm -o bare");
    let metric = |name: &str| report["metrics"][name].as_f64().unwrap();
    assert!(metric("completeness") > 0.95 && metric("audible_completeness") > 0.95, "{}", report["metrics"]);
    assert!(metric("false_returns") < 0.02 && metric("outside_returns") < 0.17, "{}", report["metrics"]);
    assert_eq!(report["scene"]["up"], "y");
    assert!(report["scene"]["resolution_cells"][1].as_f64().unwrap() > 15.0);
    done(path, "init --mesh lamp.obj --size 50cm .");
    done(path, "image lamp.toml -o typed --quiet");
    for file in ["depth.exr", "volume.npz", "truth.exr"] {
        let read = |folder: &str| fs::read(path.join(folder).join(file)).unwrap();
        assert!(read("bare") == read("typed"), "{file} differs");
    }
    refused(path, "init --mesh lamp.obj --size 50cm .", 2, &["lamp.toml", "overwritten"]);
    // Elsewhere the run file names the mesh by its whole path.
    done(path, "init --mesh lamp.obj --unit mm --scale 10 --rotate 0,-30,0 sub/folder");
    let planned = done_json(&path.join("sub"), "plan folder/lamp.toml");
    assert_eq!(planned["grid"], done_json(path, "plan lamp.obj --unit cm --rotate 0,-30,0")["grid"]);
}

#[test]
fn a_mesh_of_any_size_is_within_its_grid_and_takes_seconds() {
    let folder = folder();
    let path = folder.path();
    for (size, cells) in [
        (0.0017, [0.0, 0.2]),
        (0.02, [1.0, 2.0]),
        (0.5, [30.0, 60.0]),
        (2.0, [60.0, 90.0]),
        (30.0, [60.0, 110.0]),
    ] {
        let planned = done_json(path, &format!("plan lamp.obj --size {size}"));
        let across = planned["resolution_cells"][1].as_f64().unwrap();
        assert!((cells[0]..cells[1]).contains(&across), "{size} m: {across} cells");
        let voxels: f64 =
            ["x", "y", "z"].map(|k| planned["grid"][k]["count"].as_f64().unwrap()).iter().product();
        assert!(voxels <= 5e6, "{size} m: {voxels} voxels");
        let bare = loaded(&path.join("lamp.obj"), &[&format!("scene.size={size:?}")]);
        let (low, high) = bare.scene.bounds().unwrap();
        for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
            let number = |name: &str| planned["grid"][axis][name].as_f64().unwrap();
            let last = number("first") + number("pitch") * (number("count") - 1.0);
            assert!(number("first") <= low[k] && last + number("pitch") >= high[k], "{size} m, {axis}");
        }
    }
    let warned = |words: &str| {
        let ran = run(path, words);
        assert_eq!(ran.status, 0, "{words}: {}", ran.stderr);
        ran.stderr
    };
    assert_names(warned("plan lamp.obj --size 1.7mm"), &["wavelength", "--scale 294"]);
    assert_names(warned("plan lamp.obj --size 40mm"), &["resolution cells", "--scale"]);
    let large = warned("plan lamp.obj --size 743m");
    assert_names(&large, &["with a band of", "--scale 2.7e-3", "voxels of"]);
    assert!(!large.contains("unambiguous"), "the step leaves its paths unambiguous: {large}");
    // The array suits a lamp of half a metre, so there is no warning.
    assert_eq!(warned("plan lamp.obj --size 50cm"), "");
    assert!(warned("image lamp.obj --size 1.7mm -o small").contains("wavelength"));
}

#[test]
fn a_large_mesh_is_seen_with_a_narrower_band_unless_one_is_typed() {
    let folder = folder();
    let path = folder.path().join("lamp.obj");
    let size = |size: f64, typed: &[&str]| {
        let size = format!("scene.size={size:?}");
        loaded(&path, &[&[size.as_str()], typed].concat())
    };
    for small in [0.02, 0.5, 2.0] {
        let bare = size(small, &[]);
        assert_eq!((bare.run.sweep.start, bare.run.sweep.stop), (10e3, 20e3), "{small} m");
        assert!(!bare.hints.iter().any(|hint| hint.contains("band")), "{:?}", bare.hints);
    }
    let mut narrowest = 10e3;
    for large in [30.0, 743.0, 1.5e3] {
        let bare = size(large, &[]);
        let (sweep, instrument) = (&bare.run.sweep, bare.run.instrument().unwrap());
        let band = sweep.stop - sweep.start;
        assert!(band < narrowest && sweep.stop == 20e3, "{large} m: {sweep:?}");
        narrowest = band;
        assert!(instrument.sweep.len() <= 5001, "{large} m: {sweep:?}");
        // Voxels without wide gaps, and no two paths that are taken for one another.
        let grid = bare.run.voxels(&instrument, None).unwrap();
        let cells = instrument.lateral_resolution(0.5 * (grid.z.first + grid.z.last()));
        assert!(grid.x.pitch < 1.6 * cells[0].unwrap(), "{large} m");
        let paths = instrument.ambiguous_length(instrument.path_bounds(&grid));
        assert!(instrument.unambiguous_path().unwrap() >= paths, "{large} m: {sweep:?}");
        let hint = bare.hints.iter().find(|hint| hint.contains("with a band of")).unwrap();
        assert_names(hint, &["Hz", "in depth", "--set sweep.start=10000"]);
    }
    // A narrower band is of no use to arrays that resolve nothing, or so much across that there are few planes anyway.
    for array in [&["array.count=1"][..], &["array.extent=60", "array.count=401"]] {
        let bare = size(30.0, array);
        let planes = bare.run.voxels(&bare.run.instrument().unwrap(), None).unwrap().z.count;
        assert!(bare.run.sweep.start == 10e3 || planes > 50, "{array:?}: {:?}, {planes}", bare.run.sweep);
    }
    assert_eq!(size(30.0, &["array.count=1"]).run.sweep.start, 10e3);
    // Nor kilometres away, where it takes too much memory.
    assert_eq!(size(24e3, &[]).run.sweep.start, 10e3);
    let typed = size(30.0, &["sweep.start=10000"]);
    assert_eq!(typed.run.sweep.start, 10e3);
    assert!(!typed.hints.iter().any(|hint| hint.contains("with a band of")), "{:?}", typed.hints);
}

#[test]
fn what_is_typed_wins() {
    let folder = folder();
    let path = folder.path().join("lamp.obj");
    let cm = "scene.unit=cm";
    let wide = loaded(&path, &[cm, "array.extent=1.5", "array.count=21"]);
    let array = wide.run.microphones().unwrap();
    assert!((array.extent().x - 1.5).abs() < 1e-12 && array.len() == 441);
    let middle = |bare: &BareMesh| {
        let (low, high) = bare.scene.bounds().unwrap();
        0.5 * (low + high)
    };
    assert!((middle(&wide) - DVec3::Z * (0.5 * 1.5)).length() < 1e-9);
    let there = loaded(&path, &[cm, "scene.fit=[0.1,0,3]"]);
    assert!((middle(&there) - DVec3::new(0.1, 0.0, 3.0)).length() < 1e-9);
    assert_eq!(there.run.scene.fit, Some([0.1, 0.0, 3.0]));
    let kept = loaded(&path, &[cm, "scene.translate=[0,0,2]"]);
    assert!((middle(&kept) - DVec3::new(0.0, -0.25, 2.0)).length() < 1e-9, "{}", middle(&kept));
    let coarse = loaded(&path, &[cm, "grid.pitch=[0.05,0.05,0.05]", "grid.x=[-0.2,0.2]", "sweep.step=40"]);
    assert_eq!((coarse.run.grid.x, coarse.run.sweep.step), (Some([-0.2, 0.2]), 40.0));
    assert_eq!(coarse.run.grid.pitch, Some([0.05; 3]));
    // A sweep of designs compares arrays before a mesh that stays in its place.
    let swept = done_json(folder.path(), "plan lamp.obj --unit cm --sweep array.extent=0.5,1");
    let widths = [0, 1].map(|k| swept["combinations"][k]["design"]["widths"][1].as_f64().unwrap());
    // Twice as wide an array from the same place resolves about twice as finely.
    assert!((1.5..2.3).contains(&(widths[0] / widths[1])), "{widths:?}");
    fs::write(folder.path().join("mics.csv"), "x,y,z\n-0.3,0,0\n0.3,0,0\n0,0.3,0\n").unwrap();
    let file =
        done_json(folder.path(), "plan lamp.obj --unit cm --set array.layout=file --set array.file=mics.csv");
    assert_eq!(file["plan"]["microphones"], 3);
}

#[test]
fn a_preview_shows_the_mesh_before_the_array() {
    let folder = folder();
    let path = folder.path();
    done(path, "truth lamp.obj --size 50cm -o front.png");
    done(path, "truth lamp.obj --size 50cm --rotate 0,0,180 -o head.png");
    let ink = |name: &str| {
        let decoder = png::Decoder::new(std::io::BufReader::new(fs::File::open(path.join(name)).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        let mut indices = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut indices).unwrap();
        let palette = reader.info().palette.clone().unwrap();
        let grey = |index: &u8| {
            let [r, g, b] = std::array::from_fn(|k| palette[3 * *index as usize + k]);
            // What faces the array is lighter than where nothing is.
            r > 225 && r == g && g == b
        };
        // Well within the map, which has titles above, axes below and a colour bar beside it.
        let (width, height) = (info.width as usize, info.height as usize);
        let map = |row: &[u8]| row[width / 5..width * 7 / 10].iter().filter(|i| grey(i)).count();
        let rows = indices.chunks_exact(width).skip(height / 5).take(height * 6 / 10).map(map);
        rows.collect::<Vec<usize>>()
    };
    let half = |rows: &[usize]| {
        let (top, bottom) = rows.split_at(rows.len() / 2);
        [top, bottom].map(|rows| rows.iter().sum::<usize>())
    };
    let ([a, b], [c, d]) = (half(&ink("front.png")), half(&ink("head.png")));
    assert!(a + b > 1000 && c + d > 1000, "{a} {b} {c} {d}");
    assert!((a > b) != (c > d), "on its head it is the other way up: {a} {b} {c} {d}");
    refused(path, "truth lamp.obj --size 50cm -o front.jpg", 2, &["front.jpg", ".png"]);
}

#[test]
fn hints_tell_a_back_and_a_flat_side() {
    let folder = folder();
    let path = folder.path().join("plate.obj");
    let hint = |overrides: &[&str]| loaded(&path, overrides).hints.join(" ");
    assert_names(hint(&["scene.unit=m"]), &["backs", "--rotate 0,180,0"]);
    assert_names(hint(&["scene.unit=m", "scene.rotate=[0,180,0]"]), &["one flat side", "--rotate 25,35,0"]);
    let warned = run(folder.path(), "image plate.obj --size 0.2m -o out --set array.count=15").stderr;
    assert_names(warned, &["backs of faces"]);
    let warnings = json_file(&folder.path().join("out/report.json"))["warnings"].to_string();
    assert!(warnings.contains("backs of faces"), "{warnings}");
}

#[test]
fn info_needs_no_unit_and_mistakes_are_named() {
    let folder = folder();
    let path = folder.path();
    let facts = done_json(path, "info lamp.stl");
    assert_eq!((&facts["up"], &facts["up_is_default"]), (&"z".into(), &true.into()));
    assert_eq!(facts["size_in_file_units"], serde_json::json!([30.0, 30.0, 50.0]));
    assert_eq!(facts["size_by_unit"]["--unit cm"], "30.0 cm x 30.0 cm x 50.0 cm");
    assert!(facts["size_m"].is_null() && done(path, "info lamp.stl").contains("--unit mm"));
    assert_eq!(done_json(path, "info lamp.stl --unit cm")["size_m"][1], 0.5);
    refused(
        path,
        "image lamp.obj -o out",
        2,
        &["lamp.obj", "--unit", "mm (50.0 mm)", "cm (50.0 cm)", "--size 0.5m"],
    );
    for (words, named) in [
        ("--size 5apples", &["--size 5apples", "30cm"][..]),
        ("--size 0.5m --unit mm", &["size", "unit", "scale"]),
        ("--unit mm --up w", &["up", "\"w\"", "\"z\"", "\"none\""]),
        ("--unit mm --rotate 10,20", &["scene.rotate=[10,20]", "3"]),
        ("--unit mm --scale 0", &["scene.scale=0", "greater than 0"]),
        ("--unit mm --fit 0,0,-2", &["[scene]", "behind the array"]),
    ] {
        refused(path, &format!("image lamp.obj -o out {words}"), 2, named);
    }
    refused(path, "init --up y", 2, &["--mesh"]);
    refused(path, "init --mesh gone.obj --unit m", 2, &["gone.obj", "no such file"]);
    refused(path, "init --mesh mics.csv", 2, &["mics.csv", "mesh"]);
    assert!(!path.join("out").exists() && !path.join("gone.toml").exists());
}
