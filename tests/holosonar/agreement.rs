//! Fast against literal, forward against inverse.

use crate::named::{Warnings, assert_names};
use crate::support::{
    Random, assert_within_bounds, direct, lattice_grid, literal, peak, position_of, random_cube,
    relative_difference,
};
use glam::DVec3;
use holosonar::acquisition::{DataCube, Detection, Instrument, MicArray, SimulateOptions, Sweep, simulate};
use holosonar::grid::{Axis, Grid};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct, reconstruct_with};
use holosonar::reflectors::Reflectors;
use holosonar::wave::Geometry;
use num_complex::Complex32;

/// A random measurement and a grid that fits its lattice; sizes are odd as often as even.
pub(crate) fn random_case(seed: u64) -> (DataCube, Grid, Window) {
    let mut random = Random::new(seed);
    let count = [random.whole(1, 12), random.whole(1, 12)];
    let pitch = [random.uniform(0.006, 0.03), random.uniform(0.006, 0.03)];
    let centre =
        DVec3::new(random.uniform(-0.1, 0.1), random.uniform(-0.1, 0.1), random.uniform(-0.05, 0.05));
    let array = MicArray::rectangular(count, pitch, centre).unwrap();
    let step = random.uniform(20.0, 300.0);
    let start = random.uniform(2_000.0, 15_000.0);
    let sweep = Sweep::stepped(start, start + 20.0 * step, step).unwrap();
    let source = DVec3::new(random.uniform(-0.2, 0.2), random.uniform(-0.2, 0.2), random.uniform(-0.1, 0.1));
    let geometry = match seed % 6 {
        0 | 3 => Geometry::Monostatic,
        5 => Geometry::Pair { offset: source },
        _ => Geometry::FixedSource { source },
    };
    let detection = if seed.is_multiple_of(4) { Detection::InPhase } else { Detection::Quadrature };
    let u = [random.whole(1, 3), random.whole(1, 3)];
    let shape = [random.whole(1, 19), random.whole(1, 19), random.whole(1, 4)];
    let grid = lattice_grid(&mut random, &array, u, shape);
    let cube = random_cube(&mut random, sweep, array, geometry, detection);
    let window = [Window::None, Window::Hann, Window::Taylor][seed as usize % 3];
    (cube, grid, window)
}

#[test]
fn direct_is_the_literal_sum() {
    for seed in 0..12 {
        let (cube, grid, window) = random_case(seed);
        let options = ReconstructOptions::new(Method::Direct, window);
        let got = reconstruct(&cube, &grid, &options).unwrap().volume;
        let voxels: Vec<usize> = (0..got.samples.len()).step_by(7).collect();
        let expected = literal(&cube, &grid, window, Geometry::path_length, voxels.iter().copied());
        let got_there: Vec<Complex32> = voxels.iter().map(|v| got.samples[*v]).collect();
        let scale = peak(&expected) / f64::from(got.peak());
        let error = relative_difference(&got_there, &expected) * scale;
        assert!(error < 2e-6, "seed {seed}: {error:e}");
    }
}

/// The volume by convolution with a tolerance, and its bound.
fn convolve(cube: &DataCube, grid: &Grid, window: Window, tolerance: f64) -> (Vec<Complex32>, f64) {
    let options = ReconstructOptions::new(Method::Convolution, window).with_tolerance(tolerance);
    let image = reconstruct(cube, grid, &options).unwrap();
    (image.volume.samples, image.error_bound)
}

#[test]
fn convolution_is_direct_on_random_lattices() {
    for seed in 0..60 {
        let (cube, grid, window) = random_case(seed);
        let (volume, bound) = convolve(&cube, &grid, window, 0.0);
        let error = relative_difference(&volume, &direct(&cube, &grid, window));
        assert!(error < 1e-5, "seed {seed} {:?}: {error:e}", grid.shape());
        assert!(bound == 0.0, "nothing is left out");
    }
}

