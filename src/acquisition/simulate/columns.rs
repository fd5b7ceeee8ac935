//! The columns of a cube, which a simulation fills tile by tile of microphones: loaded where an interrupted run has
//! stored them, and saved as they are finished.

use super::no_room;
use crate::alloc::{try_with_capacity, try_zeroed};
use crate::blocks::BlockStore;
use crate::error::Result;
use num_complex::Complex32;

/// The samples of a cube and the store of its tiles. Block k is tile k, `[n_f, microphone of the tile]`.
pub(super) struct Columns<'a> {
    /// `[n_f, n_mic]`, or nothing where tiles are for the store alone.
    samples: &'a mut [Complex32],
    /// Then the columns of the tiles that were filled last.
    some: Vec<Complex32>,
    n_f: usize,
    n_mic: usize,
    store: &'a mut dyn BlockStore,
    /// Tiles that are finished and not saved yet: their numbers and columns.
    finished: Vec<(u64, Vec<usize>)>,
}

impl<'a> Columns<'a> {
    /// Of a whole cube, `[n_f, n_mic]`.
    pub(super) fn new(samples: &'a mut [Complex32], n_mic: usize, store: &'a mut dyn BlockStore) -> Self {
        let n_f = samples.len() / n_mic;
        Self { samples, some: Vec::new(), n_f, n_mic, store, finished: Vec::new() }
    }

    /// Of tiles that the store wants, without the others' samples.
    pub(super) fn for_store([n_f, n_mic]: [usize; 2], store: &'a mut dyn BlockStore) -> Self {
        Self { samples: &mut [], some: Vec::new(), n_f, n_mic, store, finished: Vec::new() }
    }

    /// What stores them.
    pub(super) fn store(&mut self) -> &mut dyn BlockStore {
        self.store
    }

    /// Fills the columns of tile `k`, which has these microphones, if they are stored; `true` too where they are not wanted.
    pub(super) fn load(&mut self, k: usize, microphones: &[usize]) -> Result<bool> {
        if self.store.skips(k as u64) {
            return Ok(true);
        }
        let mut block = try_zeroed((self.n_f * microphones.len()) as u64).ok_or_else(no_room)?;
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

    /// Has the columns of tiles filled, each given by its number and microphones.
    ///
    /// `write` takes samples in rows of this width, one for each frequency, and the columns of each tile there.
    pub(super) fn fill(
        &mut self,
        tiles: &[(usize, &[usize])],
        write: impl FnOnce(&mut [Complex32], usize, &[Vec<usize>]),
    ) -> Result<()> {
        let mut width = self.n_mic;
        let mut columns: Vec<Vec<usize>> =
            tiles.iter().map(|(_, microphones)| microphones.to_vec()).collect();
        if self.samples.is_empty() {
            // Those before them have no place any more.
            self.save()?;
            width = 0;
            for columns in &mut columns {
                *columns = (width..width + columns.len()).collect();
                width += columns.len();
            }
            self.some = Vec::new();
            self.some = try_zeroed((self.n_f * width) as u64).ok_or_else(no_room)?;
        }
        let samples = if self.samples.is_empty() { &mut self.some } else { &mut *self.samples };
        write(samples, width, &columns);
        self.finished.extend(tiles.iter().map(|(k, _)| *k as u64).zip(columns));
        Ok(())
    }

    /// Saves the finished tiles, if it is time.
    pub(super) fn save_if_due(&mut self) -> Result<()> {
        if self.store.is_due() { self.save() } else { Ok(()) }
    }

    fn save(&mut self) -> Result<()> {
        let most = self.finished.iter().map(|(_, columns)| columns.len()).max().unwrap_or(0);
        let mut block = try_with_capacity((self.n_f * most) as u64).ok_or_else(no_room)?;
        let samples = if self.samples.is_empty() { &self.some } else { &*self.samples };
        for (k, columns) in self.finished.drain(..) {
            block.clear();
            for row in samples.chunks_exact(samples.len() / self.n_f) {
                block.extend(columns.iter().map(|&column| row[column]));
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
    fn without_a_cube_tiles_reach_the_store_as_with_one() {
        let saved = |mut samples: Vec<Complex32>| {
            let mut store = Stopped::default();
            let mut columns = if samples.is_empty() {
                Columns::for_store([2, 5], &mut store)
            } else {
                Columns::new(&mut samples, 5, &mut store)
            };
            for tiles in [&[(0, &[4, 1][..]), (1, &[0])][..], &[(3, &[2, 3])]] {
                let write = |samples: &mut [Complex32], width: usize, columns: &[Vec<usize>]| {
                    for (f, row) in samples.chunks_exact_mut(width).enumerate() {
                        for (column, mic) in
                            columns.iter().flatten().zip(tiles.iter().flat_map(|(_, mics)| *mics))
                        {
                            row[*column] = Complex32::new(f as f32, *mic as f32);
                        }
                    }
                };
                columns.fill(tiles, write).unwrap();
            }
            columns.save().unwrap();
            store.0
        };
        let alone = saved(Vec::new());
        assert_eq!(alone.len(), 3);
        assert_eq!(alone, saved(vec![Complex32::ZERO; 10]));
    }

    #[test]
    fn a_stop_while_a_tile_is_read_loses_no_finished_tile() {
        let mut samples: Vec<_> = (0..8_u8).map(|i| Complex32::new(i.into(), 0.0)).collect();
        let mut store = Stopped::default();
        let mut columns = Columns::new(&mut samples, 4, &mut store);
        for (k, tile) in [[0, 1], [3, 2]].iter().enumerate() {
            assert_eq!(columns.load(k, tile), Ok(false));
            columns.fill(&[(k, tile)], |_, _, _| {}).unwrap();
            columns.save_if_due().unwrap();
        }
        assert_eq!(columns.load(2, &[0, 1]), Err(Error::Interrupted));
        let saved = |k: u64, values: [u8; 4]| (k, values.map(|i| Complex32::new(i.into(), 0.0)).to_vec());
        assert_eq!(store.0, [saved(0, [0, 1, 4, 5]), saved(1, [3, 2, 7, 6])]);
    }
}
