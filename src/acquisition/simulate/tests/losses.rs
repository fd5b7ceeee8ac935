//! Losses against their formulas, virtual tones against the literal sum, and imperfect microphones against their
//! statistics.

use super::super::virtual_tones::TONE_DESIGNS;
use super::super::*;
use super::assert_threads_do_not_matter;
use super::virtual_tones::{self, ROUNDING, forced, plan, reflectors, scattered, sweep_of};
use crate::acquisition::{MicArray, Sweep};
use crate::wave::Geometry;
use crate::wave::air::{Air, DB_PER_NEPER, REFERENCE_PRESSURE};
use crate::wave::piston::piston;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::f64::consts::{PI, TAU};

pub(super) const AIR: Air = Air { temperature: 20.0, humidity: 50.0, pressure: REFERENCE_PRESSURE };

/// `2J₁(x)/x` by its integral, independently of the library.
fn piston_by_integral(x: f64) -> f64 {
    let n = 4000;
    let step = PI / f64::from(n);
    let sum = (0..n).map(|i| {
        let t = (f64::from(i) + 0.5) * step;
        (x * t.cos()).cos() * t.sin() * t.sin()
    });
    2.0 / PI * step * sum.sum::<f64>()
}

/// A sample, and the part of `Σ|A|` that reaches the microphone, in f64 from the formulas alone.
fn expected(
    reflectors: &Reflectors,
    f: f64,
    r: DVec3,
    instrument: &Instrument,
    options: &SimulateOptions,
) -> ([f64; 2], f64) {
    let (mut sum, mut arriving) = ([0.0; 2], 0.0);
    let losses = options.losses;
    for (&p, a) in reflectors.positions().iter().zip(reflectors.amplitudes()) {
        let s = match instrument.geometry {
            Geometry::FixedSource { source } => source,
            Geometry::Monostatic => r,
            Geometry::Pair { offset } => r + offset,
        };
        let (d1, d2) = (p.distance(s), p.distance(r));
        let path = options.model.path_length(instrument, p, r);
        let spreading = if losses.spreading { 1.0 / (d1.max(0.01) * d2.max(0.01)) } else { 1.0 };
        let mut factor = spreading;
        if let Some(air) = losses.air {
            factor *= 10f64.powf(-air.absorption(f) * DB_PER_NEPER * path / 20.0);
        }
        for (radius, leg) in [(losses.speaker_radius, p - s), (losses.microphone_radius, p - r)] {
            if radius > 0.0 && leg.length() > 0.0 {
                let sine = leg.truncate().length() / leg.length();
                factor *= piston(TAU * f / instrument.sound_speed * radius * sine);
            }
        }
        let (sin, cos) = (TAU * (f * path / instrument.sound_speed).fract()).sin_cos();
        let (re, im) = (f64::from(a.re) * factor, f64::from(a.im) * factor);
        sum[0] += re * cos - im * sin;
        sum[1] += re * sin + im * cos;
        arriving += f64::from(a.norm()) * spreading;
    }
    (sum, arriving)
}

/// The maximum error of samples relative to what reaches their microphone, over some frequencies and all microphones.
pub(super) fn greatest_error(
    samples: &[Complex32],
    reflectors: &Reflectors,
    instrument: &Instrument,
    options: &SimulateOptions,
) -> f64 {
    let Instrument { sweep, array, .. } = instrument;
    let mut worst = 0.0f64;
    for (mic, &r) in array.positions().iter().enumerate() {
        for f in (0..sweep.len()).step_by(sweep.len().div_ceil(9)).chain([sweep.len() - 1]) {
            let ([re, im], arriving) = expected(reflectors, sweep.frequencies()[f], r, instrument, options);
            let im = if instrument.detection == Detection::InPhase { 0.0 } else { im };
            let m = samples[f * array.len() + mic];
            worst = worst.max((f64::from(m.re) - re).hypot(f64::from(m.im) - im) / arriving.max(1e-30));
        }
    }
    worst
}

