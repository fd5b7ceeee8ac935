//! The identity of a job, by which its checkpoint is recognised.

use crate::wave::simd::Level;
use std::fmt;
use std::hash::{DefaultHasher, Hasher};

/// Everything that the result of a job depends on, in 64 bits: inputs, parameters, program, processor.
///
/// The number of threads and the limits on memory and instruction set are not part of it, because they change no byte. The
/// processor is, because a library's matrix products may round differently on another one.
#[derive(Debug, Clone)]
pub(crate) struct Identity(DefaultHasher);

impl Identity {
    /// The identity of a job of this name without any inputs.
    pub(crate) fn of(job: &str) -> Self {
        // This hasher has constant keys, but its algorithm may change with the standard library: a program that was built
        // with another one does not resume a run of this one.
        let mut identity = Self(DefaultHasher::new());
        let program = concat!(env!("CARGO_PKG_VERSION"), " ", env!("HOLOSONAR_COMMIT"), " 1");
        let processor = Level::of_processor().as_str();
        for text in [program, std::env::consts::ARCH, std::env::consts::OS, processor, job] {
            identity.text(text);
        }
        identity
    }

    /// Adds a text.
    pub(crate) fn text(&mut self, text: &str) {
        self.bytes(text.as_bytes());
    }

    /// Adds numbers by their bits.
    pub(crate) fn numbers(&mut self, numbers: impl ExactSizeIterator<Item = f64>) {
        self.0.write_u64(numbers.len() as u64);
        numbers.for_each(|number| self.0.write_u64(number.to_bits()));
    }

    /// Adds bytes.
    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.0.write_u64(bytes.len() as u64);
        self.0.write(bytes);
    }

    /// The 64 bits.
    pub(super) fn key(&self) -> u64 {
        self.0.finish()
    }

    /// Whether a text is an identity as [`fmt::Display`] writes it.
    pub(super) fn is_written(text: &str) -> bool {
        text.len() == 16 && text.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b))
    }
}

impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.key())
    }
}
