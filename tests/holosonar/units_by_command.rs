//! Work that several processes share, by commands: of simulations, recordings, volumes and images, and what the commands say.

use crate::binary::{command, done, done_json, refused, run, small};
use crate::named::assert_names;
use crate::units::{is_shared, job, segments, with_ending};
use holosonar::checkpoint::Checkpoint;
use holosonar::pipeline::{JobOptions, Wanted, simulate_scene, work_on_simulation};
use std::fs;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

#[test]
fn reflectors_are_placed_by_one_process_and_again_where_they_are_lost() {
    let folder = tempfile::tempdir().unwrap();
    // A part of the corner is behind the array, which is said by everyone.
    let behind = "--set scene.translate=[0,0,-1.9]";
    placed_by_one(&folder.path().join("straight"), behind);
    let rough = "--set reflectors.surface=rough --set reflectors.roughness=0.1 --set reflectors.spacing=0.03";
    let detours = "--set scene.bounces=2 --set scene.edges=true";
    placed_by_one(&folder.path().join("detours"), &format!("{behind} {rough} {detours}"));
}

fn placed_by_one(folder: &Path, typed: &str) {
    fs::create_dir(folder).unwrap();
    let typed = format!("{} --set sweep.step=400 {typed}", small("corner.toml").display());
    let told = |words: &str| {
        let ran = run(folder, words);
        assert_eq!(ran.status, 0, "{}", ran.stderr);
        ran.stderr
    };
    let whole = told(&format!("simulate {typed} -o whole/cube.npz -v"));
    assert_names(&whole, &["behind the array", "sampling surfaces"]);
    let work = |part: u32| told(&format!("work {typed} -o parts/cube.npz --part {part}/3 -v"));
    assert_names(work(1), &["behind the array", "sampling surfaces"]);
    // The tiles are shared, too, in a smaller file.
    let shared = segments(&folder.join("parts")).into_iter().filter(|path| is_shared(path));
    let shared = &shared.max_by_key(|path| fs::metadata(path).unwrap().len()).unwrap();
    let second = work(2);
    assert_names(&second, &["behind the array", "another process"]);
    assert!(!second.contains("sampling"), "{second}");
    let mut bytes = fs::read(shared).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(shared, &bytes).unwrap();
    assert_names(work(3), &["damaged", "sampling surfaces"]);
    assert!(fs::read(shared).unwrap() != bytes, "it is mended");
    assert_names(told(&format!("simulate {typed} -o parts/cube.npz -v")), &["another process", "taking up"]);
    let [shared, whole] = ["parts", "whole"].map(|of| fs::read(folder.join(of).join("cube.npz")).unwrap());
    assert!(shared == whole);
    assert!(segments(&folder.join("parts")).is_empty(), "nothing is left");
}

#[test]
fn cubes_are_shared_and_the_command_says_what_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small("corner.toml");
    let folder = folder.path();
    done(folder, &format!("simulate {} -o cube.npz", scene.display()));
    let settings = "--set grid.x=[-0.3,0.3] --set grid.y=[-0.3,0.3] --set grid.z=[1.5,1.8] --set grid.pitch=[0.03333333333333333,0.03333333333333333,0.01]";
    done(folder, &format!("image cube.npz -o whole {settings}"));
    let listed = done_json(folder, &format!("plan cube.npz --units {settings}"));
    assert_eq!(listed.as_array().unwrap().len(), 32);
    assert_eq!((&listed[0]["stage"], &listed[1]["stage"]), (&"compress".into(), &"reconstruct".into()));
    let half = done_json(folder, &format!("work cube.npz -o parts --part 1/2 {settings}"));
    assert_eq!((half["computed"].as_array().unwrap().len(), half["left"].as_u64()), (16, Some(16)));
    let numbers: Vec<u64> = (16..32).collect();
    assert_eq!((&half["missing"], &half["simulation"]), (&serde_json::json!(numbers), &0.into()));
    // At once, and both halves twice.
    let words = |part: u32| format!("work cube.npz -o parts --part {part}/2 {settings}");
    let start =
        |part| command(folder, words(part).split_whitespace()).stdout(Stdio::piped()).spawn().unwrap();
    let processes = [1, 2, 1, 2].map(start);
    let texts =
        processes.map(|process| String::from_utf8(process.wait_with_output().unwrap().stdout).unwrap());
    assert!(texts.iter().all(|text| text.contains("of 32 units")), "{texts:?}");
    assert_names(done(folder, &words(2)), &["16 were there", "image"]);
    done(folder, &format!("image cube.npz -o parts {settings}"));
    assert_eq!(
        fs::read(folder.join("parts/volume.npz")).unwrap(),
        fs::read(folder.join("whole/volume.npz")).unwrap()
    );
    assert!(segments(&folder.join("parts")).is_empty(), "they are deleted with the checkpoint");
}

