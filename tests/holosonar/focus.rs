//! `autofocus`, and `calibrate --blind`: what they find, what they decline, and what they leave alone.

use crate::binary::{done, done_json, json, json_file, names_below, refused, run, small};
use crate::named::assert_names;
use crate::support::Random;
use holosonar::acquisition::DataCube;
use holosonar::num_complex::Complex32;
use std::fmt::Write;
use std::fs;
use std::path::Path;

/// 10 to 14 kHz.
const SWEEP: &str = "--set sweep.start=10000 --set sweep.stop=14000 --set sweep.step=100";

/// A large array of few microphones, and a smaller one of more.
const LARGE: &str = "--set array.count=11 --set array.extent=1.0";
const DENSE: &str = "--set array.count=15 --set array.extent=0.7";

const REGION: &str = "--set grid.x=[-0.3,0.3] --set grid.y=[-0.3,0.3] --set grid.z=[0.9,1.3]";

/// Simulates points all over the region into `cube.npz`.
fn simulate(path: &Path, count: usize, array: &str) -> DataCube {
    let mut random = Random::new(5);
    let mut list = "x,y,z,amplitude\n".to_owned();
    for _ in 0..count {
        let [x, y, z] = [0.2, 0.2, 0.15].map(|reach| random.uniform(-reach, reach));
        writeln!(list, "{x},{y},{},1", 1.1 + z).unwrap();
    }
    fs::write(path.join("points.csv"), list).unwrap();
    done(path, &format!("simulate points.csv -o cube.npz -q {SWEEP} {array}"));
    DataCube::read(&path.join("cube.npz"), 1 << 30).unwrap()
}

#[test]
fn a_wrong_speed_of_sound_is_found_said_and_not_applied() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    simulate(path, 5, LARGE);
    let before = fs::read(path.join("cube.npz")).unwrap();
    let search = format!("autofocus cube.npz --over sound-speed {REGION} --set medium.sound_speed=349.86");
    let found = done_json(path, &format!("{search} --range 336,356 --trials 11 -o out"));
    assert_eq!(found, json_file(&path.join("out/focus.json")));
    assert_eq!(names_below(&path.join("out")), ["focus.json", "focus.png"]);
    assert!(fs::read(path.join("out/focus.png")).unwrap().starts_with(b"\x89PNG"));
    assert_eq!(found["verdict"], "found", "{found}");
    let best = found["best"].as_f64().unwrap();
    assert!((best / 343.0 - 1.0).abs() < 0.003, "{best}");
    // What is to be typed is what the program reads.
    let setting = found["setting"].as_str().unwrap();
    assert_names(done(path, &format!("plan cube.npz {REGION} --set {setting}")), &["m/s instead of"]);
    assert_eq!(fs::read(path.join("cube.npz")).unwrap(), before);
    let text = done(path, &format!("{search} --range 346,356 --trials 5"));
    assert_names(text, &["sound-speed is not known", "end of the range"]);
}

#[test]
fn a_tilt_is_a_correction() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    simulate(path, 1, LARGE);
    let said = done_json(path, "calibrate cube.npz -o tilted.npz --set calibration.tilt=[2.0,0.0]");
    assert_names(said["corrections"].to_string(), &["tilted by 2°"]);
    let extent = |name: &str| DataCube::read(&path.join(name), 1 << 30).unwrap().instrument.array.extent();
    let (flat, tilted) = (extent("cube.npz"), extent("tilted.npz"));
    let (sin, cos) = 2.0_f64.to_radians().sin_cos();
    assert!((tilted.z - sin * flat.y).abs() < 1e-9 && (tilted.y - cos * flat.y).abs() < 1e-9, "{tilted}");
}

