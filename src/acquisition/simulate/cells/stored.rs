//! A plan as numbers: one process of a job finds it for all, and nobody cuts the reflectors into cells again.
//!
//! They are 32-bit words: whether there is one, the designs of its tones, how often the array is halved into panels, and
//! the reflectors in the order of the cells, the first of each with its highest bit set.

use super::CellPlan;
use super::choice::CellTones;
use super::panels::PanelSize;
use super::tree::CellTree;
use crate::acquisition::Instrument;
use crate::acquisition::simulate::{SimulateOptions, SimulationJob, SimulationMethod, method};
use crate::alloc::try_zeroed;
use crate::blocks::BlockStore;
use crate::error::Result;
use crate::reflectors::Reflectors;
use num_complex::Complex32;

/// The block of a simulation's store that has its plan, far beyond those of its tiles.
const BLOCK: u64 = 1 << 48;

/// Words before the order, of which the first says that they are a plan.
const HEAD: usize = 4;
const PLAN: u32 = 1;

/// The first reflector of a cell.
const FIRST: u32 = 1 << 31;

/// Samples that a plan for so many reflectors is stored as; none for too many.
pub(crate) const fn simulation_plan_len(reflectors: usize) -> u64 {
    if reflectors < FIRST as usize { (HEAD + reflectors).div_ceil(2) as u64 } else { 0 }
}

impl<'a> SimulationMethod<'a> {
    /// The cheapest method that meets the tolerance, as another process has found it, or found now and kept for others.
    ///
    /// # Errors
    /// [`Error::Interrupted`](crate::error::Error::Interrupted).
    pub(in super::super) fn shared(job: &SimulationJob<'a>, store: &mut dyn BlockStore) -> Result<Self> {
        let SimulationJob { reflectors, instrument, options, .. } = *job;
        if !CellPlan::is_possible(reflectors, instrument, options) {
            return Ok(method(reflectors, instrument, options));
        }
        let mut samples = try_zeroed(simulation_plan_len(reflectors.len())).unwrap_or_default();
        if store.load(BLOCK, &mut samples)?
            && let Some(plan) = CellPlan::stored(&samples, reflectors, instrument, options)
        {
            return Ok(Self::Cells(Box::new(plan)));
        }
        let method = method(reflectors, instrument, options);
        if let Self::Cells(plan) = &method
            && store.keeps()
            && !samples.is_empty()
        {
            plan.store(&mut samples);
            store.save(BLOCK, &samples);
        }
        Ok(method)
    }
}

impl<'a> CellPlan<'a> {
    /// Writes it as so many samples.
    fn store(&self, samples: &mut [Complex32]) {
        let (head, order) = bytemuck::cast_slice_mut::<_, u32>(samples).split_at_mut(HEAD);
        let [intervals, cells, times] = self.choice.map(|chosen| chosen as u32);
        head.copy_from_slice(&[PLAN, intervals, cells, times]);
        order[..self.tree.order.len()].copy_from_slice(&self.tree.order);
        for cell in &self.tree.cells {
            order[cell.members.start] |= FIRST;
        }
    }

    /// The plan that was written as these samples; `None` if they are none of this job.
    fn stored(
        samples: &[Complex32],
        reflectors: &'a Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> Option<Self> {
        let (head, order) = bytemuck::cast_slice::<_, u32>(samples).split_at_checked(HEAD)?;
        let [PLAN, intervals, cells, times] = *head else { return None };
        let order = order.get(..reflectors.len())?;
        let size = PanelSize::new(instrument.array.positions(), times as usize)?;
        let designs = [intervals as usize, cells as usize];
        let tones = CellTones::of(designs, reflectors, instrument, options)?;
        let starts = order.iter().map(|word| word & FIRST != 0);
        let tree = CellTree::in_order(reflectors, order.iter().map(|word| word & !FIRST), starts)?;
        tones.plan(tree, &size, reflectors, instrument, options)
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
        let places: Vec<DVec3> = (0..20_001).map(place).collect();
        let reflectors = Reflectors::new(places, vec![Complex32::ONE; 20_001]).unwrap();
        let array = MicArray::rectangular([16, 15], [0.05; 2], DVec3::ZERO).unwrap();
        let instrument = Instrument::new(Sweep::stepped(10_000.0, 20_000.0, 100.0).unwrap(), array);
        let options = SimulateOptions::default();
        let run = |store: &mut Kept| {
            simulate_resumable(from_ref(&reflectors), &instrument, &options, store, &Silent).unwrap().samples
        };
        let mut kept = Kept::default();
        let whole = run(&mut kept);
        assert!(kept.given == 0 && kept.plan.is_some());
        assert!(run(&mut kept) == whole && kept.given == 1);
        let plan = kept.plan.take().unwrap();
        let read = |samples: &[Complex32]| CellPlan::stored(samples, &reflectors, &instrument, &options);
        let found = read(&plan).unwrap();
        assert!(found.tree.cells.len() > 10 && found.tree.order.len() == 20_001);
        let word = |at: usize, change: &dyn Fn(u32) -> u32| {
            let mut other = plan.clone();
            let words: &mut [u32] = bytemuck::cast_slice_mut(&mut other);
            words[at] = change(words[at]);
            read(&other).is_none()
        };
        // None, designs and panels that there are not, no first cell, a reflector twice, and one that there is not.
        assert!(word(0, &|_| 0) && word(1, &|_| 99) && word(2, &|_| 99) && word(3, &|_| 40));
        assert!(word(HEAD, &|word| word & !FIRST) && word(HEAD + 7, &|word| word ^ 1));
        assert!(word(HEAD + 9, &|_| 20_001) && read(&plan[..9000]).is_none());
        assert!(read(&[]).is_none());
    }
}
