//! The perspective view and the metrics of each material, through the binary.

use crate::binary::{done, done_json, json_file, refused, run, shipped};
use crate::named::assert_names;

#[test]
fn a_camera_shows_the_scene_and_views_are_not_mixed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let scene = shipped("camera.toml");
    let scene = scene.display();
    done(path, &format!("image {scene} -o out -q"));
    let report = json_file(&path.join("out/report.json"));
    println!("{}\n{}", report["metrics"], report["materials"]);
    assert!(report["metrics"]["completeness"].as_f64().unwrap() > 0.80, "{}", report["metrics"]);
    assert_eq!(report["pixels"], 160 * 120);

    // The reconstructed map has the same pixels as a truth computed separately, and each material is scored.
    done(path, &format!("truth {scene} -o truth.exr -q"));
    let scored = done_json(path, "compare out/depth.exr truth.exr --png error.png");
    assert_eq!(scored["metrics"], report["metrics"]);
    assert_eq!(scored["materials"], report["materials"]);
    let names: Vec<&String> = scored["materials"].as_object().unwrap().keys().collect();
    assert_eq!(names, ["crate", "sheet", "wall"]);
    assert!(std::fs::read(path.join("error.png")).unwrap().starts_with(b"\x89PNG"));
    let table =
        done(path, "compare out/depth.exr truth.exr --min completeness:wall=0.5 --min completeness#1=0.5");
    assert_names(table, &["crate", "sheet", "wall"]);
    let missed = run(path, "compare out/depth.exr truth.exr --max median_error:crate=0");
    assert_eq!(missed.status, 3, "{}", missed.stderr);
    assert_names(missed.stderr, &["median_error:crate"]);

    // The file's `pixels` go with the perspective view.
    done(path, &format!("truth {scene} -o parallel.exr -q --set depth.view=orthographic"));
    refused(path, "compare out/depth.exr parallel.exr", 2, &["orthographic", "perspective"]);
    // A volume has no camera.
    refused(path, &format!("depth out/volume.npz -c {scene} -o again.exr"), 2, &["fov", "degrees"]);
    done(path, &format!("depth out/volume.npz -c {scene} -o again.exr -q --set depth.fov=40.107045659"));
    let again = done_json(path, "compare again.exr truth.exr");
    let [a, b] = [&again, &scored].map(|s| s["metrics"]["completeness"].as_f64().unwrap());
    assert!((a - b).abs() < 1e-3, "{a} {b}");
}
