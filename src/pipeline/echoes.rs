//! A scene turned into reflectors, with the instrument that hears them and the grid that shows them.

use super::facts::compensation;
use super::memory::{MemoryBudget, SceneSize};
use super::{SceneSummary, is_csv, is_in_metres, load_scene, scene_path, warn_all};
use crate::acquisition::{
    DataCube, Detection, Instrument, SimulateOptions, simulate_resumable, simulation_bytes,
};
use crate::blocks::BlockStore;
use crate::config::RunFile;
use crate::error::{Result, gib};
use crate::grid::Grid;
use crate::plan::{JobArrays, Plan, outside_warning, plan, scale_warnings};
use crate::progress::Observer;
use crate::reflectors::{Reflectors, sample_surface_with};
use crate::scene::Scene;
use glam::DVec3;
use serde_json::json;

/// The run file's instrument.
#[derive(Debug)]
pub(super) struct Measurement {
    pub(super) instrument: Instrument,
    pub(super) options: SimulateOptions,
}

impl Measurement {
    pub(super) fn of(run: &RunFile) -> Result<Self> {
        Ok(Self { instrument: run.instrument()?, options: run.simulate_options() })
    }

    /// What is simulated beyond Eq. 5 and done to the volume, in words.
    pub(super) fn physics(&self, run: &RunFile) -> Vec<String> {
        let mut lines = self.options.physics(&self.instrument);
        if let Some(air) = run.medium.air() {
            lines.insert(
                0,
                format!(
                    "sound travels at {:.2} m/s, in air of {} °C and {} %",
                    self.instrument.sound_speed, air.temperature, air.humidity
                ),
            );
        }
        lines.extend(compensation(run));
        lines
    }

    /// The arrays of a job until the cube of a scene is simulated.
    fn arrays(&self, run: &RunFile, grid: &Grid, size: &SceneSize) -> JobArrays {
        let threads = rayon::current_num_threads();
        let simulation = simulation_bytes(&self.instrument, size.bounds, &self.options, threads);
        JobArrays {
            samples: self.instrument.cube_bytes(),
            simulation,
            ..size.arrays(run, &self.instrument, grid)
        }
    }

    /// Those of `image`.
    pub(super) fn imaging(&self, budget: &MemoryBudget, grid: &Grid, size: &SceneSize) -> JobArrays {
        budget.imaging(&self.instrument, grid, self.arrays(budget.run, grid, size))
    }

    /// Those of `simulate`.
    pub(super) fn simulating(&self, run: &RunFile, grid: &Grid, size: &SceneSize) -> JobArrays {
        let arrays = self.arrays(run, grid, size);
        // Samples in phase are copied without their imaginary parts to be written.
        let written = if self.instrument.detection == Detection::InPhase { arrays.samples / 2 } else { 0 };
        JobArrays { simulation: arrays.simulation.max(written), ..arrays }
    }

    /// Refuses to simulate a cube that cannot fit.
    pub(super) fn check_simulation(
        &self,
        budget: &MemoryBudget,
        grid: &Grid,
        size: &SceneSize,
    ) -> Result<()> {
        let peak = self.simulating(budget.run, grid, size).peak(0);
        peak.check(&self.instrument, budget.limit, |_| Vec::new())
    }
}

/// A scene turned into reflectors, with the instrument that will hear them and the grid they will be imaged on.
#[derive(Debug)]
pub(super) struct Echoes {
    measurement: Measurement,
    pub(super) scene: Option<Scene>,
    /// Distance between the scene's reflectors, m.
    spacing: Option<f64>,
    pub(super) reflectors: Reflectors,
    pub(super) grid: Grid,
    pub(super) plan: Plan,
    /// The sizes of what leads to their cube, and of the cube.
    pub(super) arrays: JobArrays,
}