#[test]
fn phases_are_found_blindly_and_declined_where_they_are_none() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let mut cube = simulate(path, 60, DENSE);
    let n_mic = cube.instrument.array.len();
    let mut random = Random::new(3);
    let mut phase = || Complex32::cis((random.uniform(-1.0, 1.0) * 1.4) as f32);
    let phases: Vec<Complex32> = (0..n_mic).map(|_| phase()).collect();
    cube.samples.iter_mut().enumerate().for_each(|(i, m)| *m *= phases[i % n_mic]);
    cube.write(&path.join("wrong.npz")).unwrap();
    let blind = |cube: &str| format!("calibrate {cube}.npz --blind phase --prior 45 -o mended.npz {REGION}");
    let found = done_json(path, &blind("wrong"));
    assert_eq!(found["found"]["verdict"], "better", "{found}");
    let kept = done_json(path, "info mended.npz")["provenance"]["calibration"].to_string();
    assert_names(&kept, &["phase errors", "kept aside"]);
    // What is mended is not wrong any more, and noise never was right.
    fs::rename(path.join("mended.npz"), path.join("right.npz")).unwrap();
    cube.samples.iter_mut().for_each(|m| *m = random.complex());
    cube.write(&path.join("noise.npz")).unwrap();
    for name in ["right", "noise"] {
        let declined = run(path, &blind(name));
        assert_eq!(declined.status, 3, "{}{}", declined.stdout, declined.stderr);
        assert_names(&declined.stderr, &["kept aside", "nothing was written", "--anyway"]);
        assert!(!path.join("mended.npz").exists());
    }
    let anyway = run(path, &format!("{} --anyway --json", blind("noise")));
    assert_eq!(anyway.status, 3, "{}", anyway.stderr);
    assert_eq!(json(&anyway.stdout)["found"]["verdict"], "not better");
    assert!(path.join("mended.npz").exists());
}

#[test]
fn what_cannot_be_searched_or_found_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    simulate(path, 1, DENSE);
    let search = |more: &str| format!("autofocus cube.npz {more}");
    let nowhere = run(path, &search("--over sound-speed"));
    assert_eq!(nowhere.status, 2);
    assert_names(&nowhere.stderr, &["[grid]", "missing", "for example"]);
    refused(path, &search(&format!("--over delay {REGION} --trials 2")), 2, &["--trials", "5"]);
    refused(path, &search(&format!("--over sound-speed {REGION} --range -5,340")), 2, &["speed of sound"]);
    refused(path, "autofocus points.csv --over delay", 2, &["points.csv", "cube"]);
    for words in ["", "--over colour", "--over delay --range 2,1", "--over delay --measure taste"] {
        assert_eq!(run(path, &search(words)).status, 2, "{words}");
    }
    let blind = |more: &str| format!("calibrate cube.npz -o mended.npz {REGION} {more}");
    refused(path, &blind("--blind phase --prior 30"), 2, &["--blind", "many echoes", "--reference"]);
    refused(path, &blind("--blind delay --prior 0"), 2, &["--prior", "m"]);
    for words in
        ["--blind phase", "--prior 30", "--anyway", "--blind colour --prior 3", "--blind phase --prior x"]
    {
        assert_eq!(run(path, &blind(words)).status, 2, "{words}");
    }
    assert!(!path.join("mended.npz").exists());
}

#[test]
#[ignore = "minutes: three blind calibrations of the corner"]
fn microphones_five_millimetres_off_are_found_and_the_picture_is_complete_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let corner = small("corner.toml").display().to_string();
    done(path, &format!("truth {corner} -o truth.exr -q"));
    let completeness = |cube: &str| {
        done(path, &format!("image {cube}.npz -c {corner} -o picture -q"));
        done_json(path, "compare picture/depth.exr truth.exr")["metrics"]["completeness"].as_f64().unwrap()
    };
    for seed in 1..=3 {
        let errors = format!(
            "--set array.position_error=0.005 --set array.error_seed={seed} --set reflectors.seed={seed}"
        );
        done(path, &format!("simulate {corner} -o wrong.npz -q {errors}"));
        let blind = format!("calibrate wrong.npz -c {corner} --blind position --prior 0.005 -o mended.npz");
        let found = done_json(path, &blind);
        let [before, after] = ["wrong", "mended"].map(completeness);
        println!("seed {seed}: completeness {before:.3} -> {after:.3}, {}", found["found"]["held_out"]);
        assert!(before < 0.5 && after >= 0.7, "seed {seed}: {before} {after}");
    }
}
