//! Blocks stored and loaded, damaged journals, and identities.

#![allow(clippy::unwrap_used)]

use super::seal::HEADING;
use super::*;
use crate::blocks::BlockStore;
use crate::grid::{Axis, Grid, Volume};
use crate::progress::Silent;
use crate::reconstruct::{Method, ReconstructionInfo, VolumeSink};

/// Records what is reported.
#[derive(Default)]
pub(super) struct Listener(Mutex<Vec<String>>);

impl Listener {
    pub(super) fn into_told(self) -> Vec<String> {
        self.0.into_inner().unwrap()
    }
}

impl Observer for Listener {
    fn tell(&self, message: &str) {
        self.0.lock().unwrap().push(message.to_owned());
    }
}

/// Requests a stop.
pub(super) struct Stopping;

impl Observer for Stopping {
    fn should_stop(&self) -> bool {
        true
    }
}

/// A folder for a job's output of this name, and the job's identity.
pub(super) fn job(name: &str) -> (tempfile::TempDir, PathBuf, Identity) {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join(name);
    (folder, output, identity("test"))
}

/// The identity of a job of this name that stores more than any of these tests.
fn identity(name: &str) -> Identity {
    Identity::of(name).storing(Stage::Cube, 100, 16 << 20).storing(Stage::Volume, 100, 16 << 20)
}

/// With a secret of the test's own.
pub(super) fn beside(output: &Path, every: Duration) -> Checkpoint {
    let mut checkpoint = Checkpoint::beside(output, every);
    let secrets = output.parent().unwrap().join("secrets");
    checkpoint.place.as_mut().unwrap().secrets = Some(secrets);
    checkpoint
}

pub(super) fn block(k: u64) -> Vec<Complex32> {
    (0..50).map(|i| crate::wave::phasor(0.37 * (k * 50 + i) as f64)).collect()
}

pub(super) fn opened(output: &Path, identity: &Identity) -> (Checkpoint, Vec<String>) {
    opened_at(beside(output, Duration::ZERO), identity)
}

/// A checkpoint that is opened, and what was reported.
pub(super) fn opened_at(checkpoint: Checkpoint, identity: &Identity) -> (Checkpoint, Vec<String>) {
    let listener = Listener::default();
    checkpoint.open(identity, &listener).unwrap();
    (checkpoint, listener.into_told())
}

/// With an interval longer than any test takes.
pub(super) fn opened_for_long(output: &Path, identity: &Identity) -> Checkpoint {
    let checkpoint = beside(output, Duration::from_secs(1000));
    checkpoint.open(identity, &Silent).unwrap();
    checkpoint
}

/// Stores blocks 0 to 4 of a cube; returns the journal's path.
pub(super) fn stored(output: &Path, identity: &Identity) -> PathBuf {
    store(&opened(output, identity).0, identity)
}

/// The same in this checkpoint.
pub(super) fn store(checkpoint: &Checkpoint, identity: &Identity) -> PathBuf {
    let stop = GracefulStop::new(checkpoint, &Silent);
    let mut store = CheckpointStore::new(checkpoint, Stage::Cube, &stop);
    for k in 0..5 {
        assert!(store.is_due());
        store.save(k, &block(k));
        store.flush().unwrap();
    }
    checkpoint.place.as_ref().unwrap().checkpoint_of(identity)
}

/// The numbers of the blocks that can be loaded, whose content must be correct.
pub(super) fn loaded(output: &Path, identity: &Identity) -> Vec<u64> {
    loaded_from(&opened(output, identity).0)
}

/// The same from this checkpoint.
pub(super) fn loaded_from(checkpoint: &Checkpoint) -> Vec<u64> {
    let stop = GracefulStop::new(checkpoint, &Silent);
    let mut store = CheckpointStore::new(checkpoint, Stage::Cube, &stop);
    let mut found = vec![Complex32::ZERO; 50];
    let mut is_there = |k: &u64| {
        let is_there = store.load(*k, &mut found).unwrap();
        assert!(!is_there || found == block(*k));
        is_there
    };
    (0..6).filter(|k| is_there(k)).collect()
}

