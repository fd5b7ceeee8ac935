//! Virtual tones against Eq. 5 in f64, over random scenes, arrays, sweeps, tiles and durations.

use super::super::columns::Columns;
use super::super::cost::{self, candidates};
use super::super::expand::fast;
use super::super::virtual_tones::{TONE_DESIGNS, ToneDesign};
use super::super::*;
use super::assert_threads_do_not_matter;
use super::losses::greatest_error;
use crate::acquisition::{MicArray, Sweep};
use crate::progress::Silent;
use crate::wave::Geometry;
use crate::wave::phasor;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// The error that f32 adds to the tolerance, relative to `Σ|A|`: rounding of phases and sums, times the size of the
/// weights. A phase step with an error of 7·10⁻⁷ is repeated 23 times for 47 tones: up to 1.7·10⁻⁵ for a single echo, and
/// a fraction of it for many.
pub(super) const ROUNDING: f64 = 2e-5;

/// A quasi-random number in ±½.
fn fraction(i: usize, k: f64) -> f64 {
    (i as f64 * k).fract() - 0.5
}

pub(super) fn reflectors(count: usize, size: DVec3, centre: DVec3) -> Reflectors {
    let place =
        |i| centre + size * DVec3::new(fraction(i, 0.618_034), fraction(i, 0.754_878), fraction(i, 0.569_84));
    let amplitudes = (0..count).map(|i| phasor(fraction(i, 0.413_59)) * (i % 5) as f32).collect();
    Reflectors::new((0..count).map(place).collect(), amplitudes).expect("finite")
}

/// Microphones on no lattice and in no plane.
pub(super) fn scattered(count: usize, size: DVec3) -> MicArray {
    let place = |i| size * DVec3::new(fraction(i, 0.445_041), fraction(i, 0.801_938), fraction(i, 0.286_62));
    MicArray::from_positions((0..count).map(place).collect()).expect("ok")
}

/// The simulation by virtual tones with the given tiles and tones.
pub(super) fn forced(
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
    design: ToneDesign,
    count: usize,
) -> Vec<Complex32> {
    let radius = cost::widest_tile(design, instrument);
    let candidate = cost::CandidatePlan { microphones: count, radius, design, held: 50 };
    let plan = SimulationPlan::of(&candidate, reflectors, instrument, options).expect("a standard duration");
    let mut samples = vec![Complex32::ZERO; instrument.sweep.len() * instrument.array.len()];
    let job = SimulationJob { reflectors, instrument, options, responses: &[] };
    let mut store = NoStore;
    let mut columns = Columns::new(&mut samples, instrument.array.len(), &mut store);
    fast(&job, &plan, &mut columns, &Silent).expect("not interrupted");
    samples
}

pub(super) fn sweep_of(kind: u8) -> Sweep {
    match kind {
        0 => Sweep::stepped(10_000.0, 20_000.0, 50.0).expect("ok"),
        1 => Sweep::stepped(18_000.0, 20_000.0, 20.0).expect("ok"),
        2 => Sweep::from_frequencies(vec![900.0, 1000.5, 5000.0, 20_000.25]).expect("ok"),
        _ => {
            let uneven = (0..70).map(|n| 15_000.0 + 70.0 * f64::from(n) + 20.0 * f64::from(n % 3)).collect();
            Sweep::from_frequencies(uneven).expect("ok")
        }
    }
}

/// A monostatic scan without a source.
pub(super) fn instrument(sweep: Sweep, array: MicArray, source: Option<DVec3>, in_phase: bool) -> Instrument {
    let geometry = source.map_or(Geometry::Monostatic, |source| Geometry::FixedSource { source });
    let detection = if in_phase { Detection::InPhase } else { Detection::Quadrature };
    Instrument::new(sweep, array).with_geometry(geometry).with_detection(detection)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 160, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

    #[test]
    fn virtual_tones_meet_their_tolerance(
        count in 0usize..300,
        // Scenes from among the microphones to far away, from a point to deep ones.
        size in prop::array::uniform3(0.0f64..3.0),
        distance in prop_oneof![Just(0.0), 0.0f64..4.0, Just(300.0)],
        array_size in prop::array::uniform3(0.0f64..1.0),
        microphones in 1usize..40,
        design in prop::sample::select(TONE_DESIGNS.to_vec()),
        tile in prop::sample::select(vec![1usize, 4, 16, 64]),
        sweep in 0u8..4,
        tolerance in prop::sample::select(vec![1e-3, 1e-5, 1e-6]),
        monostatic: bool,
        linear: bool,
        in_phase: bool,
        source in prop::array::uniform3(-0.5f64..0.5),
    ) {
        let reflectors = reflectors(count, DVec3::from_array(size), DVec3::new(0.1, 0.0, distance));
        let array = scattered(microphones, DVec3::from_array(array_size));
        let source = (!monostatic).then_some(DVec3::from_array(source));
        let instrument = instrument(sweep_of(sweep), array, source, in_phase);
        let options = SimulateOptions {
            model: if linear { PropagationModel::Linear } else { PropagationModel::Exact },
            tolerance,
            ..SimulateOptions::default()
        };
        let samples = forced(&reflectors, &instrument, &options, design, tile);
        let error = greatest_error(&samples, &reflectors, &instrument, &options);
        prop_assert!(error <= tolerance + ROUNDING, "{error:e}, but the tolerance is {tolerance:e}");
    }
}

