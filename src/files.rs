//! Reads and writes files: writes them completely or not at all, and never over an input.
//!
//! Takes a path and a closure that writes the bytes; gives a file that other processes never see incomplete. Every file
//! of this crate is written by [`write_atomically`] and opened for reading by [`open_input`]; `job_files` compares the two.
//! A Zarr store, which is a folder, is written like a file by `store`. `.npz` files are read and written by [`npz`] and stores
//! by [`zarr`], either by [`arrays`]; `.npy` files read, the header of PLY files by `ply`, and `.wav` files by [`wav`].

pub(crate) mod arrays;
mod folder;
mod input;
mod job_files;
pub(crate) mod npz;
pub(crate) mod ply;
mod store;
pub(crate) mod unfinished;
pub(crate) mod wav;
pub(crate) mod zarr;

pub(crate) use folder::{NewFolders, OutputFolder, free_space};
pub(crate) use input::open_input;
pub(crate) use job_files::{check_inputs, check_is_no_input, is_input, protect_inputs};
pub(crate) use store::AtomicStore;

use crate::error::{Error, Result};
use folder::{check_folder, nearest};
use std::fs::{self, File, TryLockError};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use unfinished::Unfinished;

/// Writes a file atomically: readers see either the old file or the complete new one.
///
/// The bytes go to a temporary file in the target's own folder, which is flushed, synchronised and only then
/// renamed to `path`. A missing folder is created; a symbolic link is followed, also to a file that does not exist yet.
/// The new file gets the permissions and the group of the one that it replaces, or else those of any newly created file.
///
/// `write` may seek within the file, which starts empty; through the `BufWriter` it can access the file itself,
/// which is also open for reading.
///
/// # Errors
/// [`Error::Io`] when a step fails, including `write`: the temporary file is then removed, and an older
/// file at `path` is unchanged. [`Error::InvalidInput`] when `path` is a folder, a device or an input of the process.
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
    // Dropped in this order, so that new folders are empty again.
    file: tempfile::NamedTempFile,
    folders: NewFolders,
    _unfinished: Unfinished,
    /// Bytes that the disk has begun with.
    begun: u64,
}

impl AtomicFile {
    /// Begins a file; a missing folder is created.
    ///
    /// # Errors
    /// As [`write_atomically`].
    pub(crate) fn create(path: &Path) -> Result<Self> {
        let target = resolve(path)?;
        let (file, folders, unfinished) = make_unfinished(path, &target, open_locked)?;
        #[cfg(unix)]
        if let Ok(old) = fs::metadata(&target) {
            // Before it has any content that the old file's permissions protect.
            take_permissions(file.as_file(), &old);
        }
        Ok(Self { path: path.to_owned(), target, file, folders, _unfinished: unfinished, begun: 0 })
    }

    /// The path that the file gets when it is committed.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The file, empty at first, open for reading and writing.
    pub(crate) fn file(&self) -> &File {
        self.file.as_file()
    }

    /// Has the disk begin with what was appended since the last time, so that there is less to wait for when the file is
    /// committed.
    pub(crate) fn begin_to_store(&mut self) {
        let end = self.file().metadata().map_or(self.begun, |known| known.len());
        // A hint, which may be ignored: what is not needed in memory is written at once. Elsewhere there is none.
        #[cfg(target_os = "linux")]
        if let Some(length) = std::num::NonZeroU64::new(end.saturating_sub(self.begun)) {
            let _ = rustix::fs::fadvise(self.file(), self.begun, Some(length), rustix::fs::Advice::DontNeed);
        }
        self.begun = end;
    }

    /// Renames the file to its final path, once every byte of it is on the disk.
    ///
    /// # Errors
    /// As [`write_atomically`].
    pub(crate) fn commit(self) -> Result<()> {
        let failed = |error: io::Error| Error::writing(&self.path, error);
        self.file.as_file().sync_all().map_err(failed)?;
        self.file.persist(&self.target).map_err(|error| failed(error.error))?;
        appeared(&self.target, self.folders);
        Ok(())
    }
}

/// Makes something under a temporary name beside a target, which is announced; a missing folder above it is created.
fn make_unfinished<T>(
    path: &Path,
    target: &Path,
    mut make: impl FnMut(&Path) -> io::Result<T>,
) -> Result<(tempfile::NamedTempFile<T>, NewFolders, Unfinished)> {
    let failed = |error: io::Error| Error::writing(path, error);
    if let Some(files) = job_files::of_process() {
        files.will_write(path, target, false)?;
    }
    let folder = parent_of(target);
    let folders = NewFolders::create(folder).map_err(failed)?;
    let prefix = part_prefix(target);
    remove_abandoned(folder, &prefix);
    let make = || tempfile::Builder::new().prefix(&prefix).suffix(PART).make_in(folder, &mut make);
    let (made, unfinished) = Unfinished::make(make, |made| made.path()).map_err(failed)?;
    Ok((made, folders, unfinished))
}

