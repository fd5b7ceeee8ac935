//! Fault injection: jobs are killed, stopped, short of disk space or memory, and their checkpoints damaged or planted by
//! others. Nothing may be lost, and the final outputs are bit-identical to those of an undisturbed run.

#![cfg(unix)]

mod hostile;
mod killed;
mod signals;
mod soak;
mod starved;

use crate::binary::{Outcome, command, done, files_below, names_below, refused, run, shipped};
use crate::named::assert_names;
use crate::support::Random;
use signals::signal;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// A job of many blocks: its command line, and its output folder.
struct Job {
    words: &'static str,
    output: &'static str,
}

/// A lattice of microphones, summed literally: by virtual tones to a cube, to a volume, and all of it.
const SIMULATE: Job = Job {
    words: "simulate job.toml -o made/cube.npz --set array.count=[96,96] --set sweep.step=100",
    output: "made",
};
const RECONSTRUCT: Job =
    Job { words: "reconstruct cube.npz -c job.toml -o made/volume.npz -o made/volume.exr", output: "made" };
const IMAGE: Job = Job { words: "image job.toml -o made", output: "made" };
/// Scattered microphones: term by term to a cube, spread and convolved, and by back-projection.
const LITERAL: Job = Job {
    words: "simulate spiral.toml -o made/cube.npz --set detection.tolerance=0 --set sweep.step=20",
    output: "made",
};
const SPIRAL: Job = Job { words: "reconstruct spiral.npz -c spiral.toml -o made/volume.vti", output: "made" };
const SPIRAL_IMAGE: Job = Job { words: "image spiral.toml -o made", output: "made" };
const RANDOM: Job =
    Job { words: "reconstruct random.npz -c random.toml -o made/volume.nrrd", output: "made" };
/// A refinement, whose blocks are what it has after a step.
const REFINED: Job = Job {
    words: "image refined.toml -o made --set refine.method=fista --set refine.steps=12",
    output: "made",
};
const JOBS: [&Job; 8] =
    [&SIMULATE, &RECONSTRUCT, &IMAGE, &LITERAL, &SPIRAL, &SPIRAL_IMAGE, &RANDOM, &REFINED];

/// A folder with a scene and run files that take some hundred milliseconds each, in many blocks.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::copy(shipped("meshes/corner.obj"), folder.path().join("corner.obj")).unwrap();
    let scene = |name: &str, step: u32, array: &str, half: f64, pitch: [f64; 3], method: &str| {
        let text = format!(
            "[scene]\nmesh = \"corner.obj\"\nunit = \"m\"\nup = \"none\"\n[sweep]\nstart = 10000.0\nstop = 20000.0\nstep = {step}.0\n\
             [array]\n{array}\nextent = [1.0, 1.0]\n\
             [grid]\nx = [-{half}, {half}]\ny = [-{half}, {half}]\nz = [1.2, 2.3]\npitch = {pitch:?}\n\
             [reconstruct]\nmethod = \"{method}\"\n[output]\nformats = [\"exr\", \"npz\"]\n"
        );
        fs::write(folder.path().join(name), text).unwrap();
    };
    scene("job.toml", 400, "count = [16, 16]", 0.6, [0.025, 0.025, 0.03], "direct");
    let spiral = "layout = \"spiral\"\nelements = 900";
    scene("spiral.toml", 100, spiral, 0.45, [0.015, 0.015, 0.008], "convolution");
    // On one lattice with the array.
    scene("refined.toml", 200, "count = [16, 16]", 0.4, [1.0 / 30.0, 1.0 / 30.0, 0.02], "auto");
    let random = "layout = \"random\"\nelements = 400";
    scene("random.toml", 100, random, 0.6, [0.03, 0.03, 0.01], "backprojection");
    // Two blocks, each of which takes as long as the others' whole jobs.
    scene("slow.toml", 400, "count = [40, 40]", 0.6, [0.0095, 0.0095, 1.0], "direct");
    folder
}

/// Name and content of every file of an output, without the timings.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let content = |path: PathBuf| {
        let mut bytes = fs::read(&path).unwrap();
        let name = path.strip_prefix(folder).unwrap().to_owned();
        if ["report.json", "report.html"].iter().any(|timed| name.ends_with(timed)) {
            let text = String::from_utf8(bytes).unwrap();
            let (before, rest) = text.split_once("\"timings\": {").unwrap();
            bytes = format!("{before}{}", rest.split_once('}').unwrap().1).into_bytes();
        }
        (name, bytes)
    };
    files_below(folder).into_iter().map(content).collect()
}

