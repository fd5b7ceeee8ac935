#![allow(clippy::unwrap_used)]

use super::*;
use crate::acquisition::{DataCube, MicArray, Noise, SimulateOptions, Sweep, simulate};
use crate::progress::Silent;
use crate::reflectors::Reflectors;
use crate::wave::Geometry;
use glam::DVec3;

const F32_NAN: Complex32 = Complex32::new(f32::NAN, 0.0);

fn instrument(detection: Detection) -> Instrument {
    let array = MicArray::rectangular([12, 10], [0.06; 2], DVec3::ZERO).unwrap();
    Instrument::new(Sweep::stepped(10e3, 16e3, 40.0).unwrap(), array).with_detection(detection)
}

/// Three echoes, 0.9 to 2.1 m away, of 8.6 m of path.
fn cube(instrument: &Instrument, snr_db: Option<f64>) -> DataCube {
    let places = vec![DVec3::new(0.1, -0.2, 0.9), DVec3::new(-0.4, 0.3, 1.5), DVec3::new(0.6, 0.1, 2.0)];
    let amplitudes = vec![Complex32::ONE, Complex32::new(0.0, 0.8), Complex32::new(0.5, 0.5)];
    let reflectors = Reflectors::new(places, amplitudes).unwrap();
    let noise = snr_db.map(|snr_db| Noise { snr_db, seed: 7 });
    simulate(&reflectors, instrument, &SimulateOptions::default().with_noise(noise)).unwrap()
}

fn health(cube: &DataCube) -> Health {
    Health::of(&mut &*cube, 1 << 30, &Silent).unwrap()
}

fn scale(cube: &mut DataCube, microphone: usize, factor: f32) {
    cube.samples.iter_mut().skip(microphone).step_by(120).for_each(|m| *m *= factor);
}

#[test]
fn dead_loud_and_missing_channels_are_told_apart() {
    let sound = cube(&instrument(Detection::Quadrature), Some(20.0));
    let found = health(&sound);
    for levels in [&found.microphones, &found.tones] {
        assert_eq!([levels.dead.count, levels.loud.count, levels.not_finite.count], [0; 3]);
        assert!((1.0..2.0).contains(&levels.median) && levels.spread_db.unwrap() < 8.0, "{levels:?}");
    }
    assert_eq!((found.samples_not_finite, found.all_zero, found.profiled_microphones), (0, false, 120));
    let mut bad = sound.clone();
    for (microphone, factor) in [(3, 0.0), (17, 0.005), (50, 0.02), (40, 30.0), (60, 5.0)] {
        scale(&mut bad, microphone, factor);
    }
    bad.samples[5 * 120 + 70] = F32_NAN;
    bad.samples[120 * 9..120 * 10].fill(Complex32::new(0.0, f32::INFINITY));
    bad.samples[120 * 20..120 * 21].fill(Complex32::ZERO);
    let found = health(&bad);
    let named = |odd: &OddChannels| odd.first.iter().map(|odd| odd.index).collect::<Vec<_>>();
    let microphones = &found.microphones;
    assert_eq!((named(&microphones.dead), named(&microphones.loud)), (vec![3, 17], vec![40]));
    assert_eq!(
        microphones.loud.first[0].position_m.unwrap(),
        bad.instrument.array.positions()[40].to_array()
    );
    assert!((microphones.loud.first[0].level_db.unwrap() - 29.5).abs() < 1.0);
    assert_eq!(microphones.dead.first[0].level_db, None);
    assert_eq!((microphones.not_finite.count, microphones.not_finite.first.len()), (120, 8));
    let tones = &found.tones;
    assert_eq!((named(&tones.dead), tones.loud.count), (vec![20], 0));
    assert_eq!(named(&tones.not_finite), [5, 9]);
    assert_eq!(tones.not_finite.first[1].frequency_hz, Some(10_360.0));
    assert_eq!([tones.not_finite.first[0].samples_not_finite, found.samples_not_finite], [1, 121]);
    assert!(tones.rms[9].is_nan() && !tones.rms[5].is_nan());
    // The others still tell of noise, echoes and sign.
    assert_eq!(found.profiled_microphones, 117);
    assert!((found.profile.unwrap().peaks[0].range - 0.93).abs() < 0.05);
    assert_eq!(found.phase_sign.unwrap().likely, LikelySign::Declared);
}

