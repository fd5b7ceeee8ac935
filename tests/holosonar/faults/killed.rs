//! Jobs of every kind, killed at any moment.

use super::{
    IMAGE, JOBS, Job, RECONSTRUCT, SIMULATE, assert_same, end, reused, start, states, undisturbed, workplace,
};
use crate::support::Random;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

/// Kills every job `times` times at pseudo-random moments and resumes it; returns the numbers of kills and of blocks that
/// were not computed again.
fn kill(jobs: &[&Job], times: usize, seed: u64, threads: &[&str]) -> (usize, usize) {
    let folder = workplace();
    let folder = folder.path();
    let mut random = Random::new(seed);
    let (mut kills, mut blocks) = (0, 0);
    for job in jobs {
        let (expected, whole) = undisturbed(folder, job);
        let (mut killed, mut finished, mut kept) = (0, 0, 0);
        while killed < times || finished == 0 {
            let threads = threads[random.whole(0, threads.len() - 1)];
            let words = format!("{} --checkpoint-every 0 {threads}", job.words);
            let mut child = start(folder, &words);
            // Rarely enough to make progress, and often near the end, where files are written.
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
            kept += reused(&ran);
            if ran.status == 0 {
                finished += 1;
                assert_same(folder, job, &expected);
                fs::remove_dir_all(folder.join(job.output)).unwrap();
            } else {
                killed += 1;
            }
        }
        println!("{killed} kills, {kept} blocks were not computed again: {}", job.words);
        kills += killed;
        blocks += kept;
        // The last of them may have been killed.
        let _ = fs::remove_dir_all(folder.join(job.output));
    }
    (kills, blocks)
}

/// Number of complete blocks in a checkpoint file: records follow its heading of 96 bytes, each with a heading of 96 bytes
/// whose bytes 16 to 23 are the length of the data after it.
fn whole_blocks(state: &Path) -> usize {
    const HEADING: usize = 96;
    // A file that was deleted in the meantime has none.
    let bytes = fs::read(state).unwrap_or_default();
    let (mut at, mut blocks) = (HEADING, 0);
    while let Some(heading) = bytes.get(at..at + HEADING) {
        at += HEADING + u64::from_le_bytes(heading[16..24].try_into().unwrap()) as usize;
        blocks += usize::from(at <= bytes.len());
    }
    blocks
}

/// Starts a job and kills it once two blocks are stored; returns the number of blocks it leaves, `None` if it was done
/// before.
fn killed_between_blocks(folder: &Path, job: &Job) -> Option<usize> {
    let mut child = start(folder, &format!("{} --checkpoint-every 0", job.words));
    let stored = || states(folder, job).first().map_or(0, |state| whole_blocks(state));
    while child.try_wait().unwrap().is_none() {
        if stored() >= 2 {
            child.kill().unwrap();
            break;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let ran = end(child);
    assert!(ran.status == 0 || ran.status == -1, "{}: {}", job.words, ran.stderr);
    // A job that has written all of its output removes the state, and may be killed thereafter.
    Some(stored()).filter(|blocks| ran.status == -1 && *blocks > 0)
}

/// Maximum number of tries to kill a job before it is done.
const TRIES: usize = 20;

#[test]
fn a_killed_job_resumes_from_every_block_that_it_stored() {
    let folder = workplace();
    let folder = folder.path();
    for job in [&SIMULATE, &RECONSTRUCT, &IMAGE] {
        let (expected, _) = undisturbed(folder, job);
        let stored = (0..TRIES).find_map(|_| {
            let _ = fs::remove_dir_all(folder.join(job.output));
            killed_between_blocks(folder, job)
        });
        let stored = stored.unwrap_or_else(|| panic!("{}: done before each of {TRIES} kills", job.words));
        let ran = end(start(folder, job.words));
        assert_eq!(ran.status, 0, "{}: {}", job.words, ran.stderr);
        assert_eq!(reused(&ran), stored, "{}: {}", job.words, ran.stderr);
        println!("killed with {stored} blocks stored, which were not computed again: {}", job.words);
        assert_same(folder, job, &expected);
        assert_eq!(states(folder, job), Vec::<std::path::PathBuf>::new());
        fs::remove_dir_all(folder.join(job.output)).unwrap();
    }
}

#[test]
#[ignore = "about two minutes"]
fn jobs_of_every_kind_killed_ten_times_each_are_resumed() {
    let (mut kills, mut blocks) = (0, 0);
    for (seed, job) in JOBS.into_iter().enumerate() {
        let (killed, kept) = kill(&[job], 10, 1 + seed as u64, &["", "-j 1", "-j 16"]);
        assert!(kept > 0, "{}: no block was reused", job.words);
        kills += killed;
        blocks += kept;
    }
    println!("{kills} kills in all, {blocks} blocks were not computed again");
    assert!(kills >= 70 && blocks > 140, "{kills} kills, {blocks} blocks");
}
