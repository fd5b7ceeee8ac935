//! Samples on their way: columns of tiles of microphones, which may come from an earlier run and are kept for a later.

use super::no_room;
use crate::alloc::{try_with_capacity, try_zeroed};
use crate::error::Result;
use crate::progress::Keeper;
use num_complex::Complex32;

/// The samples of a cube, `[n_f, n_mic]`, whose finished columns are handed over when they are wanted.
pub(super) struct KeptSamples<'a> {
    pub(super) samples: &'a mut [Complex32],
    /// Microphones.
    pub(super) width: usize,
    pub(super) keeper: &'a mut dyn Keeper,
    /// Tiles that are finished and not handed over yet: their numbers and microphones.
    pub(super) finished: Vec<(u64, Vec<usize>)>,
}

impl KeptSamples<'_> {
    /// Whether the tile `k` of these microphones is at hand; then its columns are filled in.
    pub(super) fn recall(&mut self, k: usize, microphones: &[usize]) -> Result<bool> {
        let frequencies = self.samples.len() / self.width;
        // A keeper with nothing costs no more than asking.
        let mut block = try_zeroed((frequencies * microphones.len()) as u64).ok_or_else(no_room)?;
        if !self.keeper.recall(k as u64, &mut block)? {
            return Ok(false);
        }
        let rows = self.samples.chunks_exact_mut(self.width);
        for (row, kept) in rows.zip(block.chunks_exact(microphones.len())) {
            microphones.iter().zip(kept).for_each(|(&mic, m)| row[mic] = *m);
        }
        Ok(true)
    }

    /// Takes note of a tile whose columns are filled.
    pub(super) fn finish(&mut self, k: usize, microphones: &[usize]) {
        self.finished.push((k as u64, microphones.to_vec()));
    }

    /// Hands over what is finished, if it is wanted now.
    pub(super) fn pause(&mut self) -> Result<()> {
        if !self.keeper.is_due() {
            return Ok(());
        }
        let most = self.finished.iter().map(|(_, microphones)| microphones.len()).max().unwrap_or(0);
        let mut block =
            try_with_capacity((self.samples.len() / self.width * most) as u64).ok_or_else(no_room)?;
        for (k, microphones) in self.finished.drain(..) {
            block.clear();
            for row in self.samples.chunks_exact(self.width) {
                block.extend(microphones.iter().map(|&mic| row[mic]));
            }
            self.keeper.keep(k, &block)?;
        }
        self.keeper.kept()
    }
}
