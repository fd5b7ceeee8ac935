//! Volumes as VTK image data, `.vti`: what `ParaView` and `PyVista` open with the right size and place.
//!
//! XML with the numbers appended as raw little-endian bytes, each array behind its length as a `UInt64`.
//! `vtkio` 0.7 was looked at: it writes and reads a file as a whole, while these are written depth by depth and may be larger than
//! the memory.

use super::amplitude::{Amplitude, declared_grid, read_floats};
use super::volume_file::{VolumeFile, VolumeStream};
use super::{Attribute, Attributes, Components};
use crate::error::{Error, Result};
use crate::grid::{Grid, Volume};
use num_complex::Complex32;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// What a float of the file is made of.
type Part = fn(&Complex32) -> f32;

/// Writes the point data `amplitude`, on request `re` and `im`, all float32; origin and spacing in m.
///
/// VTK's order is ours, x fastest. `attributes` become field data of the same names.
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
) -> Result<VolumeFile> {
    VolumeFile::create(path, |out| VtiVolume::begin(out, grid, components, attributes))
}

/// A volume on its way into a file: every array grows at its own place.
struct VtiVolume {
    out: BufWriter<File>,
    arrays: &'static [(&'static str, Part)],
    /// Where the first array's length stands.
    first: u64,
    /// Bytes of an array, and of what is there of each.
    bytes: u64,
    done: u64,
}

impl VtiVolume {
    fn begin(
        mut out: BufWriter<File>,
        grid: &Grid,
        components: Components,
        attributes: &[(String, Attribute)],
    ) -> io::Result<Self> {
        let arrays: &[(&str, Part)] = match components {
            Components::Amplitude => &[("amplitude", |sample| sample.norm())],
            Components::Complex => &[
                ("amplitude", |sample| sample.norm()),
                ("re", |sample| sample.re),
                ("im", |sample| sample.im),
            ],
        };
        let bytes = grid.voxel_count().saturating_mul(4);
        let names: Vec<&str> = arrays.iter().map(|(name, _)| *name).collect();
        let header = header(grid, &names, bytes, attributes);
        out.write_all(header.as_bytes())?;
        Ok(Self { out, arrays, first: header.len() as u64, bytes, done: 0 })
    }

    /// Goes to `offset` within an array, its length counted.
    fn seek(&mut self, array: usize, offset: u64) -> io::Result<()> {
        let place = self.first + array as u64 * (8 + self.bytes) + offset;
        self.out.seek(SeekFrom::Start(place)).map(|_| ())
    }
}

impl VolumeStream for VtiVolume {
    fn planes(&mut self, planes: &[Complex32]) -> io::Result<()> {
        for (array, (_, part)) in self.arrays.iter().enumerate() {
            if self.done == 0 {
                self.seek(array, 0)?;
                self.out.write_all(&self.bytes.to_le_bytes())?;
            } else {
                self.seek(array, 8 + self.done)?;
            }
            write_floats(&mut self.out, planes, *part)?;
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

fn write_floats(out: &mut impl Write, samples: &[Complex32], part: Part) -> io::Result<()> {
    for sample in samples {
        out.write_all(&part(sample).to_le_bytes())?;
    }
    Ok(())
}

/// Everything up to the first appended byte.
fn header(grid: &Grid, names: &[&str], bytes: u64, attributes: &[(String, Attribute)]) -> String {
    let axes = [grid.x, grid.y, grid.z];
    let extent = axes.map(|axis| format!("0 {}", axis.count - 1)).join(" ");
    let origin = axes.map(|axis| axis.first.to_string()).join(" ");
    let spacing = axes.map(|axis| axis.pitch.to_string()).join(" ");
    let mut arrays = String::new();
    for (name, at) in names.iter().zip(0_u64..) {
        let offset = at * (8 + bytes);
        let _ = writeln!(
            arrays,
            r#"        <DataArray type="Float32" Name="{name}" format="appended" offset="{offset}"/>"#
        );
    }
    let facts = field_data(attributes);
    format!(
        r#"<?xml version="1.0"?>
<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">
  <ImageData WholeExtent="{extent}" Origin="{origin}" Spacing="{spacing}">
{facts}    <Piece Extent="{extent}">
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
        let mut array = |kind: &str, size: &str, numbers: String| {
            let _ = writeln!(
                text,
                r#"      <{} type="{kind}" Name="{name}" {size} format="ascii">{numbers}</{}>"#,
                if kind == "String" { "Array" } else { "DataArray" },
                if kind == "String" { "Array" } else { "DataArray" },
            );
        };
        match value {
            // VTK spells a text as the numbers of its bytes, ended by 0.
            Attribute::Text(words) => {
                let bytes: Vec<_> = words.bytes().chain([0]).map(|byte| byte.to_string()).collect();
                array("String", r#"NumberOfTuples="1""#, bytes.join(" "));
            }
            Attribute::Number(number) => array("Float64", r#"NumberOfTuples="1""#, number.to_string()),
            Attribute::Integer(integer) => array("Int64", r#"NumberOfTuples="1""#, integer.to_string()),
            Attribute::Vector(vector) => array(
                "Float64",
                r#"NumberOfComponents="3" NumberOfTuples="1""#,
                vector.map(|number| number.to_string()).join(" "),
            ),
        }
    }
    text + "    </FieldData>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// What ends the text of a file of ours, before the first appended byte.
const APPENDED: &str = "<AppendedData encoding=\"raw\">\n   _";

/// Longest text that is looked for.
const LONGEST_TEXT: u64 = 1 << 24;

/// Reads `amplitude` of a file that [`write_volume_vti`] wrote. Field data are left out.
///
/// # Errors
/// A missing or damaged file, or one by another program; more voxels than `limit_bytes` hold.
pub fn read_volume_vti(path: &Path, limit_bytes: u64) -> Result<Amplitude> {
    let fault = || {
        Error::input(
            path.display(),
            "is no VTI with a raw appended array `amplitude` as this program writes it, or is damaged",
        )
    };
    let failed = |error: io::Error| Error::reading(path, error);
    let mut file = File::open(path).map_err(failed)?;
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
    let count = [x1, y1, z1].map(|last| last as usize + 1);
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
    fn the_numbers_stand_where_the_header_says() {
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
