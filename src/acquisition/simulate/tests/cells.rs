//! The simulation by cells against Eq. 5 in f64, over random scenes, arrays and losses; threads, and resumed runs.

use super::super::columns::Columns;
use super::super::*;
use super::assert_threads_do_not_matter;
use super::losses::{AIR, all_losses, greatest_error};
use super::virtual_tones::{self, ROUNDING, reflectors, scattered, sweep_of};
use crate::acquisition::{MicArray, Sweep};
use crate::progress::Silent;
use crate::wave::Geometry;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// The simulation by some cells and panels, and how many pairs of them are interpolated and how many are not; `None` if
/// no tones serve.
pub(super) fn by_cells(
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
    choice: [usize; 2],
) -> Option<(Vec<Complex32>, [usize; 2])> {
    let plan = CellPlan::forced(reflectors, instrument, options, choice)?;
    let mut samples = vec![Complex32::ZERO; instrument.sweep.len() * instrument.array.len()];
    let job = SimulationJob { reflectors, instrument, options, responses: &[] };
    let mut store = NoStore;
    let mut columns = Columns::new(&mut samples, instrument.array.len(), &mut store);
    plan.simulate(&job, &mut columns, &Silent).expect("not interrupted");
    Some((samples, plan.interpolated()))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

    #[test]
    fn cells_meet_their_tolerance(
        count in 1usize..300,
        // Scenes from among the microphones to far away, from a point to deep ones.
        size in prop::array::uniform3(0.0f64..2.0),
        distance in prop_oneof![Just(0.0), 0.0f64..4.0, Just(300.0)],
        // Planes, lines and boxes of microphones.
        array_size in (0.0f64..1.5, 0.0f64..1.5, prop_oneof![Just(0.0), 0.0f64..0.02, 0.0f64..0.5]),
        microphones in 1usize..300,
        choice in prop::array::uniform2(0usize..100),
        sweep in 0u8..4,
        tolerance in prop::sample::select(vec![1e-3, 1e-5, 1e-6]),
        losses in prop_oneof![Just(Losses::NONE), all_losses()],
        kind in 0u8..3,
        in_phase: bool,
        source in prop::array::uniform3(-0.5f64..0.5),
    ) {
        let reflectors = reflectors(count, DVec3::from_array(size), DVec3::new(0.1, 0.0, distance));
        let array = scattered(microphones, DVec3::from(array_size));
        let place = DVec3::from_array(source);
        let source = (kind == 1).then_some(place);
        let mut instrument = virtual_tones::instrument(sweep_of(sweep), array, source, in_phase);
        let mut options = SimulateOptions { losses, tolerance, ..SimulateOptions::default() };
        if kind == 2 {
            instrument = instrument.with_geometry(Geometry::Pair { offset: place });
            // Which pairs with cells do not have.
            options.losses.speaker_radius = 0.0;
        }
        if let Some((samples, _)) = by_cells(&reflectors, &instrument, &options, choice) {
            let error = greatest_error(&samples, &reflectors, &instrument, &options);
            prop_assert!(error <= tolerance + ROUNDING, "{error:e}, but the tolerance is {tolerance:e}");
        }
    }
}

/// A sheet of reflectors, and an array in front of it.
fn sheet(count: usize) -> (Reflectors, Instrument) {
    let reflectors = reflectors(count, DVec3::new(0.8, 0.6, 0.05), DVec3::new(0.1, 0.0, 1.6));
    let array = MicArray::rectangular([16, 15], [0.05; 2], DVec3::ZERO).expect("ok");
    let sweep = Sweep::stepped(10_000.0, 20_000.0, 100.0).expect("ok");
    (reflectors, Instrument::new(sweep, array))
}

#[test]
fn cells_far_from_panels_are_interpolated_and_near_ones_summed_at_the_microphones() {
    let (far, instrument) = sheet(500);
    let options = SimulateOptions::default();
    let near = reflectors(500, DVec3::new(0.6, 0.6, 0.3), DVec3::new(0.0, 0.0, 0.1));
    let (mut used, offset) = ([0; 2], DVec3::new(0.1, -0.05, 0.03));
    for (reflectors, interpolates) in [(&far, true), (&near, false)] {
        let (mut all, mut served) = ([0; 2], 0);
        for choice in 0..28 {
            for geometry in [Geometry::ORIGIN, Geometry::Monostatic, Geometry::Pair { offset }] {
                let instrument = instrument.clone().with_geometry(geometry);
                let Some((samples, pairs)) = by_cells(reflectors, &instrument, &options, [choice, choice])
                else {
                    continue;
                };
                let error = greatest_error(&samples, reflectors, &instrument, &options);
                assert!(error <= options.tolerance + ROUNDING, "{choice}: {error:e}");
                all = [all[0] + pairs[0], all[1] + pairs[1]];
                served += 1;
            }
        }
        assert!(served >= 28, "{served} choices");
        assert!(interpolates || all[1] > 0, "{all:?}");
        used = [used[0] + all[0], used[1] + all[1]];
    }
    assert!(used[0] > 1000 && used[1] > 1000, "{used:?}");
}

