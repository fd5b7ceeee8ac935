//! Echoes are found where they are, in both detections, even and uneven sweeps, with and without a window.

use super::*;
use crate::acquisition::{DataCube, MicArray, SimulateOptions, Sweep, simulate};
use crate::progress::Silent;
use crate::reflectors::Reflectors;
use glam::DVec3;

fn instrument(sweep: Sweep) -> Instrument {
    Instrument::new(sweep, MicArray::rectangular([3, 3], [0.05, 0.04], DVec3::ZERO).expect("valid"))
}

fn cube(instrument: &Instrument, echoes: &[(f64, f32)]) -> DataCube {
    let (at, loud): (Vec<_>, Vec<_>) =
        echoes.iter().map(|(z, a)| (DVec3::new(0.0, 0.0, *z), Complex32::new(*a, 0.0))).unzip();
    let echoes = Reflectors::new(at, loud).expect("valid");
    simulate(&echoes, instrument, &SimulateOptions::default()).expect("fits")
}

fn scan(cube: &DataCube, microphone: ScannedMicrophone) -> AScan {
    let weights = vec![1.0; cube.instrument.sweep.len()];
    let options = AScanOptions::default().with_microphone(microphone);
    AScan::of(&mut &*cube, &weights, &options, &Silent).expect("a profile")
}

#[test]
fn ranges_levels_and_limits_are_those_of_the_formulas() {
    let even = Sweep::stepped(10e3, 20e3, 50.0).expect("even");
    let list: Vec<f64> = (0..201).map(|n| 10e3 + 50.0 * f64::from(n) + f64::from(n * 7 % 13)).collect();
    let uneven = Sweep::from_frequencies(list).expect("ascending");
    for (sweep, detection) in [
        (even.clone(), Detection::Quadrature),
        (even, Detection::InPhase),
        (uneven.clone(), Detection::Quadrature),
        (uneven, Detection::InPhase),
    ] {
        let instrument = instrument(sweep).with_detection(detection);
        // The microphone in the centre is at the speaker.
        let scan = scan(&cube(&instrument, &[(0.873, 1.0), (1.2, 0.25)]), ScannedMicrophone::Centre);
        let [first, second] = scan.peaks[..] else { panic!("two echoes: {:?}", scan.peaks) };
        // A resolution of 17 mm; sidelobes of one echo move the other.
        assert!(
            (first.range - 0.873).abs() < 2e-4 && (second.range - 1.2).abs() < 1e-3,
            "{detection}: {scan:?}"
        );
        assert!(first.level_db.abs() < 0.2 && (second.level_db + 12.04).abs() < 1.0, "{first:?} {second:?}");
        assert!((scan.range_resolution - 343.0 / scan_band(&scan) / 2.0).abs() < 1e-12);
        // A rectangular window's peak is 0.886 c/2B wide.
        assert!((scan.peak_width / scan.range_resolution - 0.886).abs() < 0.01, "{}", scan.peak_width);
        let most = 343.0 / scan_band(&scan) * 200.0 * if detection == Detection::InPhase { 0.5 } else { 1.0 };
        assert!((scan.unambiguous_path / most - 1.0).abs() < 1e-9);
        assert!(scan.amplitude.len() as f64 * scan.path_pitch >= 0.999 * scan.unambiguous_path);
    }
}

fn scan_band(scan: &AScan) -> f64 {
    scan.frequencies[scan.frequencies.len() - 1] - scan.frequencies[0]
}

#[test]
fn paths_beyond_the_unambiguous_length_fold() {
    // c/δf = 3.43 m of path in quadrature: an echo at 2 m of range has a path of 4 m, seen as 0.57 m.
    let instrument = instrument(Sweep::stepped(10e3, 20e3, 100.0).expect("even"));
    let found = scan(&cube(&instrument, &[(2.0, 1.0)]), ScannedMicrophone::Centre);
    assert!((found.peaks[0].range - 0.285).abs() < 2e-4, "{:?}", found.peaks);
    // In phase it is mirrored at half of that: 1.715 m of path. 1 m of range are seen as 3.43 − 2 = 1.43 m of path.
    let real = instrument.with_detection(Detection::InPhase);
    let found = scan(&cube(&real, &[(1.0, 1.0)]), ScannedMicrophone::Centre);
    assert!((found.peaks[0].range - 0.715).abs() < 1e-3, "{:?}", found.peaks);
}

#[test]
fn the_mean_is_of_all_and_a_window_widens() {
    let instrument = instrument(Sweep::stepped(10e3, 20e3, 50.0).expect("even"));
    let one = cube(&instrument, &[(1.5, 1.0)]);
    let mean = scan(&one, ScannedMicrophone::Mean);
    assert_eq!((mean.microphones, mean.peaks.len(), mean.samples.len()), (9, 1, 0));
    let weights: Vec<f64> =
        (0..201).map(|n| (std::f64::consts::PI * (f64::from(n) + 0.5) / 201.0).sin().powi(2)).collect();
    let options = AScanOptions::default().with_microphone(ScannedMicrophone::Number(4));
    let hann = AScan::of(&mut &one, &weights, &options, &Silent).expect("a profile");
    assert!((hann.peak_width / hann.range_resolution - 1.44).abs() < 0.02, "{}", hann.peak_width);
    assert!(hann.peaks.len() == 1 && (hann.peaks[0].range - 1.5).abs() < 1e-4, "{:?}", hann.peaks);
}

#[test]
fn what_there_is_not_is_refused() {
    let instrument = instrument(Sweep::stepped(10e3, 20e3, 1000.0).expect("even"));
    let one = cube(&instrument, &[(0.1, 1.0)]);
    let refused = |options: AScanOptions| {
        AScan::of(&mut &one, &[1.0; 11], &options, &Silent).expect_err("refused").to_string()
    };
    assert!(refused(AScanOptions::default().with_microphone(ScannedMicrophone::Number(9))).contains("has 9"));
    assert!(refused(AScanOptions::default().with_transmission(1_usize)).contains("has 1"));
    let single = instrument.with_sweep(Sweep::from_frequencies(vec![1e4]).expect("one"));
    let one = cube(&single, &[(0.1, 1.0)]);
    let error = AScan::of(&mut &one, &[1.0], &AScanOptions::default(), &Silent).expect_err("no band");
    assert!(error.to_string().contains("single frequency"));
}

#[test]
fn microphones_are_named_by_number_word_or_place() {
    use ScannedMicrophone::{Centre, Mean, Nearest, Number};
    for (typed, expected) in
        [("7", Number(7)), ("centre", Centre), ("mean", Mean), ("0.1, -2", Nearest([0.1, -2.0]))]
    {
        assert_eq!(typed.parse::<ScannedMicrophone>().expect("known"), expected);
    }
    for typed in ["", "-1", "center", "1,2,3", "nan,1", "0.5"] {
        assert!(typed.parse::<ScannedMicrophone>().is_err(), "{typed}");
    }
    let array = MicArray::rectangular([3, 3], [0.05, 0.04], DVec3::ZERO).expect("valid");
    assert_eq!(
        [array.nearest([0.0, 0.0]), array.nearest([9.0, -9.0]), array.nearest([-0.03, 0.03])],
        [4, 2, 6]
    );
}
