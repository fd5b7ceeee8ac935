//! Disks that are full or may not be written, and too little memory.

use super::{RECONSTRUCT, end, reused, start, undisturbed, workplace};
use crate::binary::{Outcome, done, done_json, files_below, refused, run};
use crate::meshes::write_stl;
use crate::named::{all_named, assert_names};
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// A small file system of its own, while it lives; `None` where none may be mounted.
pub(super) struct Disk {
    at: PathBuf,
    /// The folder made for it, if one was.
    made: Option<tempfile::TempDir>,
}

impl Disk {
    fn mount(kilobytes: u64) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let mut disk = Self::mount_at(folder.path(), &format!("size={kilobytes}k"))?;
        disk.made = Some(folder);
        Some(disk)
    }

    /// In an empty folder.
    pub(super) fn mount_at(folder: &Path, options: &str) -> Option<Self> {
        let disk = Self { at: folder.to_owned(), made: None };
        if disk.set(options, false) {
            return Some(disk);
        }
        println!("skipped: no file system can be mounted here");
        None
    }

    pub(super) fn set(&self, options: &str, again: bool) -> bool {
        let options = if again { format!("remount,{options}") } else { options.to_owned() };
        let mount =
            Command::new("mount").args(["-t", "tmpfs", "-o", &options, "tmpfs"]).arg(&self.at).output();
        mount.is_ok_and(|output| output.status.success())
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.at).output();
        drop(self.made.take());
    }
}

#[test]
#[ignore = "mounts a file system, where it may"]
fn a_full_disk_loses_nothing() {
    let folder = workplace();
    // Term by term and on one thread: many blocks, and time to fill the disk meanwhile.
    let simulate = format!("{MANY_BLOCKS} -o");
    done(folder.path(), &format!("{simulate} expected.npz -q"));
    let expected = fs::read(folder.path().join("expected.npz")).unwrap();
    let kilobytes = expected.len() as u64 / 1024;
    let Some(disk) = Disk::mount(kilobytes / 2) else { return };
    let (path, ballast) = (disk.at.join("cube.npz"), disk.at.join("ballast"));
    let words = format!("{simulate} {}", path.display());
    // Known before the work.
    refused(folder.path(), &words, 1, &[disk.at.to_str().unwrap(), "free", "MiB"]);
    // Filled by another while the job runs: what was there stays, and so does the state.
    assert!(disk.set(&format!("size={}k", kilobytes * 8), true));
    fs::write(&path, "an older cube").unwrap();
    let child = start(folder.path(), &words);
    while !files_below(&disk.at).iter().any(|path| path.extension().is_some_and(|e| e == "resume")) {
        std::thread::sleep(Duration::from_millis(1));
    }
    let mut file = fs::File::create(&ballast).unwrap();
    while std::io::Write::write_all(&mut file, &[0; 4096]).is_ok() {}
    let ran = end(child);
    assert_eq!(ran.status, 1, "{}", ran.stderr);
    assert_names(ran.stderr, &["error: ", "cube.npz", "blocks", ".resume"]);
    assert_eq!(fs::read(&path).unwrap(), b"an older cube");
    drop(file);
    fs::remove_file(&ballast).unwrap();
    let ran = run(folder.path(), &words);
    assert_eq!(ran.status, 0, "{}", ran.stderr);
    println!("after the disk was full: {} blocks were not computed again", reused(&ran));
    assert!(reused(&ran) > 0);
    assert!(fs::read(&path).unwrap() == expected);
    assert_eq!(files_below(&disk.at), std::slice::from_ref(&path), "no state is left");
    // A disk that holds the output and little of the state: the job is done without it.
    fs::remove_file(&path).unwrap();
    assert!(disk.set(&format!("size={}k", kilobytes * 5 / 4), true));
    let ran = run(folder.path(), &words);
    assert_eq!(ran.status, 0, "{}", ran.stderr);
    assert!(ran.stderr.lines().any(|line| says_full(line, &disk.at)), "{}", ran.stderr);
    assert!(fs::read(&path).unwrap() == expected);
    println!("a disk with room for the cube and a quarter of its state: done without the state");
}

/// Whether a line is the note that the disk has no space for more of the checkpoint: for a job without an earlier
/// checkpoint it is the only note that names the folder.
fn says_full(line: &str, folder: &Path) -> bool {
    line.starts_with("note: ") && line.contains(folder.to_str().unwrap())
}

/// A simulation of 25 blocks, one after another.
const MANY_BLOCKS: &str = "simulate job.toml -j 1 --checkpoint-every 0 --set detection.tolerance=0 \
                           --set array.count=[40,40] --set sweep.step=40";

