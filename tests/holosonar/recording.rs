//! Recordings: `simulate -o recording.wav`, `import`, and the image, against the way without a recording.

use crate::binary::{done, done_json, refused, run};
use crate::named::assert_names;
use crate::support::{folder_with_two_reflectors, read_cube, relative_difference};
use holosonar::num_complex::Complex32;
use std::fs;

/// Two echoes before 6 × 5 microphones.
const SWEEP: &str = "--set sweep.start=10000 --set sweep.stop=14000 --set sweep.step=250";
const ARRAY: &str = "--set array.count=[6,5] --set array.pitch=0.03";
const TONES: &str = "--set recording.dwell=0.03 --set recording.settling=0.02";

#[test]
fn a_recording_becomes_the_cube_that_was_simulated_and_the_same_image() {
    let folder = folder_with_two_reflectors();
    let path = folder.path();
    done(path, &format!("simulate two.csv -o cube.npz {SWEEP} {ARRAY}"));
    let expected = read_cube(&path.join("cube.npz"));
    let reference = "--set recording.reference=4";
    // Of the tone before, e⁻¹⁰ is left, 4.5e-5; 16 bits of a signal at half of full scale leave less.
    for (format, allowed) in [("float32", 1.2e-4), ("int24", 1.2e-4), ("int16", 2e-4)] {
        let recording = format!("{SWEEP} {ARRAY} {TONES} {reference} --set recording.start=0.0107");
        let facts = done_json(
            path,
            &format!("simulate two.csv -o a.wav {recording} --set recording.format={format}"),
        );
        let gain = format!("--set recording.gain_db={}", facts["gain_db"]);
        assert_eq!(facts["channels"], 31, "{facts}");
        let facts = done_json(path, &format!("import a.wav -o again.npz {recording} {gain}"));
        let again = read_cube(&path.join("again.npz"));
        assert_eq!(again.instrument, expected.instrument);
        let error = relative_difference(&again.samples, &expected.samples);
        assert!(error < allowed, "{format}: {error:.1e}");
        assert!(facts["least_snr_db"].as_f64().unwrap() > 60.0, "{facts}");
        assert_eq!(facts["phase_sign"], 1);
    }
    // At once, without a reference, in phase, from a run file; the settings are in one place.
    let text = "[scene]\nmesh = \"two.csv\"\n[sweep]\nstart = 10e3\nstop = 14e3\nstep = 250\n[array]\ncount = [6, 5]\npitch = 0.03\n\
                source = [0, 0, 0]\n[medium]\nsound_speed = 343\n[import]\nsamples = \"b.wav\"\n[recording]\ndwell = 0.02\n\
                settling = 0.01\nsample_rate = 44100\ngain_db = -8\nlatency = 0.0005\ndecay = 0\n\
                [grid]\nx = [-0.1, 0.1]\ny = [-0.06, 0.06]\nz = [0.7, 1.1]\npitch = [0.02, 0.02, 0.02]\n";
    fs::write(path.join("lab.toml"), text).unwrap();
    done(path, "simulate lab.toml -o b.wav --set detection.kind=in-phase --set recording.format=float32");
    let said = done(path, "import lab.toml -o b.npz");
    assert_names(&said, &["tones", "30 channels, 44100 Hz", "latency"]);
    // Amplitudes of 0.5 of full scale count as 1 only beside a reference.
    let mut halved = read_cube(&path.join("b.npz"));
    halved.samples.iter_mut().for_each(|m| *m *= 2.0);
    assert_eq!(halved.instrument, expected.instrument);
    let error = relative_difference(&halved.samples, &expected.samples);
    assert!(error < 1e-6, "{error:.1e}");
    let in_phase = done_json(path, "import lab.toml -o real.npz --set detection.kind=in-phase");
    assert_eq!(in_phase["detection"], "in-phase");
    assert!(read_cube(&path.join("real.npz")).samples.iter().all(|m| m.im == 0.0));
    // The image is that of the cube, within the error of the samples.
    let volume = |name: &str| {
        done(path, &format!("reconstruct {name}.npz -c lab.toml -o {name}_volume.npz"));
        let path = path.join(format!("{name}_volume.npz"));
        holosonar::export::volume_npz::read_volume_npz(&path, 1 << 24).unwrap().0
    };
    let (direct, recorded) = (volume("cube"), volume("again"));
    let difference = direct.samples.iter().zip(&recorded.samples).map(|(a, b)| (a - b).norm());
    let worst = difference.fold(0.0, f32::max) / direct.peak();
    assert!(worst < 2e-4, "{worst:.1e}");
}

