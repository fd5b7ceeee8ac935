//! The linear method against its own formula, summed as it is written, and as an adjoint.

use crate::support::{self, Random, peak, position_of, random_cube, relative_difference, unit_reflector};
use glam::DVec3;
use holosonar::acquisition::{
    DataCube, Detection, Instrument, MicArray, PropagationModel, SimulateOptions, Sweep, simulate,
};
use holosonar::grid::{Axis, Grid};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, estimate, reconstruct};
use holosonar::reflectors::Reflectors;
use holosonar::wave::Geometry;
use num_complex::Complex32;
use std::f64::consts::TAU;

fn axis(first: f64, pitch: f64, count: usize) -> Axis {
    Axis { first, pitch, count }
}

/// The literal sum with the path of Eq. 6–7.
fn literal(cube: &DataCube, grid: &Grid, window: Window) -> Vec<Complex32> {
    let voxels = 0..grid.voxel_count() as usize;
    support::literal(cube, grid, window, Geometry::linear_path_length, voxels)
}

fn linear(cube: &DataCube, grid: &Grid, window: Window, tolerance: f64) -> Vec<Complex32> {
    let options = ReconstructOptions::new(Method::Linear, window).with_tolerance(tolerance);
    let image = reconstruct(cube, grid, &options).unwrap();
    assert_eq!(image.method, Method::Linear);
    let exact = literal(cube, grid, window);
    let worst = image.volume.samples.iter().zip(&exact).map(|(a, b)| (a - b).norm()).fold(0.0, f32::max);
    let rounding = 3e-6 * peak(&cube.samples);
    assert!(f64::from(worst) <= image.error_bound + rounding, "{worst:e} beyond {:e}", image.error_bound);
    image.volume.samples
}

fn lattice(count: [usize; 2], pitch: [f64; 2], centre: DVec3) -> MicArray {
    MicArray::rectangular(count, pitch, centre).unwrap()
}

/// Microphones anywhere in a plane.
fn scattered(random: &mut Random, count: usize, z: f64) -> MicArray {
    let place = |_| DVec3::new(random.uniform(-0.4, 0.3), random.uniform(-0.2, 0.3), z);
    let positions: Vec<DVec3> = (0..count).map(place).collect();
    MicArray::from_positions(positions).unwrap()
}

fn uneven() -> Sweep {
    let f = |n: usize| 9_000.0 + 130.0 * n as f64 + 40.0 * (n as f64 * 0.618).fract();
    Sweep::from_frequencies((0..37).map(f).collect()).unwrap()
}

fn even(count: usize) -> Sweep {
    Sweep::stepped(10_000.0, 10_000.0 + 100.0 * (count - 1) as f64, 100.0).unwrap()
}

#[test]
fn random_data_of_every_kind_agree_with_the_formula() {
    let mut random = Random::new(11);
    let box_grid = Grid { x: axis(-0.43, 0.061, 11), y: axis(-0.2, 0.05, 9), z: axis(0.9, 0.023, 8) };
    let aside = Grid { x: axis(0.3, 0.04, 9), y: axis(0.5, 0.07, 3), z: axis(0.0, 0.11, 7) };
    let flat = Grid { x: axis(-0.5, 0.05, 21), y: axis(0.0, 1.0, 1), z: axis(0.0, 0.1, 12) };
    let source = Geometry::FixedSource { source: DVec3::new(0.1, -0.2, 0.07) };
    let off = lattice([9, 6], [0.05, 0.07], DVec3::new(0.3, -0.1, 0.02));
    let row = lattice([33, 1], [0.03, 0.03], DVec3::ZERO);
    let square = lattice([12, 13], [0.04, 0.035], DVec3::ZERO);
    let bent = scattered(&mut random, 70, -0.03);
    let (quadrature, in_phase) = (Detection::Quadrature, Detection::InPhase);
    for (array, sweep, grid, geometry, detection) in [
        (square.clone(), even(41), box_grid, Geometry::ORIGIN, quadrature),
        (square.clone(), even(41), aside, Geometry::Monostatic, in_phase),
        (off.clone(), uneven(), box_grid, source, quadrature),
        (off, even(150), aside, source, quadrature),
        (row, even(101), flat, Geometry::ORIGIN, in_phase),
        (bent.clone(), uneven(), box_grid, Geometry::ORIGIN, quadrature),
        (bent, even(30), aside, Geometry::Monostatic, quadrature),
        (square, even(1), box_grid, Geometry::ORIGIN, quadrature),
        (lattice([1, 1], [0.1, 0.1], DVec3::ZERO), even(20), box_grid, source, quadrature),
    ] {
        let cube = random_cube(&mut random, sweep, array, geometry, detection);
        for (window, tolerance, within) in
            [(Window::None, 1e-4, 1e-5), (Window::Taylor, 1e-2, 2e-3), (Window::Hann, 0.0, 2e-6)]
        {
            let image = linear(&cube, &grid, window, tolerance);
            let difference = relative_difference(&image, &literal(&cube, &grid, window));
            println!("tolerance {tolerance:e}: {difference:.1e} of the greatest");
            assert!(difference < within, "{difference:e}");
        }
    }
}

