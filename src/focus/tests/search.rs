//! Autofocus.

use super::*;
use crate::acquisition::InstrumentChanges;
use crate::focus::jackknife::top;
use crate::focus::{Autofocus, AutofocusOptions, FocusMeasure, FocusParameter, FocusVerdict, autofocus};
use crate::grid::Volume;
use crate::named::assert_names;
use crate::progress::Silent;
use crate::wave::Geometry;

fn search(cube: &DataCube, parameter: FocusParameter, options: &AutofocusOptions) -> Autofocus {
    autofocus(cube, &region(), parameter, options, &Silent).unwrap()
}

/// A cube that says a wrong speed of sound.
fn wrong_speed(extent: f64, share: f64) -> DataCube {
    let mut cube = echoes(&instrument(extent), &points(5));
    cube.instrument.sound_speed *= 1.0 + share;
    cube
}

#[test]
fn a_wrong_speed_of_sound_is_found_with_a_large_array_and_not_with_a_small_one() {
    for measure in FocusMeasure::ALL {
        let found = search(
            &wrong_speed(1.0, 0.02),
            FocusParameter::SoundSpeed,
            &AutofocusOptions::default().with_measure(*measure),
        );
        assert_eq!(found.verdict, FocusVerdict::Found, "{found:?}");
        assert!((found.best / 343.0 - 1.0).abs() < 0.003, "{measure}: {}", found.best);
        assert!(found.setting.unwrap().starts_with("medium.sound_speed=34"));
        assert!(found.width[0] < found.best && found.best < found.width[1]);
    }
    let found = search(&wrong_speed(0.25, 0.02), FocusParameter::SoundSpeed, &AutofocusOptions::default());
    assert!([FocusVerdict::Flat, FocusVerdict::NoBlur].contains(&found.verdict), "{found:?}");
    assert!(found.setting.is_none() && found.reason.unwrap().contains("larger array"));
}

#[test]
fn what_a_setting_says_mends_the_cube() {
    // What the cube does not know, and what is to be typed.
    let right = instrument(1.0);
    let raised = InstrumentChanges { centre: Some(DVec3::new(0.0, 0.0, 0.03)), ..Default::default() };
    let raised = right.changed(&raised).unwrap().0.array;
    let wide = AutofocusOptions::default().with_range([-0.2, 0.2]);
    let raised = echoes_at(&right, raised.positions(), &points(5));
    let found = search(&raised, FocusParameter::ArrayZ, &wide);
    let within = |found: &Autofocus, truth: f64| {
        let [from, to] = found.plateau.unwrap();
        found.verdict == FocusVerdict::Found && (from..=to).contains(&truth)
    };
    assert!(within(&found, 0.03), "{found:?}");
    assert!(found.setting.unwrap().starts_with("array.centre=[0.0,0.0,0.0"));
    let aside = right.clone().with_geometry(Geometry::FixedSource { source: DVec3::new(0.0, 0.0, -0.03) });
    let mut moved = echoes(&aside, &points(5));
    moved.instrument = right.clone();
    let found = search(&moved, FocusParameter::SourceZ, &wide);
    assert!(within(&found, -0.03), "{found:?}");
    assert!(found.setting.unwrap().starts_with("array.source=[0.0,0.0,-0.0"));
    let cube = echoes(&right, &points(5));
    // A delay that was corrected by too little is found as a whole.
    let late = crate::acquisition::Calibration { delay: -0.05, ..Default::default() };
    let mut delayed = cube.clone();
    late.apply(&mut delayed, &Silent).unwrap();
    let found = search(&delayed, FocusParameter::Delay, &wide.with_delay(0.01));
    assert!(within(&found, 0.06), "{found:?}");
    assert!(found.setting.unwrap().starts_with("calibration.delay=0.0"));
}

#[test]
fn several_speakers_are_focused_together() {
    let sources = [DVec3::new(-0.3, 0.0, 0.0), DVec3::new(0.3, 0.1, 0.0)];
    let right = instrument(1.0).with_sources(&sources).unwrap();
    let mut cube = echoes(&right, &points(5));
    cube.instrument.sound_speed *= 1.02;
    let found = search(&cube, FocusParameter::SoundSpeed, &AutofocusOptions::default());
    assert_eq!(found.verdict, FocusVerdict::Found, "{found:?}");
    assert!((found.best / 343.0 - 1.0).abs() < 0.003 && found.standard_error.is_some(), "{found:?}");
    // Which of them would be moved?
    let options = AutofocusOptions::default();
    let refused = autofocus(&cube, &region(), FocusParameter::SourceX, &options, &Silent).unwrap_err();
    assert_names(refused.to_string(), &["source-x", "one loudspeaker", "2"]);
}

