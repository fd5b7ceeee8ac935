//! Correlation against its literal double sum, what phases it forgives, and what it tells of depth.

#![allow(clippy::unwrap_used)]

use super::*;
use crate::acquisition::{DataCube, Detection, MicArray, Sweep};
use crate::grid::Volume;
use crate::named::assert_names;
use crate::progress::Silent;
use crate::reconstruct::volume::ResumedVolume;
use crate::reconstruct::volume::fixtures::*;
use crate::reconstruct::{RefineOptions, Solver, Window, reconstruct, reconstruct_into};
use crate::wave::Geometry;
use glam::DVec3;
use num_complex::{Complex32, Complex64};
use std::f64::consts::{FRAC_2_PI, TAU};

/// The echo of a unit reflector at `p`, times a phase in turns for each tone.
fn echo(instrument: Instrument, p: DVec3, turns: impl Fn(usize) -> f64) -> DataCube {
    let c = instrument.sound_speed;
    let mut samples = Vec::new();
    for tx in 0..instrument.transmissions() {
        for (i, f) in instrument.sweep.frequencies().iter().enumerate() {
            for r in instrument.array.positions() {
                let path = instrument.transmission(tx).path_length(p, *r);
                let m = Complex64::cis(TAU * (f * path / c + turns(i)));
                samples.push(Complex32::new(m.re as f32, m.im as f32));
            }
        }
    }
    DataCube::new(instrument, samples).unwrap()
}

fn grid() -> Grid {
    Grid { x: axis(-0.06, 0.03, 5), y: axis(-0.05, 0.03, 4), z: axis(0.5, 0.02, 4) }
}

fn options(window: Window, sub_band: usize) -> ReconstructOptions {
    ReconstructOptions::new(Method::Correlation, window).with_sub_band(sub_band)
}

fn image(cube: &DataCube, options: &ReconstructOptions) -> Volume {
    reconstruct(cube, &grid(), options).unwrap().volume
}

/// The largest difference of two volumes.
fn apart(a: &Volume, b: &Volume) -> f32 {
    a.samples.iter().zip(&b.samples).map(|(a, b)| (a - b).norm()).fold(0.0, f32::max)
}

/// The literal double sum over pairs of microphones, for each sub-band: the oracle. `[z, y, x]`.
fn correlation_literal(cube: &DataCube, grid: &Grid, (window, sub_band): (Window, usize)) -> Vec<f64> {
    let Instrument { sweep, array, sound_speed, .. } = &cube.instrument;
    let (of_sweep, of_array) = (window.over_sweep(sweep), window.over_array(array));
    let (n_f, n_mic) = (sweep.len(), array.len());
    let [n_z, n_y, n_x] = grid.shape();
    let mut volume = Vec::new();
    for i in 0..n_z * n_y * n_x {
        let p = grid.position(i % n_x, i / n_x % n_y, i / (n_x * n_y));
        let (mut sum, mut weights) = (0.0, 0.0);
        for (tx, samples) in cube.samples.chunks(n_f * n_mic).enumerate() {
            let instrument = cube.instrument.transmission(tx);
            let steered = |f: usize, r: usize| {
                let path = instrument.path_length(p, array.positions()[r]);
                let m = samples[f * n_mic + r];
                let phase = Complex64::cis(-TAU * sweep.frequencies()[f] * path / sound_speed);
                Complex64::new(m.re.into(), m.im.into()) * phase * of_sweep[f] * of_array[r]
            };
            let tones: Vec<usize> = (0..n_f).collect();
            for band in tones.chunks(sub_band) {
                for (r, other) in (0..n_mic).flat_map(|r| (0..n_mic).map(move |other| (r, other))) {
                    if r == other {
                        continue;
                    }
                    for (f, g) in band.iter().flat_map(|f| band.iter().map(move |g| (*f, *g))) {
                        sum += (steered(f, r) * steered(g, other).conj()).re;
                        weights += of_sweep[f] * of_array[r] * of_sweep[g] * of_array[other];
                    }
                }
            }
        }
        volume.push(sum / weights);
    }
    volume
}

