//! A volume file that is written depth by depth, whatever its format, and appears when it is whole.

use crate::error::{Error, Result};
use crate::files::AtomicFile;
use crate::grid::Volume;
use num_complex::Complex32;
use std::fmt;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

/// What a format does with neighbouring depths as they come.
pub(super) trait VolumeStream: Send {
    /// Takes the next depths, `[plane, y, x]`.
    fn planes(&mut self, planes: &[Complex32]) -> io::Result<()>;

    /// Writes what comes after the last, and flushes.
    fn finish(self: Box<Self>) -> io::Result<()>;
}

/// A volume file on its way.
pub(crate) struct VolumeFile {
    file: AtomicFile,
    stream: Box<dyn VolumeStream>,
}

impl fmt::Debug for VolumeFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "VolumeFile({})", self.file.path().display())
    }
}

impl VolumeFile {
    /// Begins a file with what `begin` makes of it.
    pub(super) fn create<S: VolumeStream + 'static>(
        path: &Path,
        begin: impl FnOnce(BufWriter<File>) -> io::Result<S>,
    ) -> Result<Self> {
        let file = AtomicFile::create(path)?;
        let stream = file
            .file()
            .try_clone()
            .and_then(|file| begin(BufWriter::with_capacity(1 << 16, file)))
            .map_err(|error| Error::writing(path, error))?;
        Ok(Self { file, stream: Box::new(stream) })
    }

    /// Adds the next depths, `[plane, y, x]`.
    ///
    /// # Errors
    /// [`Error::Io`] when they cannot be written.
    pub(crate) fn take(&mut self, planes: &[Complex32]) -> Result<()> {
        self.stream.planes(planes).map_err(|error| Error::writing(self.file.path(), error))
    }

    /// Ends the file and gives it its name.
    ///
    /// # Errors
    /// [`Error::Io`] when it cannot be written; an older file is then left as it was.
    pub(crate) fn finish(self) -> Result<()> {
        let Self { file, stream } = self;
        stream.finish().map_err(|error| Error::writing(file.path(), error))?;
        file.commit()
    }

    /// All of a volume at once.
    pub(super) fn whole(mut self, volume: &Volume) -> Result<()> {
        self.take(&volume.samples)?;
        self.finish()
    }
}
