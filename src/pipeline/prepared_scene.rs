//! A prepared scene: its reflectors, with the instrument that measures them and the grid on which they are imaged.

use super::facts::beyond_the_sum;
use super::job::kept::KnownScene;
use super::memory::{MemoryBudget, SceneSize};
use super::{JobOptions, Multipath, SceneSummary, is_in_metres, load_scene, reflector_list, warn_all};
use crate::acquisition::{
    CodeReport, DataCube, Detection, HeardTones, Instrument, SimulateOptions, SourceCode, simulate_heard,
    simulate_resumable, simulate_tiles, simulation_bytes,
};
use crate::blocks::BlockStore;
use crate::config::{RunFile, SurfaceKind};
use crate::error::{Result, gib};
use crate::grid::Grid;
use crate::plan::{AcquisitionTime, JobArrays, Plan, TypedTimes, outside_warning, plan, scale_warnings};
use crate::progress::Observer;
use crate::reflectors::{Reflectors, SurfaceOptions};
use crate::scene::Scene;
use glam::DVec3;
use serde_json::json;
use std::sync::Arc;

/// What a job has in memory of what it computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Held {
    /// Tiles of a cube, one by one.
    Tiles,
    /// A cube.
    Cube,
    /// A cube and its image.
    Image,
}

/// How the run file's scene is measured.
#[derive(Debug)]
pub(super) struct Measurement {
    pub(super) instrument: Instrument,
    pub(super) options: SimulateOptions,
}

impl Measurement {
    pub(super) fn of(run: &RunFile) -> Result<Self> {
        let (instrument, options) = (run.instrument()?, run.simulate_options());
        options.code.as_ref().map_or(Ok(()), |code| code.check(&instrument))?;
        Ok(Self { instrument, options })
    }

    /// What is simulated in addition to Eq. 5, and how the volume is corrected, in words.
    pub(super) fn physics(&self, run: &RunFile) -> Vec<String> {
        let mut lines = self.options.physics(&self.instrument);
        lines.extend(bounces_in_words(run, &self.instrument));
        if run.scene.edges {
            lines.push("convex edges and rims diffract as those of rigid wedges, once".to_owned());
        }
        lines.extend(self.code_report().map(|report| report.to_string()));
        if let Some(air) = run.medium.air() {
            let (speed, temperature, humidity) = (self.instrument.sound_speed, air.temperature, air.humidity);
            lines.insert(
                0,
                format!("sound travels at {speed:.2} m/s, in air of {temperature} °C and {humidity} %"),
            );
        }
        lines.extend(beyond_the_sum(run, &self.instrument));
        lines
    }

    /// What a code of the loudspeakers is worth, if they have one.
    pub(super) fn code_report(&self) -> Option<CodeReport> {
        self.options.code.as_ref().and_then(|code| code.report(&self.instrument).ok())
    }

    /// How long it takes to measure what is in a grid.
    pub(super) fn acquisition_time(&self, run: &RunFile, grid: &Grid) -> AcquisitionTime {
        let sweeps = self.code_report().map_or(self.instrument.transmissions() as f64, |code| code.sweeps);
        let passes =
            self.options.electronics.as_ref().map_or(1, |electronics| electronics.passes(&self.instrument));
        let recording = &run.recording;
        let typed = TypedTimes {
            dwell: recording.dwell,
            signal: recording.signal,
            response: recording.response,
            sweeps: sweeps * passes as f64,
        };
        AcquisitionTime::of(&self.instrument, grid, &typed)
    }

    /// What simulating takes beside the samples.
    fn tiles_bytes(&self, budget: &MemoryBudget, grid: &Grid, size: &SceneSize) -> u64 {
        let reflectors = size.reflectors(budget.run, &self.instrument, grid);
        simulation_bytes(&self.instrument, (size.bounds, reflectors), &self.options, budget.threads)
    }

    /// The arrays of a job up to the simulated cube.
    fn arrays(&self, budget: &MemoryBudget, grid: &Grid, size: &SceneSize) -> JobArrays {
        let simulation = self.tiles_bytes(budget, grid, size);
        // Echoes at several frequencies are read into a cube of its own.
        let cube = self.instrument.cube_bytes();
        let echoes = if self.options.electronics.is_some() { cube } else { 0 };
        // What is recorded of coded loudspeakers, and what is decoded of it.
        let sweeps = |code: &SourceCode| code.sweeps(self.instrument.transmissions()) as u64;
        let coded = self.options.code.as_ref().map_or(0, |code| {
            cube.saturating_add(cube / self.instrument.transmissions() as u64 * sweeps(code))
        });
        let echoes = echoes.max(coded);
        let microphones = JobArrays::measured(&self.instrument, 0).microphones;
        JobArrays {
            microphones,
            samples: self.instrument.cube_bytes(),
            simulation: simulation.saturating_add(echoes),
            ..size.arrays(budget.run, &self.instrument, grid)
        }
    }

