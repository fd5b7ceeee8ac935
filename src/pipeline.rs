//! The stages in order: [`image_scene`] and [`image_cube`] are the main jobs.
//!
//! Only this module and the command line use the run file. Stages are timed and their warnings collected for the report;
//! `outputs` writes the files, and `limits` checks the same result against the run file's `[expect]`.
//!
//! # Example
//! ```
//! use holosonar::config::RunFile;
//! use holosonar::pipeline::{JobOptions, image_scene};
//! use std::path::Path;
//!
//! let run = RunFile::load(Path::new("scenes/point.toml"), &[])?;
//! let outcome = image_scene(&run, &JobOptions::default())?;
//! assert!((outcome.image.volume.peak() - 1.0).abs() < 0.01);
//! assert!(outcome.depth.accepted() > 0 && outcome.truth.is_none());
//! # Ok::<(), holosonar::error::Error>(())
//! ```

mod bare_mesh;
mod cubes;
mod design;
mod facts;
mod forecast;
mod job;
mod limits;
mod maps;
mod memory;
mod oracle;
mod outputs;
mod prepared_scene;
mod recording;
mod report;

pub use bare_mesh::BareMesh;
pub use cubes::{
    ascan_cube, ascan_scene, autofocus_cube, image_cube, image_samples, reconstruct_cube,
    reconstruct_samples, self_calibrate_cube,
};
pub use design::{
    BudgetRow, Combination, DesignCost, DesignFront, DesignRow, DesignScores, DesignSweep, InstrumentBudget,
    RunWith, SweepSimulation, SweepWork, SweptKey, point_spreads, simulate_designs, sweep_designs,
    work_on_designs,
};
pub(crate) use facts::{aperture_of_file, resolution_of};
pub use facts::{facts_of_attributes, resolution_in};
pub use forecast::{CommandMemory, Forecast, forecast_cube, forecast_scene};
pub use job::JobOptions;
pub use job::units::{
    ShardsLeft, Unit, UnitStage, Wanted, WorkDone, units_of_cube, units_of_scene, work_on_cube,
    work_on_reconstruction, work_on_scene, work_on_simulation,
};
pub(crate) use limits::measure_of;
pub use limits::{Bound, Judgement, LimitVerdict, check_scene, hold};
pub use maps::{depth_in_volume, depth_of_volume, truth_of_scene, write_preview};
pub use oracle::{Oracle, oracle_of_scene};
#[cfg(feature = "python")]
pub(crate) use outputs::check_cube_name;
pub(crate) use outputs::{announce_outputs, error_note};
pub use outputs::{write_cube, write_depth, write_outputs, write_page, write_volume};
pub use recording::record_scene;
pub use report::{Multipath, Report, SceneSummary};

use crate::acquisition::{CodeReport, CubeSource, DataCube, Detection, Instrument, Sweep};
use crate::blocks::BlockStore;
use crate::checkpoint::{Checkpoint, CheckpointStore, CheckpointedVolume, GracefulStop, SharedTones, Stage};
use crate::config::{RunFile, SceneTable};
use crate::depth::{ArraySidelobes, DepthOptions, Refine, locate_depth_beside};
use crate::error::{Error, Result};
use crate::export::points_ply::SceneMesh;
use crate::files::extension;
use crate::grid::{DepthMap, Grid, Raster, Volume};
use crate::metrics::{Metrics, Scores, score};
use crate::plan::{JobArrays, Plan, Smear};
use crate::progress::{Observer, stage};
use crate::reconstruct::{
    GridSurroundings, ReconstructOptions, Reconstruction, ReconstructionInfo, VolumeSink, reconstruct_stored,
};
use crate::reflectors::Reflectors;
use crate::scene::Scene;
use job::{identity, kept::KnownScene, log::Log};
use maps::truth_of;
use memory::MemoryBudget;
use prepared_scene::{Held, PreparedScene};
use std::path::Path;
use std::sync::Arc;

