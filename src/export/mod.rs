//! The output formats: `OpenEXR`, VTK image data, NRRD, `OpenVDB`, `NumPy` archives, Zarr stores, PLY points, PNG figures,
//! and an HTML page that shows everything.
//!
//! Takes the types of [`crate::grid`] and named [`Attributes`]; writes files that are complete or do not appear at all.
//! Depth maps, volumes and points can be read, too. No writer smooths anything, and none but that of OpenVDB,
//! whose world has z up, flips an axis: an image's column is x and its row is y.
//!
//! # Example
//! A depth map of two pixels, one of them empty, as an image for Blender and Nuke and as a figure for a paper:
//! ```
//! use holosonar::export::depth_exr::{read_depth_map, write_depth_map};
//! use holosonar::export::figure::{DepthKind, write_depth_figure};
//! use holosonar::export::{Attribute, Encoding, Fill};
//! use holosonar::grid::{Axis, DepthLayer, DepthMap, Raster, View};
//!
//! let folder = std::env::temp_dir().join(format!("holosonar-{}", std::process::id()));
//! let path = folder.join("depth.exr");
//! let row = |count| Axis { first: 0.0, pitch: 0.01, count };
//! let picked = DepthLayer { depth: vec![1.25, f32::NAN], strength: vec![0.5, 0.0], ..DepthLayer::default() };
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
mod volume;

pub use fill::Fill;
pub(crate) use volume::VolumeFile;
pub use volume::reading::read_volume;
pub use volume::{
    exr as volume_exr, npz as volume_npz, nrrd as volume_nrrd, vdb as volume_vdb, vti as volume_vti,
    zarr as volume_zarr,
};

use crate::choice::choice;

/// The value of an attribute that is written with a result.
#[derive(Debug, Clone, PartialEq)]
pub enum Attribute {
    /// Text. EXR stores only ASCII: other characters are escaped as in JSON, such as `\u00e9`.
    Text(String),
    /// A number, in the SI unit of the quantity it is named after.
    Number(f64),
    /// An integer. EXR stores 32 bits: larger ones are written as [`Attribute::Number`].
    Integer(i64),
    /// A position or an extent along x, y, z; m unless its name says otherwise.
    Vector([f64; 3]),
}

/// Named attributes, in the order in which they are written; names start with `sonar:`.
pub type Attributes = Vec<(String, Attribute)>;

impl Attribute {
    /// The value as text; the components of a vector are separated by spaces.
    fn to_text(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Number(number) => number.to_string(),
            Self::Integer(integer) => integer.to_string(),
            Self::Vector(vector) => vector.map(|number| number.to_string()).join(" "),
        }
    }
}

choice! {
    /// Which components of a complex volume a file contains.
    #[derive(Default)]
    pub enum Components: "components" {
        /// `|Â|` only.
        #[default]
        Amplitude = "amplitude",
        /// `|Â|`, and its real and imaginary parts as `re` and `im`.
        Complex = "complex",
    }
}

choice! {
    /// The lossless compression of a file.
    #[derive(Default)]
    pub enum Compression: "compression" {
        /// Deflate: EXR's ZIP in blocks of 16 lines, NRRD's gzip, VDB's zip of each leaf, gzip of each chunk of a Zarr store.
        #[default]
        Zip = "zip",
        /// None, which is faster to write and to read.
        None = "none",
    }
}

/// How an EXR file stores its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Encoding {
    /// Whether amplitudes (`R`, `G`, `B`, `Y`) take 16 bits instead of 32.
    pub float16: bool,
    /// The compression of the pixels.
    pub compression: Compression,
}

/// Whether half floats are suitable for amplitudes up to `peak`: without overflow, and with their full precision of
/// eleven bits down to 40 dB below it.
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
