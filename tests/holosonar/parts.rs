//! A scene of several files is the scene of one file, with metrics for each.

use crate::binary::{done_json, refused, run, shipped};
use std::fs;

/// The keys that the two run files share.
const REST: &str = "[sweep]\nstart = 10000.0\nstop = 16000.0\nstep = 100.0\n[array]\ncount = [15, 15]\npitch = [0.05, 0.05]\n\
    [grid]\nx = [-0.6, 0.6]\ny = [-0.65, 0.65]\nz = [1.3, 2.3]\npitch = [0.025, 0.025, 0.02]\n[output]\nreport = false\n";

/// The shipped corner as it is, and as three files of a plate each, the second of them in millimetres with z up.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let corner = fs::read_to_string(shipped("meshes/corner.obj")).unwrap();
    let write = |name: &str, text: String| fs::write(folder.path().join(name), text).unwrap();
    let plate = |wanted: usize, vertex: &dyn Fn([f64; 3]) -> [f64; 3]| {
        let mut plates = 0;
        let kept = corner.lines().filter_map(|line| {
            let (keyword, rest) = line.split_once(' ')?;
            match keyword {
                "v" => {
                    let numbers: Vec<f64> = rest.split(' ').map(|n| n.parse().unwrap()).collect();
                    Some(format!(
                        "v {}",
                        vertex([numbers[0], numbers[1], numbers[2]]).map(|n| n.to_string()).join(" ")
                    ))
                }
                "f" => {
                    plates += 1;
                    (plates == wanted).then(|| line.to_owned())
                }
                _ => None,
            }
        });
        kept.collect::<Vec<_>>().join("\n")
    };
    write("a.obj", plate(1, &|v| v));
    write("b.obj", plate(2, &|[x, y, z]| [1e3 * x, 1e3 * z, -1e3 * y]));
    write("c.obj", plate(3, &|v| v));
    write("corner.obj", corner.clone());
    write("one.toml", format!("[scene]\nmesh = \"corner.obj\"\nup = \"none\"\nunit = \"m\"\n{REST}"));
    let part = |file: &str, unit: &str, up: &str| {
        format!(
            "[[scene.parts]]\nmesh = \"{file}.obj\"\nunit = \"{unit}\"\nup = \"{up}\"\nmaterial = \"concrete\"\n"
        )
    };
    let parts = part("a", "m", "none") + &part("b", "mm", "z") + &part("c", "m", "none");
    write("several.toml", format!("{parts}{REST}"));
    folder
}

#[test]
fn parts_are_imaged_as_one_scene_with_metrics_for_each() {
    let folder = folder();
    let path = folder.path();
    let one = done_json(path, "image one.toml -o one --set materials=[{name='*',material='concrete'}]");
    let several = done_json(path, "image several.toml -o several");
    assert!(one["accepted"].as_u64().unwrap() > 200, "{one}");
    let close = |key: &str| {
        let [a, b] = [&one, &several].map(|report| report["metrics"][key].as_f64().unwrap());
        assert!((a - b).abs() <= 0.01 * a.max(0.1), "{key}: {a} {b}");
    };
    ["completeness", "false_returns", "median_error"].into_iter().for_each(close);
    let names: Vec<_> = several["materials"].as_object().unwrap().keys().cloned().collect();
    assert_eq!(names, ["a", "b", "c"]);
    let reached = several["materials"]["b"]["completeness"].as_f64().unwrap();
    let status = |min: f64| {
        run(path, &format!("compare several/depth.exr several/truth.exr --min completeness:b={min}")).status
    };
    assert_eq!((status(reached - 1e-6), status(reached + 1e-6)), (0, 3));
}

#[test]
fn a_part_at_fault_is_named() {
    let folder = folder();
    let path = folder.path();
    let (several, named) = ("several.toml", ["[[scene.parts]]", "gone.obj"]);
    refused(path, "plan several.toml --set scene.parts.1.mesh=gone.obj", 2, &[several, named[0], named[1]]);
    refused(path, "plan several.toml --unit m", 2, &["scene.unit=m", "[[scene.parts]]"]);
    fs::write(path.join("b.obj"), "v 1 2 3\nf 1 2 9\n").unwrap();
    refused(path, "truth several.toml -o t.exr", 2, &["part `b`", "b.obj", "line 2"]);
}
