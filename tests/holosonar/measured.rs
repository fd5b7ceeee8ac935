//! Measured cubes from the command line: what may be changed of them, and what is asked about.

use crate::binary::{done, done_json, refused, run, shipped};
use crate::named::assert_names;
use crate::support::write_npz;
use std::fs;
use std::path::Path;

/// Voxels around the reflector of the point scene.
const GRID: &str = "--set grid.x=[-0.3,0.3] --set grid.y=[-0.3,0.3] --set grid.z=[0.6,1.0] --set grid.pitch=[0.03,0.03,0.01]";

/// A folder with the point scene as `r.toml`, and its cube.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("meshes")).unwrap();
    fs::copy(shipped("point.toml"), folder.path().join("r.toml")).unwrap();
    fs::copy(shipped("meshes/point.csv"), folder.path().join("meshes/point.csv")).unwrap();
    done(folder.path(), "simulate r.toml -o c.npz -q");
    folder
}

/// A cube of 3 frequencies at 2 x 2 microphones.
fn write_cube(path: &Path, samples: (&str, &[u8]), meta: &str, [first, step]: [f64; 2]) {
    let frequencies = [first, first + step, first + 2.0 * step];
    let positions = [0.0_f64, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1, 0.0, 0.1, 0.1, 0.0];
    write_npz(
        path,
        &[
            ("samples", samples.0, &[3, 2, 2], samples.1),
            ("frequencies", "<f8", &[3], bytemuck::cast_slice(&frequencies)),
            ("mic_positions", "<f8", &[2, 2, 3], bytemuck::cast_slice(&positions)),
            ("meta", "|u1", &[meta.len()], meta.as_bytes()),
        ],
    );
}

#[test]
fn what_is_typed_replaces_what_a_cube_says() {
    let folder = workplace();
    let path = folder.path();
    let depth = |name: &str, typed: &str| {
        let said = done(path, &format!("image c.npz -o {name} {GRID} {typed}"));
        let found = done_json(path, &format!("info {name}/depth.exr"));
        (said, found["depth_range_m"][0].as_f64().unwrap(), found)
    };
    let (_, own, _) = depth("own", "");
    // Echoes of sound that is 3 % faster come from 3 % farther away.
    let (said, faster, found) = depth("faster", "--set medium.sound_speed=353.3");
    assert_names(&said, &["353.3 m/s instead of 343 m/s"]);
    assert!((faster / own - 1.03).abs() < 0.005, "{faster} {own}");
    assert_eq!(found["attributes"]["sonar:soundSpeed"], 353.3);
    assert_eq!(found["attributes"]["sonar:phaseSign"], 1);
    // Of array and speaker moved 10 cm away from the scene, the picture moves with them.
    let (said, moved, _) = depth("moved", "--set array.centre=[0,0,-0.1] --set array.source=[0,0,-0.1]");
    assert_names(&said, &["(0, 0, -0.1)", "centre of the array", "speaker"]);
    assert!((own - moved - 0.1).abs() < 0.005, "{moved} {own}");
    // `plan` and `reconstruct` follow.
    let plan = done(path, &format!("plan c.npz {GRID} --set medium.temperature=30"));
    assert_names(&plan, &["sound speed 350.218 m/s", "instead of 343 m/s"]);
    done(path, &format!("reconstruct c.npz -o v.npz {GRID} --set medium.sound_speed=340 -q"));
    assert_eq!(done_json(path, "info v.npz")["meta"]["sound_speed"], 340.0);
}

#[test]
fn what_would_change_nothing_is_refused_or_warned_of() {
    let folder = workplace();
    let path = folder.path();
    for (typed, named) in [
        ("--set sweep.step=10", "frequencies"),
        ("--set array.pitch=0.1", "microphones"),
        ("--set scene.scale=2", "scene"),
        ("--up y", "scene"),
        ("--set medium.spreading=true", "reconstruct.compensate"),
    ] {
        refused(path, &format!("image c.npz -o out {GRID} {typed}"), 2, &["--set", named]);
        refused(path, &format!("plan c.npz {GRID} {typed}"), 2, &["--set", named]);
    }
    // A run file describes its simulation.
    let text = fs::read_to_string(path.join("r.toml")).unwrap();
    fs::write(path.join("w.toml"), format!("{text}\n[medium]\nsound_speed = 330.0\n")).unwrap();
    let said = run(path, "image c.npz -c w.toml -o out");
    assert_names(&said.stderr, &["330 m/s instead of 343 m/s", "--set"]);
    assert!(!run(path, "image c.npz -c r.toml -o same").stderr.contains("instead of"));
}

#[test]
fn implausible_cubes_are_asked_about_and_unknown_names_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let ones = [1.0_f32; 12];
    let real = ("<f4", bytemuck::cast_slice(&ones));
    let image = |name: &str| run(path, &format!("image {name}.npz -o {name} {GRID}"));
    write_cube(&path.join("khz.npz"), real, "{}", [10.0, 5.0]);
    assert_names(&image("khz").stderr, &["10.00 to 20.00 Hz", "in Hz"]);
    write_cube(&path.join("light.npz"), real, r#"{"sound_speed": 3e8}"#, [10e3, 5e3]);
    assert_names(&image("light").stderr, &["300000000 m/s", "15.0 km"]);
    write_cube(&path.join("unsigned.npz"), ("<u2", &[7; 24]), "{}", [10e3, 5e3]);
    assert_names(&image("unsigned").stderr, &["unsigned", "offset"]);
    write_cube(&path.join("zeros.npz"), ("<f4", &[0; 48]), "{}", [10e3, 5e3]);
    assert_names(&image("zeros").stderr, &["every sample is 0"]);
    write_cube(&path.join("key.npz"), real, r#"{"sound_sped": 340.0}"#, [10e3, 5e3]);
    refused(
        path,
        &format!("image key.npz -o out {GRID}"),
        2,
        &["key.npz", "meta", "did you mean `sound_speed`?"],
    );
    write_npz(&path.join("array.npz"), &[("samples", "<f4", &[12], real.1), ("frequency", "<f8", &[0], &[])]);
    refused(
        path,
        &format!("image array.npz -o out {GRID}"),
        2,
        &["array.npz", "did you mean `frequencies`?"],
    );
}
