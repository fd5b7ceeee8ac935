//! A plan as numbers: one process of a job finds it for all, and nobody cuts reflectors into cells, or an array into tiles,
//! again.
//!
//! They are 32-bit words: what kind of plan, three numbers that it chose, and what it cut, part after part, the first of
//! each with its highest bit set: the reflectors in cells, or the microphones in tiles.

use super::cells::CellPlan;
use super::expand::SimulationPlan;
use super::{SimulateOptions, SimulationJob, SimulationMethod, method};
use crate::acquisition::Instrument;
use crate::alloc::{try_with_capacity, try_zeroed};
use crate::blocks::BlockStore;
use crate::error::Result;
use crate::reflectors::Reflectors;
use num_complex::Complex32;
use std::ops::Range;

/// The block of a simulation's store that has its plan, far beyond those of its tiles.
const BLOCK: u64 = 1 << 48;

/// Words before what is cut, and kinds of plans, of which the first says so.
const HEAD: usize = 4;
const CELLS: u32 = 1;
const TILES: u32 = 2;

/// The first of a part.
const FIRST: u32 = 1 << 31;

/// Samples that a plan for so many reflectors and microphones is stored as; none for too many.
pub(crate) fn simulation_plan_len(reflectors: usize, microphones: usize) -> u64 {
    let most = reflectors.max(microphones);
    if most < FIRST as usize { (HEAD + most).div_ceil(2) as u64 } else { 0 }
}

/// What a plan chose and cut.
#[derive(Debug)]
pub(super) struct PlanNumbers {
    pub(super) chosen: [u32; 3],
    /// What is cut, every number once, and the parts of it.
    pub(super) order: Vec<u32>,
    pub(super) parts: Vec<Range<usize>>,
}

impl PlanNumbers {
    /// Writes those of a kind of plan.
    fn write(&self, kind: u32, words: &mut [u32]) {
        let (head, order) = words.split_at_mut(HEAD);
        head[0] = kind;
        head[1..].copy_from_slice(&self.chosen);
        order[..self.order.len()].copy_from_slice(&self.order);
        for part in &self.parts {
            order[part.start] |= FIRST;
        }
    }

    /// Reads those of a plan that cuts so many; `None` if they are none, or do not fit in memory.
    fn read(words: &[u32], count: usize) -> Option<Self> {
        let words = words.get(1..HEAD + count)?;
        let (chosen, words) = words.split_first_chunk()?;
        let (mut order, mut seen) = (try_with_capacity(count as u64)?, try_zeroed::<u8>(count as u64)?);
        let mut first: Vec<usize> = Vec::new();
        for (at, word) in words.iter().enumerate() {
            let number = word & !FIRST;
            if std::mem::replace(seen.get_mut(number as usize)?, 1) == 1 {
                return None;
            }
            order.push(number);
            if *word != number {
                first.push(at);
            }
        }
        if first.first().is_none_or(|first| *first > 0) {
            return None;
        }
        let ends = first.iter().skip(1).copied().chain([count]);
        let parts = first.iter().copied().zip(ends).map(|(at, end)| at..end).collect();
        Some(Self { chosen: *chosen, order, parts })
    }
}

impl<'a> SimulationMethod<'a> {
    /// The cheapest method that meets the tolerance, as another process has found it, or found now and kept for others.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::error::Error::Interrupted).
    pub(super) fn shared(job: &SimulationJob<'a>, store: &mut dyn BlockStore) -> Result<Self> {
        let SimulationJob { reflectors, instrument, options, .. } = *job;
        let len = simulation_plan_len(reflectors.len(), instrument.array.len());
        let mut samples = try_zeroed(len).unwrap_or_default();
        if store.load(BLOCK, &mut samples)?
            && let Some(method) = Self::stored(&samples, reflectors, instrument, options)
        {
            return Ok(method);
        }
        let method = method(reflectors, instrument, options);
        if store.keeps() && !samples.is_empty() {
            let words = bytemuck::cast_slice_mut(&mut samples);
            match &method {
                Self::Cells(plan) => plan.numbers().write(CELLS, words),
                Self::Tiles(plan) => plan.numbers().write(TILES, words),
                // Nothing was cut.
                Self::Literal => return Ok(method),
            }
            store.save(BLOCK, &samples);
        }
        Ok(method)
    }

