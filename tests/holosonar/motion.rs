//! Motion while the tones are played: simulated, predicted, compensated, found, and refused where it cannot be.

use crate::binary::{done, done_json, json_file, refused, small};
use crate::named::assert_names;
use crate::support::write_point_run;
use std::fs;

/// A point that moves away by some centimetres, before a small array.
const RUN: &str = r#"
[scene]
mesh = "point.csv"
occlusion = "none"
velocity = [0.0, 0.01, 0.05]
[sweep]
start = 9e3
stop = 15e3
step = 200.0
[recording]
dwell = 0.02
[array]
count = [9, 8]
pitch = [0.03, 0.03]
[grid]
x = [-0.06, 0.06]
y = [-0.06, 0.06]
z = [0.8, 1.1]
pitch = [0.02, 0.02, 0.01]
"#;

#[test]
fn a_point_that_moves_is_predicted_compensated_and_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    write_point_run(path, RUN);
    let planned = done_json(path, "plan run.toml");
    let smear = &planned["motion"][0];
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    assert_eq!(smear["velocity"], serde_json::json!([0.0, 0.01, 0.05]));
    assert!((number(&smear["duration"]) - 0.62).abs() < 1e-9);
    // τ = 12 kHz · 0.02 s/200 Hz + 0.3 s.
    assert!((number(&smear["displacement"][2]) - 0.05 * 1.5).abs() < 1e-9);
    let left = number(&smear["amplitude"]);
    assert!((0.3..0.95).contains(&left), "{left}");
    assert_names(planned["physics"].to_string(), &["(0, 0.01, 0.05) m/s", "75) mm"]);
    done(path, "image run.toml -o still");
    let report = json_file(&path.join("still/report.json"));
    assert_eq!(report["motion"], planned["motion"]);
    // Between two voxels there is a little less.
    let peak = number(&report["peak_amplitude"]);
    assert!((left - 0.12..left + 0.02).contains(&peak), "{peak} {left}");

    let velocity = "--set medium.velocity=[0.0,0.01,0.05]";
    let frame = done_json(path, &format!("plan run.toml {velocity}"));
    assert!(frame.get("motion").is_none());
    assert_names(frame["physics"].to_string(), &["frame that moves", "0.02 s from one tone to the next"]);
    done(path, "simulate run.toml -o cube.npz -q");
    done(path, &format!("reconstruct cube.npz -c run.toml {velocity} -o moving.npz"));
    let info = done_json(path, "info moving.npz");
    assert!((number(&info["peak_amplitude"]) - 1.0).abs() < 1e-3, "{info}");
    // Another time between tones undoes it.
    done(
        path,
        &format!("reconstruct cube.npz -c run.toml {velocity} --set recording.dwell=0.01 -o half.npz"),
    );
    assert!(number(&done_json(path, "info half.npz")["peak_amplitude"]) < 0.99);

    let y = "--set medium.velocity=[0.0,0.01,0.0]";
    let search =
        format!("autofocus cube.npz -c run.toml {y} --over velocity-z --range -0.05,0.15 --trials 21");
    let found = done_json(path, &search);
    assert_eq!(found["verdict"], "found", "{found}");
    let error = (number(&found["best"]) - 0.05).abs();
    assert!(error < 2.0 * number(&found["standard_error"]) && error < 0.01, "{found}");
    assert!(found["setting"].as_str().unwrap().starts_with("medium.velocity=[0.0,0.01,0.0"), "{found}");
}

#[test]
fn a_part_moves_by_itself() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let plate = |x: f64| {
        let corner = |dx: f64, dy: f64| format!("v {} {} 1\n", x + dx, dy);
        [corner(-0.05, -0.1), corner(0.05, -0.1), corner(0.05, 0.1), corner(-0.05, 0.1), "f 1 2 3 4\n".into()]
            .concat()
    };
    fs::write(path.join("left.obj"), plate(-0.15)).unwrap();
    fs::write(path.join("right.obj"), plate(0.15)).unwrap();
    let part = |name: &str, more: &str| {
        format!("[[scene.parts]]\nmesh = \"{name}.obj\"\nunit = \"m\"\nup = \"none\"\n{more}")
    };
    let rest = "[sweep]\nstart = 9e3\nstop = 15e3\nstep = 300.0\n[recording]\ndwell = 0.02\n[array]\ncount = 12\npitch = 0.04\n\
        [reflectors]\nspacing = 0.02\n[grid]\nx = [-0.2, 0.2]\ny = [-0.1, 0.1]\nz = [0.9, 1.15]\npitch = 0.02\n[output]\nreport = false\n";
    let text = part("left", "") + &part("right", "velocity = [0.0, 0.0, 0.05]\n") + rest;
    fs::write(
        path.join("two.toml"),
        text.replace("count = 12", "count = [12, 12]")
            .replace("pitch = 0.04", "pitch = [0.04, 0.04]")
            .replace("pitch = 0.02", "pitch = [0.02, 0.02, 0.01]"),
    )
    .unwrap();
    // With this seed neither plate is dark by chance.
    let complete = |out: &str, set: &str| {
        let report = done_json(path, &format!("image two.toml -o {out} --set reflectors.seed=3 {set}"));
        ["left", "right"].map(|name| report["materials"][name]["completeness"].as_f64().unwrap_or(0.0))
    };
    let at_rest = complete("rest", "--set scene.parts.1.velocity=[0.0,0.0,0.0]");
    let [still, moved] = complete("still", "");
    let [left, right] = complete("moving", "--set medium.velocity=[0.0,0.0,0.05]");
    let all = (at_rest, still, moved, left, right);
    assert!(at_rest[0] > 0.7 && (still - at_rest[0]).abs() < 0.06, "{all:?}");
    assert!(at_rest[1] > 0.9 && (right - at_rest[1]).abs() < 0.06, "{all:?}");
    assert!(moved < 0.1 && left < 0.1, "{all:?}");
}

#[test]
fn what_cannot_move_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    write_point_run(path, RUN);
    let corner = small("corner.toml");
    let corner = corner.display();
    let dwell = "--set recording.dwell=0.01";
    for (command, parts) in [
        (format!("plan {corner} --set scene.velocity=[0,0,0.1]"), &["scene.velocity", "dwell"][..]),
        (format!("plan {corner} --set medium.velocity=[0,0,0.1]"), &["medium.velocity", "dwell"]),
        (format!("plan {corner} {dwell} --set medium.velocity=[0,0,1e5]"), &["medium.velocity", "1e4"]),
        (
            format!(
                "plan {corner} {dwell} --set scene.velocity=[0,0,0.1] --set instrument.quadrature=passes"
            ),
            &["scene.velocity", "instrument.quadrature"],
        ),
        (
            format!("plan {corner} {dwell} --set medium.velocity=[0,0,0.1] --set refine.method=fista"),
            &["medium.velocity", "refine.method"],
        ),
        (
            format!(
                "plan {corner} {dwell} --set medium.velocity=[0,0,0.1] --set reconstruct.method=correlation"
            ),
            &["medium.velocity", "correlation"],
        ),
        ("work run.toml -o out --part 1/2".to_owned(), &["[scene] velocity", "simulate"]),
    ] {
        refused(path, &command, 2, parts);
    }
    done(path, "simulate run.toml -o cube.npz -q");
    let search = "autofocus cube.npz --over velocity-z --set grid.x=[-0.1,0.1] --set grid.y=[-0.1,0.1] --set grid.z=[0.8,1]";
    refused(path, search, 2, &["velocity-z", "[recording] dwell"]);
}
