//! `info --health`: what it says of sound and of broken cubes.

use crate::binary::{done, done_json, files_below, json_file, names_below, refused, shipped, small};
use holosonar::acquisition::{CubeFile, CubeSource, DataCube};
use holosonar::num_complex::Complex32;
use std::path::Path;

/// Simulates a shipped scene into `cube.npz`.
fn simulated(folder: &Path, more: &str) -> DataCube {
    let scene = small("corner.toml");
    done(folder, &format!("simulate {} -o cube.npz -q {more}", scene.display()));
    DataCube::read(&folder.join("cube.npz"), 1 << 30).unwrap()
}

#[test]
fn a_sound_cube_has_its_noise_sign_and_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    for snr_db in [20.0, 10.0, 0.0] {
        let cube = simulated(path, &format!("--set detection.snr_db={snr_db:.1}"));
        let health = done_json(path, "info cube.npz --health -o out");
        assert_eq!(health, json_file(&path.join("out/health.json")));
        let found = health["noise"]["snr_db"].as_f64().unwrap();
        println!("{snr_db} dB: {} {}", health["noise"], health["phase_sign"]);
        assert!((found - snr_db).abs() < 2.0 && health["noise"]["at_least"] == false, "{snr_db}: {found}");
        assert_eq!(health["phase_sign"]["likely"], "as declared", "{}", health["phase_sign"]);
        assert_eq!(health["microphones"]["count"], cube.instrument.array.len());
        assert_eq!(health["microphones"]["dead"]["count"], 0);
    }
    assert_eq!(names_below(&path.join("out")), ["health.json", "health.png"]);
    let figure = std::fs::read(path.join("out/health.png")).unwrap();
    assert!(figure.starts_with(b"\x89PNG") && figure.len() > 10_000);
    let text = done(path, "info cube.npz --health -o out");
    for words in ["signal to noise", "echoes", "as declared", "nothing is wrong", "health.png"] {
        assert!(text.contains(words), "`{words}` is missing: {text}");
    }
    println!("{text}");
}

#[test]
fn a_broken_cube_is_examined_though_no_image_is_made_of_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let mut cube = simulated(path, "");
    let n_mic = cube.instrument.array.len();
    cube.samples.iter_mut().for_each(|m| *m = m.conj());
    cube.samples[3 * n_mic + 5] = Complex32::new(f32::NAN, 0.0);
    cube.samples.iter_mut().skip(7).step_by(n_mic).for_each(|m| *m = Complex32::ZERO);
    cube.write(&path.join("broken.npz")).unwrap();
    refused(path, "info broken.npz", 2, &["frequency 3", "microphone 5"]);
    let text = done(path, "info broken.npz --health");
    for words in ["not finite: 1, at 1 microphones", "dead microphones", "`phase_sign`", "no. 7 at "] {
        assert!(text.contains(words), "`{words}` is missing: {text}");
    }
    let health = done_json(path, "info broken.npz --health");
    assert_eq!(health["phase_sign"]["likely"], "opposite");
    assert_eq!(health["tones"]["not_finite"]["first"][0]["index"], 3);
    let mut file = CubeFile::open(&path.join("broken.npz"), 1 << 30).unwrap();
    assert!(file.visit(1000, &mut |_, _| Ok(())).is_err());
    assert!(file.unchecked().visit(1000, &mut |_, _| Ok(())).is_ok());
}

#[test]
fn only_cubes_have_a_health_and_inputs_are_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    refused(
        path,
        &format!("info {} --health", shipped("point.toml").display()),
        2,
        &["point.toml", "data cube"],
    );
    simulated(path, "");
    done(path, &format!("reconstruct cube.npz -c {} -o volume.npz -q", small("corner.toml").display()));
    refused(path, "info volume.npz --health -o out", 2, &["volume.npz", "data cube"]);
    refused(path, "info missing.npz --health -o out", 2, &["missing.npz"]);
    assert!(files_below(&path.join("out")).is_empty());
    assert_eq!(crate::binary::run(path, "info cube.npz -o out").status, 2);
}