#[test]
fn noise_is_that_of_the_cube_and_is_reported() {
    let folder = folder_with_two_reflectors();
    let path = folder.path();
    let recording =
        format!("{SWEEP} {ARRAY} {TONES} --set recording.reference=0 --set recording.gain_db=-12");
    let noise = "--set detection.snr_db=20";
    done(path, &format!("simulate two.csv -o cube.npz {SWEEP} {ARRAY}"));
    done(path, &format!("simulate two.csv -o a.wav {recording} {noise}"));
    let bytes = fs::read(path.join("a.wav")).unwrap();
    done(path, &format!("simulate two.csv -o a.wav {recording} {noise} -j 1"));
    assert!(fs::read(path.join("a.wav")).unwrap() == bytes, "the same bytes on one thread");
    let facts = done_json(path, &format!("import a.wav -o again.npz {recording}"));
    let (found, expected) = (read_cube(&path.join("again.npz")), read_cube(&path.join("cube.npz")));
    let pairs = found.samples.iter().zip(&expected.samples);
    let noise: f32 = pairs.map(|(a, b)| (a - b).norm_sqr()).sum();
    let power: f32 = expected.samples.iter().map(Complex32::norm_sqr).sum();
    let snr_db = 10.0 * (power / noise).log10();
    assert!((snr_db - 20.0).abs() < 1.0, "{snr_db}");
    // Tones differ in power, and their noise is the same.
    assert!((facts["snr_db"].as_f64().unwrap() - 20.0).abs() < 3.0, "{facts}");
    assert_eq!(facts["snr_db_of_tones"].as_array().unwrap().len(), 17);
    let info = done_json(path, "info again.npz");
    assert_eq!(info["provenance"]["import"]["signal"], "tones", "{info}");
    let shown = done(path, "info a.wav");
    assert_names(&shown, &["recording", "31 channels, 48000 Hz, 24 bits", "-6"]);
}

#[test]
fn plan_predicts_the_recording_and_what_does_not_fit_is_refused() {
    let folder = folder_with_two_reflectors();
    let path = folder.path();
    let plan = done_json(path, &format!("plan two.csv {SWEEP} {ARRAY} {TONES} --set recording.reference=0"));
    done(path, &format!("simulate two.csv -o a.wav {SWEEP} {ARRAY} {TONES} --set recording.reference=0"));
    let length = fs::metadata(path.join("a.wav")).unwrap().len();
    // 31 channels of 17 tones of 1440 frames of 3 bytes, and the heading.
    assert_eq!(plan["recording"]["bytes"], 31 * 17 * 1440 * 3, "{}", plan["recording"]);
    assert!((1..128).contains(&(length - plan["recording"]["bytes"].as_u64().unwrap())));
    assert_names(done(path, &format!("plan two.csv {SWEEP} {ARRAY} {TONES}")), &["30 channels, 0.51 s"]);
    let slow = format!("plan two.csv {SWEEP} {ARRAY} {TONES} --set recording.sample_rate=20000");
    assert_names(run(path, &slow).stderr, &["no recording", "sample_rate", "14000 Hz"]);
    for (words, named) in [
        ("", &["[recording] dwell", "missing"][..]),
        ("--set recording.dwell=60", &["4.0 GiB", "WAV", "fewer microphones"]),
        ("--set recording.dwell=0.05 --set recording.sample_rate=28000", &["sample_rate", "28000"]),
        ("--set recording.dwell=0.05 --set recording.signal=broadband", &["signal", "tones"]),
        ("--set recording.dwell=0.05 --set recording.latency=direct", &["latency", "in s"]),
        ("--set recording.dwell=0.05 --set recording.settling=0.06", &["recording.settling", "0.06", "0.05"]),
        ("--set recording.dwell=0.05 --set recording.reference=two.wav", &["reference", "number"]),
    ] {
        refused(path, &format!("simulate two.csv -o b.wav {SWEEP} {ARRAY} {words}"), 2, named);
    }
    assert!(!path.join("b.wav").exists());
    let reading = format!("import a.wav -o c.npz {SWEEP} {ARRAY}");
    for (words, named) in [
        (String::new(), &["31 channels", "30 microphones", "recording.reference"][..]),
        ("--set recording.reference=0".to_owned(), &["[recording] dwell"]),
        (format!("{TONES} --set recording.reference=31"), &["channel 31", "a.wav", "from 0"]),
        (
            "--set recording.dwell=0.04 --set recording.reference=0".to_owned(),
            &["a.wav", "0.510 s", "0.680 s"],
        ),
        (
            "--set recording.dwell=0.025 --set recording.settling=0.01 --set recording.reference=0"
                .to_owned(),
            &["a.wav", "no tone of", "recording.start"],
        ),
        (format!("{TONES} --set recording.reference=0 --set import.phase_sign=-1"), &["phase_sign", "known"]),
        (format!("{TONES} --set recording.reference=0 --memory 64k"), &["a.wav", "--memory"]),
    ] {
        let ran = run(path, &format!("{reading} {words}"));
        assert_eq!(ran.status, 2, "{words}: {}", ran.stderr);
        assert_names(ran.stderr, named);
    }
    done(path, &format!("simulate two.csv -o cube.npz {SWEEP} {ARRAY}"));
    refused(path, "plan cube.npz --set recording.settling=1", 2, &["--set recording.settling", "already"]);
    assert!(!path.join("c.npz").exists());
}
