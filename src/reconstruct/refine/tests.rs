//! The model and its adjoint against literal sums and each other, and what the solvers find against dense algebra.

#![allow(clippy::unwrap_used)]

mod adjoint;

use super::operator::Operator;
use super::*;
use crate::acquisition::{DataCube, Detection, Instrument, MicArray, Sweep};
use crate::grid::{Axis, Volume};
use crate::linalg::{LeastSquares, Matrix};
use crate::named::assert_names;
use crate::progress::Silent;
use crate::reconstruct::plan::{Candidates, MethodPlan};
use crate::reconstruct::{Method, Window, reconstruct, reconstruct_stored};
use crate::wave::{Geometry, Interface, phasor};
use glam::DVec3;
use num_complex::Complex32;
use std::collections::HashMap;

fn axis(first: f64, pitch: f64, count: usize) -> Axis {
    Axis { first, pitch, count }
}

/// A fixed sequence of numbers in −1 .. 1.
fn random(count: usize, seed: u64) -> Vec<Complex32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1 << 23) as f32 - 1.0
    };
    (0..count).map(|_| Complex32::new(next(), next())).collect()
}

fn sweep(step: f64) -> Sweep {
    Sweep::stepped(8_000.0, 14_000.0, step).unwrap()
}

fn options(window: Window) -> ReconstructOptions {
    ReconstructOptions::new(Method::Auto, window)
        .with_tolerance(1e-6)
        .with_refine(RefineOptions::new(Solver::Cgls))
}

