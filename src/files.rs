//! Writes files completely or not at all.
//!
//! Takes a path and a closure that writes the bytes; gives a file that other processes never see incomplete. Every file
//! of this crate is written by [`write_atomically`], `.npz` files are read and written by [`npz`], and the header of
//! PLY files by `ply`.

pub(crate) mod npz;
pub(crate) mod ply;
pub(crate) mod unfinished;

use crate::error::{Error, Result};
use std::fs::{self, File, TryLockError};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use unfinished::Unfinished;

/// Writes a file atomically: readers see either the old file or the complete new one.
///
/// The bytes go to a temporary file in the target's own folder, which is flushed, synchronised and only then
/// renamed to `path`. A missing folder is created; a symbolic link is followed. The new file gets the
/// permissions that any newly created file gets.
///
/// `write` may seek within the file, which starts empty; through the `BufWriter` it can access the file itself,
/// which is also open for reading.
///
/// # Errors
/// [`Error::Io`] when a step fails, including `write`: the temporary file is then removed, and an older
/// file at `path` is unchanged. [`Error::InvalidInput`] when `path` is a folder or a device.
pub(crate) fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<&File>) -> io::Result<()>,
) -> Result<()> {
    let file = AtomicFile::create(path)?;
    let mut buffer = BufWriter::with_capacity(1 << 16, file.file());
    write(&mut buffer).and_then(|()| buffer.flush()).map_err(|error| Error::writing(path, error))?;
    drop(buffer);
    file.commit()
}

/// The extension of a path in lower case, by which formats are recognised; empty if there is none.
pub(crate) fn extension(path: &Path) -> String {
    path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase()
}

/// A file that is being written under a temporary name in its own folder. It is removed unless it is committed.
#[derive(Debug)]
pub(crate) struct AtomicFile {
    path: PathBuf,
    target: PathBuf,
    file: tempfile::NamedTempFile,
    _unfinished: Unfinished,
}

impl AtomicFile {
    /// Begins a file; a missing folder is created.
    ///
    /// # Errors
    /// As [`write_atomically`].
    pub(crate) fn create(path: &Path) -> Result<Self> {
        let target = resolve(path)?;
        let failed = |error: io::Error| Error::writing(path, error);
        let folder = match target.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        fs::create_dir_all(folder).map_err(failed)?;
        let prefix = part_prefix(&target);
        remove_abandoned(folder, &prefix);
        let make = || tempfile::Builder::new().prefix(&prefix).suffix(PART).make_in(folder, open_locked);
        let (file, unfinished) = Unfinished::make(make, |file| file.path()).map_err(failed)?;
        Ok(Self { path: path.to_owned(), target, file, _unfinished: unfinished })
    }

    /// The path that the file gets when it is committed.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The file, empty at first, open for reading and writing.
    pub(crate) fn file(&self) -> &File {
        self.file.as_file()
    }

    /// Renames the file to its final path, once every byte of it is on the disk.
    ///
    /// # Errors
    /// As [`write_atomically`].
    pub(crate) fn commit(self) -> Result<()> {
        let failed = |error: io::Error| Error::writing(&self.path, error);
        self.file.as_file().sync_all().map_err(failed)?;
        self.file.persist(&self.target).map_err(|error| failed(error.error))?;
        // The new name should survive a power cut too; where a folder cannot be synchronised, the file is complete anyway.
        #[cfg(unix)]
        if let Some(folder) = self.target.parent().and_then(|folder| File::open(nearest(folder)).ok()) {
            let _ = folder.sync_all();
        }
        Ok(())
    }
}

/// Suffix of the names of unfinished files.
const PART: &str = ".part";

/// Prefix of the names of a target's unfinished files.
fn part_prefix(target: &Path) -> String {
    let name = target.file_name().unwrap_or_default().to_string_lossy();
    // With prefix and suffix a name must not exceed 255 bytes.
    let short: String = name.chars().take(48).collect();
    format!(".{short}.")
}

