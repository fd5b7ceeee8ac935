//! Each correction against the error that it undoes, on random cubes.
#![allow(clippy::unwrap_used)]

use super::*;
use crate::acquisition::{MicArray, SimulateOptions, Sweep, simulate};
use crate::named::assert_names;
use crate::progress::Silent;
use crate::reflectors::Reflectors;
use glam::DVec3;
use num_complex::Complex64;
use std::f64::consts::TAU;
use std::path::Path;

const TARGET: DVec3 = DVec3::new(0.1, -0.05, 1.2);

/// The echoes of some places at 9 x 7 microphones and 81 tones, in quadrature.
fn echoes_of(places: &[DVec3]) -> DataCube {
    let array = MicArray::rectangular([9, 7], [0.03, 0.04], DVec3::new(0.01, 0.0, 0.0)).unwrap();
    let instrument = Instrument::new(Sweep::stepped(8e3, 12e3, 50.0).unwrap(), array);
    let scene = Reflectors::new(places.to_vec(), vec![Complex32::ONE; places.len()]).unwrap();
    simulate(&scene, &instrument, &SimulateOptions::default()).unwrap()
}

/// Numbers that look random, within 1 of 0.
fn random(seed: usize) -> f64 {
    let x = (seed as f64 * 12.9898 + 78.233).sin() * 43758.5453;
    2.0 * (x - x.floor()) - 1.0
}

fn none() -> Calibration {
    Calibration { phase_sign: 1, memory: 1 << 30, ..Calibration::default() }
}

/// rms of the difference over rms of `b`.
fn difference(a: &DataCube, b: &DataCube) -> f64 {
    let square = |m: Complex32| f64::from(m.norm_sqr());
    let differing: f64 = a.samples.iter().zip(&b.samples).map(|(a, b)| square(a - b)).sum();
    (differing / b.samples.iter().map(|b| square(*b)).sum::<f64>()).sqrt()
}

/// Multiplies sample by sample: by a factor of each tone, and of each microphone.
fn distorted(
    cube: &DataCube,
    tones: &dyn Fn(usize) -> Complex64,
    mics: &dyn Fn(usize) -> Complex64,
) -> DataCube {
    let mut cube = cube.clone();
    let n_mic = cube.instrument.array.len();
    for (i, m) in cube.samples.iter_mut().enumerate() {
        let factor = tones(i / n_mic) * mics(i % n_mic);
        *m *= Complex32::new(factor.re as f32, factor.im as f32);
    }
    cube
}

fn tone_error(f: usize) -> Complex64 {
    Complex64::from_polar(1.0 + 0.5 * random(f), 2.0 * random(f + 1000))
}

fn mic_error(r: usize) -> Complex64 {
    Complex64::from_polar(1.0 + 0.3 * random(r + 5000), 1.5 * random(r + 7000))
}

#[test]
fn a_response_measured_with_a_target_is_divided_out_of_another_scene() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cal.npz");
    let one = |_: usize| Complex64::ONE;
    let (ball, scene) =
        (echoes_of(&[TARGET]), echoes_of(&[DVec3::new(-0.2, 0.1, 0.9), DVec3::new(0.1, 0.2, 1.5)]));
    for (axis, tones, mics) in [
        (
            ResponseAxis::Frequency,
            &tone_error as &dyn Fn(usize) -> Complex64,
            &one as &dyn Fn(usize) -> Complex64,
        ),
        (ResponseAxis::Microphone, &one, &mic_error),
        (ResponseAxis::Both, &tone_error, &mic_error),
    ] {
        let response = ChannelResponse::measure(&distorted(&ball, tones, mics), TARGET, axis).unwrap();
        assert!(response.explained > 0.999_999, "{axis}: {}", response.explained);
        response.write(&path).unwrap();
        let mut measured = distorted(&scene, tones, mics);
        let before = difference(&measured, &scene);
        let words =
            Calibration { response: Some(path.clone()), ..none() }.apply(&mut measured, &Silent).unwrap();
        assert_names(words.join("; "), &["divided by the response"]);
        // A response is known but for a factor, which its rms of 1 settles: what is left is that of the errors' rms.
        let scale = measured.samples[7] / scene.samples[7];
        let back = distorted(&measured, &|_| Complex64::new(scale.re.into(), scale.im.into()).inv(), &one);
        let after = difference(&back, &scene);
        assert!(before > 0.3 && after < 1e-5, "{axis}: {before} before, {after} after");
        assert_eq!(measured.provenance["calibration"][0], words[0].as_str());
    }
    // Of one axis alone nothing of the other is known.
    let half = ChannelResponse::measure(
        &distorted(&ball, &tone_error, &mic_error),
        TARGET,
        ResponseAxis::Microphone,
    );
    assert!(half.unwrap().explained < 0.7);
}

