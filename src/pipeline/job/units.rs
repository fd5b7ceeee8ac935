//! The work of an image, a cube or a volume in units that processes share, on one host or many: tiles of microphones to
//! simulate, a sweep to compress, depths to reconstruct, and shards of their Zarr store to encode.
//!
//! Units are planned from the whole job, so that its bytes do not depend on who computes what. Each is stored as a segment
//! beside the checkpoint of [`image_scene`](crate::pipeline::image_scene), [`image_cube`](crate::pipeline::image_cube),
//! [`simulate_scene`](crate::pipeline::simulate_scene) or [`reconstruct_cube`](crate::pipeline::reconstruct_cube), which take
//! up all that there are, compute the rest, and add the noise. Processes share a folder and the user's secret, and no word.

mod listed;
mod shards;
mod simulated;

use super::{JobOptions, identity, shared};
use crate::acquisition::{CubeFile, CubeSource, Instrument, simulation_plan_len};
use crate::blocks::BlockStore;
use crate::checkpoint::{
    Checkpoint, CheckpointStore, GracefulStop, Identity, ListedTiles, SegmentWriter, SharedNodes,
    SharedTones, Stage, UnitBlocks, WantedDepths, WantedTiles,
};
use crate::config::{RunFile, VolumeFormat};
use crate::error::{Error, Result};
use crate::files::extension;
use crate::grid::Grid;
use crate::pipeline::memory::MemoryBudget;
use crate::pipeline::prepared_scene::{Held, PreparedScene};
use crate::pipeline::{need_bandwidth, recording};
use crate::plan::JobArrays;
use crate::progress::{Observer, Silent};
use crate::reconstruct::{Method, ReconstructOptions, reconstruct_shared};
pub use listed::{ShardsLeft, Unit, UnitStage, Wanted};
use listed::{Units, check};
use num_complex::Complex32;
use serde::Serialize;
pub(super) use shards::StoredShards;
use simulated::SimulatedCube;
use std::path::Path;

/// What a process has done, and what is left of the job.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct WorkDone {
    /// Units of the job, of which those of the simulation come first.
    pub units: u64,
    /// Units of its simulation.
    pub simulation: u64,
    /// Units of its depths, which come after these and a compressed sweep.
    pub depths: u64,
    /// Units of the shards of a Zarr store, which come last.
    pub shards: u64,
    /// Numbers of the units that were computed now.
    pub computed: Vec<u64>,
    /// Units that were to be computed, and are stored already.
    pub found: u64,
    /// Units of the simulation that are not stored yet, which must be before any depth is reconstructed.
    pub simulation_left: u64,
    /// Whether a compressed sweep is stored, from which depths are reconstructed without the cube.
    pub compressed: bool,
    /// Units of shards that are not stored yet; the command that writes the store encodes them, too.
    pub shards_left: Vec<ShardsLeft>,
    /// Units of the job that are not stored yet.
    pub left: u64,
    /// Their numbers.
    pub missing: Vec<u64>,
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
        let depths = units.reconstruct.len() as u64;
        let shards = units.encode.len() as u64;
        let done = WorkDone { units: units.len(), simulation, depths, shards, ..WorkDone::default() };
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

    /// Notes units that were computed, and takes up all that were stored meanwhile.
    fn computed(&mut self, units: &[UnitBlocks]) -> Result<()> {
        self.done.computed.extend(units.iter().map(|unit| unit.unit));
        // What was said of the segments was said before.
        self.checkpoint.take_segments(&self.identity, &Silent)
    }

    /// Simulates units of tiles.
    fn simulate(
        &mut self,
        wanted: &[UnitBlocks],
        (prepared, plans): (&PreparedScene, &mut dyn BlockStore),
    ) -> Result<()> {
        let missing = self.missing(Stage::Cube, wanted)?;
        if !missing.is_empty() {
            let stop = GracefulStop::new(self.checkpoint, self.observer);
            let writer =
                SegmentWriter::new(self.checkpoint, &self.identity, (Stage::Cube, &missing), self.observer);
            prepared.simulate_tiles(&mut WantedTiles::new(writer, plans, &stop), &stop)?;
        }
        self.computed(&missing)
    }

    /// Whether compressing the sweep is left to do.
    fn lacks_tones(&self, units: &Units) -> bool {
        !self.left(Stage::Tones, &units.compress).is_empty()
    }

    /// Whether compressing the sweep is asked for by its number, and left to do.
    fn wants_tones(&mut self, wanted: &Wanted, units: &Units) -> bool {
        let (named, left) = (wanted.names(&units.compress), self.lacks_tones(units));
        self.done.found += u64::from(named && !left);
        named && left
    }

    /// The options of a reconstruction, if it fits in memory, and encoding its shards as well.
    fn options(
        &self,
        instrument: &Instrument,
        (grid, units): (&Grid, &Units),
        (budget, samples): (&MemoryBudget<'_>, JobArrays),
    ) -> Result<ReconstructOptions> {
        let store = units.shards.as_ref().map(|_| "volume.zarr");
        let known = self.checkpoint.lists_convolved_tones().then_some(Method::Convolution);
        let budget = MemoryBudget { known, ..*budget };
        let arrays = budget.reconstructing(store, grid, false, samples);
        budget.check(instrument, grid, &arrays, self.observer)?;
        Ok(budget.options(&arrays))
    }

    /// Reconstructs units of depths from a cube; if the compressed sweep is not stored, as a unit of its own first.
    fn reconstruct(
        &mut self,
        (units, missing): (&Units, &[UnitBlocks]),
        source: &mut dyn CubeSource,
        grid: &Grid,
        options: &ReconstructOptions,
    ) -> Result<()> {
        let lacks_tones = self.lacks_tones(units);
        let stop = GracefulStop::new(self.checkpoint, self.observer);
        let writer = |stage, units: &[UnitBlocks]| {
            SegmentWriter::new(self.checkpoint, &self.identity, (stage, units), self.observer)
        };
        let mut tones = SharedTones::new(self.checkpoint, Some(writer(Stage::Tones, &units.compress)), &stop);
        let mut sink = WantedDepths::new(writer(Stage::Volume, missing), grid.plane_len(), &stop);
        let nodes = SharedNodes::new(self.checkpoint, &self.identity, &stop);
        reconstruct_shared(source, grid, options, (&mut sink, &mut tones, Some(&nodes)), &stop)?;
        nodes.forget();
        if tones.finish(lacks_tones)? {
            self.done.computed.extend(units.compress.iter().map(|unit| unit.unit));
        }
        self.computed(missing)
    }

    /// What was done, and what is left.
    fn done(mut self, units: &Units) -> WorkDone {
        let mut missing = self.left(Stage::Cube, &units.simulate);
        self.done.simulation_left = missing.len() as u64;
        let depths = self.left(Stage::Volume, &units.reconstruct);
        // Nobody needs the tones of depths that are all there.
        if !depths.is_empty() {
            missing.extend(self.left(Stage::Tones, &units.compress));
        }
        missing.extend(depths);
        let shards = self.left(Stage::Shards, &units.encode);
        self.done.shards_left = units.shards_left(&shards);
        missing.extend(shards);
        let compressed = self.checkpoint.lists_tones();
        WorkDone { left: missing.len() as u64, missing, compressed, ..self.done }
    }
}

