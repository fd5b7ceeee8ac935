//! `[instrument]`: electronics that are not ideal, in cubes, images, plans and reports.

use crate::binary::{done, done_json, json_file, refused, shipped};
use crate::named::assert_names;
use crate::support::{folder_with_two_reflectors, read_cube, relative_difference};

const SETTINGS: &str = "--set sweep.start=10000 --set sweep.stop=14000 --set sweep.step=250 --set array.count=[6,5] \
                        --set array.pitch=0.03";

#[test]
fn what_is_ideal_changes_no_byte() {
    let folder = folder_with_two_reflectors();
    let path = folder.path();
    done(path, &format!("simulate two.csv -o a.npz {SETTINGS}"));
    let typed = "--set instrument.mixer=switch --set instrument.jitter=0 --set instrument.quadrature=passes";
    done(path, &format!("simulate two.csv -o b.npz {SETTINGS} {typed}"));
    assert_eq!(read_cube(&path.join("a.npz")).samples, read_cube(&path.join("b.npz")).samples);
}

/// Three ways to the same samples: closed forms, and a recording that is written and demodulated.
#[test]
fn an_integral_after_a_step_is_what_a_recording_holds() {
    let folder = folder_with_two_reflectors();
    let path = folder.path();
    // 10 ms are whole halves of the periods of all tones. The room takes 4 ms.
    let times = "--set recording.dwell=0.018 --set recording.settling=0.008";
    done(path, &format!("simulate two.csv -o ideal.npz {SETTINGS}"));
    let instrument = "--set instrument.filter=integration --set instrument.decay=0.004";
    done(path, &format!("simulate two.csv -o integrated.npz {SETTINGS} {times} {instrument}"));
    let recorded = format!("{SETTINGS} {times} --set recording.format=float32");
    done(path, &format!("simulate two.csv -o a.wav {recorded} --set recording.decay=0.004"));
    done(path, &format!("import a.wav -o recorded.npz {recorded}"));
    let [ideal, integrated, mut recorded] =
        ["ideal", "integrated", "recorded"].map(|name| read_cube(&path.join(name).with_extension("npz")));
    // Without a reference, samples are half of full scale.
    recorded.samples.iter_mut().for_each(|m| *m *= 2.0);
    let (unsettled, error) = (
        relative_difference(&integrated.samples, &ideal.samples),
        relative_difference(&recorded.samples, &integrated.samples),
    );
    println!("unsettled {unsettled:.1e}, recorded against integrated {error:.1e}");
    assert!(unsettled > 0.03 && error < 0.05 * unsettled, "{unsettled} {error}");
}

#[test]
fn plans_and_reports_tell_of_each_element() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let point = shipped("point.toml");
    let typed = "--set instrument.mixer=switch --set instrument.harmonics_db=[-40,-40] --set instrument.clock_error=1000 \
                 --set instrument.adc_bits=8 --set instrument.jitter=1e-6 --set detection.snr_db=30";
    let text = done(path, &format!("plan {} {typed}", point.display()));
    assert_names(
        &text,
        &["16 points", "distortion", "jitter", "clock", "converter", "noise", "all", "8 bits"],
    );
    let plan = done_json(path, &format!("plan {} {typed}", point.display()));
    let row = |name: &str| {
        let rows = plan["budget"]["rows"].as_array().unwrap();
        rows.iter().find(|row| row["element"] == name).unwrap_or_else(|| panic!("{name}: {rows:?}")).clone()
    };
    let number = |name: &str, key: &str| row(name)[key].as_f64().unwrap();
    // A clock that is a thousandth fast makes ranges a thousandth longer.
    let bias = number("clock", "range_bias");
    assert!((bias - 0.8e-3).abs() < 0.15e-3, "{bias}");
    // A third of -40 dB, and that is all that a sine's reading has beside itself.
    let snr = number("distortion", "snr_db");
    assert!((snr - 49.5).abs() < 1.0, "{snr}");
    // 8 bits of a full-scale wave.
    let snr = number("converter", "snr_db");
    assert!((snr - 49.9).abs() < 1.5, "{snr}");
    let (f, jitter) = (12e3, 1e-6);
    let turn: f64 = std::f64::consts::TAU * f * jitter;
    assert!((number("jitter", "snr_db") + 20.0 * turn.log10()).abs() < 1.0, "{}", row("jitter"));
    assert!((number("noise", "snr_db") - 30.0).abs() < 1.0);
    assert!(number("all", "snr_db") < 30.0);
    assert!(done_json(path, &format!("plan {}", point.display())).get("budget").is_none());
    done(path, &format!("image {} -o out -q {typed}", point.display()));
    let report = json_file(&path.join("out/report.json"));
    assert_names(report["physics"].to_string(), &["switch mixer", "1000 ppm", "8 bits", "scatter"]);
    assert_eq!(report["run"]["instrument"]["adc_bits"], 8);
}

#[test]
fn recordings_are_of_the_same_instrument_and_hold_no_mixer() {
    let folder = folder_with_two_reflectors();
    let path = folder.path();
    // 8 ms are whole periods of all tones.
    let times = "--set recording.dwell=0.016 --set recording.settling=0.008 --set recording.reference=0";
    let typed = "--set instrument.amplifier_band=[200,16000] --set instrument.microphone_band=[100,20000] \
                 --set instrument.harmonics_db=[-30,-20] --set instrument.filter=integration --set instrument.decay=0.003 \
                 --set instrument.clock_error=40 --set instrument.adc_bits=20";
    let recorded = format!("{SETTINGS} {times} --set recording.sample_rate=96000");
    let facts = done_json(path, &format!("simulate two.csv -o a.wav {recorded} {typed}"));
    done(
        path,
        &format!("import a.wav -o recorded.npz {recorded} --set recording.gain_db={}", facts["gain_db"]),
    );
    done(path, &format!("simulate two.csv -o mixed.npz {SETTINGS} {times} {typed}"));
    done(path, &format!("simulate two.csv -o ideal.npz {SETTINGS}"));
    let [ideal, mixed, recorded] =
        ["ideal", "mixed", "recorded"].map(|name| read_cube(&path.join(name).with_extension("npz")).samples);
    let (change, error) = (relative_difference(&mixed, &ideal), relative_difference(&recorded, &mixed));
    println!("changed {change:.1e}, recorded against mixed {error:.1e}");
    assert!(change > 0.2 && error < 1e-3, "{change} {error}");
    let wav = format!("simulate two.csv -o b.wav {SETTINGS} --set recording.dwell=0.02");
    let switch = "--set instrument.mixer=switch --set instrument.harmonics_db=[-40,-40]";
    refused(path, &format!("{wav} {switch}"), 2, &["[instrument] mixer", "switch", ".npz"]);
    let low_pass = "--set instrument.filter=low-pass";
    refused(path, &format!("{wav} {low_pass}"), 2, &["[instrument] filter", "low-pass", "import"]);
    assert!(!path.join("b.wav").exists());
    done(path, &format!("simulate two.csv -o a.npz {SETTINGS}"));
    refused(path, "ascan a.npz --set instrument.jitter=1e-6", 2, &["instrument.jitter", "measured"]);
}
