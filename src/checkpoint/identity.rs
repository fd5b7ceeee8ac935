//! The identity of a job, by which its checkpoint is recognised.

use super::{Stage, private};
use crate::wave::simd::Level;
use std::fmt;

/// Everything that the result of a job depends on, as a hash of 256 bits: inputs, parameters, program, processor; the user,
/// so that two of them have two checkpoints in a shared folder; and, beside the hash, what the job may store.
///
/// The number of threads and the limits on memory and instruction set are not part of it, because they change no byte. The
/// processor is, because a library's matrix products may round differently on another one.
#[derive(Debug, Clone)]
pub(crate) struct Identity {
    hasher: blake3::Hasher,
    limits: [BlockLimit; STAGES],
}

/// Bytes of numbers that are hashed at a time.
const PIECE: usize = 1 << 16;

/// Number of stages that store blocks.
const STAGES: usize = 8;

/// The most that a stage of a job can store.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BlockLimit {
    /// Number of blocks.
    blocks: u64,
    /// Bytes of one block.
    bytes: u64,
}

impl Identity {
    /// The identity of a job of this name without any inputs, which stores nothing.
    pub(crate) fn of(job: &str) -> Self {
        let mut identity = Self { hasher: blake3::Hasher::new(), limits: [BlockLimit::default(); STAGES] };
        let program = concat!(env!("CARGO_PKG_VERSION"), " ", env!("HOLOSONAR_COMMIT"), " 2");
        let processor = Level::of_processor().as_str();
        let user = private::user().to_string();
        for text in [program, std::env::consts::ARCH, std::env::consts::OS, processor, &user, job] {
            identity.text(text);
        }
        identity
    }

    /// The same job, of which `stage` stores at most this many blocks of at most so many bytes each.
    #[must_use]
    pub(crate) fn storing(mut self, stage: Stage, blocks: u64, bytes: u64) -> Self {
        self.limits[stage as usize - 1] = BlockLimit { blocks, bytes };
        self
    }

    /// Whether block `k` of a stage, by its number, may have this many bytes.
    pub(super) fn stores(&self, stage: u64, k: u64, bytes: u64) -> bool {
        let limit = usize::try_from(stage).ok().and_then(|stage| self.limits.get(stage.checked_sub(1)?));
        limit.is_some_and(|limit| k < limit.blocks && bytes <= limit.bytes)
    }

    /// Adds a text.
    pub(crate) fn text(&mut self, text: &str) {
        self.bytes(text.as_bytes());
    }

    /// Adds numbers by their bits.
    pub(crate) fn numbers(&mut self, numbers: impl ExactSizeIterator<Item = f64>) {
        self.length(numbers.len());
        // In pieces: the hash takes many bytes at once in vectors.
        let mut piece = Vec::with_capacity(PIECE.min(8 * numbers.len()));
        for number in numbers {
            piece.extend(number.to_bits().to_le_bytes());
            if piece.len() == PIECE {
                self.hasher.update(&piece);
                piece.clear();
            }
        }
        self.hasher.update(&piece);
    }

    /// Adds bytes.
    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.length(bytes.len());
        self.hasher.update(bytes);
    }

    fn length(&mut self, length: usize) {
        self.hasher.update(&(length as u64).to_le_bytes());
    }

    /// The hash.
    pub(crate) fn key(&self) -> [u8; 32] {
        *self.hasher.finalize().as_bytes()
    }

    /// Whether a text is an identity as [`fmt::Display`] writes it.
    pub(super) fn is_written(text: &str) -> bool {
        text.len() == 16 && text.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b))
    }
}

/// The first 64 bits: a part of a file's name, which need not be more, since the journal has all of them in its seals.
impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.key()[..8].iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}
