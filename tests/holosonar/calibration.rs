//! `[calibration]` and `calibrate`: simulated errors of hardware, then mended, and the pictures compared.

use crate::binary::{done, done_json, json, refused, run, small};
use crate::named::assert_names;
use crate::support::Random;
use holosonar::acquisition::DataCube;
use holosonar::config::RunFile;
use holosonar::export::volume_npz::read_volume_npz;
use holosonar::num_complex::Complex32;
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use std::f64::consts::TAU;
use std::fs;
use std::path::Path;

/// Seven points of one brightness, well apart.
const POINTS: &str = "0,0,1.7,1\n0.3,0.1,1.5,1\n-0.35,0.2,1.6,1\n0.1,-0.4,1.8,1\n-0.2,-0.3,1.4,1\n\
    0.4,-0.2,2,1\n-0.1,0.45,2.1,1\n";

/// Where the target of the reference stood, as it is typed.
const BALL: &str = "0.1,0.05,1.5";

/// Sweep and array of the small corner, for lists of reflectors.
const INSTRUMENT: &str = "--set sweep.start=10000 --set sweep.stop=20000 --set sweep.step=40 --set array.count=31 \
    --set array.extent=1.0";

/// The cubes of the corner, of seven points and of a ball, seen by one instrument, and the corner's truth.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    done(path, &format!("simulate {} -o corner.npz -q", corner()));
    done(path, &format!("truth {} -o truth.exr -q", corner()));
    simulate(path, "seven", POINTS);
    simulate(path, "ball", &format!("{BALL},1\n"));
    folder
}

fn corner() -> String {
    small("corner.toml").display().to_string()
}

/// Simulates reflectors into `{name}.npz`.
fn simulate(path: &Path, name: &str, reflectors: &str) {
    fs::write(path.join(name).with_extension("csv"), format!("x,y,z,amplitude\n{reflectors}")).unwrap();
    done(path, &format!("simulate {name}.csv -o {name}.npz -q {INSTRUMENT}"));
}

fn read(path: &Path, name: &str) -> DataCube {
    DataCube::read(&path.join(format!("{name}.npz")), 1 << 30).unwrap()
}

fn write(path: &Path, name: &str, cube: &DataCube) {
    cube.write(&path.join(format!("{name}.npz"))).unwrap();
}

/// Writes `wrong_{name}.npz`: each sample of `{name}.npz`, changed; the change is told tone and microphone.
fn spoil(path: &Path, name: &str, change: impl Fn(usize, usize, Complex32) -> Complex32) {
    let mut cube = read(path, name);
    let n_mic = cube.instrument.array.len();
    for (i, m) in cube.samples.iter_mut().enumerate() {
        *m = change(i / n_mic, i % n_mic, *m);
    }
    write(path, &format!("wrong_{name}"), &cube);
}

/// Numbers of mean 0 and of an rms.
fn errors(random: &mut Random, count: usize, rms: f64) -> Vec<f64> {
    (0..count).map(|_| random.uniform(-rms, rms) * 3.0_f64.sqrt()).collect()
}

fn phasors(angles: &[f64]) -> Vec<Complex32> {
    angles.iter().map(|angle| Complex32::cis(*angle as f32)).collect()
}

/// Sharpness N Σ I² / (Σ I)² of a cube's image, I being powers, on the corner's grid.
fn sharpness(path: &Path, name: &str) -> f64 {
    let cube = read(path, name);
    let grid = RunFile::load(&small("corner.toml"), &[]).unwrap().voxels(&cube.instrument, None).unwrap();
    let options = ReconstructOptions::new(Method::Convolution, Window::None);
    let volume = reconstruct(&cube, &grid, &options).unwrap().volume;
    let powers = || volume.samples.iter().map(|sample| f64::from(sample.norm_sqr()));
    let sum: f64 = powers().sum();
    volume.samples.len() as f64 * powers().map(|power| power * power).sum::<f64>() / (sum * sum)
}

