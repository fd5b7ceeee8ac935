//! Predictions of a job, for `plan`: everything that can be known before the scene is traced or any sample computed.

use super::design::{InstrumentBudget, instrument_budget};
use super::facts::{beyond_the_sum, smears};
use super::job::JobOptions;
use super::memory::{MemoryBudget, SceneSize};
use super::prepared_scene::{Measurement, placement_warnings};
use super::{is_in_metres, load_scene, outputs, reflector_list};
use crate::acquisition::{CodeReport, CubeFile, CubeSource, Instrument, RecordingSize};
use crate::config::RunFile;
use crate::error::{Result, gib};
use crate::grid::{Axis, Grid};
use crate::plan::design::Suggestion;
use crate::plan::{AcquisitionTime, Design, JobArrays, MemoryEstimate, Plan, Smear, design, plan};
use crate::progress::Observer;
use crate::reconstruct::{Correlation, Estimate, estimate};
use crate::reflectors::TracingForecast;
use serde::Serialize;
use std::path::Path;

/// The predicted resolution, cost and files of a job.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Forecast {
    /// Resolution, ambiguity, aliasing.
    pub plan: Plan,
    /// Widths, grating lobes and sidelobes, and what would fix each warning.
    pub design: Design,
    /// The voxels, as typed or chosen.
    pub grid: Grid,
    /// Every method, whether applicable or not, with its operations and bytes.
    pub methods: Vec<Estimate>,
    /// Index of the method that the job uses.
    pub chosen: usize,
    /// How microphones will be correlated, if they will.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub correlation: Option<Correlation>,
    /// Worker threads.
    pub threads: usize,
    /// Peak memory of each command that does the job or a part of it, `image` first.
    pub memory: Vec<CommandMemory>,
    /// What will be simulated in addition to Eq. 5, and how the volume will be corrected, in words.
    pub physics: Vec<String>,
    /// Seconds of each method, from a short measurement of this computer's speed.
    pub seconds: Vec<f64>,
    /// What tracing bounces and edges comes to, of a scene with any; of several speakers for each.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tracing: Option<TracingForecast>,
    /// Resolution cells across the scene along x and y, at the depth of its middle; `None` without a scene.
    pub resolution_cells: Option<[Option<f64>; 2]>,
    /// Files that `image` will write.
    pub files: Vec<String>,
    /// How long the measurement takes, of a scene.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub acquisition: Option<AcquisitionTime>,
    /// The recording that `simulate` writes into a file `.wav`, if `[recording]` says how.
    pub recording: Option<RecordingSize>,
    /// What the motion of the scene does to its image, if something moves.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub motion: Vec<Smear>,
    /// What the code of loudspeakers that sound at once is worth, if they do.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coding: Option<CodeReport>,
    /// What each element of `[instrument]` costs, if there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub budget: Option<InstrumentBudget>,
    /// Warnings for the user.
    pub warnings: Vec<String>,
}

/// The memory of a command.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[non_exhaustive]
pub struct CommandMemory {
    /// `image`; `simulate`, if there is a scene; or `reconstruct`, from a cube file to a volume that is written depth by depth
    /// (.npz, .zarr, .vti, .nrrd).
    pub command: &'static str,
    /// Peak memory, bytes.
    pub bytes: u64,
    /// The stage of the peak, and its arrays.
    pub peak: MemoryEstimate,
}

impl CommandMemory {
    fn new(command: &'static str, peak: MemoryEstimate) -> Self {
        Self { command, bytes: peak.total(), peak }
    }
}

/// As in "1.2 GiB for `image`, at its peak reconstructing: samples 1 GiB".
impl std::fmt::Display for CommandMemory {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} for `{}`, at its peak {}", gib(self.bytes), self.command, self.peak)
    }
}

