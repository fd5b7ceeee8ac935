//! What methods are estimated to take, what they take, and how good the choice among them is, over a grid of jobs:
//! `cargo bench --bench choice [-- JOBS]`.
//!
//! One line per job and method. Seconds are the least of several runs, in turn, each of which finds its own plan; operations
//! per second are told against their median, so that 1 is an exact estimate; of `auto` also how many times as long it takes as
//! the best by name.

#![allow(missing_docs, clippy::print_stdout)]

mod job;

use glam::DVec3;
use holosonar::acquisition::{DataCube, MicArray, Sweep};
use holosonar::grid::{Axis, Grid};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, estimate, reconstruct};
use holosonar::wave::Geometry;
use job::{noise, scattered};
use std::time::Instant;

/// Jobs, unless the command line says otherwise.
const JOBS: usize = 80;

/// Methods that are estimated to take more operations are not run.
const MOST_OPERATIONS: f64 = 6e11;

/// Runs of a method, and seconds after which no other begins.
const RUNS: usize = 5;
const LONG: f64 = 2.0;

const METHODS: [Method; 3] = [Method::Auto, Method::Convolution, Method::Backprojection];

/// What a method takes for a job.
struct Measured {
    method: Method,
    operations: f64,
    seconds: f64,
}

fn lattice(count: [usize; 2], extent: f64) -> (String, MicArray) {
    let [columns, rows] = count;
    let pitch = extent / (columns - 1) as f64;
    let array = MicArray::rectangular(count, [pitch; 2], DVec3::ZERO).expect("an array");
    (format!("{columns} x {rows} on {extent} m"), array)
}

/// Microphones all over a square, or a cube.
fn random(count: usize, extent: DVec3) -> (String, MicArray) {
    let positions = (0..count).map(|i| scattered(i) * extent).collect();
    (format!("{count} in {extent} m"), MicArray::from_positions(positions).expect("an array"))
}

fn arrays() -> Vec<(String, MicArray)> {
    let flat = |extent: f64| DVec3::new(extent, extent, 0.0);
    vec![
        lattice([3; 2], 0.5),
        lattice([8; 2], 0.5),
        lattice([16; 2], 0.4),
        lattice([32; 2], 1.0),
        lattice([63; 2], 2.0),
        lattice([64; 2], 0.5),
        lattice([127; 2], 1.0),
        lattice([255; 2], 1.0),
        random(8, flat(0.3)),
        random(64, flat(1.0)),
        random(256, flat(1.0)),
        random(1000, flat(0.6)),
        random(4000, flat(2.0)),
        random(64, DVec3::new(0.5, 0.5, 0.2)),
        random(500, DVec3::new(0.6, 0.6, 0.1)),
    ]
}

/// Rows of microphones, for two-dimensional images.
fn rows() -> Vec<(String, MicArray)> {
    let on_a_line = |count: usize, extent: f64| random(count, DVec3::new(extent, 0.0, 0.0));
    vec![
        lattice([16, 1], 0.5),
        lattice([64, 1], 0.63),
        lattice([255, 1], 1.016),
        lattice([256, 1], 2.55),
        lattice([1024, 1], 2.0),
        on_a_line(64, 1.0),
        on_a_line(500, 2.0),
    ]
}

/// Those of two-dimensional images.
const IMAGES: [(usize, usize, [f64; 2], f64); 6] = [
    (256, 200, [0.01, 0.01], 1.0),
    (512, 512, [0.0025, 0.0025], 0.5),
    (256, 1024, [0.01, 0.01], 1.0),
    (1024, 1000, [0.002, 0.002], 0.3),
    (167, 231, [0.008, 0.005], 1.25),
    (2048, 400, [0.005, 0.01], 2.0),
];

/// Voxels across and in depth, their pitches and the first depth.
const GRIDS: [(usize, usize, [f64; 2], f64); 7] = [
    (48, 48, [0.008, 0.008], 1.0),
    (100, 1, [0.008, 0.01], 1.0),
    (96, 96, [0.004, 0.004], 0.8),
    (64, 128, [0.01, 0.005], 0.3),
    (128, 48, [0.008, 0.01], 1.5),
    (24, 200, [0.02, 0.004], 2.0),
    (120, 60, [0.015, 0.01], 6.0),
];

const FREQUENCIES: [usize; 5] = [11, 101, 501, 1001, 5001];