/// What an undisturbed run of a job writes; the folder is left without it.
fn undisturbed(folder: &Path, job: &Job) -> (Vec<(PathBuf, Vec<u8>)>, Duration) {
    if let ["reconstruct", cube, "-c", run, ..] = job.words.split(' ').collect::<Vec<_>>()[..]
        && !folder.join(cube).exists()
    {
        done(folder, &format!("simulate {run} -o {cube} -q"));
    }
    let begun = Instant::now();
    done(folder, &format!("{} -q", job.words));
    let seconds = begun.elapsed();
    let contents = contents(&folder.join(job.output));
    fs::remove_dir_all(folder.join(job.output)).unwrap();
    (contents, seconds)
}

/// Asserts that an output has the files of an undisturbed run and no others.
fn assert_same(folder: &Path, job: &Job, expected: &[(PathBuf, Vec<u8>)]) {
    let found = contents(&folder.join(job.output));
    let names = |files: &[(PathBuf, Vec<u8>)]| files.iter().map(|(name, _)| name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&found), names(expected), "{}", job.words);
    for ((name, found), (_, expected)) in found.iter().zip(expected) {
        assert!(found == expected, "{}: {} differs", job.words, name.display());
    }
}

fn start(folder: &Path, words: &str) -> Child {
    let mut command = command(folder, words.split_whitespace());
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

fn end(child: Child) -> Outcome {
    Outcome::of(child.wait_with_output().unwrap())
}

/// Number of blocks that a run reused from an interrupted one, as its note says.
fn reused(ran: &Outcome) -> usize {
    let Some(note) = ran.stderr.lines().find(|line| line.contains("an interrupted run: ")) else { return 0 };
    let words: Vec<&str> = note.split_whitespace().collect();
    let count = words.windows(2).find(|pair| pair[1].starts_with("block"));
    count.unwrap_or_else(|| panic!("no number of blocks: {note}"))[0].parse().unwrap()
}

/// The checkpoint files in a job's output folder.
fn states(folder: &Path, job: &Job) -> Vec<PathBuf> {
    let files = files_below(&folder.join(job.output));
    files.into_iter().filter(|path| path.extension().is_some_and(|e| e == "resume")).collect()
}

#[test]
fn a_job_shorter_than_the_interval_stores_no_checkpoint() {
    let folder = workplace();
    let folder = folder.path();
    let mut child = start(folder, &format!("{} --checkpoint-every 3600", IMAGE.words));
    while child.try_wait().unwrap().is_none() {
        assert_eq!(states(folder, &IMAGE), Vec::<PathBuf>::new());
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(end(child).status, 0);
}

/// Path and content of a checkpoint of the reconstruction.
fn a_state(folder: &Path) -> (PathBuf, Vec<u8>) {
    let ran = signal(folder, &RECONSTRUCT, "--checkpoint-every 0", &["-TERM"]);
    assert_eq!(ran.status, 143, "{}", ran.stderr);
    let path = states(folder, &RECONSTRUCT).remove(0);
    let bytes = fs::read(&path).unwrap();
    (path, bytes)
}

#[test]
fn damaged_state_is_computed_again() {
    let folder = workplace();
    let folder = folder.path();
    let (expected, _) = undisturbed(folder, &RECONSTRUCT);
    let (path, whole) = a_state(folder);
    let mut random = Random::new(3);
    let (mut flipped, mut cut) = (0, 0);
    for turn in 0..6 {
        let mut state = whole.clone();
        if turn % 2 == 0 {
            // Headings are few bytes among many; half of the flips go there.
            let most = if turn % 4 == 0 { 192 } else { state.len() };
            state[random.whole(0, most - 1)] ^= 1 << random.whole(0, 7);
            flipped += 1;
        } else {
            state.truncate(random.whole(0, state.len() - 1));
            cut += 1;
        }
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, state).unwrap();
        let ran = end(start(folder, RECONSTRUCT.words));
        assert_eq!(ran.status, 0, "{}", ran.stderr);
        assert_same(folder, &RECONSTRUCT, &expected);
    }
    println!(
        "{flipped} states with a flipped bit and {cut} that were cut off: nothing of it is in any result"
    );
}

#[test]
fn state_of_another_job_is_not_mixed_in() {
    let folder = workplace();
    let folder = folder.path();
    let (expected, _) = undisturbed(folder, &RECONSTRUCT);
    let (path, state) = a_state(folder);
    // Other parameters.
    let other = format!("{} --set medium.sound_speed=340 --set reconstruct.window=hann", RECONSTRUCT.words);
    let ran = end(start(folder, &other));
    assert_eq!((ran.status, reused(&ran)), (0, 0), "{}", ran.stderr);
    assert_names(ran.stderr, &["note: ", "made", "other"]);
    assert!(!path.exists(), "the output is complete, and the state gone");
    assert!(contents(&folder.join("made")) != expected);
    // Another cube under the same name, of the same time and size.
    fs::write(&path, &state).unwrap();
    let times = fs::metadata(folder.join("cube.npz")).unwrap().modified().unwrap();
    done(folder, "simulate job.toml -o cube.npz -q --set reflectors.seed=2");
    fs::File::options().write(true).open(folder.join("cube.npz")).unwrap().set_modified(times).unwrap();
    let ran = end(start(folder, RECONSTRUCT.words));
    assert_eq!((ran.status, reused(&ran)), (0, 0), "{}", ran.stderr);
    // A state under another's name.
    done(folder, "simulate job.toml -o cube.npz -q");
    let (right, _) = a_state(folder);
    let mut forged = state;
    forged[20] ^= 1;
    fs::write(&right, forged).unwrap();
    let ran = end(start(folder, RECONSTRUCT.words));
    assert_eq!((ran.status, reused(&ran)), (0, 0), "{}", ran.stderr);
    assert_same(folder, &RECONSTRUCT, &expected);
}

#[test]
fn clocks_do_not_matter() {
    let folder = workplace();
    let folder = folder.path();
    let (expected, _) = undisturbed(folder, &RECONSTRUCT);
    for seconds in [0u64, 5_000_000_000] {
        let (path, _) = a_state(folder);
        let time = std::time::UNIX_EPOCH + Duration::from_secs(seconds);
        for path in [&path, &folder.join("cube.npz"), &folder.join("job.toml")] {
            fs::File::options().write(true).open(path).unwrap().set_modified(time).unwrap();
        }
        let ran = end(start(folder, RECONSTRUCT.words));
        assert!(ran.status == 0 && reused(&ran) > 0, "{}", ran.stderr);
        println!("files of the second {seconds}: {} blocks were not computed again", reused(&ran));
        assert_same(folder, &RECONSTRUCT, &expected);
        fs::remove_dir_all(folder.join("made")).unwrap();
    }
}

#[test]
fn another_process_at_the_same_job_is_noticed() {
    let folder = workplace();
    let folder = folder.path();
    undisturbed(folder, &RECONSTRUCT);
    let (path, _) = a_state(folder);
    let held = fs::File::options().write(true).open(&path).unwrap();
    held.lock().unwrap();
    refused(folder, RECONSTRUCT.words, 2, &[path.file_name().unwrap().to_str().unwrap(), "process"]);
    drop(held);
    assert_eq!(run(folder, RECONSTRUCT.words).status, 0);
}

#[test]
fn what_killed_processes_left_of_a_file_is_removed() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for name in [".cube.npz.aB3dE6.part", ".cube.npz.busy00.part", ".cube.npz.part", ".other.npz.aB3dE6.part"]
    {
        fs::write(path(name), "half").unwrap();
    }
    let busy = fs::File::options().write(true).open(path(".cube.npz.busy00.part")).unwrap();
    busy.lock().unwrap();
    done(folder.path(), &format!("simulate {} -o cube.npz", shipped("point.toml").display()));
    assert_eq!(
        names_below(folder.path()),
        [".cube.npz.busy00.part", ".cube.npz.part", ".other.npz.aB3dE6.part", "cube.npz"]
    );
}

#[test]
fn threads_change_no_byte() {
    let folder = workplace();
    let folder = folder.path();
    for job in [&SIMULATE, &RECONSTRUCT, &IMAGE, &SPIRAL] {
        let (expected, _) = undisturbed(folder, job);
        for threads in [1, 16] {
            done(folder, &format!("{} -q -j {threads}", job.words));
            assert_same(folder, job, &expected);
            fs::remove_dir_all(folder.join(job.output)).unwrap();
        }
    }
}