#[test]
fn one_echo_follows_the_formulas() {
    // Both legs are 2 m long and 30 degrees off the axis.
    let p = DVec3::new(1.0, 0.0, 3.0f64.sqrt());
    let one = Reflectors::new(vec![p], vec![Complex32::new(0.0, 2.0)]).expect("finite");
    let array = MicArray::from_positions(vec![DVec3::ZERO]).expect("one");
    let sweep = Sweep::from_frequencies(vec![10_000.0, 15_000.0, 20_000.0]).expect("ok");
    let instrument = Instrument::new(sweep, array);
    let level = |losses: Losses, f: usize| {
        let options = SimulateOptions::default().with_losses(losses).with_tolerance(0.0);
        let cube = simulate(&one, &instrument, &options).expect("small");
        f64::from(cube.samples[f].norm()) / 2.0
    };
    let near = |a: f64, b: f64| assert!((a - b).abs() < 2e-6, "{a} {b}");
    near(level(Losses::NONE, 0), 1.0);
    near(level(Losses { spreading: true, ..Losses::NONE }, 1), 1.0 / 4.0);
    // 0.159 dB/m over 4 m, ISO 9613-1.
    let decibels = -20.0 * level(Losses { air: Some(AIR), ..Losses::NONE }, 0).log10();
    assert!((decibels - 0.159 * 4.0).abs() < 0.005, "{decibels}");
    // ka sin θ of a piston of 12 mm at 20 kHz and 30 degrees.
    let x = TAU * 20_000.0 / 343.0 * 0.012 * 0.5;
    let (speaker_radius, microphone_radius) = (0.012, 0.012);
    near(level(Losses { speaker_radius, ..Losses::NONE }, 2), piston_by_integral(x));
    near(level(Losses { microphone_radius, ..Losses::NONE }, 2), piston_by_integral(x));
    let both = Losses { speaker_radius, microphone_radius, ..Losses::NONE };
    near(level(both, 2), piston_by_integral(x).powi(2));
    let all = Losses { spreading: true, air: Some(AIR), ..both };
    let one_by_one =
        0.25 * level(Losses { air: Some(AIR), ..Losses::NONE }, 2) * piston_by_integral(x).powi(2);
    near(level(all, 2), one_by_one);
}

pub(super) fn all_losses() -> impl Strategy<Value = Losses> {
    let radius = prop_oneof![Just(0.0), 0.001f64..0.03];
    let air = prop::option::of((-10.0f64..40.0, 5.0f64..100.0));
    (any::<bool>(), air, radius.clone(), radius).prop_map(
        |(spreading, air, speaker_radius, microphone_radius)| {
            let pressure = REFERENCE_PRESSURE;
            let air = air.map(|(temperature, humidity)| Air { temperature, humidity, pressure });
            Losses { spreading, air, speaker_radius, microphone_radius }
        },
    )
}

/// The f32 error of the literal sum, relative to `Σ|A|`: 4·10⁻⁶ for a phasor after 64 steps, and 10⁻⁶ for its start.
const LITERAL_ROUNDING: f64 = 6e-6;

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

    #[test]
    fn losses_by_virtual_tones_and_in_the_literal_sum_meet_the_tolerance(
        losses in all_losses(),
        count in 1usize..120,
        size in prop::array::uniform3(0.0f64..3.0),
        distance in prop_oneof![Just(0.3), 0.5f64..4.0, Just(60.0)],
        array_size in prop::array::uniform3(0.0f64..1.0),
        microphones in 1usize..20,
        design in prop::sample::select(TONE_DESIGNS.to_vec()),
        tile in prop::sample::select(vec![1usize, 4, 16]),
        sweep in 0u8..4,
        tolerance in prop::sample::select(vec![1e-3, 1e-5, 1e-6]),
        monostatic: bool,
        linear: bool,
        in_phase: bool,
    ) {
        let reflectors = reflectors(count, DVec3::from_array(size), DVec3::new(0.1, 0.0, distance));
        let array = scattered(microphones, DVec3::from_array(array_size));
        let source = (!monostatic).then_some(DVec3::new(0.1, -0.1, 0.02));
        let instrument = virtual_tones::instrument(sweep_of(sweep), array, source, in_phase);
        let options = SimulateOptions {
            model: if linear { PropagationModel::Linear } else { PropagationModel::Exact },
            losses,
            tolerance,
            ..SimulateOptions::default()
        };
        let samples = forced(&reflectors, &instrument, &options, design, tile);
        let error = greatest_error(&samples, &reflectors, &instrument, &options);
        prop_assert!(error <= tolerance + ROUNDING, "{error:e}, but the tolerance is {tolerance:e}");
        let exact = SimulateOptions { tolerance: 0.0, ..options };
        let samples = simulate(&reflectors, &instrument, &exact).expect("small").samples;
        let error = greatest_error(&samples, &reflectors, &instrument, &exact);
        prop_assert!(error <= LITERAL_ROUNDING, "literally {error:e}");
    }
}

