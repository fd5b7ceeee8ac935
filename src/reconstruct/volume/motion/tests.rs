//! Moving frames against the sum written out with the places of every tone, and what motion does to an image.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::acquisition::DataCube;
use crate::grid::Volume;
use crate::named::assert_names;
use crate::progress::Silent;
use crate::reconstruct::volume::ResumedVolume;
use crate::reconstruct::volume::fixtures::*;
use crate::reconstruct::{RefineOptions, Solver, reconstruct, reconstruct_into};
use crate::wave::{Interface, blurred_amplitude};
use num_complex::Complex64;

fn grid() -> Grid {
    Grid { x: axis(-0.06, 0.03, 4), y: axis(-0.05, 0.03, 3), z: axis(0.5, 0.02, 4) }
}

/// The equation of the module, written out.
fn literal(cube: &DataCube, grid: &Grid, window: Window, motion: Motion) -> Vec<Complex64> {
    let Instrument { sweep, array, sound_speed, detection, .. } = &cube.instrument;
    let (of_sweep, of_array) = (window.over_sweep(sweep), window.over_array(array));
    let (n_f, n_mic, [n_z, n_y, n_x]) = (sweep.len(), array.len(), grid.shape());
    let at = |i: usize| grid.position(i % n_x, i / n_x % n_y, i / n_x / n_y);
    let of_voxel = |p: DVec3| {
        let (mut sum, mut weights) = (Complex64::ZERO, 0.0);
        for (i, m) in cube.samples.iter().enumerate() {
            let (played, f, r) = (i / n_mic, i / n_mic % n_f, i % n_mic);
            let there = p + motion.velocity * (motion.start + played as f64 * motion.dwell);
            let own = cube.instrument.transmission(i / (n_f * n_mic));
            let path = own.path_length(there, array.positions()[r]);
            let turn = Complex64::cis(-TAU * sweep.frequencies()[f] * path / sound_speed);
            let weight = of_sweep[f] * of_array[r];
            sum += Complex64::new(m.re.into(), m.im.into()) * turn * weight;
            weights += weight;
        }
        sum * detection.weight() / weights
    };
    (0..n_x * n_y * n_z).map(|i| of_voxel(at(i))).collect()
}

fn moving(velocity: DVec3, dwell: f64) -> ReconstructOptions {
    ReconstructOptions::new(Method::Auto, Window::None).with_motion(Motion::new(velocity, dwell))
}

#[test]
fn every_method_is_the_literal_sum_with_moved_positions() {
    let beside = DVec3::new(0.2, -0.1, 0.03);
    let several = instrument(lattice([5, 4])).with_sources(&[DVec3::ZERO, beside]).unwrap();
    let scan = instrument(lattice([5, 4])).with_geometry(Geometry::Monostatic);
    let pair = instrument(lattice([5, 4])).with_geometry(Geometry::Pair { offset: beside });
    let in_phase = instrument(lattice([5, 4])).with_detection(Detection::InPhase);
    let fast = DVec3::new(0.3, -0.2, 0.5);
    for (instrument, method, window, velocity) in [
        (instrument(lattice([5, 4])), Method::Convolution, Window::None, fast),
        (instrument(lattice([5, 4])), Method::Direct, Window::Taylor, fast),
        (instrument(scattered(17)), Method::Auto, Window::Hann, fast),
        (instrument(scattered(17)), Method::Backprojection, Window::None, -fast),
        (several, Method::Auto, Window::None, fast),
        (scan, Method::Convolution, Window::Taylor, fast),
        (pair, Method::Direct, Window::None, fast),
        (in_phase, Method::Convolution, Window::None, fast),
        // So slow that some tones are imaged together, and all of them.
        (instrument(lattice([5, 4])), Method::Convolution, Window::None, fast * 2e-5),
        (instrument(lattice([5, 4])), Method::Convolution, Window::None, fast * 1e-7),
    ] {
        let mut options = moving(velocity, 0.01);
        (options.method, options.window) = (method, window);
        options.motion.as_mut().unwrap().start = 0.05;
        let cube = cube(instrument);
        let found = reconstruct(&cube, &grid(), &options).unwrap();
        let exact = literal(&cube, &grid(), window, options.motion.unwrap());
        for (a, exact) in found.volume.samples.iter().zip(&exact) {
            let error = (Complex64::new(a.re.into(), a.im.into()) - exact).norm();
            assert!(error <= found.error_bound + 3e-6, "{method} {velocity}: {error:e}");
        }
    }
    let of = |velocity| together(&instrument(lattice([5, 4])), &grid(), Motion::new(velocity, 0.01), 1e-4);
    assert_eq!([of(fast), of(fast * 1e-7), of(DVec3::ZERO)], [1, 9, 9]);
    assert!((2..9).contains(&of(fast * 2e-5)), "{}", of(fast * 2e-5));
}

