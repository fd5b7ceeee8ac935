//! Neighbours in a shared folder: what they plant under the name of a checkpoint is neither followed, waited for, written
//! to nor taken for a result.

#![allow(clippy::unwrap_used)]

use super::tests::{
    INFO, Listener, Stopping, beside, block, job, loaded, loaded_from, opened, opened_at, store, stored,
    volume,
};
use super::*;
use crate::files::tests::make_pipe;
use crate::named::assert_names;
use crate::progress::Silent;
use crate::reconstruct::VolumeSink;
use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::sync::atomic::AtomicUsize;

/// What somebody may plant: its name in messages, whether it can be replaced, and how it is made at the first path with
/// the second as a file of ours. Each returns whether it could be made.
type Planted = (&'static str, bool, fn(&Path, &Path) -> bool);

const PLANTED: [Planted; 7] = [
    ("symbolic link", true, |path, ours| symlink(ours, path).is_ok()),
    ("symbolic link", true, |path, ours| symlink(ours.with_extension("missing"), path).is_ok()),
    ("hard link", true, |path, ours| fs::hard_link(ours, path).is_ok()),
    ("pipe", true, |path, _| make_pipe(path).is_ok()),
    ("folder", false, |path, _| fs::create_dir(path).is_ok()),
    ("changed by other users", true, |path, ours| {
        fs::copy(ours, path).unwrap();
        fs::set_permissions(path, fs::Permissions::from_mode(0o620)).is_ok()
    }),
    ("another user", true, |path, ours| {
        fs::copy(ours, path).unwrap();
        // Only root can give a file away.
        let given = chown(path, Some(65534), None).is_ok();
        if !given {
            fs::remove_file(path).unwrap();
        }
        given
    }),
];

#[test]
fn planted_files_are_reported_and_neither_read_nor_written() {
    for (what, replaceable, plant) in PLANTED {
        let (folder, output, identity) = job("cube.npz");
        let path = stored(&output, &identity);
        // The file of ours is an intact journal of this very job, which must not be read under another's name.
        let ours = folder.path().join("ours");
        fs::rename(&path, &ours).unwrap();
        let before = fs::read(&ours).unwrap();
        if !plant(&path, &ours) {
            continue;
        }
        let (checkpoint, notes) = opened(&output, &identity);
        assert_eq!(notes.len(), 1, "{what}: {notes:?}");
        assert_names(&notes[0], &[path.to_str().unwrap(), what, "beginning"]);
        assert_eq!(loaded_from(&checkpoint), [0u64; 0], "{what}");
        // The first block takes its place, if it can.
        store(&checkpoint, &identity);
        drop(checkpoint);
        assert_eq!(fs::read(&ours).unwrap(), before, "{what}: the file of ours is as it was");
        assert!(!ours.with_extension("missing").exists());
        assert_eq!(loaded(&output, &identity).len(), if replaceable { 5 } else { 0 }, "{what}");
        let (checkpoint, _) = opened(&output, &identity);
        checkpoint.remove();
        assert_eq!(path.exists(), !replaceable, "{what}");
        assert_eq!(fs::read(&ours).unwrap(), before, "{what}");
    }
}

#[test]
fn other_jobs_of_others_are_left_alone() {
    let (folder, output, identity) = job("cube.npz");
    let planted = folder.path().join(".cube.npz.0123456789abcdef.resume");
    symlink(folder.path().join("elsewhere"), &planted).unwrap();
    let pipe = folder.path().join(".cube.npz.0123456789abcdee.resume");
    make_pipe(&pipe).unwrap();
    let (checkpoint, notes) = opened(&output, &identity);
    assert_eq!(notes, [""; 0]);
    checkpoint.remove();
    assert!(planted.is_symlink() && pipe.exists());
}

#[test]
fn a_checkpoint_is_readable_by_its_owner_alone() {
    let (_folder, output, identity) = job("cube.npz");
    let path = stored(&output, &identity);
    assert_eq!(fs::metadata(path).unwrap().permissions().mode() & 0o777, 0o600);
}

/// A checkpoint whose user has no secret, or this one's.
fn sealed_by(output: &Path, secrets: Option<&Path>) -> Checkpoint {
    let mut checkpoint = beside(output, Duration::ZERO);
    checkpoint.place.as_mut().unwrap().secrets = secrets.map(Path::to_owned);
    checkpoint
}

/// Stores sevens as block 0 of the cube.
fn forge(output: &Path, identity: &Identity, secrets: Option<&Path>) -> PathBuf {
    let (checkpoint, _) = opened_at(sealed_by(output, secrets), identity);
    checkpoint.save(Stage::Cube, 0, &[Complex32::new(7.0, 0.0); 50], &Silent);
    checkpoint.place.as_ref().unwrap().checkpoint_of(identity)
}

#[test]
fn a_forged_journal_with_right_checksums_is_not_used() {
    let (folder, output, identity) = job("cube.npz");
    // This user has a secret already; the others have none, or their own.
    let path = stored(&output, &identity);
    let own = fs::read(&path).unwrap();
    let theirs = folder.path().join("their secrets");
    let mut found = vec![Complex32::ZERO; 50];
    for secrets in [None, Some(theirs.as_path())] {
        fs::remove_file(&path).unwrap();
        forge(&output, &identity, secrets);
        // It is sound for its author.
        let (checkpoint, notes) = opened_at(sealed_by(&output, secrets), &identity);
        assert!(notes[0].contains("1 blocks"), "{notes:?}");
        assert_eq!(checkpoint.load(Stage::Cube, 0, &mut found, &Silent), Ok(true));
        assert_eq!(found[0].re, 7.0);
        drop(checkpoint);
        let (checkpoint, notes) = opened(&output, &identity);
        assert_names(&notes[0], &[path.to_str().unwrap(), "not written by this user", "beginning"]);
        assert_eq!(checkpoint.load(Stage::Cube, 0, &mut found, &Silent), Ok(false));
        assert!(checkpoint.how_to_continue().is_none());
        // Their records after our heading, and after our records.
        drop(checkpoint);
        let forged = fs::read(&path).unwrap();
        for blocks in [0, 2] {
            let intact = &own[..seal::HEADING + blocks * (seal::HEADING + 400)];
            fs::write(&path, [intact, &forged[seal::HEADING..]].concat()).unwrap();
            assert_eq!(loaded(&output, &identity), (0..blocks as u64).collect::<Vec<_>>());
            assert!(opened(&output, &identity).1[0].contains("damaged"));
        }
    }
    // And of this user, for another job.
    let mut other = identity.clone();
    other.text("other inputs");
    let path_of_other = stored(&output, &other);
    fs::copy(path_of_other, &path).unwrap();
    assert_eq!(loaded(&output, &identity), [0u64; 0]);
}

#[test]
fn without_a_home_a_checkpoint_of_this_user_is_resumed() {
    let (folder, output, identity) = job("cube.npz");
    // No folder at all, and one that cannot be created.
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    for secrets in [None, Some(file.as_path())] {
        store(&opened_at(sealed_by(&output, secrets), &identity).0, &identity);
        let (checkpoint, _) = opened_at(sealed_by(&output, secrets), &identity);
        assert_eq!(loaded_from(&checkpoint), [0, 1, 2, 3, 4]);
        checkpoint.remove();
    }
}

#[test]
fn more_blocks_or_bytes_than_the_job_has_are_not_read() {
    let (_folder, output, identity) = job("volume.npz");
    // Sealed rightly: the limits are no part of the identity's hash.
    let write = |blocks: &[(Stage, u64, usize)]| {
        let (checkpoint, _) = opened(&output, &identity);
        for (stage, k, samples) in blocks {
            checkpoint.save(*stage, *k, &vec![Complex32::ONE; *samples], &Silent);
        }
    };
    // Ten depths of six voxels, and three tiles.
    let small = || Identity::of("test").storing(Stage::Volume, 10, 48).storing(Stage::Cube, 3, 400);
    let depths: Vec<_> = (0..15).map(|k| (Stage::Volume, k, 6)).collect();
    write(&depths);
    let (checkpoint, notes) = opened(&output, &small());
    assert_names(&notes[0], &["damaged", "10 blocks"]);
    let stop = GracefulStop::new(&checkpoint, &Silent);
    let mut ten = volume([3, 2, 10]);
    let grid = ten.grid;
    let mut sink = CheckpointedVolume::new(&checkpoint, &mut ten, &grid, &stop);
    sink.begin(&INFO).unwrap();
    assert!(sink.wanted(0..10).is_empty());
    assert_eq!(ten.samples, [Complex32::ONE; 60]);
    let path = checkpoint.place.as_ref().unwrap().checkpoint_of(&identity);
    drop(checkpoint);
    for blocks in [
        [(Stage::Volume, 0, 6), (Stage::Volume, 1, 7)],
        [(Stage::Volume, 0, 6), (Stage::Volume, u64::MAX, 6)],
        [(Stage::Cube, 2, 50), (Stage::Cube, 3, 50)],
        [(Stage::Cube, 0, 50), (Stage::Cube, 1, 1 << 20)],
    ] {
        fs::remove_file(&path).unwrap();
        write(&blocks);
        let (checkpoint, notes) = opened(&output, &small());
        assert!(notes[0].contains("damaged after its first 1 blocks"), "{blocks:?}: {notes:?}");
        assert!(checkpoint.how_to_continue().unwrap().starts_with("1 finished"));
    }
}

#[test]
fn zeros_after_the_blocks_are_neither_read_nor_kept() {
    let (_folder, output, identity) = job("cube.npz");
    let path = stored(&output, &identity);
    let length = fs::metadata(&path).unwrap().len();
    // Sparse: it takes no disk.
    let sparse = || fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(1 << 36).unwrap();
    sparse();
    let (checkpoint, notes) = opened(&output, &identity);
    assert!(notes[0].contains("damaged after its first 5 blocks"), "{notes:?}");
    assert_eq!(loaded_from(&checkpoint), [0, 1, 2, 3, 4]);
    checkpoint.save(Stage::Cube, 5, &block(5), &Silent);
    drop(checkpoint);
    assert_eq!(fs::metadata(&path).unwrap().len(), length + seal::HEADING as u64 + 400);
    assert_eq!(loaded(&output, &identity), [0, 1, 2, 3, 4, 5]);
}

/// Requests a stop after it was asked this often.
struct StopsAfter(usize, AtomicUsize);

impl Observer for StopsAfter {
    fn should_stop(&self) -> bool {
        self.1.fetch_add(1, Ordering::Relaxed) >= self.0
    }
}

#[test]
fn reading_ends_when_a_stop_is_requested() {
    let (_folder, output, identity) = job("volume.npz");
    // Twelve MiB, of which four are read between two looks.
    let plane = vec![Complex32::ONE; 3 << 19];
    let (checkpoint, _) = opened(&output, &identity);
    checkpoint.save(Stage::Volume, 0, &plane, &Silent);
    checkpoint.save(Stage::Volume, 1, &plane, &Silent);
    drop(checkpoint);
    let (checkpoint, _) = opened(&output, &identity);
    let mut found = vec![Complex32::ZERO; plane.len()];
    for asked in 0..3 {
        let observer = StopsAfter(asked, AtomicUsize::new(0));
        assert_eq!(checkpoint.load(Stage::Volume, 0, &mut found, &observer), Err(Error::Interrupted));
    }
    let observer = StopsAfter(3, AtomicUsize::new(0));
    assert_eq!(checkpoint.load(Stage::Volume, 0, &mut found, &observer), Ok(true), "it is still stored");
    assert!(found == plane);
    // Without the grace that a block in progress is given.
    let stop = GracefulStop::new(&checkpoint, &Stopping);
    let mut two = volume([1 << 10, 3 << 9, 2]);
    let grid = two.grid;
    let mut sink = CheckpointedVolume::new(&checkpoint, &mut two, &grid, &stop);
    assert_eq!(sink.begin(&INFO), Err(Error::Interrupted));
    drop(checkpoint);
    // And while the records are found.
    let second = beside(&output, Duration::ZERO);
    assert_eq!(second.open(&identity, &Stopping), Err(Error::Interrupted));
    assert_eq!(opened_at(second, &identity).1.len(), 1);
}

#[test]
fn damaged_samples_are_reported_once() {
    let (_folder, output, identity) = job("cube.npz");
    let path = stored(&output, &identity);
    let mut bytes = fs::read(&path).unwrap();
    for k in [1, 3] {
        bytes[seal::HEADING * 2 + k * (seal::HEADING + 400)] ^= 1;
    }
    fs::write(&path, bytes).unwrap();
    let (checkpoint, _) = opened(&output, &identity);
    let (listener, mut found) = (Listener::default(), vec![Complex32::ZERO; 50]);
    let mut load = |k| checkpoint.load(Stage::Cube, k, &mut found, &listener).unwrap();
    assert_eq!([0, 1, 2, 3].map(&mut load), [true, false, true, false]);
    let told = listener.into_told();
    assert_eq!(told.len(), 1);
    assert_names(&told[0], &[path.to_str().unwrap(), "damaged blocks"]);
}
