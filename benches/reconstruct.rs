//! Terms of Eq. 13 (voxels × microphones × frequencies) per second, by method: ratios of rates are ratios of speeds.

#![allow(missing_docs)]

mod job;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use holosonar::acquisition::DataCube;
use holosonar::grid::{Axis, Grid};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, direct_terms, reconstruct};
use job::{displaced, job};

fn reconstruction(c: &mut Criterion) {
    let mut group = c.benchmark_group("reconstruct");
    group.sample_size(10);
    let mut bench = |id: BenchmarkId, (cube, grid): &(DataCube, Grid), method, tolerance| {
        group.throughput(Throughput::Elements(direct_terms(&cube.instrument, grid)));
        let mut options = ReconstructOptions::new(method, Window::None);
        options.tolerance = tolerance;
        group.bench_function(id, |b| b.iter(|| reconstruct(cube, grid, &options).expect("fits")));
    };
    for (method, tolerance, n, frequencies, depths) in [
        (Method::Direct, 0.0, 16, 51, 2),
        (Method::Convolution, 0.0, 16, 51, 2),
        (Method::Convolution, 1e-4, 16, 51, 2),
        // One plane pair of n = 128: all of 101 x 4, and those that remain with skeleton frequencies.
        (Method::Convolution, 0.0, 64, 101, 4),
        (Method::Convolution, 1e-4, 64, 101, 4),
        (Method::Convolution, 1e-4, 64, 1001, 128),
    ] {
        let size = format!("{n}x{n} mics x {frequencies} f x {n}x{n}x{depths} voxels");
        let name = format!("{method:?} {tolerance:e}").to_lowercase();
        bench(BenchmarkId::new(name, size), &job(n, n, frequencies, depths), method, tolerance);
    }
    let (cube, grid) = job(64, 64, 1001, 128);
    let id = BenchmarkId::new("spreading 1e-4", "64x64 mics x 1001 f x 64x64x128 voxels");
    bench(id, &(displaced(&cube, 0.0), grid), Method::Convolution, 1e-4);
    // 64 x 64 microphones, 1001 frequencies, 128 x 128 x 128 voxels; the direct sum on a part of them.
    let lateral = Axis { first: -0.508, pitch: 0.008, count: 128 };
    let whole = Grid { x: lateral, y: lateral, z: Axis { first: 1.0, pitch: 1.0 / 127.0, count: 128 } };
    let every = |axis: Axis, n: usize| Axis { pitch: axis.pitch * (axis.count / n) as f64, count: n, ..axis };
    let part = Grid { x: every(whole.x, 16), y: every(whole.y, 16), z: every(whole.z, 8) };
    let cube = displaced(&cube, 0.025);
    for (name, method, size, grid) in [
        ("direct", Method::Direct, "16x16x8", part),
        ("backprojection 1e-4", Method::Backprojection, "128x128x128", whole),
    ] {
        let size = format!("not planar, 64x64 mics x 1001 f x {size} voxels");
        bench(BenchmarkId::new(name, size), &(cube.clone(), grid), method, 1e-4);
    }
    group.finish();
}

criterion_group!(benches, reconstruction);
criterion_main!(benches);
