//! The memory that a job may use, what it holds of it, and its refusal where that is too little.

use super::{is_csv, outputs, scene_path};
use crate::acquisition::Instrument;
use crate::config::RunFile;
use crate::error::{Result, gib};
use crate::grid::Grid;
use crate::plan::{Holding, Needs, check_memory, left_for_method, memory_limit, needs};
use crate::progress::Observer;
use crate::reconstruct::ReconstructOptions;
use crate::reflectors::{Reflectors, SurfaceOptions, sampling_bytes};
use crate::scene::{MeshNeeds, Scene};
use glam::DVec3;

/// A run, and the bytes that it may use: found once, before anything is allocated, since what is free shrinks as a job grows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Budget<'a> {
    pub(super) run: &'a RunFile,
    pub(super) limit: Option<u64>,
}

impl<'a> Budget<'a> {
    pub(super) fn of(run: &'a RunFile) -> Self {
        Self { run, limit: memory_limit(run.memory) }
    }

    /// What `image` holds, given what it holds of scene and samples.
    pub(super) fn imaging(&self, setup: &Instrument, grid: &Grid, held: Holding) -> Holding {
        let resolution = setup.range_resolution().unwrap_or(f64::NAN);
        let depth = self.run.depth_options(resolution).search_bytes(grid);
        let writing = outputs::writing_bytes(outputs::volume_names(self.run), self.run, grid);
        Holding { volume: true, depth, writing, ..held }
    }

    /// How a volume is to be made within the memory there is.
    pub(super) fn options(&self, grid: &Grid, holding: Holding) -> ReconstructOptions {
        let mut options = self.run.reconstruct_options();
        options.memory = left_for_method(grid, holding, self.limit, rayon::current_num_threads());
        options
    }

    /// What that takes.
    pub(super) fn needs(&self, setup: &Instrument, grid: &Grid, holding: Holding) -> Result<Needs> {
        needs(setup, grid, &self.options(grid, holding), holding, rayon::current_num_threads())
    }

    /// Refuses a job that cannot fit in memory, and says what one that can will take.
    pub(super) fn room(
        &self,
        setup: &Instrument,
        grid: &Grid,
        holding: Holding,
        observer: &dyn Observer,
    ) -> Result<()> {
        let needs = self.needs(setup, grid, holding)?;
        check_memory(&needs, setup, grid, holding, self.limit)?;
        observer.note(&format!("taking about {} of memory", gib(needs.peak_bytes)));
        Ok(())
    }
}

/// What is known of a scene that is read, and not sampled yet.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Seen {
    pub(super) bounds: Option<(DVec3, DVec3)>,
    mesh: MeshNeeds,
    /// Of its surfaces, m²; 0 for a list of reflectors.
    area: f64,
}

impl Seen {
    pub(super) fn mesh(scene: &Scene) -> Self {
        Self { bounds: scene.bounds(), mesh: scene.needs(), area: scene.surface_area() }
    }

    pub(super) fn list(reflectors: &Reflectors) -> Self {
        Self::within(reflectors.bounds())
    }

    /// What is known of the run file's scene, which is let go again.
    pub(super) fn of(run: &RunFile, bare: bool, observer: &dyn Observer) -> Result<Self> {
        let path = scene_path(run)?;
        if is_csv(path) {
            return Ok(Self::list(&Reflectors::read_csv(path)?));
        }
        Ok(Self::mesh(&Scene::load(path, &run.load_options(bare)?, observer)?))
    }

    /// Reflectors within these bounds.
    pub(super) fn within(bounds: Option<(DVec3, DVec3)>) -> Self {
        Self { bounds, ..Self::default() }
    }

    /// How its surfaces are sampled.
    pub(super) fn surface_options(&self, run: &RunFile, setup: &Instrument, grid: &Grid) -> SurfaceOptions {
        let nearest = self.bounds.map_or(grid.z.first, |(low, _)| low.z.max(grid.z.first));
        run.surface_options(setup, nearest)
    }

    /// Bytes that sampling them takes, the scene included.
    pub(super) fn sampling(&self, options: &SurfaceOptions) -> u64 {
        self.mesh.held().saturating_add(sampling_bytes(self.mesh.triangles, self.area, options))
    }

    /// What a job holds of it, now and from its reading to its sampling.
    pub(super) fn holding(&self, run: &RunFile, setup: &Instrument, grid: &Grid) -> Holding {
        if self.mesh.triangles == 0 {
            return Holding::default();
        }
        let options = self.surface_options(run, setup, grid);
        let preparing = self.mesh.peak().max(self.sampling(&options));
        Holding { scene: self.mesh.held(), preparing, ..Holding::default() }
    }
}
