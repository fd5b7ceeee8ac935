//! What a sum over loudspeakers takes, and how many of them share their kernels.

use super::end_slabs;
use crate::acquisition::Instrument;
use crate::error::Result;
use crate::grid::Grid;
use crate::reconstruct::plan::{Candidates, Estimate, Estimates, chosen_among};
use crate::reconstruct::{Method, ReconstructOptions};

/// The most transmissions that share kernels: these then take an eighth of what they did, and the spectra of the samples are
/// not too many.
const TOGETHER: usize = 8;

/// Bytes that sharing may take where as little as possible is worked on at a time.
const SHARED_BYTES: u64 = 256 << 20;

/// How the transmissions of a job are summed: by one method, a group of them at a time.
pub(super) struct Course {
    /// The plans for the first one.
    pub(super) first: Candidates,
    /// Of all of them, without the slab that they are summed in.
    pub(super) estimates: Estimates,
    /// How many share their kernels, at the most.
    pub(super) group: usize,
}

impl Course {
    /// Whether kernels are shared follows from the job alone, whatever memory there is: it may change the last bits.
    pub(super) fn new(
        instrument: &Instrument,
        grid: &Grid,
        options: &ReconstructOptions,
        threads: usize,
    ) -> Result<Self> {
        let first = Candidates::new(&instrument.transmission(0), grid, options, threads)?;
        let alone = of_all(instrument, first.estimates().to_vec(), 1);
        // As many in each group as in any.
        let count = instrument.transmissions();
        let group = count.div_ceil(count.div_ceil(TOGETHER));
        let shared = match shared(instrument, grid, options, (group, threads))? {
            Some(shared) if is_less(&shared, &alone) => Some(shared),
            _ => None,
        };
        let sharing = shared.is_some();
        let methods = with_shared(alone, shared);
        let chosen = chosen_among(&methods, options.method);
        // Another method may take less even so, and works on one at a time.
        let group = if sharing && methods[chosen].method == Method::Convolution { group } else { 1 };
        Ok(Self { first, estimates: Estimates { methods, chosen }, group })
    }

    /// The estimates with the memory of the longest slab, the last one's paths being the longest, too.
    pub(super) fn with_longest_slab(
        self,
        instrument: &Instrument,
        grid: &Grid,
        options: &ReconstructOptions,
        threads: usize,
    ) -> Result<Estimates> {
        let Estimates { mut methods, chosen } = self.estimates;
        let first = instrument.transmission(0);
        for part in end_slabs(grid).filter(|part| part != grid) {
            let alone = Candidates::new(&first, &part, options, threads)?.estimates().to_vec();
            let shared = match self.group {
                1 => None,
                group => shared(instrument, &part, options, (group, threads))?,
            };
            let of_part = with_shared(of_all(instrument, alone, 1), shared);
            methods.iter_mut().zip(of_part).for_each(|(all, part)| all.bytes = all.bytes.max(part.bytes));
        }
        Ok(Estimates { methods, chosen })
    }
}

/// What all transmissions take, by what a group of them does.
fn of_all(instrument: &Instrument, methods: Vec<Estimate>, group: usize) -> Vec<Estimate> {
    let times = instrument.transmissions() as f64 / group as f64;
    let of_all = |estimate: Estimate| Estimate { operations: estimate.operations * times, ..estimate };
    methods.into_iter().map(of_all).collect()
}

/// What convolution takes for all transmissions where `group` of them share their kernels, if they can.
fn shared(
    instrument: &Instrument,
    grid: &Grid,
    options: &ReconstructOptions,
    (group, threads): (usize, usize),
) -> Result<Option<Estimate>> {
    // Each has a gain of its own where the spreading is compensated.
    let asked = matches!(options.method, Method::Auto | Method::Convolution);
    if group == 1 || !asked || options.compensate || options.tolerance <= 0.0 {
        return Ok(None);
    }
    let some = instrument.some_transmissions(0..group);
    let of_group = |options: &ReconstructOptions| -> Result<Option<Estimate>> {
        let found = Candidates::among(&some, grid, options, (threads, Some(Method::Convolution)))?;
        Ok(of_all(instrument, found.estimates().to_vec(), group).into_iter().find(is_possible))
    };
    let least = of_group(&options.with_memory(Some(0)))?;
    if least.is_none_or(|least| least.bytes > SHARED_BYTES) {
        return Ok(None);
    }
    of_group(options)
}

fn is_possible(estimate: &Estimate) -> bool {
    estimate.method == Method::Convolution && estimate.obstacle.is_none()
}

/// Whether sharing takes fewer operations than convolution without does.
fn is_less(shared: &Estimate, alone: &[Estimate]) -> bool {
    let least = alone.iter().find(|estimate| is_possible(estimate));
    least.is_none_or(|alone| shared.operations < alone.operations)
}

/// These estimates with another of convolution, if there is one.
fn with_shared(mut methods: Vec<Estimate>, shared: Option<Estimate>) -> Vec<Estimate> {
    if let Some(shared) = shared {
        methods.iter_mut().filter(|e| e.method == shared.method).for_each(|e| *e = shared.clone());
    }
    methods
}