#[test]
fn losses_are_simulated_by_few_terms_with_any_number_of_threads() {
    let reflectors = reflectors(3000, DVec3::new(1.0, 1.0, 0.5), DVec3::new(0.0, 0.0, 1.5));
    let array = MicArray::rectangular([16, 16], [0.02; 2], DVec3::ZERO).expect("ok");
    let instrument = Instrument::new(Sweep::stepped(10_000.0, 20_000.0, 20.0).expect("ok"), array);
    let losses = Losses { spreading: true, air: Some(AIR), speaker_radius: 0.012, microphone_radius: 0.003 };
    let options = SimulateOptions {
        losses,
        errors: Some(ArrayErrors { gain_db: 0.5, phase: 5.0, position: 1e-3, seed: 7 }),
        ..SimulateOptions::default()
    };
    let found = plan(&reflectors, &instrument, &options).expect("far cheaper than term by term");
    let terms = found.terms.as_ref().expect("losses").count();
    assert!((3..=9).contains(&terms), "{terms} terms");
    assert_threads_do_not_matter(&reflectors, &instrument, &options);
}

#[test]
fn the_cube_has_nominal_positions_and_samples_at_the_actual_ones() {
    let reflectors = reflectors(40, DVec3::ONE, DVec3::new(0.0, 0.0, 1.5));
    let array = MicArray::rectangular([20, 15], [0.02; 2], DVec3::ZERO).expect("ok");
    let instrument = Instrument::new(Sweep::stepped(10_000.0, 10_500.0, 100.0).expect("ok"), array.clone());
    let errors = ArrayErrors { gain_db: 0.0, phase: 0.0, position: 2e-3, seed: 3 };
    let options = SimulateOptions::default().with_errors(errors);
    let cube = simulate(&reflectors, &instrument, &options).expect("ok");
    assert_eq!(cube.instrument, instrument);
    let real = errors.displaced(&array).expect("small");
    assert!(real.lattice().is_none());
    let moved: f64 =
        real.positions().iter().zip(array.positions()).map(|(a, b)| a.distance_squared(*b)).sum();
    let rms = (moved / (3 * array.len()) as f64).sqrt();
    assert!((rms / 2e-3 - 1.0).abs() < 0.1, "{rms}");
    let perfect = SimulateOptions { errors: None, ..options.clone() };
    let there = simulate(&reflectors, &instrument.with_array(real), &perfect).expect("ok");
    assert_eq!(cube.samples, there.samples);
}

#[test]
fn gains_and_phases_have_the_requested_rms_and_separate_streams() {
    let reflectors = reflectors(20, DVec3::ONE, DVec3::new(0.0, 0.0, 1.5));
    let array = MicArray::rectangular([40, 40], [0.02; 2], DVec3::ZERO).expect("ok");
    let instrument = Instrument::new(Sweep::stepped(10_000.0, 10_100.0, 100.0).expect("ok"), array);
    let run = |errors: Option<ArrayErrors>, detection| {
        let instrument = instrument.clone().with_detection(detection);
        let options = SimulateOptions { errors, ..SimulateOptions::default() };
        simulate(&reflectors, &instrument, &options).expect("ok").samples
    };
    let clean = run(None, Detection::Quadrature);
    let errors = ArrayErrors { gain_db: 0.8, phase: 6.0, position: 0.0, seed: 3 };
    let both = run(Some(errors), Detection::Quadrature);
    let rms = |value: &dyn Fn(Complex32) -> f32| {
        let squares = both.iter().zip(&clean).map(|(b, c)| f64::from(value(b / c)).powi(2));
        (squares.sum::<f64>() / clean.len() as f64).sqrt()
    };
    let (gain, phase) = (rms(&|q| 20.0 * q.norm().log10()), rms(&|q| q.arg().to_degrees()));
    assert!((gain / 0.8 - 1.0).abs() < 0.06 && (phase / 6.0 - 1.0).abs() < 0.06, "{gain} {phase}");
    // A microphone's error is the same at every frequency.
    for (a, b) in both[..1600].iter().zip(&clean).zip(both[1600..].iter().zip(&clean[1600..])) {
        assert!((a.0 / a.1 - b.0 / b.1).norm() < 1e-4);
    }
    // The errors apply before in-phase detection.
    for (i, q) in run(Some(errors), Detection::InPhase).iter().zip(&both) {
        assert_eq!((i.re, i.im), (q.re, 0.0));
    }
    assert_eq!(both, run(Some(errors), Detection::Quadrature));
    assert_ne!(both, run(Some(ArrayErrors { seed: 4, ..errors }), Detection::Quadrature));
    // Another kind of error does not change the gains.
    let alone = run(Some(ArrayErrors { phase: 0.0, ..errors }), Detection::Quadrature);
    for (a, b) in alone.iter().zip(&both) {
        assert!((a.norm() / b.norm() - 1.0).abs() < 1e-5);
    }
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        let options = SimulateOptions::default().with_errors(ArrayErrors { phase: bad, ..errors });
        assert!(simulate(&reflectors, &instrument, &options).is_err());
    }
}