#[test]
fn errors_average_for_many_reflectors_and_are_as_small_as_without_cells() {
    let (reflectors, instrument) = sheet(20_000);
    let options = SimulateOptions::default();
    let run = |tolerance| {
        let options = options.clone().with_tolerance(tolerance);
        simulate(&reflectors, &instrument, &options).expect("small").samples
    };
    assert!(matches!(method(&reflectors, &instrument, &options), SimulationMethod::Cells(_)));
    let exact = run(0.0);
    let peak = exact.iter().map(|m| m.norm()).fold(0.0, f32::max);
    let error = run(1e-6).iter().zip(&exact).map(|(a, b)| (a - b).norm()).fold(0.0, f32::max);
    assert!(error <= 2e-5 * peak, "{error:e} of the peak {peak:e}");
}

#[test]
fn many_reflectors_before_a_moved_pair_are_summed_by_cells() {
    let (reflectors, instrument) = sheet(20_000);
    let offset = DVec3::new(0.05, 0.02, -0.01);
    let pair = instrument.clone().with_geometry(Geometry::Pair { offset });
    let losses = Losses { spreading: true, air: Some(AIR), microphone_radius: 0.003, ..Losses::NONE };
    for losses in [Losses::NONE, losses] {
        let options = SimulateOptions::default().with_losses(losses);
        assert!(matches!(method(&reflectors, &pair, &options), SimulationMethod::Cells(_)));
        let run = |tolerance| {
            let options = options.clone().with_tolerance(tolerance);
            simulate(&reflectors, &pair, &options).expect("small").samples
        };
        let exact = run(0.0);
        let peak = exact.iter().map(|m| m.norm()).fold(0.0, f32::max);
        let error = run(1e-6).iter().zip(&exact).map(|(a, b)| (a - b).norm()).fold(0.0, f32::max);
        assert!(error <= 2e-5 * peak, "{error:e} of the peak {peak:e}");
    }
    // Beams of the speaker, and pairs that are not alike.
    let beams = SimulateOptions::default().with_losses(Losses { speaker_radius: 0.01, ..Losses::NONE });
    assert!(matches!(method(&reflectors, &pair, &beams), SimulationMethod::Literal));
    let sources: Vec<DVec3> = instrument.array.positions().iter().map(|r| -*r).collect();
    let gather = instrument.with_pairs(&sources).expect("as many");
    let options = SimulateOptions::default();
    assert!(matches!(method(&reflectors, &gather, &options), SimulationMethod::Literal));
}

#[test]
fn the_number_of_threads_does_not_change_cells() {
    let (reflectors, instrument) = sheet(20_000);
    let options = SimulateOptions::default();
    assert!(matches!(method(&reflectors, &instrument, &options), SimulationMethod::Cells(_)));
    assert_threads_do_not_matter(&reflectors, &instrument, &options);
}

#[test]
fn the_number_of_threads_does_not_change_cells_with_losses() {
    let (reflectors, instrument) = sheet(3000);
    let losses = Losses { spreading: true, air: Some(AIR), speaker_radius: 0.012, microphone_radius: 0.003 };
    let options = SimulateOptions::default().with_losses(losses);
    for choice in [[3, 0], [9, 1]] {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| by_cells(&reflectors, &instrument, &options, choice)).expect("tones that serve")
        };
        let (one, several) = (run(1), run(7));
        assert!(one.1[0] > 0, "no cell is interpolated");
        assert_eq!(one, several);
    }
}

/// Some finished tiles of an earlier run.
#[derive(Default)]
pub(super) struct EarlierRun {
    pub(super) stored: std::collections::BTreeMap<u64, Vec<Complex32>>,
    /// Only tiles whose number leaves no remainder are given back.
    pub(super) every: u64,
    pub(super) given: usize,
}

impl BlockStore for EarlierRun {
    fn load(&mut self, k: u64, block: &mut [Complex32]) -> Result<bool> {
        let Some(stored) = self.stored.get(&k).filter(|_| k.is_multiple_of(self.every)) else {
            return Ok(false);
        };
        block.copy_from_slice(stored);
        self.given += 1;
        Ok(true)
    }

    fn is_due(&mut self) -> bool {
        true
    }

    fn save(&mut self, k: u64, block: &[Complex32]) {
        self.stored.insert(k, block.to_vec());
    }

    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}

#[test]
fn a_resumed_run_gives_the_same_bytes() {
    let (reflectors, instrument) = sheet(20_000);
    let options = SimulateOptions::default();
    let mut store = EarlierRun { every: u64::MAX, ..EarlierRun::default() };
    let run = |store: &mut EarlierRun| {
        simulate_resumable(std::slice::from_ref(&reflectors), &instrument, &options, store, &Silent)
            .expect("ok")
            .samples
    };
    // No tile has that number but the first, which is not stored yet.
    let whole = run(&mut store);
    assert!(store.stored.len() >= 4 && store.given == 0, "{} tiles", store.stored.len());
    for every in [2, 1] {
        let mut resumed = EarlierRun { stored: store.stored.clone(), every, given: 0 };
        assert_eq!(run(&mut resumed), whole);
        assert_eq!(resumed.given, store.stored.len().div_ceil(every as usize));
    }
}

#[test]
fn few_reflectors_and_far_field_paths_have_no_cells() {
    let (few, instrument) = sheet(3000);
    let (many, _) = sheet(20_000);
    let options = SimulateOptions::default();
    let linear = options.clone().with_model(PropagationModel::Linear);
    for (reflectors, options) in [(&few, &options), (&many, &linear)] {
        assert!(matches!(method(reflectors, &instrument, options), SimulationMethod::Tiles(_)));
    }
}
