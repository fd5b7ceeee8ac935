//! Closed forms against waveforms, and each element against what is known of it.

use super::literal::Waveforms;
use super::*;
use crate::acquisition::{DataCube, Detection, MicArray, SimulateOptions, simulate};
use crate::reflectors::Reflectors;
use glam::DVec3;
use num_complex::{Complex32, Complex64};
use std::f64::consts::TAU;

const SPEED: f64 = 343.0;

/// One microphone at the speaker.
fn instrument(sweep: Sweep) -> Instrument {
    Instrument::new(sweep, MicArray::from_positions(vec![DVec3::ZERO]).expect("one"))
}

/// The cube of echoes with these paths and amplitudes.
fn cube(instrument: &Instrument, echoes: &[(f64, f64)], electronics: Option<Electronics>) -> DataCube {
    let (at, loud): (Vec<_>, Vec<_>) = echoes
        .iter()
        .map(|(path, a)| (DVec3::new(0.0, 0.0, path / 2.0), Complex32::new(*a as f32, 0.0)))
        .unzip();
    let echoes = Reflectors::new(at, loud).expect("valid");
    let options = SimulateOptions::default().with_tolerance(0.0).with_electronics(electronics);
    simulate(&echoes, instrument, &options).expect("simulated")
}

fn wide(m: Complex32) -> Complex64 {
    Complex64::new(m.re.into(), m.im.into())
}

/// Σ A e^{i2πfd/c}.
fn response(f: f64, echoes: &[(f64, f64)]) -> Complex64 {
    echoes.iter().map(|(path, a)| a * Complex64::cis(TAU * f * path / SPEED)).sum()
}

#[test]
fn closed_forms_are_the_waveforms() {
    let rate = 5e6;
    let mut state = 3_u32;
    let mut random = |low: f64, high: f64| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        low + (high - low) * f64::from(state >> 8) / f64::from(1 << 24)
    };
    for case in 0..24 {
        let filter = if case % 2 == 0 { OutputFilter::Integration } else { OutputFilter::LowPass };
        let mixer = if case % 4 < 2 { Mixer::Switch } else { Mixer::Sine };
        let mut electronics = Electronics::default()
            .with_filter(filter)
            .with_mixer(mixer)
            .with_low_pass(random(40.0, 200.0))
            .with_dwell((random(4e-3, 6e-3) * rate).round() / rate)
            .with_settling((random(5e-4, 2e-3) * rate).round() / rate);
        if case % 3 == 1 {
            electronics = electronics.with_decay(random(2e-4, 2e-3));
        }
        if case % 3 != 0 {
            electronics = electronics.with_harmonics_db(vec![random(-30.0, -10.0), -12.0, -20.0, -15.0]);
        }
        if case % 5 > 2 {
            electronics = electronics.with_amplifier_band([random(300.0, 800.0), random(3e3, 8e3)]);
        }
        if case % 5 > 3 {
            electronics = electronics.with_microphone_band([random(300.0, 800.0), random(3e3, 8e3)]);
        }
        if case % 7 > 3 {
            electronics = electronics.with_quadrature_error(random(-20.0, 20.0)).with_clock_error(3e4);
        }
        let late = [(random(10.0, 9000.0) as usize, 0.7), (random(10.0, 9000.0) as usize, -0.3)];
        let paths = late.map(|(samples, a)| (samples as f64 / rate * SPEED, a));
        let start = random(1.1e3, 1.6e3);
        let tones = vec![start, start + random(90.0, 300.0), 2e3];
        let instrument = instrument(Sweep::from_frequencies(tones.clone()).expect("ascending"));
        let actual: Vec<f64> = tones.iter().map(|f| f * (1.0 + 1e-6 * electronics.clock_error)).collect();
        let waves = Waveforms { electronics: &electronics, rate, echoes: &late };
        let expected = waves.readings([&actual, &actual]);
        let found = cube(&instrument, &paths, Some(electronics.clone()));
        for (m, expected) in found.samples.iter().zip(&expected) {
            let error = (wide(*m) - expected).norm();
            assert!(error < 4e-3, "case {case}: {m} {expected}: {error:.1e}\n{electronics:?}");
        }
        // In phase the first mixer alone is read.
        let real = cube(&instrument.with_detection(Detection::InPhase), &paths, Some(electronics));
        for (m, expected) in real.samples.iter().zip(&expected) {
            assert!((f64::from(m.re) - expected.re).abs() < 4e-3 && m.im == 0.0, "case {case}: {m}");
        }
    }
}