/// A scene, the units of a job that begins with it, and the plans of its simulations.
fn prepared<'a>(
    run: &RunFile,
    job: &JobOptions<'a>,
) -> Result<(PreparedScene, Units, shared::SimulationPlans<'a>)> {
    let prepared = PreparedScene::of(
        &MemoryBudget::of(run),
        job.known().shared_with_others(),
        Held::Tiles,
        job.observer,
    )?;
    let listed = || {
        let mut tiles = ListedTiles::default();
        prepared.simulate_tiles(&mut tiles, &Silent)?;
        Ok(tiles)
    };
    let simulations = prepared.measurement.options.simulations(prepared.instrument()) as u64;
    let bytes = prepared.instrument().cube_bytes().saturating_mul(simulations);
    // A tile has a microphone at least.
    let most =
        simulations * (prepared.instrument().transmissions() * prepared.instrument().array.len()) as u64;
    let microphones = prepared.instrument().array.len();
    let plan = prepared.reflectors.iter().map(|list| simulation_plan_len(list.len(), microphones)).max();
    let plan = plan.unwrap_or(0) * size_of::<Complex32>() as u64;
    let identity = identity::of_scene("tiles and plans", run, &prepared);
    let (tiles, plans) = shared::tiles((identity, most, plan), job, listed)?;
    let units = Units::new((&tiles, bytes), (run, writes_store(run)), prepared.instrument(), &prepared.grid);
    Ok((prepared, units, plans))
}

/// Whether an image is written as a Zarr store, too.
fn writes_store(run: &RunFile) -> bool {
    run.output.formats.contains(&VolumeFormat::Zarr)
}

/// The units of a scene's image, of which those of its simulation are its cube's. Cost: the scene is loaded and sampled.
///
/// # Errors
/// Those of [`image_scene`](crate::pipeline::image_scene) before its simulation.
pub fn units_of_scene(run: &RunFile, job: &JobOptions) -> Result<Vec<Unit>> {
    need_bandwidth("[sweep]", &run.sweep()?)?;
    Ok(prepared(run, job)?.1.listed())
}

/// The units of a cube's image: its sweep, its depths, and their shards. Those of its volume are the same, but for the shards,
/// which there are if the volume is a Zarr store.
///
/// # Errors
/// A run file without a grid.
pub fn units_of_cube(run: &RunFile, cube: &CubeFile) -> Result<Vec<Unit>> {
    let grid = run.voxels(cube.instrument(), None)?;
    Ok(Units::new((&[], 0), (run, writes_store(run)), cube.instrument(), &grid).listed())
}

