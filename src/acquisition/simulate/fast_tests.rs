//! Virtual tones against Eq. 5 in f64, over random scenes, arrays, sweeps, tiles and durations.

use super::columns::Columns;
use super::cost::choices;
use super::expand::fast;
use super::virtual_tones::{RUNGS, Rung};
use super::*;
use crate::acquisition::{MicArray, Sweep};
use crate::progress::Silent;
use crate::wave::phasor;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::f64::consts::TAU;

/// What f32 adds to the tolerance, relative to `Σ|A|`: rounding of phases and sums, times the size of the weights. A turn
/// that errs by 7·10⁻⁷ is repeated 23 times for 47 tones: a single echo comes to 1.7·10⁻⁵ at worst, many to a fraction of it.
pub(super) const ROUNDING: f64 = 2e-5;

/// A number in ±½ that looks random.
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

/// The greatest error of `samples` against Eq. 5 in f64, relative to `Σ|A|`, over some frequencies and all microphones.
fn greatest_error(
    samples: &[Complex32],
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
) -> f64 {
    let Instrument { sweep, array, geometry, detection, sound_speed } = instrument;
    let scale: f64 = reflectors.amplitudes().iter().map(|a| f64::from(a.norm())).sum();
    let mut worst = 0.0f64;
    for (mic, &r) in array.positions().iter().enumerate() {
        let delay = |&p: &DVec3| options.model.path_length(geometry, p, r) / sound_speed;
        let delays: Vec<f64> = reflectors.positions().iter().map(delay).collect();
        let last = sweep.len() - 1;
        for f in (0..sweep.len()).step_by(sweep.len().div_ceil(9)).chain([last]) {
            let (mut re, mut im) = (0.0, 0.0);
            for (delay, a) in delays.iter().zip(reflectors.amplitudes()) {
                let (sin, cos) = (TAU * (sweep.frequencies()[f] * delay).fract()).sin_cos();
                re += f64::from(a.re) * cos - f64::from(a.im) * sin;
                im += f64::from(a.re) * sin + f64::from(a.im) * cos;
            }
            let m = samples[f * array.len() + mic];
            let im = if *detection == Detection::InPhase { 0.0 } else { im };
            worst = worst.max((f64::from(m.re) - re).hypot(f64::from(m.im) - im));
        }
    }
    worst / scale.max(1e-30)
}

/// The fast way with tiles and tones of our own choice.
pub(super) fn forced(
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
    rung: Rung,
    count: usize,
) -> Vec<Complex32> {
    let radius = cost::widest_tile(rung, instrument);
    let choice = cost::Choice { microphones: count, radius, rung, held: 50 };
    let plan = Plan::of(&choice, reflectors, instrument, options).expect("a standard duration");
    let mut samples = vec![Complex32::ZERO; instrument.sweep.len() * instrument.array.len()];
    let job = Job { reflectors, instrument, options, responses: &[] };
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

proptest! {
    #![proptest_config(ProptestConfig { cases: 160, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

    #[test]
    fn virtual_tones_keep_their_tolerance(
        count in 0usize..300,
        // Scenes from among the microphones to far away, from a point to deep ones.
        size in prop::array::uniform3(0.0f64..3.0),
        distance in prop_oneof![Just(0.0), 0.0f64..4.0, Just(300.0)],
        array_size in prop::array::uniform3(0.0f64..1.0),
        microphones in 1usize..40,
        rung in prop::sample::select(RUNGS.to_vec()),
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
        let mut instrument = Instrument::new(sweep_of(sweep), array);
        instrument.geometry = if monostatic {
            Geometry::Monostatic
        } else {
            Geometry::FixedSource { source: DVec3::from_array(source) }
        };
        instrument.detection = if in_phase { Detection::InPhase } else { Detection::Quadrature };
        let options = SimulateOptions {
            model: if linear { PropagationModel::Linear } else { PropagationModel::Exact },
            tolerance,
            ..SimulateOptions::default()
        };
        let samples = forced(&reflectors, &instrument, &options, rung, tile);
        let error = greatest_error(&samples, &reflectors, &instrument, &options);
        prop_assert!(error <= tolerance + ROUNDING, "{error:e} where {tolerance:e} was asked");
    }
}

#[test]
fn a_single_echo_is_exact_to_f32() {
    // One reflector has nobody to average its error with.
    let reflectors =
        Reflectors::new(vec![DVec3::new(0.2, -0.3, 1.7)], vec![Complex32::new(0.6, -0.8)]).expect("finite");
    let array = MicArray::rectangular([12, 9], [0.008; 2], DVec3::ZERO).expect("ok");
    let instrument = Instrument::new(sweep_of(0), array);
    let options = SimulateOptions::default();
    for rung in RUNGS {
        let samples = forced(&reflectors, &instrument, &options, rung, 64);
        let error = greatest_error(&samples, &reflectors, &instrument, &options);
        assert!(error <= options.tolerance + ROUNDING, "{rung:?}: {error:e}");
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
fn chosen_ways_keep_their_tolerance_against_the_literal_one() {
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
fn threads_do_not_change_the_bytes_of_the_fast_way() {
    let sweep = Sweep::stepped(10_000.0, 20_000.0, 50.0).expect("ok");
    let (reflectors, instrument, options) = jobs(&sweep).swap_remove(3);
    assert!(plan(&reflectors, &instrument, &options).is_some());
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| simulate(&reflectors, &instrument, &options).expect("ok").samples)
    };
    assert_eq!(run(1), run(5));
}

#[test]
fn small_jobs_and_absurd_ones_are_summed_literally() {
    let array = MicArray::rectangular([4, 4], [0.01; 2], DVec3::ZERO).expect("ok");
    let options = SimulateOptions::default();
    let instrument = Instrument::new(sweep_of(0), array);
    let few = reflectors(10, DVec3::ONE, DVec3::Z);
    let many = reflectors(20_000, DVec3::ONE, DVec3::Z);
    assert!(!choices(&many, &instrument, &options).is_empty());
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
    positions[7].x = 1e200;
    let lost = Reflectors::new(positions, many.amplitudes().to_vec()).expect("finite");
    assert!(plan(&lost, &instrument, &options).is_none());
    let lost =
        Reflectors::new(vec![DVec3::splat(1e100); 20_000], many.amplitudes().to_vec()).expect("finite");
    assert!(plan(&lost, &instrument, &options).is_none());
    for tolerance in [f64::NAN, -1.0, f64::INFINITY] {
        let options = SimulateOptions { tolerance, ..options.clone() };
        assert!(simulate(&few, &instrument, &options).is_err());
    }
}
