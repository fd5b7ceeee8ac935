//! A-scans of cubes and of scenes.

use crate::acquisition::{AScan, AScanOptions, CubeFile, CubeSource};
use crate::config::RunFile;
use crate::error::Result;
use crate::pipeline::{JobOptions, simulate_scene};

/// The range profile of a cube's microphone after `[calibration]`, with the window of `[reconstruct]`.
///
/// # Errors
/// Those of [`AScan::of`]; corrections that are impossible.
pub fn ascan_cube(run: &RunFile, cube: CubeFile, options: &AScanOptions, job: &JobOptions) -> Result<AScan> {
    let mut cube = cube.calibrated(&run.calibration(), job.observer)?;
    scan(run, &mut cube, options, job)
}

/// The range profile of a microphone before a scene, whose cube is simulated as [`simulate_scene`] does it: noise and errors
/// of the microphones are those of the whole cube.
///
/// # Errors
/// Those of [`AScan::of`] and [`simulate_scene`].
pub fn ascan_scene(run: &RunFile, options: &AScanOptions, job: &JobOptions) -> Result<AScan> {
    scan(run, &mut &simulate_scene(run, job)?, options, job)
}

fn scan(
    run: &RunFile,
    source: &mut dyn CubeSource,
    options: &AScanOptions,
    job: &JobOptions,
) -> Result<AScan> {
    let weights = run.reconstruct.window.over_sweep(&source.instrument().sweep);
    AScan::of(source, &weights, options, job.observer)
}
