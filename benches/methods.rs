//! Times and errors of every method compared with the direct sum; the growth of time with voxels, microphones and
//! frequencies; and the paper's 2-D image size: `cargo bench --bench methods [-- table growth paper]`.
//!
//! Ratios are of the minimum of several times, alternating within one run (jobs of milliseconds many times in a row). The
//! direct sum is timed on an evenly spaced part of the voxels, and scaled; errors are the maximum over those voxels,
//! relative to the volume's peak.

#![allow(missing_docs, clippy::print_stdout)]

mod job;

use glam::DVec3;
use holosonar::acquisition::{DataCube, MicArray, SimulateOptions, Sweep, simulate};
use holosonar::grid::{Axis, Grid, Volume};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, direct_terms, reconstruct};
use holosonar::reflectors::Reflectors;
use job::{displaced, job, noise};
use num_complex::Complex32;
use std::time::Instant;

/// Jobs that take fewer seconds are repeated this many times for each direct sum.
const SHORT: f64 = 0.02;
const REPEATS: usize = 20;

/// A volume and the seconds it took.
fn timed(cube: &DataCube, grid: &Grid, method: Method, tolerance: f64) -> (Volume, f64) {
    let mut options = ReconstructOptions::new(method, Window::None);
    options.tolerance = tolerance;
    let begun = Instant::now();
    let volume = reconstruct(cube, grid, &options).expect("fits").volume;
    (volume, begun.elapsed().as_secs_f64())
}

/// The minimum seconds of `times` runs.
fn minimum(times: usize, cube: &DataCube, grid: &Grid, method: Method, tolerance: f64) -> f64 {
    (0..times).map(|_| timed(cube, grid, method, tolerance).1).fold(f64::INFINITY, f64::min)
}

/// The echoes of a few reflectors within the grid at a cube's microphones.
fn echoes(cube: &DataCube, grid: &Grid) -> DataCube {
    let at = |axis: &Axis, t: f64| axis.first + t.fract() * (axis.last() - axis.first);
    let place = |i: u32| {
        let t = |k: f64| f64::from(i + 1) * k;
        DVec3::new(at(&grid.x, t(0.618_034)), at(&grid.y, t(0.754_878)), at(&grid.z, t(0.569_84)))
    };
    let reflectors = Reflectors::new((0..12).map(place).collect(), vec![Complex32::ONE; 12]).expect("finite");
    simulate(&reflectors, &cube.instrument, &SimulateOptions::default()).expect("small")
}

/// At most `most` evenly spaced voxels along each axis, and their spacing in voxels.
fn part(grid: &Grid, most: [usize; 3]) -> (Grid, [usize; 3]) {
    let axes = [grid.x, grid.y, grid.z];
    let steps: [usize; 3] = std::array::from_fn(|i| axes[i].count.div_ceil(most[i]));
    let some = |i: usize| {
        let Axis { first, pitch, count } = axes[i];
        Axis { first, pitch: pitch * steps[i] as f64, count: count.div_ceil(steps[i]) }
    };
    (Grid { x: some(0), y: some(1), z: some(2) }, steps)
}

/// The maximum difference at the voxels of a part, relative to the volume's peak.
fn error(volume: &Volume, part: &Volume, steps: [usize; 3]) -> f64 {
    let [n_z, n_y, n_x] = part.grid.shape();
    let all = volume.grid.shape();
    let mut worst = 0.0f32;
    for (i, value) in part.samples.iter().enumerate() {
        let (x, y, z) = (i % n_x * steps[0], i / n_x % n_y * steps[1], i / n_x / n_y * steps[2]);
        worst = worst.max((volume.samples[(z * all[1] + y) * all[2] + x] - value).norm());
    }
    assert_eq!(part.samples.len(), n_x * n_y * n_z);
    f64::from(worst / volume.peak())
}

