//! The columns of a cube, which a simulation fills tile by tile of microphones: loaded where an interrupted run has
//! stored them, and saved as they are finished.

use super::no_room;
use crate::alloc::{try_with_capacity, try_zeroed};
use crate::blocks::BlockStore;
use crate::error::Result;
use num_complex::Complex32;

/// The samples of a cube and the store of its tiles. Block k is tile k, `[n_f, microphone of the tile]`.
pub(super) struct Columns<'a> {
    /// `[n_f, n_mic]`.
    pub(super) samples: &'a mut [Complex32],
    n_mic: usize,
    store: &'a mut dyn BlockStore,
    /// Tiles that are finished and not saved yet: their numbers and microphones.
    finished: Vec<(u64, Vec<usize>)>,
}

impl<'a> Columns<'a> {
    pub(super) fn new(samples: &'a mut [Complex32], n_mic: usize, store: &'a mut dyn BlockStore) -> Self {
        Self { samples, n_mic, store, finished: Vec::new() }
    }

    /// Fills the columns of tile `k`, which has these microphones, if they are stored.
    pub(super) fn load(&mut self, k: usize, microphones: &[usize]) -> Result<bool> {
        let frequencies = self.samples.len() / self.n_mic;
        let mut block = try_zeroed((frequencies * microphones.len()) as u64).ok_or_else(no_room)?;
        if !self.store.load(k as u64, &mut block) {
            return Ok(false);
        }
        let rows = self.samples.chunks_exact_mut(self.n_mic);
        for (row, stored) in rows.zip(block.chunks_exact(microphones.len())) {
            microphones.iter().zip(stored).for_each(|(&mic, m)| row[mic] = *m);
        }
        Ok(true)
    }

    /// Records that the columns of tile `k` are filled.
    pub(super) fn finish(&mut self, k: usize, microphones: &[usize]) {
        self.finished.push((k as u64, microphones.to_vec()));
    }

    /// Saves the finished tiles, if it is time.
    pub(super) fn save_if_due(&mut self) -> Result<()> {
        if !self.store.is_due() {
            return Ok(());
        }
        let most = self.finished.iter().map(|(_, microphones)| microphones.len()).max().unwrap_or(0);
        let mut block =
            try_with_capacity((self.samples.len() / self.n_mic * most) as u64).ok_or_else(no_room)?;
        for (k, microphones) in self.finished.drain(..) {
            block.clear();
            for row in self.samples.chunks_exact(self.n_mic) {
                block.extend(microphones.iter().map(|&mic| row[mic]));
            }
            self.store.save(k, &block);
        }
        self.store.flush()
    }
}