impl Echoes {
    /// Loads and samples a scene to be simulated, and imaged too if `imaged`.
    pub(super) fn of(
        budget: &MemoryBudget,
        bare: bool,
        imaged: bool,
        observer: &dyn Observer,
    ) -> Result<Self> {
        let run = budget.run;
        let measurement = Measurement::of(run)?;
        let instrument = &measurement.instrument;
        // What can never fit is refused before any ray is traced.
        let fits = |grid: &Grid, size: &SceneSize| {
            if imaged {
                budget.check(instrument, grid, &measurement.imaging(budget, grid, size), observer)
            } else {
                measurement.check_simulation(budget, grid, size)
            }
        };
        let path = scene_path(run)?;
        if is_csv(path) {
            let reflectors = Reflectors::read_csv(path)?;
            let grid = run.voxels(instrument, reflectors.bounds())?;
            let size = SceneSize::of_list(&reflectors);
            fits(&grid, &size)?;
            let plan = plan(instrument, &grid);
            let arrays = measurement.arrays(run, &grid, &size);
            return Ok(Self { measurement, scene: None, spacing: None, reflectors, grid, plan, arrays });
        }
        let scene = load_scene(path, run, bare, observer)?;
        let size = SceneSize::of_mesh(&scene);
        let grid = run.voxels(instrument, scene.bounds());
        let grid = grid.and_then(|grid| fits(&grid, &size).map(|()| grid)).inspect_err(|_| {
            // A wrong unit may be why no grid fits.
            if let Some((low, high)) = scene.bounds() {
                warn_all(&scale_warnings(instrument, low, high, is_in_metres(path)), observer);
            }
        })?;
        let plan = plan(instrument, &grid);
        let options = size.surface_options(run, instrument, &grid);
        let reflectors = sample_surface_with(&scene, &options, observer)?;
        observer.note(&format!("{} reflectors, {:.1} mm apart", reflectors.len(), 1e3 * options.spacing));
        let arrays = measurement.arrays(run, &grid, &size);
        let (scene, spacing) = (Some(scene), Some(options.spacing));
        Ok(Self { measurement, scene, spacing, reflectors, grid, plan, arrays })
    }

    pub(super) fn instrument(&self) -> &Instrument {
        &self.measurement.instrument
    }

    /// What is simulated beyond Eq. 5 and done to the volume, in words.
    pub(super) fn physics(&self, run: &RunFile) -> Vec<String> {
        self.measurement.physics(run)
    }

    fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.scene.as_ref().map_or_else(|| self.reflectors.bounds(), Scene::bounds)
    }

    /// Warns about what looks wrong.
    pub(super) fn warn(&self, run: &RunFile, observer: &dyn Observer) {
        warn_all(&self.plan.warnings, observer);
        let in_metres = scene_path(run).is_ok_and(is_in_metres);
        let mesh = self.scene.as_ref().map(|_| in_metres);
        warn_all(&placement_warnings(self.instrument(), &self.grid, self.bounds(), mesh), observer);
        if self.reflectors.is_empty() {
            observer.warn("the speaker reaches no surface of the scene: the cube will be silent; check where the scene lies");
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
        observer.note(&format!(
            "a cube of {} frequencies x {} microphones, {}",
            instrument.sweep.len(),
            instrument.array.len(),
            gib(self.plan.cube_bytes)
        ));
        cube.provenance = json!({ "run": run.to_json(), "seed": run.reflectors.seed });
        Ok(cube)
    }

    pub(super) fn summary(&self) -> Option<SceneSummary> {
        let (low, high) = self.bounds()?;
        Some(SceneSummary::new(self.scene.as_ref(), self.spacing, low, high, self.instrument().wavelength()))
    }
}

/// What looks wrong about where a scene lies and how large it is. A list of reflectors is in metres for certain, so
/// only a `mesh` is suspected of another unit, or of another scale where its format says its unit (`Some(true)`).
pub(super) fn placement_warnings(
    instrument: &Instrument,
    grid: &Grid,
    bounds: Option<(DVec3, DVec3)>,
    mesh: Option<bool>,
) -> Vec<String> {
    let Some((low, high)) = bounds else { return Vec::new() };
    let suspected = mesh.map(|in_metres| scale_warnings(instrument, low, high, in_metres));
    let mut warnings = suspected.unwrap_or_default();
    warnings.extend(outside_warning(grid, low, high));
    warnings
}