#[test]
fn odd_microphones_are_masked_and_amplitudes_stay() {
    let clean = echoes_of(&[TARGET]);
    let mut cube = clean.clone();
    for row in cube.samples.chunks_exact_mut(63) {
        (row[3], row[17]) = (row[3] * 1000.0, Complex32::ZERO);
    }
    cube.samples[63 * 40 + 60] = Complex32::new(f32::NAN, 0.0);
    let listed = Calibration { mask: ChannelMask::Listed(vec![60, 3, 17]), ..none() };
    let found = Calibration { mask: ChannelMask::Found(AutoWord::Auto), ..none() };
    let mut results = [cube.clone(), cube];
    let words = found.apply(&mut results[0], &Silent).unwrap();
    assert_eq!(words, ["3 of 63 microphones masked: 3, 17, 60"]);
    assert_eq!(listed.apply(&mut results[1], &Silent).unwrap(), words);
    assert_eq!(results[0].samples, results[1].samples);
    for (i, (m, was)) in results[0].samples.iter().zip(&clean.samples).enumerate() {
        let factor = if [3, 17, 60].contains(&(i % 63)) { 0.0 } else { 63.0 / 60.0 };
        assert!((m - was * factor).norm() < 1e-6);
    }
    let beyond = Calibration { mask: ChannelMask::Listed(vec![63]), ..none() };
    assert_names(
        beyond.apply(&mut clean.clone(), &Silent).unwrap_err().to_string(),
        &["mask", "63", "0 to 62"],
    );
    // What is not masked must be finite.
    let mut bad = clean.clone();
    bad.samples[5] = Complex32::new(0.0, f32::INFINITY);
    let other = Calibration { mask: ChannelMask::Listed(vec![6]), ..none() };
    assert_names(other.apply(&mut bad, &Silent).unwrap_err().to_string(), &["not finite", "microphone 5"]);
}

