//! Options of a job that are not part of its run file.

pub(super) mod identity;
pub(super) mod kept;
pub(super) mod log;
mod shared;
pub(super) mod units;

use super::BareMesh;
use crate::checkpoint::Checkpoint;
use crate::progress::{Observer, Silent};
use kept::{KeptScenes, KnownScene};
use shared::SharedReflectors;
use std::fmt;
use units::StoredShards;

/// Options of a job that are not part of its run file; by default no checkpoint and no observer.
///
/// ```no_run
/// use holosonar::checkpoint::Checkpoint;
/// use holosonar::config::RunFile;
/// use holosonar::pipeline::{JobOptions, image_scene, write_outputs};
/// use std::path::Path;
/// use std::time::Duration;
///
/// let run = RunFile::load(Path::new("scenes/corner.toml"), &[])?;
/// let folder = Path::new("out");
/// let checkpoint = Checkpoint::within(folder, Duration::from_secs(5));
/// let options = JobOptions::default().with_checkpoint(&checkpoint);
/// let outcome = image_scene(&run, &options)?;
/// write_outputs(&run, &outcome, folder, &options)?;
/// checkpoint.remove();
/// # Ok::<(), holosonar::error::Error>(())
/// ```
#[derive(Clone, Copy)]
#[non_exhaustive]
pub struct JobOptions<'a> {
    /// The mesh without a run file from which the run file was made, so that it is not read again.
    pub bare_mesh: Option<&'a BareMesh>,
    /// Where finished blocks are stored, from which an interrupted job resumes.
    pub checkpoint: &'a Checkpoint,
    /// Receives progress and warnings, and may stop the job.
    pub observer: &'a dyn Observer,
    /// What the job has in common with others of this process.
    pub(super) kept: Option<&'a KeptScenes>,
}

/// The checkpoint of jobs without one: it stores nothing.
static OFF: Checkpoint = Checkpoint::off();

impl Default for JobOptions<'_> {
    fn default() -> Self {
        Self { bare_mesh: None, checkpoint: &OFF, observer: &Silent, kept: None }
    }
}

impl<'a> JobOptions<'a> {
    /// The same options for a mesh without a run file, if it is one.
    #[must_use]
    pub fn with_bare_mesh(self, bare_mesh: Option<&'a BareMesh>) -> Self {
        Self { bare_mesh, ..self }
    }

    /// What may be wrong with the placement of a mesh without a run file.
    pub(super) fn hints(&self) -> &'a [String] {
        self.bare_mesh.map_or(&[], |bare| &bare.hints)
    }

    /// What is known of the scene.
    pub(super) fn known(&self) -> KnownScene<'a> {
        let shared = SharedReflectors { checkpoint: self.checkpoint, stores: false };
        KnownScene { bare: self.bare_mesh, kept: self.kept, shared: Some(shared) }
    }

    /// The shards of a volume's Zarr store that other processes have encoded.
    pub(super) fn shards(&self) -> StoredShards<'a> {
        StoredShards { checkpoint: self.checkpoint, observer: self.observer }
    }

    /// The same options with a checkpoint.
    #[must_use]
    pub fn with_checkpoint(self, checkpoint: &'a Checkpoint) -> Self {
        Self { checkpoint, ..self }
    }

    /// The same options with an observer.
    #[must_use]
    pub fn with_observer(self, observer: &'a dyn Observer) -> Self {
        Self { observer, ..self }
    }
}

impl fmt::Debug for JobOptions<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("JobOptions")
            .field("bare_mesh", &self.bare_mesh.map(|bare| &bare.scene))
            .field("checkpoint", &self.checkpoint)
            .finish_non_exhaustive()
    }
}
