//! Work that several processes share gives the bytes of one: for any number of parts, by every method, and after segments
//! were deleted, cut off and altered.

use crate::binary::refused;
use crate::named::assert_names;
use holosonar::checkpoint::Checkpoint;
use holosonar::config::RunFile;
use holosonar::pipeline::{
    JobOptions, Unit, UnitStage, Wanted, WorkDone, image_scene, units_of_scene, work_on_scene,
};
use num_complex::Complex32;
use std::fs;
use std::path::{Path, PathBuf};
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

pub(crate) fn job(typed: &[&str]) -> (tempfile::TempDir, RunFile) {
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

pub(crate) fn segments(folder: &Path) -> Vec<PathBuf> {
    with_ending(folder, "unit")
}

pub(crate) fn with_ending(folder: &Path, ending: &str) -> Vec<PathBuf> {
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

pub(crate) fn is_shared(path: &Path) -> bool {
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
