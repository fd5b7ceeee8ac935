//! Volumes as VTK image data, `.vti`, which `ParaView` and `PyVista` open with the correct size and position.
//!
//! XML with the numbers appended as raw little-endian bytes, each array after its length as a `UInt64`. The crate `vtkio`
//! 0.7 writes and reads a file as a whole, while these are written depth by depth and may be larger than the memory.

use super::{Component, VolumeFile, VolumeStream, write_floats};
use crate::error::{Error, Result};
use crate::export::amplitude::{Amplitude, declared_grid, read_floats};
use crate::export::{Attribute, Attributes, Components};
use crate::files::open_input;
use crate::grid::{Grid, Volume};
use num_complex::Complex32;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// Writes the point data `amplitude`, on request `re` and `im`, all float32; origin and spacing in m.
///
/// The order of the voxels is `[z, y, x]`, x fastest. `attributes` become field data of the same names.
///
/// # Errors
/// As `crate::files::write_atomically`.
pub fn write_volume_vti(
    path: &Path,
    volume: &Volume,
    components: Components,
    attributes: &[(String, Attribute)],
) -> Result<()> {
    stream_volume_vti(path, &volume.grid, components, attributes)?.whole(volume)
}

/// The same depth by depth.
///
/// # Errors
/// As [`write_volume_vti`].
pub(crate) fn stream_volume_vti(
    path: &Path,
    grid: &Grid,
    components: Components,
    attributes: &[(String, Attribute)],
) -> Result<VolumeFile<'static>> {
    VolumeFile::create(path, |mut out| {
        let (arrays, bytes) = (components.list(), grid.voxel_count().saturating_mul(4));
        let header = header(grid, arrays, bytes, attributes);
        out.write_all(header.as_bytes())?;
        Ok(VtiVolume { out, arrays, first: header.len() as u64, bytes, done: 0 })
    })
}

/// A volume that is being written: every array grows at its own position.
struct VtiVolume {
    out: BufWriter<File>,
    arrays: &'static [(&'static str, Component)],
    /// Offset of the first array's length.
    first: u64,
    /// Bytes of an array, and how many of them have been written.
    bytes: u64,
    done: u64,
}

impl VtiVolume {
    /// Seeks to an offset within an array, including its length.
    fn seek(&mut self, array: usize, offset: u64) -> io::Result<()> {
        let place = self.first + array as u64 * (8 + self.bytes) + offset;
        self.out.seek(SeekFrom::Start(place)).map(|_| ())
    }
}