/// The i-th of many combinations, of which every fifth is two-dimensional.
fn job_of(i: usize) -> (String, DataCube, Grid) {
    let is_image = i % 5 == 4;
    let (arrays, grids) = if is_image { (rows(), &IMAGES[..]) } else { (arrays(), &GRIDS[..]) };
    let i = if is_image { i / 5 } else { i - i / 5 };
    let (name, array) = arrays[i % arrays.len()].clone();
    let (across, depths, [lateral, along], first) = grids[i * if is_image { 5 } else { 3 } % grids.len()];
    // Samples of 256 MiB at most.
    let most = (1 << 25) / array.len();
    let frequencies = FREQUENCIES[(i + i / 7) % FREQUENCIES.len()].min(most);
    let sweep = Sweep::stepped(10_000.0, 20_000.0, 10_000.0 / (frequencies - 1) as f64).expect("a sweep");
    let mut cube = noise(sweep, array);
    if i % 4 == 3 {
        cube.instrument = cube.instrument.with_geometry(Geometry::Monostatic);
    }
    let rows = match depths {
        _ if is_image => 1,
        1 => 100,
        _ => across,
    };
    let centred = |count: usize| Axis { first: -0.5 * lateral * (count - 1) as f64, pitch: lateral, count };
    let z = Axis { first, pitch: along, count: depths };
    let grid = Grid { x: centred(across), y: centred(rows), z };
    let kind = if i % 4 == 3 { ", monostatic" } else { "" };
    let size = format!("{across} x {rows} x {depths} of {lateral} x {along} m from {first} m");
    let name = format!("{name}{kind}, {frequencies} f, {size}");
    (name, cube, grid)
}

/// All methods of a job that can be used and are not too long.
fn measured(cube: &DataCube, grid: &Grid) -> Vec<Measured> {
    let of = |method: Method| ReconstructOptions::new(method, Window::None);
    let possible = METHODS.map(|method| {
        let estimates = estimate(&cube.instrument, grid, &of(method), 2).expect("a job");
        let found = estimates.of(method).unwrap_or(estimates.chosen());
        (found.obstacle.is_none() && found.operations < MOST_OPERATIONS).then_some((method, found.operations))
    });
    let possible: Vec<_> = possible.into_iter().flatten().collect();
    let (mut least, begun) = (vec![f64::INFINITY; possible.len()], Instant::now());
    let z = Axis { first: grid.z.first + 0.1 * grid.z.pitch, ..grid.z };
    let other = Grid { z, ..*grid };
    for _ in 0..RUNS {
        for ((method, _), least) in possible.iter().zip(&mut least) {
            // The last plan is remembered: this job's is forgotten.
            estimate(&cube.instrument, &other, &of(*method), 2).expect("a job");
            let start = Instant::now();
            reconstruct(cube, grid, &of(*method)).expect("fits");
            *least = least.min(start.elapsed().as_secs_f64());
        }
        if begun.elapsed().as_secs_f64() > LONG {
            break;
        }
    }
    let each = possible.into_iter().zip(least);
    each.map(|((method, operations), seconds)| Measured { method, operations, seconds }).collect()
}

fn main() {
    let count = std::env::args().skip(1).find_map(|word| word.parse().ok()).unwrap_or(JOBS);
    let jobs: Vec<(String, Vec<Measured>)> = (0..count)
        .map(|i| {
            let (name, cube, grid) = job_of(i);
            (name, measured(&cube, &grid))
        })
        .collect();
    let all = jobs.iter().flat_map(|(_, methods)| methods);
    let mut rates: Vec<f64> = all.map(|m| m.operations / m.seconds).collect();
    rates.sort_by(f64::total_cmp);
    let Some(median) = rates.get(rates.len() / 2) else { return };
    println!("| job | method | operations | s | operations/s of the median's | of the best |");
    println!("|---|---|---|---|---|---|");
    let (mut off, mut regret) = (1.0f64, 1.0f64);
    for (job, methods) in &jobs {
        let named = methods.iter().filter(|m| m.method != Method::Auto);
        let best = named.map(|m| m.seconds).fold(f64::INFINITY, f64::min);
        for Measured { method, operations, seconds } in methods {
            let rate = operations / seconds / median;
            off = off.max(rate).max(1.0 / rate);
            let mut than_best = String::new();
            if *method == Method::Auto {
                regret = regret.max(seconds / best);
                than_best = format!("{:.2}", seconds / best);
            }
            println!("| {job} | {method} | {operations:.1e} | {seconds:.4} | {rate:.2} | {than_best} |");
        }
    }
    println!(
        "Estimates are off by up to {off:.2}; a choice takes up to {regret:.2} times as long as the best."
    );
}
