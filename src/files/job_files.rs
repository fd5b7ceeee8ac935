//! Which files a process has read and which it will write, so that no result replaces an input.
//!
//! Takes every file when it is opened for reading, and every output when its name is known, which is before any long work;
//! refuses a file that would be both, and an output that is named twice. The order does not matter: whichever comes second
//! is refused. Files are compared by their identity, so that symbolic and hard links count; names that do not exist yet, by
//! their folder and name.
//!
//! The command line starts this with [`protect_inputs`], because its process is one job. It covers every file that
//! [`open_input`](super::open_input) opens, also those to which a mesh refers. A library's caller may well read a file and
//! then replace it, so that there nothing is recorded.

use super::folder::nearest;
use super::target_of;
use crate::error::{Error, Result};
use std::fs::Metadata;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

/// What is the same for two names of one file: device and inode.
#[cfg(unix)]
type FileId = (u64, u64);
/// Elsewhere the standard library gives no identity, so that only names are compared.
#[cfg(not(unix))]
type FileId = std::convert::Infallible;

#[cfg_attr(unix, allow(clippy::unnecessary_wraps))] // elsewhere there is none
fn id_of(file: &Metadata) -> Option<FileId> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        Some((file.dev(), file.ino()))
    }
    #[cfg(not(unix))]
    {
        let _ = file;
        None
    }
}

/// What a process does with a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FileUse {
    Reads,
    WillWrite,
    /// The output is complete. Its identity is new, and reading it back is harmless.
    Wrote,
}

#[derive(Debug)]
struct UsedFile {
    /// As it was given, for messages.
    path: PathBuf,
    /// Its folder without links, and its name.
    target: PathBuf,
    /// `None` if it did not exist.
    id: Option<FileId>,
    use_: FileUse,
}

/// The files of one job.
#[derive(Debug, Default)]
pub(super) struct JobFiles(Mutex<UsedFiles>);

#[derive(Debug, Default)]
struct UsedFiles {
    entries: Vec<UsedFile>,
    /// The first refusal of an input.
    refused: Option<Error>,
}

/// The files of the process, if they are recorded.
static OF_PROCESS: OnceLock<JobFiles> = OnceLock::new();

/// From now on refuses to write a file that the process has read, to read one that it will write, and to write one twice.
pub(crate) fn protect_inputs() {
    let _ = OF_PROCESS.set(JobFiles::default());
}

/// The record of the process, if there is one.
pub(super) fn of_process() -> Option<&'static JobFiles> {
    OF_PROCESS.get()
}

/// Whether the process has read a file and records it.
pub(crate) fn is_input(path: &Path) -> bool {
    of_process().is_some_and(|files| files.has_read(path))
}

/// Repeats the first refusal of an input, for a caller that goes on without a file that cannot be read.
///
/// # Errors
/// [`Error::InvalidInput`] when an input that was to be read is an output.
pub(crate) fn check_inputs() -> Result<()> {
    of_process().and_then(|files| files.record().refused.clone()).map_or(Ok(()), Err)
}

/// Refuses to write a file that has been read. For files that a command writes besides its outputs.
///
/// # Errors
/// [`Error::InvalidInput`] when it is an input.
pub(crate) fn check_is_no_input(path: &Path) -> Result<()> {
    if is_input(path) { Err(overwritten(path, path)) } else { Ok(()) }
}

impl JobFiles {
    /// Records an input that has just been opened.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] when it is an output that is not complete yet.
    pub(super) fn read(&self, path: &Path, file: &Metadata) -> Result<()> {
        let entry =
            UsedFile { path: path.into(), target: canonical(path), id: id_of(file), use_: FileUse::Reads };
        let mut record = self.record();
        let output = record.entries.iter().find(|other| other.use_ == FileUse::WillWrite && other.is(&entry));
        let refusal = output.map(|output| overwritten(path, &output.path));
        // Recorded in any case, so that it is not overwritten even if the refusal is lost.
        record.entries.push(entry);
        let Some(refusal) = refusal else { return Ok(()) };
        record.refused.get_or_insert_with(|| refusal.clone());
        Err(refusal)
    }

    /// Records an output, which `announced` says is named for the first time.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] when the file has been read, or when it is announced twice.
    pub(super) fn will_write(&self, path: &Path, target: &Path, announced: bool) -> Result<()> {
        let id = target.metadata().ok().and_then(|file| id_of(&file));
        let entry = UsedFile { path: path.into(), target: canonical(target), id, use_: FileUse::WillWrite };
        let mut record = self.record();
        let entries = &mut record.entries;
        for other in entries.iter().filter(|other| other.is(&entry)) {
            match other.use_ {
                FileUse::Reads => return Err(overwritten(&other.path, path)),
                FileUse::WillWrite | FileUse::Wrote if announced => return Err(twice(path, &other.path)),
                FileUse::WillWrite | FileUse::Wrote => {}
            }
        }
        entries.push(entry);
        Ok(())
    }

    /// Notes that an output is complete, after which it may be read.
    pub(super) fn wrote(&self, target: &Path) {
        let target = canonical(target);
        for entry in &mut self.record().entries {
            if entry.use_ == FileUse::WillWrite && entry.target == target {
                // The inode of the file that was replaced may be another file's by now.
                (entry.use_, entry.id) = (FileUse::Wrote, None);
            }
        }
    }

