//! Broken on purpose: jobs killed, stopped, starved of disk and memory, and their state damaged. Nothing may be lost, and
//! what comes out in the end is what an undisturbed run writes, byte for byte.

#![cfg(unix)]

mod starved;

use crate::binary::{Ran, command, done, files_below, refused, run, shipped};
use crate::support::Random;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A job of many blocks: what is typed, and what it writes.
struct Job {
    words: &'static str,
    output: &'static str,
}

const SIMULATE: Job = Job { words: "simulate job.toml -o made/cube.npz", output: "made" };
const RECONSTRUCT: Job =
    Job { words: "reconstruct cube.npz -c job.toml -o made/volume.npz -o made/volume.exr", output: "made" };
const IMAGE: Job = Job { words: "image job.toml -o made", output: "made" };
const JOBS: [&Job; 3] = [&SIMULATE, &RECONSTRUCT, &IMAGE];

/// A folder with a scene that takes some hundred milliseconds, in some tens of blocks.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::copy(shipped("meshes/corner.obj"), folder.path().join("corner.obj")).unwrap();
    let scene = "[scene]\nmesh = \"corner.obj\"\nunit = \"m\"\n[sweep]\nstart = 10000.0\nstop = 20000.0\nstep = 100.0\n\
                 [array]\ncount = [40, 40]\nextent = [1.0, 1.0]\n\
                 [grid]\nx = [-0.6, 0.6]\ny = [-0.6, 0.6]\nz = [1.2, 2.3]\npitch = [0.03, 0.03, 0.02]\n\
                 [reconstruct]\nmethod = \"backprojection\"\n[output]\nformats = [\"exr\", \"npz\"]\n";
    fs::write(folder.path().join("job.toml"), scene).unwrap();
    folder
}

/// Every file of an output by name and content, times aside.
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
    if job.words.contains("cube.npz -c") && !folder.join("cube.npz").exists() {
        done(folder, "simulate job.toml -o cube.npz -q");
    }
    let begun = Instant::now();
    done(folder, &format!("{} -q", job.words));
    let seconds = begun.elapsed();
    let contents = contents(&folder.join(job.output));
    fs::remove_dir_all(folder.join(job.output)).unwrap();
    (contents, seconds)
}

/// That an output is what an undisturbed run writes, and that nothing lies beside it.
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