/// Kernels that are even about a lag, about the middle of two, or about neither, along either axis and for every kind of
/// sublattice: a few microphones beside, before and far from few voxels, one row of either, and a scan.
#[test]
fn convolution_is_direct_wherever_the_voxels_lie_on_the_lattice() {
    let mut random = Random::new(11);
    for (case, [mics, voxels]) in
        [[[9, 8], [13, 10]], [[12, 1], [17, 1]], [[1, 21], [2, 40]], [[40, 3], [1, 3]], [[6, 25], [30, 1]]]
            .into_iter()
            .cycle()
            .take(60)
            .enumerate()
    {
        let pitch = [0.011, 0.014];
        let array = MicArray::rectangular(mics, pitch, DVec3::new(0.07, -0.03, 0.01)).unwrap();
        let sweep = Sweep::stepped(9_000.0, 9_000.0 + 100.0 * 17.0, 100.0).unwrap();
        let geometry = if case % 3 == 0 { Geometry::Monostatic } else { Geometry::ORIGIN };
        let cube = random_cube(&mut random, sweep, array, geometry, Detection::Quadrature);
        let u = [random.whole(1, 2), random.whole(1, 2)];
        let v = [random.whole(1, 2), random.whole(1, 2)];
        let mut grid = lattice_grid(&mut random, &cube.instrument.array, u, [voxels[0], voxels[1], 2]);
        let lattice = cube.instrument.array.lattice().unwrap();
        // In quarters of a pitch, from overlapping to far aside.
        let mut first = |mics: &Axis| mics.first + mics.pitch * (random.whole(0, 60) as f64 / 4.0 - 10.0);
        (grid.x.first, grid.y.first) = (first(&lattice.x), first(&lattice.y));
        for (axis, v) in [&mut grid.x, &mut grid.y].into_iter().zip(v) {
            axis.pitch *= v as f64;
        }
        for window in [Window::None, Window::Hann] {
            let (volume, _) = convolve(&cube, &grid, window, 0.0);
            let error = relative_difference(&volume, &direct(&cube, &grid, window));
            assert!(error < 1e-5, "case {case} {:?}: {error:e}", grid.shape());
        }
    }
}

#[test]
fn skeletons_keep_their_bound_on_random_lattices() {
    for seed in 0..40 {
        let (cube, grid, window) = random_case(seed);
        let options = ReconstructOptions::new(Method::Convolution, window);
        assert_within_bounds(seed, &cube, &grid, &options, &[1e-2, 1e-4, 1e-6]);
    }
}

/// Microphones anywhere in a plane, and voxels of any pitch.
#[test]
fn spreading_keeps_its_bound_for_scattered_arrays_and_any_pitch() {
    for seed in 0..40 {
        let (cube, mut grid, window) = random_case(seed);
        let mut random = Random::new(seed + 500);
        grid.x.pitch *= random.uniform(0.6, 2.7);
        grid.y.pitch *= random.uniform(0.6, 2.7);
        let z = cube.instrument.array.positions()[0].z;
        let scattered = if seed.is_multiple_of(2) {
            let place = |r: &DVec3| {
                DVec3::new(r.x + random.uniform(-0.01, 0.01), r.y + random.uniform(-0.01, 0.01), z)
            };
            let positions: Vec<DVec3> = cube.instrument.array.positions().iter().map(place).collect();
            MicArray::from_positions(positions).unwrap()
        } else {
            cube.instrument.array.clone()
        };
        let instrument = cube.instrument.clone().with_array(scattered);
        let moved = DataCube::new(instrument, cube.samples.clone()).unwrap();
        let options = ReconstructOptions::new(Method::Convolution, window);
        assert_within_bounds(seed, &moved, &grid, &options, &[1e-2, 1e-4]);
    }
}