/// Completeness and share of false returns of the picture of a cube, against the corner's truth.
fn scores(path: &Path, name: &str, settings: &str) -> [f64; 2] {
    done(path, &format!("image {name}.npz -c {} -o picture -q {settings}", corner()));
    let scored = done_json(path, "compare picture/depth.exr truth.exr");
    ["completeness", "false_returns"].map(|metric| scored["metrics"][metric].as_f64().unwrap())
}

/// The brightness of points that is back, as sharpness over that without errors: as it came, and calibrated.
fn regained(path: &Path, scene: &str, wrong: &str, settings: &str) -> [f64; 2] {
    let said = done_json(path, &format!("calibrate {wrong}.npz -o mended.npz {settings}"));
    assert!(!said["corrections"].as_array().unwrap().is_empty(), "{said}");
    let whole = sharpness(path, scene);
    let shares = [wrong, "mended"].map(|name| sharpness(path, name) / whole);
    println!("{scene} {settings}: sharpness {:.4} -> {:.4}", shares[0], shares[1]);
    shares
}

#[test]
fn a_ball_mends_microphones_and_the_picture_is_complete_again() {
    let folder = workplace();
    let path = folder.path();
    let whole = scores(path, "corner", "");
    for seed in 1..=3 {
        let mut random = Random::new(seed);
        let mics = phasors(&errors(&mut random, 31 * 31, 60.0_f64.to_radians()));
        for scene in ["corner", "seven", "ball"] {
            spoil(path, scene, |_, r, m| m * mics[r]);
        }
        let ball = format!("calibrate --reference wrong_ball.npz --at {BALL} --per microphone -o cal.npz");
        assert!(done_json(path, &ball)["explained"].as_f64().unwrap() > 0.999);
        let wrong = scores(path, "wrong_corner", "");
        // A path in a setting is relative to the run file.
        let response = path.join("cal.npz").display().to_string();
        let mended = scores(path, "wrong_corner", &format!("--set calibration.response={response}"));
        println!("seed {seed}: completeness, false returns {wrong:?} -> {mended:?} of {whole:?}");
        assert!((mended[0] - whole[0]).abs() < 0.02 && (mended[1] - whole[1]).abs() < 0.02);
        assert!(wrong[0] < mended[0] - 0.02 || wrong[1] > mended[1] + 0.1, "the errors were harmless");
        let [_, share] = regained(path, "seven", "wrong_seven", "--set calibration.response=cal.npz");
        assert!(share > 0.98);
    }
}

#[test]
fn a_ball_mends_the_speaker() {
    let folder = workplace();
    let path = folder.path();
    for seed in 1..=3 {
        let mut random = Random::new(seed);
        let n_f = read(path, "ball").instrument.sweep.len();
        let gains = errors(&mut random, n_f, 6.0);
        let tones: Vec<Complex32> = phasors(&errors(&mut random, n_f, 69.0_f64.to_radians()))
            .iter()
            .zip(&gains)
            .map(|(tone, decibel)| tone * 10.0_f64.powf(decibel / 20.0) as f32)
            .collect();
        for scene in ["corner", "seven", "ball"] {
            spoil(path, scene, |f, _, m| m * tones[f]);
        }
        done(path, &format!("calibrate --reference wrong_ball.npz --at {BALL} -o cal.npz -q"));
        for scene in ["corner", "seven"] {
            let [before, after] =
                regained(path, scene, &format!("wrong_{scene}"), "--set calibration.response=cal.npz");
            assert!(before < 0.5 && after > 0.98, "seed {seed}: {before} {after}");
        }
    }
}

