//! Blocks stored and loaded, journals that were cut and flipped, and identities.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::blocks::BlockStore;
use crate::grid::{Axis, Grid, Volume};
use crate::progress::Silent;
use crate::reconstruct::{Method, ReconstructionInfo, VolumeSink};

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

/// Stores blocks 0 to 4 of a cube; gives the journal's path.
fn stored(output: &Path, identity: &Identity) -> PathBuf {
    let (checkpoint, _) = opened(output, identity);
    let stop = GracefulStop::new(&checkpoint, &Silent);
    let mut store = CheckpointStore::new(&checkpoint, Stage::Cube, &stop);
    for k in 0..5 {
        assert!(store.is_due());
        store.save(k, &block(k));
        store.flush().unwrap();
    }
    checkpoint.place.as_ref().unwrap().checkpoint_of(identity)
}

/// The blocks that can be loaded, which must be right.
fn loaded(output: &Path, identity: &Identity) -> Vec<u64> {
    let (checkpoint, _) = opened(output, identity);
    let stop = GracefulStop::new(&checkpoint, &Silent);
    let mut store = CheckpointStore::new(&checkpoint, Stage::Cube, &stop);
    let mut found = vec![Complex32::ZERO; 50];
    let mut is_there = |k: &u64| {
        let is_there = store.load(*k, &mut found);
        assert!(!is_there || found == block(*k));
        is_there
    };
    (0..6).filter(|k| is_there(k)).collect()
}

#[test]
fn blocks_are_loaded_until_the_output_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    // In a folder that is not there yet.
    let output = folder.path().join("new/cube.npz");
    let identity = Identity::of("test");
    assert_eq!(loaded(&output, &identity), [0u64; 0]);
    let path = stored(&output, &identity);
    assert_eq!(loaded(&output, &identity), [0, 1, 2, 3, 4]);
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
    let path = stored(&output, &identity);
    let whole = fs::read(&path).unwrap();
    for length in (0..whole.len()).step_by(7) {
        fs::write(&path, &whole[..length]).unwrap();
        let blocks = length.saturating_sub(32) / (32 + 400);
        assert_eq!(loaded(&output, &identity).len(), blocks, "cut at {length}");
    }
    for at in (0..whole.len()).step_by(5) {
        let mut flipped = whole.clone();
        flipped[at] ^= 1 << (at % 8);
        fs::write(&path, flipped).unwrap();
        assert!(loaded(&output, &identity).len() < 5, "bit of byte {at}");
    }
    // What is damaged is written again, and then all is there.
    let mut flipped = whole;
    flipped[32 + 3 * 432 + 100] ^= 4;
    fs::write(&path, flipped).unwrap();
    assert_eq!(loaded(&output, &identity), [0, 1, 2, 4]);
    stored(&output, &identity);
    assert_eq!(loaded(&output, &identity), [0, 1, 2, 3, 4]);
}

#[test]
fn another_job_has_another_checkpoint() {
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
    let path = stored(&output, &a);
    for other in [&b, &c] {
        assert_eq!(loaded(&output, other), [0u64; 0]);
        assert!(opened(&output, other).1[0].contains("other inputs or parameters"));
    }
    assert!(path.exists(), "its job may still be resumed");
    // A journal under a wrong name.
    let (checkpoint, _) = opened(&output, &b);
    fs::copy(&path, checkpoint.place.as_ref().unwrap().checkpoint_of(&b)).unwrap();
    assert_eq!(loaded(&output, &b), [0u64; 0]);
    checkpoint.remove();
    assert!(!path.exists(), "the output is complete");
}

#[test]
fn two_processes_do_not_write_one_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("cube.npz");
    let identity = Identity::of("test");
    let path = stored(&output, &identity);
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

const INFO: ReconstructionInfo = ReconstructionInfo { method: Method::Direct, error_bound: 0.0 };

