//! Back-projection against the literal sum, on arrays that need not be planar.

use crate::support::{Random, assert_within_bounds, direct, random_cube, relative_difference};
use glam::DVec3;
use holosonar::acquisition::{DataCube, Detection, Instrument, MicArray, SimulateOptions, Sweep, simulate};
use holosonar::grid::{Axis, Grid};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use holosonar::reflectors::Reflectors;
use holosonar::wave::Geometry;
use num_complex::Complex32;

/// Frequencies with even or uneven steps, few or one.
fn random_sweep(random: &mut Random) -> Sweep {
    let (start, step) = (random.uniform(2_000.0, 15_000.0), random.uniform(20.0, 200.0));
    match random.whole(0, 3) {
        0 => Sweep::from_frequencies(vec![start]).unwrap(),
        1 => {
            let uneven = (0..40).map(|n| start + step * (f64::from(n) + random.uniform(0.0, 0.9))).collect();
            Sweep::from_frequencies(uneven).unwrap()
        }
        _ => Sweep::stepped(start, start + 60.0 * step, step).unwrap(),
    }
}

/// Microphones in a volume, in a plane at any place, or on a line.
fn random_array(random: &mut Random) -> MicArray {
    let extent = [random.uniform(0.0, 0.6), random.uniform(0.0, 0.6), random.uniform(0.0, 0.3)];
    let flat = random.whole(0, 3);
    let count = random.whole(1, 70);
    let positions = (0..count)
        .map(|_| {
            let place = extent.map(|e| random.uniform(-e, e));
            DVec3::new(
                place[0],
                if flat == 1 { 0.1 } else { place[1] },
                if flat > 1 { 0.0 } else { place[2] },
            )
        })
        .collect();
    MicArray::from_positions(positions).unwrap()
}

/// A grid of any pitch and size, down to the microphones' own plane.
fn random_grid(random: &mut Random, pitch: f64) -> Grid {
    let mut axis = |low: f64, high: f64, most: usize| {
        let count = random.whole(1, most);
        Axis { first: random.uniform(low, high), pitch: pitch * random.uniform(0.7, 1.5), count }
    };
    Grid { x: axis(-0.6, 0.4, 23), y: axis(-0.5, 0.5, 11), z: axis(0.0, 1.0, 9) }
}

fn random_case(seed: u64) -> (DataCube, Grid, Window) {
    let mut random = Random::new(seed);
    let (sweep, array) = (random_sweep(&mut random), random_array(&mut random));
    let source = DVec3::new(random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6), random.uniform(-0.3, 0.3));
    let geometry =
        if seed.is_multiple_of(3) { Geometry::Monostatic } else { Geometry::FixedSource { source } };
    let detection = if seed.is_multiple_of(4) { Detection::InPhase } else { Detection::Quadrature };
    let pitch = [0.002, 0.008, 0.03][seed as usize % 3];
    let mut grid = random_grid(&mut random, pitch);
    if seed.is_multiple_of(5) {
        // A voxel on a microphone.
        let r = array.positions()[array.len() / 2];
        (grid.x.first, grid.y.first, grid.z.first) = (r.x, r.y, r.z.max(0.0));
    }
    let cube = random_cube(&mut random, sweep, array, geometry, detection);
    (cube, grid, [Window::None, Window::Hann, Window::Taylor][seed as usize % 3])
}

#[test]
fn backprojection_keeps_its_bound_on_any_array_and_grid() {
    for seed in 0..60 {
        let (cube, grid, window) = random_case(seed);
        let options = ReconstructOptions::new(Method::Backprojection, window);
        assert_within_bounds(seed, &cube, &grid, &options, &[1e-2, 1e-4, 1e-6]);
    }
}

/// Voxels so close together that most are interpolated, along both axes or one, against the literal sum.
#[test]
fn voxels_between_nodes_keep_the_bound() {
    for seed in 0..4 {
        let mut random = Random::new(900 + seed);
        let positions = (0..420)
            .map(|_| {
                DVec3::new(random.uniform(-0.2, 0.2), random.uniform(-0.2, 0.2), random.uniform(-0.1, 0.0))
            })
            .collect();
        let array = MicArray::from_positions(positions).unwrap();
        let sweep = match seed {
            0 => Sweep::from_frequencies(vec![17_000.0]).unwrap(),
            1 => {
                let uneven = (0..30).map(|n| 9_000.0 + 200.0 * (f64::from(n) + random.uniform(0.0, 0.9)));
                Sweep::from_frequencies(uneven.collect()).unwrap()
            }
            _ => Sweep::stepped(10_000.0, 16_000.0, 100.0).unwrap(),
        };
        let source = DVec3::new(0.1, -0.2, -0.1);
        let geometry = if seed == 2 { Geometry::Monostatic } else { Geometry::FixedSource { source } };
        let cube = random_cube(&mut random, sweep, array, geometry, Detection::Quadrature);
        let axis = |first: f64, pitch: f64, count: usize| Axis { first, pitch, count };
        let y = if seed == 3 { axis(0.0, 0.05, 40) } else { axis(-0.1, 0.004, 91) };
        let grid = Grid { x: axis(-0.2, 0.003, 110), y, z: axis(0.6, 0.02, 7) };
        let options = ReconstructOptions::new(Method::Backprojection, Window::None);
        assert_within_bounds(seed, &cube, &grid, &options, &[1e-2, 1e-4, 1e-6]);
    }
}

