//! The choices that only run files have (the stages declare the others), and [`InputFile`].

use crate::choice::choice;
use crate::reconstruct::Solver;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

choice! {
    /// How a surface scatters.
    pub enum SurfaceKind: "surface" {
        /// A seeded random phase per reflector.
        Diffuse = "diffuse",
        /// Reflectors displaced along the normal; their amplitudes stay real.
        Rough = "rough",
        /// A mirror: all reflectors in phase.
        Smooth = "smooth",
    }
}

choice! {
    /// How amplitude depends on the angle of incidence at the speaker.
    pub enum Shading: "shading" {
        /// By the cosine of the angle.
        Lambert = "lambert",
        /// Not at all.
        None = "none",
    }
}

choice! {
    /// Where the microphones' positions come from.
    pub enum ArrayLayout: "layout" {
        /// A rectangle of `count` × `pitch` about `centre`.
        Grid = "grid",
        /// Vogel's spiral, in the ellipse within the same rectangle.
        Spiral = "spiral",
        /// Random positions in the same rectangle.
        Random = "random",
        /// The CSV or XML file named by `file`.
        File = "file",
    }
}

choice! {
    /// Whether the volume is refined, and how.
    pub enum RefineMethod: "method" {
        /// It is that of Eq. 13.
        None = "none",
        /// [`Solver::Cgls`].
        Cgls = "cgls",
        /// [`Solver::Fista`].
        Fista = "fista",
    }
}

impl RefineMethod {
    /// How it is refined, if it is.
    pub(crate) fn solver(self) -> Option<Solver> {
        match self {
            Self::None => None,
            Self::Cgls => Some(Solver::Cgls),
            Self::Fista => Some(Solver::Fista),
        }
    }
}

choice! {
    /// File formats of the volume.
    pub enum VolumeFormat: "format" {
        /// EXR, one part per depth.
        Exr = "exr",
        /// Zipped `NumPy` arrays.
        Npz = "npz",
        /// A Zarr store, which xarray, tensorstore, napari and neuroglancer open.
        Zarr = "zarr",
        /// VTK image data, which `ParaView` opens.
        Vti = "vti",
        /// NRRD, which 3D Slicer and ITK open.
        Nrrd = "nrrd",
        /// OpenVDB, which Blender and Houdini open.
        Vdb = "vdb",
    }
}

/// A file that a run file names: its path as typed, and its resolved path.
///
/// Only the path as typed is written out again, so that a resolved run file has the same bytes wherever it was read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub struct InputFile {
    /// As typed.
    pub typed: String,
    /// The path to open: `typed`, relative to the run file's folder.
    pub path: PathBuf,
}

impl InputFile {
    /// A file whose path needs no resolving.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        let path = path.into();
        Self { typed: path.to_string_lossy().into_owned(), path }
    }

    /// Sets `path` to `typed` relative to `folder`.
    pub(super) fn locate(&mut self, folder: &Path) {
        self.path = folder.join(&self.typed);
    }
}

impl AsRef<Path> for InputFile {
    fn as_ref(&self) -> &Path {
        &self.path
    }
}

impl From<String> for InputFile {
    fn from(typed: String) -> Self {
        Self::new(typed)
    }
}

impl From<InputFile> for String {
    fn from(file: InputFile) -> Self {
        file.typed
    }
}
