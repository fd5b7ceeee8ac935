//! The work of an image, a cube or a volume in units that processes share, on one host or many: tiles of microphones to
//! simulate, and depths to reconstruct.
//!
//! Units are planned from the whole job, so that its bytes do not depend on who computes what. Each is stored as a segment
//! beside the checkpoint of [`image_scene`](crate::pipeline::image_scene), [`image_cube`](crate::pipeline::image_cube),
//! [`simulate_scene`](crate::pipeline::simulate_scene) or [`reconstruct_cube`](crate::pipeline::reconstruct_cube), which take
//! up all that there are, compute the rest, and add the noise. Processes share a folder and the user's secret, and no word.

use super::{JobOptions, identity};
use crate::acquisition::{CubeFile, CubeSource};
use crate::blocks::NoStore;
use crate::checkpoint::{
    Checkpoint, CheckpointStore, GracefulStop, Identity, ListedTiles, SegmentWriter, Stage, UnitBlocks,
    WantedDepths, WantedTiles,
};
use crate::choice::choice;
use crate::config::RunFile;
use crate::error::{Error, Result};
use crate::files::extension;
use crate::grid::Grid;
use crate::pipeline::memory::MemoryBudget;
use crate::pipeline::prepared_scene::PreparedScene;
use crate::pipeline::{need_bandwidth, recording};
use crate::plan::JobArrays;
use crate::progress::{Observer, Silent};
use crate::reconstruct::reconstruct_stored;
use serde::Serialize;
use std::ops::Range;
use std::path::Path;

/// Units of a stage, as far as it has so many blocks: enough for many processes, and more where one would be large.
const UNITS: u64 = 64;

/// Bytes of a unit beyond which there are more of them, and the most that there are.
const UNIT_BYTES: u64 = 64 << 20;
const MOST_UNITS: u64 = 1024;

choice! {
    /// The stages whose work is shared.
    pub enum UnitStage: "stage" {
        /// Tiles of microphones are simulated.
        Simulate = "simulate",
        /// Depths are reconstructed.
        Reconstruct = "reconstruct",
    }
}

/// One unit of a job's work.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Unit {
    /// Its number in the job, from 0.
    pub unit: u64,
    /// What is computed.
    pub stage: UnitStage,
    /// Number of the first tile or depth.
    pub first: u64,
    /// How many tiles or depths.
    pub blocks: u64,
    /// Its share of the stage's cost.
    pub share: f64,
}

/// Which units a process computes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Wanted {
    /// Of each stage the `part`-th of `of` parts, from 1 on.
    Part {
        /// From 1 to `of`.
        part: u64,
        /// Number of processes.
        of: u64,
    },
    /// By number.
    Numbers(Range<u64>),
}

/// What a process has done, and what is left of the job.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct WorkDone {
    /// Units of the job, of which those of the simulation come first.
    pub units: u64,
    /// Units of its simulation.
    pub simulation: u64,
    /// Numbers of the units that were computed now.
    pub computed: Vec<u64>,
    /// Units that were to be computed, and are stored already.
    pub found: u64,
    /// Units of the simulation that are not stored yet, which must be before any depth is reconstructed.
    pub simulation_left: u64,
    /// Units of the job that are not stored yet.
    pub left: u64,
    /// Their numbers.
    pub missing: Vec<u64>,
}

impl Wanted {
    /// Those of a stage's units.
    fn of<'u>(&self, units: &'u [UnitBlocks]) -> &'u [UnitBlocks] {
        let range = match self {
            Self::Part { part, of } => {
                let end = |part: u64| (u128::from(part) * units.len() as u128 / u128::from(*of)) as usize;
                end(part - 1)..end(*part)
            }
            Self::Numbers(numbers) => {
                let end = |number: u64| units.partition_point(|unit| unit.unit < number);
                end(numbers.start)..end(numbers.end)
            }
        };
        &units[range]
    }
}

/// The units of a job, by stage.
struct Units {
    simulate: Vec<UnitBlocks>,
    reconstruct: Vec<UnitBlocks>,
}