#[test]
fn a_frame_that_is_still_is_eq_13_and_resuming_changes_no_byte() {
    let cube = cube(instrument(lattice([5, 4])));
    let still = reconstruct(&cube, &grid(), &ReconstructOptions::new(Method::Auto, Window::None)).unwrap();
    let none = reconstruct(&cube, &grid(), &moving(DVec3::ZERO, 0.1)).unwrap();
    let apart = still.volume.samples.iter().zip(&none.volume.samples).map(|(a, b)| (a - b).norm());
    assert!(apart.fold(0.0, f32::max) <= 2.0 * still.error_bound as f32 + 1e-6);
    let options = moving(DVec3::new(0.1, 0.0, 0.2), 0.01);
    let whole = reconstruct(&cube, &grid(), &options).unwrap().volume;
    let tight = ReconstructOptions { memory: Some(0), ..options };
    assert_eq!(reconstruct(&cube, &grid(), &tight).unwrap().volume, whole);
    for done in 0..4 {
        let mut resumed = ResumedVolume { volume: Volume { grid: grid(), samples: vec![] }, done };
        reconstruct_into(&mut &cube, &grid(), &options, &mut resumed, &Silent).unwrap();
        let plane = grid().plane_len();
        assert_eq!(resumed.volume.samples[done * plane..], whole.samples[done * plane..], "{done}");
    }
}

#[test]
fn an_image_that_takes_it_for_still_is_displaced_and_blurred_as_predicted() {
    let (p, velocity, dwell) = (DVec3::new(0.02, -0.03, 0.9), DVec3::new(0.01, 0.0, 0.06), 0.024);
    let instrument = Instrument::new(Sweep::stepped(9e3, 15e3, 400.0).unwrap(), lattice([5, 4]));
    let motion = Motion::new(velocity, dwell);
    let mut samples = Vec::new();
    for (n, f) in instrument.sweep.frequencies().iter().enumerate() {
        for r in instrument.array.positions() {
            let path = instrument.path_length(p + motion.displacement(n as f64), *r);
            samples.push(phasor(f * path / instrument.sound_speed));
        }
    }
    let cube = DataCube::new(instrument.clone(), samples).unwrap();
    let band = [instrument.sweep.start(), instrument.sweep.stop()];
    let seen = p + velocity * motion.lag(band, 400.0);
    assert!(seen.distance(p) > 0.03, "{seen}");
    let about = |p: DVec3| Grid {
        x: axis(p.x - 0.02, 0.01, 5),
        y: axis(p.y - 0.02, 0.01, 5),
        z: axis(p.z - 0.02, 0.002, 21),
    };
    let still = ReconstructOptions::new(Method::Auto, Window::None);
    let image = reconstruct(&cube, &about(seen), &still).unwrap().volume;
    let peak = image.peak();
    let highest = image.samples.iter().position(|a| a.norm() == peak).unwrap();
    // Across, a point is as wide as the whole of this grid.
    assert!((highest as i32 / 25 - 10).abs() <= 2, "{}", highest / 25);
    let there = f64::from(image.plane(10)[12].norm());
    let step = 1e-4 * velocity.normalize();
    let path = |p: DVec3| instrument.path_length(p, instrument.array.centre());
    let rate = velocity.length() * (path(p + step) - path(p - step)) / 2e-4;
    let cycles = motion.cycles(6e3, 400.0, rate, instrument.sound_speed);
    let expected = blurred_amplitude(cycles);
    assert!(expected < 0.95 && (there - expected).abs() < 0.02, "{there} {expected} {cycles}");
    assert!(f64::from(peak) < there + 0.02, "{peak} {there}");
    // With its velocity it is where it was at first, and sharp.
    let image = reconstruct(&cube, &about(p), &still.with_motion(motion)).unwrap().volume;
    assert!((image.plane(10)[12].norm() - 1.0).abs() < 1e-3 && (image.peak() - 1.0).abs() < 1e-3);
}

#[test]
fn what_cannot_move_is_refused_and_costs_are_counted() {
    let cube = cube(instrument(lattice([5, 4])));
    let refused = |cube: &DataCube, options: ReconstructOptions, parts: &[&str]| {
        let estimated = estimate(&cube.instrument, &grid(), &options, 1).unwrap_err().to_string();
        assert_eq!(reconstruct(cube, &grid(), &options).unwrap_err().to_string(), estimated);
        assert_names(estimated, parts);
    };
    let plain = moving(DVec3::Z * 0.1, 0.01);
    refused(&cube, plain.with_refine(RefineOptions::new(Solver::Cgls)), &["refine.method", "velocity"]);
    refused(&cube, moving(DVec3::X * 1e5, 0.01), &["medium.velocity", "1e4"]);
    refused(&cube, moving(DVec3::X, f64::NAN), &["medium.velocity", "1e4"]);
    let correlation = ReconstructOptions { method: Method::Correlation, ..plain };
    refused(&cube, correlation, &["medium.velocity", "correlation"]);
    let mut layered = cube.clone();
    layered.instrument.interface = Some(Interface { depth: 0.2, sound_speed: 1500.0 });
    refused(&layered, plain, &["medium.velocity", "interface"]);
    let of = |options: &ReconstructOptions| estimate(&cube.instrument, &grid(), options, 1).unwrap();
    let still = ReconstructOptions::new(Method::Auto, Window::None);
    assert!(of(&plain).chosen().operations > of(&still).chosen().operations);
    assert_eq!(of(&plain).methods.len(), 4);
}
