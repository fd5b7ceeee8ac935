//! Opens files for reading: every input of the crate is opened here.

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
    let about = file.metadata().map_err(failed)?;
    need_regular(path, &about)?;
    if let Some(files) = job_files::of_process() {
        files.read(path, &about)?;
    }
    Ok(file)
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
