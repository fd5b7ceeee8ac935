//! What a job may be given beside its run file.

use crate::checkpoint::Checkpoint;
use crate::progress::{Observer, Silent};
use std::fmt;

/// What a job may be given beside its run file; by default no checkpoint, no observer, and a mesh that stands where the run
/// file puts it.
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
    /// Whether the mesh came without a run file: then its centre goes before the array, 2 diagonals of its box away, unless a
    /// key places it.
    pub bare_mesh: bool,
    /// Where finished blocks are stored, and whence an interrupted job resumes.
    pub checkpoint: &'a Checkpoint,
    /// Hears of progress and warnings, and may stop the job.
    pub observer: &'a dyn Observer,
}

/// The checkpoint of jobs that have none: it stores nothing.
static OFF: Checkpoint = Checkpoint::off();

impl Default for JobOptions<'_> {
    fn default() -> Self {
        Self { bare_mesh: false, checkpoint: &OFF, observer: &Silent }
    }
}

impl<'a> JobOptions<'a> {
    /// The same for a mesh that came without a run file, or with one.
    #[must_use]
    pub fn with_bare_mesh(self, bare_mesh: bool) -> Self {
        Self { bare_mesh, ..self }
    }

    /// The same with a checkpoint.
    #[must_use]
    pub fn with_checkpoint(self, checkpoint: &'a Checkpoint) -> Self {
        Self { checkpoint, ..self }
    }

    /// The same with an observer.
    #[must_use]
    pub fn with_observer(self, observer: &'a dyn Observer) -> Self {
        Self { observer, ..self }
    }
}

impl fmt::Debug for JobOptions<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("JobOptions")
            .field("bare_mesh", &self.bare_mesh)
            .field("checkpoint", &self.checkpoint)
            .finish_non_exhaustive()
    }
}
