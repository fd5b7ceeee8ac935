//! Blind self-calibration.

use super::*;
use crate::focus::blind::agreements;
use crate::focus::{ChannelError, SelfCalibration, SelfCalibrationVerdict, self_calibrate};
use crate::named::assert_names;
use crate::progress::Silent;
use std::f64::consts::TAU;

fn calibrate(cube: &DataCube, kind: ChannelError, prior: f64) -> SelfCalibration {
    self_calibrate(cube, &region(), kind, prior, None, &Silent).unwrap()
}

/// What is common to errors of one channel: 1 if what was found is the truth, but for a constant.
fn correlation(found: &SelfCalibration, truth: &[f64], axis: usize) -> f64 {
    let found: Vec<f64> = found.errors().iter().map(|error| error[axis]).collect();
    let centred = |values: &[f64]| {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().map(|value| value - mean).collect::<Vec<_>>()
    };
    let (a, b) = (centred(&found), centred(truth));
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    dot(&a, &b) / (dot(&a, &a) * dot(&b, &b)).sqrt()
}

/// What a failed assertion shows.
fn said(found: &SelfCalibration, correlation: f64) -> String {
    let SelfCalibration { kind, verdict, rms, sharpness_before, sharpness_after, held_out, .. } = found;
    format!(
        "{kind}: {verdict} {rms} {sharpness_before} -> {sharpness_after} {held_out:?}, correlation {correlation}"
    )
}

/// Asserts that errors were found, by what was kept aside and by the truth, from which a shift of the image may differ.
#[track_caller]
fn assert_found(found: &SelfCalibration, truth: &[f64], axis: usize) {
    let correlation = correlation(found, truth, axis);
    let good = found.verdict == SelfCalibrationVerdict::Better && correlation > 0.75;
    assert!(good, "{}", said(found, correlation));
}

#[test]
fn phases_delays_and_places_are_found_from_echoes_alone() {
    let right = instrument(0.6);
    let n_mic = right.array.len();
    let echoes_of = |places: &[DVec3]| echoes_at(&right, places, &points(40));
    for seed in 1..=2 {
        let mut normal = normal(seed);
        let turns: Vec<f64> = (0..n_mic).map(|_| normal() * 50.0_f64.to_radians()).collect();
        let mut cube = echoes_of(right.array.positions());
        cube.samples.iter_mut().enumerate().for_each(|(i, m)| *m *= phasor(turns[i % n_mic] / TAU));
        let found = calibrate(&cube, ChannelError::Phase, 50.0);
        assert_found(&found, &turns, 0);

        let delays: Vec<f64> = (0..n_mic).map(|_| normal() * 0.004).collect();
        let mut cube = echoes_of(right.array.positions());
        let f = right.sweep.frequencies();
        cube.samples
            .iter_mut()
            .enumerate()
            .for_each(|(i, m)| *m *= phasor(f[i / n_mic] * delays[i % n_mic] / 343.0));
        let found = calibrate(&cube, ChannelError::Delay, 0.004);
        assert_found(&found, &delays, 0);
    }
}

/// An instrument of two loudspeakers.
fn two_speakers() -> Instrument {
    instrument(0.6).with_sources(&[DVec3::new(-0.1, 0.0, 0.0), DVec3::new(0.25, 0.2, -0.05)]).unwrap()
}

/// Errors of microphones and of tones are the same for every loudspeaker, which tells the more of them.
#[test]
fn errors_are_found_in_the_echoes_of_several_speakers() {
    let right = two_speakers();
    let [n_f, n_mic] = [right.sweep.len(), right.array.len()];
    let mut normal = normal(4);
    let turns: Vec<f64> = (0..n_mic).map(|_| normal() * 50.0_f64.to_radians()).collect();
    let mut cube = echoes(&right, &points(40));
    cube.samples.iter_mut().enumerate().for_each(|(i, m)| *m *= phasor(turns[i % n_mic] / TAU));
    let found = calibrate(&cube, ChannelError::Phase, 50.0);
    assert_found(&found, &turns, 0);
    let corrected = found.correct(&cube).unwrap();
    let again = calibrate(&corrected, ChannelError::Phase, 50.0);
    assert!(again.rms < 5.0, "there is nothing left: {}", said(&again, 0.0));

    let turns: Vec<f64> = (0..n_f).map(|_| normal() * 50.0_f64.to_radians()).collect();
    let mut cube = echoes(&right, &points(40));
    cube.samples.iter_mut().enumerate().for_each(|(i, m)| *m *= phasor(turns[i / n_mic % n_f] / TAU));
    assert_found(&calibrate(&cube, ChannelError::Frequency, 50.0), &turns, 0);
}