#[test]
fn a_single_echo_is_exact_to_f32() {
    // The error of one reflector does not average out.
    let reflectors =
        Reflectors::new(vec![DVec3::new(0.2, -0.3, 1.7)], vec![Complex32::new(0.6, -0.8)]).expect("finite");
    let array = MicArray::rectangular([12, 9], [0.008; 2], DVec3::ZERO).expect("ok");
    let instrument = Instrument::new(sweep_of(0), array);
    let options = SimulateOptions::default();
    for design in TONE_DESIGNS {
        let samples = forced(&reflectors, &instrument, &options, design, 64);
        let error = greatest_error(&samples, &reflectors, &instrument, &options);
        assert!(error <= options.tolerance + ROUNDING, "{design:?}: {error:e}");
    }
}

/// The plan of tiles, which is chosen without cells.
pub(super) fn plan(
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
) -> Option<SimulationPlan> {
    match method(reflectors, instrument, options) {
        SimulationMethod::Tiles(plan) => Some(*plan),
        SimulationMethod::Cells(_) | SimulationMethod::Literal => None,
    }
}

/// Jobs that are large enough for virtual tones to be chosen, of every shape.
fn jobs(sweep: &Sweep) -> Vec<(Reflectors, Instrument, SimulateOptions)> {
    let with = |array: MicArray| Instrument::new(sweep.clone(), array);
    let wide = MicArray::rectangular([24, 20], [0.1; 2], DVec3::new(0.2, 0.0, 0.0)).expect("ok");
    let dense = MicArray::rectangular([20, 16], [0.008; 2], DVec3::ZERO).expect("ok");
    let line = MicArray::rectangular([255, 1], [0.009; 2], DVec3::ZERO).expect("ok");
    let cloud = scattered(200, DVec3::new(0.6, 0.4, 0.2));
    let shallow = reflectors(1500, DVec3::new(1.0, 1.0, 0.2), DVec3::new(0.0, 0.1, 1.5));
    let deep = reflectors(1500, DVec3::new(2.0, 2.0, 7.0), DVec3::new(0.0, 0.1, 4.0));
    let around = reflectors(1500, DVec3::new(1.0, 0.8, 0.6), DVec3::ZERO);
    let default = SimulateOptions::default();
    let linear = default.clone().with_model(PropagationModel::Linear);
    vec![
        (shallow.clone(), with(wide), default.clone()),
        (deep.clone(), with(dense.clone()).with_geometry(Geometry::Monostatic), default.clone()),
        (deep, with(line), linear),
        (around, with(cloud), default.clone()),
        (shallow, with(dense).with_detection(Detection::InPhase), default),
    ]
}

#[test]
fn chosen_plans_meet_their_tolerance_against_the_literal_sum() {
    let sweep = Sweep::stepped(10_000.0, 20_000.0, 20.0).expect("ok");
    for (i, (reflectors, instrument, options)) in jobs(&sweep).into_iter().enumerate() {
        let scale: f64 = reflectors.amplitudes().iter().map(|a| f64::from(a.norm())).sum();
        let run = |tolerance| {
            let options = SimulateOptions { tolerance, ..options.clone() };
            assert_eq!(plan(&reflectors, &instrument, &options).is_some(), tolerance > 0.0, "job {i}");
            simulate(&reflectors, &instrument, &options).expect("small").samples
        };
        let exact = run(0.0);
        let peak = exact.iter().map(|m| m.norm()).fold(0.0, f32::max);
        for tolerance in [1e-4, 1e-6] {
            let errors = run(tolerance).into_iter().zip(&exact).map(|(a, b)| (a - b).norm());
            let error = errors.fold(0.0, f32::max);
            assert!(f64::from(error) <= (tolerance + ROUNDING) * scale, "job {i}: {error:e} of {scale:e}");
            assert!(error <= 2e-5 * peak || tolerance > 1e-5, "job {i}: {error:e} of the peak {peak:e}");
        }
    }
}

#[test]
fn the_number_of_threads_does_not_change_virtual_tones() {
    let sweep = Sweep::stepped(10_000.0, 20_000.0, 50.0).expect("ok");
    let (reflectors, instrument, options) = jobs(&sweep).swap_remove(3);
    assert!(plan(&reflectors, &instrument, &options).is_some());
    assert_threads_do_not_matter(&reflectors, &instrument, &options);
}

#[test]
fn small_jobs_and_absurd_ones_are_summed_literally() {
    let array = MicArray::rectangular([4, 4], [0.01; 2], DVec3::ZERO).expect("ok");
    let options = SimulateOptions::default();
    let instrument = Instrument::new(sweep_of(0), array);
    let few = reflectors(10, DVec3::ONE, DVec3::Z);
    let many = reflectors(20_000, DVec3::ONE, DVec3::Z);
    assert!(!candidates(&many, &instrument, &options).is_empty());
    let single = instrument.clone().with_sweep(Sweep::from_frequencies(vec![1000.0]).expect("one"));
    let strict = options.clone().with_tolerance(1e-9);
    let slow = instrument.clone().with_sound_speed(1e-9);
    for (reflectors, instrument, options) in [
        (&few, &instrument, &options),
        (&many, &single, &options),
        (&many, &instrument, &strict),
        (&many, &slow, &options),
        (&Reflectors::default(), &instrument, &options),
    ] {
        assert!(plan(reflectors, instrument, options).is_none());
    }
    let mut positions = many.positions().to_vec();
    positions[7].x = 9e8;
    let lost = Reflectors::new(positions, many.amplitudes().to_vec()).expect("finite");
    assert!(plan(&lost, &instrument, &options).is_none());
    for tolerance in [f64::NAN, -1.0, f64::INFINITY] {
        let options = SimulateOptions { tolerance, ..options.clone() };
        assert!(simulate(&few, &instrument, &options).is_err());
    }
}