#[test]
fn every_sub_band_is_the_literal_sum_over_pairs() {
    let beside = DVec3::new(0.2, -0.1, 0.03);
    let several = instrument(lattice([5, 4])).with_sources(&[DVec3::ZERO, beside]).unwrap();
    let scan = instrument(lattice([5, 4])).with_geometry(Geometry::Monostatic);
    let mut negative = 0;
    for (instrument, sub_band, window) in [
        (instrument(lattice([5, 4])), 1, Window::None),
        (instrument(lattice([5, 4])), 4, Window::Taylor),
        (instrument(scattered(17)), 1, Window::Hann),
        (instrument(scattered(17)), 7, Window::None),
        (instrument(lattice([5, 4])), 9, Window::None),
        (several, 4, Window::None),
        (scan, 2, Window::Taylor),
    ] {
        let cube = cube(instrument);
        let options = options(window, sub_band);
        let found = reconstruct(&cube, &grid(), &options).unwrap();
        let exact = correlation_literal(&cube, &grid(), (window, sub_band));
        negative += exact.iter().filter(|p| **p < 0.0).count();
        // The bound on amplitudes is the root of that on powers.
        let bound = found.error_bound.powi(2) + 1e-6;
        for (a, p) in found.volume.samples.iter().zip(&exact) {
            let error = (f64::from(a.re).powi(2) - p.max(0.0)).abs();
            assert!(a.im == 0.0 && error <= bound, "{sub_band}: {a} against {p}, {bound:e}");
        }
        let correlation = found.correlation.unwrap();
        assert_eq!((found.method, correlation.sub_band), (Method::Correlation, sub_band));
        assert_eq!(correlation.sub_bands, 9_usize.div_ceil(sub_band));
    }
    assert!(negative > 100, "{negative}");
}

#[test]
fn a_unit_reflector_peaks_at_one_and_unknown_phases_do_not_matter() {
    let p = DVec3::new(0.03, -0.02, 0.54);
    let known = |_: usize| 0.0;
    let of_tones = |f: usize| random(f + 1, 0.618_033_99);
    let of_bands = |f: usize| random(f / 5 + 1, 0.618_033_99);
    for array in [lattice([5, 4]), scattered(17)] {
        let with = |turns: &dyn Fn(usize) -> f64| echo(instrument(array.clone()), p, turns);
        let cubes = [with(&known), with(&of_tones), with(&of_bands)];
        let [plain, tones, bands] = &cubes;
        let single = options(Window::None, 1);
        let at_peak = |volume: &Volume| volume.plane(2)[5 + 3].norm();
        assert!((at_peak(&image(plain, &single)) - 1.0).abs() < 1e-3);
        assert!(apart(&image(plain, &single), &image(tones, &single)) < 2e-3);
        let banded = options(Window::None, 5);
        assert!((at_peak(&image(bands, &banded)) - 1.0).abs() < 1e-3);
        assert!(apart(&image(plain, &banded), &image(bands, &banded)) < 2e-3);
        // A coherent image needs all of them.
        let coherent = ReconstructOptions::new(Method::Auto, Window::None);
        assert!(at_peak(&image(plain, &coherent)) > 0.99 && at_peak(&image(tones, &coherent)) < 0.5);
    }
}

#[test]
fn neither_memory_nor_interruption_changes_a_byte() {
    let cube = cube(instrument(lattice([5, 4])));
    for sub_band in [1, 4] {
        let options = options(Window::None, sub_band);
        let whole = image(&cube, &options);
        assert_eq!(image(&cube, &ReconstructOptions { memory: Some(0), ..options }), whole);
        for done in 0..=4 {
            let mut resumed = ResumedVolume { volume: Volume { grid: grid(), samples: vec![] }, done };
            reconstruct_into(&mut &cube, &grid(), &options, &mut resumed, &Silent).unwrap();
            let plane = grid().plane_len();
            let samples = &resumed.volume.samples;
            assert!(done == 4 || samples[done * plane..] == whole.samples[done * plane..], "{done}");
        }
    }
}