#[test]
fn an_empty_room_that_has_drifted_takes_the_direct_wave_away() {
    let folder = workplace();
    let path = folder.path();
    for seed in 1..=3 {
        let mut random = Random::new(seed);
        for scene in ["corner", "seven"] {
            let cube = read(path, scene);
            let instrument = &cube.instrument;
            let rms = (cube.samples.iter().map(|m| f64::from(m.norm_sqr())).sum::<f64>()
                / cube.samples.len() as f64)
                .sqrt();
            // 40 dB above the echoes, from the speaker in the middle of the array.
            let direct = |f: usize, r: usize| {
                let turns = instrument.sweep.frequencies()[f] * instrument.array.positions()[r].length()
                    / instrument.sound_speed;
                Complex32::from_polar(100.0 * rms as f32, (TAU * turns) as f32)
            };
            // Of each tone its level and phase have changed by some 2 % until the scene stood there.
            let drift: Vec<Complex32> = (0..instrument.sweep.len())
                .map(|_| 1.0 + random.complex() * (0.02 * 1.5_f32.sqrt()))
                .collect();
            spoil(path, scene, |f, r, m| m + direct(f, r) * drift[f]);
            let mut empty = cube.clone();
            let n_mic = instrument.array.len();
            for (i, m) in empty.samples.iter_mut().enumerate() {
                *m = direct(i / n_mic, i % n_mic);
            }
            write(path, "empty", &empty);
            let [before, after] =
                regained(path, scene, &format!("wrong_{scene}"), "--set calibration.background=empty.npz");
            assert!(
                (before - 1.0).abs() > 0.05 && (after - 1.0).abs() < 0.02,
                "seed {seed}: {before} {after}"
            );
        }
    }
}

#[test]
fn loud_dead_and_broken_microphones_are_found_and_silenced() {
    let folder = workplace();
    let path = folder.path();
    for scene in ["corner", "seven"] {
        let loud = |r: usize| [100, 400, 777].contains(&r);
        spoil(path, scene, |_, r, m| if loud(r) { m * 1000.0 } else { m });
        let [before, after] =
            regained(path, scene, &format!("wrong_{scene}"), "--set calibration.mask=\"auto\"");
        assert!(before < 0.2 && after > 0.98, "{before} {after}");
        spoil(path, scene, |f, r, m| match r {
            5 if f == 17 => Complex32::new(f32::NAN, 0.0),
            9 => Complex32::ZERO,
            _ if loud(r) => m * 1000.0,
            _ => m,
        });
        refused(
            path,
            &format!("image wrong_{scene}.npz -c {} -o o", corner()),
            2,
            &["frequency 17", "microphone 5"],
        );
        let said =
            done(path, &format!("calibrate wrong_{scene}.npz -o again.npz --set calibration.mask=\"auto\""));
        assert_names(&said, &["5 of 961 microphones", "again.npz"]);
        assert!(sharpness(path, "again") / sharpness(path, "mended") > 0.99);
    }
}

#[test]
fn what_was_corrected_is_said_and_kept() {
    let folder = workplace();
    let path = folder.path();
    let gate = "--set calibration.gate=[2.5,5.0] --set calibration.delay=0.1 --set calibration.mask=[3,4]";
    done(path, &format!("calibrate corner.npz -o mended.npz -q {gate}"));
    let kept = done_json(path, "info mended.npz")["provenance"]["calibration"].to_string();
    assert_names(&kept, &["2 of 961 microphones", "0.1 m", "2.5"]);
    // `image` and `reconstruct` correct as `calibrate` does.
    let image = |words: &str| done(path, &format!("{words} -c {} -q", corner()));
    image("reconstruct mended.npz -o a.npz");
    image(&format!("reconstruct corner.npz -o b.npz {gate}"));
    let [a, b] = ["a.npz", "b.npz"].map(|name| read_volume_npz(&path.join(name), 1 << 30).unwrap());
    assert_eq!(a.0.samples, b.0.samples);
    let meta = done_json(path, "info b.npz")["meta"]["run"]["calibration"].to_string();
    assert_names(&meta, &["\"mask\":[3,4]", "\"delay\":0.1"]);
    assert_names(done(path, &format!("plan corner.npz -c {} {gate}", corner())), &["2 of 961 microphones"]);
    // A scene has no errors to be mended.
    let scene = run(path, &format!("image {} -o scene {gate}", corner()));
    assert_names(&scene.stderr, &["[calibration]"]);
    assert_eq!(scene.status, 0);
}

