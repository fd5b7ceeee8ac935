//! What a job takes of the machine: operations and seconds by method, and bytes at the peak.
//!
//! Unlike the rest of a plan this depends on the machine and the number of threads, so it is shown and enforced but never
//! part of a result.

use super::memory::WAITING;
use crate::acquisition::Instrument;
use crate::error::{Error, Result, gib};
use crate::grid::Grid;
use crate::reconstruct::{Estimate, Estimates, Method, ReconstructOptions, estimate};
use crate::wave::simd::{LANES, Lanes, lane_phasors};
use serde::Serialize;
use std::time::Instant;

/// What a job holds in memory beside its method's own needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Holding {
    /// Bytes of a scene, from its sampling to its truth.
    pub scene: u64,
    /// Bytes at the peak of reading and sampling it, before there is anything else.
    pub preparing: u64,
    /// Bytes of samples: a simulated cube, or a file that cannot be read in order.
    pub samples: u64,
    /// Bytes that simulating them takes beside them; 0 where they are not simulated.
    pub simulating: u64,
    /// The volume whole, rather than depth by depth.
    pub volume: bool,
    /// Bytes that finding depths takes beside samples and volume; 0 where none are found.
    pub depth: u64,
    /// Bytes that writing takes beside the volume.
    pub writing: u64,
}

/// What a job takes of this machine.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Needs {
    /// Every method, possible here or not.
    pub methods: Vec<Estimate>,
    /// Which of them the job takes, as an index.
    pub chosen: usize,
    /// Worker threads.
    pub threads: usize,
    /// Bytes at the peak.
    pub peak_bytes: u64,
    /// The same with as little as possible at a time.
    pub least_peak_bytes: u64,
}

/// Bytes of the program itself, its libraries and their tables, as far as they are ever touched.
const PROGRAM: u64 = 18 << 20;

/// Bytes of a thread: its stack, and the buffers of matrix products.
const THREAD: u64 = 1 << 20;

/// Works out what a job takes. Costs milliseconds.
///
/// # Errors
/// Those of [`estimate`].
pub fn needs(
    setup: &Instrument,
    grid: &Grid,
    options: &ReconstructOptions,
    holding: Holding,
    threads: usize,
) -> Result<Needs> {
    let Estimates { methods, chosen } = estimate(setup, grid, options, threads)?;
    let method = &methods[chosen];
    let peak_bytes = peak(method.bytes, grid, holding, threads);
    let least_peak_bytes = peak(method.least_bytes, grid, holding, threads);
    Ok(Needs { methods, chosen, threads, peak_bytes, least_peak_bytes })
}

/// Bytes of the program with so many threads.
fn program(threads: usize) -> u64 {
    PROGRAM.saturating_add(THREAD.saturating_mul(threads as u64))
}

/// Bytes at the peak of a job whose method takes `bytes`: the most of its stages.
fn peak(bytes: u64, grid: &Grid, holding: Holding, threads: usize) -> u64 {
    let Holding { scene, preparing, samples, simulating, depth, writing, .. } = holding;
    let volume = if holding.volume { grid.volume_bytes() } else { 0 };
    // Depths that wait to be kept for a later run.
    let focusing = bytes.saturating_add(WAITING.min(grid.volume_bytes()));
    let both = scene.saturating_add(samples).saturating_add(volume);
    let stages = [
        preparing,
        scene.saturating_add(samples).saturating_add(simulating),
        both.saturating_add(focusing.max(depth)),
        volume.saturating_add(writing),
    ];
    program(threads).saturating_add(stages.into_iter().max().unwrap_or(0))
}

/// Bytes at the peak of a simulation by itself, by so many threads.
pub fn simulation_peak(holding: Holding, threads: usize) -> u64 {
    let Holding { scene, preparing, samples, simulating, .. } = holding;
    program(threads).saturating_add(preparing.max(scene.saturating_add(samples).saturating_add(simulating)))
}

/// Where memory is short, a scene may take so much all the same: it is not what does not fit.
const SMALL_SCENE: u64 = 16 << 20;

/// What `limit` leaves, beside the program by itself, to reading and sampling a scene.
pub fn left_for_scene(limit: Option<u64>, threads: usize) -> Option<u64> {
    limit.map(|limit| limit.saturating_sub(program(threads)).max(SMALL_SCENE))
}

impl Needs {
    /// Seconds of each method on this machine, by a measurement of a few milliseconds.
    pub fn seconds(&self) -> Vec<f64> {
        let rate = operations_per_second() * self.threads.max(1) as f64;
        self.methods.iter().map(|method| method.operations / rate).collect()
    }
}

/// What `limit` leaves to the method beside the program, the samples and the volume:
/// [`ReconstructOptions::memory`].
pub fn left_for_method(grid: &Grid, holding: Holding, limit: Option<u64>, threads: usize) -> Option<u64> {
    let focusing = Holding { preparing: 0, simulating: 0, depth: 0, writing: 0, ..holding };
    limit.map(|limit| limit.saturating_sub(peak(0, grid, focusing, threads)))
}