/// Calls `test` with the operator of a case.
fn with_operator(
    instrument: &Instrument,
    grid: &Grid,
    options: &ReconstructOptions,
    test: impl Fn(&Operator<'_>),
) {
    let candidates = Candidates::new(instrument, grid, options, 2).unwrap();
    let batch = candidates.chosen(Method::Auto).batch;
    let (plan, _) = candidates.choose(instrument, grid, Method::Auto).unwrap();
    let MethodPlan::Convolution(plan) = plan else { panic!("{plan:?}") };
    test(&Operator::new(instrument, grid, &plan, batch, options));
}

/// `Σ_p A(p) e^{i2πf·path/c}` as it is written.
fn literal_echoes(instrument: &Instrument, grid: &Grid, voxels: &[Complex32]) -> Vec<Complex32> {
    let mut samples = Vec::new();
    let transmissions = (0..instrument.transmissions()).map(|index| instrument.transmission(index));
    let sweeps =
        transmissions.flat_map(|one| instrument.sweep.frequencies().iter().map(move |f| (one.clone(), f)));
    for (instrument, f) in sweeps {
        for r in instrument.array.positions() {
            let mut sum = Complex32::ZERO;
            for (i, a) in voxels.iter().enumerate() {
                let (ix, iy) = (i % grid.x.count, i / grid.x.count % grid.y.count);
                let p = grid.position(ix, iy, i / grid.plane_len());
                sum += a * phasor(f / instrument.sound_speed * instrument.path_length(p, *r));
            }
            let in_phase = instrument.detection == Detection::InPhase;
            samples.push(if in_phase { Complex32::new(sum.re, 0.0) } else { sum });
        }
    }
    samples
}

fn norm(numbers: &[Complex32]) -> f64 {
    numbers.iter().map(|a| f64::from(a.norm_sqr())).sum::<f64>().sqrt()
}

/// A few voxels so far apart that the array tells them apart, a little.
fn tiny() -> (Instrument, Grid) {
    let array = MicArray::rectangular([5, 4], [0.05; 2], DVec3::ZERO).unwrap();
    let grid = Grid { x: axis(-0.1, 0.09, 3), y: axis(-0.08, 0.09, 3), z: axis(0.5, 0.03, 3) };
    (Instrument::new(sweep(200.0), array), grid)
}

/// The least squares of a dense matrix in double precision.
fn dense_least_squares(instrument: &Instrument, grid: &Grid, samples: &[Complex32]) -> Vec<Complex32> {
    let count = grid.voxel_count() as usize;
    let columns: Vec<Vec<Complex32>> = (0..count)
        .map(|k| {
            let mut one = vec![Complex32::ZERO; count];
            one[k] = Complex32::ONE;
            literal_echoes(instrument, grid, &one)
        })
        .collect();
    let rows = samples.len();
    // Real and imaginary parts.
    let matrix = Matrix::from_fn(2 * rows, 2 * count, |n, k| {
        let a = columns[k % count][n % rows];
        f64::from(match (n < rows, k < count) {
            (true, true) | (false, false) => a.re,
            (true, false) => -a.im,
            (false, true) => a.im,
        })
    });
    let right = Matrix::from_fn(2 * rows, 1, |n, _| {
        f64::from(if n < rows { samples[n].re } else { samples[n - rows].im })
    });
    let found = LeastSquares::new(&matrix).solve(&right);
    (0..count).map(|k| Complex32::new(found[(k, 0)] as f32, found[(count + k, 0)] as f32)).collect()
}

#[test]
fn conjugate_gradients_find_the_dense_least_squares_and_leave_less_with_every_step() {
    let (instrument, grid) = tiny();
    let samples = random(instrument.sweep.len() * instrument.array.len(), 21);
    let dense = dense_least_squares(&instrument, &grid, &samples);
    let cube = DataCube::new(instrument, samples).unwrap();
    let mut before = 1.0;
    for steps in [1_usize, 2, 3, 5, 8, 60] {
        let by = RefineOptions::new(Solver::Cgls).with_steps(steps).with_noise(Some(0.0));
        let found = reconstruct(&cube, &grid, &options(Window::None).with_refine(by)).unwrap();
        let misfit = found.refinement.unwrap().misfit;
        assert!(misfit <= before * (1.0 + 1e-6), "{steps} steps: {misfit} after {before}");
        before = misfit;
        if steps == 60 {
            let differences: Vec<_> = found.volume.samples.iter().zip(&dense).map(|(a, b)| a - b).collect();
            assert!(norm(&differences) < 1e-4 * norm(&dense), "{:e}", norm(&differences) / norm(&dense));
        }
    }
}

#[test]
fn sparse_amplitudes_meet_the_conditions_of_the_minimum() {
    let (instrument, grid) = tiny();
    let mut truth = vec![Complex32::ZERO; grid.voxel_count() as usize];
    (truth[4], truth[22]) = (Complex32::ONE, Complex32::new(-0.3, 0.6));
    let noise = random(instrument.sweep.len() * instrument.array.len(), 31);
    let echoes = literal_echoes(&instrument, &grid, &truth);
    let samples = echoes.iter().zip(&noise).map(|(m, n)| m + n * 0.3).collect();
    let cube = DataCube::new(instrument.clone(), samples).unwrap();
    let by = RefineOptions::new(Solver::Fista).with_steps(300_usize).with_sparsity(0.1).with_noise(Some(0.0));
    let found = reconstruct(&cube, &grid, &options(Window::None).with_refine(by)).unwrap();
    let sparsity = found.refinement.unwrap().sparsity;
    let largest = reconstruct(&cube, &grid, &options(Window::None).with_refine(None)).unwrap().volume.peak();
    assert!((sparsity - 0.1 * f64::from(largest)).abs() < 1e-4 * sparsity);
    with_operator(&instrument, &grid, &options(Window::None), |operator| {
        let echoes = operator.echo(&found.volume.samples, &Silent).unwrap();
        let mut slope = Volume { grid, samples: Vec::new() };
        operator.image(&mut &cube, Some(&echoes), &mut slope, &Silent).unwrap();
        let mut silent = 0;
        for (a, slope) in found.volume.samples.iter().zip(&slope.samples) {
            if a.norm() > 0.0 {
                // K*(m − KA) = λ A/|A|.
                let expected = a / a.norm() * sparsity as f32;
                assert!((slope - expected).norm() < 1e-3 * sparsity as f32, "{slope} is not {expected}");
            } else {
                silent += 1;
                assert!(slope.norm() <= sparsity as f32 * 1.001);
            }
        }
        assert!(silent > 9, "{silent} of 27 voxels are silent");
    });
}

/// Keeps blocks in memory, always due, and stops after so many flushes.
struct Kept {
    blocks: HashMap<u64, Vec<Complex32>>,
    left: usize,
}

impl BlockStore for Kept {
    fn load(&mut self, k: u64, block: &mut [Complex32]) -> Result<bool> {
        let Some(stored) = self.blocks.get(&k).filter(|stored| stored.len() == block.len()) else {
            return Ok(false);
        };
        block.copy_from_slice(stored);
        Ok(true)
    }

    fn is_due(&mut self) -> bool {
        true
    }

    fn save(&mut self, k: u64, block: &[Complex32]) {
        self.blocks.insert(k, block.to_vec());
    }

    fn flush(&mut self) -> Result<()> {
        self.left = self.left.checked_sub(1).ok_or(crate::error::Error::Interrupted)?;
        Ok(())
    }
}

#[test]
fn a_refinement_that_resumes_or_has_other_threads_gives_the_same_bytes() {
    let array = MicArray::rectangular([6, 5], [0.031; 2], DVec3::ZERO).unwrap();
    let instrument = Instrument::new(sweep(100.0), array);
    let grid = Grid { x: axis(-0.15, 0.03, 11), y: axis(-0.12, 0.03, 9), z: axis(0.6, 0.011, 17) };
    let samples = random(instrument.sweep.len() * instrument.array.len(), 41);
    let cube = DataCube::new(instrument, samples).unwrap();
    for solver in [Solver::Cgls, Solver::Fista] {
        let by = RefineOptions::new(solver).with_steps(5_usize).with_noise(Some(0.0));
        let options = options(Window::None).with_refine(by);
        let whole = reconstruct(&cube, &grid, &options).unwrap();
        assert_eq!(whole.refinement.unwrap().steps, 5);
        for stopped in [0, 1, 3] {
            let mut store = Kept { blocks: HashMap::new(), left: stopped };
            let mut volume = Volume { grid, samples: Vec::new() };
            let first = reconstruct_stored(&mut &cube, &grid, &options, &mut volume, &mut store, &Silent);
            assert!(first.is_err() && volume.samples.is_empty());
            store.left = 9;
            let info = reconstruct_stored(&mut &cube, &grid, &options, &mut volume, &mut store, &Silent);
            assert_eq!((info.unwrap(), &volume), (whole.info(), &whole.volume), "{solver} after {stopped}");
        }
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(pool.install(|| reconstruct(&cube, &grid, &options).unwrap()), whole, "{solver}");
        }
    }
}