/// Records that a target has appeared, in folders that stay now.
fn appeared(target: &Path, folders: NewFolders) {
    folders.keep();
    if let Some(files) = job_files::of_process() {
        files.wrote(target);
    }
    // The new name should survive a power cut too; where a folder cannot be synchronised, the result is complete anyway.
    #[cfg(unix)]
    if let Ok(folder) = File::open(nearest(parent_of(target))) {
        let _ = folder.sync_all();
    }
}

/// The folder in which a path is.
fn parent_of(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Whether a result of this name is a store, which is a folder.
pub(crate) fn is_store(path: &Path) -> bool {
    extension(path) == "zarr"
}

/// Suffix of the names of unfinished files and stores.
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

/// Removes unfinished files and stores of the same target that killed processes left.
fn remove_abandoned(folder: &Path, prefix: &str) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let random = name.to_str().and_then(|name| name.strip_prefix(prefix)?.strip_suffix(PART));
        if !random
            .is_some_and(|random| random.len() == 6 && random.bytes().all(|b| b.is_ascii_alphanumeric()))
        {
            continue;
        }
        let path = entry.path();
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            if File::open(&path).is_ok_and(|folder| folder.try_lock().is_ok()) {
                let _ = fs::remove_dir_all(&path);
            }
        } else if is_abandoned(&path) {
            let _ = fs::remove_file(&path);
        }
    }
}

/// Whether an unfinished file is nobody's: a regular file that no process has locked, and no input of this one.
fn is_abandoned(path: &Path) -> bool {
    // A link or a pipe of such a name is not ours; and a pipe could keep us waiting.
    fs::symlink_metadata(path).is_ok_and(|about| about.is_file())
        && !is_input(path)
        // Network file systems lock only what may be written; a file may have taken a mode in which it may not.
        && File::options()
            .read(true)
            .write(true)
            .open(path)
            .or_else(|_| File::open(path))
            .is_ok_and(|file| file.try_lock().is_ok())
}

/// Gives a new file the permissions and, as far as allowed, the owner of the file that it will replace. Some file systems
/// have neither.
#[cfg(unix)]
fn take_permissions(new: &File, old: &fs::Metadata) {
    use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
    let mut mode = old.mode() & 0o777;
    let Ok(created) = new.metadata() else { return };
    if (created.uid(), created.gid()) != (old.uid(), old.gid())
        && fchown(new, Some(old.uid()), Some(old.gid())).is_err()
        && fchown(new, None, Some(old.gid())).is_err()
        && created.gid() != old.gid()
    {
        // Another group may do no more than everybody.
        mode &= 0o707 | ((mode & 0o007) << 3);
    }
    let _ = new.set_permissions(fs::Permissions::from_mode(mode));
}

/// Checks before any long work whether a file can be written at `path` later, and that this replaces no input and no other
/// output of the process; creates nothing. Every command announces all its outputs, each once, as soon as it knows them.
///
/// # Errors
/// [`Error::InvalidInput`] when `path` is a folder (or, for a store, one that may not be replaced) or a device, is inside a
/// file, or is another file of the process; [`Error::Io`] when its folder is not writable.
pub(crate) fn announce_output(path: &Path) -> Result<()> {
    let target = if is_store(path) { store::resolve(path)? } else { resolve(path)? };
    check_folder(target.parent().unwrap_or(Path::new(".")))?;
    job_files::of_process().map_or(Ok(()), |files| files.will_write(path, &target, true))
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
        Err(_) => free_target(path),
    }
}

/// The end of a chain of symbolic links where there is nothing yet.
fn free_target(path: &Path) -> Result<PathBuf> {
    let target = target_of(path);
    if target.is_symlink() {
        return Err(Error::input(path.display(), "is a loop of symbolic links; give another name"));
    }
    Ok(target)
}

/// The path at the end of a chain of symbolic links, whether there is a file or not.
fn target_of(path: &Path) -> PathBuf {
    /// As many as Linux follows.
    const LINKS: usize = 40;
    let mut target = path.to_path_buf();
    for _ in 0..LINKS {
        let Ok(next) = fs::read_link(&target) else { break };
        // A relative link begins in its own folder; an absolute one replaces everything.
        target = target.parent().unwrap_or(Path::new("")).join(next);
    }
    target
}

#[cfg(test)]
pub(crate) mod tests;