/// Kernels of voxels within a wave of the array bend too sharply to be spread. A sample alone shows them as they are: those
/// of many microphones hide each other's errors.
#[test]
fn depths_at_the_array_keep_the_bound_too() {
    let mut random = Random::new(23);
    for (count, spread) in [(24, 0.1), (17, 0.0)] {
        for (seed, above) in [0.0, 0.004, 0.07, 0.1].into_iter().enumerate() {
            let mut place = |at: f64| at + random.uniform(-0.12, 0.12);
            let positions = (0..count)
                .map(|_| DVec3::new(place(0.0), if spread > 0.0 { place(0.0) } else { 0.0 }, above));
            let array = MicArray::from_positions(positions.collect()).unwrap();
            let sweep = Sweep::stepped(10_000.0, 20_000.0, 500.0).unwrap();
            let axis = |pitch: f64, count: usize| Axis { first: -0.1, pitch, count };
            let rows = if spread > 0.0 { 9 } else { 1 };
            let y = if rows == 1 { Axis { first: 0.0, pitch: 0.01, count: 1 } } else { axis(0.023, rows) };
            let grid = Grid { x: axis(0.017, 13), y, z: Axis { first: 0.0, pitch: 0.01, count: 16 } };
            let geometry = if seed % 2 == 0 { Geometry::ORIGIN } else { Geometry::Monostatic };
            let mut cube = random_cube(&mut random, sweep, array, geometry, Detection::Quadrature);
            let options = |window| ReconstructOptions::new(Method::Convolution, window);
            assert_within_bounds(seed as u64, &cube, &grid, &options(Window::Hann), &[1e-4]);
            let kept = random.whole(0, cube.samples.len() - 1);
            let alone = cube.samples[kept];
            cube.samples.fill(Complex32::ZERO);
            cube.samples[kept] = alone;
            let tolerances = [1e-2, 1e-4, 1e-6];
            assert_within_bounds(seed as u64, &cube, &grid, &options(Window::None), &tolerances);
        }
    }
}

/// `Re⟨K a, m⟩ = Re⟨a, K* m⟩` with `K* = reconstruction · n_f · n_r / w`, reflectors on every voxel.
#[test]
fn forward_and_inverse_are_adjoint() {
    for seed in 0..24 {
        let (cube, grid, _) = random_case(seed);
        let mut random = Random::new(seed + 1000);
        let positions: Vec<DVec3> = (0..grid.voxel_count() as usize).map(|v| position_of(&grid, v)).collect();
        let a: Vec<Complex32> = positions.iter().map(|_| random.complex()).collect();
        let reflectors = Reflectors::new(positions, a.clone()).unwrap();
        let ka = simulate(&reflectors, &cube.instrument, &SimulateOptions::default()).unwrap();
        let dot = |x: &[Complex32], y: &[Complex32]| -> f64 {
            x.iter()
                .zip(y)
                .map(|(x, y)| f64::from(x.re) * f64::from(y.re) + f64::from(x.im) * f64::from(y.im))
                .sum()
        };
        let norm = |x: &[Complex32]| dot(x, x).sqrt();
        for method in [Method::Direct, Method::Convolution, Method::Backprojection] {
            let options = ReconstructOptions::new(method, Window::None);
            let volume = reconstruct(&cube, &grid, &options).unwrap().volume;
            let scale = (cube.instrument.sweep.len() * cube.instrument.array.len()) as f64
                / cube.instrument.detection.weight();
            let (left, right) = (dot(&ka.samples, &cube.samples), dot(&a, &volume.samples) * scale);
            let error = (left - right).abs() / (norm(&ka.samples) * norm(&cube.samples));
            assert!(error < 1e-5, "seed {seed} {method:?}: {left} against {right}");
        }
    }
}

#[test]
fn threads_do_not_change_the_bytes_of_a_volume() {
    let (cube, grid, window) = random_case(7);
    for method in [Method::Direct, Method::Convolution, Method::Backprojection] {
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let options = ReconstructOptions::new(method, window);
            pool.install(|| reconstruct(&cube, &grid, &options).unwrap().volume.samples)
        };
        assert_eq!(run(1), run(5));
    }
}

/// The cube with one microphone moved out of the plane.
fn bent(cube: &DataCube) -> DataCube {
    let mut positions = cube.instrument.array.positions().to_vec();
    positions[3].z += 0.01;
    let array = MicArray::from_positions(positions).unwrap();
    DataCube::new(Instrument::new(cube.instrument.sweep.clone(), array), cube.samples.clone()).unwrap()
}

