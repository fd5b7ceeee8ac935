//! Jobs of every kind, killed at any moment.

use super::{
    IMAGE, JOBS, Job, RECONSTRUCT, SIMULATE, assert_same, end, reused, start, undisturbed, workplace,
};
use crate::support::Random;
use std::fs;
use std::time::{Duration, Instant};

/// Kills some jobs so many times each, at moments that look random, and goes on with them; gives kills and blocks that were
/// not computed again.
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

#[test]
fn a_killed_job_goes_on() {
    kill(&[&SIMULATE, &RECONSTRUCT, &IMAGE], 2, 7, &[""]);
}

#[test]
#[ignore = "about two minutes"]
fn jobs_of_every_kind_killed_ten_times_each_go_on() {
    let (mut kills, mut blocks) = (0, 0);
    for (seed, job) in JOBS.into_iter().enumerate() {
        let (killed, kept) = kill(&[job], 10, 1 + seed as u64, &["", "-j 1", "-j 16"]);
        assert!(kept > 0, "{}: nothing was taken up", job.words);
        kills += killed;
        blocks += kept;
    }
    println!("{kills} kills in all, {blocks} blocks were not computed again");
    assert!(kills >= 70 && blocks > 140, "{kills} kills, {blocks} blocks");
}