    /// Whether a file has been read.
    pub(super) fn has_read(&self, path: &Path) -> bool {
        let id = path.metadata().ok().and_then(|file| id_of(&file));
        let file = UsedFile { path: path.into(), target: canonical(path), id, use_: FileUse::Reads };
        self.record().entries.iter().any(|other| other.use_ == FileUse::Reads && other.is(&file))
    }

    fn record(&self) -> MutexGuard<'_, UsedFiles> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl UsedFile {
    /// Whether two entries are one file.
    fn is(&self, other: &Self) -> bool {
        self.target == other.target || (self.id.is_some() && self.id == other.id)
    }
}

/// The same file's name without links, also if it or its folders do not exist yet.
fn canonical(path: &Path) -> PathBuf {
    let target = target_of(path);
    if let Ok(existing) = target.canonicalize() {
        return existing;
    }
    let folder = target.parent().unwrap_or(Path::new(""));
    let existing = nearest(folder);
    let missing = folder.strip_prefix(existing).unwrap_or(folder);
    let root = existing.canonicalize().unwrap_or_else(|_| existing.to_path_buf());
    root.join(missing).join(target.file_name().unwrap_or_default())
}

fn overwritten(input: &Path, output: &Path) -> Error {
    let problem = if input == output {
        "is an input of this command and would be overwritten by its output; write to another file".to_owned()
    } else {
        format!(
            "is an input of this command and would be overwritten, because the output {} is the same file; write to \
             another file",
            output.display()
        )
    };
    Error::input(input.display(), problem)
}

fn twice(path: &Path, other: &Path) -> Error {
    let problem = if path == other {
        "is given twice as an output; give each output a file of its own".to_owned()
    } else {
        format!("is the same file as the output {}; give each output a file of its own", other.display())
    };
    Error::input(path.display(), problem)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;
    use std::fs;

    fn read(files: &JobFiles, path: &Path) -> Result<()> {
        files.read(path, &fs::metadata(path).unwrap())
    }

    fn announce(files: &JobFiles, path: &Path) -> Result<()> {
        files.will_write(path, &target_of(path), true)
    }

    /// Refused in either order, with a message that names both.
    #[track_caller]
    fn assert_refused(input: &Path, output: &Path) {
        let both = [input.to_str().unwrap(), output.to_str().unwrap(), "overwritten"];
        let first = JobFiles::default();
        read(&first, input).unwrap();
        assert_names(announce(&first, output).unwrap_err().to_string(), &both);
        let second = JobFiles::default();
        announce(&second, output).unwrap();
        let error = read(&second, input).unwrap_err();
        assert_eq!(error.exit_status(), 2);
        assert_names(error.to_string(), &both);
        // Also where the refusal is lost.
        assert_eq!(second.record().refused, Some(error));
        assert_names(second.will_write(output, output, false).unwrap_err().to_string(), &["overwritten"]);
    }

    #[test]
    fn an_input_is_recognised_under_any_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("sub")).unwrap();
        fs::write(path("cube.npz"), "measured").unwrap();
        assert_refused(&path("cube.npz"), &path("cube.npz"));
        assert_refused(&path("cube.npz"), &path("sub/../cube.npz"));
        #[cfg(unix)]
        {
            use std::os::unix::fs::symlink;
            fs::hard_link(path("cube.npz"), path("hard.npz")).unwrap();
            symlink("cube.npz", path("soft.npz")).unwrap();
            symlink("soft.npz", path("softer.npz")).unwrap();
            symlink(folder.path(), path("sub/up")).unwrap();
            for name in ["hard.npz", "soft.npz", "softer.npz", "sub/up/cube.npz", "sub/up/hard.npz"] {
                assert_refused(&path("cube.npz"), &path(name));
                assert_refused(&path(name), &path("cube.npz"));
            }
        }
        fs::copy(path("cube.npz"), path("copy.npz")).unwrap();
        let files = JobFiles::default();
        read(&files, &path("cube.npz")).unwrap();
        read(&files, &path("cube.npz")).unwrap();
        announce(&files, &path("copy.npz")).unwrap();
        assert!(files.has_read(&path("cube.npz")) && !files.has_read(&path("copy.npz")));
    }

    #[test]
    fn an_output_is_announced_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let files = JobFiles::default();
        for name in ["v.npz", "new/v.npz", "w.npz"] {
            announce(&files, &path(name)).unwrap();
        }
        for name in ["v.npz", "./v.npz", "new/v.npz"] {
            let error = announce(&files, &path(name)).unwrap_err();
            assert_eq!(error.exit_status(), 2);
            assert_names(error.to_string(), &["v.npz", "output"]);
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink("w.npz", path("dangling.npz")).unwrap();
            let error = announce(&files, &path("dangling.npz")).unwrap_err();
            assert_names(error.to_string(), &["dangling.npz", "w.npz"]);
        }
        files.will_write(&path("v.npz"), &path("v.npz"), false).unwrap();
    }

    #[test]
    fn a_complete_output_may_be_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.exr");
        let files = JobFiles::default();
        announce(&files, &path).unwrap();
        fs::write(&path, "new").unwrap();
        assert!(read(&files, &path).is_err(), "another wrote it");
        files.wrote(&path);
        read(&files, &path).unwrap();
    }
}
