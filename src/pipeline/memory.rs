//! The memory that a job may use, the arrays for which it is used, and the refusal of a job that does not fit.

use super::job::kept::KnownScene;
use super::{load_scene, outputs, reflector_list};
use crate::acquisition::Instrument;
use crate::checkpoint::BUFFER_BYTES;
use crate::config::RunFile;
use crate::depth::{ArraySidelobes, Refine};
use crate::error::{Result, gib};
use crate::grid::Grid;
use crate::plan::{JobArrays, JobEstimate, estimate_job, memory_limit};
use crate::progress::Observer;
use crate::reconstruct::{GridSurroundings, Method, ReconstructOptions};
use crate::reflectors::{Reflectors, SurfaceOptions, most_bounced, most_pieces, sampling_bytes};
use crate::scene::{BYTES_PER_TRIANGLE, Scene};
use glam::DVec3;
use std::path::Path;

/// A run, with the threads and the bytes that it may use: determined once, before anything is allocated, since free memory shrinks as a job
/// grows.
#[derive(Debug, Clone, Copy)]
pub(super) struct MemoryBudget<'a> {
    pub(super) run: &'a RunFile,
    pub(super) limit: Option<u64>,
    /// Worker threads.
    pub(super) threads: usize,
    /// The method that another process has found to take least.
    pub(super) known: Option<Method>,
}

impl<'a> MemoryBudget<'a> {
    pub(super) fn of(run: &'a RunFile) -> Self {
        let threads = rayon::current_num_threads();
        Self { run, limit: memory_limit(run.memory), threads, known: None }
    }

    /// The arrays of `image`, given those of its scene and samples.
    pub(super) fn imaging(&self, instrument: &Instrument, grid: &Grid, arrays: JobArrays) -> JobArrays {
        let search = self.run.depth_options(instrument.aperture(), ArraySidelobes::default());
        // What is outside is listened to while the powers of the voxels are there.
        let surroundings = GridSurroundings::of(instrument, grid, &self.run.reconstruct_options())
            .filter(|_| search.refine == Refine::Surface);
        let bytes = surroundings.map_or(0, |around| around.bytes());
        let depth = search.search_bytes(grid).saturating_add(bytes);
        JobArrays { depth, ..self.reconstructing(outputs::volume_names(self.run), grid, true, arrays) }
    }

    /// The arrays of `reconstruct` into files of these names, including the volume if it is `whole` in memory.
    pub(super) fn reconstructing(
        &self,
        paths: impl IntoIterator<Item: AsRef<Path>>,
        grid: &Grid,
        whole: bool,
        arrays: JobArrays,
    ) -> JobArrays {
        let volume = grid.volume_bytes();
        let output = outputs::writing_bytes(paths, self.run, grid);
        let checkpoint = BUFFER_BYTES.min(volume);
        JobArrays { volume: if whole { volume } else { 0 }, checkpoint, output, ..arrays }
    }

    /// The options of a reconstruction that stays within the budget.
    pub(super) fn options(&self, arrays: &JobArrays) -> ReconstructOptions {
        let mut options = self.run.reconstruct_options();
        options.memory = arrays.left_for_method(self.limit);
        options.known = self.known;
        options
    }

    /// The operations and the memory of such a reconstruction.
    pub(super) fn estimate(
        &self,
        instrument: &Instrument,
        grid: &Grid,
        arrays: &JobArrays,
    ) -> Result<JobEstimate> {
        estimate_job(instrument, grid, &self.options(arrays), arrays, self.threads)
    }

    /// Refuses a job that does not fit in memory, and reports the memory of one that does.
    pub(super) fn check(
        &self,
        instrument: &Instrument,
        grid: &Grid,
        arrays: &JobArrays,
        observer: &dyn Observer,
    ) -> Result<()> {
        let estimate = self.estimate(instrument, grid, arrays)?;
        estimate.check_memory(instrument, grid, arrays, self.limit)?;
        observer.note(&format!("taking about {} of memory", gib(estimate.memory.total())));
        Ok(())
    }
}

