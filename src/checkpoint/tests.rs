//! Blocks kept and taken up, journals that were cut and flipped, and identities.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::grid::{Axis, Grid, Volume};
use crate::progress::Silent;
use crate::reconstruct::{Made, Method, VolumeSink};
use std::sync::Mutex;

/// Remembers what it was told.
#[derive(Default)]
struct Listener(Mutex<Vec<String>>);

impl Observer for Listener {
    fn tell(&self, message: &str) {
        self.0.lock().unwrap().push(message.to_owned());
    }
}

/// Wants to stop.
struct Stopping;

impl Observer for Stopping {
    fn should_stop(&self) -> bool {
        true
    }
}

fn block(k: u64) -> Vec<Complex32> {
    (0..50).map(|i| crate::wave::phasor(0.37 * (k * 50 + i) as f64)).collect()
}

fn opened(output: &Path, identity: &Identity) -> (Checkpoint, Vec<String>) {
    let (checkpoint, listener) = (Checkpoint::beside(output, Duration::ZERO), Listener::default());
    checkpoint.open(identity, &listener).unwrap();
    (checkpoint, listener.0.into_inner().unwrap())
}

/// With nothing due for longer than any test takes.
fn opened_for_long(output: &Path, identity: &Identity) -> Checkpoint {
    let checkpoint = Checkpoint::beside(output, Duration::from_secs(1000));
    checkpoint.open(identity, &Silent).unwrap();
    checkpoint
}

/// Keeps blocks 0 to 4 of a cube.
fn kept(output: &Path, identity: &Identity) -> PathBuf {
    let (checkpoint, _) = opened(output, identity);
    let patient = Patient::new(&checkpoint, &Silent);
    let mut keeper = checkpoint.cube(&patient);
    for k in 0..5 {
        assert!(keeper.is_due());
        keeper.keep(k, &block(k)).unwrap();
        keeper.kept().unwrap();
    }
    checkpoint.place.as_ref().unwrap().state_of(identity)
}

/// The blocks at hand, which must be right.
fn at_hand(output: &Path, identity: &Identity) -> Vec<u64> {
    let (checkpoint, _) = opened(output, identity);
    let patient = Patient::new(&checkpoint, &Silent);
    let mut keeper = checkpoint.cube(&patient);
    let mut found = vec![Complex32::ZERO; 50];
    let mut is_there = |k: &u64| keeper.recall(*k, &mut found).unwrap() && found == block(*k);
    (0..6).filter(|k| is_there(k)).collect()
}

#[test]
fn blocks_come_back_until_the_output_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    // In a folder that is not there yet.
    let output = folder.path().join("new/cube.npz");
    let identity = Identity::of("test");
    assert_eq!(at_hand(&output, &identity), [0u64; 0]);
    let path = kept(&output, &identity);
    assert_eq!(at_hand(&output, &identity), [0, 1, 2, 3, 4]);
    let (checkpoint, notes) = opened(&output, &identity);
    assert!(notes[0].contains("5 blocks"), "{notes:?}");
    assert!(checkpoint.how_to_continue().unwrap().contains("5 finished blocks"));
    checkpoint.remove();
    assert!(!path.exists());
}

#[test]
fn every_cut_and_every_flipped_bit_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("cube.npz");
    let identity = Identity::of("test");
    let path = kept(&output, &identity);
    let whole = fs::read(&path).unwrap();
    for length in (0..whole.len()).step_by(7) {
        fs::write(&path, &whole[..length]).unwrap();
        let blocks = length.saturating_sub(32) / (32 + 400);
        assert_eq!(at_hand(&output, &identity).len(), blocks, "cut at {length}");
    }
    for at in (0..whole.len()).step_by(5) {
        let mut flipped = whole.clone();
        flipped[at] ^= 1 << (at % 8);
        fs::write(&path, flipped).unwrap();
        assert!(at_hand(&output, &identity).len() < 5, "bit of byte {at}");
    }
    // What is damaged is written again, and then all is there.
    let mut flipped = whole;
    flipped[32 + 3 * 432 + 100] ^= 4;
    fs::write(&path, flipped).unwrap();
    assert_eq!(at_hand(&output, &identity), [0, 1, 2, 4]);
    kept(&output, &identity);
    assert_eq!(at_hand(&output, &identity), [0, 1, 2, 3, 4]);
}

