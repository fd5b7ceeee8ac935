//! Work that several processes share gives the bytes of one: for any number of parts, by every method, and after segments
//! were deleted, cut off and altered.

use crate::binary::{command, done, done_json, refused, run, small};
use crate::named::assert_names;
use holosonar::checkpoint::Checkpoint;
use holosonar::config::RunFile;
use holosonar::pipeline::{
    JobOptions, Unit, UnitStage, Wanted, WorkDone, image_scene, simulate_scene, units_of_scene,
    work_on_scene, work_on_simulation,
};
use num_complex::Complex32;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::Duration;

/// A list of reflectors is imaged in a moment; noise is of the whole cube.
const RUN: &str = r#"
[scene]
mesh = "points.csv"
[sweep]
start = 10e3
stop = 14e3
step = 100.0
[array]
count = [12, 11]
pitch = [0.02, 0.02]
[detection]
snr_db = 20
[grid]
x = [-0.1, 0.1]
y = [-0.1, 0.1]
z = [0.8, 1.1]
pitch = [0.02, 0.02, 0.01]
"#;

fn job(typed: &[&str]) -> (tempfile::TempDir, RunFile) {
    let folder = tempfile::tempdir().unwrap();
    let points = "x,y,z,amplitude\n0.03,-0.02,0.95,1\n-0.06,0.05,1.02,0.5\n0.08,0.09,0.84,0.7\n";
    fs::write(folder.path().join("points.csv"), points).unwrap();
    fs::write(folder.path().join("run.toml"), RUN).unwrap();
    let typed: Vec<String> = typed.iter().map(|&typed| typed.to_owned()).collect();
    let run = RunFile::load(&folder.path().join("run.toml"), &typed).unwrap();
    (folder, run)
}

fn volume(run: &RunFile, folder: Option<&Path>) -> Vec<Complex32> {
    let checkpoint =
        folder.map_or(Checkpoint::off(), |folder| Checkpoint::within(folder, Duration::from_hours(1)));
    image_scene(run, &JobOptions::default().with_checkpoint(&checkpoint)).unwrap().image.volume.samples
}

fn work(run: &RunFile, folder: &Path, wanted: &Wanted) -> holosonar::error::Result<WorkDone> {
    let checkpoint = Checkpoint::within(folder, Duration::ZERO);
    work_on_scene(run, wanted, &JobOptions::default().with_checkpoint(&checkpoint))
}

/// Every part twice: first the simulation, of which the last alone finds all, then depths.
fn work_in_parts(run: &RunFile, folder: &Path, of: u64) {
    for _ in 0..2 {
        for part in 1..=of {
            work(run, folder, &Wanted::Part { part, of }).unwrap();
        }
    }
}

fn segments(folder: &Path) -> Vec<PathBuf> {
    with_ending(folder, "unit")
}

fn with_ending(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let mut found: Vec<_> =
        fs::read_dir(folder).into_iter().flatten().map(|entry| entry.unwrap().path()).collect();
    found.retain(|path| path.extension().is_some_and(|end| end == ending));
    found.sort();
    found
}

/// Those that are not of all processes.
fn finished_units(folder: &Path) -> Vec<PathBuf> {
    segments(folder).into_iter().filter(|path| !is_shared(path)).collect()
}

fn is_shared(path: &Path) -> bool {
    path.display().to_string().ends_with(".shared.unit")
}