fn end(child: Child) -> Ran {
    let output = child.wait_with_output().unwrap();
    Ran {
        status: output.status.code().unwrap_or(-1),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

/// Blocks that a run took from an earlier one, by what it says.
fn reused(ran: &Ran) -> usize {
    let said = ran.stderr.split_once("continuing an interrupted run: ");
    said.map_or(0, |(_, rest)| rest.split_once(' ').unwrap().0.parse().unwrap())
}

/// The state that lies in a job's output.
fn states(folder: &Path, job: &Job) -> Vec<PathBuf> {
    let files = files_below(&folder.join(job.output));
    files.into_iter().filter(|path| path.extension().is_some_and(|e| e == "resume")).collect()
}

/// Kills every job so many times, each at a moment that looks random, and goes on with it; gives kills and blocks that
/// were not computed again.
fn kill(times: usize, seed: u64, threads: &[&str]) -> (usize, usize) {
    let folder = workplace();
    let folder = folder.path();
    let mut random = Random::new(seed);
    let (mut kills, mut blocks) = (0, 0);
    for job in JOBS {
        let (expected, whole) = undisturbed(folder, job);
        let (mut killed, mut finished) = (0, 0);
        while killed < times || finished == 0 {
            let threads = threads[random.whole(0, threads.len() - 1)];
            let words = format!("{} --checkpoint-every 0 {threads}", job.words);
            let mut child = start(folder, &words);
            // Seldom enough to get somewhere, and often near the end, where files are written.
            let share = random.uniform(0.05, if killed < times { 0.9 } else { 30.0 });
            let until = Instant::now() + whole.mul_f64(share);
            while Instant::now() < until && child.try_wait().unwrap().is_none() {
                std::thread::sleep(Duration::from_millis(2));
            }
            let ended = child.try_wait().unwrap().is_some();
            if !ended {
                child.kill().unwrap();
            }
            let ran = end(child);
            assert!(ran.status == 0 || ran.status == -1, "{words}: {}", ran.stderr);
            blocks += reused(&ran);
            if ran.status == 0 {
                finished += 1;
                assert_same(folder, job, &expected);
                fs::remove_dir_all(folder.join(job.output)).unwrap();
            } else {
                killed += 1;
            }
        }
        kills += killed;
        // The last of them may have been killed.
        let _ = fs::remove_dir_all(folder.join(job.output));
    }
    (kills, blocks)
}

#[test]
fn a_killed_job_goes_on() {
    let (kills, blocks) = kill(2, 7, &[""]);
    println!("{kills} kills, {blocks} blocks were not computed again");
}

#[test]
#[ignore = "about two minutes"]
fn a_job_killed_twenty_times_goes_on() {
    let (kills, blocks) = kill(20, 1, &["", "-j 1", "-j 16"]);
    println!("{kills} kills, {blocks} blocks were not computed again");
    assert!(kills >= 60 && blocks > 60, "{kills} kills, {blocks} blocks");
}

/// Starts a job and sends it signals as soon as it has kept something.
fn signal(folder: &Path, job: &Job, options: &str, signals: &[&str]) -> Ran {
    let child = start(folder, &format!("{} {options}", job.words));
    let begun = Instant::now();
    while states(folder, job).is_empty() && begun.elapsed() < Duration::from_mins(1) {
        std::thread::sleep(Duration::from_millis(1));
    }
    for signal in signals {
        Command::new("kill").args([*signal, &child.id().to_string()]).status().unwrap();
    }
    end(child)
}

#[test]
fn a_signal_ends_the_block_and_says_how_to_go_on() {
    let folder = workplace();
    let folder = folder.path();
    let (expected, _) = undisturbed(folder, &IMAGE);
    for (name, status) in [("-INT", 130), ("-TERM", 143)] {
        let ran = signal(folder, &IMAGE, "--checkpoint-every 0", &[name]);
        assert_eq!(ran.status, status, "{}", ran.stderr);
        for words in ["interrupted; nothing was left half-written", "the same command goes on from there"] {
            assert!(ran.stderr.contains(words), "{}", ran.stderr);
        }
        assert_eq!(states(folder, &IMAGE).len(), 1);
        let ran = end(start(folder, IMAGE.words));
        assert_eq!(ran.status, 0, "{}", ran.stderr);
        assert!(reused(&ran) > 0, "{}", ran.stderr);
        println!("{name}: {} blocks were not computed again", reused(&ran));
        assert_same(folder, &IMAGE, &expected);
        fs::remove_dir_all(folder.join(IMAGE.output)).unwrap();
    }
}

#[test]
fn a_job_of_seconds_keeps_nothing() {
    let folder = workplace();
    let folder = folder.path();
    let child = start(folder, IMAGE.words);
    let mut child = child;
    while child.try_wait().unwrap().is_none() {
        assert_eq!(states(folder, &IMAGE), Vec::<PathBuf>::new());
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(end(child).status, 0);
}

/// A state of the reconstruction, by name and content.
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
            let most = if turn % 4 == 0 { 64 } else { state.len() };
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
    assert!(ran.stderr.contains("with other inputs or parameters; it is not used"), "{}", ran.stderr);
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
    refused(folder, RECONSTRUCT.words, 2, &["is in use", "another process"]);
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
    holosonar::files::write_atomically(&path("cube.npz"), |out| std::io::Write::write_all(out, b"whole"))
        .unwrap();
    let names: Vec<_> =
        files_below(folder.path()).iter().map(|p| p.file_name().unwrap().to_owned()).collect();
    assert_eq!(names, [".cube.npz.busy00.part", ".cube.npz.part", ".other.npz.aB3dE6.part", "cube.npz"]);
}

#[test]
fn threads_change_no_byte() {
    let folder = workplace();
    let folder = folder.path();
    for job in JOBS {
        let (expected, _) = undisturbed(folder, job);
        for threads in [1, 16] {
            done(folder, &format!("{} -q -j {threads}", job.words));
            assert_same(folder, job, &expected);
            fs::remove_dir_all(folder.join(job.output)).unwrap();
        }
    }
}