#[test]
fn another_job_has_another_state() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("cube.npz");
    let identities = || {
        let (mut a, mut b) = (Identity::of("test"), Identity::of("test"));
        a.numbers([1.0, 2.0].into_iter());
        b.numbers([1.0].into_iter());
        b.numbers([2.0].into_iter());
        (a, b, Identity::of("other"))
    };
    let (a, b, c) = identities();
    assert_eq!(a.to_string(), identities().0.to_string());
    assert!(Identity::is_written(&a.to_string()));
    let path = kept(&output, &a);
    for other in [&b, &c] {
        assert_eq!(at_hand(&output, other), [0u64; 0]);
        assert!(opened(&output, other).1[0].contains("other inputs or parameters"));
    }
    assert!(path.exists(), "it may be wanted yet");
    // A state under a wrong name.
    let (checkpoint, _) = opened(&output, &b);
    fs::copy(&path, checkpoint.place.as_ref().unwrap().state_of(&b)).unwrap();
    assert_eq!(at_hand(&output, &b), [0u64; 0]);
    checkpoint.remove();
    assert!(!path.exists(), "the output is complete");
}

#[test]
fn two_processes_do_not_write_one_state() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("cube.npz");
    let identity = Identity::of("test");
    let path = kept(&output, &identity);
    let (checkpoint, _) = opened(&output, &identity);
    let second = Checkpoint::beside(&output, Duration::ZERO);
    let error = second.open(&identity, &Silent).unwrap_err();
    assert!(error.to_string().contains("in use"), "{error}");
    drop(checkpoint);
    assert!(second.open(&identity, &Silent).is_ok());
    assert!(path.exists());
}

fn volume() -> Volume {
    let axis = |count| Axis { first: 0.5, pitch: 0.1, count };
    Volume { grid: Grid { x: axis(3), y: axis(2), z: axis(10) }, samples: Vec::new() }
}

#[test]
fn depths_are_handed_on_once_and_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("volume.npz");
    let identity = Identity::of("test");
    let made = Made { method: Method::Direct, error_bound: 0.0 };
    let planes = |range: std::ops::Range<u16>| -> Vec<Complex32> {
        (range.start * 6..range.end * 6).map(|i| Complex32::new(i.into(), 1.0)).collect()
    };
    let (checkpoint, _) = opened(&output, &identity);
    let patient = Patient::new(&checkpoint, &Silent);
    let mut half = volume();
    let mut sink = KeptVolume::new(&checkpoint, &mut half, &volume().grid, &patient);
    sink.begin(&made).unwrap();
    assert_eq!(sink.done(), 0);
    sink.take(0, &planes(0..3)).unwrap();
    sink.take(3, &planes(3..5)).unwrap();
    drop(checkpoint);

    let (checkpoint, _) = opened(&output, &identity);
    let patient = Patient::new(&checkpoint, &Silent);
    let mut rest = volume();
    let mut sink = KeptVolume::new(&checkpoint, &mut rest, &volume().grid, &patient);
    sink.begin(&made).unwrap();
    assert_eq!(sink.done(), 5);
    // A method that divides otherwise gives some depths again.
    sink.take(4, &planes(4..10)).unwrap();
    assert_eq!(rest.samples, planes(0..10));
}

#[test]
fn so_many_depths_wait_before_it_is_time_and_the_last_are_left_to_the_result() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("volume.npz");
    let identity = Identity::of("test");
    let checkpoint = opened_for_long(&output, &identity);
    let patient = Patient::new(&checkpoint, &Silent);
    let axis = |count| Axis { first: 0.5, pitch: 0.1, count };
    let grid = Grid { x: axis(1024), y: axis(768), z: axis(8) };
    let mut volume = Volume { grid, samples: Vec::new() };
    let mut sink = KeptVolume::new(&checkpoint, &mut volume, &grid, &patient);
    let plane = vec![Complex32::ONE; grid.plane_len()];
    // 6 MiB each: 18 wait, then 18, then 12.
    for first in 0..8 {
        sink.take(first, &plane).unwrap();
    }
    assert_eq!(volume.samples, plane.repeat(8));
    drop(checkpoint);
    let (checkpoint, _) = opened(&output, &identity);
    let mut found = Vec::new();
    let kept: Vec<u64> = (0..8).filter(|k| checkpoint.recall(Stage::Volume, *k, &mut found)).collect();
    assert_eq!(kept, [0, 3], "the last two are written as the result at once");
    assert_eq!(found, plane.repeat(3));
}

#[test]
fn a_stop_is_obeyed_after_the_block_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("cube.npz");
    let identity = Identity::of("test");
    let checkpoint = opened_for_long(&output, &identity);
    let patient = Patient::new(&checkpoint, &Stopping);
    assert!(!patient.should_stop(), "the block may end first");
    let mut keeper = checkpoint.cube(&patient);
    assert!(keeper.is_due(), "whatever the time");
    keeper.keep(0, &block(0)).unwrap();
    assert_eq!(keeper.kept(), Err(Error::Interrupted));
    assert!(patient.should_stop(), "another block that was begun meanwhile is not waited for");
    drop(checkpoint);
    assert_eq!(at_hand(&output, &identity), [0]);
    assert!(
        Patient::new(&Checkpoint::off(), &Stopping).should_stop(),
        "nothing is kept, nothing to wait for"
    );
}
