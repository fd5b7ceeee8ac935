//! A scene turned into reflectors, with the instrument that hears them and the grid that shows them.

use super::facts::compensation;
use super::forecast::imaging;
use super::{SceneSummary, is_csv, is_in_metres, load_scene, room, scene_path, warn_all};
use crate::acquisition::{
    DataCube, Detection, MicArray, Setup, SimulateOptions, Sweep, simulate_keeping, simulation_bytes,
};
use crate::config::RunFile;
use crate::error::Result;
use crate::grid::Grid;
use crate::plan::{
    Plan, check_sampling, check_simulation, gib, memory_limit, outside_warning, plan, scale_warnings,
    simulation_peak,
};
use crate::progress::{Keeper, Observer};
use crate::reflectors::{Reflectors, sample_surface, sampling_bytes};
use crate::scene::Scene;
use glam::DVec3;
use serde_json::json;

/// The run file's instrument.
#[derive(Debug)]
pub(super) struct Measurement {
    pub(super) sweep: Sweep,
    pub(super) array: MicArray,
    pub(super) options: SimulateOptions,
}

impl Measurement {
    pub(super) fn of(run: &RunFile) -> Result<Self> {
        Ok(Self { sweep: run.sweep()?, array: run.microphones()?, options: run.simulate_options() })
    }

    /// What is simulated beyond Eq. 5 and done to the volume, in words.
    pub(super) fn physics(&self, run: &RunFile) -> Vec<String> {
        let mut lines = self.options.physics(&self.sweep);
        if let Some(air) = run.medium.air() {
            lines.insert(
                0,
                format!(
                    "sound travels at {:.2} m/s, in air of {} °C and {} %",
                    self.options.sound_speed, air.temperature, air.humidity
                ),
            );
        }
        lines.extend(compensation(run));
        lines
    }

    pub(super) fn setup(&self) -> Setup<'_> {
        Setup {
            sweep: &self.sweep,
            array: &self.array,
            geometry: self.options.geometry,
            detection: self.options.detection,
            sound_speed: self.options.sound_speed,
        }
    }

    /// Bytes that simulating takes beside the cube, for a scene within these bounds.
    pub(super) fn simulating(&self, bounds: Option<(DVec3, DVec3)>) -> u64 {
        simulation_bytes(&self.sweep, &self.array, bounds, &self.options, rayon::current_num_threads())
    }

    /// Bytes at the peak of `simulate`.
    pub(super) fn simulation_peak(&self, bounds: Option<(DVec3, DVec3)>) -> u64 {
        let setup = self.setup();
        // Samples in phase are copied without their imaginary parts to be written.
        let written = if setup.detection == Detection::InPhase { setup.cube_bytes() / 2 } else { 0 };
        simulation_peak(&setup, self.simulating(bounds).max(written), rayon::current_num_threads())
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
}

impl Echoes {
    /// Loads and samples a scene to be simulated, and imaged too if `imaged`.
    pub(super) fn of(run: &RunFile, bare: bool, imaged: bool, observer: &dyn Observer) -> Result<Self> {
        let measurement = Measurement::of(run)?;
        let setup = measurement.setup();
        // What can never fit is refused before any ray is traced.
        let fits = |grid: &Grid, bounds| {
            if imaged {
                let beside = measurement.simulating(bounds);
                room(run, &setup, grid, imaging(run, &setup, grid, setup.cube_bytes(), beside), observer)
            } else {
                check_simulation(&setup, measurement.simulation_peak(bounds), memory_limit())
            }
        };
        let path = scene_path(run)?;
        if is_csv(path) {
            let reflectors = Reflectors::read_csv(path)?;
            let grid = run.voxels(&setup, reflectors.bounds())?;
            fits(&grid, reflectors.bounds())?;
            let plan = plan(&setup, &grid);
            return Ok(Self { measurement, scene: None, spacing: None, reflectors, grid, plan });
        }
        let scene = load_scene(path, run, bare, observer)?;
        let grid = run.voxels(&setup, scene.bounds());
        let grid = grid.and_then(|grid| fits(&grid, scene.bounds()).map(|()| grid)).inspect_err(|_| {
            // A wrong unit may be why no grid fits.
            if let Some((low, high)) = scene.bounds() {
                warn_all(&scale_warnings(&setup, low, high, is_in_metres(path)), observer);
            }
        })?;
        let plan = plan(&setup, &grid);
        let nearest = scene.bounds().map_or(grid.z.first, |(low, _)| low.z.max(grid.z.first));
        let options = run.surface_options(&setup, nearest);
        check_sampling(sampling_bytes(&scene, &options), options.spacing, memory_limit())?;
        let reflectors = sample_surface(&scene, &options, observer)?;
        observer.note(&format!("{} reflectors, {:.1} mm apart", reflectors.len(), 1e3 * options.spacing));
        Ok(Self { measurement, scene: Some(scene), spacing: Some(options.spacing), reflectors, grid, plan })
    }

    pub(super) fn setup(&self) -> Setup<'_> {
        self.measurement.setup()
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
        warn_all(&placement_warnings(&self.setup(), &self.grid, self.bounds(), mesh), observer);
        if self.reflectors.is_empty() {
            observer.warn("the speaker reaches no surface of the scene: the cube will be silent; check where the scene lies");
        }
    }

    pub(super) fn simulate(
        &self,
        run: &RunFile,
        keeper: &mut dyn Keeper,
        observer: &dyn Observer,
    ) -> Result<DataCube> {
        let Measurement { sweep, array, options } = &self.measurement;
        let mut cube = simulate_keeping(&self.reflectors, sweep, array, options, keeper, observer)?;
        observer.note(&format!(
            "a cube of {} tones x {} microphones, {}",
            sweep.len(),
            array.len(),
            gib(self.plan.cube_bytes)
        ));
        cube.provenance = json!({ "run": run.to_json(), "seed": run.reflectors.seed });
        Ok(cube)
    }

    pub(super) fn summary(&self) -> Option<SceneSummary> {
        let (low, high) = self.bounds()?;
        Some(SceneSummary::new(self.scene.as_ref(), self.spacing, low, high, self.setup().wavelength()))
    }
}

/// What looks wrong about where a scene lies and how large it is. A list of reflectors is in metres for certain, so
/// only a `mesh` is suspected of another unit, or of another scale where its format says its unit (`Some(true)`).
pub(super) fn placement_warnings(
    setup: &Setup,
    grid: &Grid,
    bounds: Option<(DVec3, DVec3)>,
    mesh: Option<bool>,
) -> Vec<String> {
    let Some((low, high)) = bounds else { return Vec::new() };
    let suspected = mesh.map(|in_metres| scale_warnings(setup, low, high, in_metres));
    let mut warnings = suspected.unwrap_or_default();
    warnings.extend(outside_warning(grid, low, high));
    warnings
}