#[test]
fn places_of_microphones_are_found_from_echoes_alone() {
    let array = MicArray::rectangular([13, 13], [0.075; 2], DVec3::ZERO).unwrap();
    let right = Instrument::new(Sweep::stepped(10e3, 20e3, 200.0).unwrap(), array);
    let mut normal = normal(1);
    let mut shift = || 0.005 * normal();
    let places: Vec<DVec3> =
        right.array.positions().iter().map(|r| *r + DVec3::new(shift(), shift(), shift())).collect();
    let heights: Vec<f64> = places.iter().map(|r| r.z).collect();
    let cube = echoes_at(&right, &places, &points(60));
    let found = calibrate(&cube, ChannelError::Position, 0.005);
    assert_found(&found, &heights, 2);
    let corrected = found.correct(&cube).unwrap();
    assert!(corrected.provenance["calibration"][0].as_str().unwrap().contains("position errors"));
    let off = |array: &MicArray| {
        array.positions().iter().zip(&places).map(|(a, b)| a.distance_squared(*b)).sum::<f64>()
    };
    let share = off(&corrected.instrument.array) / off(&right.array);
    assert!(share < 0.7, "{share}: {}", said(&found, 0.0));
}

#[test]
fn phases_of_tones_are_found() {
    let right = instrument(0.6);
    let n_mic = right.array.len();
    let mut normal = normal(3);
    let turns: Vec<f64> = (0..right.sweep.len()).map(|_| normal() * 50.0_f64.to_radians()).collect();
    let mut cube = echoes(&right, &points(40));
    cube.samples.iter_mut().enumerate().for_each(|(i, m)| *m *= phasor(turns[i / n_mic] / TAU));
    let found = calibrate(&cube, ChannelError::Frequency, 50.0);
    assert_found(&found, &turns, 0);
    assert!(found.sharpness_after > found.sharpness_before);
    let corrected = found.correct(&cube).unwrap();
    let again = calibrate(&corrected, ChannelError::Frequency, 50.0);
    assert_eq!(again.verdict, SelfCalibrationVerdict::NotBetter, "there is nothing left: {again:?}");
}

/// Places all over the region.
fn everywhere(count: usize, seed: u64) -> Vec<DVec3> {
    let mut normal = normal(seed);
    let mut even = || {
        let x = 12_345.678 * normal();
        x - x.floor() - 0.5
    };
    (0..count).map(|_| DVec3::new(0.44 * even(), 0.44 * even(), 1.1 + 0.36 * even())).collect()
}

#[test]
fn sharpness_that_is_not_in_the_echoes_is_declined() {
    // Of 800 echoes more overlap than 121 microphones tell apart. There are no errors, but errors make the image sharper.
    let right = instrument(0.6);
    let many = echoes(&right, &everywhere(800, 8));
    for (kind, prior) in
        [(ChannelError::Phase, 100.0), (ChannelError::Position, 0.01), (ChannelError::Delay, 0.01)]
    {
        let found = calibrate(&many, kind, prior);
        let tempting = found.sharpness_after > 1.15 * found.sharpness_before && found.rms > 0.2 * prior;
        let declined = found.verdict == SelfCalibrationVerdict::NotBetter;
        assert!(tempting && declined, "{}", said(&found, 0.0));
    }
    // Neither of noise, nor where there is nothing to gain.
    for kind in [ChannelError::Phase, ChannelError::Position, ChannelError::Frequency] {
        let prior = if kind == ChannelError::Position { 0.003 } else { 40.0 };
        for cube in
            [DataCube::new(right.clone(), noise(&right, 1.0, 5)).unwrap(), echoes(&right, &points(40))]
        {
            let found = calibrate(&cube, kind, prior);
            assert_eq!(found.verdict, SelfCalibrationVerdict::NotBetter, "{}", said(&found, 0.0));
        }
    }
}

