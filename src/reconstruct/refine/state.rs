//! What a solver has after a step, stored so that an interrupted run resumes after it.

use super::RefineOptions;
use super::operator::Operator;
use crate::acquisition::Instrument;
use crate::blocks::BlockStore;
use crate::error::Result;
use crate::grid::Grid;
use crate::reconstruct::plan::cost::COMPLEX;
use num_complex::Complex32;

/// Numbers that a solver keeps beside its volumes and tones.
const SCALARS: usize = 8;

/// Samples of a block.
const BLOCK: usize = 1 << 20;

/// Sets of volumes and of tones that any solver has.
const SETS: u64 = 2;

impl RefineOptions {
    /// How many blocks a refinement may store, and the bytes of the largest.
    pub(crate) fn blocks(&self, instrument: &Instrument, grid: &Grid) -> [u64; 2] {
        let blocks_of = |samples: u64| samples.div_ceil(BLOCK as u64);
        let tones = (instrument.transmissions() * instrument.sweep.len()) as u64;
        let samples = tones * instrument.array.len() as u64;
        let step = 1 + SETS * (blocks_of(grid.voxel_count()) + blocks_of(samples));
        [step.saturating_mul(self.steps as u64 + 1), COMPLEX * BLOCK as u64]
    }
}

/// Volumes and tones after a step, and a few numbers.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct State<const N: usize, const M: usize> {
    pub(super) step: usize,
    pub(super) scalars: [f64; SCALARS],
    pub(super) volumes: [Vec<Complex32>; N],
    pub(super) tones: [Vec<Complex32>; M],
}

impl<const N: usize, const M: usize> State<N, M> {
    /// Before the first step, all zero.
    ///
    /// # Errors
    /// It does not fit in memory.
    pub(super) fn empty(operator: &Operator<'_>) -> Result<Self> {
        let (mut volumes, mut tones) = ([const { Vec::new() }; N], [const { Vec::new() }; M]);
        volumes.iter_mut().try_for_each(|volume| operator.darkness().map(|zeros| *volume = zeros))?;
        tones.iter_mut().try_for_each(|tones| operator.silence().map(|zeros| *tones = zeros))?;
        Ok(Self { step: 0, scalars: [0.0; SCALARS], volumes, tones })
    }

    /// Takes up the last of `steps` that is stored, if there is one, in the place of what is held, which has the shapes.
    pub(super) fn resume(&mut self, store: &mut dyn BlockStore, steps: usize) -> Result<()> {
        let mut scalars = [Complex32::ZERO; SCALARS];
        for step in (1..=steps).rev() {
            let first = step as u64 * self.blocks();
            if !store.load(first, &mut scalars)? {
                continue;
            }
            let mut whole = true;
            for (k, block) in (first + 1..).zip(self.blocks_mut()) {
                whole = whole && store.load(k, block)?;
            }
            if whole {
                self.step = step;
                self.scalars.copy_from_slice(bytemuck::cast_slice(&scalars));
                return Ok(());
            }
        }
        if self.step == 0 {
            // What was read in part.
            self.blocks_mut().for_each(|block| block.fill(Complex32::ZERO));
        }
        Ok(())
    }

    /// Stores it if it is time to.
    pub(super) fn save(&self, store: &mut dyn BlockStore) -> Result<()> {
        if !store.is_due() {
            return Ok(());
        }
        let first = self.step as u64 * self.blocks();
        store.save(first, bytemuck::cast_slice(&self.scalars));
        let blocks = self.volumes.iter().chain(&self.tones).flat_map(|part| part.chunks(BLOCK));
        for (k, block) in (first + 1..).zip(blocks) {
            store.save(k, block);
        }
        store.flush()
    }

    /// Blocks of a step: the numbers, then parts of volumes and tones.
    fn blocks(&self) -> u64 {
        let parts = self.volumes.iter().chain(&self.tones);
        1 + parts.map(|part| part.len().div_ceil(BLOCK) as u64).sum::<u64>()
    }

    fn blocks_mut(&mut self) -> impl Iterator<Item = &mut [Complex32]> {
        self.volumes.iter_mut().chain(&mut self.tones).flat_map(|part| part.chunks_mut(BLOCK))
    }
}
