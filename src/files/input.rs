//! Opens files for reading, and folders that are one input: every input of the crate is opened here.

use super::job_files;
use crate::error::{Error, Result};
use std::fs::{self, File, Metadata};
use std::path::Path;

/// Opens a regular file for reading, after following links.
///
/// A pipe or a device is refused: it might never end, and readers of most formats go back and forth in a file. Opening one
/// never waits, even if it takes the file's place at the last moment.
///
/// # Errors
/// A file that is missing, a folder, not permitted, or not a regular file; one that is also an output of this process.
pub(crate) fn open_input(path: &Path) -> Result<File> {
    let file = open_regular(path)?;
    if let Some(files) = job_files::of_process() {
        files.read(path, &file.metadata().map_err(|error| Error::reading(path, error))?)?;
    }
    Ok(file)
}

/// The same for a file within a folder that is recorded as an input.
pub(super) fn open_regular(path: &Path) -> Result<File> {
    let failed = |error| Error::reading(path, error);
    need_regular(path, &fs::metadata(path).map_err(failed)?)?;
    let mut options = File::options();
    options.read(true);
    #[cfg(unix)]
    {
        use rustix::fs::OFlags;
        use std::os::unix::fs::OpenOptionsExt;
        options.custom_flags((OFlags::NONBLOCK | OFlags::NOCTTY).bits() as i32);
    }
    let file = options.open(path).map_err(failed)?;
    need_regular(path, &file.metadata().map_err(failed)?)?;
    Ok(file)
}

/// Records a folder that is one input, as Zarr stores are.
///
/// # Errors
/// One that is missing or a file; one that is also an output of this process.
pub(super) fn record_folder(path: &Path) -> Result<()> {
    let about = fs::metadata(path).map_err(|error| Error::reading(path, error))?;
    if !about.is_dir() {
        return Err(Error::input(path.display(), "is a file; a Zarr store is a folder"));
    }
    job_files::of_process().map_or(Ok(()), |files| files.read(path, &about))
}

fn need_regular(path: &Path, about: &Metadata) -> Result<()> {
    if about.is_dir() {
        return Err(Error::input(path.display(), "is a folder; a file was expected"));
    }
    if !about.is_file() {
        return Err(Error::input(
            path.display(),
            "is a pipe or a device, not a regular file; save its content in a file, and give that",
        ));
    }
    Ok(())
}