#[test]
#[ignore = "mounts a file system, where it may"]
fn a_disk_that_fills_in_the_middle_costs_no_block() {
    let folder = workplace();
    let folder = folder.path();
    undisturbed(folder, &RECONSTRUCT);
    let (mut tries, mut blocks) = (0, 0);
    // A volume grows on the disk beside its state, a cube is written when it is complete.
    for (job, name, growing) in [
        (MANY_BLOCKS, "cube.npz", 1),
        ("reconstruct cube.npz -c job.toml --checkpoint-every 0", "volume.npz", 2),
    ] {
        done(folder, &format!("{job} -q -o expected.npz"));
        let expected = fs::read(folder.join("expected.npz")).unwrap();
        for percent in [15, 30, 50, 70, 85] {
            // Space for the output, for the reserve, and for this share of the checkpoint.
            let bytes = expected.len() * (100 + growing * percent) / 100 + (1 << 20);
            let Some(disk) = Disk::mount(bytes as u64 / 1024) else { return };
            let (path, ballast) = (disk.at.join(name), disk.at.join("ballast"));
            let words = format!("{job} -o {}", path.display());
            let mut child = start(folder, &words);
            let mut said = BufReader::new(child.stderr.take().unwrap());
            let mut lines = String::new();
            while !lines.lines().any(|line| says_full(line, &disk.at)) {
                assert!(said.read_line(&mut lines).unwrap() > 0, "{words}: {lines}");
            }
            // What was left for the output is taken by another.
            let mut file = fs::File::create(&ballast).unwrap();
            while std::io::Write::write_all(&mut file, &[0; 4096]).is_ok() {}
            said.read_to_string(&mut lines).unwrap();
            let ran = end(child);
            drop(file);
            fs::remove_file(&ballast).unwrap();
            tries += 1;
            if ran.status == 0 {
                // The other came too late.
                assert!(fs::read(&path).unwrap() == expected);
                continue;
            }
            assert_eq!(ran.status, 1, "{lines}");
            assert_names(lines, &["error: ", name, "blocks", ".resume"]);
            assert!(!path.exists(), "half an output");
            assert!(disk.set(&format!("size={}k", expected.len() * 8 / 1024), true));
            let ran = run(folder, &words);
            assert_eq!(ran.status, 0, "{}", ran.stderr);
            println!("full at {percent} % of {name}: {} blocks were not computed again", reused(&ran));
            blocks += reused(&ran);
            assert!(fs::read(&path).unwrap() == expected);
            assert_eq!(files_below(&disk.at), [path], "no state is left");
        }
    }
    println!("{tries} disks that filled up, {blocks} blocks were not computed again");
    assert!(blocks >= 40, "{blocks} blocks");
}

#[test]
#[ignore = "mounts a file system, where it may"]
fn without_inodes_nothing_is_left() {
    let folder = workplace();
    undisturbed(folder.path(), &RECONSTRUCT);
    let Some(disk) = Disk::mount(20_000) else { return };
    let at = disk.at.as_path();
    // One inode is the root's. With one more the check before the work passes, with two more there are folders, but no file.
    for (inodes, words) in [
        (1, "simulate job.toml -o AT/cube.npz"),
        (1, "image job.toml -o AT/made"),
        (2, "simulate job.toml -o AT/a/cube.npz"),
        (2, "image job.toml -o AT/made"),
        (3, "simulate job.toml -o AT/a/b/cube.npz"),
        (3, "reconstruct cube.npz -c job.toml -o AT/a/b/volume.npz --checkpoint-every 0"),
        (3, "reconstruct cube.npz -c job.toml -o AT/a/b/volume.exr --checkpoint-every 0"),
    ] {
        assert!(disk.set(&format!("nr_inodes={inodes}"), true));
        let words = words.replace("AT", at.to_str().unwrap());
        let ran = run(folder.path(), &format!("{words} -q"));
        assert_eq!(ran.status, 1, "{words}: {}", ran.stderr);
        assert_names(ran.stderr, &["error: ", at.to_str().unwrap(), "cannot be written"]);
        let left: Vec<_> = fs::read_dir(at).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert!(left.is_empty(), "{words}: {left:?}");
    }
    assert!(disk.set("nr_inodes=100", true));
    done(folder.path(), &format!("image job.toml -o {}/made -q", at.display()));
}