#[test]
fn what_has_no_lattice_is_projected_back() {
    let (cube, mut grid, _) = random_case(5);
    let bent = bent(&cube);
    (grid.x.pitch, grid.y.pitch) = (0.01, 0.01);
    (grid.x.count, grid.y.count) = (40, 40);
    let warnings = Warnings::default();
    let image = reconstruct_with(&bent, &grid, &ReconstructOptions::default(), &warnings).unwrap();
    assert_eq!(image.method, Method::Backprojection);
    assert!(warnings.list().is_empty(), "nothing slow about it");
    let by_name = ReconstructOptions::new(Method::Convolution, Window::None);
    let error = reconstruct(&bent, &grid, &by_name).unwrap_err().to_string();
    assert_names(error, &["plane", "\"backprojection\""]);
    // For a single frequency and few voxels the direct sum is cheaper than range profiles.
    (grid.x.count, grid.y.count) = (12, 12);
    let tone = Sweep::from_frequencies(vec![9_000.0]).unwrap();
    let samples = bent.samples[..bent.instrument.array.len()].to_vec();
    let one = DataCube::new(bent.instrument.clone().with_sweep(tone), samples).unwrap();
    let image = reconstruct_with(&one, &grid, &ReconstructOptions::default(), &warnings).unwrap();
    assert_eq!(image.method, Method::Direct);
    assert!(warnings.list().is_empty(), "nothing slow about it");
}

#[test]
fn without_a_tolerance_what_has_no_lattice_goes_to_direct_with_a_warning_or_is_refused() {
    let (cube, mut grid, _) = random_case(5);
    let bent = bent(&cube);
    let exact = ReconstructOptions::default().with_tolerance(0.0);
    let warnings = Warnings::default();
    assert_eq!(reconstruct_with(&bent, &grid, &exact, &warnings).unwrap().method, Method::Direct);
    assert_names(&warnings.list()[0], &["plane"]);
    let profiles = ReconstructOptions::new(Method::Backprojection, Window::None).with_tolerance(0.0);
    let error = reconstruct(&cube, &grid, &profiles).unwrap_err().to_string();
    assert_names(error, &["tolerance", "0", "method = \"direct\""]);
    // Nothing may be spread either.
    grid.x.pitch *= 1.01;
    assert_eq!(reconstruct_with(&cube, &grid, &exact, &warnings).unwrap().method, Method::Direct);
    assert_names(&warnings.list()[1], &["pitch", "x"]);
    (grid.x.count, grid.y.count, grid.z.count) = (1 << 13, 1 << 13, 1 << 10);
    let error = reconstruct(&bent, &grid, &exact).unwrap_err().to_string();
    assert_names(error, &["method = \"direct\""]);
}

/// A few microphones far apart would need millions of nodes; back-projection is cheaper.
#[test]
fn microphones_far_apart_are_not_spread() {
    let (_, mut grid, _) = random_case(3);
    (grid.x.count, grid.y.count) = (9, 9);
    let positions = [[-400.0, 3.0, 0.0], [1.0, -500.0, 0.0], [700.0, 650.0, 0.0]].map(DVec3::from);
    let array = MicArray::from_positions(positions.to_vec()).unwrap();
    let sweep = Sweep::stepped(10_000.0, 10_100.0, 0.1).unwrap();
    let cube = random_cube(&mut Random::new(1), sweep, array, Geometry::ORIGIN, Detection::Quadrature);
    let image = reconstruct(&cube, &grid, &ReconstructOptions::default()).unwrap();
    assert_ne!(image.method, Method::Convolution);
    let by_name = ReconstructOptions::new(Method::Backprojection, Window::Taylor);
    let image = reconstruct(&cube, &grid, &by_name).unwrap();
    let error = relative_difference(&image.volume.samples, &direct(&cube, &grid, Window::Taylor));
    let peak = f64::from(image.volume.peak());
    assert!(error <= image.error_bound / peak + 1e-5, "{error:e}");
    let by_name = ReconstructOptions::new(Method::Convolution, Window::None);
    let error = reconstruct(&cube, &grid, &by_name).unwrap_err().to_string();
    assert_names(error, &["lattice"]);
}