impl VolumeStream for VtiVolume {
    fn planes(&mut self, planes: &[Complex32]) -> io::Result<()> {
        for (array, (_, component)) in self.arrays.iter().enumerate() {
            if self.done == 0 {
                self.seek(array, 0)?;
                self.out.write_all(&self.bytes.to_le_bytes())?;
            } else {
                self.seek(array, 8 + self.done)?;
            }
            write_floats(&mut self.out, planes, *component)?;
        }
        self.done += 4 * planes.len() as u64;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> io::Result<()> {
        self.seek(self.arrays.len(), 0)?;
        self.out.write_all(b"\n  </AppendedData>\n</VTKFile>\n")?;
        self.out.flush()
    }
}

/// Everything up to the first appended byte.
fn header(grid: &Grid, list: &[(&str, Component)], bytes: u64, attributes: &[(String, Attribute)]) -> String {
    let axes = [grid.x, grid.y, grid.z];
    let extent = axes.map(|axis| format!("0 {}", axis.count - 1)).join(" ");
    let origin = axes.map(|axis| axis.first.to_string()).join(" ");
    let spacing = axes.map(|axis| axis.pitch.to_string()).join(" ");
    let mut arrays = String::new();
    for ((name, _), at) in list.iter().zip(0_u64..) {
        let offset = at * (8 + bytes);
        let _ = writeln!(
            arrays,
            r#"        <DataArray type="Float32" Name="{name}" format="appended" offset="{offset}"/>"#
        );
    }
    let fields = field_data(attributes);
    format!(
        r#"<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
  <ImageData WholeExtent="{extent}" Origin="{origin}" Spacing="{spacing}">
{fields}    <Piece Extent="{extent}">
      <PointData Scalars="amplitude">
{arrays}      </PointData>
    </Piece>
  </ImageData>
  <AppendedData encoding="raw">
   _"#
    )
}

fn field_data(attributes: &[(String, Attribute)]) -> String {
    if attributes.is_empty() {
        return String::new();
    }
    let mut text = "    <FieldData>\n".to_owned();
    for (name, value) in attributes {
        let name = escaped(name);
        let (element, kind, components) = match value {
            Attribute::Text(_) => ("Array", "String", ""),
            Attribute::Number(_) => ("DataArray", "Float64", ""),
            Attribute::Integer(_) => ("DataArray", "Int64", ""),
            Attribute::Vector(_) => ("DataArray", "Float64", r#"NumberOfComponents="3" "#),
        };
        let mut numbers = value.to_text();
        if kind == "String" {
            // In VTK, a text is the numbers of its bytes and a final 0.
            numbers = numbers.bytes().chain([0]).map(|byte| byte.to_string()).collect::<Vec<_>>().join(" ");
        }
        let _ = writeln!(
            text,
            r#"      <{element} type="{kind}" Name="{name}" {components}NumberOfTuples="1" format="ascii">{numbers}</{element}>"#,
        );
    }
    text + "    </FieldData>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The end of the text in a file of this program, before the first appended byte.
const APPENDED: &str = "<AppendedData encoding=\"raw\">\n   _";

/// Maximum length of the text, bytes.
const LONGEST_TEXT: u64 = 1 << 24;

/// Reads `amplitude` of a file written by [`write_volume_vti`]. Field data are ignored.
///
/// # Errors
/// A missing or damaged file, or one from another program; more voxels than `limit_bytes` allow.
pub fn read_volume_vti(path: &Path, limit_bytes: u64) -> Result<Amplitude> {
    let fault = || {
        Error::input(
            path.display(),
            "is damaged, or is not a VTI with a raw appended array `amplitude` as this program writes it",
        )
    };
    let failed = |error: io::Error| Error::reading(path, error);
    let mut file = open_input(path)?;
    let mut start = Vec::new();
    (&mut file).take(LONGEST_TEXT.min(limit_bytes)).read_to_end(&mut start).map_err(failed)?;
    let end = start.windows(APPENDED.len()).position(|w| w == APPENDED.as_bytes()).ok_or_else(fault)?;
    let text = std::str::from_utf8(&start[..end]).map_err(|_| fault())?;
    let value = |after: &str, key: &str| {
        let rest = &text[text.find(after)? + after.len()..];
        let rest = &rest[rest.find(key)? + key.len()..];
        rest.split_once('"').map(|(value, _)| value)
    };
    let numbers = |key: &str| -> Option<Vec<f64>> {
        value("<ImageData", key)?.split(' ').map(|word| word.parse().ok()).collect()
    };
    let (Some(&[x0, x1, y0, y1, z0, z1]), Some(&[x, y, z]), Some(&[p_x, p_y, p_z])) = (
        numbers(" WholeExtent=\"").as_deref(),
        numbers(" Origin=\"").as_deref(),
        numbers(" Spacing=\"").as_deref(),
    ) else {
        return Err(fault());
    };
    if [x0, y0, z0] != [0.0; 3] || !text.contains("header_type=\"UInt64\"") {
        return Err(fault());
    }
    let count = [x1, y1, z1].map(|last| (last as usize).saturating_add(1));
    let grid = declared_grid(path, [x, y, z], [p_x, p_y, p_z], count, 4, limit_bytes)?;
    let array = "<DataArray type=\"Float32\" Name=\"amplitude\" format=\"appended\"";
    let offset: u64 = value(array, " offset=\"").and_then(|n| n.parse().ok()).ok_or_else(fault)?;
    let at = ((end + APPENDED.len()) as u64).checked_add(offset).ok_or_else(fault)?;
    file.seek(SeekFrom::Start(at)).map_err(|_| fault())?;
    let mut length = [0; 8];
    file.read_exact(&mut length).map_err(|_| fault())?;
    if u64::from_le_bytes(length) != 4 * grid.voxel_count() {
        return Err(fault());
    }
    let values = read_floats(&mut io::BufReader::new(file), &grid)?.ok_or_else(fault)?;
    Ok(Amplitude { grid, values, attributes: Attributes::new() })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::grid::{Axis, Grid};

    #[test]
    fn the_numbers_are_where_the_header_says() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("volume.vti");
        let grid = Grid {
            x: Axis { first: -0.5, pitch: 0.25, count: 5 },
            y: Axis { first: 0.0, pitch: 0.1, count: 2 },
            z: Axis { first: 1.5, pitch: 0.005, count: 3 },
        };
        let samples: Vec<_> = (0..30).map(|i| Complex32::new(i as f32, 1.0)).collect();
        let volume = Volume::new(grid, samples);
        let attributes = [
            ("sonar:soundSpeed".to_owned(), Attribute::Number(343.0)),
            ("sonar:note".to_owned(), Attribute::Text("a<b".into())),
        ];
        write_volume_vti(&path, &volume, Components::Complex, &attributes).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let start = bytes.windows(5).position(|five| five == b"\n   _").unwrap() + 5;
        let text = String::from_utf8_lossy(&bytes[..start]);
        assert!(text.contains(r#"WholeExtent="0 4 0 1 0 2" Origin="-0.5 0 1.5" Spacing="0.25 0.1 0.005""#));
        assert!(text.contains(r#"Name="re" format="appended" offset="128""#));
        assert!(text.contains(">97 60 98 0<"), "{text}");
        let at = start + 128;
        assert_eq!(bytes[at..at + 8], 120_u64.to_le_bytes());
        assert_eq!(bytes[at + 8 + 4 * 7..][..4], 7_f32.to_le_bytes());
    }
}
