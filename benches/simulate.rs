//! Terms of Eq. 5 per second: reflectors × microphones × frequencies.

#![allow(missing_docs)]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use holosonar::acquisition::{MicArray, SimulateOptions, Sweep, simulate};
use holosonar::progress::Silent;
use holosonar::reflectors::Reflectors;
use holosonar::wave::phasor;

fn reflectors(count: usize) -> Reflectors {
    let fraction = |i: usize, k: f64| (i as f64 * k).fract() - 0.5;
    let positions = (0..count)
        .map(|i| DVec3::new(fraction(i, 0.618_034), fraction(i, 0.754_878), 1.5 + fraction(i, 0.569_84)))
        .collect();
    let amplitudes = (0..count).map(|i| phasor(fraction(i, 0.413_59))).collect();
    Reflectors::new(positions, amplitudes).expect("finite")
}

fn simulation(c: &mut Criterion) {
    let mut group = c.benchmark_group("simulate");
    group.sample_size(10);
    let array = MicArray::rectangular("array", [16, 16], [0.016; 2], DVec3::ZERO).expect("an array");
    let reflectors = reflectors(2000);
    for (name, sweep) in [
        ("even steps", Sweep::stepped("sweep", 10_000.0, 20_000.0, 10.0).expect("a sweep")),
        (
            "uneven steps",
            Sweep::from_frequencies(
                "f",
                (0..1001).map(|n| 10_000.0 + 10.0 * f64::from(n) + f64::from(n % 3)).collect(),
            )
            .expect("a sweep"),
        ),
    ] {
        let terms = reflectors.len() * array.len() * sweep.len();
        group.throughput(Throughput::Elements(terms as u64));
        group.bench_function(format!("{name}/2000 reflectors x 256 mics x 1001 f"), |b| {
            b.iter(|| {
                simulate(&reflectors, &sweep, &array, &SimulateOptions::default(), &Silent).expect("small")
            });
        });
    }
    group.finish();
}

criterion_group!(benches, simulation);
criterion_main!(benches);