#[test]
fn the_noise_is_that_of_the_simulation() {
    for detection in [Detection::Quadrature, Detection::InPhase] {
        let instrument = instrument(detection);
        for snr_db in [30.0, 20.0, 10.0, 0.0] {
            let noise = health(&cube(&instrument, Some(snr_db))).noise.unwrap();
            let found = noise.snr_db.unwrap();
            assert!((found - snr_db).abs() < 1.0 && !noise.at_least, "{snr_db}: {noise:?}");
        }
        let noise = health(&cube(&instrument, None)).noise.unwrap();
        assert!(noise.at_least && noise.snr_db.unwrap() > 50.0, "{noise:?}");
    }
    // A single microphone.
    let alone = instrument(Detection::Quadrature)
        .with_array(MicArray::rectangular([1, 1], [1.0; 2], DVec3::ZERO).unwrap());
    for snr_db in [20.0, 10.0, 0.0] {
        let noise = health(&cube(&alone, Some(snr_db))).noise.unwrap();
        assert!((noise.snr_db.unwrap() - snr_db).abs() < 3.0, "{snr_db}: {noise:?}");
    }
}

#[test]
fn echoes_that_fill_the_path_are_no_noise() {
    // 41 tones 100 Hz apart tell 3.4 m of path apart; echoes of falling strength fill all of it.
    let sweep = Sweep::stepped(10e3, 14e3, 100.0).unwrap();
    let instrument = instrument(Detection::Quadrature).with_sweep(sweep);
    let places = (0..60).map(|i| DVec3::new(0.0, 0.0, 0.1 + 0.03 * f64::from(i)));
    let amplitudes = (0..60_u8).map(|i| Complex32::new(0.93_f32.powi(i.into()), 0.0));
    let reflectors = Reflectors::new(places.collect(), amplitudes.collect()).unwrap();
    let noise = Some(Noise { snr_db: 60.0, seed: 1 });
    let cube = simulate(&reflectors, &instrument, &SimulateOptions::default().with_noise(noise)).unwrap();
    let found = health(&cube).noise.unwrap();
    assert!(found.at_least && found.snr_db.unwrap() < 60.0, "{found:?}");
}

#[test]
fn the_sign_of_the_phase_is_told() {
    let usual = instrument(Detection::Quadrature);
    let scattered = {
        let place = |i: u32| {
            DVec3::from((glam::DVec2::from_angle(f64::from(i) * 2.4) * 0.05 * f64::from(i).sqrt(), 0.0))
        };
        MicArray::from_positions((0..80).map(place).collect()).unwrap()
    };
    let beside = Geometry::FixedSource { source: DVec3::new(0.5, 0.0, 0.1) };
    // With a step of 100 Hz the echoes are in the second half of 3.4 m of path, or beyond.
    let coarse = Sweep::stepped(10e3, 16e3, 100.0).unwrap();
    for (name, instrument) in [
        ("usual", usual.clone()),
        ("scattered", usual.clone().with_array(scattered)),
        ("beside", usual.clone().with_geometry(beside)),
        ("monostatic", usual.clone().with_geometry(Geometry::Monostatic)),
        ("coarse", usual.clone().with_sweep(coarse)),
    ] {
        for snr_db in [20.0, 0.0] {
            let mut cube = cube(&instrument, Some(snr_db));
            let right = health(&cube).phase_sign.unwrap();
            assert_eq!(right.likely, LikelySign::Declared, "{name}, {snr_db} dB: {right:?}");
            cube.samples.iter_mut().for_each(|m| *m = m.conj());
            let wrong = health(&cube).phase_sign.unwrap();
            assert_eq!(wrong.likely, LikelySign::Opposite, "{name}, {snr_db} dB: {wrong:?}");
        }
    }
    // Noise alone has no sign.
    let mut silent = cube(&usual, Some(-60.0));
    let found = health(&silent).phase_sign.unwrap();
    assert_eq!(found.likely, LikelySign::Unknown, "{found:?}");
    silent.instrument.detection = Detection::InPhase;
    assert_eq!(health(&silent).phase_sign, None);
}