    /// The method that was written as these samples; `None` if they are none of this job.
    fn stored(
        samples: &[Complex32],
        reflectors: &'a Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> Option<Self> {
        let words: &[u32] = bytemuck::cast_slice(samples);
        match *words.first()? {
            CELLS => {
                let numbers = PlanNumbers::read(words, reflectors.len())?;
                let plan = CellPlan::of_numbers(numbers, reflectors, instrument, options)?;
                Some(Self::Cells(Box::new(plan)))
            }
            TILES => {
                let numbers = PlanNumbers::read(words, instrument.array.len())?;
                let plan = SimulationPlan::of_numbers(&numbers, reflectors, instrument, options)?;
                Some(Self::Tiles(Box::new(plan)))
            }
            _ => None,
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::acquisition::simulate::simulate_resumable;
    use crate::acquisition::{MicArray, Sweep};
    use crate::progress::Silent;
    use glam::DVec3;
    use std::slice::from_ref;

    /// Keeps the plan of a simulation.
    #[derive(Default)]
    struct Kept {
        plan: Option<Vec<Complex32>>,
        given: usize,
    }

    impl BlockStore for Kept {
        fn load(&mut self, k: u64, samples: &mut [Complex32]) -> Result<bool> {
            let Some(plan) = self.plan.as_ref().filter(|_| k == BLOCK) else { return Ok(false) };
            samples.copy_from_slice(plan);
            self.given += 1;
            Ok(true)
        }

        fn keeps(&self) -> bool {
            true
        }

        fn save(&mut self, k: u64, samples: &[Complex32]) {
            if k == BLOCK {
                self.plan = Some(samples.to_vec());
            }
        }
    }

    /// Words that are changed one at a time; whether none of these is a plan.
    fn refuses(
        plan: &[Complex32],
        job: (&Reflectors, &Instrument, &SimulateOptions),
        changes: &[(usize, u32)],
    ) -> bool {
        changes.iter().all(|(at, word)| {
            let mut other = plan.to_vec();
            bytemuck::cast_slice_mut(&mut other)[*at] = *word;
            SimulationMethod::stored(&other, job.0, job.1, job.2).is_none()
        })
    }

    #[test]
    fn a_plan_that_another_process_has_found_gives_the_same_bytes_and_a_wrong_one_is_none() {
        let part = |i: usize, k: f64| (i as f64 * k).fract() - 0.5;
        let place = |i: usize| {
            DVec3::new(
                0.1 + 0.8 * part(i, 0.618_034),
                0.6 * part(i, 0.754_878),
                1.6 + 0.05 * part(i, 0.569_84),
            )
        };
        let array = MicArray::rectangular([16, 15], [0.05; 2], DVec3::ZERO).unwrap();
        let instrument = Instrument::new(Sweep::stepped(10_000.0, 20_000.0, 100.0).unwrap(), array);
        let options = SimulateOptions::default();
        // Many reflectors are cut into cells, of fewer the array into tiles.
        for (count, kind) in [(20_001, CELLS), (5_001, TILES)] {
            let reflectors =
                Reflectors::new((0..count).map(place).collect(), vec![Complex32::ONE; count]).unwrap();
            let job = (&reflectors, &instrument, &options);
            let run = |store: &mut Kept| {
                simulate_resumable(from_ref(&reflectors), &instrument, &options, store, &Silent)
                    .unwrap()
                    .samples
            };
            let mut kept = Kept::default();
            let whole = run(&mut kept);
            assert!(kept.given == 0 && kept.plan.is_some());
            assert!(run(&mut kept) == whole && kept.given == 1);
            let plan = kept.plan.take().unwrap();
            let words: &[u32] = bytemuck::cast_slice(&plan);
            assert!(words[0] == kind && words[HEAD] & FIRST != 0);
            let cut = if kind == CELLS { count } else { 240 };
            assert!(words[HEAD..HEAD + cut].iter().filter(|word| **word & FIRST != 0).count() > 3);
            let wrong = [
                (0, 0),
                // The other kind, and a design that there is not.
                (0, CELLS + TILES - kind),
                (1, 99),
                // No first part, something twice, and something that there is not.
                (HEAD, words[HEAD] & !FIRST),
                (HEAD + 7, words[HEAD + 7] ^ 1),
                (HEAD + 9, 20_001),
            ];
            assert!(refuses(&plan, job, &wrong));
            // Designs of cells and panels that there are not; a tile that is too large.
            assert!(kind == TILES || refuses(&plan, job, &[(2, 99), (3, 40)]));
            let second = (HEAD + 1..words.len()).find(|at| words[*at] & FIRST != 0).unwrap();
            assert!(kind == CELLS || refuses(&plan, job, &[(second, words[second] & !FIRST)]));
            for samples in [&plan[..cut / 3], &[]] {
                assert!(SimulationMethod::stored(samples, job.0, job.1, job.2).is_none());
            }
        }
    }
}