#[test]
#[ignore = "mounts a file system, where it may"]
fn a_place_that_cannot_be_written_is_found_first() {
    let folder = workplace();
    undisturbed(folder.path(), &RECONSTRUCT);
    let Some(disk) = Disk::mount(1000) else { return };
    assert!(disk.set("ro", true));
    for words in [
        "simulate job.toml -o AT/cube.npz",
        "image job.toml -o AT/made",
        "reconstruct cube.npz -c job.toml -o AT/a.npz",
    ] {
        let words = words.replace("AT", disk.at.to_str().unwrap());
        refused(folder.path(), &words, 1, &[disk.at.to_str().unwrap(), "Read-only"]);
    }
    println!("three jobs with a read-only output: each is refused before its work");
}

/// Runs a job with a limit on its address space, bytes.
fn limited(folder: &Path, words: &str, bytes: u64) -> Outcome {
    let line = format!("ulimit -v {} && exec \"$0\" {words}", bytes / 1024);
    let mut shell = Command::new("sh");
    shell.current_dir(folder).args(["-c", &line, env!("CARGO_BIN_EXE_holosonar")]);
    // A trace takes memory, too.
    Outcome::of(shell.env("RUST_BACKTRACE", "0").output().unwrap())
}

#[test]
#[ignore = "some seconds and 600 MiB"]
fn a_limit_of_memory_is_kept_to() {
    let folder = workplace();
    let folder = folder.path();
    let finer = |pitch: &str| {
        let set = format!(
            "--set grid.pitch={pitch} --set reconstruct.method=convolution --set output.report=false"
        );
        let planned = done_json(folder, &format!("plan job.toml {set}"));
        (planned["memory"][0]["bytes"].as_u64().unwrap(), format!("image job.toml -o made -q {set}"))
    };
    let (bytes, words) = finer("[0.005,0.005,0.006]");
    let ran = limited(folder, &words, bytes + (512 << 20));
    assert_eq!(ran.status, 0, "{} planned, and 512 MiB more: {}", bytes, ran.stderr);
    let begun = Instant::now();
    let ran = limited(folder, &words, bytes / 2);
    // The C library sets 64 MiB of addresses aside for each thread, sooner or later: either this job is refused for what it
    // needs, or any job for what is left.
    let too_much = ran.status == 2 && all_named(&ran.stderr, &["error: memory: ", "--memory"]);
    let too_little = ran.status == 1 && all_named(&ran.stderr, &["error: memory: ", "`ulimit -v`"]);
    assert!(too_much || too_little, "{}: {}", ran.status, ran.stderr);
    println!("{bytes} bytes planned: done with 512 MiB more, refused with half after {:?}", begun.elapsed());
    // Where half is far more than that.
    let (bytes, words) = finer("[0.002,0.002,0.002]");
    let ran = limited(folder, &words, bytes / 2);
    assert_eq!(ran.status, 2, "{}", ran.stderr);
    assert_names(ran.stderr, &["error: memory: ", "--memory"]);
    println!("{bytes} bytes planned: refused with half");
}

#[test]
#[ignore = "a minute or two"]
fn with_too_few_addresses_a_job_is_done_or_says_so() {
    let folder = workplace();
    let folder = folder.path();
    let words = "image job.toml -o made --set reconstruct.method=convolution";
    let convolution = super::Job { words, output: "made" };
    // Most of what this takes is its mesh's.
    write_stl(&folder.join("large.stl"), 200_000);
    let words = "image job.toml -o made --set scene.mesh=large.stl --set reflectors.spacing=0.02";
    let mesh = super::Job { words, output: "made" };
    for job in super::JOBS.into_iter().chain([&convolution, &mesh]) {
        let (expected, _) = undisturbed(folder, job);
        let (mut done, mut said, mut late) = (0, 0, 0);
        // Below the first of these the system does not load the program; above the last of them any of the jobs is done.
        for mebibytes in (32..=400).step_by(16) {
            let ran = limited(folder, &format!("{} -q", job.words), mebibytes << 20);
            let told = |words: &[&str]| words.iter().any(|words| ran.stderr.contains(words));
            match ran.status {
                0 => {
                    super::assert_same(folder, job, &expected);
                    done += 1;
                }
                2 if told(&["--memory"]) => said += 1,
                1 if told(&["error: memory: ", "error: threads: "]) => said += 1,
                // The second is the C library's, where no list of what a thread drops at its end can be made.
                1 if told(&["memory allocation of ", "TLS destructor: out of memory"]) => late += 1,
                status => panic!("{mebibytes} MiB, {}: status {status}: {}", job.words, ran.stderr),
            }
            let _ = fs::remove_dir_all(folder.join(job.output));
        }
        assert!(done > 0 && said > late, "{}: {done} done, {said} refused, {late} found late", job.words);
        println!("{}: {done} limits done with the same bytes, {said} refused, {late} found late", job.words);
    }
}