#[test]
fn the_empty_room_is_subtracted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("empty.npz");
    let scene = echoes_of(&[TARGET]);
    let room = distorted(&echoes_of(&[DVec3::new(0.0, 0.0, 0.3)]), &|_| Complex64::new(100.0, 0.0), &|_| {
        Complex64::ONE
    });
    room.write(&path).unwrap();
    let both = |scene: &DataCube| {
        let mut sum = scene.clone();
        sum.samples.iter_mut().zip(&room.samples).for_each(|(m, room)| *m += room);
        sum
    };
    let subtract = Calibration { background: Some(Background::Cube(path.clone())), ..none() };
    let mut cube = both(&scene);
    let words = subtract.apply(&mut cube, &Silent).unwrap();
    assert!(difference(&cube, &scene) < 1e-4);
    assert_names(words.join("; "), &["empty.npz", "dB"]);
    // Each tone of it has drifted.
    let drift = |f: usize| 1.0 + Complex64::from_polar(0.02, random(f) * TAU);
    let mut cube = both(&scene);
    let n_mic = 63;
    for (i, m) in cube.samples.iter_mut().enumerate() {
        let more = drift(i / n_mic) - 1.0;
        *m += room.samples[i] * Complex32::new(more.re as f32, more.im as f32);
    }
    assert!(difference(&cube, &both(&scene)) > 0.01);
    subtract.apply(&mut cube, &Silent).unwrap();
    assert!(difference(&cube, &scene) < 0.3, "{}", difference(&cube, &scene));
    // Masked microphones stay silent.
    let mut cube = both(&scene);
    let masked = Calibration { mask: ChannelMask::Listed(vec![1]), ..subtract.clone() };
    masked.apply(&mut cube, &Silent).unwrap();
    assert_eq!(cube.samples[1], Complex32::ZERO);
    assert!((cube.samples[2] - scene.samples[2] * (63.0 / 62.0)).norm() < 1e-4);
    // That of another instrument is refused.
    let other = Instrument::new(Sweep::stepped(8e3, 12e3, 100.0).unwrap(), scene.instrument.array.clone());
    DataCube::new(other, vec![Complex32::ONE; 41 * 63]).unwrap().write(&path).unwrap();
    assert_names(subtract.apply(&mut cube, &Silent).unwrap_err().to_string(), &["empty.npz", "frequencies"]);
}

#[test]
fn means_are_those_of_literal_sums() {
    let (own, radius) = (echoes_of(&[TARGET, DVec3::new(0.0, 0.0, 0.4)]), 0.055);
    let positions = own.instrument.array.positions();
    let literal = |near: &dyn Fn(DVec3, DVec3) -> bool, masked: &[usize]| {
        let mut result = own.clone();
        for (i, m) in result.samples.iter_mut().enumerate() {
            let (f, r) = (i / 63, i % 63);
            let others = (0..63).filter(|s| near(positions[r], positions[*s]) && !masked.contains(s));
            let others: Vec<Complex32> = others.map(|s| own.samples[f * 63 + s]).collect();
            *m -= others.iter().sum::<Complex32>() / others.len() as f32;
        }
        result
    };
    let mut mean = own.clone();
    Calibration { background: Some(Background::Mean), ..none() }.apply(&mut mean, &Silent).unwrap();
    assert!(difference(&mean, &literal(&|_, _| true, &[])) < 1e-5);
    let mut local = own.clone();
    let high_pass = Calibration { high_pass: Some(2.0 * radius), ..none() };
    high_pass.apply(&mut local, &Silent).unwrap();
    assert!(difference(&local, &literal(&|r, s| r.distance(s) <= radius, &[])) < 1e-5);
    // Masked microphones are in no mean.
    let mut masked = own.clone();
    Calibration { mask: ChannelMask::Listed(vec![10]), ..high_pass }.apply(&mut masked, &Silent).unwrap();
    let expected = literal(&|r, s| r.distance(s) <= radius, &[10]);
    assert!((masked.samples[11] - expected.samples[11] * (63.0 / 62.0)).norm() < 1e-5);
    let small = Calibration { high_pass: Some(0.01), ..none() };
    assert_names(small.apply(&mut own.clone(), &Silent).unwrap_err().to_string(), &["high_pass", "0.01"]);
}

#[test]
fn a_delay_is_a_length_of_path() {
    let mut cube = echoes_of(&[TARGET]);
    let f = cube.instrument.sweep.frequencies().to_vec();
    let longer = |i: usize| Complex64::cis(TAU * f[i] * 0.37 / 343.0);
    let mut late = distorted(&cube, &longer, &|_| Complex64::ONE);
    let calibration = Calibration { delay: 0.37, ..none() };
    calibration.apply(&mut late, &Silent).unwrap();
    assert!(difference(&late, &cube) < 1e-5);
    cube.instrument.detection = Detection::InPhase;
    assert_names(calibration.apply(&mut cube, &Silent).unwrap_err().to_string(), &["delay", "in-phase"]);
}