#[test]
fn it_is_the_adjoint_of_a_linear_simulation() {
    let mut random = Random::new(5);
    let (array, sweep) = (lattice([8, 7], [0.06, 0.05], DVec3::new(0.02, 0.0, 0.0)), even(60));
    let grid = Grid { x: axis(-0.3, 0.05, 13), y: axis(-0.2, 0.06, 7), z: axis(0.7, 0.03, 9) };
    let m = random_cube(&mut random, sweep, array, Geometry::ORIGIN, Detection::Quadrature);
    let count = grid.voxel_count() as usize;
    let positions = (0..count).map(|v| position_of(&grid, v));
    let a: Vec<Complex32> = (0..count).map(|_| random.complex()).collect();
    let reflectors = Reflectors::new(positions.collect(), a.clone()).unwrap();
    let options = SimulateOptions::default().with_model(PropagationModel::Linear).with_tolerance(0.0);
    let simulated = simulate(&reflectors, &m.instrument, &options).unwrap();
    let image = linear(&m, &grid, Window::None, 0.0);
    let product = |a: &[Complex32], b: &[Complex32]| -> f64 {
        a.iter().zip(b).map(|(a, b)| f64::from((a.conj() * b).re)).sum()
    };
    let forward = product(&simulated.samples, &m.samples);
    let backward = product(&a, &image) * m.samples.len() as f64;
    let norm = |z: &[Complex32]| z.iter().map(|z| f64::from(z.norm_sqr())).sum::<f64>().sqrt();
    let scale = norm(&simulated.samples) * norm(&m.samples);
    assert!((forward - backward).abs() < 3e-6 * scale, "{forward} {backward}, {scale}");
}

#[test]
fn linear_data_give_a_sharp_image_and_exact_data_near_by_do_not() {
    let p = DVec3::new(0.2, -0.1, 1.0);
    let point = unit_reflector(p);
    let instrument = Instrument::new(even(101), lattice([41, 41], [0.025, 0.025], DVec3::ZERO));
    let grid = Grid { x: axis(0.0, 0.02, 21), y: axis(-0.3, 0.02, 21), z: axis(0.9, 0.01, 21) };
    let peak = |model: PropagationModel, p: DVec3| {
        let options = SimulateOptions::default().with_model(model);
        let cube = simulate(&point, &instrument, &options).unwrap();
        let options = ReconstructOptions::new(Method::Linear, Window::None);
        let volume = reconstruct(&cube, &grid, &options).unwrap().volume;
        let [ix, iy, iz] =
            [(&grid.x, p.x), (&grid.y, p.y), (&grid.z, p.z)].map(|(a, at)| a.index_of(at).unwrap());
        (volume.plane(iz)[iy * 21 + ix].norm(), volume.peak())
    };
    let (at, greatest) = peak(PropagationModel::Linear, p);
    assert!((at - 1.0).abs() < 1e-3 && (greatest - 1.0).abs() < 1e-3, "{at} {greatest}");
    let (_, greatest) = peak(PropagationModel::Exact, p);
    assert!(greatest < 0.2, "a wavelength out of focus: {greatest}");
}

#[test]
fn a_far_echo_is_the_same_by_the_far_field_and_by_the_true_path() {
    let p = DVec3::new(3.0, -2.0, 60.0);
    let point = unit_reflector(p);
    let instrument = Instrument::new(even(101), lattice([9, 9], [0.03, 0.03], DVec3::ZERO));
    let cube = simulate(&point, &instrument, &SimulateOptions::default()).unwrap();
    let grid = Grid { x: axis(-5.0, 1.0, 11), y: axis(-5.0, 1.0, 11), z: axis(59.8, 0.01, 41) };
    let of = |method: Method| {
        let options = ReconstructOptions::new(method, Window::None);
        reconstruct(&cube, &grid, &options).unwrap().volume.samples
    };
    // r²/2|p| is at most 0.24 mm, 0.014 of a turn.
    let difference = relative_difference(&of(Method::Linear), &of(Method::Direct));
    assert!(difference < 0.06, "{difference}");
}

#[test]
fn simulated_linear_data_are_equation_7() {
    let (p, c) = (DVec3::new(0.4, -0.3, 1.3), 343.0);
    let point = Reflectors::new(vec![p], vec![Complex32::new(0.7, 0.0)]).unwrap();
    let (array, sweep) = (lattice([5, 4], [0.2, 0.3], DVec3::new(0.1, 0.0, 0.0)), even(30));
    let instrument = Instrument::new(sweep.clone(), array.clone()).with_detection(Detection::InPhase);
    let options = SimulateOptions::default().with_model(PropagationModel::Linear);
    let cube = simulate(&point, &instrument, &options).unwrap();
    for (q, f) in sweep.frequencies().iter().enumerate() {
        for (j, r) in array.positions().iter().enumerate() {
            let phase = 2.0 * TAU * f * p.length() / c - TAU * f * p.dot(*r) / p.length() / c;
            let m = cube.samples[q * array.len() + j];
            assert!((f64::from(m.re) - 0.7 * phase.cos()).abs() < 1e-5 && m.im == 0.0);
        }
    }
}

#[test]
fn auto_never_takes_it_and_it_needs_no_plane_of_microphones() {
    let mut random = Random::new(3);
    let grid = Grid { x: axis(-0.3, 0.05, 13), y: axis(-0.2, 0.06, 7), z: axis(0.7, 0.03, 9) };
    let positions = (0..20)
        .map(|_| DVec3::new(random.uniform(-0.4, 0.3), random.uniform(-0.2, 0.3), random.uniform(-0.1, 0.1)));
    let bent = MicArray::from_positions(positions.collect()).unwrap();
    let planar = lattice([40, 40], [0.02, 0.02], DVec3::ZERO);
    for array in [planar, bent] {
        let cube = random_cube(&mut random, even(200), array, Geometry::ORIGIN, Detection::Quadrature);
        let of = |method: Method| {
            estimate(&cube.instrument, &grid, &ReconstructOptions::new(method, Window::None), 2).unwrap()
        };
        assert_ne!(of(Method::Auto).chosen().method, Method::Linear);
        let estimates = of(Method::Linear);
        assert_eq!(estimates.chosen().method, Method::Linear);
        assert!(estimates.chosen().obstacle.is_none());
        linear(&cube, &grid, Window::None, 1e-4);
    }
}
