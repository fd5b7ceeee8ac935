#![allow(clippy::unwrap_used)]

use super::*;
use crate::acquisition::MicArray;
use crate::grid::{Axis, DepthLayer, Grid, Raster, View, Volume};
use crate::scene::{Material, Scene, Triangle};
use glam::DVec3;
use num_complex::Complex32;

fn axis(first: f64, pitch: f64, count: usize) -> Axis {
    Axis { first, pitch, count }
}

fn map(columns: usize, rows: usize) -> DepthMap {
    let depth =
        (0..columns * rows).map(|i| if i % 3 == 0 { f32::NAN } else { 1.0 + i as f32 * 1e-3 }).collect();
    let picked = DepthLayer { depth, strength: vec![1.0; columns * rows], ..DepthLayer::default() };
    let (x, y) = (axis(-0.5, 0.1, columns), axis(-0.25, 0.1, rows));
    DepthMap::new(Raster { view: View::Orthographic, x, y }, picked)
}

fn page(contents: &Contents, title: &str, report: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.html");
    Page::new(contents).unwrap().write(&path, title, report).unwrap();
    std::fs::read_to_string(path).unwrap()
}

/// The JSON of a script element.
fn json_of(page: &str, id: &str) -> Value {
    let start = format!("id=\"{id}\">");
    let rest = &page[page.find(&start).unwrap() + start.len()..];
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

#[test]
fn a_page_is_complete_and_loads_nothing() {
    let grid = Grid { x: axis(-0.5, 0.1, 4), y: axis(-0.25, 0.1, 3), z: axis(1.0, 0.1, 2) };
    let volume = Miniature::of_volume(&Volume::new(grid, vec![Complex32::ONE; 24]));
    let array = MicArray::rectangular([2, 2], [0.5, 0.5], DVec3::ZERO).unwrap();
    let scene = ScenePoints::new(None, &array, &[]).with_bounces(&[(DVec3::Z, 0.5)]);
    let (depth, truth) = (map(4, 3), map(4, 3));
    let wall = Triangle { vertices: [DVec3::ZERO, DVec3::X, DVec3::Y], material: 0 };
    let material =
        Material { name: "wall".into(), reflectance: 1.0, transmittance: 0.0, source: "here".into() };
    let mesh = SceneMesh::decimated(&Scene::new(vec![wall], vec![material]).unwrap());
    let contents = Contents {
        volume: Some(&volume),
        depth: Some(&depth),
        truth: Some(&truth),
        scene: Some(&scene),
        mesh: Some(&mesh),
    };
    let report = r#"{"warnings":["</script><script>alert(1)</script>"]}"#;
    let text = page(&contents, "a <b> & c", report);
    assert!(!text.contains("{{") && text.ends_with("</html>\n"));
    assert!(text.contains("<title>a &lt;b> &amp; c · holosonar</title>"));
    for loading in ["src=", "http://", "https://", "@import", "fetch("] {
        assert!(!text.contains(loading), "{loading}");
    }
    assert_eq!(json_of(&text, "report"), serde_json::from_str::<Value>(report).unwrap());
    let data = json_of(&text, "page-data");
    for key in ["colours", "volume", "maps", "points", "mesh", "truth_points"] {
        assert!(data.get(key).is_some(), "{key}");
    }
    assert_eq!(data["points"]["microphones"]["of"], 4);
    assert_eq!(data["points"]["bounces"]["of"], 1);
    assert_eq!(data["truth_points"]["shown"], 8);
    assert_eq!(
        (&data["mesh"]["low"], &data["mesh"]["high"]),
        (&json!([0.0, 0.0, 0.0]), &json!([1.0, 1.0, 0.0]))
    );
    assert_eq!(
        data["mesh"]["vertices"],
        pack(&[0, 0, 0, 0, 0, 0, 255, 255, 0, 0, 0, 0, 0, 0, 255, 255, 0, 0])
    );
    assert_eq!(data["mesh"]["parts"][0]["triangles"], 1);
    assert_eq!(text, page(&contents, "a <b> & c", report), "results are bit-identical");
}

#[test]
fn anything_may_be_missing() {
    let text = page(&Contents::default(), "empty", "{}");
    let data = json_of(&text, "page-data");
    assert_eq!(data.as_object().unwrap().len(), 2, "{data}");
}

#[test]
fn large_clouds_are_subsampled_with_their_true_numbers() {
    let sampled = sample(&vec![[1.0; 3]; 13_000]);
    assert_eq!((&sampled["of"], &sampled["shown"]), (&json!(13_000), &json!(4334)));
}

#[test]
fn maps_of_other_pixels_are_refused() {
    let (depth, truth) = (map(4, 3), map(3, 4));
    assert!(
        Page::new(&Contents { depth: Some(&depth), truth: Some(&truth), ..Contents::default() }).is_err()
    );
}