#[test]
fn a_gate_keeps_its_paths_and_nothing_else() {
    let (near, far) = (DVec3::new(0.0, 0.0, 0.5), DVec3::new(0.1, 0.0, 2.5));
    // In phase the gate's mirror, from 1.4 to 2.4 m, lies next to the near echo, which is 28 dB above the far one.
    for (detection, least) in [(Detection::Quadrature, 0.05), (Detection::InPhase, 0.1)] {
        let real = |mut cube: DataCube| {
            cube.instrument.detection = detection;
            if detection == Detection::InPhase {
                cube.samples.iter_mut().for_each(|m| m.im = 0.0);
            }
            cube
        };
        let (wanted, mut both) = (real(echoes_of(&[far])), real(echoes_of(&[near, far])));
        Calibration { gate: Some([4.5, 5.5]), ..none() }.apply(&mut both, &Silent).unwrap();
        let left = difference(&both, &wanted);
        assert!(left < least, "{detection}: {left}");
        // Outside of the gate hardly anything is left.
        let mut lonely = real(echoes_of(&[near]));
        Calibration { gate: Some([4.5, 5.5]), ..none() }.apply(&mut lonely, &Silent).unwrap();
        let leaked = (background::power(&lonely.samples) / background::power(&wanted.samples)).sqrt();
        assert!(leaked < least, "{detection}: {leaked}");
    }
    // Paths repeat after c/δf = 6.86 m.
    let all = Calibration { gate: Some([0.0, 7.0]), ..none() };
    assert_names(all.apply(&mut echoes_of(&[near]), &Silent).unwrap_err().to_string(), &["gate", "6.86"]);
}

#[test]
fn responses_of_tones_are_read_of_tables_and_arrays() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let clean = echoes_of(&[TARGET]);
    let phases: Vec<f64> = (0..81).map(|f| 2.0 * random(f)).collect();
    let measured = distorted(&clean, &|f| Complex64::cis(phases[f]), &|_| Complex64::ONE);
    let rows: Vec<String> =
        (0..81).map(|f| format!("{},{}", 8000 + 50 * f, phases[f].to_degrees())).collect();
    std::fs::write(path("p.csv"), "f,deg\n".to_owned() + &rows.join("\n")).unwrap();
    let falling: Vec<String> = phases.iter().map(|phase| format!("{}", -phase)).collect();
    std::fs::write(path("rad.txt"), falling.join("\n")).unwrap();
    let text = "{'descr': '<f8', 'fortran_order': False, 'shape': (81,), }\n";
    let numbers: Vec<u8> = phases.iter().flat_map(|phase| phase.to_le_bytes()).collect();
    let head =
        [b"\x93NUMPY\x01\x00".as_slice(), &(text.len() as u16).to_le_bytes(), text.as_bytes()].concat();
    std::fs::write(path("p.npy"), [head, numbers].concat()).unwrap();
    for (name, columns, phase_sign) in
        [("p.csv", vec![], 1), ("rad.txt", vec![TraceColumn::Radian], -1), ("p.npy", vec![], 1)]
    {
        let mut cube = measured.clone();
        let calibration = Calibration { response: Some(path(name)), columns, phase_sign, ..none() };
        calibration.apply(&mut cube, &Silent).unwrap();
        assert!(difference(&cube, &clean) < 1e-5, "{name}");
    }
    std::fs::write(path("few.csv"), "f,deg\n8000,1\n").unwrap();
    std::fs::write(path("other.csv"), "f,deg\n".to_owned() + &rows.join("\n").replace("8000", "8001"))
        .unwrap();
    std::fs::write(path("a.xyz"), "").unwrap();
    for (name, parts) in [
        ("few.csv", &["few.csv", "of 1 frequencies", "81"][..]),
        ("other.csv", &["other.csv", "other frequencies"]),
        ("a.xyz", &["a.xyz", "unknown kind", ".npz"]),
        ("none.npz", &["none.npz"]),
    ] {
        let calibration = Calibration { response: Some(path(name)), ..none() };
        assert_names(calibration.apply(&mut clean.clone(), &Silent).unwrap_err().to_string(), parts);
    }
    assert!(ChannelResponse::read(Path::new("none.npz"), 1).is_err());
}