/// Operations per phasor of the kernel that is timed.
const PER_PHASOR: f64 = 25.0;

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
    PER_PHASOR * count / best.max(1e-9)
}

/// Refuses a job that cannot fit, however little of it is worked on at a time.
///
/// # Errors
/// [`Error::InvalidInput`] when the peak exceeds `limit` bytes, with the numbers and what would make it fit.
pub fn check_memory(
    needs: &Needs,
    setup: &Instrument,
    grid: &Grid,
    holding: Holding,
    limit: Option<u64>,
) -> Result<()> {
    let Some(limit) = limit.filter(|limit| needs.peak_bytes > *limit) else { return Ok(()) };
    let [n_z, n_y, n_x] = grid.shape();
    let mut ways = Vec::new();
    // A far-field image is another one.
    let others = needs.methods.iter().filter(|m| m.obstacle.is_none() && m.method != Method::Linear);
    for method in others {
        let bytes = peak(method.least_bytes, grid, holding, needs.threads);
        if bytes <= limit {
            ways.push(format!("[reconstruct] method = \"{}\" needs {}", method.method, gib(bytes)));
        }
    }
    if holding.volume && holding.depth == 0 {
        ways.push("a volume written as .npz, .vti or .nrrd is never held whole".to_owned());
    }
    if holding.samples > 0 {
        ways.push("a cube in a file (`simulate`, then `reconstruct`) is never held whole".to_owned());
    }
    if holding.scene > 0
        && program(needs.threads).saturating_add(holding.preparing.max(holding.scene)) > limit / 2
    {
        ways.push(format!(
            "decimate the mesh, of which reading and sampling take {} and the scene {}",
            gib(holding.preparing),
            gib(holding.scene)
        ));
    }
    ways.push(
        "make the grid smaller or its pitch larger, or take fewer frequencies or microphones".to_owned(),
    );
    Err(Error::input(
        "memory",
        format!(
            "this job needs about {} even if as little as possible is worked on at a time ({} frequencies x {} microphones: {}; {n_x} x {n_y} x {n_z} voxels: {}), and {} \
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
/// [`Error::InvalidInput`] when [`simulation_peak`] exceeds `limit`.
pub fn check_simulation(
    setup: &Instrument,
    holding: Holding,
    threads: usize,
    limit: Option<u64>,
) -> Result<()> {
    let bytes = simulation_peak(holding, threads);
    match limit {
        Some(limit) if bytes > limit => Err(Error::input(
            "memory",
            format!(
                "a cube of {} frequencies x {} microphones takes about {} to simulate, and {} may be used here \
                 (--memory sets another limit); take fewer of either{}",
                setup.sweep.len(),
                setup.array.len(),
                gib(bytes),
                gib(limit),
                if holding.preparing > 0 {
                    ", decimate the mesh, or sample it with a larger [reflectors] spacing"
                } else {
                    ""
                }
            ),
        )),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::test_instrument;
    use super::*;
    use crate::acquisition::{DataCube, Detection};
    use crate::grid::Axis;
    use crate::named::assert_names;
    use crate::progress::Silent;
    use crate::reconstruct::reconstruct;
    use crate::wave::phasor;

    #[test]
    fn what_memory_there_is_is_kept_to_and_changes_no_byte() {
        let setup = &test_instrument(31, 0.9, 40.0, Detection::Quadrature);
        let lateral = Axis { first: -0.9, pitch: 0.03, count: 61 };
        let grid = Grid { x: lateral, y: lateral, z: Axis { first: 0.5, pitch: 0.02, count: 40 } };
        let samples =
            (0..setup.sweep.len() * setup.array.len()).map(|i| phasor(i as f64 * 0.618_034)).collect();
        let cube = DataCube::new(setup.clone(), samples).expect("finite");
        let holding = Holding { volume: true, ..Holding::default() };
        for (method, tolerance) in [(Method::Convolution, 1e-4), (Method::Convolution, 0.0)] {
            let mut options = ReconstructOptions::new(method, crate::reconstruct::Window::None);
            options.tolerance = tolerance;
            let usual = needs(setup, &grid, &options, holding, 4).expect("an estimate");
            assert!(usual.least_peak_bytes < usual.peak_bytes);
            let volume = reconstruct(&cube, &grid, &options, &Silent).expect("fits").volume;
            let limit = usual.least_peak_bytes;
            options.memory = left_for_method(&grid, holding, Some(limit), 4);
            let tight = needs(setup, &grid, &options, holding, 4).expect("an estimate");
            assert_eq!(tight.peak_bytes, limit);
            assert!(check_memory(&tight, setup, &grid, holding, Some(limit)).is_ok());
            let refused = check_memory(&tight, setup, &grid, holding, Some(limit - 1)).expect_err("too much");
            assert_names(refused.to_string(), &["memory", ".npz"]);
            assert_eq!(reconstruct(&cube, &grid, &options, &Silent).expect("fits").volume, volume);
        }
    }
}