#[test]
fn noise_is_measured_and_ends_the_steps() {
    for detection in [Detection::Quadrature, Detection::InPhase] {
        let array = MicArray::rectangular([8, 8], [0.03; 2], DVec3::ZERO).unwrap();
        let instrument = Instrument::new(sweep(20.0), array).with_detection(detection);
        let grid = Grid { x: axis(-0.1, 0.05, 5), y: axis(-0.1, 0.05, 5), z: axis(0.6, 0.02, 11) };
        let echoes = literal_echoes(&instrument, &grid, &random(275, 51));
        let noise = random(echoes.len(), 52);
        // Uniform in −1 .. 1, a part has a variance of 1/3.
        let level = 2.0;
        let noisy = |(m, n): (&Complex32, &Complex32)| match detection {
            Detection::Quadrature => m + n * level,
            Detection::InPhase => Complex32::new(m.re + n.re * level, 0.0),
        };
        let expected =
            f64::from(level) * if detection == Detection::InPhase { 1.0 / 3.0 } else { 2.0 / 3.0f64 }.sqrt();
        let cube = DataCube::new(instrument, echoes.iter().zip(&noise).map(noisy).collect()).unwrap();
        let by = RefineOptions::new(Solver::Cgls).with_steps(40_usize);
        let found = reconstruct(&cube, &grid, &options(Window::None).with_refine(by)).unwrap();
        let refinement = found.refinement.unwrap();
        let measured = refinement.noise.unwrap();
        assert!((measured - expected).abs() < 0.03 * expected, "{detection}: {measured} for {expected}");
        assert!(refinement.down_to_noise && refinement.steps < 40, "{refinement:?}");
        let given = by.with_noise(Some(0.0));
        let on = reconstruct(&cube, &grid, &options(Window::None).with_refine(given)).unwrap();
        assert!(on.refinement.unwrap().steps == 40 && !on.refinement.unwrap().down_to_noise);
    }
}

#[test]
fn nothing_at_all_is_refined_to_nothing() {
    let (instrument, grid) = tiny();
    let count = instrument.sweep.len() * instrument.array.len();
    let cube = DataCube::new(instrument, vec![Complex32::ZERO; count]).unwrap();
    for solver in [Solver::Cgls, Solver::Fista] {
        let options = options(Window::None).with_refine(RefineOptions::new(solver));
        let found = reconstruct(&cube, &grid, &options).unwrap();
        assert!(found.volume.samples.iter().all(|a| *a == Complex32::ZERO), "{solver}");
        assert_eq!(found.refinement.unwrap().misfit, 0.0);
    }
}

#[test]
fn what_cannot_be_refined_is_refused_with_the_reason() {
    let (instrument, grid) = tiny();
    let count = instrument.sweep.len() * instrument.array.len();
    let cube = DataCube::new(instrument.clone(), vec![Complex32::ONE; count]).unwrap();
    let refused = |cube: &DataCube, grid: &Grid, options: &ReconstructOptions| {
        let error = reconstruct(cube, grid, options).unwrap_err();
        assert_eq!(error.exit_status(), 2, "{error}");
        error.to_string()
    };
    let usual = options(Window::None);
    let by = RefineOptions::new(Solver::Fista);
    assert_names(
        refused(&cube, &grid, &usual.with_refine(by.with_steps(0_usize))),
        &["refine.steps", "0", "1 to"],
    );
    assert_names(
        refused(&cube, &grid, &usual.with_refine(by.with_sparsity(1.0))),
        &["refine.sparsity", "1", "below 1"],
    );
    assert_names(
        refused(&cube, &grid, &usual.with_refine(by.with_noise(f64::NAN))),
        &["refine.noise", "NaN"],
    );
    assert_names(refused(&cube, &grid, &usual.with_tolerance(0.0)), &["tolerance of 0", "1e-4"]);
    for method in [Method::Direct, Method::Backprojection, Method::Linear] {
        assert_names(
            refused(&cube, &grid, &usual.with_method(method)),
            &[method.as_str(), "adjoint", "[refine]"],
        );
    }
    let deep: Vec<_> =
        (0..20).map(|i| DVec3::new(0.01 * f64::from(i), 0.0, 0.02 * f64::from(i % 3))).collect();
    let deep = Instrument::new(instrument.sweep, MicArray::from_positions(deep).unwrap());
    let deep = DataCube::new(deep, cube.samples).unwrap();
    assert_names(refused(&deep, &grid, &usual), &["no plane", "[refine]"]);
}
