//! Folders for results: created, checked and locked before the work, and gone if nothing was written.

use super::unfinished::Unfinished;
use super::{PART, extension};
use crate::error::{Error, Result};
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// The folders that creating one folder made; dropped, it removes those of them that are empty.
#[derive(Debug, Default)]
pub(crate) struct NewFolders {
    folders: Vec<PathBuf>,
    unfinished: Vec<Unfinished>,
}

impl NewFolders {
    /// Creates a folder and those above it that are missing.
    pub(crate) fn create(folder: &Path) -> io::Result<Self> {
        let missing = folder.ancestors().take_while(|folder| !is_there(folder)).map(Path::to_path_buf);
        // If only some can be created, they are removed at once.
        let mut new = Self { folders: missing.collect(), unfinished: Vec::new() };
        fs::create_dir_all(folder)?;
        // The outermost first: the last is removed first.
        new.unfinished = new.folders.iter().rev().map(|folder| Unfinished::listed(folder)).collect();
        Ok(new)
    }

    /// Leaves the folders as they are.
    pub(super) fn keep(mut self) {
        self.folders.clear();
    }
}

impl Drop for NewFolders {
    fn drop(&mut self) {
        for folder in &self.folders {
            // This fails where there is a file in it, which is how such a folder remains.
            let _ = fs::remove_dir(folder);
        }
        self.unfinished.clear();
    }
}

fn is_there(folder: &Path) -> bool {
    folder.as_os_str().is_empty() || folder.exists()
}

/// The folder into which a command writes several files, while it does: no other command may write there at the same time.
///
/// Dropped, it removes the folder if the command created it and left nothing there.
#[derive(Debug)]
pub(crate) struct OutputFolder {
    // Dropped in this order: another process cannot begin in a folder that is about to be removed.
    _new: NewFolders,
    _lock: Option<File>,
}

impl OutputFolder {
    /// Creates a folder if it is missing, checks that files can be created in it, and locks it until it is dropped or the
    /// process ends, however that ends. Where the system cannot lock folders, as on some network file systems and on
    /// Windows, two commands are not noticed.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] when `folder` is a file, or when another process is writing into it; [`Error::Io`] when it
    /// cannot be created or written.
    pub(crate) fn open(folder: &Path) -> Result<Self> {
        let new = created(folder)?;
        let lock = File::open(folder).ok();
        if lock.as_ref().is_some_and(|lock| matches!(lock.try_lock(), Err(TryLockError::WouldBlock))) {
            // Both may have found no folder; it is the other's now.
            new.keep();
            return Err(Error::input(
                folder.display(),
                "is in use: another holosonar process is writing into this folder; wait for it, or give another folder",
            ));
        }
        check_folder(folder)?;
        Ok(Self { _new: new, _lock: lock })
    }

    /// The same for a command beside which others may write into the folder: it is not locked.
    ///
    /// # Errors
    /// As [`OutputFolder::open`], except for other processes.
    pub(crate) fn shared(folder: &Path) -> Result<Self> {
        let new = created(folder)?;
        check_folder(folder)?;
        Ok(Self { _new: new, _lock: None })
    }
}

/// Extensions of results that are files. A new folder with such a name is hardly what was meant.
const FILES: [&str; 13] =
    ["csv", "exr", "html", "json", "npz", "nrrd", "ply", "png", "toml", "vdb", "vti", "wav", "zarr"];

fn created(folder: &Path) -> Result<NewFolders> {
    let end = extension(folder);
    if FILES.contains(&end.as_str()) && !folder.exists() {
        let problem =
            format!("is the name of a file, and several are written here; give a folder, without .{end}");
        return Err(Error::input(folder.display(), problem));
    }
    NewFolders::create(folder).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists | io::ErrorKind::NotADirectory => {
            Error::input(folder.display(), "is a file; a folder was expected")
        }
        _ => Error::writing(folder, error),
    })
}

/// The folder itself, or the nearest above it that exists.
pub(super) fn nearest(folder: &Path) -> &Path {
    let existing = folder.ancestors().find(|folder| folder.exists());
    existing.filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Checks before any long work whether files can be created in a folder, which may not exist yet; creates nothing.
///
/// # Errors
/// [`Error::InvalidInput`] when it is inside a file; [`Error::Io`] when it is not writable.
pub(super) fn check_folder(folder: &Path) -> Result<()> {
    let existing = nearest(folder);
    if !existing.is_dir() {
        return Err(Error::input(existing.display(), "is a file; a folder was expected for the results"));
    }
    let probe = tempfile::Builder::new().prefix(".").suffix(PART).tempfile_in(existing);
    probe.map(drop).map_err(|error| Error::writing(folder, error))
}

/// Free bytes for a folder, or for the nearest above it that exists; `None` where they are not known.
pub(crate) fn free_space(folder: &Path) -> Option<u64> {
    #[cfg(unix)]
    {
        let found = rustix::fs::statvfs(nearest(folder)).ok()?;
        found.f_bavail.checked_mul(found.f_frsize)
    }
    #[cfg(not(unix))]
    {
        let _ = folder;
        None
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    #[test]
    fn a_new_folder_without_files_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let (outer, inner) = (folder.path().join("a"), folder.path().join("a/b/c"));
        drop(OutputFolder::open(&inner).unwrap());
        assert!(!outer.exists());
        let opened = OutputFolder::open(&inner).unwrap();
        fs::write(inner.join("depth.exr"), "x").unwrap();
        drop(opened);
        assert!(inner.join("depth.exr").exists());
        // An empty folder that was there before stays.
        let old = folder.path().join("old");
        fs::create_dir(&old).unwrap();
        drop(OutputFolder::open(&old).unwrap());
        assert!(old.exists());
        let error = OutputFolder::open(&inner.join("depth.exr/d")).unwrap_err();
        assert_eq!((error.exit_status(), inner.join("depth.exr").is_file()), (2, true));
        // The name of a file is refused, unless there is such a folder.
        let file = folder.path().join("new/volume.NPZ");
        for open in [OutputFolder::open, OutputFolder::shared] {
            assert_names(
                open(&file).unwrap_err().to_string(),
                &["volume.NPZ", "give a folder, without .npz"],
            );
            assert!(!folder.path().join("new").exists());
        }
        fs::create_dir_all(&file).unwrap();
        drop(OutputFolder::open(&file).unwrap());
    }

    #[cfg(unix)]
    #[test]
    fn a_folder_has_one_writer_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let first = OutputFolder::open(folder.path()).unwrap();
        let error = OutputFolder::open(folder.path()).unwrap_err();
        assert_eq!(error.exit_status(), 2);
        assert_names(error.to_string(), &[folder.path().to_str().unwrap(), "in use", "process"]);
        drop(first);
        OutputFolder::open(folder.path()).unwrap();
    }
}