/// The size of a scene that is read, but not sampled yet.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SceneSize {
    pub(super) bounds: Option<(DVec3, DVec3)>,
    /// Triangles of a mesh; 0 for a list of reflectors.
    triangles: u64,
    /// Reflectors of a list; 0 for a mesh, which is not sampled yet.
    count: u64,
    /// Surface area, m²; 0 for a list of reflectors.
    area: f64,
    /// Bytes in memory.
    bytes: u64,
}

impl SceneSize {
    pub(super) fn of_mesh(scene: &Scene) -> Self {
        let (triangles, bytes) = (scene.triangles().len() as u64, scene.memory_bytes());
        Self { bounds: scene.bounds(), triangles, area: scene.surface_area(), bytes, count: 0 }
    }

    pub(super) fn of_list(reflectors: &Reflectors) -> Self {
        let count = reflectors.len() as u64;
        let bytes = count.saturating_mul(Reflectors::BYTES_EACH);
        Self { count, bytes, ..Self::within(reflectors.bounds()) }
    }

    /// The size of the run file's scene, which is read only for its size.
    pub(super) fn of(run: &RunFile, known: KnownScene<'_>, observer: &dyn Observer) -> Result<Self> {
        match reflector_list(run)? {
            Some(list) => Ok(Self::of_list(&Reflectors::read_csv_within(list, memory_limit(run.memory))?)),
            None => Ok(Self::of_mesh(&*load_scene(run, known, observer)?)),
        }
    }

    /// The size of one reflector within these bounds.
    pub(super) fn within(bounds: Option<(DVec3, DVec3)>) -> Self {
        Self { bounds, ..Self::default() }
    }

    /// The options with which its surfaces are sampled.
    pub(super) fn surface_options(
        &self,
        run: &RunFile,
        instrument: &Instrument,
        grid: &Grid,
    ) -> SurfaceOptions {
        let nearest = self.bounds.map_or(grid.z.first, |(low, _)| low.z.max(grid.z.first));
        run.surface_options(instrument, nearest)
    }

    /// Reflectors: those of the list, or about as many as the mesh will have at most, with bounces and edges.
    pub(super) fn reflectors(&self, run: &RunFile, instrument: &Instrument, grid: &Grid) -> u64 {
        self.reflectors_and_tracing(run, instrument, grid)[0]
    }

    /// The same, and the bytes that finding bounces and edges takes.
    fn reflectors_and_tracing(&self, run: &RunFile, instrument: &Instrument, grid: &Grid) -> [u64; 2] {
        if self.triangles == 0 {
            return [self.count, 0];
        }
        let options = self.surface_options(run, instrument, grid);
        let direct = (self.area / (options.spacing * options.spacing)) as u64;
        let order = options.bounces.as_ref().map(|bounces| bounces.order);
        let [bounced, bytes] = order.map_or([0; 2], |order| most_bounced(self.triangles, direct, order));
        let [pieces, finding] =
            options.edges.map_or([0; 2], |_| most_pieces(self.triangles, self.area, options.wavelength));
        [direct + bounced + pieces, bytes.max(finding)]
    }

    /// The arrays of reading and sampling the scene.
    pub(super) fn arrays(&self, run: &RunFile, instrument: &Instrument, grid: &Grid) -> JobArrays {
        if self.triangles == 0 {
            return JobArrays { scene: self.bytes, ..JobArrays::default() };
        }
        // Its reflectors stay beside it once they are sampled.
        let [reflectors, tracing] = self.reflectors_and_tracing(run, instrument, grid);
        let reflectors = reflectors.saturating_mul(instrument.transmissions() as u64);
        let reflectors = reflectors.saturating_mul(Reflectors::BYTES_EACH);
        let scene = JobArrays { scene: self.bytes.saturating_add(reflectors), ..JobArrays::default() };
        let options = self.surface_options(run, instrument, grid);
        let sampling = sampling_bytes(self.triangles, self.area, &options).saturating_add(tracing);
        JobArrays { loading: self.triangles.saturating_mul(BYTES_PER_TRIANGLE), sampling, ..scene }
    }
}
