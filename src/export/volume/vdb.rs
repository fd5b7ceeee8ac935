//! Volumes as OpenVDB, which Blender and Houdini open as a fog volume of the correct size and position.
//!
//! A header, then one grid: its metadata, its transform, the topology of its tree, and the values of the leaves. The format
//! has no specification; this is version 224 as OpenVDB's own sources write it (`io::Archive`, `io::writeCompressedValues`,
//! `tree::RootNode`, `InternalNode` and `LeafNode`). The only crate found for it, `vdb-rs` 0.6, reads but does not write.

mod tree;

use super::exr::grid_attributes;
use crate::error::{Error, Result};
use crate::export::{Attribute, Compression};
use crate::files::write_atomically;
use crate::grid::{Grid, VolumeView, no_room_for};
use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;
use tree::{Leaf, Values};

/// The usual threshold of the program's files, dB relative to the peak: what the page and the figures show.
pub const THRESHOLD_DB: f64 = -40.0;

/// Offset of the file's UUID, 36 characters.
const UUID: u64 = 21;

/// Bit of the grid's compression that says that the values are deflated.
const ZIP: u32 = 1;

/// Bit that says that values of active voxels alone are stored.
const ACTIVE_MASK: u32 = 2;

/// Writes one grid of floats, `density`: `|Â|` over the volume's peak, so from 0 to 1.
///
/// Voxels below `threshold_db`, relative to the peak, are inactive and 0, as are those that are not finite: they take no
/// space. The peak is the metadata `sonar:amplitudeScale`, the threshold `sonar:thresholdDb`, and the grid is
/// described as in an EXR file; `attributes` become metadata of the same names.
///
/// The world is that of Blender, in m: x is right, y away from the array (our z), z up (our −y). The voxel
/// `[i_x, i_y, i_z]` has the index `(i_x, i_z, n_y − 1 − i_y)`, which the grid's transform scales and moves.
///
/// # Errors
/// As `crate::files::write_atomically`; more than 2³¹ − 1 voxels along an axis; no memory for the list of leaves, 0.16 bytes
/// per voxel.
pub fn write_volume_vdb<'v>(
    path: &Path,
    volume: impl Into<VolumeView<'v>>,
    threshold_db: f64,
    attributes: &[(String, Attribute)],
    compression: Compression,
) -> Result<()> {
    let volume = volume.into();
    let count = index_count(&volume.grid).ok_or_else(|| {
        Error::input(path.display(), "has an axis of more than 2147483647 voxels, the most in OpenVDB")
    })?;
    let density = FogDensity::new(volume, count, threshold_db);
    let leaves =
        tree::leaves(count, |index| density.is_active(index)).ok_or_else(|| no_room_for(&volume.grid))?;
    let mut attributes = attributes.to_vec();
    attributes.extend(grid_attributes(&volume.grid));
    attributes.push(("sonar:amplitudeScale".into(), Attribute::Number(f64::from(density.peak))));
    attributes.push(("sonar:thresholdDb".into(), Attribute::Number(threshold_db)));
    let description = description(&volume.grid, &attributes, compression);
    write_atomically(path, |file| write(file, &description, &leaves, &density, compression))
}

/// Bytes that [`write_volume_vdb`] takes in addition to the volume: those of the list of leaves.
pub(crate) fn writing_bytes(grid: &Grid) -> u64 {
    index_count(grid).map_or(0, tree::bytes)
}

/// Voxels along the axes of the index space: x, z, y.
fn index_count(grid: &Grid) -> Option<[i32; 3]> {
    let [x, y, z] = [grid.x, grid.y, grid.z].map(|axis| i32::try_from(axis.count).ok());
    Some([x?, z?, y?])
}

/// The values of the grid.
struct FogDensity<'a> {
    volume: VolumeView<'a>,
    count: [i32; 3],
    peak: f32,
    threshold: f32,
}

impl<'a> FogDensity<'a> {
    fn new(volume: VolumeView<'a>, count: [i32; 3], threshold_db: f64) -> Self {
        let norms = volume.samples.iter().map(|sample| sample.norm());
        let peak = norms.filter(|norm| norm.is_finite()).fold(0.0, f32::max);
        Self { volume, count, peak, threshold: 10_f64.powf(threshold_db / 20.0) as f32 }
    }

    /// The density at an index; NaN in a volume of zeros.
    fn at(&self, index: [i32; 3]) -> f32 {
        let [x, z, up] = index.map(|i| i as usize);
        let grid = &self.volume.grid;
        let row = z * grid.y.count + grid.y.count - 1 - up;
        self.volume.samples[row * grid.x.count + x].norm() / self.peak
    }

