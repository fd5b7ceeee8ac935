//! What one process of a job keeps for the others: a volume's tones, so that one compresses the sweep for all of them, and
//! nodes at the ends of its depths.

use crate::blocks::{BlockStore, NodeStore};
use crate::error::Result;
use num_complex::Complex32;
use std::sync::OnceLock;

/// The blocks of a store for tones: the first, one that is there where they are convolved, and that of the first stretch.
const BLOCK: u64 = 0;
pub(crate) const CONVOLVED: u64 = 1;
const STRETCHES: u64 = 2;

/// Numbers that compressing yields beside the tones; each has the bytes of a sample.
pub(super) const NUMBERS: usize = 3;

/// Bytes of all of them.
pub(crate) const BYTES_BESIDE_TONES: u64 = (NUMBERS * size_of::<Complex32>()) as u64;

/// Where the tones of a volume are kept, if they are: one block, the samples `[Q, n_mic]`, `Σ|w m| / Σw`, the level of the
/// samples, and what slabs' tones err by. Of a volume in stretches it has the numbers alone, and each stretch has a block
/// of its samples.
#[derive(Default)]
pub(crate) struct KeptTones<'a> {
    pub(crate) store: Option<&'a mut (dyn BlockStore + Send)>,
    /// Whether they are to be convolved.
    pub(crate) convolved: bool,
    /// Measured while the samples are read, if at all.
    pub(crate) level: Option<&'a OnceLock<f64>>,
    /// What the tones of all slabs err by, relative to `Σ|w m| / Σw`, once it is known.
    pub(crate) error: OnceLock<f64>,
    /// Finds it for others, if they are to know it.
    pub(crate) find_error: Option<&'a (dyn Fn() -> f64 + Sync)>,
    /// Where nodes are shared, if they are.
    pub(crate) nodes: Option<&'a dyn NodeStore>,
}

impl KeptTones<'_> {
    /// The same for a shorter time.
    pub(crate) fn lent(&mut self) -> KeptTones<'_> {
        let store = self.store.as_deref_mut().map(|store| -> &mut (dyn BlockStore + Send) { store });
        KeptTones { store, error: self.error.clone(), ..*self }
    }

    /// Fills a block from the store, and returns what is beside the samples; the block's content is undefined if it is not
    /// there.
    pub(super) fn load(&mut self, block: &mut [Complex32]) -> Result<Option<f64>> {
        let Some(store) = &mut self.store else { return Ok(None) };
        if !store.load(BLOCK, block)? {
            return Ok(None);
        }
        let [modulus, level, error] = [3, 2, 1].map(|from_end| f64_of(block[block.len() - from_end]));
        if let Some(known) = self.level {
            known.get_or_init(|| level);
        }
        if !error.is_nan() {
            self.error.get_or_init(|| error);
        }
        Ok(Some(modulus))
    }

    /// Keeps a block, of which the samples are filled.
    pub(super) fn save(&mut self, block: &mut [Complex32], modulus: f64) -> Result<()> {
        let Some(store) = &mut self.store else { return Ok(()) };
        let level = self.level.and_then(OnceLock::get).copied().unwrap_or(f64::NAN);
        let find_error = self.find_error.filter(|_| store.keeps());
        let error = find_error.map_or(f64::NAN, |find| *self.error.get_or_init(find));
        let numbers = [modulus, level, error];
        let samples = block.len() - NUMBERS;
        block[samples..].copy_from_slice(&numbers.map(bytemuck::cast::<f64, Complex32>));
        if self.convolved && store.keeps() {
            store.save(CONVOLVED, &[Complex32::ONE]);
        }
        store.save(BLOCK, block);
        store.flush()
    }

    /// Whether others take up what is kept.
    pub(super) fn is_asked_for(&self) -> bool {
        self.store.as_ref().is_some_and(|store| store.keeps())
    }

    /// Fills the samples of a stretch from the store; their content is undefined if they are not there.
    pub(super) fn load_stretch(&mut self, stretch: usize, samples: &mut [Complex32]) -> Result<bool> {
        self.store.as_mut().map_or(Ok(false), |store| store.load(STRETCHES + stretch as u64, samples))
    }

    /// Keeps the samples of a stretch. The numbers come after those of all.
    pub(super) fn save_stretch(&mut self, stretch: usize, samples: &[Complex32]) {
        if let Some(store) = &mut self.store {
            store.save(STRETCHES + stretch as u64, samples);
        }
    }
}

fn f64_of(sample: Complex32) -> f64 {
    bytemuck::cast(sample)
}
