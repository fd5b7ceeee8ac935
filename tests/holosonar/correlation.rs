//! Correlation from outside: what it forgives, what every file says of it, and what is refused.

use crate::binary::{done, done_json, json_file, refused, shipped, small};
use crate::named::assert_names;

const METHOD: &str = "--set reconstruct.method=correlation";

/// A phase for every tone of the point scene, in turns.
fn unknown_phases() -> Vec<u8> {
    let turns = (0..41).map(|n| f64::from(n) * 0.618_033_988_75);
    turns.flat_map(|turns| (std::f64::consts::TAU * turns.fract()).to_le_bytes()).collect()
}

/// An npy file of one axis of doubles.
fn npy(values: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({},), }}", values.len() / 8);
    let header = format!("{header:117}\n");
    [b"\x93NUMPY\x01\x00".as_slice(), &118_u16.to_le_bytes(), header.as_bytes(), values].concat()
}

#[test]
fn a_speaker_of_unknown_phases_is_imaged_and_every_file_says_how() {
    let folder = tempfile::tempdir().unwrap();
    let (path, scene) = (folder.path(), shipped("point.toml"));
    let scene = scene.display();
    std::fs::write(path.join("phases.npy"), npy(&unknown_phases())).unwrap();
    done(path, &format!("simulate {scene} -o cube.npz -q"));
    let unknown = format!("--set calibration.response={}", path.join("phases.npy").display());
    let unknown = unknown.as_str();
    let peak = |set: &str, name: &str| {
        done(path, &format!("reconstruct cube.npz -c {scene} {set} -o {name} -q"));
        done_json(path, &format!("info {name}"))["peak_amplitude"].as_f64().unwrap()
    };
    assert!(peak(unknown, "coherent.npz") < 0.5);
    let [known, forgiven] = [METHOD.to_owned(), format!("{METHOD} {unknown}")].map(|set| peak(&set, "a.npz"));
    assert!((known - 1.0).abs() < 0.01 && (forgiven - known).abs() < 1e-3, "{known} {forgiven}");

    let set = format!("{METHOD} --set reconstruct.sub_band=9");
    let planned = done_json(path, &format!("plan {scene} {set}"));
    assert_eq!(planned["methods"].as_array().unwrap().len(), 1);
    assert_eq!(planned["methods"][0]["method"], "correlation");
    assert_eq!(planned["correlation"]["sub_bands"], 5);
    let words = done(path, &format!("plan {scene} {set}"));
    assert_names(words, &["* correlation", "5 sub-bands of 9 tones", "mm in depth"]);
    let summary = done(path, &format!("image {scene} {set} -o out"));
    assert_names(summary, &["correlation", "5 sub-bands of 9 tones"]);
    let report = json_file(&path.join("out/report.json"));
    assert_eq!((&report["method"], &report["correlation"]), (&"correlation".into(), &planned["correlation"]));
    let page = std::fs::read_to_string(path.join("out/report.html")).unwrap();
    assert_names(page, &["correlation", "sub_bands"]);
    // Read again, the volume knows how deep a point is in it.
    done(path, &format!("depth out/volume.npz -c {scene} -o again.exr"));
    assert_names(done_json(path, "info out/volume.npz").to_string(), &["correlation"]);
    // One by one the tones tell depth by curvature alone.
    let resolution =
        |value: &serde_json::Value| value["correlation"]["depth_resolution"][0].as_f64().unwrap();
    let single = done_json(path, &format!("plan {scene} {METHOD}"));
    assert!(resolution(&single) > 3.0 * resolution(&planned));
    let spread = done_json(path, &format!("psf {scene} {METHOD} --at 0,0,0.8"));
    let along = &spread["points"][0]["widths"][2];
    let [measured, predicted] = ["at_3_db", "predicted_at_3_db"].map(|key| along[key].as_f64().unwrap());
    // The prediction takes the curvature for a parabola.
    assert!((measured / predicted - 1.0).abs() < 0.5, "{measured} {predicted}");
}

#[test]
fn what_a_correlation_cannot_be_of_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small("corner.toml");
    for (set, parts) in [
        ("reconstruct.sub_band=4", &["reconstruct.sub_band", "method = \"correlation\""][..]),
        ("reconstruct.method=correlation --set reconstruct.sub_band=0", &["reconstruct.sub_band", "found 0"]),
        ("reconstruct.method=correlation --set reconstruct.sub_band=252", &["sub_band", "1 to 251"]),
        ("reconstruct.method=correlation --set refine.method=fista", &["refine.method", "correlation"]),
        ("reconstruct.method=correlation --set detection.kind=in-phase", &["detection.kind", "phases"]),
        (
            "reconstruct.method=correlation --set array.count=1 --set array.pitch=0.1",
            &["pairs", "there is one"],
        ),
    ] {
        refused(folder.path(), &format!("plan {} --set {set}", scene.display()), 2, parts);
    }
}
