//! Volume files: one module for each format, and what the formats that are written depth by depth have in common.

pub mod exr;
pub mod npz;
pub mod nrrd;
pub(super) mod reading;
pub mod vdb;
pub mod vti;
pub mod zarr;

use crate::error::{Error, Result};
use crate::export::Components;
use crate::files::{AtomicFile, AtomicStore};
use crate::grid::Volume;
use num_complex::Complex32;
use std::fmt;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// A real number of a complex sample.
pub(super) type Component = fn(&Complex32) -> f32;

impl Components {
    /// Name and value of each component in a file.
    pub(super) fn list(self) -> &'static [(&'static str, Component)] {
        let all: &[(&str, Component)] =
            &[("amplitude", |sample| sample.norm()), ("re", |sample| sample.re), ("im", |sample| sample.im)];
        match self {
            Self::Amplitude => &all[..1],
            Self::Complex => all,
        }
    }
}

/// Writes one component of samples as little-endian floats.
pub(super) fn write_floats(
    out: &mut dyn Write,
    samples: &[Complex32],
    component: Component,
) -> io::Result<()> {
    let mut bytes = Vec::with_capacity(1 << 14);
    for block in samples.chunks(1 << 12) {
        bytes.clear();
        bytes.extend(block.iter().flat_map(|sample| component(sample).to_le_bytes()));
        out.write_all(&bytes)?;
    }
    Ok(())
}

/// The encoder of a format, which receives the depths in order.
pub(super) trait VolumeStream: Send {
    /// Writes the next depths, `[plane, y, x]`.
    fn planes(&mut self, planes: &[Complex32]) -> io::Result<()>;

    /// Writes the end of the file, and flushes.
    fn finish(self: Box<Self>) -> io::Result<()>;
}

/// What gets its name when it is complete.
enum Target {
    File(AtomicFile),
    Store(AtomicStore),
}

impl Target {
    fn path(&self) -> &Path {
        match self {
            Self::File(file) => file.path(),
            Self::Store(store) => store.path(),
        }
    }
}

/// A volume file that is being written.
pub(crate) struct VolumeFile<'a> {
    target: Target,
    stream: Box<dyn VolumeStream + 'a>,
}

impl fmt::Debug for VolumeFile<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "VolumeFile({})", self.target.path().display())
    }
}

impl<'a> VolumeFile<'a> {
    /// Begins a file; `begin` writes its header and returns the encoder.
    pub(super) fn create<S: VolumeStream + 'a>(
        path: &Path,
        begin: impl FnOnce(BufWriter<File>) -> io::Result<S>,
    ) -> Result<Self> {
        let file = AtomicFile::create(path)?;
        let stream = file
            .file()
            .try_clone()
            .and_then(|file| begin(BufWriter::with_capacity(1 << 16, file)))
            .map_err(|error| Error::writing(path, error))?;
        Ok(Self { target: Target::File(file), stream: Box::new(stream) })
    }

    /// Begins a store; `begin` writes into a folder, and returns the encoder.
    pub(super) fn create_store<S: VolumeStream + 'a>(
        path: &Path,
        begin: impl FnOnce(&Path) -> io::Result<S>,
    ) -> Result<Self> {
        let store = AtomicStore::create(path)?;
        let stream = begin(store.folder()).map_err(|error| Error::writing(path, error))?;
        Ok(Self { target: Target::Store(store), stream: Box::new(stream) })
    }

    /// Appends the next depths, `[plane, y, x]`.
    ///
    /// # Errors
    /// [`Error::Io`] if they cannot be written.
    pub(crate) fn take(&mut self, planes: &[Complex32]) -> Result<()> {
        self.stream.planes(planes).map_err(|error| Error::writing(self.target.path(), error))?;
        if let Target::File(file) = &mut self.target {
            file.begin_to_store();
        }
        Ok(())
    }

    /// Completes the file and gives it its name.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be written; an existing file is then unchanged.
    pub(crate) fn finish(self) -> Result<()> {
        let Self { target, stream } = self;
        stream.finish().map_err(|error| Error::writing(target.path(), error))?;
        match target {
            Target::File(file) => file.commit(),
            Target::Store(store) => store.commit(),
        }
    }

    /// Writes all of a volume at once.
    pub(super) fn whole(mut self, volume: &Volume) -> Result<()> {
        self.take(&volume.samples)?;
        self.finish()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::grid::{Axis, Grid};

    /// A volume of 3 x 2 voxels per depth, whose amplitude grows from voxel to voxel, for the tests of all formats.
    pub(in crate::export) fn volume(depths: usize) -> Volume {
        let grid = Grid {
            x: Axis { first: -0.1, pitch: 0.1 / 3.0, count: 3 },
            y: Axis { first: 0.7, pitch: 0.2, count: 2 },
            z: Axis { first: 1.3, pitch: 0.007, count: depths },
        };
        Volume::new(grid, (0..6 * depths).map(|i| Complex32::new(i as f32, -(i as f32))).collect())
    }
}
