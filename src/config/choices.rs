//! The words a run file chooses from (most are the stages' own), and the two values that are more than a number or a word: [`Fill`] and
//! [`InputFile`].

pub use crate::acquisition::{Detection as DetectionKind, PropagationModel as Model};
pub use crate::depth::{Pick, Refine};
pub use crate::export::{Components, Compression};
pub use crate::grid::View;
pub use crate::reconstruct::{Method, Window};
pub use crate::reflectors::OcclusionKind as Occlusion;
pub use crate::scene::{Unit, Up};
use serde::de::{self, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::path::{Path, PathBuf};

/// Declares an enumeration whose variants are written in a run file in kebab case.
macro_rules! choice {
    ($(#[$about:meta])* $name:ident { $($(#[$meaning:meta])* $variant:ident),+ $(,)? }) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case")]
        pub enum $name { $($(#[$meaning])* $variant),+ }
    };
}

choice! {
    /// How a surface scatters.
    Surface {
        /// A seeded random phase per reflector.
        Diffuse,
        /// Reflectors displaced along the normal; their amplitudes stay real.
        Rough,
        /// A mirror: all reflectors in phase.
        Smooth,
    }
}

choice! {
    /// How amplitude depends on the angle of incidence at the speaker.
    Shading {
        /// By its cosine.
        Lambert,
        /// Not at all.
        None,
    }
}

choice! {
    /// Who moves.
    Geometry {
        /// One speaker that stays, and an array of microphones: path |p − s| + |p − r|.
        FixedSource,
        /// Speaker and microphone scan the array together: path 2|p − r|.
        Monostatic,
    }
}

choice! {
    /// Where the microphones' positions come from.
    Layout {
        /// A rectangle of `count` × `pitch` about `centre`.
        Grid,
        /// Vogel's spiral, in the ellipse within the same rectangle.
        Spiral,
        /// Random places in the same rectangle.
        Random,
        /// The CSV or XML file named by `file`.
        File,
    }
}

choice! {
    /// File formats of the volume.
    VolumeFormat {
        /// EXR, one part per depth.
        Exr,
        /// Zipped `NumPy` arrays.
        Npz,
        /// VTK image data, which `ParaView` opens.
        Vti,
        /// NRRD, which 3D Slicer and ITK open.
        Nrrd,
    }
}

/// What `Z` holds where no return was accepted: written `"inf"`, `"nan"`, or a number of m.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fill {
    /// Plus infinity.
    Inf,
    /// Not a number.
    Nan,
    /// This depth, m.
    Depth(f64),
}

impl Fill {
    /// The value itself, m.
    pub fn value(self) -> f64 {
        match self {
            Self::Inf => f64::INFINITY,
            Self::Nan => f64::NAN,
            Self::Depth(depth) => depth,
        }
    }
}

impl From<Fill> for crate::export::depth_exr::Fill {
    fn from(fill: Fill) -> Self {
        match fill {
            Fill::Inf => Self::Infinity,
            Fill::Nan => Self::NaN,
            Fill::Depth(depth) => Self::Value(depth as f32),
        }
    }
}

impl Serialize for Fill {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Inf => serializer.serialize_str("inf"),
            Self::Nan => serializer.serialize_str("nan"),
            Self::Depth(depth) => serializer.serialize_f64(*depth),
        }
    }
}

impl<'de> Deserialize<'de> for Fill {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct FillVisitor;
        impl Visitor<'_> for FillVisitor {
            type Value = Fill;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("\"inf\", \"nan\" or a number of metres")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Fill, E> {
                match text {
                    "inf" => Ok(Fill::Inf),
                    "nan" => Ok(Fill::Nan),
                    _ => Err(E::invalid_value(de::Unexpected::Str(text), &self)),
                }
            }

            // TOML spells infinity and NaN without quotes, and either spelling is clear.
            fn visit_f64<E: de::Error>(self, depth: f64) -> Result<Fill, E> {
                if depth.is_nan() {
                    Ok(Fill::Nan)
                } else if depth == f64::INFINITY {
                    Ok(Fill::Inf)
                } else if depth.is_finite() {
                    Ok(Fill::Depth(depth))
                } else {
                    Err(E::invalid_value(de::Unexpected::Float(depth), &self))
                }
            }

            fn visit_i64<E: de::Error>(self, depth: i64) -> Result<Fill, E> {
                Ok(Fill::Depth(depth as f64))
            }

            fn visit_u64<E: de::Error>(self, depth: u64) -> Result<Fill, E> {
                Ok(Fill::Depth(depth as f64))
            }
        }
        deserializer.deserialize_any(FillVisitor)
    }
}

/// A file that a run file names: as typed, and where that is.
///
/// Only what was typed is written out again, so that a resolved run file has the same bytes wherever it was
/// read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub struct InputFile {
    /// As typed.
    pub typed: String,
    /// To be opened: `typed`, seen from the run file's folder.
    pub path: PathBuf,
}

impl InputFile {
    /// A file named by a path that needs no resolving.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        let path = path.into();
        Self { typed: path.to_string_lossy().into_owned(), path }
    }

    /// Sets `path` to `typed` as seen from `folder`.
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
        let path = PathBuf::from(&typed);
        Self { typed, path }
    }
}

impl From<InputFile> for String {
    fn from(file: InputFile) -> Self {
        file.typed
    }
}