    fn is_active(&self, index: [i32; 3]) -> bool {
        let within = index.iter().zip(self.count).all(|(i, n)| *i < n);
        within && (self.threshold..f32::INFINITY).contains(&self.at(index))
    }
}

/// Writes everything.
fn write(
    file: &mut BufWriter<&File>,
    description: &[u8],
    leaves: &[Leaf],
    density: &FogDensity,
    compression: Compression,
) -> io::Result<()> {
    let mut values = Values::new(compression);
    let mut hasher = blake3::Hasher::new();
    let header = header();
    file.write_all(&header)?;
    file.write_all(description)?;
    hasher.update(description);
    tree::write_topology(file, leaves, &mut values)?;
    let blocks = file.stream_position()?;
    for leaf in leaves {
        let mask = leaf.mask();
        file.write_all(&mask)?;
        let bytes = values.write(file, leaf.indices().map(|index| density.at(index)))?;
        hasher.update(&mask).update(bytes);
    }
    let end = file.stream_position()?;
    let grid = header.len() as u64;
    file.seek(SeekFrom::Start(grid - 24))?;
    for place in [grid, blocks, end] {
        file.write_all(&place.to_le_bytes())?;
    }
    // Readers tell files apart by it. Made from the contents, it is the same for the same contents.
    file.seek(SeekFrom::Start(UUID))?;
    file.write_all(uuid(&hasher.finalize()).as_bytes())
}

/// The file's header and the grid's descriptor, whose last 24 bytes are the places of the grid, of its values and of its end.
fn header() -> Vec<u8> {
    let mut out = b" BDV\0\0\0\0".to_vec();
    // The version of the format, and the release of OpenVDB whose files are like this one.
    for number in [224_u32, 10, 0] {
        out.extend(number.to_le_bytes());
    }
    // There are places in descriptors.
    out.push(1);
    out.extend([0; 36]);
    // No metadata of the file; one grid.
    out.extend([0_u32, 1].map(u32::to_le_bytes).concat());
    for text in ["density", "Tree_float_5_4_3", ""] {
        put_text(&mut out, text);
    }
    out.extend([0; 24]);
    out
}

/// The grid's compression, metadata and transform.
fn description(grid: &Grid, attributes: &[(String, Attribute)], compression: Compression) -> Vec<u8> {
    let flags = match compression {
        Compression::Zip => ZIP | ACTIVE_MASK,
        Compression::None => ACTIVE_MASK,
    };
    let mut out = flags.to_le_bytes().to_vec();
    out.extend((attributes.len() as u32 + 2).to_le_bytes());
    put_metadata(&mut out, "class", "string", b"fog volume");
    put_metadata(&mut out, "name", "string", b"density");
    for (name, value) in attributes {
        match value {
            Attribute::Text(text) => put_metadata(&mut out, name, "string", text.as_bytes()),
            Attribute::Number(number) => put_metadata(&mut out, name, "double", &number.to_le_bytes()),
            Attribute::Integer(integer) => put_metadata(&mut out, name, "int64", &integer.to_le_bytes()),
            Attribute::Vector(vector) => {
                put_metadata(&mut out, name, "vec3d", &vector.map(f64::to_le_bytes).concat());
            }
        }
    }
    put_text(&mut out, "ScaleTranslateMap");
    let scale = [grid.x.pitch, grid.z.pitch, grid.y.pitch];
    let inverse = scale.map(f64::recip);
    // Translation, scale, size of a voxel, and what OpenVDB derives from the scale.
    for vector in [
        [grid.x.first, grid.z.first, -grid.y.last()],
        scale,
        scale,
        inverse,
        inverse.map(|s| s * s),
        inverse.map(|s| s / 2.0),
    ] {
        out.extend(vector.map(f64::to_le_bytes).concat());
    }
    out
}

/// Appends a text after its length.
fn put_text(out: &mut Vec<u8>, text: &str) {
    put_bytes(out, text.as_bytes());
}

fn put_bytes(out: &mut Vec<u8>, bytes: &[u8]) {
    out.extend((bytes.len() as u32).to_le_bytes());
    out.extend(bytes);
}

fn put_metadata(out: &mut Vec<u8>, name: &str, kind: &str, value: &[u8]) {
    put_text(out, name);
    put_text(out, kind);
    put_bytes(out, value);
}

/// A UUID of version 8, whose bits are the writer's own, from a hash.
fn uuid(hash: &blake3::Hash) -> String {
    let hex = hash.to_hex();
    let part = |from: usize, to: usize| &hex[from..to];
    format!("{}-{}-8{}-8{}-{}", part(0, 8), part(8, 12), part(13, 16), part(17, 20), part(20, 32))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests;