/// Every correction of several loudspeakers is that of each alone.
#[test]
fn several_speakers_are_corrected_like_each_alone() {
    let folder = tempfile::tempdir().unwrap();
    let sources = [DVec3::ZERO, DVec3::X * 0.3];
    let of = |places: &[DVec3], sources: &[DVec3]| {
        let instrument = echoes_of(places).instrument.with_sources(sources).unwrap();
        let scene = Reflectors::new(places.to_vec(), vec![Complex32::ONE; places.len()]).unwrap();
        simulate(&scene, &instrument, &SimulateOptions::default()).unwrap()
    };
    let both = of(&[TARGET, DVec3::new(-0.2, 0.1, 0.7)], &sources);
    let path = |name: &str| folder.path().join(name);
    of(&[DVec3::new(-0.2, 0.1, 0.7)], &sources).write(&path("empty.npz")).unwrap();
    ChannelResponse::measure(&echoes_of(&[TARGET]), TARGET * 1.1, ResponseAxis::Both)
        .unwrap()
        .write(&path("response.npz"))
        .unwrap();
    for (tx, source) in sources.iter().enumerate() {
        of(&[DVec3::new(-0.2, 0.1, 0.7)], &[*source]).write(&path(&format!("empty{tx}.npz"))).unwrap();
    }
    let all = Calibration {
        mask: ChannelMask::Listed(vec![2, 7]),
        background: Some(Background::Cube(path("empty.npz"))),
        high_pass: Some(0.1),
        response: Some(path("response.npz")),
        delay: 0.1,
        gate: Some([1.5, 3.0]),
        tilt: [1.0, -2.0],
        ..none()
    };
    let mut together = both.clone();
    all.apply(&mut together, &Silent).unwrap();
    for (tx, source) in sources.iter().enumerate() {
        let instrument = both.instrument.clone().with_sources(&[*source]).unwrap();
        let mut alone = DataCube::new(instrument, both.transmission(tx).to_vec()).unwrap();
        let background = Some(Background::Cube(path(&format!("empty{tx}.npz"))));
        Calibration { background, ..all.clone() }.apply(&mut alone, &Silent).unwrap();
        assert_eq!(together.transmission(tx), &alone.samples, "{tx}");
        assert_eq!(together.instrument.array, alone.instrument.array);
    }
    // A background of one of them, or of other places, is none.
    let of_one = Calibration { background: Some(Background::Cube(path("empty0.npz"))), ..none() };
    assert_names(
        of_one.apply(&mut both.clone(), &Silent).unwrap_err().to_string(),
        &["empty0.npz", "loudspeakers"],
    );
    let mut elsewhere = both.clone();
    elsewhere.instrument = elsewhere.instrument.with_sources(&[DVec3::ZERO, DVec3::Y]).unwrap();
    let moved = Calibration { background: Some(Background::Cube(path("empty.npz"))), ..none() };
    assert_names(
        moved.apply(&mut elsewhere, &Silent).unwrap_err().to_string(),
        &["empty.npz", "loudspeakers"],
    );
    // A microphone that is lost with one of them is masked with all.
    let mut lost = both.clone();
    let half = lost.samples.len() / 2;
    lost.samples[half + 5] = Complex32::new(f32::NAN, 0.0);
    assert_names(
        none().apply(&mut lost.clone(), &Silent).unwrap_err().to_string(),
        &["loudspeaker 1", "microphone 5"],
    );
    let auto = Calibration { mask: ChannelMask::Found(AutoWord::Auto), ..none() };
    auto.apply(&mut lost, &Silent).unwrap();
    assert!((0..2).all(|tx| lost.transmission(tx).iter().skip(5).step_by(63).all(|m| *m == Complex32::ZERO)));
}