/// One line: a method compared with the direct sum of the same cube, alternating.
fn line(name: &str, cube: &DataCube, grid: &Grid, method: Method, tolerance: f64) {
    // A small grid is summed completely, so that the fixed cost of a call is not scaled.
    let (some, steps) = if grid.voxel_count() < 1 << 15 { (*grid, [1; 3]) } else { part(grid, [16, 16, 8]) };
    let (mut direct, mut fast, mut worst) = (f64::INFINITY, f64::INFINITY, 0.0f64);
    let begun = Instant::now();
    for round in 0..7 {
        let (exact, seconds) = timed(cube, &some, Method::Direct, 1e-4);
        direct = direct.min(seconds);
        let (volume, seconds) = timed(cube, grid, method, tolerance);
        // Short jobs are repeated: the first run starts with the caches and memory in the state that the direct sum left.
        let fastest = if seconds < SHORT { minimum(REPEATS, cube, grid, method, tolerance) } else { seconds };
        fast = fast.min(fastest);
        worst = worst.max(error(&volume, &exact, steps));
        if round > 0 && begun.elapsed().as_secs_f64() > 15.0 {
            break;
        }
    }
    let terms = direct_terms(&cube.instrument, grid) as f64;
    let scaled = direct * terms / direct_terms(&cube.instrument, &some) as f64;
    println!(
        "| {name} | {:.0} | {:.1e} | {fast:.4} | {:.1e} | {:.0} | {worst:.0e} |",
        scaled,
        terms / scaled,
        terms / fast,
        scaled / fast
    );
}

/// All methods at three sizes.
fn table() {
    println!("| method, size | direct s | terms/s | s | terms/s | ratio | error |");
    for (mics, frequencies, voxels) in [(32, 251, [32, 32]), (64, 501, [64, 64]), (64, 1001, [128, 128])] {
        let [lateral, depths] = voxels;
        let (cube, grid) = job(mics, lateral, frequencies, depths);
        let flat = echoes(&cube, &grid);
        let scattered = echoes(&displaced(&cube, 0.0), &grid);
        let not_planar = echoes(&displaced(&cube, 0.025), &grid);
        let size = format!("{mics}^2 mics x {frequencies} f x {lateral}^2 x {depths}");
        for (name, cube, method, tolerance) in [
            ("plain Eq. 16", &flat, Method::Convolution, 0.0),
            ("skeletons", &flat, Method::Convolution, 1e-4),
            ("spreading", &scattered, Method::Convolution, 1e-4),
            ("backprojection", &not_planar, Method::Backprojection, 1e-4),
        ] {
            line(&format!("{name}, {size}"), cube, &grid, method, tolerance);
        }
    }
}

/// Seconds with skeleton frequencies around one size, as one parameter grows.
fn growth() {
    for (mics, frequencies, lateral, depths) in [
        (64, 1001, 128, 64),
        (64, 1001, 64, 64),
        (64, 1001, 128, 128),
        (64, 1001, 192, 64),
        (32, 1001, 128, 64),
        (128, 1001, 128, 64),
        (64, 251, 128, 64),
        (64, 5001, 128, 64),
        (64, 1001, 128, 128),
        (64, 5001, 128, 128),
    ] {
        let (cube, grid) = job(mics, lateral, frequencies, depths);
        let seconds = minimum(5, &cube, &grid, Method::Convolution, 1e-4);
        println!("{mics}^2 mics x {frequencies} f x {lateral}^2 x {depths} voxels: {seconds:.3} s");
    }
}

/// The paper's 2-D size: as printed, with pixels over the whole metre, and with a pitch shared with the microphones, which
/// is the best choice (0.8 m of the metre).
fn paper() {
    let sweep = Sweep::stepped(18_000.0, 20_000.0, 2.0).expect("a sweep");
    let array = MicArray::rectangular([255, 1], [1.0 / 254.0; 2], DVec3::ZERO).expect("an array");
    let cube = noise(sweep, array);
    let y = Axis { first: 0.0, pitch: 0.01, count: 1 };
    for (across, pitch) in [("a shared pitch", 2.0 / 254.0), ("the whole metre", 1.0 / 99.0)] {
        let x = Axis { first: -49.5 * pitch, pitch, count: 100 };
        for (deep, near, far, method) in [
            ("0 to 5 m", 0.0, 5.0, Method::Auto),
            ("0.5 to 5.5 m", 0.5, 5.5, Method::Convolution),
            ("1.8 to 2.2 m", 1.8, 2.2, Method::Convolution),
        ] {
            let grid = Grid { x, y, z: Axis { first: near, pitch: (far - near) / 99.0, count: 100 } };
            line(&format!("2-D, {across}, {deep}"), &echoes(&cube, &grid), &grid, method, 1e-4);
        }
    }
}

fn main() {
    let asked: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    for (name, run) in [("table", table as fn()), ("growth", growth), ("paper", paper)] {
        if asked.is_empty() || asked.iter().any(|word| word == name) {
            println!("{name}, {} threads", rayon::current_num_threads());
            run();
        }
    }
}
