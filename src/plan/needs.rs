//! What a job takes of the machine: operations and seconds by method, and bytes at the peak.
//!
//! Unlike the rest of a plan this depends on the machine and the number of threads, so it is shown and enforced but never
//! part of a result.

use super::memory::{WAITING, gib};
use crate::acquisition::Setup;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::reconstruct::{Estimate, ReconstructOptions, estimate};
use crate::wave::simd::{LANES, Lanes, lane_phasors};
use serde::Serialize;
use std::time::Instant;

/// What a job holds in memory beside its method's own needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Holding {
    /// Bytes of samples: a simulated cube, or a file that cannot be read in order.
    pub samples: u64,
    /// Whether they are simulated first, which takes sums beside them.
    pub simulated: bool,
    /// The volume whole, rather than depth by depth.
    pub volume: bool,
    /// What finding depths takes beside the volume.
    pub depth: bool,
}

impl Holding {
    /// A simulated cube, imaged with its depths.
    pub fn of_simulation(setup: &Setup) -> Self {
        Self { samples: setup.cube_bytes(), simulated: true, volume: true, depth: true }
    }
}

/// What a job takes of this machine.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Needs {
    /// Every method, possible here or not.
    pub methods: [Estimate; 4],
    /// Seconds of each, by a short measurement of this machine's speed.
    pub seconds: [f64; 4],
    /// Which of them the job takes, as an index.
    pub chosen: usize,
    /// Worker threads.
    pub threads: usize,
    /// Bytes at the peak.
    pub peak_bytes: u64,
    /// The same with one thread.
    pub peak_bytes_with_one_thread: u64,
}

/// Bytes of the program itself, its threads' stacks and its libraries' tables.
const PROGRAM: u64 = 20 << 20;

/// The most bytes of sums that a simulation holds beside its cube.
const SIMULATION: u64 = 128 << 20;

/// Works out what a job takes. Costs milliseconds.
///
/// # Errors
/// Those of [`estimate`].
pub fn needs(
    setup: &Setup,
    grid: &Grid,
    options: &ReconstructOptions,
    holding: Holding,
    threads: usize,
) -> Result<Needs> {
    let (methods, chosen) = estimate(setup, grid, options, threads)?;
    let (alone, _) = estimate(setup, grid, options, 1)?;
    let voxels = grid.voxel_count();
    let cube = holding.samples;
    let volume = if holding.volume { grid.volume_bytes() } else { 0 };
    let simulating = if holding.simulated { simulating(cube) } else { 0 };
    // |Â|², a smoothed copy and what the filter passes through.
    let depth = if holding.depth { cube.saturating_add(voxels.saturating_mul(8 + 16)) } else { 0 };
    let peak = |method: &Estimate| {
        let kept = WAITING.min(voxels.saturating_mul(8));
        let focusing = cube.saturating_add(volume).saturating_add(method.bytes).saturating_add(kept);
        PROGRAM.saturating_add(focusing.max(simulating).max(depth))
    };
    let rate = operations_per_second();
    let seconds = std::array::from_fn(|i| methods[i].operations / (rate * threads.max(1) as f64));
    Ok(Needs {
        seconds,
        chosen,
        threads,
        peak_bytes: peak(&methods[chosen]),
        peak_bytes_with_one_thread: peak(&alone[chosen]),
        methods,
    })
}

/// Operations per phasor of the kernel that is timed.
const PER_PHASOR: f64 = 25.0;

/// How much more goes through the methods' own loops than through the timed one, by measurement of both.
const AGAINST_PHASORS: f64 = 1.0;

/// Floating-point operations per second and thread of this machine, by a measurement of a few milliseconds. It only ever
/// turns operations into seconds to be shown.
fn operations_per_second() -> f64 {
    let lengths: Vec<[f64; LANES]> =
        (0..512).map(|i| std::array::from_fn(|l| 1.0 + f64::from(i) * 0.003 + l as f64 * 0.1)).collect();
    let mut phasors = vec![Lanes::ZERO; lengths.len()];
    let count = (lengths.len() * LANES) as f64;
    let best = (0..200)
        .map(|_| {
            let begun = Instant::now();
            lane_phasors(&[58.3; LANES], &lengths, &mut phasors);
            begun.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min);
    AGAINST_PHASORS * PER_PHASOR * count / best.max(1e-9)
}

/// Refuses a job that cannot fit.
///
/// # Errors
/// [`Error::Input`] when the peak exceeds `limit` bytes, with the numbers and what would make it fit.
pub fn check_memory(
    needs: &Needs,
    setup: &Setup,
    grid: &Grid,
    holding: Holding,
    limit: Option<u64>,
) -> Result<()> {
    let Some(limit) = limit.filter(|limit| needs.peak_bytes > *limit) else { return Ok(()) };
    let [n_z, n_y, n_x] = grid.shape();
    let mut ways = Vec::new();
    if needs.peak_bytes_with_one_thread <= limit {
        ways.push(format!("one thread (-j 1) needs {}", gib(needs.peak_bytes_with_one_thread)));
    }
    if holding.volume && !holding.depth {
        ways.push("a volume written as .npz, .vti or .nrrd is never held whole".to_owned());
    }
    if holding.samples > 0 {
        ways.push("a cube in a file (`simulate`, then `reconstruct`) is never held whole".to_owned());
    }
    ways.push(
        "make the grid smaller or its pitch larger, or take fewer frequencies or microphones".to_owned(),
    );
    Err(Error::input(
        "memory",
        format!(
            "this job needs about {} ({} frequencies x {} microphones: {}; {n_x} x {n_y} x {n_z} voxels: {}), and {} \
             may be used here (--memory sets another limit); {}",
            gib(needs.peak_bytes),
            setup.sweep.len(),
            setup.array.len(),
            gib(setup.cube_bytes()),
            gib(grid.volume_bytes()),
            gib(limit),
            ways.join("; ")
        ),
    ))
}

/// Refuses to simulate a cube that cannot fit.
///
/// # Errors
/// [`Error::Input`] when it and the sums beside it exceed `limit` bytes.
pub fn check_simulation(setup: &Setup, limit: Option<u64>) -> Result<()> {
    let bytes = simulating(setup.cube_bytes());
    match limit {
        Some(limit) if bytes > limit => Err(Error::input(
            "memory",
            format!(
                "a cube of {} frequencies x {} microphones takes about {} to simulate, and {} may be used here \
                 (--memory sets another limit); take fewer of either",
                setup.sweep.len(),
                setup.array.len(),
                gib(bytes),
                gib(limit)
            ),
        )),
        _ => Ok(()),
    }
}

/// Bytes while a cube is simulated: itself, and sums beside it.
fn simulating(cube: u64) -> u64 {
    cube.saturating_add(cube.min(SIMULATION))
}
