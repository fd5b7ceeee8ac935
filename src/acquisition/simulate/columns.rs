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

    /// Fills the columns of tile `k`, which has these microphones, if they are stored; `true` too where they are not wanted.
    pub(super) fn load(&mut self, k: usize, microphones: &[usize]) -> Result<bool> {
        if self.store.skips(k as u64) {
            return Ok(true);
        }
        let frequencies = self.samples.len() / self.n_mic;
        let mut block = try_zeroed((frequencies * microphones.len()) as u64).ok_or_else(no_room)?;
        match self.store.load(k as u64, &mut block) {
            Ok(true) => {}
            Ok(false) => return Ok(false),
            Err(stopped) => {
                // What was finished before is not lost.
                self.save()?;
                return Err(stopped);
            }
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
        if self.store.is_due() { self.save() } else { Ok(()) }
    }

    fn save(&mut self) -> Result<()> {
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

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::error::Error;

    /// Nothing is stored yet, it is never time to save, and a stop is requested while block 2 is read.
    #[derive(Default)]
    struct Stopped(Vec<(u64, Vec<Complex32>)>);

    impl BlockStore for Stopped {
        fn load(&mut self, k: u64, _: &mut [Complex32]) -> Result<bool> {
            if k == 2 { Err(Error::Interrupted) } else { Ok(false) }
        }

        fn is_due(&mut self) -> bool {
            false
        }

        fn save(&mut self, k: u64, block: &[Complex32]) {
            self.0.push((k, block.to_vec()));
        }

        fn flush(&mut self) -> Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_stop_while_a_tile_is_read_loses_no_finished_tile() {
        let mut samples: Vec<_> = (0..8_u8).map(|i| Complex32::new(i.into(), 0.0)).collect();
        let mut store = Stopped::default();
        let mut columns = Columns::new(&mut samples, 4, &mut store);
        for (k, tile) in [[0, 1], [3, 2]].iter().enumerate() {
            assert_eq!(columns.load(k, tile), Ok(false));
            columns.finish(k, tile);
            columns.save_if_due().unwrap();
        }
        assert_eq!(columns.load(2, &[0, 1]), Err(Error::Interrupted));
        let saved = |k: u64, values: [u8; 4]| (k, values.map(|i| Complex32::new(i.into(), 0.0)).to_vec());
        assert_eq!(store.0, [saved(0, [0, 1, 4, 5]), saved(1, [3, 2, 7, 6])]);
    }
}