#[test]
fn ideal_electronics_change_nothing_and_integrals_err_as_equation_3_says() {
    let echoes = [(1.3, 1.0), (2.9, -0.4)];
    let instrument = instrument(Sweep::stepped(10e3, 12e3, 125.0).expect("even"));
    let plain = cube(&instrument, &echoes, None);
    let ideal = cube(&instrument, &echoes, Some(Electronics::default().with_mixer(Mixer::Switch)));
    for (a, b) in plain.samples.iter().zip(&ideal.samples) {
        assert!((a - b).norm() < 1e-6, "{a} {b}");
    }
    // 8 ms are whole periods of all of them; of 8.03 ms the mixer's second product is left, 1/(2πfT) of the amplitudes.
    for (dwell, whole) in [(0.008, true), (0.00803, false)] {
        let summed = Electronics::default()
            .with_filter(OutputFilter::Integration)
            .with_dwell(dwell)
            .with_settling(0.0);
        let read = cube(&instrument, &echoes, Some(summed));
        let mut worst = 0_f64;
        for ((a, b), f) in plain.samples.iter().zip(&read.samples).zip(instrument.sweep.frequencies()) {
            worst = worst.max(f64::from((a - b).norm()) * TAU * f * dwell);
        }
        // Both phases err by α/(2πfT) at the most, and α is 1.4 at the most.
        assert!(if whole { worst < 1e-3 } else { (0.1..2.0).contains(&worst) }, "{dwell}: {worst}");
    }
}

#[test]
fn a_switch_receives_the_third_harmonic_from_three_times_the_path() {
    let echoes = [(0.7, 1.0), (1.1, 0.5)];
    let instrument = instrument(Sweep::stepped(10e3, 14e3, 50.0).expect("even"));
    let switch = Electronics::default().with_mixer(Mixer::Switch).with_harmonics_db(vec![-20.0, -26.0]);
    let read = cube(&instrument, &echoes, Some(switch.clone()));
    let third = 10_f64.powf(-1.3) / 3.0;
    for (m, f) in read.samples.iter().zip(instrument.sweep.frequencies()) {
        let expected = response(*f, &echoes) - third * response(3.0 * f, &echoes).conj();
        assert!((wide(*m) - expected).norm() < 1e-5, "{m} {expected}");
    }
    // A sine receives nothing but its own frequency.
    let sine = cube(&instrument, &echoes, Some(switch.with_mixer(Mixer::Sine)));
    for (m, f) in sine.samples.iter().zip(instrument.sweep.frequencies()) {
        assert!((wide(*m) - response(*f, &echoes)).norm() < 1e-5);
    }
}

#[test]
fn corners_take_three_decibels_and_an_eighth_of_a_turn() {
    let instrument = instrument(Sweep::from_frequencies(vec![1e3, 1e4]).expect("two"));
    for (low, high, at, turn) in [(1e3, 1e12, 0, 0.125), (0.0, 1e4, 1, -0.125)] {
        let amplifier = Electronics::default().with_amplifier_band([low, high]);
        let microphone = Electronics::default().with_microphone_band([low, high]);
        for electronics in [amplifier, microphone] {
            let read = wide(cube(&instrument, &[(1e-6, 1.0)], Some(electronics)).samples[at]);
            // A cube's phase grows with the delay: that of a signal, which a low-pass filter turns back, has the other sign.
            let expected = 0.5_f64.sqrt() * Complex64::cis(-TAU * turn);
            assert!((read - expected).norm() < 1e-3, "{read} {expected}");
        }
    }
}