/// Computes units of a scene's image into segments of the checkpoint: of the simulation, and once all of that is stored, by
/// whichever processes, of the reconstruction.
///
/// The cube is simulated tile by tile, of which only those wanted take memory. It is in memory as a whole where the sweep is
/// compressed, and for depths that are not summed from compressed sweeps; the volume never is. The scene is read by every
/// process, and its reflectors are placed by the first.
///
/// # Errors
/// Those of [`image_scene`](crate::pipeline::image_scene); units of depths asked for by number before the cube is there; a
/// segment that cannot be written.
pub fn work_on_scene(run: &RunFile, wanted: &Wanted, job: &JobOptions) -> Result<WorkDone> {
    need_bandwidth("[sweep]", &run.sweep()?)?;
    let (prepared, units, mut plans) = prepared(run, job)?;
    prepared.warn(run, job, job.observer);
    check(wanted, &units)?;
    let mut worker = Worker::new(identity::of_scene("image", run, &prepared), &units, job)?;
    worker.simulate(wanted.of(&units.simulate), (&prepared, &mut plans))?;
    let (depths, left) = (wanted.of(&units.reconstruct), worker.left(Stage::Cube, &units.simulate).len());
    // Depths that are summed from the tones of another process need no cube.
    let compressed = job.checkpoint.lists_tones();
    let needed = wanted.names(&units.compress) || !depths.is_empty();
    if left > 0 && !compressed && needed && matches!(wanted, Wanted::Numbers(_)) {
        let all = units.simulate.len();
        return Err(Error::input(
            "--units",
            format!(
                "{all} and more need the whole cube, and {left} of the {all} units of the simulation are not stored yet; \
                 compute units 0-{} first",
                all - 1
            ),
        ));
    }
    let missing = if left == 0 || compressed { worker.missing(Stage::Volume, depths)? } else { Vec::new() };
    if worker.wants_tones(wanted, &units) || !missing.is_empty() {
        let make = || {
            let stop = GracefulStop::new(job.checkpoint, job.observer);
            prepared.simulate(run, &mut CheckpointStore::new(job.checkpoint, Stage::Cube, &stop), &stop)
        };
        let mut cube = SimulatedCube::new(prepared.instrument(), &make);
        let samples = if compressed { 0 } else { prepared.arrays.samples };
        let arrays = JobArrays { samples, ..prepared.arrays };
        let limits = (&MemoryBudget::of(run), arrays);
        let options = worker.options(prepared.instrument(), (&prepared.grid, &units), limits)?;
        if !compressed {
            cube.make()?;
        }
        worker.reconstruct((&units, &missing), &mut cube, &prepared.grid, &options)?;
    }
    worker.encode(wanted, &units)?;
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
    let (prepared, units, mut plans) = prepared(run, job)?;
    let units = units.without_depths();
    prepared.warn(run, job, job.observer);
    check(wanted, &units)?;
    let mut worker = Worker::new(identity::of_scene("simulate", run, &prepared), &units, job)?;
    worker.simulate(wanted.of(&units.simulate), (&prepared, &mut plans))?;
    Ok(worker.done(&units))
}

/// Computes units of a cube's image into segments of the checkpoint. Memory: as `reconstruct` takes, for the volume is never
/// held.
///
/// # Errors
/// Those of [`image_cube`](crate::pipeline::image_cube); a segment that cannot be written.
pub fn work_on_cube(run: &RunFile, cube: CubeFile, wanted: &Wanted, job: &JobOptions) -> Result<WorkDone> {
    need_bandwidth("the cube's `frequencies`", &cube.instrument().sweep)?;
    work_on_depths("image", (run, writes_store(run)), cube, wanted, job)
}

/// Computes units of a cube's volume into segments, for [`reconstruct_cube`](crate::pipeline::reconstruct_cube), whose first
/// output is `output`.
///
/// # Errors
/// Those of [`reconstruct_cube`](crate::pipeline::reconstruct_cube); a segment that cannot be written.
pub fn work_on_reconstruction(
    run: &RunFile,
    cube: CubeFile,
    output: &Path,
    wanted: &Wanted,
    job: &JobOptions,
) -> Result<WorkDone> {
    work_on_depths("reconstruct", (run, extension(output) == "zarr"), cube, wanted, job)
}

fn work_on_depths(
    name: &str,
    (run, store): (&RunFile, bool),
    cube: CubeFile,
    wanted: &Wanted,
    job: &JobOptions,
) -> Result<WorkDone> {
    let mut cube = cube.calibrated(&run.calibration(), job.observer)?;
    let grid = run.voxels(cube.instrument(), None)?;
    let units = Units::new((&[], 0), (run, store), cube.instrument(), &grid);
    check(wanted, &units)?;
    let mut worker = Worker::new(identity::of_cube(name, run, &mut cube, &grid)?, &units, job)?;
    let samples = JobArrays::measured(cube.instrument(), cube.held_bytes());
    let missing = worker.missing(Stage::Volume, wanted.of(&units.reconstruct))?;
    if worker.wants_tones(wanted, &units) || !missing.is_empty() {
        let limits = (&MemoryBudget::of(run), samples);
        let options = worker.options(cube.instrument(), (&grid, &units), limits)?;
        worker.reconstruct((&units, &missing), &mut cube, &grid, &options)?;
    }
    worker.encode(wanted, &units)?;
    Ok(worker.done(&units))
}