    /// The arrays of `image`.
    pub(super) fn imaging(&self, budget: &MemoryBudget, grid: &Grid, size: &SceneSize) -> JobArrays {
        budget.imaging(&self.instrument, grid, self.arrays(budget, grid, size))
    }

    /// The arrays of `simulate`.
    pub(super) fn simulating(&self, budget: &MemoryBudget, grid: &Grid, size: &SceneSize) -> JobArrays {
        let arrays = self.arrays(budget, grid, size);
        // To be written, in-phase samples are copied without their imaginary parts.
        let written = if self.instrument.detection == Detection::InPhase { arrays.samples / 2 } else { 0 };
        JobArrays { simulation: arrays.simulation.max(written), ..arrays }
    }

    /// The arrays of tiles that are simulated one by one, without the cube.
    fn simulating_tiles(&self, budget: &MemoryBudget, grid: &Grid, size: &SceneSize) -> JobArrays {
        let simulation = self.tiles_bytes(budget, grid, size);
        JobArrays { samples: 0, simulation, ..self.arrays(budget, grid, size) }
    }

    /// Refuses a job that does not fit in memory.
    pub(super) fn check(
        &self,
        (budget, held): (&MemoryBudget, Held),
        grid: &Grid,
        size: &SceneSize,
        observer: &dyn Observer,
    ) -> Result<()> {
        let arrays = match held {
            Held::Image => {
                return budget.check(&self.instrument, grid, &self.imaging(budget, grid, size), observer);
            }
            Held::Cube => self.simulating(budget, grid, size),
            Held::Tiles => self.simulating_tiles(budget, grid, size),
        };
        arrays.peak(0).check(&self.instrument, budget.limit, |_| Vec::new())
    }
}

/// A scene that is loaded, checked against the memory limit and sampled.
#[derive(Debug)]
pub(super) struct PreparedScene {
    pub(super) measurement: Measurement,
    pub(super) scene: Option<Arc<Scene>>,
    /// Distance between the reflectors of a mesh, m.
    spacing: Option<f64>,
    /// What each loudspeaker lights, or one list for all of them.
    pub(super) reflectors: Vec<Reflectors>,
    /// What bounced echoes there are.
    pub(super) multipath: Option<Multipath>,
    pub(super) grid: Grid,
    pub(super) plan: Plan,
    /// The sizes of the arrays up to the simulated cube.
    pub(super) arrays: JobArrays,
}

impl PreparedScene {
    /// Loads and samples a scene for a job that holds so much.
    pub(super) fn of(
        budget: &MemoryBudget,
        known: KnownScene<'_>,
        held: Held,
        observer: &dyn Observer,
    ) -> Result<Self> {
        let run = budget.run;
        let measurement = Measurement::of(run)?;
        let instrument = &measurement.instrument;
        // A job that does not fit in memory is refused before any ray is traced.
        let fits = |grid: &Grid, size: &SceneSize| measurement.check((budget, held), grid, size, observer);
        if let Some(list) = reflector_list(run)? {
            let reflectors = run.moving(Reflectors::read_csv_within(list, budget.limit)?)?;
            let grid = run.voxels(instrument, reflectors.bounds())?;
            let size = SceneSize::of_list(&reflectors);
            fits(&grid, &size)?;
            let plan = plan(instrument, &grid);
            let arrays = measurement.arrays(budget, &grid, &size);
            let (scene, spacing, reflectors, multipath) = (None, None, vec![reflectors], None);
            return Ok(Self { measurement, scene, spacing, reflectors, multipath, grid, plan, arrays });
        }
        let scene = load_scene(run, known, observer)?;
        let size = SceneSize::of_mesh(&scene);
        let grid = run.voxels(instrument, scene.bounds());
        let grid = grid.and_then(|grid| fits(&grid, &size).map(|()| grid)).inspect_err(|_| {
            // A wrong unit may be the reason why no grid fits.
            if let Some((low, high)) = scene.bounds() {
                warn_all(&scale_warnings(instrument, None, (low, high), is_in_metres(&run.scene)), observer);
            }
        })?;
        let plan = plan(instrument, &grid);
        let options = size.surface_options(run, instrument, &grid);
        let options = options.with_velocities(run.triangle_velocities(scene.parts()));
        // Each loudspeaker has surfaces that it does not reach.
        let lit = instrument.sources().into_iter().map(Some).collect::<Vec<_>>();
        let lit = if lit.is_empty() { vec![None] } else { lit };
        let reflectors = lit.into_iter().map(|source| {
            let speaker = source.unwrap_or(options.speaker);
            known.reflectors(&scene, &SurfaceOptions { speaker, ..options.clone() }, observer)
        });
        let reflectors = reflectors.collect::<Result<Vec<_>>>()?;
        let most = reflectors.iter().map(Reflectors::direct).max().unwrap_or(0);
        observer.note(&format!("{most} reflectors, {:.1} mm apart", 1e3 * options.spacing));
        let multipath = Multipath::of(&reflectors[0], instrument);
        multipath.iter().flat_map(Multipath::lines).for_each(|line| observer.note(&line));
        let arrays = measurement.arrays(budget, &grid, &size);
        let (scene, spacing) = (Some(scene), Some(options.spacing));
        Ok(Self { measurement, scene, spacing, reflectors, multipath, grid, plan, arrays })
    }