#[test]
fn phases_that_are_no_quarter_apart_leave_a_mirror_image() {
    let echoes = [(0.7, 1.0)];
    let instrument = instrument(Sweep::stepped(10e3, 14e3, 50.0).expect("even"));
    let angle = 5.0_f64;
    let read = cube(&instrument, &echoes, Some(Electronics::default().with_quadrature_error(angle)));
    let turn = Complex64::cis(angle.to_radians());
    for (m, f) in read.samples.iter().zip(instrument.sweep.frequencies()) {
        let m0 = response(*f, &echoes);
        let expected = 0.5 * (1.0 + turn) * m0 + 0.5 * (1.0 - turn.conj()) * m0.conj();
        assert!((wide(*m) - expected).norm() < 1e-5, "{m} {expected}");
    }
}

#[test]
fn what_has_not_settled_is_missing() {
    let (dwell, settling, decay) = (0.02, 0.004, 0.003);
    let instrument = instrument(Sweep::from_frequencies(vec![12e3]).expect("one"));
    let electronics = Electronics::default()
        .with_filter(OutputFilter::Integration)
        .with_dwell(dwell)
        .with_settling(settling)
        .with_decay(decay);
    let read = wide(cube(&instrument, &[(0.7, 1.0)], Some(electronics)).samples[0]);
    let missing = decay / (dwell - settling) * ((-settling / decay).exp() - (-dwell / decay).exp());
    let expected = response(12e3, &[(0.7, 1.0)]) * (1.0 - missing);
    assert!((read - expected).norm() < 1e-3 && missing > 0.04, "{read} {expected}");
}

#[test]
fn jitter_weakens_and_scatters_by_the_characteristic_function() {
    let (f, jitter, n) = (20e3, 6e-6, 4000);
    let mics = MicArray::rectangular([n, 1], [1e-9, 1e-9], DVec3::ZERO).expect("valid");
    let instrument = Instrument::new(Sweep::from_frequencies(vec![f]).expect("one"), mics);
    for quadrature in [QuadratureBy::Mixers, QuadratureBy::Passes] {
        let electronics = Electronics::default().with_jitter(jitter).with_quadrature(quadrature);
        let read = cube(&instrument, &[(1.0, 1.0)], Some(electronics));
        let mean = read.samples.iter().map(|m| wide(*m)).sum::<Complex64>() / n as f64;
        let kept = (-0.5 * (TAU * f * jitter).powi(2)).exp();
        let expected = kept * response(f, &[(1.0, 1.0)]);
        assert!((mean - expected).norm() < 0.03, "{mean} {expected}");
        let spread = read.samples.iter().map(|m| (wide(*m) - mean).norm_sqr()).sum::<f64>() / n as f64;
        assert!((spread / (1.0 - kept * kept) - 1.0).abs() < 0.1, "{spread}");
        // At once, all readings have the modulus 1.
        let whole = read.samples.iter().all(|m| (m.norm() - 1.0).abs() < 1e-5);
        assert_eq!(whole, quadrature == QuadratureBy::Mixers);
    }
}

#[test]
fn a_clock_that_is_wrong_scales_paths_and_one_that_drifts_bends_them() {
    let echoes = [(1.7, 1.0)];
    let instrument = instrument(Sweep::stepped(10e3, 14e3, 100.0).expect("even"));
    let clock = Electronics::default().with_clock_error(500.0).with_clock_drift(100.0).with_dwell(0.05);
    let twice = clock.clone().with_quadrature(QuadratureBy::Passes);
    let (once, twice) = (cube(&instrument, &echoes, Some(clock)), cube(&instrument, &echoes, Some(twice)));
    let n_f = instrument.sweep.len();
    for (n, f) in instrument.sweep.frequencies().iter().enumerate() {
        let at = |n: usize| response(f * (1.0 + 500e-6 + 100e-6 * 0.05 * n as f64), &echoes);
        assert!((wide(once.samples[n]) - at(n)).norm() < 1e-5);
        let expected = Complex64::new(at(n).re, at(n + n_f).im);
        assert!((wide(twice.samples[n]) - expected).norm() < 1e-5);
    }
}

