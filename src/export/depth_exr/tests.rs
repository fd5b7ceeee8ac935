#![allow(clippy::unwrap_used)]

use super::*;
use crate::named::assert_names;
use exr::prelude as ex;
use exr::prelude::WritableImage;

const LIMIT: u64 = 1 << 24;
const NAN: f32 = f32::NAN;

fn map() -> DepthMap {
    let near = DepthLayer {
        depth: vec![1.5, NAN, 2.25, 0.1, NAN, 3.0],
        strength: vec![0.25, 0.0, 0.5, 2.0, 0.0, 0.125],
        material: Some(vec![2, 0, 1, 1, 0, 2]),
        confidence: Some(vec![7.0, NAN, 4.5, 31.0, NAN, -2.0]),
        ..DepthLayer::default()
    };
    let far = DepthLayer {
        depth: vec![NAN, NAN, 2.5, 10.0, NAN, NAN],
        strength: vec![0.0, 0.0, 0.375, 1.0, 0.0, 0.0],
        material: Some(vec![0, 0, 2, 2, 0, 0]),
        ..DepthLayer::default()
    };
    DepthMap {
        view: View::Orthographic,
        x: Axis { first: -0.1, pitch: 0.1, count: 3 },
        y: Axis { first: 0.3, pitch: 0.07, count: 2 },
        picked: DepthLayer { confidence: None, ..near.clone() },
        confidence: vec![12.0, NAN, 3.5, 30.0, NAN, -1.0],
        returns: vec![near, far],
        materials: vec!["glass, \"clear\" ü".into(), "wall".into()],
    }
}

/// A file of a map, with +∞ where there is no return.
fn written(map: &DepthMap) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("depth.exr");
    write_depth_map(&path, map, Fill::Infinity, &[], Encoding::default()).unwrap();
    (folder, path)
}

/// Equality in which NaN equals itself.
fn same(a: &[f32], b: &[f32]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a == b || (a.is_nan() && b.is_nan()))
}

fn same_surface(a: &DepthLayer, b: &DepthLayer) -> bool {
    let levels = |s: &DepthLayer| s.confidence.clone().unwrap_or_default();
    same(&a.depth, &b.depth)
        && same(&a.strength, &b.strength)
        && a.facing == b.facing
        && a.material == b.material
        && same(&levels(a), &levels(b))
}

fn assert_same(a: &DepthMap, b: &DepthMap) {
    assert_eq!((a.view, a.x, a.y, &a.materials), (b.view, b.x, b.y, &b.materials));
    assert!(same_surface(&a.picked, &b.picked), "{:?}\n{:?}", a.picked, b.picked);
    assert!(same(&a.confidence, &b.confidence));
    assert_eq!(a.returns.len(), b.returns.len());
    assert!(a.returns.iter().zip(&b.returns).all(|(a, b)| same_surface(a, b)));
}

#[test]
fn a_perspective_map_is_read_as_one_and_has_its_window() {
    let camera = Raster::camera(60.0, [3, 2]).unwrap();
    let map = DepthMap { view: camera.view, x: camera.x, y: camera.y, ..map() };
    let (_folder, path) = written(&map);
    let file = read_depth_map(&path, LIMIT).unwrap();
    assert_same(&file.map, &map);
    let header = &read_parts(&path, LIMIT, |_| 0).unwrap().layer_data[0].attributes;
    let width = 2.0 * 30f32.to_radians().tan() * 1.5;
    assert!((header.screen_window_width - width).abs() < 1e-6, "{}", header.screen_window_width);
    assert!(
        matches!(find_attribute(&file.attributes, "sonar:fieldOfViewY"), Some(Attribute::Number(n)) if (n - 60.0).abs() < 1e-9)
    );
    // An id without a name counts as none.
    let beyond = DepthMap { materials: vec!["glass".into()], ..map };
    let (_folder, path) = written(&beyond);
    assert_eq!(read_depth_map(&path, LIMIT).unwrap().map.picked.material.unwrap(), [0, 0, 1, 1, 0, 0]);
}

#[test]
fn a_map_is_read_value_by_value_whatever_the_fill() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("depth.exr");
    let attributes = vec![("sonar:soundSpeed".to_owned(), Attribute::Number(343.0))];
    // 10 m is also a true depth of the map's second return.
    for fill in [Fill::Infinity, Fill::NaN, Fill::Depth(0.0), Fill::Depth(10.0)] {
        write_depth_map(&path, &map(), fill, &attributes, Encoding::default()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let file = read_depth_map(&path, LIMIT).unwrap();
        assert_same(&file.map, &map());
        assert!(file.axes_known);
        assert!(file.attributes.contains(&attributes[0]));
        write_depth_map(&path, &map(), fill, &attributes, Encoding::default()).unwrap();
        assert!(bytes == std::fs::read(&path).unwrap(), "results are bit-identical");
    }
}