/// Everything that one run computes, before anything is written.
#[derive(Debug)]
#[non_exhaustive]
pub struct Outcome {
    /// The plan: resolution, ambiguity, aliasing and sizes as predicted.
    pub plan: Plan,
    /// The scene, when there was one.
    pub scene: Option<SceneSummary>,
    /// The surfaces of the scene, decimated; only a mesh scene has some, and only with `[output] points`.
    pub mesh: Option<SceneMesh>,
    /// The reflectors simulated, when they were; of several speakers those that the first lights. Without bounced ones.
    pub reflectors: Option<Reflectors>,
    /// The bounced echoes beside them, if there are any.
    pub multipath: Option<Multipath>,
    /// What was simulated in addition to Eq. 5, and how the volume was corrected, in words.
    pub physics: Vec<String>,
    /// What the motion of the scene does to its image, if something moves.
    pub motion: Vec<Smear>,
    /// What the code of loudspeakers that sound at once is worth, if they do.
    pub coding: Option<CodeReport>,
    /// The instrument of the measurement, simulated or real.
    pub instrument: Instrument,
    /// The volume, and how it was computed.
    pub image: Reconstruction,
    /// The array's sidelobes that depth was told of.
    pub sidelobes: ArraySidelobes,
    /// The depth map found in the volume.
    pub depth: DepthMap,
    /// The true depth map; only a mesh scene has one.
    pub truth: Option<DepthMap>,
    /// The depth map compared with the truth: overall, by material and by surface.
    pub scores: Option<Scores>,
    /// Seconds per stage, in order.
    pub timings: Vec<(String, f64)>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
}

impl Outcome {
    /// The overall metrics of the depth map, if the truth is known.
    pub fn metrics(&self) -> Option<Metrics> {
        self.scores.as_ref().map(|scores| scores.all)
    }

    /// The metadata of its files.
    pub(crate) fn facts(&self, run: &RunFile) -> serde_json::Value {
        facts::image_facts(&self.instrument, run, &self.image.info(), self.sidelobes)
    }
}

/// Images a scene: loads, samples, plans, simulates, reconstructs, locates depth, traces the truth and scores.
///
/// Finished blocks are stored in the checkpoint, and those of an interrupted run are not computed again;
/// [`Checkpoint::remove`] deletes them once the files are written.
///
/// # Errors
/// The errors of the stages; a run file without a scene; a disk without space for the files; another process that works on
/// the same job.
pub fn image_scene(run: &RunFile, job: &JobOptions) -> Result<Outcome> {
    let JobOptions { checkpoint, observer, .. } = *job;
    let log = Log::new(observer);
    need_bandwidth("[sweep]", &run.sweep()?)?;
    let budget = MemoryBudget::of(run);
    let (prepared, mesh) = log.timed("scene", || {
        let prepared = PreparedScene::of(&budget, job.known(), Held::Image, &log)?;
        let scene = prepared.scene.as_ref().filter(|_| run.output.points);
        let mesh = scene.map(|scene| SceneMesh::decimated(scene));
        Ok((prepared, mesh))
    })?;
    let raster = run.raster(prepared.scene.as_ref().and_then(|scene| scene.camera()))?;
    prepared.warn(run, job, &log);
    let volume = outputs::volume_bytes(run, &prepared.grid);
    checkpoint.check_space(volume)?;
    checkpoint.open(&identity::of_scene("image", run, &prepared), observer)?;
    let sidelobes = facts::sidelobes(prepared.instrument(), run);
    let cube = log.timed("simulate", || simulate(run, &prepared, checkpoint, &log))?;
    let (image, depth) = reconstruct_and_locate(
        &budget,
        &mut &cube,
        &prepared.grid,
        (raster, prepared.arrays, sidelobes),
        checkpoint,
        &log,
    )?;
    drop(cube);
    let truth = prepared.scene.as_ref().map(|scene| {
        log.timed("truth", || {
            truth_of((scene, job.known()), run, (prepared.instrument(), &prepared.grid), &log)
        })
    });
    let truth = truth.transpose()?;
    let aperture = prepared.instrument().aperture();
    let scores = truth.as_ref().map(|truth| score(&depth, truth, aperture)).transpose()?;
    let (timings, warnings) = log.finish();
    let mut physics = prepared.measurement.physics(run);
    physics.extend(prepared.multipath.iter().flat_map(Multipath::lines));
    let motion = facts::smears(run, prepared.instrument(), &prepared.grid);
    physics.extend(motion.iter().map(ToString::to_string));
    Ok(Outcome {
        scene: prepared.summary(),
        mesh,
        physics,
        motion,
        coding: prepared.measurement.code_report(),
        plan: prepared.plan,
        reflectors: prepared.reflectors.into_iter().next().map(Reflectors::without_bounced),
        multipath: prepared.multipath,
        instrument: prepared.measurement.instrument,
        image,
        sidelobes,
        depth,
        truth,
        scores,
        timings,
        warnings,
    })
}

