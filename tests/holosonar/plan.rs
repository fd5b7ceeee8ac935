//! The predictions of `plan`, the memory limit, and volumes that are written depth by depth.

use crate::binary::{done, done_json, files_below, json_file, names_below, refused, shipped, small};

#[test]
fn plan_predicts_what_image_writes_and_touches_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let scene = shipped("point.toml");
    let planned = done_json(folder.path(), &format!("plan {}", scene.display()));
    assert_eq!(files_below(folder.path()), Vec::<std::path::PathBuf>::new());
    let text = done(folder.path(), &format!("plan {}", scene.display()));
    for words in ["* convolution", "backprojection", "direct", "operations", "memory", "writes"] {
        assert!(text.contains(words), "`{words}` is missing: {text}");
    }
    done(folder.path(), &format!("image {} -o out -q", scene.display()));
    let mut predicted: Vec<String> = serde_json::from_value(planned["files"].clone()).unwrap();
    predicted.sort();
    assert_eq!(names_below(&folder.path().join("out")), predicted);
    let report = json_file(&folder.path().join("out/report.json"));
    let chosen = planned["chosen"].as_u64().unwrap() as usize;
    assert_eq!(planned["methods"][chosen]["method"], report["method"]);
    assert_eq!(planned["plan"], report["plan"]);
}

#[test]
fn the_memory_limit_is_kept_and_a_refusal_says_what_would_fit() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small("corner.toml");
    let words = format!("image {} -o out --memory 20MiB", scene.display());
    refused(folder.path(), &words, 2, &["memory", "20 MiB", "--memory", "251 frequencies", "grid"]);
    refused(folder.path(), &format!("plan {} --memory lots", scene.display()), 2, &["--memory", "2GiB"]);
}

#[test]
fn a_volume_written_by_depths_is_the_volume_in_memory() {
    let folder = tempfile::tempdir().unwrap();
    let scene = shipped("point.toml");
    done(folder.path(), &format!("simulate {} -o cube.npz -q", scene.display()));
    let set = "--set output.formats=[\"exr\",\"npz\",\"vdb\"]";
    let names = "-o a.npz -o a.exr -o a.vti -o a.nrrd -o a.vdb";
    done(folder.path(), &format!("reconstruct cube.npz -c {} {names} {set} -q", scene.display()));
    done(folder.path(), &format!("image cube.npz -c {} -o out {set} -q", scene.display()));
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert_eq!(bytes("a.npz"), bytes("out/volume.npz"));
    assert_eq!(bytes("a.exr"), bytes("out/volume.exr"));
    assert_eq!(bytes("a.vdb"), bytes("out/volume.vdb"));
    let info = |name: &str| done_json(folder.path(), &format!("info {name}"));
    let peak = info("a.npz")["peak_amplitude"].clone();
    assert!(peak.as_f64().unwrap() > 0.5);
    assert_eq!(info("a.vti")["peak_amplitude"], peak);
    assert_eq!(info("a.nrrd")["peak_amplitude"], peak);
}

#[test]
fn a_spiral_counted_along_one_side_is_asked_about() {
    let folder = tempfile::tempdir().unwrap();
    for (count, asked) in [(120, true), (10, false)] {
        let set = format!("array.layout=spiral --set array.extent=1 --set array.count={count}");
        let planned =
            done_json(folder.path(), &format!("plan {} --set {set}", small("corner.toml").display()));
        assert_eq!(
            planned["warnings"].to_string().contains("elements = 120"),
            asked,
            "{}",
            planned["warnings"]
        );
    }
}

/// Searches that would grow with an absurd number are cut short, and the plan says so.
#[test]
fn plans_of_absurd_jobs_come_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small("corner.toml");
    for set in ["medium.sound_speed=0.343", "sweep.stop=10e6", "array.pitch=300", "array.pitch=1e6"] {
        let begun = std::time::Instant::now();
        let words = format!("plan {} --set {set}", scene.display());
        let text = done(folder.path(), &words);
        println!("{set}: {:?}", begun.elapsed());
        // A hundred times as long as it takes.
        assert!(begun.elapsed() < std::time::Duration::from_mins(1), "{set}: {:?}", begun.elapsed());
        assert!(text.contains("not searched"), "{set}: {text}");
        let planned = done_json(folder.path(), &words);
        assert!(!planned["design"]["aliasing"]["sidelobes"]["skipped"].as_array().unwrap().is_empty());
    }
    let usual = done_json(folder.path(), &format!("plan {}", scene.display()));
    assert!(usual["design"]["aliasing"]["sidelobes"]["skipped"].as_array().unwrap().is_empty());
}