impl Units {
    /// Of these tiles, and of the depths of a grid, unless the volume is refined, which takes all of it.
    fn new(tiles: &[u64], cube_bytes: u64, run: &RunFile, grid: &Grid) -> Self {
        let simulate = divided(tiles, cube_bytes, 0);
        let depths: Vec<u64> =
            if run.refine_options().is_some() { Vec::new() } else { (0..grid.z.count as u64).collect() };
        let reconstruct = divided(&depths, grid.volume_bytes(), simulate.len() as u64);
        Self { simulate, reconstruct }
    }

    fn len(&self) -> u64 {
        (self.simulate.len() + self.reconstruct.len()) as u64
    }

    fn listed(&self) -> Vec<Unit> {
        let of = |(stage, units): (UnitStage, &[UnitBlocks])| {
            let all = units.iter().map(|unit| unit.blocks.len()).sum::<usize>() as f64;
            let listed = |unit: &UnitBlocks| Unit {
                unit: unit.unit,
                stage,
                first: unit.blocks[0],
                blocks: unit.blocks.len() as u64,
                share: unit.blocks.len() as f64 / all,
            };
            units.iter().map(listed).collect::<Vec<_>>()
        };
        let stages = [(UnitStage::Simulate, &self.simulate[..]), (UnitStage::Reconstruct, &self.reconstruct)];
        stages.into_iter().flat_map(of).collect()
    }
}

/// Blocks of so many bytes in all, in units numbered from `first` on.
fn divided(blocks: &[u64], bytes: u64, first: u64) -> Vec<UnitBlocks> {
    let all = blocks.len() as u64;
    let count = UNITS.max(bytes.div_ceil(UNIT_BYTES)).min(MOST_UNITS).min(all);
    let end = |i: u64| (u128::from(i) * u128::from(all) / u128::from(count.max(1))) as usize;
    let unit = |i: u64| UnitBlocks { unit: first + i, blocks: blocks[end(i)..end(i + 1)].to_vec() };
    (0..count).map(unit).collect()
}

/// A process's part in a job.
struct Worker<'a> {
    identity: Identity,
    checkpoint: &'a Checkpoint,
    observer: &'a dyn Observer,
    done: WorkDone,
}

impl<'a> Worker<'a> {
    fn new(identity: Identity, units: &Units, job: &JobOptions<'a>) -> Result<Self> {
        let simulation = units.simulate.len() as u64;
        let done = WorkDone { units: units.len(), simulation, ..WorkDone::default() };
        let worker = Self { identity, checkpoint: job.checkpoint, observer: job.observer, done };
        worker.checkpoint.take_segments(&worker.identity, worker.observer)?;
        Ok(worker)
    }

    /// Those units that are not stored, or damaged; all that are stored are read.
    fn missing(&mut self, stage: Stage, units: &[UnitBlocks]) -> Result<Vec<UnitBlocks>> {
        let mut missing = Vec::new();
        for unit in units {
            if !self.checkpoint.has_unit(stage, unit, self.observer)? {
                missing.push(unit.clone());
            }
        }
        self.done.found += (units.len() - missing.len()) as u64;
        Ok(missing)
    }

    /// The units that are not stored; one that is damaged is computed by whoever takes it up.
    fn left(&self, stage: Stage, units: &[UnitBlocks]) -> Vec<u64> {
        units.iter().filter(|unit| !self.checkpoint.lists_unit(stage, unit)).map(|unit| unit.unit).collect()
    }

    /// Computes units, and takes up all that were stored meanwhile.
    fn compute(
        &mut self,
        (stage, missing): (Stage, &[UnitBlocks]),
        compute: impl FnOnce(SegmentWriter<'_>, &GracefulStop<'_>) -> Result<()>,
    ) -> Result<()> {
        if !missing.is_empty() {
            let stop = GracefulStop::new(self.checkpoint, self.observer);
            let writer = SegmentWriter::new(self.checkpoint, &self.identity, (stage, missing), self.observer);
            compute(writer, &stop)?;
            self.done.computed.extend(missing.iter().map(|unit| unit.unit));
        }
        // What was said of the segments was said before.
        self.checkpoint.take_segments(&self.identity, &Silent)
    }

    /// Simulates units of tiles.
    fn simulate(&mut self, wanted: &[UnitBlocks], prepared: &PreparedScene) -> Result<()> {
        let missing = self.missing(Stage::Cube, wanted)?;
        self.compute((Stage::Cube, &missing), |writer, stop| {
            prepared.simulate_tiles(&mut WantedTiles::new(writer, stop), stop)
        })
    }