/// Simulates the cube of a scene; the checkpoint is used as by [`image_scene`].
///
/// # Errors
/// The errors of the stages; a run file without a scene; a disk without space for the file; another process that works on
/// the same job.
pub fn simulate_scene(run: &RunFile, job: &JobOptions) -> Result<DataCube> {
    let JobOptions { checkpoint, observer, .. } = *job;
    let prepared = PreparedScene::of(&MemoryBudget::of(run), job.known(), Held::Cube, observer)?;
    prepared.warn(run, job, observer);
    let bytes = prepared.instrument().cube_bytes();
    // In-phase samples are written without imaginary parts.
    let written = if prepared.instrument().detection == Detection::InPhase { bytes / 2 } else { bytes };
    checkpoint.check_space(written)?;
    checkpoint.open(&identity::of_scene("simulate", run, &prepared), observer)?;
    simulate(run, &prepared, checkpoint, observer)
}

/// Refuses to locate depth with a single frequency, before the long work rather than after it.
fn need_bandwidth(place: &str, sweep: &Sweep) -> Result<()> {
    if sweep.bandwidth() > 0.0 {
        return Ok(());
    }
    Err(Error::input(
        place,
        "is a single frequency, but depth needs a bandwidth (the range resolution is c/2B); use several frequencies, or \
         `simulate` and `reconstruct`, which need no bandwidth",
    ))
}

/// Simulates a scene, with a checkpoint of its tiles.
fn simulate(
    run: &RunFile,
    prepared: &PreparedScene,
    checkpoint: &Checkpoint,
    observer: &dyn Observer,
) -> Result<DataCube> {
    let stop = GracefulStop::new(checkpoint, observer);
    let mut store = CheckpointStore::new(checkpoint, Stage::Cube, &stop);
    prepared.simulate(run, &mut store, &stop)
}

/// Reconstructs a volume, with a checkpoint of its depths.
fn reconstruct(
    source: &mut dyn CubeSource,
    grid: &Grid,
    options: &ReconstructOptions,
    sink: &mut dyn VolumeSink,
    checkpoint: &Checkpoint,
    observer: &dyn Observer,
) -> Result<ReconstructionInfo> {
    let stop = GracefulStop::new(checkpoint, observer);
    let mut sink = CheckpointedVolume::new(checkpoint, sink, grid, &stop);
    let mut steps = CheckpointStore::new(checkpoint, Stage::Refinement, &stop);
    let mut tones = SharedTones::new(checkpoint, None, &stop);
    let store: &mut (dyn BlockStore + Send) = if options.refine.is_some() { &mut steps } else { &mut tones };
    let info = reconstruct_stored(source, grid, options, &mut sink, store, &stop)?;
    sink.finish()?;
    Ok(info)
}

/// Reconstructs a cube and locates depth in the volume.
fn reconstruct_and_locate(
    budget: &MemoryBudget,
    source: &mut dyn CubeSource,
    grid: &Grid,
    (raster, arrays, sidelobes): (Option<Raster>, JobArrays, ArraySidelobes),
    checkpoint: &Checkpoint,
    log: &Log,
) -> Result<(Reconstruction, DepthMap)> {
    let aperture = source.instrument().aperture();
    let options = budget.options(&budget.imaging(source.instrument(), grid, arrays));
    // Allocated when the reconstruction begins, so that nothing is allocated for a job that is refused.
    let mut volume = Volume { grid: *grid, samples: Vec::new() };
    let info =
        log.timed("reconstruct", || reconstruct(source, grid, &options, &mut volume, checkpoint, log))?;
    let mut image = Reconstruction::new(volume, &info);
    let [depths, rows, columns] = grid.shape();
    let (method, error_bound, peak) = (image.method, image.error_bound, image.volume.peak());
    log.note(&format!(
        "{method}, {columns} x {rows} x {depths} voxels, each to within {error_bound:.1e}; the peak is {peak:.3e}"
    ));
    if let Some(refinement) = &image.refinement {
        log.note(&refinement.to_string());
    }
    if let Some(correlation) = &image.correlation {
        log.note(&correlation.to_string());
    }
    let resolution = facts::resolution(aperture, image.correlation.as_ref());
    let mut search = budget.run.depth_options(resolution, sidelobes);
    (search.raster, search.floor) = (raster, info.incoherent_level.unwrap_or(0.0));
    let depth = log.timed("depth", || locate(source, &options, &mut image, search, log))?;
    depth.check()?;
    log.note(&format!("a return at {} of {} pixels", depth.accepted(), depth.len()));
    if peak == 0.0 {
        log.warn("every sample is 0, and so is every voxel");
    }
    if depth.accepted() == 0 {
        log.warn(
            "no return was accepted anywhere: nothing in the grid reflects sound, or too weakly beside what is outside, or \
             [depth] confidence_db is too high; the files are valid, but empty",
        );
    }
    Ok((image, depth))
}