/// Blocks of several slabs, and groups of microphones in several sums.
#[test]
fn threads_do_not_change_the_bytes_of_a_larger_image() {
    let mut random = Random::new(77);
    let positions = (0..700)
        .map(|_| DVec3::new(random.uniform(-0.3, 0.3), random.uniform(-0.3, 0.3), random.uniform(-0.2, 0.0)))
        .collect();
    let array = MicArray::from_positions(positions).unwrap();
    let sweep = Sweep::stepped(10_000.0, 20_000.0, 100.0).unwrap();
    let cube = random_cube(&mut random, sweep, array, Geometry::ORIGIN, Detection::Quadrature);
    let axis = |first: f64, count: usize| Axis { first, pitch: 0.011, count };
    let grid = Grid { x: axis(-0.1, 21), y: axis(-0.1, 13), z: axis(0.5, 40) };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let options = ReconstructOptions::new(Method::Backprojection, Window::None);
        pool.install(|| reconstruct(&cube, &grid, &options).unwrap())
    };
    let (one, five) = (run(1), run(5));
    assert_eq!(one, five);
    // A part of it against the literal sum.
    let part = Grid { z: Axis { first: grid.z.position(17), ..axis(0.0, 3) }, ..grid };
    let plane = grid.plane_len();
    let error =
        relative_difference(&one.volume.samples[17 * plane..20 * plane], &direct(&cube, &part, Window::None));
    assert!(error < 1e-4, "{error:e}");
}

/// Job S: 64 × 64 microphones that are not in a plane, 1001 frequencies, 128³ voxels, a dozen reflectors; 128 voxels of it
/// against the literal sum.
#[test]
#[ignore = "half a minute in a release build"]
fn a_large_job_errs_by_less_than_a_ten_thousandth_of_its_peak() {
    let mut random = Random::new(4);
    let mut place = |x: f64, y: f64, z: [f64; 2]| {
        DVec3::new(random.uniform(-x, x), random.uniform(-y, y), random.uniform(z[0], z[1]))
    };
    let positions: Vec<DVec3> = (0..64 * 64).map(|_| place(0.25, 0.25, [-0.05, 0.0])).collect();
    let array = MicArray::from_positions(positions).unwrap();
    let sweep = Sweep::stepped(10_000.0, 20_000.0, 10.0).unwrap();
    let points: Vec<DVec3> = (0..12).map(|_| place(0.45, 0.45, [1.1, 1.9])).collect();
    let reflectors = Reflectors::new(points, vec![Complex32::ONE; 12]).unwrap();
    let cube = simulate(&reflectors, &Instrument::new(sweep, array), &SimulateOptions::default()).unwrap();
    let axis = |first: f64| Axis { first, pitch: 0.008, count: 128 };
    let grid = Grid { x: axis(-0.508), y: axis(-0.508), z: axis(1.0) };
    let options = ReconstructOptions::new(Method::Backprojection, Window::None);
    let volume = reconstruct(&cube, &grid, &options).unwrap().volume;
    let mut worst = 0.0f32;
    for _ in 0..128 {
        let at = [random.whole(0, 127), random.whole(0, 127), random.whole(0, 127)];
        let one = |axis: Axis, i: usize| Axis { first: axis.position(i), count: 1, ..axis };
        let voxel = Grid { x: one(grid.x, at[0]), y: one(grid.y, at[1]), z: one(grid.z, at[2]) };
        let exact = direct(&cube, &voxel, Window::None)[0];
        worst = worst.max((volume.samples[(at[2] * 128 + at[1]) * 128 + at[0]] - exact).norm());
    }
    println!("{:.1e} of the peak", worst / volume.peak());
    assert!(worst < 1e-4 * volume.peak());
}
