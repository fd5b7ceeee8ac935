//! `ascan`: a known echo, from a run file and from a cube, and what is refused.

use crate::binary::{done, done_json, names_below, refused, shipped};

#[test]
fn a_scene_and_its_cube_have_the_same_profile() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let point = shipped("point.toml");
    done(path, &format!("simulate {} -o cube.npz -q", point.display()));
    let scene = done_json(path, &format!("ascan {}", point.display()));
    let cube = done_json(path, "ascan cube.npz -o out.png -o out.csv");
    assert_eq!(scene, cube);
    // Speaker and microphone are in the centre; the reflector is at (0.09, -0.06, 0.8).
    let range = 0.6517_f64.sqrt();
    let peak = &cube["peaks"][0];
    assert!((peak["range"].as_f64().unwrap() - range).abs() < 1e-3, "{peak}");
    assert!(peak["level_db"].as_f64().unwrap().abs() < 0.05, "{peak}");
    assert_eq!(cube["peaks"].as_array().unwrap().len(), 1, "sidelobes are no echoes");
    assert_eq!(names_below(path), ["cube.npz", "out.csv", "out.png"]);
    let csv = std::fs::read_to_string(path.join("out.csv")).unwrap();
    assert!(csv.starts_with("path_m,range_m,amplitude,level_db\n0.000000,"));
    assert_eq!(csv.lines().count(), 1 + cube["amplitude"].as_array().unwrap().len());
    let figure = std::fs::read(path.join("out.png")).unwrap();
    assert!(figure.starts_with(b"\x89PNG") && figure.len() > 5000);
    let text = done(path, "ascan cube.npz --mic mean --set reconstruct.window=hann");
    for words in ["mean power of 121", "c/2B = 42.9 mm", "3.430 m of path", "0.81"] {
        assert!(text.contains(words), "`{words}` is missing: {text}");
    }
}

#[test]
fn microphones_and_files_that_there_are_not_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let point = shipped("point.toml");
    let of = |more: &str| format!("ascan {} {more}", point.display());
    refused(path, &of("--mic 121"), 2, &["microphone", "121", "counted from 0"]);
    refused(path, &of("--mic center"), 2, &["--mic", "center", "mean"]);
    refused(path, &of("--speaker 1"), 2, &["loudspeaker", "1"]);
    refused(path, &of("-o out.exr"), 2, &["out.exr", ".png, .csv"]);
    refused(path, &of("--set sweep.stop=10000 --set sweep.step=1"), 2, &["single frequency"]);
    refused(path, "ascan missing.npz", 2, &["missing.npz"]);
    assert!(names_below(path).is_empty());
}