/// Locates depth, listening to what is outside the grid where the volume may show its sidelobes.
fn locate(
    source: &mut dyn CubeSource,
    options: &ReconstructOptions,
    image: &mut Reconstruction,
    mut search: DepthOptions,
    observer: &dyn Observer,
) -> Result<DepthMap> {
    let volume = image.volume.view();
    let surroundings = GridSurroundings::of(source.instrument(), &volume.grid, options)
        .filter(|_| search.refine == Refine::Surface);
    let level = image.incoherent_level.unwrap_or(0.0);
    let sidelobes = surroundings.as_ref().is_some_and(|around| around.may_show(volume, level));
    let mut heard = None;
    let mut listen = || match &surroundings {
        Some(around) => around.loudest(source, observer).map(|level| *heard.insert(level)),
        None => Ok(0.0),
    };
    if sidelobes {
        search.outside = listen()?;
    }
    let (depth, looks) = locate_depth_beside(volume, &search, &mut listen, observer)?;
    // Where it does not count, the volume's file is that of `reconstruct`, which does not listen.
    image.outside_level = heard.filter(|_| looks.outshone);
    if looks.mirrors {
        observer.warn(
            "this looks like mirrors: only where they send the sound back to the array is a surface reported, and what is \
             weak beside such a glint is left out",
        );
    }
    Ok(depth)
}

fn warn_all(warnings: &[String], observer: &dyn Observer) {
    for warning in warnings {
        observer.warn(warning);
    }
}

/// Reads a scene as a reported stage, since a million triangles take seconds; a bare mesh has been read already.
fn load_scene(run: &RunFile, known: KnownScene<'_>, observer: &dyn Observer) -> Result<Arc<Scene>> {
    let scene = known.scene(run, || {
        let options = run.load_options()?;
        let load = || match &run.scene.mesh {
            Some(mesh) => Scene::load_with(&mesh.path, &options, observer),
            None => Scene::assemble(&run.part_files(), &options, observer),
        };
        stage(observer, "reading the scene", 0, load).map(Arc::new)
    })?;
    observer.note(&format!("{} triangles, {:.3} m²", scene.triangles().len(), scene.surface_area()));
    Ok(scene)
}

/// The scene's list of reflectors; `None` where it consists of meshes.
///
/// # Errors
/// A run file without a scene.
fn reflector_list(run: &RunFile) -> Result<Option<&Path>> {
    match &run.scene.mesh {
        Some(file) => Ok(Some(file.path.as_path()).filter(|path| extension(path) == "csv")),
        None if run.scene.parts.is_empty() => Err(Error::input(
            "[scene] mesh",
            "is missing; name a mesh (.obj, .gltf, .glb, .stl, .ply) or a reflector list (.csv), or give [[scene.parts]]",
        )),
        None => Ok(None),
    }
}

/// Whether a run file's scene has surfaces, and so a true depth.
pub fn has_truth(run: &RunFile) -> bool {
    reflector_list(run).is_ok_and(|list| list.is_none())
}

/// Reads the surfaces of a scene for their true depth.
fn load_surfaces(run: &RunFile, known: KnownScene<'_>, observer: &dyn Observer) -> Result<Arc<Scene>> {
    match reflector_list(run)? {
        None => load_scene(run, known, observer),
        Some(list) => Err(Error::input(
            list.display(),
            "is a list of reflectors, which have no surfaces and so no true depth; a mesh was expected",
        )),
    }
}

/// Whether the formats of all the scene's files define their unit as metres: glTF does.
fn is_in_metres(scene: &SceneTable) -> bool {
    scene.files().all(|file| ["gltf", "glb"].contains(&extension(&file.path).as_str()))
}