#[test]
fn cubes_of_zeros_offsets_few_or_uneven_tones_are_told() {
    let instrument = instrument(Detection::InPhase);
    let mut cube = cube(&instrument, None);
    let sound = health(&cube);
    assert!(!sound.never_negative);
    // 40 Hz tell 8.575 m of path apart, of which real samples lose half.
    assert!((sound.profile.unwrap().unambiguous_path - 343.0 / 80.0).abs() < 1e-9);
    cube.samples.iter_mut().for_each(|m| m.re += 4.0);
    assert!(health(&cube).never_negative);
    cube.samples.fill(Complex32::ZERO);
    let found = health(&cube);
    assert!(found.all_zero && !found.never_negative);
    assert_eq!((found.microphones.dead.count, found.tones.dead.count), (120, 151));
    assert!(found.noise.is_none() && found.no_profile.is_some());
    cube.samples.fill(F32_NAN);
    let found = health(&cube);
    assert_eq!((found.microphones.dead.count, found.microphones.not_finite.count), (0, 120));
    for frequencies in [vec![10e3], (0_u32..40).map(|i| 1e4 + f64::from(i).powf(1.1) * 50.0).collect()] {
        let sweep = Sweep::from_frequencies(frequencies).unwrap();
        let found = health(&tests::cube(&instrument.clone().with_sweep(sweep), Some(20.0)));
        assert!(found.profile.is_none() && found.no_profile.is_some() && found.tones.median > 0.0);
    }
    // Little memory: fewer microphones are profiled, and all have levels.
    let noisy = tests::cube(&instrument, Some(20.0));
    let found = Health::of(&mut &noisy, 4 * 8 * 151 * 10, &Silent).unwrap();
    assert_eq!((found.profiled_microphones, found.microphones.rms.len()), (10, 120));
}

#[test]
fn several_speakers_are_examined_together_and_each() {
    let sources = [DVec3::ZERO, DVec3::X * 0.3, DVec3::Y * 0.2];
    let one = instrument(Detection::Quadrature);
    let several = one.clone().with_sources(&sources).unwrap();
    let mut cube = cube(&several, Some(20.0));
    scale(&mut cube, 3, 0.0);
    let size = cube.samples.len() / 3;
    // The second is conjugated, the third 30 dB weaker.
    cube.samples[size..2 * size].iter_mut().for_each(|m| *m = m.conj());
    cube.samples[2 * size..].iter_mut().for_each(|m| *m *= 0.03);
    let found = health(&cube);
    assert_eq!((found.microphones.dead.count, found.microphones.dead.first[0].index), (1, 3));
    assert_eq!((found.tones.count, found.profiled_microphones, found.transmissions.len()), (151, 119, 3));
    assert_eq!(found.phase_sign.unwrap().likely, LikelySign::Declared);
    for (tx, each) in found.transmissions.iter().enumerate() {
        let instrument = one.clone().with_sources(&sources[tx..=tx]).unwrap();
        let alone = health(&DataCube::new(instrument, cube.transmission(tx).to_vec()).unwrap());
        assert_eq!((each.phase_sign, each.noise), (alone.phase_sign, alone.noise), "{tx}");
        assert_eq!(each.source_m, sources[tx].to_array());
        assert!(!each.is_loud() && !each.is_dead());
    }
    let sign = |tx: usize| found.transmissions[tx].phase_sign.unwrap().likely;
    assert_eq!(
        [sign(0), sign(1), sign(2)],
        [LikelySign::Declared, LikelySign::Opposite, LikelySign::Declared]
    );
    let level = found.transmissions[2].level_db.unwrap();
    assert!((level + 30.5).abs() < 1.0, "{level}");
    cube.samples[2 * size..].fill(Complex32::ZERO);
    assert!(health(&cube).transmissions[2].is_dead());
}
