//! Every form in which a result leaves: `OpenEXR`, VTK image data, NRRD, `NumPy` archives, PLY points, PNG figures, and a page
//! that shows it all.
//!
//! Takes the shapes of [`crate::grid`] and named facts about them ([`Attributes`]); gives files that are written
//! whole or not at all. Depth maps, volumes and points are read back too. No writer flips or smooths anything: an
//! image's column is x and its row is y.
//!
//! # Example
//! A depth map of two pixels, one of them empty, as an image for Blender and Nuke and as a figure for a paper:
//! ```
//! use holosonar::export::depth_exr::{read_depth_map, write_depth_map};
//! use holosonar::export::figure::{DepthKind, write_depth_figure};
//! use holosonar::export::{Attribute, Encoding, Fill};
//! use holosonar::grid::{Axis, DepthMap, Raster, Surface, View};
//!
//! let folder = std::env::temp_dir().join(format!("holosonar-{}", std::process::id()));
//! let path = folder.join("depth.exr");
//! let row = |count| Axis { first: 0.0, pitch: 0.01, count };
//! let picked = Surface { depth: vec![1.25, f32::NAN], strength: vec![0.5, 0.0], ..Surface::default() };
//! let map = DepthMap::new(Raster { view: View::Orthographic, x: row(2), y: row(1) }, picked);
//! let facts = [("sonar:seed".to_owned(), Attribute::Integer(1))];
//! write_depth_map(&path, &map, Fill::Infinity, &facts, Encoding::default())?;
//! let file = read_depth_map(&path, 1 << 20)?;
//! assert_eq!((file.map.picked.depth[0], file.map.accepted()), (1.25, 1));
//! write_depth_figure(&folder.join("depth.png"), DepthKind::Found, &map, None)?;
//! # std::fs::remove_dir_all(&folder).unwrap();
//! # Ok::<(), holosonar::error::Error>(())
//! ```

pub mod amplitude;
pub mod depth_exr;
mod exr_file;
mod fill;
pub mod figure;
pub(crate) mod page;
pub mod points_ply;
pub mod volume_exr;
mod volume_file;
pub mod volume_npz;
pub mod volume_nrrd;
mod volume_reading;
pub mod volume_vti;

pub use fill::Fill;
pub(crate) use volume_file::VolumeFile;

/// A fact about a result that its file carries along.
#[derive(Debug, Clone, PartialEq)]
pub enum Attribute {
    /// Words. EXR keeps ASCII alone: other characters are written as `\u00e9`, as JSON writes them.
    Text(String),
    /// A number, in the SI unit of the quantity it is named after.
    Number(f64),
    /// A whole number. EXR keeps 32 bits: what lies beyond is written as a [`Attribute::Number`].
    Integer(i64),
    /// A position or an extent along x, y, z; m unless its name says otherwise.
    Vector([f64; 3]),
}

/// Named facts, in the order in which they are to appear; names start with `sonar:`.
pub type Attributes = Vec<(String, Attribute)>;

use crate::choice::choice;

choice! {
    /// Which numbers of a complex volume a file holds.
    #[derive(Default)]
    pub enum Components: "components" {
        /// `|Â|` alone.
        #[default]
        Amplitude = "amplitude",
        /// `|Â|`, and its real and imaginary parts as `re` and `im`.
        Complex = "complex",
    }
}

choice! {
    /// Whether a file is made smaller, always without loss.
    #[derive(Default)]
    pub enum Compression: "compression" {
        /// Deflate: EXR's ZIP in blocks of 16 lines, NRRD's gzip.
        #[default]
        Zip = "zip",
        /// Not at all, which is faster to write and to read.
        None = "none",
    }
}

/// How an EXR file keeps its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Encoding {
    /// Whether amplitudes (`R`, `G`, `B`, `Y`) take 16 bits instead of 32; see `fits_float16`.
    pub float16: bool,
    /// Of the pixels.
    pub compression: Compression,
}

/// Whether half floats hold amplitudes up to `peak` well: at their full eleven bits down to 40 dB below it, and
/// nothing beyond the greatest of them.
pub(crate) fn fits_float16(peak: f32) -> bool {
    peak == 0.0 || (0.01..=6e4).contains(&peak)
}

/// The attribute of this name, if there is one.
pub(crate) fn find_attribute<'a>(attributes: &'a [(String, Attribute)], name: &str) -> Option<&'a Attribute> {
    attributes.iter().find(|(other, _)| other == name).map(|(_, value)| value)
}

/// The attributes as one JSON object.
pub(crate) fn attributes_as_json(attributes: &[(String, Attribute)]) -> serde_json::Value {
    attributes
        .iter()
        .map(|(name, value)| {
            let value: serde_json::Value = match value {
                Attribute::Text(text) => text.as_str().into(),
                // JSON has no infinity, which "no return" may be.
                Attribute::Number(number) if !number.is_finite() => number.to_string().into(),
                Attribute::Number(number) => (*number).into(),
                Attribute::Integer(integer) => (*integer).into(),
                Attribute::Vector(vector) => vector.to_vec().into(),
            };
            (name.clone(), value)
        })
        .collect()
}