#[test]
fn the_picture_is_scaled_and_0_without_a_return() {
    let (_folder, path) = written(&map());
    let parts = read_parts(&path, LIMIT, |_| 0).unwrap().layer_data;
    let channel = |name: &str| floats(&channel_of(&parts[0], name).unwrap().sample_data);
    assert_eq!(channel("G"), [0.125, 0.0, 0.25, 1.0, 0.0, 0.0625]);
    assert_eq!(channel("A"), [1.0, 0.0, 1.0, 1.0, 0.0, 1.0]);
    assert_eq!(channel("Z")[1], f32::INFINITY);
    assert_eq!(channel("range.V")[0], map().range(0) as f32);
    assert_eq!(channel("return2.V"), [0.0, 0.0, 0.1875, 0.5, 0.0, 0.0]);
    assert_eq!(parts[0].attributes.world_to_camera.unwrap()[5], -1.0);
    assert_eq!(parts[0].encoding.compression, ex::Compression::ZIP16);
}

#[test]
fn truth_keeps_its_normals_and_has_no_confidence() {
    let mut truth = map();
    truth.confidence.clear();
    truth.picked.facing = Some(vec![1.0, 0.0, 0.5, 0.25, 0.0, 0.75]);
    truth.returns[0].facing = truth.picked.facing.clone();
    let (_folder, path) = written(&truth);
    assert_same(&read_depth_map(&path, LIMIT).unwrap().map, &truth);
}

#[test]
fn a_map_without_any_return_is_a_valid_file() {
    let mut empty = map();
    empty.picked = DepthLayer::empty(6).unwrap();
    empty.confidence = vec![NAN; 6];
    empty.returns.clear();
    let (_folder, path) = written(&empty);
    assert_same(&read_depth_map(&path, LIMIT).unwrap().map, &empty);
}

/// A file like those of other programs: tiles, a layer's name, none of our attributes.
fn foreign(path: &Path, names: &[&str]) {
    let channels = names
        .iter()
        .map(|&name| {
            let samples = [1.5, 1e10, 0.0, 4.0, f32::INFINITY, f32::NAN].to_vec();
            ex::AnyChannel::new(name, ex::FlatSamples::F32(samples))
        })
        .collect();
    let layer = ex::Layer::new(
        (3, 2),
        ex::LayerAttributes::named("render"),
        ex::Encoding::FAST_LOSSLESS,
        ex::AnyChannels::sort(channels),
    );
    ex::Image::from_layer(layer).write().to_file(path).unwrap();
}

#[test]
fn depths_of_other_programs_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("render.exr");
    for name in ["Z", "ViewLayer.Depth.Z"] {
        foreign(&path, &[name]);
        let file = read_depth_map(&path, LIMIT).unwrap();
        assert!(!file.axes_known);
        assert_eq!(file.map.x, Axis { first: 0.0, pitch: 1.0, count: 3 });
        assert!(same(&file.map.picked.depth, &[1.5, NAN, NAN, 4.0, NAN, NAN]), "{:?}", file.map.picked);
        assert_eq!(file.map.picked.strength, [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        assert!(file.map.confidence.is_empty() && file.map.returns.is_empty());
    }
    for (names, words) in [(&["R"][..], &["channel", "`Z`"][..]), (&["a.Z", "b.Z"], &["layers"])] {
        foreign(&path, names);
        let error = read_depth_map(&path, LIMIT).unwrap_err();
        assert_names(error.to_string(), words);
        assert_eq!(error.exit_status(), 2);
    }
}

#[test]
fn damaged_and_oversized_files_are_input_errors() {
    let (folder, path) = written(&map());
    let error = read_depth_map(&path, 100).unwrap_err();
    assert_names(error.to_string(), &["depth.exr", "100"]);
    assert_eq!(read_depth_map(&folder.path().join("none.exr"), LIMIT).unwrap_err().exit_status(), 2);
    let whole = std::fs::read(&path).unwrap();
    for end in (0..whole.len()).step_by(7) {
        std::fs::write(&path, &whole[..end]).unwrap();
        let error = read_depth_map(&path, LIMIT).unwrap_err();
        assert_eq!(error.exit_status(), 2, "cut at {end}: {error}");
    }
    for at in (0..whole.len()).step_by(3) {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x9d;
        std::fs::write(&path, &damaged).unwrap();
        // Not all damage is noticed, but none may cause a panic.
        let _ = read_depth_map(&path, LIMIT);
    }
}

#[test]
#[should_panic(expected = "one value per pixel")]
fn a_map_whose_fields_disagree_is_a_programmers_error() {
    let mut broken = map();
    broken.picked.strength.pop();
    let _ = write_depth_map(Path::new("never.exr"), &broken, Fill::Infinity, &[], Encoding::default());
}
