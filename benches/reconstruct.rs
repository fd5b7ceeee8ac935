//! Terms of Eq. 13 (voxels × microphones × frequencies) per second, by method: their ratios are those of the times.

#![allow(missing_docs)]

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use holosonar::acquisition::{DataCube, MicArray, Sweep};
use holosonar::grid::{Axis, Grid};
use holosonar::progress::Silent;
use holosonar::reconstruct::{Method, ReconstructOptions, Window, direct_terms, reconstruct};
use holosonar::wave::phasor;

/// The same cube from microphones up to 2 mm off their lattice.
fn jittered(cube: &DataCube) -> DataCube {
    let off = |i: usize, k: f64| 0.004 * ((i as f64 * k).fract() - 0.5);
    let place = |(i, r): (usize, &DVec3)| *r + DVec3::new(off(i, 0.618_034), off(i, 0.754_878), 0.0);
    let positions: Vec<DVec3> = cube.array.positions().iter().enumerate().map(place).collect();
    let array = MicArray::from_positions("jittered", &[positions.len()], positions).expect("an array");
    DataCube::new(cube.sweep.clone(), array, cube.samples.clone()).expect("finite")
}

/// The same cube from microphones that lie in no plane: up to 2 mm off their lattice, and within 5 cm of depth.
fn bent(cube: &DataCube) -> DataCube {
    let off = |i: usize, k: f64| (i as f64 * k).fract() - 0.5;
    let place = |(i, r): (usize, &DVec3)| {
        *r + DVec3::new(0.004 * off(i, 0.618_034), 0.004 * off(i, 0.754_878), 0.05 * off(i, 0.569_84))
    };
    let positions: Vec<DVec3> = cube.array.positions().iter().enumerate().map(place).collect();
    let array = MicArray::from_positions("bent", &[positions.len()], positions).expect("an array");
    DataCube::new(cube.sweep.clone(), array, cube.samples.clone()).expect("finite")
}

/// n² microphones 8 mm apart, and n² voxels of the same pitch at `depths` depths from 1 m on.
fn job(n: usize, frequencies: usize, depths: usize) -> (DataCube, Grid) {
    let array = MicArray::rectangular("array", [n, n], [0.008; 2], DVec3::ZERO).expect("an array");
    let step = 10_000.0 / (frequencies - 1) as f64;
    let sweep = Sweep::stepped("sweep", 10_000.0, 20_000.0, step).expect("a sweep");
    let samples = (0..sweep.len() * array.len()).map(|i| phasor((i as f64 * 0.618_034).fract())).collect();
    let lateral = Axis { first: -0.004 * (n - 1) as f64, pitch: 0.008, count: n };
    let grid = Grid { x: lateral, y: lateral, z: Axis { first: 1.0, pitch: 0.008, count: depths } };
    (DataCube::new(sweep, array, samples).expect("finite"), grid)
}

fn reconstruction(c: &mut Criterion) {
    let mut group = c.benchmark_group("reconstruct");
    group.sample_size(10);
    for (method, tolerance, n, frequencies, depths) in [
        (Method::Direct, 0.0, 16, 51, 2),
        (Method::Convolution, 0.0, 16, 51, 2),
        (Method::Convolution, 1e-4, 16, 51, 2),
        // One plane pair of n = 128: all of 101 x 4, and what skeletons leave of them.
        (Method::Convolution, 0.0, 64, 101, 4),
        (Method::Convolution, 1e-4, 64, 101, 4),
        (Method::Convolution, 1e-4, 64, 1001, 128),
    ] {
        let (cube, grid) = job(n, frequencies, depths);
        group.throughput(Throughput::Elements(direct_terms(&cube.setup(), &grid)));
        let size = format!("{n}x{n} mics x {frequencies} f x {n}x{n}x{depths} voxels");
        let name = format!("{method:?} {tolerance:e}").to_lowercase();
        group.bench_with_input(BenchmarkId::new(name, size), &method, |b, &method| {
            let mut options = ReconstructOptions::new(method, Window::None);
            options.tolerance = tolerance;
            b.iter(|| reconstruct(&cube, &grid, &options, &Silent).expect("small"));
        });
    }
    let (cube, grid) = job(64, 1001, 128);
    let cube = jittered(&cube);
    group.throughput(Throughput::Elements(direct_terms(&cube.setup(), &grid)));
    group.bench_function("spreading 1e-4/64x64 mics x 1001 f x 64x64x128 voxels", |b| {
        let options = ReconstructOptions::new(Method::Convolution, Window::None);
        b.iter(|| reconstruct(&cube, &grid, &options, &Silent).expect("small"));
    });
    // S: 64 x 64 microphones, 1001 frequencies, 128 x 128 x 128 voxels; of the literal sum only a part.
    let lateral = Axis { first: -0.508, pitch: 0.008, count: 128 };
    let whole = Grid { x: lateral, y: lateral, z: Axis { first: 1.0, pitch: 1.0 / 127.0, count: 128 } };
    let every = |axis: Axis, n: usize| Axis { pitch: axis.pitch * (axis.count / n) as f64, count: n, ..axis };
    let part = Grid { x: every(whole.x, 16), y: every(whole.y, 16), z: every(whole.z, 8) };
    let (cube, _) = job(64, 1001, 1);
    let cube = bent(&cube);
    for (name, method, grid) in [
        ("direct/not planar, 64x64 mics x 1001 f x 16x16x8 voxels", Method::Direct, part),
        (
            "backprojection 1e-4/not planar, 64x64 mics x 1001 f x 128x128x128 voxels",
            Method::Backprojection,
            whole,
        ),
    ] {
        group.throughput(Throughput::Elements(direct_terms(&cube.setup(), &grid)));
        group.bench_function(name, |b| {
            let options = ReconstructOptions::new(method, Window::None);
            b.iter(|| reconstruct(&cube, &grid, &options, &Silent).expect("fits"));
        });
    }
    group.finish();
}

criterion_group!(benches, reconstruction);
criterion_main!(benches);
