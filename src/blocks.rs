//! Finished blocks of a long stage, stored for a run that resumes after an interruption: the [`BlockStore`] that a stage
//! saves its blocks to and loads them from. Stages do not depend on where and how they are stored. And how depths, shells or
//! transmissions are divided into [`runs`].

use crate::error::Result;
use num_complex::Complex32;
use std::ops::Range;

/// `0..count` in runs of `each`, the last of which may be shorter.
pub(crate) fn runs(count: usize, each: usize) -> impl ExactSizeIterator<Item = Range<usize>> {
    (0..count).step_by(each).map(move |first| first..(first + each).min(count))
}

/// Stores the finished blocks of one stage; what a store does not say itself is that of one that stores nothing.
///
/// A block is a piece of the stage's result that depends on the inputs alone, numbered by the stage; the number of threads
/// changes neither the blocks nor their content. A block that cannot be read is computed again, and one that cannot be
/// written is not stored: neither is an error of the stage.
pub(crate) trait BlockStore {
    /// Fills `block` with block `k` of an interrupted run. `false` where no intact block of this length is stored; the
    /// content of `block` is then undefined.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::error::Error::Interrupted) when a stop was requested before all of it was read.
    fn load(&mut self, _k: u64, _block: &mut [Complex32]) -> Result<bool> {
        Ok(false)
    }

    /// Whether block `k` is somebody else's: it is neither loaded nor computed, and its place in the result stays as it is.
    fn skips(&mut self, _k: u64) -> bool {
        false
    }

    /// Whether it is time to save the blocks that were finished since the last [`BlockStore::flush`].
    fn is_due(&mut self) -> bool {
        false
    }

    /// Whether what is saved is kept for others.
    fn keeps(&self) -> bool {
        false
    }

    /// Saves block `k`.
    fn save(&mut self, _k: u64, _block: &[Complex32]) {}

    /// Ends a series of saves.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::error::Error::Interrupted) when a stop was requested meanwhile.
    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}

/// Stores planes of nodes for other processes: those that both sides of a boundary between depths need, numbered from the
/// first of them on. A boundary is known by the depth behind it.
pub(crate) trait NodeStore: Sync {
    /// Whether another process may yet need nodes for this depth.
    fn is_needed(&self, depth: usize) -> bool;

    /// Whether `count` planes of so many samples are stored, all of them intact; then they stay there for this process.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::error::Error::Interrupted).
    fn has(&self, boundary: usize, count: usize, plane_len: usize) -> Result<bool>;

    /// Fills plane `k`; `false` if it is not stored or damaged.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::error::Error::Interrupted).
    fn load(&self, boundary: usize, k: usize, plane: &mut [Complex32]) -> Result<bool>;

    /// Stores plane `k`; they come in order, and are there for others with the last. What cannot be written is computed by
    /// whoever needs it.
    fn save(&self, boundary: usize, k: usize, plane: &[Complex32], is_last: bool);
}

/// Stores nothing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NoStore;

impl BlockStore for NoStore {}

/// The blocks of a part of a stage, numbered from `first` on in the store of all of it.
pub(crate) struct BlocksFrom<'a> {
    pub(crate) first: u64,
    pub(crate) store: &'a mut dyn BlockStore,
}

impl BlockStore for BlocksFrom<'_> {
    fn skips(&mut self, k: u64) -> bool {
        self.store.skips(self.first + k)
    }

    fn load(&mut self, k: u64, block: &mut [Complex32]) -> Result<bool> {
        self.store.load(self.first + k, block)
    }

    fn is_due(&mut self) -> bool {
        self.store.is_due()
    }

    fn keeps(&self) -> bool {
        self.store.keeps()
    }

    fn save(&mut self, k: u64, block: &[Complex32]) {
        self.store.save(self.first + k, block);
    }

    fn flush(&mut self) -> Result<()> {
        self.store.flush()
    }
}
