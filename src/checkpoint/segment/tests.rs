//! Units that are complete, unfinished, taken up, and of others.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::checkpoint::tests::{Listener, beside, block, job, opened};
use crate::named::assert_names;
use crate::progress::Silent;
use std::path::Path;
use std::time::Duration;

const UNITS: [[u64; 2]; 2] = [[0, 1], [5, 6]];

fn units() -> Vec<UnitBlocks> {
    (0..).zip(UNITS).map(|(unit, blocks)| UnitBlocks { unit, blocks: blocks.to_vec() }).collect()
}

/// Writes these blocks of both units.
fn write(checkpoint: &Checkpoint, identity: &Identity, blocks: &[u64]) {
    let mut writer = SegmentWriter::new(checkpoint, identity, (Stage::Cube, &units()), &Silent);
    for k in blocks {
        writer.write(*k, &block(*k)).unwrap();
    }
}

fn names(folder: &Path) -> Vec<String> {
    let name = |entry: fs::DirEntry| entry.file_name().into_string().unwrap();
    let mut names: Vec<String> = fs::read_dir(folder).unwrap().map(|entry| name(entry.unwrap())).collect();
    names.retain(|name| name.starts_with('.'));
    names.sort();
    names
}

#[test]
fn a_unit_appears_when_it_is_complete_and_an_unfinished_one_is_gone() {
    let (folder, output, identity) = job("cube.npz");
    let checkpoint = beside(&output, Duration::ZERO);
    write(&checkpoint, &identity, &[5, 0, 6, 9]);
    let found = names(folder.path());
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].ends_with(".1.unit"), "{found:?}");
    checkpoint.take_segments(&identity, &Silent).unwrap();
    let has = |unit: &UnitBlocks| checkpoint.has_unit(Stage::Cube, unit, &Silent).unwrap();
    assert_eq!(units().iter().map(has).collect::<Vec<_>>(), [false, true]);
    let mut taken = block(0);
    assert!(checkpoint.load(Stage::Cube, 6, &mut taken, &Silent).unwrap() && taken == block(6));
    assert!(!checkpoint.load(Stage::Volume, 6, &mut taken, &Silent).unwrap());
}

#[test]
fn a_second_process_that_takes_units_up_is_refused_and_the_first_deletes_all() {
    let (folder, output, identity) = job("cube.npz");
    write(&beside(&output, Duration::ZERO), &identity, &[0, 1, 5, 6]);
    // What a killed process left.
    fs::write(folder.path().join(format!(".cube.npz.{identity}.7.0123456789abcdef.part")), "half").unwrap();
    let (first, told) = opened(&output, &identity);
    assert_names(&told[0], &["2 units"]);
    let second = beside(&output, Duration::ZERO).open(&identity, &Silent).unwrap_err();
    assert_names(second.to_string(), &["in use"]);
    first.remove();
    assert!(names(folder.path()).is_empty());
}

#[test]
fn units_of_other_jobs_and_of_other_users_are_named_and_not_used() {
    let (folder, output, identity) = job("cube.npz");
    let other = Identity::of("another").storing(Stage::Cube, 100, 1 << 20);
    write(&beside(&output, Duration::ZERO), &other, &[0, 1]);
    let told = |checkpoint: &Checkpoint| {
        let listener = Listener::default();
        checkpoint.take_segments(&identity, &listener).unwrap();
        listener.into_told()
    };
    let checkpoint = beside(&output, Duration::ZERO);
    assert_names(&told(&checkpoint)[0], &["1 units of other work", "processor"]);
    write(&checkpoint, &identity, &[0, 1]);
    // Sealed with another secret, as by somebody else.
    fs::rename(folder.path().join("secrets"), folder.path().join("others")).unwrap();
    let (checkpoint, _) = opened(&folder.path().join("new"), &identity);
    crate::checkpoint::tests::store(&checkpoint, &identity);
    let checkpoint = beside(&output, Duration::ZERO);
    assert_names(&told(&checkpoint)[1], &[".0.unit", "not written by this user"]);
    assert!(!checkpoint.has_unit(Stage::Cube, &units()[0], &Silent).unwrap());
}