#[test]
fn what_cannot_be_corrected_is_refused() {
    let folder = workplace();
    let path = folder.path();
    let corrected = |settings: &str| format!("calibrate corner.npz -o mended.npz {settings}");
    for (settings, named) in [
        ("", &["[calibration]", "nothing"] as &[&str]),
        ("--set calibration.mask=[961]", &["961"]),
        ("--set calibration.mask=loud", &["calibration.mask", "auto"]),
        ("--set calibration.background=gone.npz", &["gone.npz"]),
        ("--set calibration.response=gone.npz", &["gone.npz"]),
        ("--set calibration.response=corner.npz", &["corner.npz"]),
        ("--set calibration.response=", &["calibration.response"]),
        ("--set calibration.high_pass=0", &["calibration.high_pass"]),
        ("--set calibration.delay=inf", &["calibration.delay"]),
        ("--set calibration.gate=[5,2]", &["calibration.gate", "shorter"]),
        ("--set calibration.gate=[0,1000]", &["gate"]),
        ("--set calibration.phase_sign=2", &["calibration.phase_sign", "-1"]),
        ("--set calibration.columns=[\"f\",\"db\"]", &["calibration.columns"]),
        ("--set calibration.file=cal.npz", &["file", "response"]),
    ] {
        refused(path, &corrected(settings), 2, named);
    }
    done(path, &format!("calibrate --reference ball.npz --at {BALL} --per both -o cal.npz -q"));
    let facts = done_json(path, "info cal.npz");
    assert_eq!((&facts["kind"], &facts["microphones"]["count"]), (&"response".into(), &961.into()));
    assert!(facts["explained"].as_f64().unwrap() > 0.999);
    let few = "simulate ball.csv -o few.npz -q --set sweep.start=10000 --set sweep.stop=11000 --set array.count=5 \
        --set array.pitch=0.1";
    done(path, few);
    let kind = "--set detection.kind=\"in-phase\"";
    done(path, &format!("{} {kind}", few.replace("few", "real")));
    refused(path, "calibrate few.npz -o a.npz --set calibration.response=cal.npz", 2, &["cal.npz"]);
    refused(path, "calibrate few.npz -o a.npz --set calibration.background=ball.npz", 2, &["ball.npz"]);
    refused(
        path,
        "calibrate real.npz -o a.npz --set calibration.delay=0.1",
        2,
        &["calibration", "delay", "I and Q"],
    );
    refused(path, &format!("calibrate --reference real.npz --at {BALL} -o a.npz"), 2, &["I and Q"]);
    refused(path, &format!("calibrate --reference ball.csv --at {BALL} -o a.npz"), 2, &["ball.csv", "cube"]);
    refused(path, &format!("calibrate --reference ball.npz --at {BALL} -o ball.npz"), 2, &["ball.npz"]);
    refused(path, "calibrate ball.npz -o ball.npz --set calibration.delay=1", 2, &["ball.npz"]);
    assert!(!path.join("a.npz").exists() && !path.join("mended.npz").exists());
    for words in [
        "calibrate -o a.npz",
        "calibrate --reference ball.npz -o a.npz",
        "calibrate --reference ball.npz --at 1,2 -o a",
    ] {
        assert_eq!(run(path, words).status, 2, "{words}");
    }
    // A target elsewhere.
    let elsewhere = run(path, "calibrate --reference ball.npz --at 0.3,0,1.2 -o a.npz");
    assert_names(&elsewhere.stderr, &["explains", "calibration.gate"]);
    let facts = json(&run(path, "calibrate --reference ball.npz --at 0.3,0,1.2 -o a.npz --json").stdout);
    assert!(facts["explained"].as_f64().unwrap() < 0.5);
}
