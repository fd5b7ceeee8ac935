//! Folders that are one result, as Zarr stores are: written completely or not at all, like a file.

use super::folder::NewFolders;
use super::unfinished::Unfinished;
use super::{appeared, free_target, make_unfinished, zarr};
use crate::error::{Error, Result};
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// A folder that is being written under a temporary name beside its target. It is removed unless it is committed.
#[derive(Debug)]
pub(crate) struct AtomicStore {
    path: PathBuf,
    target: PathBuf,
    // Dropped in this order, so that new folders are empty again.
    temporary: Temporary,
    folders: NewFolders,
    _unfinished: Unfinished,
}

/// The folder of a temporary name, which is removed with all that is in it; locked, so that no process treats it as abandoned.
#[derive(Debug)]
struct Temporary {
    path: PathBuf,
    _lock: Option<File>,
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.path);
    }
}

impl AtomicStore {
    /// Begins a store; a missing folder above it is created.
    ///
    /// # Errors
    /// [`Error::InvalidInput`] if `path` is anything but free or a store that may be replaced; [`Error::Io`] if the folder
    /// cannot be created.
    pub(crate) fn create(path: &Path) -> Result<Self> {
        let target = resolve(path)?;
        let (made, folders, unfinished) = make_unfinished(path, &target, create_locked)?;
        let (lock, temporary) = made.into_parts();
        // From here on it is removed as a folder.
        let temporary = temporary.keep().map_err(|error| Error::writing(path, error.error))?;
        #[cfg(unix)]
        if let (Ok(old), Some(new)) = (fs::metadata(&target), &lock) {
            super::take_permissions(new, &old);
        }
        let temporary = Temporary { path: temporary, _lock: lock };
        Ok(Self { path: path.to_owned(), target, temporary, folders, _unfinished: unfinished })
    }

    /// The path that the store gets when it is committed.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The folder in which it is written.
    pub(crate) fn folder(&self) -> &Path {
        &self.temporary.path
    }

    /// Gives the folder its final path, once every byte of it is on the disk. A store that it replaces is there until then,
    /// and removed afterwards.
    ///
    /// # Errors
    /// As [`AtomicStore::create`]: what is at `path` may have changed.
    pub(crate) fn commit(self) -> Result<()> {
        let failed = |error: io::Error| Error::writing(&self.path, error);
        synchronise(self.folder()).map_err(failed)?;
        if resolve(&self.path)?.exists() {
            exchange(self.folder(), &self.target).map_err(failed)?;
        } else {
            fs::rename(self.folder(), &self.target).map_err(failed)?;
        }
        appeared(&self.target, self.folders);
        Ok(())
    }
}

/// Creates a folder and locks it.
fn create_locked(candidate: &Path) -> io::Result<Option<File>> {
    fs::create_dir(candidate)?;
    // Where folders cannot be opened or locked, none is ever treated as abandoned.
    let lock = File::open(candidate).ok();
    let is_others =
        lock.as_ref().is_some_and(|lock| matches!(lock.try_lock(), Err(TryLockError::WouldBlock)));
    // Between creation and lock it may have been removed as abandoned; then another name is tried.
    if !is_others && candidate.exists() { Ok(lock) } else { Err(io::ErrorKind::AlreadyExists.into()) }
}

/// Exchanges two folders, at once where the system can.
fn exchange(new: &Path, old: &Path) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        use rustix::fs::{CWD, RenameFlags, renameat_with};
        if renameat_with(CWD, new, CWD, old, RenameFlags::EXCHANGE).is_ok() {
            return Ok(());
        }
    }
    exchange_in_steps(new, old)
}

/// The same where the system cannot: in between there is no store, and if the new one cannot be put in place the old one
/// comes back.
fn exchange_in_steps(new: &Path, old: &Path) -> io::Result<()> {
    let aside = new.with_extension("old");
    fs::rename(old, &aside)?;
    if let Err(error) = fs::rename(new, old) {
        fs::rename(&aside, old)?;
        return Err(error);
    }
    fs::rename(&aside, new)
}

/// Writes every file in a folder to the disk.
fn synchronise(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            synchronise(&entry.path())?;
        } else {
            File::options().write(true).open(entry.path())?.sync_all()?;
        }
    }
    Ok(())
}