#[test]
fn depth_is_resolved_as_predicted() {
    let array = MicArray::rectangular([15, 15], [0.04; 2], DVec3::ZERO).unwrap();
    let instrument = instrument(array);
    let p = DVec3::new(0.0, 0.0, 0.7);
    let cube = echo(instrument.clone(), p, |_| 0.0);
    let line = Grid { x: axis(0.0, 0.01, 1), y: axis(0.0, 0.01, 1), z: axis(0.5, 0.002, 201) };
    let mut widths = Vec::new();
    for sub_band in [1, 3, 9] {
        let found = reconstruct(&cube, &line, &options(Window::None, sub_band)).unwrap();
        let above = found.volume.samples.iter().filter(|a| f64::from(a.re) > FRAC_2_PI).count();
        let measured = above as f64 * 0.002;
        let at = Grid { z: axis(0.7, 0.01, 1), ..line };
        let correlation = Correlation::of(&instrument, &at, &options(Window::None, sub_band)).unwrap();
        let predicted = correlation.mean_resolution();
        assert!((predicted / measured - 1.0).abs() < 0.1, "{sub_band}: {predicted}, not {measured}");
        widths.push(predicted);
    }
    // By curvature alone, and with ever more of the band, down to c/2B of the mean slope.
    assert!(widths[0] > 2.0 * widths[1] && widths[1] > 2.0 * widths[2], "{widths:?}");
    let cell = instrument.range_resolution().unwrap();
    assert!((0.9..1.1).contains(&(widths[2] / cell)), "{} {cell}", widths[2]);
    // The farther, the flatter: with the square of the distance.
    let far = Correlation::of(&instrument, &Grid { z: axis(2.0, 2.0, 2), ..line }, &options(Window::None, 1));
    let [near, far] = far.unwrap().depth_resolution;
    assert!((far / near - 4.0).abs() < 0.3, "{near} {far}");
}

#[test]
fn a_correlation_costs_a_coherent_image_for_each_sub_band() {
    let instrument = instrument(lattice([5, 4]));
    let of = |sub_band: usize| {
        let estimates = estimate(&instrument, &grid(), &options(Window::None, sub_band), 1).unwrap();
        assert_eq!(estimates.methods.len(), 1);
        estimates.chosen().clone()
    };
    let [one, five, all] = [1, 5, 9].map(of);
    assert!(one.operations > five.operations && five.operations > all.operations);
    assert!(all.method == Method::Correlation && all.obstacle.is_none() && all.bytes > 0);
}

#[test]
fn what_has_no_pairs_is_refused() {
    let cube = cube(instrument(lattice([5, 4])));
    let refused = |cube: &DataCube, options: ReconstructOptions, parts: &[&str]| {
        let estimated = estimate(&cube.instrument, &grid(), &options, 1).unwrap_err().to_string();
        let error = reconstruct(cube, &grid(), &options).unwrap_err();
        assert!(error.exit_status() == 2 && error.to_string() == estimated);
        assert_names(estimated, parts);
    };
    let plain = options(Window::None, 1);
    refused(&cube, plain.with_sub_band(10_usize), &["reconstruct.sub_band", "10", "1 to 9"]);
    refused(&cube, plain.with_sub_band(0_usize), &["reconstruct.sub_band", "1 to 9"]);
    let refine = RefineOptions::new(Solver::Cgls);
    refused(&cube, plain.with_refine(refine), &["refine.method", "correlation"]);
    let mut real = cube.clone();
    real.instrument.detection = Detection::InPhase;
    refused(&real, plain, &["reconstruct.method", "quadrature"]);
    let one = instrument(MicArray::from_positions(vec![DVec3::ZERO]).unwrap());
    let one = echo(one, DVec3::Z, |_| 0.0);
    refused(&one, plain, &["reconstruct.method", "there is one"]);
    let uneven = Sweep::from_frequencies(vec![8e3, 9e3, 9.5e3]).unwrap();
    let uneven = echo(instrument(lattice([5, 4])).with_sweep(uneven), DVec3::Z, |_| 0.0);
    refused(&uneven, plain.with_sub_band(2_usize), &["reconstruct.sub_band", "evenly", "use 1"]);
    reconstruct(&uneven, &grid(), &plain).unwrap();
    let several = instrument(lattice([5, 4])).with_sources(&[DVec3::ZERO, DVec3::X]).unwrap();
    let several = echo(several, DVec3::Z, |_| 0.0);
    refused(&several, plain.with_compensate(true), &["reconstruct.compensate", "loudspeakers"]);
}