#[test]
fn a_converter_errs_by_a_twelfth_of_its_step_and_cuts_off() {
    let instrument = instrument(Sweep::stepped(10e3, 14e3, 2.0).expect("even"));
    let echoes = [(1.7, 1.0), (2.2, 0.3)];
    let plain = cube(&instrument, &echoes, None);
    for (bits, full) in [(8, Some(2.0)), (10, None)] {
        let electronics = Electronics::default().with_adc_bits(bits).with_adc_full_scale(full);
        let read = cube(&instrument, &echoes, Some(electronics));
        let largest = plain.samples.iter().map(|m| m.re.abs().max(m.im.abs())).fold(0.0, f32::max);
        let step = 2.0 * full.unwrap_or(f64::from(largest)) / f64::from(1 << bits);
        let errors: Vec<f64> =
            plain.samples.iter().zip(&read.samples).map(|(a, b)| f64::from(a.re - b.re)).collect();
        let power = errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64;
        assert!((power / (step * step / 12.0) - 1.0).abs() < 0.1, "{bits}: {power}");
        // The largest positive code is one step below full scale.
        assert!(errors.iter().all(|e| e.abs() <= 1.001 * step));
        assert!(read.samples.iter().all(|m| (f64::from(m.re) / step).fract().abs() < 1e-3 || bits > 8));
    }
    let cut = cube(&instrument, &echoes, Some(Electronics::default().with_adc_full_scale(0.5)));
    let most = cut.samples.iter().map(|m| m.re.abs().max(m.im.abs())).fold(0.0, f32::max);
    assert!((most - 0.5).abs() < 1e-6);
}

#[test]
fn the_number_of_threads_changes_no_byte_and_speakers_have_jitter_of_their_own() {
    let mics = MicArray::rectangular([4, 3], [0.05, 0.05], DVec3::ZERO).expect("valid");
    let instrument = Instrument::new(Sweep::stepped(10e3, 12e3, 50.0).expect("even"), mics)
        .with_sources(&[DVec3::ZERO, DVec3::ZERO])
        .expect("two");
    let electronics = Electronics::default()
        .with_mixer(Mixer::Switch)
        .with_harmonics_db(vec![-30.0, -30.0])
        .with_filter(OutputFilter::LowPass)
        .with_dwell(0.02)
        .with_decay(0.004)
        .with_jitter(1e-6)
        .with_adc_bits(12);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| cube(&instrument, &[(1.0, 1.0), (2.0, 0.5)], Some(electronics.clone())).samples)
    };
    let (one, three) = (on(1), on(3));
    assert_eq!(bytemuck::cast_slice::<_, u8>(&one), bytemuck::cast_slice::<_, u8>(&three));
    let half = one.len() / 2;
    assert_ne!(one[..half], one[half..]);
}

#[test]
fn what_means_nothing_is_refused() {
    let ideal = Electronics::default();
    for (electronics, named) in [
        (ideal.clone().with_amplifier_band([2e3, 1e3]), "amplifier_band"),
        (ideal.clone().with_harmonics_db(vec![f64::NAN]), "harmonics_db"),
        (ideal.clone().with_decay(0.01), "decay"),
        (ideal.clone().with_jitter(-1.0), "jitter"),
        (ideal.clone().with_filter(OutputFilter::Integration), "dwell"),
        (ideal.clone().with_clock_drift(1.0), "dwell"),
        (ideal.clone().with_filter(OutputFilter::Integration).with_dwell(0.1).with_settling(0.1), "dwell"),
        (ideal.clone().with_low_pass(0.0), "low_pass"),
        (ideal.clone().with_adc_bits(25), "adc_bits"),
    ] {
        let error = electronics.check().expect_err("refused").to_string();
        assert!(error.contains("[instrument]") && error.contains(named), "{error}");
    }
    assert!(ideal.check().is_ok() && ideal.elements().is_empty());
    // A clock that runs away backwards has no ascending frequencies.
    let away = ideal.with_clock_drift(-9e4).with_dwell(1.0);
    let instrument = instrument(Sweep::stepped(10e3, 10.1e3, 10.0).expect("even"));
    let options = SimulateOptions::default().with_electronics(away);
    let echo = Reflectors::new(vec![DVec3::Z], vec![Complex32::ONE]).expect("one");
    let error = simulate(&echo, &instrument, &options).expect_err("refused").to_string();
    assert!(error.contains("clock_drift") && error.contains("ascend"), "{error}");
}
