//! Terms of Eq. 13 (voxels × microphones × frequencies) per second, by method: ratios of rates are ratios of speeds.

#![allow(missing_docs)]

mod job;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use holosonar::grid::{Axis, Grid};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, direct_terms, reconstruct};
use job::{displaced, job};

fn reconstruction(c: &mut Criterion) {
    let mut group = c.benchmark_group("reconstruct");
    group.sample_size(10);
    for (method, tolerance, n, frequencies, depths) in [
        (Method::Direct, 0.0, 16, 51, 2),
        (Method::Convolution, 0.0, 16, 51, 2),
        (Method::Convolution, 1e-4, 16, 51, 2),
        // One plane pair of n = 128: all of 101 x 4, and those that remain with skeleton frequencies.
        (Method::Convolution, 0.0, 64, 101, 4),
        (Method::Convolution, 1e-4, 64, 101, 4),
        (Method::Convolution, 1e-4, 64, 1001, 128),
    ] {
        let (cube, grid) = job(n, n, frequencies, depths);
        group.throughput(Throughput::Elements(direct_terms(&cube.instrument, &grid)));
        let size = format!("{n}x{n} mics x {frequencies} f x {n}x{n}x{depths} voxels");
        let name = format!("{method:?} {tolerance:e}").to_lowercase();
        group.bench_with_input(BenchmarkId::new(name, size), &method, |b, &method| {
            let mut options = ReconstructOptions::new(method, Window::None);
            options.tolerance = tolerance;
            b.iter(|| reconstruct(&cube, &grid, &options).expect("small"));
        });
    }
    let (cube, grid) = job(64, 64, 1001, 128);
    let cube = displaced(&cube, 0.0);
    group.throughput(Throughput::Elements(direct_terms(&cube.instrument, &grid)));
    group.bench_function("spreading 1e-4/64x64 mics x 1001 f x 64x64x128 voxels", |b| {
        let options = ReconstructOptions::new(Method::Convolution, Window::None);
        b.iter(|| reconstruct(&cube, &grid, &options).expect("small"));
    });
    // 64 x 64 microphones, 1001 frequencies, 128 x 128 x 128 voxels; the direct sum on a part of them.
    let lateral = Axis { first: -0.508, pitch: 0.008, count: 128 };
    let whole = Grid { x: lateral, y: lateral, z: Axis { first: 1.0, pitch: 1.0 / 127.0, count: 128 } };
    let every = |axis: Axis, n: usize| Axis { pitch: axis.pitch * (axis.count / n) as f64, count: n, ..axis };
    let part = Grid { x: every(whole.x, 16), y: every(whole.y, 16), z: every(whole.z, 8) };
    let (cube, _) = job(64, 64, 1001, 1);
    let cube = displaced(&cube, 0.025);
    for (name, method, grid) in [
        ("direct/not planar, 64x64 mics x 1001 f x 16x16x8 voxels", Method::Direct, part),
        (
            "backprojection 1e-4/not planar, 64x64 mics x 1001 f x 128x128x128 voxels",
            Method::Backprojection,
            whole,
        ),
    ] {
        group.throughput(Throughput::Elements(direct_terms(&cube.instrument, &grid)));
        group.bench_function(name, |b| {
            let options = ReconstructOptions::new(method, Window::None);
            b.iter(|| reconstruct(&cube, &grid, &options).expect("fits"));
        });
    }
    group.finish();
}

criterion_group!(benches, reconstruction);
criterion_main!(benches);
