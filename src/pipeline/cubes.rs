//! Cubes, from files and in a caller's memory, to images and volumes.
//!
//! Samples in memory give the same results as a file of them, but without a checkpoint, and without a copy, unless they are
//! corrected.

mod ascan;
mod focus;

pub use ascan::{ascan_cube, ascan_scene};
pub use focus::{autofocus_cube, self_calibrate_cube};

use super::facts::{beyond_the_sum, image_facts, sidelobes};
use super::job::{identity, log::Log};
use super::memory::MemoryBudget;
use super::{JobOptions, Outcome, need_bandwidth, outputs, reconstruct, reconstruct_and_locate, warn_all};
use crate::acquisition::{CubeFile, CubeSource, CubeView, DataCube};
use crate::alloc::try_with_capacity;
use crate::checkpoint::Checkpoint;
use crate::config::RunFile;
use crate::error::{Error, Result, gib};
use crate::grid::{Grid, Volume};
use crate::plan::{JobArrays, plan};
use crate::progress::Observer;
use crate::reconstruct::{Reconstruction, reconstruct_into};
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Images a cube: like [`image_scene`](super::image_scene), but without a truth and metrics.
///
/// # Errors
/// The errors of the stages; a run file without a grid; a disk without space for the files; another process that works on
/// the same job.
pub fn image_cube(run: &RunFile, cube: CubeFile, job: &JobOptions) -> Result<Outcome> {
    let JobOptions { checkpoint, observer, .. } = *job;
    let log = Log::new(observer);
    let mut cube = cube.calibrated(&run.calibration(), &log)?;
    let changes = cube.changes().to_vec();
    image_source(run, &mut cube, None, &changes, checkpoint, log, |cube, grid| {
        checkpoint.check_space(outputs::volume_bytes(run, grid))?;
        checkpoint.open(&identity::of_cube("image", run, cube, grid)?, observer)
    })
}

/// Images the samples of a source, of which `changes` tell what was corrected; `open` is called before the long work, once
/// it is known that the job fits.
fn image_source<S: CubeSource>(
    run: &RunFile,
    source: &mut S,
    grid: Option<Grid>,
    changes: &[String],
    checkpoint: &Checkpoint,
    log: Log,
    open: impl FnOnce(&mut S, &Grid) -> Result<()>,
) -> Result<Outcome> {
    let instrument = source.instrument().clone();
    need_bandwidth("the cube's `frequencies`", &instrument.sweep)?;
    let grid = grid.map_or_else(|| run.voxels(&instrument, None), Ok)?;
    let plan = plan(&instrument, &grid);
    warn_all(&plan.warnings, &log);
    let budget = MemoryBudget::of(run);
    let samples = JobArrays::measured(&instrument, source.held_bytes());
    let arrays = budget.imaging(&instrument, &grid, samples);
    budget.check(&instrument, &grid, &arrays, &log)?;
    let raster = run.raster(None)?;
    open(source, &grid)?;
    let sidelobes = sidelobes(&instrument, run);
    let physics = [changes, &beyond_the_sum(run, &instrument)].concat();
    let (image, depth) =
        reconstruct_and_locate(&budget, source, &grid, (raster, samples, sidelobes), checkpoint, &log)?;
    let (timings, warnings) = log.finish();
    Ok(Outcome {
        plan,
        scene: None,
        mesh: None,
        reflectors: None,
        multipath: None,
        physics,
        motion: Vec::new(),
        coding: None,
        instrument,
        image,
        sidelobes,
        depth,
        truth: None,
        scores: None,
        timings,
        warnings,
    })
}

/// Images samples in memory: like [`image_cube`] of a file of them. Of `grid` and the run file's `[grid]`,
/// the former is used.
///
/// # Errors
/// The errors of the stages; neither a grid nor a `[grid]`.
pub fn image_samples(
    run: &RunFile,
    cube: CubeView<'_>,
    grid: Option<Grid>,
    observer: &dyn Observer,
) -> Result<Outcome> {
    let log = Log::new(observer);
    match corrected(run, cube, &log)? {
        Some((cube, changes)) => {
            image_source(run, &mut &cube, grid, &changes, &Checkpoint::off(), log, |_, _| Ok(()))
        }
        None => image_source(run, &mut { cube }, grid, &[], &Checkpoint::off(), log, |_, _| Ok(())),
    }
}