/// The folder that `path` refers to, or why it cannot be replaced.
pub(super) fn resolve(path: &Path) -> Result<PathBuf> {
    if path.file_name().is_none() {
        return Err(Error::input(path.display(), "names nothing to write; give a name"));
    }
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => {
            zarr::check_replaceable(path)?;
            fs::canonicalize(path).map_err(|error| Error::writing(path, error))
        }
        Ok(_) => {
            let problem = "is a file, and a Zarr store is a folder; remove it, or give another name";
            Err(Error::input(path.display(), problem))
        }
        Err(_) => free_target(path),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    const GROUP: &str =
        r#"{"zarr_format":3,"node_type":"group","attributes":{"holosonar":{"store":"volume"}}}"#;

    fn write(path: &Path, chunk: &str) -> Result<()> {
        let store = AtomicStore::create(path)?;
        fs::write(store.folder().join("zarr.json"), GROUP).unwrap();
        fs::create_dir_all(store.folder().join("a/c")).unwrap();
        fs::write(store.folder().join("a/c/0"), chunk).unwrap();
        store.commit()
    }

    fn names(folder: &Path) -> Vec<String> {
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_store_appears_complete_and_replaces_its_own_kind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/v.zarr");
        let store = AtomicStore::create(&path).unwrap();
        fs::write(store.folder().join("zarr.json"), GROUP).unwrap();
        assert!(!path.exists());
        drop(store);
        assert!(!folder.path().join("new").exists(), "nothing is left");
        for content in ["first", "second"] {
            write(&path, content).unwrap();
            assert_eq!(fs::read_to_string(path.join("a/c/0")).unwrap(), content);
            assert_eq!(names(&folder.path().join("new")), ["v.zarr"]);
        }
        // Without the system's call.
        let other = folder.path().join("other.part");
        fs::create_dir(&other).unwrap();
        exchange_in_steps(&other, &path).unwrap();
        assert!(names(&path).is_empty());
        assert_eq!(fs::read_to_string(other.join("a/c/0")).unwrap(), "second");
        assert!(
            exchange_in_steps(&folder.path().join("gone"), &other).is_err() && other.join("a/c/0").exists()
        );
    }

    #[test]
    fn anything_else_is_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("v.zarr");
        fs::write(&path, "a file").unwrap();
        assert_names(write(&path, "x").unwrap_err().to_string(), &["v.zarr", "is a file"]);
        fs::remove_file(&path).unwrap();
        write(&path, "x").unwrap();
        let note = path.join("a/notes.txt");
        fs::write(&note, "mine").unwrap();
        assert_names(write(&path, "y").unwrap_err().to_string(), &["v.zarr", "notes.txt"]);
        assert!(note.exists());
        fs::remove_file(&note).unwrap();
        fs::write(path.join("zarr.json"), GROUP.replace("holosonar", "other")).unwrap();
        assert_names(write(&path, "y").unwrap_err().to_string(), &["v.zarr", "holosonar"]);
        fs::write(path.join("zarr.json"), "{").unwrap();
        assert_eq!(write(&path, "y").unwrap_err().exit_status(), 2);
        assert_eq!(fs::read_to_string(path.join("a/c/0")).unwrap(), "x");
        // An empty folder is nobody's.
        let empty = folder.path().join("w.zarr");
        fs::create_dir(&empty).unwrap();
        write(&empty, "x").unwrap();
        // What appears while a store is being written is not replaced either.
        let late = folder.path().join("late.zarr");
        let store = AtomicStore::create(&late).unwrap();
        fs::create_dir(&late).unwrap();
        fs::write(late.join("mine"), "mine").unwrap();
        assert_names(store.commit().unwrap_err().to_string(), &["late.zarr"]);
        assert_eq!(names(&late), ["mine"]);
    }

    #[test]
    fn what_a_killed_process_left_is_removed_and_what_is_in_use_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("v.zarr");
        let left = folder.path().join(".v.zarr.Abc123.part");
        fs::create_dir_all(left.join("a")).unwrap();
        let first = AtomicStore::create(&path).unwrap();
        let second = AtomicStore::create(&path).unwrap();
        assert!(!left.exists() && first.folder().exists() && second.folder().exists());
    }
}
