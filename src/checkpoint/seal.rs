//! Headings of a journal and their seals: checksums that nobody can make without this user's secret.
//!
//! A seal is a BLAKE3 hash with a key \[1\]. The key is made of the user's secret and of the job's identity, so that neither
//! another user nor another job of this user seals alike. Without a secret the key is made of the identity alone, and a
//! seal is no more than a checksum.
//!
//! \[1\] J. O'Connor, J.-P. Aumasson, S. Neves, Z. Wilcox-O'Hearn, "BLAKE3: one function, fast everywhere", 2020.

use super::Identity;
use super::secret::Secret;

/// Bytes of a heading: four words, the seal of the samples, and the seal of all before it.
pub(super) const HEADING: usize = 96;

/// Bytes of the words and of the seal of the samples.
const SEALED: usize = HEADING - 32;

/// What a heading says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Heading {
    pub(super) words: [u64; 4],
    /// The seal of the samples after the heading; zeros where there are none.
    pub(super) samples: [u8; 32],
}

/// Makes and checks the seals of one job's journal.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seal {
    key: [u8; 32],
}

impl Seal {
    pub(super) fn new(secret: Option<Secret>, identity: &Identity) -> Self {
        Self { key: *blake3::keyed_hash(&secret.unwrap_or_default(), &identity.key()).as_bytes() }
    }

    /// For the seal of samples, to which they can be given in pieces.
    pub(super) fn hasher(&self) -> blake3::Hasher {
        blake3::Hasher::new_keyed(&self.key)
    }

    /// The seal of all samples at once.
    pub(super) fn of(&self, samples: &[u8]) -> [u8; 32] {
        *blake3::keyed_hash(&self.key, samples).as_bytes()
    }

    /// The bytes of a heading.
    pub(super) fn write(&self, heading: &Heading) -> [u8; HEADING] {
        let mut bytes = [0; HEADING];
        for (bytes, word) in bytes.chunks_exact_mut(8).zip(heading.words) {
            bytes.copy_from_slice(&word.to_le_bytes());
        }
        bytes[32..SEALED].copy_from_slice(&heading.samples);
        let seal = self.of(&bytes[..SEALED]);
        bytes[SEALED..].copy_from_slice(&seal);
        bytes
    }

    /// The heading of these bytes, if its seal is right.
    pub(super) fn read(&self, bytes: &[u8; HEADING]) -> Option<Heading> {
        let (sealed, seal) = bytes.split_at(SEALED);
        if !is_equal(&blake3::keyed_hash(&self.key, sealed), seal) {
            return None;
        }
        let word = |i: usize| u64::from_le_bytes(std::array::from_fn(|byte| bytes[8 * i + byte]));
        Some(Heading {
            words: std::array::from_fn(word),
            samples: std::array::from_fn(|byte| bytes[32 + byte]),
        })
    }
}

/// Whether a hash is the stored one; a hash takes the same time to compare, wherever the two differ.
pub(super) fn is_equal(hash: &blake3::Hash, stored: &[u8]) -> bool {
    blake3::Hash::from_slice(stored).is_ok_and(|stored| stored == *hash)
}