#[test]
fn what_cannot_be_calibrated_blindly_is_refused() {
    let cube = echoes(&instrument(0.6), &points(1));
    let refused = |cube: &DataCube, kind, prior: f64| {
        self_calibrate(cube, &region(), kind, prior, None, &Silent).unwrap_err().to_string()
    };
    assert_names(refused(&cube, ChannelError::Phase, 30.0), &["--blind", "many echoes", "--reference"]);
    for prior in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert_names(refused(&cube, ChannelError::Phase, prior), &["--prior", "degrees"]);
    }
    let few = MicArray::rectangular([4, 4], [0.1; 2], DVec3::ZERO).unwrap();
    let few = echoes(&instrument(0.6).with_array(few), &points(40));
    assert_names(refused(&few, ChannelError::Position, 0.01), &["20", "16"]);
    let silent = DataCube::new(cube.instrument.clone(), vec![Complex32::ZERO; cube.samples.len()]).unwrap();
    assert_names(refused(&silent, ChannelError::Phase, 30.0), &["--blind", "silent"]);
    let mut real = cube;
    real.instrument.detection = crate::acquisition::Detection::InPhase;
    real.samples.iter_mut().for_each(|m| m.im = 0.0);
    assert_names(refused(&real, ChannelError::Phase, 30.0), &["--blind", "I and Q"]);
}

#[test]
fn profiles_and_predictions_agree_with_the_literal_sums() {
    for right in [instrument(0.6), two_speakers()] {
        profiles_and_predictions_agree(&right);
    }
}

fn profiles_and_predictions_agree(right: &Instrument) {
    let mut normal = normal(9);
    let cube = DataCube::new(right.clone(), noise(right, 1.0, 4)).unwrap();
    let image: Vec<Complex32> =
        (0..points(30).len()).map(|_| Complex32::new(normal() as f32, normal() as f32)).collect();
    for kind in ChannelError::ALL {
        for channel in [0, 7, 40] {
            let error = match kind {
                ChannelError::Position => DVec3::new(0.004, -0.01, 0.006),
                ChannelError::Delay => DVec3::X * 0.013,
                _ => DVec3::X * 0.8,
            };
            let [fast, predicted] = agreements(&cube, *kind, points(30), (channel, error), &image);
            let [literal, scale] = literal(&cube, *kind, (channel, error), &image);
            assert!((fast - literal).abs() < 0.01 * scale, "{kind}: {fast} {literal}, of {scale}");
            assert!((predicted - literal).abs() < 1e-4 * scale, "{kind}: {predicted} {literal}, of {scale}");
        }
    }
}

/// `Re Σ conj(a) m e^{−i2πf·path/c}` over the samples of a channel, whose error is taken out, and the 30 points; and the sum of
/// its terms' moduli were they in random phase.
fn literal(
    cube: &DataCube,
    kind: ChannelError,
    (channel, error): (usize, DVec3),
    image: &[Complex32],
) -> [f64; 2] {
    let (right, n_mic) = (&cube.instrument, cube.instrument.array.len());
    let [mut sum, mut scale] = [0.0; 2];
    for (i, m) in cube.samples.iter().enumerate() {
        let (tone, r) = (i / n_mic % right.sweep.len(), i % n_mic);
        let one = right.transmission(i / n_mic / right.sweep.len());
        if channel != if kind == ChannelError::Frequency { tone } else { r } {
            continue;
        }
        for (a, p) in image.iter().zip(points(30)) {
            let f = right.sweep.frequencies()[tone];
            let moved = if kind == ChannelError::Position { error } else { DVec3::ZERO };
            let path = one.geometry.path_length(p, right.array.positions()[r] + moved);
            let turns = match kind {
                ChannelError::Frequency | ChannelError::Phase => f * path / 343.0 + error.x / TAU,
                ChannelError::Delay => f * (path + error.x) / 343.0,
                ChannelError::Position => f * path / 343.0,
            };
            let term = a.conj() * m * phasor(-turns);
            sum += f64::from(term.re);
            scale += f64::from(term.norm_sqr());
        }
    }
    [sum, scale.sqrt()]
}
