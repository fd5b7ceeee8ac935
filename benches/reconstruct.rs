//! Voxels × frequencies per second, by method; the same cube and grid for each.

#![allow(missing_docs)]

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use holosonar::acquisition::{DataCube, MicArray, Sweep};
use holosonar::grid::{Axis, Grid};
use holosonar::progress::Silent;
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use holosonar::wave::phasor;

/// The same cube from microphones up to 2 mm off their lattice.
fn jittered(cube: &DataCube) -> DataCube {
    let off = |i: usize, k: f64| 0.004 * ((i as f64 * k).fract() - 0.5);
    let place = |(i, r): (usize, &DVec3)| *r + DVec3::new(off(i, 0.618_034), off(i, 0.754_878), 0.0);
    let positions: Vec<DVec3> = cube.array.positions().iter().enumerate().map(place).collect();
    let array = MicArray::from_positions("jittered", &[positions.len()], positions).expect("an array");
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
        group.throughput(Throughput::Elements(grid.voxel_count() * frequencies as u64));
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
    group.throughput(Throughput::Elements(grid.voxel_count() * 1001));
    group.bench_function("spreading 1e-4/64x64 mics x 1001 f x 64x64x128 voxels", |b| {
        let options = ReconstructOptions::new(Method::Convolution, Window::None);
        b.iter(|| reconstruct(&cube, &grid, &options, &Silent).expect("small"));
    });
    group.finish();
}

criterion_group!(benches, reconstruction);
criterion_main!(benches);