#[test]
fn any_parts_give_the_bytes_of_one_process() {
    for typed in [
        &[][..],
        &["reconstruct.method=direct"],
        &["reconstruct.method=linear"],
        &["reconstruct.method=correlation", "reconstruct.sub_band=7"],
        &["reconstruct.method=backprojection"],
        &["reconstruct.tolerance=0"],
        &["reconstruct.compensate=true", "detection.kind=in-phase"],
        // Nodes from which voxels are interpolated, and lines of microphones.
        &["grid.pitch=[0.004,0.004,0.002]"],
        &["grid.pitch=[0.004,0.004,0.002]", "reconstruct.method=backprojection"],
        // Tones of stretches of depths, of which a part reads its own.
        &[
            "sweep.step=10",
            "array.count=[40,36]",
            "grid.z=[0.8,8]",
            "grid.pitch=[0.02,0.02,0.1]",
            "reconstruct.method=convolution",
        ],
        &["array.sources=[[0,0,0],[0.1,0,0],[0,0.2,0]]"],
        // Echoes at harmonics are simulated too, and readings, which remember the tone before, made of all.
        &[
            "instrument.mixer=switch",
            "instrument.harmonics_db=[-20,-20]",
            "instrument.filter=low-pass",
            "instrument.jitter=1e-6",
            "instrument.adc_bits=10",
            "recording.dwell=0.02",
        ],
        &["medium.interface={depth=0.5,sound_speed=1500}", "detection.tolerance=1e-4"],
    ] {
        let (folder, run) = job(typed);
        let whole = volume(&run, None);
        // Planning takes longer than these sums.
        let parts: &[u64] = if typed.is_empty() { &[1, 3, 7, 40] } else { &[3] };
        for of in parts {
            let shared = folder.path().join(of.to_string());
            work_in_parts(&run, &shared, *of);
            let units = units_of_scene(&run, &JobOptions::default()).unwrap();
            assert_eq!(finished_units(&shared).len(), units.len(), "{typed:?}, {of} parts");
            assert!(volume(&run, Some(&shared)) == whole, "{typed:?}, {of} parts");
        }
    }
}

#[test]
fn nodes_about_a_boundary_are_summed_by_one_process_and_again_where_they_are_lost() {
    let (folder, run) = job(&["grid.pitch=[0.004,0.004,0.002]"]);
    let whole = volume(&run, None);
    let units = units_of_scene(&run, &JobOptions::default()).unwrap();
    let depths = units.iter().filter(|unit| unit.stage == UnitStage::Reconstruct).map(|unit| unit.unit);
    let before = Wanted::Numbers(0..depths.min().unwrap());
    // Every boundary's are stored by the first that has depths beside it, and deleted by the second.
    let orders = [([1, 2, 3], [1, 1, 0]), ([3, 1, 2], [1, 2, 0]), ([2, 3, 1], [2, 1, 0])];
    for (order, expected) in orders {
        for (of, lost) in [(3, false), (3, true), (50, false)] {
            let shared = folder.path().join(format!("{of} {order:?} {lost}"));
            work(&run, &shared, &before).unwrap();
            let nodes = || with_ending(&shared, "nodes");
            let mut seen = Vec::new();
            for part in order.into_iter().chain(1..=of) {
                work(&run, &shared, &Wanted::Part { part, of }).unwrap();
                seen.push(nodes().len());
                for path in nodes().iter().filter(|_| lost) {
                    let mut bytes = fs::read(path).unwrap();
                    let at = bytes.len() - 9;
                    bytes[at] ^= 4;
                    fs::write(path, bytes).unwrap();
                }
            }
            match (of, lost) {
                (3, false) => assert_eq!(seen[..3], expected, "{order:?}"),
                (3, true) => assert_eq!(seen[0], expected[0], "{order:?}"),
                // Of so few depths they may be more than these, and are not stored.
                _ => assert!(seen.iter().all(|count| *count < 50), "{order:?}: {seen:?}"),
            }
            assert!(volume(&run, Some(&shared)) == whole, "{of} {order:?} {lost}");
        }
    }
}

#[test]
fn lost_and_damaged_segments_are_computed_again() {
    let (folder, run) = job(&[]);
    let whole = volume(&run, None);
    let shared = folder.path().join("shared");
    work_in_parts(&run, &shared, 2);
    let damage = |seed: usize| {
        for (i, path) in segments(&shared).into_iter().enumerate() {
            let mut bytes = fs::read(&path).unwrap();
            let middle = bytes.len() * 3 / 4;
            match (i + seed) % 5 {
                _ if bytes.is_empty() => {}
                0 => fs::remove_file(&path).unwrap(),
                1 => fs::write(&path, &bytes[..middle]).unwrap(),
                2 => {
                    bytes[middle] ^= 4;
                    fs::write(&path, bytes).unwrap();
                }
                3 => fs::write(&path, b"").unwrap(),
                _ => {}
            }
        }
    };
    damage(0);
    assert!(volume(&run, Some(&shared)) == whole);
    // A worker that comes back makes good what is lost, too.
    damage(1);
    work_in_parts(&run, &shared, 3);
    let left = work(&run, &shared, &Wanted::Part { part: 1, of: 1 }).unwrap();
    assert_eq!((left.computed.len(), left.left), (0, 0));
    assert!(volume(&run, Some(&shared)) == whole);
}