#[test]
fn what_an_image_cannot_tell_is_not_found() {
    // A tilt about a speaker in the array's centre turns the image, and a monostatic scan's z moves it.
    let points = points(5);
    let centred = echoes(&instrument(1.0), &points);
    let monostatic = echoes(&instrument(1.0).with_geometry(Geometry::Monostatic), &points);
    for (cube, parameter) in [
        (&centred, FocusParameter::TiltX),
        (&monostatic, FocusParameter::TiltY),
        (&monostatic, FocusParameter::ArrayZ),
    ] {
        let found = search(cube, parameter, &AutofocusOptions::default());
        assert_eq!(
            (found.verdict, found.setting),
            (FocusVerdict::NoBlur, None),
            "{parameter}: {}",
            found.blur
        );
    }
    // The truth is beyond the range.
    let range = AutofocusOptions::default().with_range([346.0, 356.0]);
    let found = search(&wrong_speed(1.0, 0.02), FocusParameter::SoundSpeed, &range);
    assert_eq!(found.verdict, FocusVerdict::EndOfRange, "{found:?}");
    for seed in 1..=3 {
        let instrument = instrument(1.0);
        let hiss = DataCube::new(instrument.clone(), noise(&instrument, 1.0, seed)).unwrap();
        let found = search(&hiss, FocusParameter::SoundSpeed, &AutofocusOptions::default());
        assert_ne!(found.verdict, FocusVerdict::Found, "{found:?}");
    }
}

#[test]
fn noise_widens_the_standard_error_and_the_truth_is_within_it() {
    let clean = wrong_speed(1.0, 0.01);
    let mut before = 0.0;
    for rms in [0.5, 4.0] {
        let mut cube = clean.clone();
        let hiss = noise(&cube.instrument, rms, 7);
        cube.samples.iter_mut().zip(hiss).for_each(|(m, noise)| *m += noise);
        let found = search(&cube, FocusParameter::SoundSpeed, &AutofocusOptions::default());
        let error = found.standard_error.unwrap();
        assert!(error > before && (found.best / 343.0 - 1.0).abs() < 0.003, "{found:?}");
        before = error;
    }
}

#[test]
fn a_search_is_the_same_with_any_number_of_threads() {
    let cube = wrong_speed(1.0, 0.01);
    let options = AutofocusOptions::default().with_trials(5);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| search(&cube, FocusParameter::SoundSpeed, &options))
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn measures_are_what_they_say() {
    let axis = Axis { first: 0.0, pitch: 1.0, count: 4 };
    let grid = Grid { x: axis, y: axis, z: axis };
    let volume = |of: &dyn Fn(usize) -> f32| Volume::new(grid, (0..64).map(|i| of(i).into()).collect());
    let even = volume(&|_| 2.0);
    let one = volume(&|i| if i == 21 { 3.0 } else { 0.0 });
    let silent = volume(&|_| 0.0);
    for (measure, of_even, of_one) in [
        (FocusMeasure::Sharpness, 1.0, 64.0),
        (FocusMeasure::Peak, 2.0, 3.0),
        (FocusMeasure::Gradient, 0.0, 2.0046),
    ] {
        assert!((measure.of(&even) - of_even).abs() < 1e-6, "{measure}");
        assert!((measure.of(&one) - of_one).abs() < 0.01, "{measure}: {}", measure.of(&one));
        assert_eq!(measure.of(&silent), 0.0, "{measure}");
    }
    let places: Vec<f64> = (0..7).map(|i| 340.0 + f64::from(i)).collect();
    let parabola: Vec<f64> = places.iter().map(|x| 5.0 - 0.3 * (x - 342.2).powi(2)).collect();
    let [at, value, falls] = top(&places, &parabola, 1.0).unwrap();
    assert!((at - 342.2).abs() < 1e-9 && (value - 5.0).abs() < 1e-9 && (falls - 0.3).abs() < 1e-9);
    assert!(top(&places, &places, 1.0).is_none(), "a line has no top");
}

#[test]
fn absurd_searches_are_refused() {
    let cube = echoes(&instrument(1.0), &points(1));
    let refused = |cube: &DataCube, parameter, options: AutofocusOptions| {
        autofocus(cube, &region(), parameter, &options, &Silent).unwrap_err().to_string()
    };
    let usual = AutofocusOptions::default();
    let speed = FocusParameter::SoundSpeed;
    assert_names(refused(&cube, speed, usual.with_range([350.0, 340.0])), &["--range", "350"]);
    assert_names(refused(&cube, speed, usual.with_range([-1.0, 340.0])), &["speed of sound"]);
    for trials in [0, 4, 1002] {
        assert_names(refused(&cube, speed, usual.with_trials(trials)), &["--trials", "5", "1001"]);
    }
    let monostatic = echoes(&instrument(1.0).with_geometry(Geometry::Monostatic), &points(1));
    assert_names(refused(&monostatic, FocusParameter::SourceX, usual), &["source-x", "monostatic"]);
    let mut real = cube;
    real.instrument.detection = crate::acquisition::Detection::InPhase;
    real.samples.iter_mut().for_each(|m| m.im = 0.0);
    assert_names(refused(&real, FocusParameter::Delay, usual), &["delay", "I and Q"]);
}
