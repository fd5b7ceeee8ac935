//! Terms of Eq. 5 per second (reflectors × microphones × frequencies), summed one by one or by virtual tones.
//!
//! In the group `simulate`, "literal" and "virtual tones" count the same terms, so the ratio of their rates is the gain
//! of virtual tones. The errors of the large job and of the one of picture size must be below 10⁻⁵ of the largest sample.
//!
//! In "cells" a million reflectors of the three plates of a corner are recorded by 63 × 63 microphones on 2 m.

#![allow(missing_docs)]

mod job;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use holosonar::acquisition::{DataCube, Instrument, MicArray, SimulateOptions, Sweep, simulate};
use holosonar::reflectors::Reflectors;
use job::{fraction, scattered};
use num_complex::Complex32;
use std::f32::consts::TAU;

fn reflectors(count: usize) -> Reflectors {
    let positions = (0..count).map(|i| scattered(i) + 1.5 * DVec3::Z).collect();
    let amplitudes = (0..count).map(|i| Complex32::cis(TAU * fraction(i, 0.413_59) as f32)).collect();
    Reflectors::new(positions, amplitudes).expect("finite")
}

/// Reflectors on the three plates of a corner that opens to the array, 2.2 m in front of it.
fn corner(count: usize) -> Reflectors {
    let edges = [(0.0, 1.0), (0.866, -0.5), (-0.866, -0.5)].map(|(x, y)| {
        let across = 0.72 * (2.0f64 / 3.0).sqrt();
        DVec3::new(across * x, across * y, -0.72 / 3.0f64.sqrt())
    });
    let place = |i: usize| {
        let (u, v) = (0.5 + fraction(i, 0.754_878), 0.5 + fraction(i, 0.569_84));
        DVec3::new(0.0, 0.0, 2.2) + u * edges[i % 3] + v * edges[(i + 1) % 3]
    };
    let amplitudes = (0..count).map(|i| Complex32::cis(TAU * fraction(i, 0.413_59) as f32)).collect();
    Reflectors::new((0..count).map(place).collect(), amplitudes).expect("finite")
}

fn literal() -> SimulateOptions {
    SimulateOptions::default().with_tolerance(0.0)
}

fn simulation(c: &mut Criterion) {
    let mut group = c.benchmark_group("simulate");
    group.sample_size(10);
    let array = MicArray::rectangular([16, 16], [0.016; 2], DVec3::ZERO).expect("an array");
    let whole = MicArray::rectangular([64, 64], [0.008; 2], DVec3::ZERO).expect("an array");
    // The large job; the literal sum on every 64th microphone.
    let chosen: Vec<usize> = (0..64).map(|row| row * 64 + row * 29 % 64).collect();
    let positions = chosen.iter().map(|&i| whole.positions()[i]).collect();
    let part = MicArray::from_positions(positions).expect("an array");
    let (few, many) = (reflectors(2000), reflectors(50_000));
    let even = Sweep::stepped(10_000.0, 20_000.0, 10.0).expect("a sweep");
    let frequencies = (0..1001).map(|n| 10_000.0 + 10.0 * f64::from(n) + f64::from(n % 3)).collect();
    let uneven = Sweep::from_frequencies(frequencies).expect("a sweep");
    let with = |sweep: &Sweep, array: &MicArray| Instrument::new(sweep.clone(), array.clone());
    let (part, whole) = (with(&even, &part), with(&even, &whole));
    for (name, reflectors, instrument, options) in [
        ("even steps, literal", &few, &with(&even, &array), literal()),
        ("uneven steps, literal", &few, &with(&uneven, &array), literal()),
        ("even steps, virtual tones", &few, &with(&even, &array), SimulateOptions::default()),
        ("uneven steps, virtual tones", &few, &with(&uneven, &array), SimulateOptions::default()),
        ("even steps, literal", &many, &part, literal()),
        ("even steps, virtual tones", &many, &whole, SimulateOptions::default()),
    ] {
        let (n_p, n_mic) = (reflectors.len(), instrument.array.len());
        group.throughput(Throughput::Elements((n_p * n_mic * even.len()) as u64));
        group.bench_function(format!("{name}/{n_p} reflectors x {n_mic} mics x 1001 f"), |b| {
            b.iter(|| simulate(reflectors, instrument, &options).expect("small"));
        });
    }
    group.finish();

    let exact = simulate(&many, &part, &literal()).expect("small");
    let fast = simulate(&many, &whole, &SimulateOptions::default()).expect("small");
    check_error(&fast, &exact, &chosen);
}

fn picture(c: &mut Criterion) {
    let mut group = c.benchmark_group("cells");
    group.sample_size(10);
    let whole = MicArray::rectangular([63, 63], [2.0 / 62.0; 2], DVec3::ZERO).expect("an array");
    let chosen = [0, 700, 1984, 2999, 3968];
    let positions = chosen.iter().map(|&i| whole.positions()[i]).collect();
    let part = MicArray::from_positions(positions).expect("an array");
    let sweep = Sweep::stepped(10_000.0, 20_000.0, 20.0).expect("a sweep");
    let [whole, part] = [whole, part].map(|array| Instrument::new(sweep.clone(), array));
    for count in [100_000, 1_000_000] {
        let reflectors = corner(count);
        let terms = count * whole.array.len() * sweep.len();
        group.throughput(Throughput::Elements(terms as u64));
        group.bench_function(format!("{count} reflectors x 3969 mics x 501 f"), |b| {
            b.iter(|| simulate(&reflectors, &whole, &SimulateOptions::default()).expect("a cube"));
        });
        if count == 100_000 {
            let exact = simulate(&reflectors, &part, &literal()).expect("small");
            let fast = simulate(&reflectors, &whole, &SimulateOptions::default()).expect("a cube");
            check_error(&fast, &exact, &chosen);
        }
    }
    group.finish();
}

/// A rate is valid only with the required error, of the microphones whose literal sums are known.
fn check_error(fast: &DataCube, exact: &DataCube, chosen: &[usize]) {
    let (mut error, mut peak) = (0.0f32, 0.0f32);
    for f in 0..exact.instrument.sweep.len() {
        for (m, &mic) in exact.frequency(f).iter().zip(chosen) {
            error = error.max((m - fast.frequency(f)[mic]).norm());
            peak = peak.max(m.norm());
        }
    }
    assert!(error < 1e-5 * peak, "against the literal sum: {error:e} of {peak:e}");
}

criterion_group!(benches, simulation, picture);
criterion_main!(benches);
