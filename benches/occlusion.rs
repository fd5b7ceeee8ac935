//! Rays per second through the BVH: what decides how long reflectors take.

#![allow(missing_docs)]

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use holosonar::scene::{Material, Scene, Triangle};
use rayon::prelude::*;
use std::hint::black_box;

/// A wavy sheet of 2·n² triangles, 2 m wide at depth 2 m.
fn sheet(n: usize, transmittance: f64) -> Scene {
    let point = |i: usize, j: usize| {
        let (x, y) = (2.0 * i as f64 / n as f64 - 1.0, 2.0 * j as f64 / n as f64 - 1.0);
        DVec3::new(x, y, 2.0 + 0.1 * (9.0 * x).sin() * (7.0 * y).cos())
    };
    let triangles = (0..n * n)
        .flat_map(|k| {
            let (i, j) = (k % n, k / n);
            let [a, b, c, d] = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
            [[a, b, c], [a, c, d]].map(|vertices| Triangle { vertices, material: 0 })
        })
        .collect();
    let material =
        Material { name: String::new(), reflectance: 1.0, transmittance, source: "bench".to_owned() };
    Scene::new(triangles, vec![material]).expect("finite triangles")
}

fn occlusion(c: &mut Criterion) {
    const RAYS: usize = 20_000;
    let mut group = c.benchmark_group("occlusion");
    group.throughput(Throughput::Elements(RAYS as u64)).sample_size(10);
    for (n, name) in [(224, "100k triangles"), (708, "1M triangles")] {
        let scene = sheet(n, 0.5);
        let fraction = |i: usize, k: f64| (i as f64 * k).fract() - 0.5;
        let target =
            |i: usize, z: f64| DVec3::new(2.0 * fraction(i, 0.618_034), 2.0 * fraction(i, 0.754_878), z);
        // A free path, as most reflectors have; and one through the sheet, as a clear scene asks.
        for (kind, z) in [("short of the surface", 1.85), ("through to 3 m", 3.0)] {
            group.bench_with_input(BenchmarkId::new(kind, name), &z, |b, &z| {
                b.iter(|| {
                    (0..RAYS)
                        .into_par_iter()
                        .map(|i| scene.transmittance(DVec3::ZERO, target(i, z)))
                        .sum::<f64>()
                });
            });
        }
    }
    group.bench_function("build/100k triangles", |b| b.iter(|| black_box(sheet(224, 0.5)).triangles().len()));
    group.finish();
}

criterion_group!(benches, occlusion);
criterion_main!(benches);