    pub(super) fn instrument(&self) -> &Instrument {
        &self.measurement.instrument
    }

    fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.scene.as_ref().map_or_else(|| self.reflectors[0].bounds(), |scene| scene.bounds())
    }

    /// Warns about what is probably wrong.
    pub(super) fn warn(&self, run: &RunFile, job: &JobOptions, observer: &dyn Observer) {
        warn_all(job.hints(), observer);
        run.array.count_warning().iter().for_each(|warning| observer.warn(warning));
        warn_all(&self.plan.warnings, observer);
        let mesh = self.scene.as_ref().map(|_| is_in_metres(&run.scene));
        warn_all(&placement_warnings(self.instrument(), &self.grid, self.bounds(), mesh), observer);
        if !run.calibration().is_empty() {
            observer.warn("[calibration] corrects measured cubes; what is simulated here is left as it is");
        }
        if let Some(multipath) = &self.multipath {
            warn_all(&multipath.warnings(self.instrument()), observer);
        }
        if self.reflectors.iter().all(Reflectors::is_empty) {
            observer.warn("the speaker reaches no surface of the scene, so that the cube is silent; check the position of the scene");
        }
    }

    pub(super) fn simulate(
        &self,
        run: &RunFile,
        store: &mut dyn BlockStore,
        observer: &dyn Observer,
    ) -> Result<DataCube> {
        let Measurement { instrument, options } = &self.measurement;
        let mut cube = simulate_resumable(&self.reflectors, instrument, options, store, observer)?;
        let (n_f, n_mic, bytes) = (instrument.sweep.len(), instrument.array.len(), gib(self.plan.cube_bytes));
        let of_sources = match instrument.transmissions() {
            1 => String::new(),
            several => format!("{several} speakers x "),
        };
        observer.note(&format!("a cube of {of_sources}{n_f} frequencies x {n_mic} microphones, {bytes}"));
        cube.provenance = json!({ "run": run.to_json(), "seed": run.reflectors.seed });
        Ok(cube)
    }

    /// What the microphones hear of the tones, with their harmonics below `limit` Hz, before any mixer.
    pub(super) fn hear(
        &self,
        limit: f64,
        store: &mut dyn BlockStore,
        observer: &dyn Observer,
    ) -> Result<HeardTones<'static>> {
        let Measurement { instrument, options } = &self.measurement;
        simulate_heard(&self.reflectors, instrument, (options, limit), store, observer)
    }

    /// Simulates those tiles that the store wants, which takes them; without noise and electronics, which are those of a whole
    /// cube.
    pub(super) fn simulate_tiles(&self, store: &mut dyn BlockStore, observer: &dyn Observer) -> Result<()> {
        let Measurement { instrument, options } = &self.measurement;
        simulate_tiles(&self.reflectors, instrument, options, store, observer)
    }

    pub(super) fn summary(&self) -> Option<SceneSummary> {
        let bounds = self.bounds()?;
        Some(SceneSummary::new(self.scene.as_deref(), self.spacing, bounds, self.instrument()))
    }
}

/// How echoes of several surfaces are simulated, if they are.
fn bounces_in_words(run: &RunFile, instrument: &Instrument) -> Option<String> {
    let (bounces, typed) = (run.scene.bounces, &run.reflectors);
    let surfaces = match bounces {
        0 => return None,
        1 => "two surfaces",
        _ => "two surfaces, and of three that are mirrors or two of them",
    };
    let walls = match typed.surface {
        SurfaceKind::Rough => {
            let rms = 1e3 * typed.roughness * instrument.wavelength();
            format!("walls of {rms:.1} mm rms roughness mirror and scatter")
        }
        _ => "walls scatter and do not mirror (surface = \"rough\" does both)".to_owned(),
    };
    let edges = if run.scene.edges { "" } else { ", and edges do not diffract" };
    Some(format!("multipath, echoes of {surfaces}: {walls}, without loss of energy{edges}"))
}

/// Warnings about a scene's position and size. A list of reflectors is always in metres, so that only a `mesh` may have
/// the wrong unit, or the wrong scale where its format defines the unit (`Some(true)`).
pub(super) fn placement_warnings(
    instrument: &Instrument,
    grid: &Grid,
    bounds: Option<(DVec3, DVec3)>,
    mesh: Option<bool>,
) -> Vec<String> {
    let Some((low, high)) = bounds else { return Vec::new() };
    let suspected = mesh.map(|in_metres| scale_warnings(instrument, Some(grid), (low, high), in_metres));
    let mut warnings = suspected.unwrap_or_default();
    warnings.extend(outside_warning(grid, low, high));
    warnings
}