#[test]
fn blocks_are_loaded_until_the_output_is_complete() {
    // In a folder that does not exist yet.
    let (_folder, output, identity) = job("new/cube.npz");
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
fn every_truncation_and_every_flipped_bit_is_detected() {
    let (_folder, output, identity) = job("cube.npz");
    let path = stored(&output, &identity);
    let whole = fs::read(&path).unwrap();
    for length in (0..whole.len()).step_by(7) {
        fs::write(&path, &whole[..length]).unwrap();
        let blocks = length.saturating_sub(HEADING) / (HEADING + 400);
        assert_eq!(loaded(&output, &identity).len(), blocks, "cut at {length}");
    }
    for at in (0..whole.len()).step_by(5) {
        let mut flipped = whole.clone();
        flipped[at] ^= 1 << (at % 8);
        fs::write(&path, flipped).unwrap();
        assert!(loaded(&output, &identity).len() < 5, "bit of byte {at}");
    }
    // A damaged block is written again, and then all can be loaded.
    let mut flipped = whole;
    flipped[HEADING + 3 * (HEADING + 400) + HEADING + 100] ^= 4;
    fs::write(&path, flipped).unwrap();
    assert_eq!(loaded(&output, &identity), [0, 1, 2, 4]);
    stored(&output, &identity);
    assert_eq!(loaded(&output, &identity), [0, 1, 2, 3, 4]);
}

#[test]
fn another_job_has_another_checkpoint() {
    let (_folder, output, _) = job("cube.npz");
    let identities = || {
        let (mut a, mut b) = (identity("test"), identity("test"));
        a.numbers([1.0, 2.0].into_iter());
        b.numbers([1.0].into_iter());
        b.numbers([2.0].into_iter());
        (a, b, identity("other"))
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
    // A journal with the wrong name.
    let (checkpoint, _) = opened(&output, &b);
    fs::copy(&path, checkpoint.place.as_ref().unwrap().checkpoint_of(&b)).unwrap();
    assert_eq!(loaded(&output, &b), [0u64; 0]);
    checkpoint.remove();
    assert!(!path.exists(), "the output is complete");
}

#[test]
fn two_processes_cannot_write_one_checkpoint() {
    let (_folder, output, identity) = job("cube.npz");
    let path = stored(&output, &identity);
    let (checkpoint, _) = opened(&output, &identity);
    let second = beside(&output, Duration::ZERO);
    let error = second.open(&identity, &Silent).unwrap_err();
    assert!(error.to_string().contains("in use"), "{error}");
    drop(checkpoint);
    assert!(second.open(&identity, &Silent).is_ok());
    assert!(path.exists());
}

/// A volume of this many voxels along x, y and z, still empty.
pub(super) fn volume(count: [usize; 3]) -> Volume {
    let [x, y, z] = count.map(|count| Axis { first: 0.5, pitch: 0.1, count });
    Volume { grid: Grid { x, y, z }, samples: Vec::new() }
}

pub(super) const INFO: ReconstructionInfo = ReconstructionInfo::plain(Method::Direct, 0.0);

#[test]
fn resumed_depths_come_first_and_every_depth_once() {
    let (_folder, output, identity) = job("volume.npz");
    let planes = |range: std::ops::Range<u16>| -> Vec<Complex32> {
        (range.start * 6..range.end * 6).map(|i| Complex32::new(i.into(), 1.0)).collect()
    };
    let (checkpoint, _) = opened(&output, &identity);
    let stop = GracefulStop::new(&checkpoint, &Silent);
    let mut half = volume([3, 2, 10]);
    let grid = half.grid;
    let mut sink = CheckpointedVolume::new(&checkpoint, &mut half, &grid, &stop);
    sink.begin(&INFO).unwrap();
    assert_eq!(sink.wanted(0..10), 0..10);
    sink.take(0, &planes(0..3)).unwrap();
    sink.take(3, &planes(3..5)).unwrap();
    drop(checkpoint);

    let (checkpoint, _) = opened(&output, &identity);
    let stop = GracefulStop::new(&checkpoint, &Silent);
    let mut rest = volume([3, 2, 10]);
    let mut sink = CheckpointedVolume::new(&checkpoint, &mut rest, &grid, &stop);
    sink.begin(&INFO).unwrap();
    assert_eq!(sink.wanted(0..10), 5..10);
    // A method with other slabs gives some depths again.
    sink.take(4, &planes(4..10)).unwrap();
    assert_eq!(rest.samples, planes(0..10));
}

#[test]
fn a_block_of_another_length_or_stage_is_not_loaded() {
    let (_folder, output, identity) = job("cube.npz");
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
        // Another block each time: an unusable one is removed.
        assert_eq!(store.load(length as u64 - 48, &mut found), Ok(is_there), "{stage:?}, {length}");
    }
}

#[test]
fn a_stop_is_obeyed_after_the_block_is_saved() {
    let (_folder, output, identity) = job("cube.npz");
    let checkpoint = opened_for_long(&output, &identity);
    let stop = GracefulStop::new(&checkpoint, &Stopping);
    assert!(!stop.should_stop(), "the block may be finished first");
    let mut store = CheckpointStore::new(&checkpoint, Stage::Cube, &stop);
    assert!(store.is_due(), "regardless of the interval");
    store.save(0, &block(0));
    assert_eq!(store.flush(), Err(Error::Interrupted));
    assert!(stop.should_stop(), "a block that began later is not waited for");
    drop(checkpoint);
    assert_eq!(loaded(&output, &identity), [0]);
    assert!(
        GracefulStop::new(&Checkpoint::off(), &Stopping).should_stop(),
        "nothing is stored, so there is nothing to wait for"
    );
}