/// Predicts `image` of a scene. The mesh is loaded for its size; with bounces or edges a few of their paths are traced.
///
/// # Errors
/// A run file without a scene, or with an invalid one; a grid that is missing and cannot be chosen.
pub fn forecast_scene(run: &RunFile, job: &JobOptions) -> Result<Forecast> {
    let measurement = Measurement::of(run)?;
    let instrument = &measurement.instrument;
    let mesh = reflector_list(run)?.is_none();
    let budget = MemoryBudget::of(run);
    let scene = if mesh { Some(load_scene(run, job.known(), job.observer)?) } else { None };
    let size = match &scene {
        Some(scene) => SceneSize::of_mesh(scene),
        None => SceneSize::of(run, job.known(), job.observer)?,
    };
    let bounds = size.bounds;
    let grid = run.voxels(instrument, bounds)?;
    let mut forecast =
        forecast(&budget, instrument, &grid, &measurement.imaging(&budget, &grid, &size), mesh)?;
    let simulation = measurement.simulating(&budget, &grid, &size).peak(0);
    forecast.memory.push(CommandMemory::new("simulate", simulation));
    forecast.memory.push(reconstruction(&budget, instrument, &grid, JobArrays::measured(instrument, 0))?);
    forecast.suggest_lattice(&budget, instrument);
    forecast.resolution_cells = bounds.map(|(low, high)| instrument.cells_across(low, high));
    forecast.acquisition = Some(measurement.acquisition_time(run, &grid));
    forecast.physics = measurement.physics(run);
    if let Some(scene) = &scene {
        let surfaces = size.surface_options(run, instrument, &grid);
        forecast.tracing = TracingForecast::of(scene, &surfaces, budget.threads)?;
    }
    forecast.motion = smears(run, instrument, &grid);
    forecast.coding = measurement.code_report();
    forecast.warnings.extend(forecast.coding.and_then(|coding| folded(&coding, &forecast.plan)));
    forecast.physics.extend(forecast.motion.iter().map(ToString::to_string));
    forecast.budget = instrument_budget(run, &measurement, &grid)?;
    if run.recording.dwell.is_some() {
        match RecordingSize::of(instrument, &run.recording_options(), &run.recorder_options()) {
            Ok(size) => forecast.recording = Some(size),
            Err(why) => forecast.warnings.push(format!("no recording can be simulated: {why}")),
        }
    }
    let mesh = mesh.then(|| is_in_metres(&run.scene));
    forecast.warnings.extend_from_slice(job.hints());
    forecast.warnings.extend(run.array.count_warning());
    forecast.warnings.extend(placement_warnings(instrument, &grid, bounds, mesh));
    Ok(forecast)
}

/// Predicts `image` of a cube file. No sample is read, unless `[calibration]` corrects them, which is tried.
///
/// # Errors
/// A missing or invalid grid; corrections that are impossible.
pub fn forecast_cube(run: &RunFile, cube: CubeFile, observer: &dyn Observer) -> Result<Forecast> {
    let cube = cube.calibrated(&run.calibration(), observer)?;
    let instrument = cube.instrument();
    let grid = run.voxels(instrument, None)?;
    let budget = MemoryBudget::of(run);
    let samples = JobArrays::measured(instrument, cube.held_bytes());
    let mut forecast =
        forecast(&budget, instrument, &grid, &budget.imaging(instrument, &grid, samples), false)?;
    forecast.memory.push(reconstruction(&budget, instrument, &grid, samples)?);
    forecast.suggest_lattice(&budget, instrument);
    forecast.physics = [cube.changes(), &forecast.physics].concat();
    Ok(forecast)
}

/// Warns of speakers whose own tones are too far apart for the grid.
fn folded(coding: &CodeReport, plan: &Plan) -> Option<String> {
    let [shortest, longest] = plan.path_bounds;
    // The sweep's own step tells so much apart.
    let unambiguous = plan.unambiguous_path? / coding.own_step.map(|_| coding.loudspeakers as f64)?;
    (longest - shortest > unambiguous).then(|| {
        format!(
            "the tones of each speaker tell paths apart up to {unambiguous:.2} m, and those of this grid differ by {:.2} m: what one \
             speaker shows twice the others do not, but it leaves ghosts; use a smaller [sweep] step, or kind = \"hadamard\"",
            longest - shortest
        )
    })
}