/// What a command writes, from units that three processes computed beside it before; `typed` is what the two have in common.
fn shared_and_whole(folder: &Path, (command, typed): (&str, &str), names: &[&str]) {
    let first = names[0];
    done(folder, &format!("{command} {typed} -o whole/{}", names.join(" -o whole/")));
    for part in 1..=3 {
        let told = done(folder, &format!("work {typed} -o parts/{first} --part {part}/3"));
        let expected = if part == 3 { ["all are there", command] } else { ["are left", "units"] };
        assert_names(told, &expected);
    }
    assert!(segments(&folder.join("parts")).len() > 1, "{command} {typed}");
    let ran = run(folder, &format!("{command} {typed} -o parts/{}", names.join(" -o parts/")));
    assert_eq!(ran.status, 0, "{}", ran.stderr);
    assert_names(&ran.stderr, &["taking up", "units that other processes have computed"]);
    for name in names {
        let [shared, whole] = ["parts", "whole"].map(|of| fs::read(folder.join(of).join(name)).unwrap());
        assert!(shared == whole, "{command} {typed}: {name}");
    }
    assert!(segments(&folder.join("parts")).is_empty(), "they are deleted with the checkpoint");
    assert!(with_ending(&folder.join("parts"), "nodes").is_empty(), "nor are nodes left");
}

#[test]
fn a_simulated_cube_and_a_recording_have_the_bytes_of_one_process() {
    let (folder, run) = job(&[]);
    let folder = folder.path();
    for settings in
        ["", "--set detection.kind=in-phase --set instrument.adc_bits=10", "--set sweep.stop=10e3"]
    {
        shared_and_whole(folder, ("simulate", &format!("run.toml {settings}")), &["cube.npz"]);
    }
    shared_and_whole(folder, ("simulate", "run.toml --set recording.dwell=0.02"), &["heard.wav"]);
    let harmonics = "run.toml --set recording.dwell=0.02 --set instrument.harmonics_db=[-20] --set instrument.clock_error=50";
    shared_and_whole(folder, ("simulate", harmonics), &["harmonics.wav"]);
    // Any number of parts, of which many have nothing to do.
    let simulated = |checkpoint: Checkpoint| {
        simulate_scene(&run, &JobOptions::default().with_checkpoint(&checkpoint)).unwrap().samples
    };
    let whole = simulated(Checkpoint::off());
    for of in [1, 7, 40, 1000] {
        let output = folder.join(format!("cube{of}.npz"));
        let beside = || Checkpoint::beside(&output, Duration::ZERO);
        let mut left = Vec::new();
        for part in 1..=of {
            let (checkpoint, wanted) = (beside(), Wanted::Part { part, of });
            let job = JobOptions::default().with_checkpoint(&checkpoint);
            left.push(work_on_simulation(&run, &output, &wanted, &job).unwrap().left);
        }
        assert_eq!(left.last(), Some(&0), "{of} parts");
        assert!(simulated(beside()) == whole, "{of} parts");
    }
}

#[test]
fn a_reconstructed_volume_has_the_bytes_of_one_process() {
    let (folder, _) = job(&[]);
    let folder = folder.path();
    done(folder, "simulate run.toml -o cube.npz");
    for settings in [
        "",
        "--set reconstruct.method=direct",
        "--set reconstruct.method=linear",
        "--set reconstruct.method=backprojection",
        "--set reconstruct.method=correlation --set reconstruct.sub_band=7",
        "--set grid.pitch=[0.004,0.004,0.002] --set output.components=complex",
    ] {
        let typed = format!("cube.npz -c run.toml {settings}");
        shared_and_whole(folder, ("reconstruct", &typed), &["volume.npz", "volume.vti"]);
    }
    // A volume needs no bandwidth, an image does.
    done(folder, "simulate run.toml -o tone.npz --set sweep.stop=10e3");
    shared_and_whole(folder, ("reconstruct", "tone.npz -c run.toml"), &["volume.nrrd", "volume.exr"]);
    refused(folder, "work tone.npz -c run.toml -o image --part 1/1", 2, &["frequencies", "bandwidth"]);
}

#[test]
fn the_output_of_work_says_whose_work_it_is() {
    let (folder, _) = job(&[]);
    let folder = folder.path();
    done(folder, "simulate run.toml -o cube.npz");
    refused(folder, "work run.toml -o volume.vti --part 1/1", 2, &["volume.vti", ".npz, .zarr, .wav"]);
    refused(folder, "work cube.npz -c run.toml -o heard.wav --part 1/1", 2, &["heard.wav", ".nrrd"]);
    refused(folder, "work cube.npz -c run.toml -o cube.npz --part 1/1", 2, &["cube.npz", "input"]);
    let refined = "work cube.npz -c run.toml -o volume.npz --part 1/1 --set refine.method=fista";
    refused(folder, refined, 2, &["[refine]", "`reconstruct`"]);
    // The units of one are none of another.
    done(folder, "work run.toml -o new/image --part 1/1");
    let cube = done_json(folder, "work run.toml -o new/cube.npz --part 1/1");
    assert_eq!((cube["found"].as_u64(), cube["left"].as_u64()), (Some(0), Some(0)));
    let units = cube["units"].as_u64().unwrap();
    let beyond = format!("work run.toml -o new/cube.npz --units 0-{units}");
    refused(folder, &beyond, 2, &["--units", &format!("0-{}", units - 1)]);
}
