//! Several speakers at once: what a code is worth, what is said of it, what is measured with one, and what is refused.

use crate::binary::{done, done_json, json_file, refused};
use crate::named::assert_names;
use crate::support::write_point_run;
use holosonar::acquisition::{CodeKind, DataCube, SourceCode};

const RUN: &str = r#"
[scene]
mesh = "point.csv"
occlusion = "none"
[sweep]
start = 10e3
stop = 14e3
step = 100.0
[array]
count = [6, 5]
pitch = [0.03, 0.03]
sources = [[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.15, 0.0]]
[grid]
x = [-0.06, 0.06]
y = [-0.06, 0.06]
z = [0.8, 1.0]
pitch = [0.02, 0.02, 0.01]
"#;

#[test]
fn coded_speakers_are_decoded_and_every_file_says_what_that_is_worth() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    write_point_run(path, RUN);
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    for (kind, sweeps, gain) in [("hadamard", 4.0, 6.02), ("comb", 1.0 / 3.0, -4.77)] {
        let set = format!("--set coding.kind={kind}");
        let planned = done_json(path, &format!("plan run.toml {set}"));
        let coding = &planned["coding"];
        assert_eq!((&coding["kind"], &coding["loudspeakers"]), (&kind.into(), &3.into()));
        assert!((number(&coding["sweeps"]) - sweeps).abs() < 1e-9);
        assert!((number(&coding["snr_gain_db"]) - gain).abs() < 0.01, "{coding}");
        assert!(
            (number(&coding["equal_time_gain_db"]) - 4.77).abs() < 0.01 && coding["cross_talk_db"].is_null()
        );
        let words = done(path, &format!("image run.toml {set} -o {kind}"));
        assert_names(words, &["3 speakers at once", kind, "no cross-talk"]);
        let report = json_file(&path.join(kind).join("report.json"));
        assert_eq!(&report["coding"], coding);
        assert!((number(&report["peak_amplitude"]) - 1.0).abs() < 5e-3, "{kind}: {report}");
    }
    // An ideal code gives the samples of one after another.
    done(path, "simulate run.toml -o alone.npz -q");
    done(path, "simulate run.toml --set coding.kind=hadamard -o coded.npz -q");
    let read = |name: &str| DataCube::read(&path.join(name), 1 << 30).unwrap();
    let [alone, coded] = ["alone.npz", "coded.npz"].map(read);
    assert_eq!(alone.instrument, coded.instrument);
    assert!(alone.samples.iter().zip(&coded.samples).all(|(a, b)| (a - b).norm() < 1e-5));
    // And one that is not leaves cross-talk.
    let wrong = done_json(path, "plan run.toml --set coding.kind=hadamard --set coding.error=0.02");
    let level = number(&wrong["coding"]["cross_talk_db"]);
    assert!((-45.0..-33.0).contains(&level), "{level}");
    let warned = "plan run.toml --set coding.kind=comb --set sweep.step=2000 --set grid.z=[0.5,2.0]";
    assert_names(done_json(path, warned)["warnings"].to_string(), &["the tones of each speaker"]);
}

#[test]
fn a_cube_of_sweeps_is_decoded_before_it_is_imaged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    write_point_run(path, RUN);
    done(path, "simulate run.toml -o alone.npz -q");
    let alone = DataCube::read(&path.join("alone.npz"), 1 << 30).unwrap();
    // What would be recorded: four sweeps, as a cube of four transmissions.
    let mut sources = alone.instrument.sources();
    let code = SourceCode::new(CodeKind::Hadamard);
    let recorded = code.encode(&alone.instrument, &alone.samples).unwrap();
    sources.push(sources[0]);
    let four = alone.instrument.clone().with_sources(&sources).unwrap();
    DataCube::new(four, recorded).unwrap().write(&path.join("sweeps.npz")).unwrap();
    let decode = "--set coding.kind=hadamard --set calibration.decode=true";
    done(path, &format!("reconstruct sweeps.npz -c run.toml {decode} -o decoded.npz"));
    let peak = |name: &str| done_json(path, &format!("info {name}"))["peak_amplitude"].as_f64().unwrap();
    assert!((peak("decoded.npz") - 1.0).abs() < 5e-3);
    let said = done_json(path, &format!("calibrate sweeps.npz -c run.toml {decode} -o mended.npz"));
    assert_names(said["corrections"].to_string(), &["decoded", "3 speakers"]);
    let mended = DataCube::read(&path.join("mended.npz"), 1 << 30).unwrap();
    assert!(mended.samples.iter().zip(&alone.samples).all(|(a, b)| (a - b).norm() < 1e-5));
    refused(
        path,
        &format!("reconstruct alone.npz -c run.toml {decode} -o no.npz"),
        2,
        &["calibration.decode", "4 sweeps"],
    );
    refused(path, "reconstruct alone.npz -c run.toml --set coding.error=0.1 -o no.npz", 2, &["coding"]);
}

#[test]
fn what_cannot_be_told_apart_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    write_point_run(path, RUN);
    for (set, parts) in [
        ("coding.kind=walsh", &["coding.kind", "hadamard"][..]),
        ("coding.error=0.1", &["coding.error", "kind"]),
        ("calibration.decode=true", &["calibration.decode", "kind"]),
        ("coding.kind=comb --set coding.error=2", &["coding.error", "0 to 1"]),
        ("coding.kind=comb --set coding.sequences=[[1,1,1]]", &["coding.sequences", "sequences"]),
        ("coding.kind=sequences", &["coding.sequences"]),
        (
            "coding.kind=sequences --set coding.sequences=[[1,1],[1,-1]]",
            &["coding.sequences", "3 amplitudes"],
        ),
        ("coding.kind=sequences --set coding.sequences=[[1,1,1],[1,1,1],[1,1,1]]", &["only 1 independent"]),
        ("coding.kind=sequences --set coding.sequences=[[1,2,1]]", &["coding.sequences", "-1 to 1"]),
        ("coding.kind=comb --set array.sources=[[0,0,0]]", &["coding.kind", "there are 1"]),
        ("coding.kind=comb --set recording.dwell=0.1 --set scene.velocity=[0,0,0.1]", &["coding"]),
    ] {
        refused(path, &format!("plan run.toml --set {set}"), 2, parts);
    }
    let record = "simulate run.toml --set coding.kind=comb --set recording.dwell=0.01 -o recording.wav";
    refused(path, record, 2, &["[coding]", "recording"]);
}