#[test]
fn units_are_listed_and_computed_by_number_in_their_order() {
    let (folder, run) = job(&[]);
    let shared = folder.path().join("shared");
    let units = units_of_scene(&run, &JobOptions::default()).unwrap();
    let of = |stage| units.iter().filter(|unit| unit.stage == stage).collect::<Vec<&Unit>>();
    let (tiles, depths) = (of(UnitStage::Simulate), of(UnitStage::Reconstruct));
    let sweep = of(UnitStage::Compress);
    assert_eq!(depths.iter().map(|unit| unit.blocks).sum::<u64>(), 31);
    for stage in [&tiles, &sweep, &depths] {
        assert!((stage.iter().map(|unit| unit.share).sum::<f64>() - 1.0).abs() < 1e-12);
    }
    assert!(units.iter().enumerate().all(|(i, unit)| unit.unit == i as u64));
    let first = tiles.len() as u64;
    assert_eq!(sweep.iter().map(|unit| unit.unit).collect::<Vec<_>>(), [first]);
    for early in [first..first + 1, first + 1..first + 3] {
        let too_early = work(&run, &shared, &Wanted::Numbers(early)).unwrap_err();
        assert_names(too_early.to_string(), &["--units", "whole cube", "first"]);
    }
    assert!(finished_units(&shared).is_empty());
    let done = work(&run, &shared, &Wanted::Numbers(0..first)).unwrap();
    assert_eq!((done.computed.len() as u64, done.simulation_left), (first, 0));
    // Depths need the compressed sweep, which is a unit of its own.
    assert_eq!((done.left, done.depths), (1 + depths.len() as u64, depths.len() as u64));
    let done = work(&run, &shared, &Wanted::Numbers(first + 3..first + 5)).unwrap();
    assert_eq!((done.computed, done.left), (vec![first, first + 3, first + 4], depths.len() as u64 - 2));
    let again = work(&run, &shared, &Wanted::Numbers(first..first + 6)).unwrap();
    assert_eq!((again.computed, again.found), (vec![first + 1, first + 2, first + 5], 3));
    for numbers in [units.len() as u64..units.len() as u64 + 1, 3..3] {
        assert!(work(&run, &shared, &Wanted::Numbers(numbers)).is_err());
    }
}

#[test]
fn only_the_simulation_of_a_refined_volume_is_shared() {
    let (folder, run) = job(&["refine.method=fista", "refine.steps=2"]);
    let units = units_of_scene(&run, &JobOptions::default()).unwrap();
    assert!(units.iter().all(|unit| unit.stage == UnitStage::Simulate));
    let shared = folder.path().join("shared");
    work_in_parts(&run, &shared, 2);
    assert!(volume(&run, Some(&shared)) == volume(&run, None));
}

#[test]
fn segments_of_another_job_are_left_alone_and_named() {
    let (folder, run) = job(&[]);
    let shared = folder.path().join("shared");
    work_in_parts(&run, &shared, 1);
    let path = folder.path().join("run.toml");
    let other =
        RunFile::load(&path, &["reflectors.seed=2".to_owned(), "detection.snr_db=10".to_owned()]).unwrap();
    assert!(volume(&other, Some(&shared)) == volume(&other, None));
    refused(folder.path(), "work run.toml -o shared --part 4/3", 2, &["--part", "4/3", "K/N"]);
    refused(folder.path(), "work run.toml -o shared --units 3-900", 2, &["--units", "0-"]);
}

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
