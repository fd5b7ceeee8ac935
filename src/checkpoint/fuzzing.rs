//! A journal made of whatever bytes, for `tests/fuzz`, which cannot make seals.

use super::seal::{HEADING, Heading, Seal};
use super::{Checkpoint, Identity, Stage};
use crate::progress::Silent;
use num_complex::Complex32;
use std::fs;
use std::path::Path;
use std::time::Duration;

/// Blocks of the job, and samples of each.
const BLOCKS: u64 = 4;
const SAMPLES: usize = 16;

/// Writes `bytes` as the checkpoint of a small job beside `output`, opens it, reads every block, stores one that it lacks
/// and reads it again. Headings, or samples too, can be given the seals that they should have.
///
/// # Panics
/// If a block is taken whose samples have not the seal that they should have, or the checkpoint cannot be used.
pub fn read_journal(output: &Path, bytes: &[u8], seal_headings: bool, seal_samples: bool) {
    let size = (SAMPLES * size_of::<Complex32>()) as u64;
    let identity =
        Identity::of("fuzzing").storing(Stage::Cube, BLOCKS, size).storing(Stage::Volume, BLOCKS, size);
    let mut checkpoint = Checkpoint::beside(output, Duration::ZERO);
    let place = checkpoint.place.as_mut().expect("it is kept somewhere");
    place.secrets = None;
    let path = place.checkpoint_of(&identity);
    let _ = fs::remove_file(&path);
    let seal = Seal::new(None, &identity);
    fs::write(&path, sealed(bytes, &seal, seal_headings, seal_samples)).expect("a folder of ours");
    checkpoint.open(&identity, &Silent).expect("nobody else works here");
    let mut block = vec![Complex32::ZERO; SAMPLES];
    for stage in [Stage::Cube, Stage::Volume] {
        for k in 0..=BLOCKS {
            let found = checkpoint.load(stage, k, &mut block, &Silent).expect("nobody stops");
            assert!(!found || (seal_headings && seal_samples && k < BLOCKS), "block {k} was not sealed");
        }
    }
    checkpoint.save(Stage::Cube, 0, &[Complex32::ONE; SAMPLES], &Silent);
    assert_eq!(checkpoint.load(Stage::Cube, 0, &mut block, &Silent), Ok(true));
    checkpoint.remove();
    assert!(!path.exists());
}

/// The bytes with the seals that the headings among them, or their samples too, should have.
fn sealed(bytes: &[u8], seal: &Seal, seal_headings: bool, seal_samples: bool) -> Vec<u8> {
    let (mut bytes, mut at) = (bytes.to_vec(), 0);
    while seal_headings && bytes.len().saturating_sub(at) >= HEADING {
        let word = |i: usize| u64::from_le_bytes(std::array::from_fn(|byte| bytes[at + 8 * i + byte]));
        let mut heading = Heading { words: std::array::from_fn(word), samples: [0; 32] };
        let samples = at + HEADING;
        // The file's own heading is followed by none.
        let length = if at == 0 { 0 } else { usize::try_from(heading.words[2]).unwrap_or(usize::MAX) };
        let end = samples.saturating_add(length);
        heading.samples.copy_from_slice(&bytes[at + 32..at + 64]);
        if seal_samples && at > 0 && end <= bytes.len() {
            heading.samples = seal.of(&bytes[samples..end]);
        }
        bytes[at..samples].copy_from_slice(&seal.write(&heading));
        at = end;
    }
    bytes
}