/// Reconstructs a cube into volume files and returns their names; of the run file only `[grid]`, `[reconstruct]` and
/// `[output]` are used. The checkpoint is used as by [`image_scene`](super::image_scene).
///
/// # Errors
/// The errors of the stages; a run file without a grid; a file that cannot be written, or a disk without space for it;
/// another process that works on the same job.
pub fn reconstruct_cube(
    run: &RunFile,
    cube: CubeFile,
    outputs: &[PathBuf],
    job: &JobOptions,
) -> Result<Vec<PathBuf>> {
    let JobOptions { checkpoint, observer, .. } = *job;
    let mut cube = cube.calibrated(&run.calibration(), observer)?;
    let instrument = cube.instrument().clone();
    let grid = run.voxels(&instrument, None)?;
    let plan = plan(&instrument, &grid);
    warn_all(&plan.warnings, observer);
    cube.changes().iter().for_each(|change| observer.note(change));
    outputs::announce_further(outputs, &grid)?;
    let whole = outputs.iter().any(|path| outputs::needs_all(path));
    let samples = JobArrays::measured(&instrument, cube.held_bytes());
    let budget = MemoryBudget::of(run);
    let arrays = budget.reconstructing(outputs.iter().map(PathBuf::as_path), &grid, whole, samples);
    budget.check(&instrument, &grid, &arrays, observer)?;
    checkpoint.check_space(outputs.iter().map(|path| outputs::bytes_of(path, run, &grid)).sum())?;
    checkpoint.open(&identity::of_cube("reconstruct", run, &mut cube, &grid)?, observer)?;
    let options = budget.options(&arrays);
    let shards = job.shards();
    let mut files = outputs::VolumeFiles::new(&instrument, run, grid, outputs, &shards);
    reconstruct(&mut cube, &grid, &options, &mut files, checkpoint, observer)?;
    files.finish()
}

/// Reconstructs samples in memory, with the `[calibration]`, `[grid]`, `[reconstruct]` and `[refine]` of a run file; returns
/// the volume and its metadata, which are those that [`reconstruct_cube`] would write. Of `grid` and
/// the run file's `[grid]`, the former is used.
///
/// # Errors
/// The errors of the stages; neither a grid nor a `[grid]`; a job that does not fit in memory.
pub fn reconstruct_samples(
    run: &RunFile,
    cube: CubeView<'_>,
    grid: Option<Grid>,
    observer: &dyn Observer,
) -> Result<(Reconstruction, Value)> {
    let (mut held, mut given) = (None, cube);
    if let Some((cube, changes)) = corrected(run, cube, observer)? {
        for change in &changes {
            observer.note(change);
        }
        held = Some(cube);
    }
    let mut held = held.as_ref();
    let source: &mut dyn CubeSource = match &mut held {
        Some(cube) => cube,
        None => &mut given,
    };
    let instrument = source.instrument().clone();
    let grid = grid.map_or_else(|| run.voxels(&instrument, None), Ok)?;
    warn_all(&plan(&instrument, &grid).warnings, observer);
    let samples = JobArrays::measured(&instrument, source.held_bytes());
    let budget = MemoryBudget::of(run);
    let arrays = budget.reconstructing(std::iter::empty::<&Path>(), &grid, true, samples);
    budget.check(&instrument, &grid, &arrays, observer)?;
    let mut volume = Volume { grid, samples: Vec::new() };
    let info = reconstruct_into(source, &grid, &budget.options(&arrays), &mut volume, observer)?;
    let facts = image_facts(&instrument, run, &info, sidelobes(&instrument, run));
    Ok((Reconstruction::new(volume, &info), facts))
}

/// The cube after the run file's `[calibration]`, and what that changed; `None` where nothing is to be corrected.
fn corrected(
    run: &RunFile,
    cube: CubeView<'_>,
    observer: &dyn Observer,
) -> Result<Option<(DataCube, Vec<String>)>> {
    let calibration = run.calibration();
    if calibration.is_empty() {
        return Ok(None);
    }
    let given = cube.samples();
    let mut samples = try_with_capacity(given.len() as u64).ok_or_else(|| {
        let bytes = gib(cube.instrument().cube_bytes());
        Error::out_of_memory(format!(
            "{bytes} of samples are copied to be corrected, and do not fit in memory"
        ))
    })?;
    samples.extend_from_slice(given);
    let mut cube = DataCube { instrument: cube.instrument().clone(), samples, provenance: Value::Null };
    let changes = calibration.apply(&mut cube, observer)?;
    Ok(Some((cube, changes)))
}