#[test]
fn resumed_depths_come_first_and_every_depth_once() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("volume.npz");
    let identity = Identity::of("test");
    let planes = |range: std::ops::Range<u16>| -> Vec<Complex32> {
        (range.start * 6..range.end * 6).map(|i| Complex32::new(i.into(), 1.0)).collect()
    };
    let (checkpoint, _) = opened(&output, &identity);
    let stop = GracefulStop::new(&checkpoint, &Silent);
    let mut half = volume();
    let mut sink = CheckpointedVolume::new(&checkpoint, &mut half, &volume().grid, &stop);
    sink.begin(&INFO).unwrap();
    assert_eq!(sink.depths_done(), 0);
    sink.take(0, &planes(0..3)).unwrap();
    sink.take(3, &planes(3..5)).unwrap();
    drop(checkpoint);

    let (checkpoint, _) = opened(&output, &identity);
    let stop = GracefulStop::new(&checkpoint, &Silent);
    let mut rest = volume();
    let mut sink = CheckpointedVolume::new(&checkpoint, &mut rest, &volume().grid, &stop);
    sink.begin(&INFO).unwrap();
    assert_eq!(sink.depths_done(), 5);
    // A method that divides otherwise gives some depths again.
    sink.take(4, &planes(4..10)).unwrap();
    assert_eq!(rest.samples, planes(0..10));
}

#[test]
fn only_so_many_depths_wait_and_the_last_are_left_to_the_result() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("volume.npz");
    let identity = Identity::of("test");
    let checkpoint = opened_for_long(&output, &identity);
    let stop = GracefulStop::new(&checkpoint, &Silent);
    let axis = |count| Axis { first: 0.5, pitch: 0.1, count };
    let grid = Grid { x: axis(1024), y: axis(768), z: axis(8) };
    let mut volume = Volume { grid, samples: Vec::new() };
    let mut sink = CheckpointedVolume::new(&checkpoint, &mut volume, &grid, &stop);
    let plane = |depth: usize| vec![Complex32::new(depth as f32, 1.0); grid.plane_len()];
    // 6 MiB each, of which two may wait: the third has them all written.
    for depth in 0..8 {
        sink.take(depth, &plane(depth)).unwrap();
    }
    assert_eq!(volume.samples, (0..8).flat_map(plane).collect::<Vec<_>>());
    drop(checkpoint);
    let (checkpoint, _) = opened(&output, &identity);
    let stop = GracefulStop::new(&checkpoint, &Silent);
    let mut store = CheckpointStore::new(&checkpoint, Stage::Volume, &stop);
    let mut found = plane(0);
    let mut is_there = |k: &usize| store.load(*k as u64, &mut found) && found == plane(*k);
    let stored: Vec<usize> = (0..8).filter(|k| is_there(k)).collect();
    assert_eq!(stored, [0, 1, 2, 3, 4, 5], "the last two are written as the result at once");
}

#[test]
fn a_block_of_another_length_or_stage_is_not_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("cube.npz");
    let identity = Identity::of("test");
    stored(&output, &identity);
    let (checkpoint, _) = opened(&output, &identity);
    let stop = GracefulStop::new(&checkpoint, &Silent);
    for (stage, length, is_there) in [
        (Stage::Cube, 50, true),
        (Stage::Volume, 50, false),
        (Stage::Cube, 49, false),
        (Stage::Cube, 51, false),
    ] {
        let mut store = CheckpointStore::new(&checkpoint, stage, &stop);
        let mut found = vec![Complex32::ZERO; length];
        // Another block each time: one that cannot be used is dropped.
        assert_eq!(store.load(length as u64 - 48, &mut found), is_there, "{stage:?}, {length}");
    }
}

#[test]
fn a_stop_is_obeyed_after_the_block_is_saved() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("cube.npz");
    let identity = Identity::of("test");
    let checkpoint = opened_for_long(&output, &identity);
    let stop = GracefulStop::new(&checkpoint, &Stopping);
    assert!(!stop.should_stop(), "the block may end first");
    let mut store = CheckpointStore::new(&checkpoint, Stage::Cube, &stop);
    assert!(store.is_due(), "whatever the time");
    store.save(0, &block(0));
    assert_eq!(store.flush(), Err(Error::Interrupted));
    assert!(stop.should_stop(), "another block that was begun meanwhile is not waited for");
    drop(checkpoint);
    assert_eq!(loaded(&output, &identity), [0]);
    assert!(
        GracefulStop::new(&Checkpoint::off(), &Stopping).should_stop(),
        "nothing is stored, nothing to wait for"
    );
}