/// Creates an unfinished file and locks it, so that no process treats it as abandoned.
fn open_locked(candidate: &Path) -> io::Result<File> {
    // Opened here rather than by tempfile, which would make it readable only by its owner.
    let file = File::options().read(true).write(true).create_new(true).open(candidate)?;
    // Without support for locks, no file is ever treated as abandoned.
    let locked = !matches!(file.try_lock(), Err(TryLockError::WouldBlock));
    // Between creation and lock it may have been removed as abandoned; then another name is tried.
    if locked && candidate.exists() { Ok(file) } else { Err(io::ErrorKind::AlreadyExists.into()) }
}

/// Removes unfinished files of the same target that killed processes left.
fn remove_abandoned(folder: &Path, prefix: &str) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let random = name.to_str().and_then(|name| name.strip_prefix(prefix)?.strip_suffix(PART));
        if !random
            .is_some_and(|random| random.len() == 6 && random.bytes().all(|b| b.is_ascii_alphanumeric()))
        {
            continue;
        }
        let abandoned = File::options().write(true).open(entry.path()).is_ok_and(|f| f.try_lock().is_ok());
        if abandoned {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// The folder itself, or the nearest above it that exists.
fn nearest(folder: &Path) -> &Path {
    let existing = folder.ancestors().find(|folder| folder.exists());
    existing.filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Checks before any long work whether a file can be written at `path` later; creates nothing.
///
/// # Errors
/// [`Error::InvalidInput`] when `path` is a folder or a device, or is inside a file; [`Error::Io`] when its folder is
/// not writable.
pub(crate) fn check_writable(path: &Path) -> Result<()> {
    let target = resolve(path)?;
    check_folder(target.parent().unwrap_or(Path::new(".")))
}

/// The same check for files in a folder, which may not exist yet.
///
/// # Errors
/// As [`check_writable`].
pub(crate) fn check_folder(folder: &Path) -> Result<()> {
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

/// The file that `path` refers to, or why it cannot be replaced.
fn resolve(path: &Path) -> Result<PathBuf> {
    if path.file_name().is_none() {
        return Err(Error::input(path.display(), "names no file to write; give a file name"));
    }
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => {
            Err(Error::input(path.display(), "is a folder; give the name of a file to write"))
        }
        // Renaming onto a device would remove the device.
        Ok(found) if !found.is_file() => {
            Err(Error::input(path.display(), "is a device or a pipe; give the name of an ordinary file"))
        }
        Ok(_) => fs::canonicalize(path).map_err(|error| Error::writing(path, error)),
        Err(_) => Ok(path.to_path_buf()),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_failure_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("depth.exr");
        write_atomically(&path, |out| out.write_all(b"old")).unwrap();
        let error = write_atomically(&path, |out| {
            out.write_all(b"half of the n")?;
            Err(io::Error::other("disk full"))
        })
        .unwrap_err();
        assert_names(error.to_string(), &["depth.exr", "disk full"]);
        assert_eq!(error.exit_status(), 1);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["depth.exr"]);
    }

    #[test]
    fn a_missing_folder_is_made_and_an_old_file_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b/report.json");
        write_atomically(&path, |out| out.write_all(b"one")).unwrap();
        write_atomically(&path, |out| out.write_all(b"two")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(names(&folder.path().join("a/b")), ["report.json"]);
    }

    #[test]
    fn the_file_is_as_readable_as_any_other() {
        let folder = tempfile::tempdir().unwrap();
        let (ours, ordinary) = (folder.path().join("ours"), folder.path().join("ordinary"));
        write_atomically(&ours, |out| out.write_all(b"x")).unwrap();
        fs::write(&ordinary, b"x").unwrap();
        assert_eq!(fs::metadata(ours).unwrap().permissions(), fs::metadata(ordinary).unwrap().permissions());
    }

    #[test]
    fn a_folder_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let error = write_atomically(folder.path(), |_| Ok(())).unwrap_err();
        assert_eq!(error.exit_status(), 2, "{error}");
        assert!(write_atomically(Path::new(""), |_| Ok(())).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn a_link_is_followed_and_a_device_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (target, link) = (folder.path().join("target"), folder.path().join("link"));
        fs::write(&target, b"old").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        write_atomically(&link, |out| out.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&target).unwrap(), b"new");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(write_atomically(Path::new("/dev/null"), |_| Ok(())).unwrap_err().exit_status(), 2);
    }
}