/// By how much a pitch may be changed to be on the microphones' lattice, as a factor.
const NEARBY: f64 = 1.25;

/// How many times as fast the job then has to be.
const FASTER: f64 = 1.5;

impl Forecast {
    /// Suggests voxels on the microphones' lattice where those are nearly as fine and take far less time.
    fn suggest_lattice(&mut self, budget: &MemoryBudget, instrument: &Instrument) {
        let Some(lattice) = instrument.array.lattice() else { return };
        let nearest = |voxels: &Axis, microphones: &Axis| {
            let times = microphones.pitch / voxels.pitch;
            match microphones.count.min(voxels.count) {
                0 | 1 => voxels.pitch,
                _ if times >= 1.0 => microphones.pitch / times.round(),
                _ => microphones.pitch * times.recip().round(),
            }
        };
        let Grid { x, y, z } = self.grid;
        let pitch = [nearest(&x, &lattice.x), nearest(&y, &lattice.y), z.pitch];
        let near = |voxels: &Axis, pitch: f64| (pitch / voxels.pitch).max(voxels.pitch / pitch) < NEARBY;
        let along = |voxels: &Axis, pitch: f64| Axis::spanning(voxels.first, voxels.last(), pitch);
        let (true, true, Ok(x), Ok(y)) =
            (near(&x, pitch[0]), near(&y, pitch[1]), along(&x, pitch[0]), along(&y, pitch[1]))
        else {
            return;
        };
        let options = budget.run.reconstruct_options();
        let Ok(there) = estimate(instrument, &Grid { x, y, z }, &options, self.threads) else { return };
        let times = self.methods[self.chosen].operations / there.chosen().operations;
        if times >= FASTER {
            let [x, y, z] = pitch;
            self.design.suggestions.push(Suggestion {
                fixes: "speed",
                set: vec![format!("grid.pitch=[{x}, {y}, {z}]")],
                effect: format!("voxels on the microphones' lattice: {times:.1} times as fast"),
            });
        }
    }
}

/// The memory of `reconstruct` from a file, of which some `samples` may be in memory.
fn reconstruction(
    budget: &MemoryBudget,
    instrument: &Instrument,
    grid: &Grid,
    samples: JobArrays,
) -> Result<CommandMemory> {
    let arrays = budget.reconstructing(std::iter::empty::<&Path>(), grid, false, samples);
    Ok(CommandMemory::new("reconstruct", budget.estimate(instrument, grid, &arrays)?.memory))
}

/// Predicts `image`, given its arrays.
pub(super) fn forecast(
    budget: &MemoryBudget,
    instrument: &Instrument,
    grid: &Grid,
    arrays: &JobArrays,
    truth: bool,
) -> Result<Forecast> {
    let run = budget.run;
    let plan = plan(instrument, grid);
    let design = design(instrument, grid, run.reconstruct.window);
    let estimate = budget.estimate(instrument, grid, arrays)?;
    Ok(Forecast {
        warnings: [plan.warnings.clone(), design.warnings.clone()].concat(),
        plan,
        design,
        grid: *grid,
        seconds: estimate.seconds(),
        methods: estimate.methods,
        chosen: estimate.chosen,
        correlation: Correlation::of(instrument, grid, &run.reconstruct_options()),
        threads: estimate.threads,
        memory: vec![CommandMemory::new("image", estimate.memory)],
        physics: beyond_the_sum(run, instrument),
        resolution_cells: None,
        tracing: None,
        files: outputs::names(run, truth),
        acquisition: None,
        recording: None,
        motion: Vec::new(),
        coding: None,
        budget: None,
    })
}