    /// Reconstructs units of depths from a cube.
    fn reconstruct(
        &mut self,
        missing: &[UnitBlocks],
        source: &mut dyn CubeSource,
        grid: &Grid,
        (budget, samples): (&MemoryBudget<'_>, JobArrays),
    ) -> Result<()> {
        self.compute((Stage::Volume, missing), |writer, stop| {
            let arrays = budget.reconstructing(std::iter::empty::<&str>(), grid, false, samples);
            budget.check(source.instrument(), grid, &arrays, stop)?;
            let mut sink = WantedDepths::new(writer, grid.plane_len(), stop);
            reconstruct_stored(source, grid, &budget.options(&arrays), &mut sink, &mut NoStore, stop)?;
            Ok(())
        })
    }

    /// What was done, and what is left.
    fn done(mut self, units: &Units) -> WorkDone {
        let mut missing = self.left(Stage::Cube, &units.simulate);
        self.done.simulation_left = missing.len() as u64;
        missing.extend(self.left(Stage::Volume, &units.reconstruct));
        WorkDone { left: missing.len() as u64, missing, ..self.done }
    }
}

fn prepared(run: &RunFile, job: &JobOptions) -> Result<(PreparedScene, Units)> {
    let prepared = PreparedScene::of(&MemoryBudget::of(run), job.known(), false, job.observer)?;
    let mut tiles = ListedTiles::default();
    prepared.simulate_tiles(&mut tiles, &Silent)?;
    let simulations = prepared.measurement.options.simulations(prepared.instrument()) as u64;
    let bytes = prepared.instrument().cube_bytes().saturating_mul(simulations);
    let units = Units::new(&tiles.0, bytes, run, &prepared.grid);
    Ok((prepared, units))
}

/// The units of a scene's image, of which those of its simulation are its cube's. Cost: the scene is loaded and sampled.
///
/// # Errors
/// Those of [`image_scene`](crate::pipeline::image_scene) before its simulation.
pub fn units_of_scene(run: &RunFile, job: &JobOptions) -> Result<Vec<Unit>> {
    need_bandwidth("[sweep]", &run.sweep()?)?;
    Ok(prepared(run, job)?.1.listed())
}

/// The units of a cube's image, and of its volume: its depths.
///
/// # Errors
/// A run file without a grid.
pub fn units_of_cube(run: &RunFile, cube: &CubeFile) -> Result<Vec<Unit>> {
    let grid = run.voxels(cube.instrument(), None)?;
    Ok(Units::new(&[], 0, run, &grid).listed())
}

/// Computes units of a scene's image into segments of the checkpoint: of the simulation, and once all of that is stored, by
/// whichever processes, of the reconstruction.
///
/// The cube is simulated tile by tile, of which only those wanted take memory; for the reconstruction it is in memory as a
/// whole, the volume never. The scene is read and sampled by every process.
///
/// # Errors
/// Those of [`image_scene`](crate::pipeline::image_scene); units of depths asked for by number before the cube is there; a
/// segment that cannot be written.
pub fn work_on_scene(run: &RunFile, wanted: &Wanted, job: &JobOptions) -> Result<WorkDone> {
    need_bandwidth("[sweep]", &run.sweep()?)?;
    let (prepared, units) = prepared(run, job)?;
    prepared.warn(run, job, job.observer);
    check(wanted, &units)?;
    let mut worker = Worker::new(identity::of_scene("image", run, &prepared), &units, job)?;
    worker.simulate(wanted.of(&units.simulate), &prepared)?;
    let (depths, left) = (wanted.of(&units.reconstruct), worker.left(Stage::Cube, &units.simulate).len());
    if left > 0 && !depths.is_empty() && matches!(wanted, Wanted::Numbers(_)) {
        let all = units.simulate.len();
        return Err(Error::input(
            "--units",
            format!(
                "{} and more are depths, which are reconstructed from the whole cube, and {left} of the {all} units of the \
                 simulation are not stored yet; compute units 0-{} first",
                depths[0].unit,
                all - 1
            ),
        ));
    }
    let missing = if left == 0 { worker.missing(Stage::Volume, depths)? } else { Vec::new() };
    // A cube is made only for depths that are missing.
    if !missing.is_empty() {
        let cube = {
            let stop = GracefulStop::new(job.checkpoint, job.observer);
            prepared.simulate(run, &mut CheckpointStore::new(job.checkpoint, Stage::Cube, &stop), &stop)?
        };
        worker.reconstruct(
            &missing,
            &mut &cube,
            &prepared.grid,
            (&MemoryBudget::of(run), prepared.arrays),
        )?;
    }
    Ok(worker.done(&units))
}

/// Computes units of a scene's simulation into segments of the checkpoint, for
/// [`simulate_scene`](crate::pipeline::simulate_scene), or where `output` is a recording (.wav) for
/// [`record_scene`](crate::pipeline::record_scene). Memory: the tiles that are wanted, never the cube.
///
/// # Errors
/// Those of these functions before their simulation; a segment that cannot be written.
pub fn work_on_simulation(
    run: &RunFile,
    output: &Path,
    wanted: &Wanted,
    job: &JobOptions,
) -> Result<WorkDone> {
    let recorded = if extension(output) == "wav" { Some(recording::recorded(run)?) } else { None };
    let run = recorded.as_ref().unwrap_or(run);
    let (prepared, mut units) = prepared(run, job)?;
    units.reconstruct.clear();
    prepared.warn(run, job, job.observer);
    check(wanted, &units)?;
    let mut worker = Worker::new(identity::of_scene("simulate", run, &prepared), &units, job)?;
    worker.simulate(wanted.of(&units.simulate), &prepared)?;
    Ok(worker.done(&units))
}

/// Computes units of a cube's image, which are depths, into segments of the checkpoint. Memory: as `reconstruct` takes, for
/// the volume is never held.
///
/// # Errors
/// Those of [`image_cube`](crate::pipeline::image_cube); a segment that cannot be written.
pub fn work_on_cube(run: &RunFile, cube: CubeFile, wanted: &Wanted, job: &JobOptions) -> Result<WorkDone> {
    need_bandwidth("the cube's `frequencies`", &cube.instrument().sweep)?;
    work_on_depths("image", run, cube, wanted, job)
}

/// Computes units of a cube's volume into segments, for [`reconstruct_cube`](crate::pipeline::reconstruct_cube).
///
/// # Errors
/// Those of [`reconstruct_cube`](crate::pipeline::reconstruct_cube); a segment that cannot be written.
pub fn work_on_reconstruction(
    run: &RunFile,
    cube: CubeFile,
    wanted: &Wanted,
    job: &JobOptions,
) -> Result<WorkDone> {
    work_on_depths("reconstruct", run, cube, wanted, job)
}

fn work_on_depths(
    name: &str,
    run: &RunFile,
    cube: CubeFile,
    wanted: &Wanted,
    job: &JobOptions,
) -> Result<WorkDone> {
    let mut cube = cube.calibrated(&run.calibration(), job.observer)?;
    let grid = run.voxels(cube.instrument(), None)?;
    let units = Units::new(&[], 0, run, &grid);
    check(wanted, &units)?;
    let mut worker = Worker::new(identity::of_cube(name, run, &mut cube, &grid)?, &units, job)?;
    let samples = JobArrays::measured(cube.instrument(), cube.held_bytes());
    let missing = worker.missing(Stage::Volume, wanted.of(&units.reconstruct))?;
    worker.reconstruct(&missing, &mut cube, &grid, (&MemoryBudget::of(run), samples))?;
    Ok(worker.done(&units))
}

/// Refuses units that there are not.
fn check(wanted: &Wanted, units: &Units) -> Result<()> {
    let count = units.len();
    if count == 0 {
        let problem = "works on the whole volume, which cannot be shared; use `image` or `reconstruct` alone, or method = \"none\"";
        return Err(Error::input("[refine]", problem));
    }
    match wanted {
        Wanted::Part { part, of } if *part == 0 || part > of => {
            Err(Error::input("--part", format!("{part}/{of} was expected to be from 1/{of} to {of}/{of}")))
        }
        Wanted::Numbers(numbers) if numbers.is_empty() || numbers.end > count => Err(Error::input(
            "--units",
            format!("the job has units 0-{}, and a range of these was expected", count - 1),
        )),
        _ => Ok(()),
    }
}
