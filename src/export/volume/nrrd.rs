//! Volumes as NRRD, which 3D Slicer, ITK and ParaView open with the correct size and position.
//!
//! A text header, an empty line, and the amplitudes as little-endian floats, gzipped or raw. The only crate found for
//! this format, `bioformats` 0.1, is under the GPL.

use super::{VolumeFile, VolumeStream, write_floats};
use crate::error::{Error, Result};
use crate::export::amplitude::{Amplitude, declared_grid, read_floats};
use crate::export::{Attribute, Compression};
use crate::files::open_input;
use crate::grid::{Grid, Volume};
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use num_complex::Complex32;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Write};
use std::path::Path;

/// Maximum length of a header line that is read; a run file is much shorter.
const LONGEST_LINE: u64 = 1 << 20;

/// Writes `|Â|` as float32, x fastest, with origin and directions in m along the program's axes (x right, y down, z
/// forward), for which NRRD has no name. `attributes` become key/value pairs, `sonar:unit` as `sonar.unit`.
///
/// # Errors
/// As `crate::files::write_atomically`.
pub fn write_volume_nrrd(
    path: &Path,
    volume: &Volume,
    attributes: &[(String, Attribute)],
    compression: Compression,
) -> Result<()> {
    stream_volume_nrrd(path, &volume.grid, attributes, compression)?.whole(volume)
}

/// The same depth by depth.
///
/// # Errors
/// As [`write_volume_nrrd`].
pub(crate) fn stream_volume_nrrd(
    path: &Path,
    grid: &Grid,
    attributes: &[(String, Attribute)],
    compression: Compression,
) -> Result<VolumeFile<'static>> {
    VolumeFile::create(path, |mut out| {
        out.write_all(header(grid, attributes, compression).as_bytes())?;
        Ok(match compression {
            Compression::None => NrrdVolume::Raw(out),
            Compression::Zip => {
                NrrdVolume::Zip(Box::new(GzEncoder::new(out, flate2::Compression::default())))
            }
        })
    })
}

/// A volume that is being written.
enum NrrdVolume {
    Raw(BufWriter<File>),
    Zip(Box<GzEncoder<BufWriter<File>>>),
}

impl VolumeStream for NrrdVolume {
    fn planes(&mut self, planes: &[Complex32]) -> io::Result<()> {
        match self {
            Self::Raw(out) => write_floats(out, planes, |sample| sample.norm()),
            Self::Zip(out) => write_floats(out, planes, |sample| sample.norm()),
        }
    }

    fn finish(self: Box<Self>) -> io::Result<()> {
        match *self {
            Self::Raw(mut out) => out.flush(),
            Self::Zip(out) => out.finish()?.flush(),
        }
    }
}

fn header(grid: &Grid, attributes: &[(String, Attribute)], compression: Compression) -> String {
    let axes = [grid.x, grid.y, grid.z];
    let [n_x, n_y, n_z] = axes.map(|axis| axis.count);
    let [p_x, p_y, p_z] = axes.map(|axis| axis.pitch);
    let [x, y, z] = axes.map(|axis| axis.first);
    let encoding = match compression {
        Compression::Zip => "gzip",
        Compression::None => "raw",
    };
    let mut text = format!(
        "NRRD0005\n# Amplitude; x right, y down, z from the array into the scene, in metres.\ntype: float\n\
         dimension: 3\nspace dimension: 3\nsizes: {n_x} {n_y} {n_z}\n\
         space directions: ({p_x},0,0) (0,{p_y},0) (0,0,{p_z})\nkinds: domain domain domain\nendian: little\n\
         encoding: {encoding}\nspace units: \"m\" \"m\" \"m\"\nspace origin: ({x},{y},{z})\ncontent: amplitude\n"
    );
    for (name, value) in attributes {
        let value = value.to_text().replace('\\', "\\\\").replace('\n', "\\n");
        // For some readers a colon ends the key.
        let _ = writeln!(text, "{}:={value}", name.replace(':', "."));
    }
    text + "\n"
}

/// Reads a file that [`write_volume_nrrd`] wrote, or one laid out like it: three axes along x, y and z, floats,
/// little-endian, raw or gzip, in one file.
///
/// # Errors
/// A missing or damaged file, another layout, more voxels than `limit_bytes` hold.
pub fn read_volume_nrrd(path: &Path, limit_bytes: u64) -> Result<Amplitude> {
    let mut file = BufReader::new(open_input(path)?);
    let fault = |problem: &str| {
        Error::input(
            path.display(),
            format!(
                "{problem}; a NRRD of floats with axes along x, y and z was expected, as this program writes it"
            ),
        )
    };
    let mut fields = Vec::new();
    let mut attributes = Vec::new();
    for number in 0.. {
        let mut line = Vec::new();
        let read = (&mut file).take(LONGEST_LINE).read_until(b'\n', &mut line);
        read.map_err(|error| Error::reading(path, error))?;
        let line = String::from_utf8_lossy(&line);
        let Some(line) = line.strip_suffix('\n').map(|line| line.trim_end_matches('\r')) else {
            return Err(fault("ends within its header"));
        };
        if number == 0 {
            if !line.starts_with("NRRD000") {
                return Err(fault("does not begin with NRRD000"));
            }
        } else if line.is_empty() {
            break;
        } else if let Some((name, value)) = line.split_once(":=") {
            attributes.push((name.replacen("sonar.", "sonar:", 1), Attribute::Text(value.to_owned())));
        } else if let Some((name, value)) = line.split_once(": ") {
            fields.push((name.to_owned(), value.trim().to_owned()));
        }
    }
    let field = |name: &str| fields.iter().find(|(n, _)| n == name).map_or("", |(_, value)| value.as_str());
    if (field("type"), field("dimension"), field("endian")) != ("float", "3", "little")
        || fields.iter().any(|(name, _)| name == "data file")
    {
        return Err(fault("has another type, dimension or byte order, or its data are in another file"));
    }
    let (Some(count), Some(first), Some([p_x, a, b, c, p_y, d, e, f, p_z])) =
        (numbers(field("sizes")), numbers(field("space origin")), numbers(field("space directions")))
    else {
        return Err(fault("has no valid sizes, space directions or space origin"));
    };
    if [a, b, c, d, e, f].iter().any(|&off| off != 0.0) {
        return Err(fault("has oblique axes"));
    }
    let count = count.map(|n: f64| n as usize);
    let grid = declared_grid(path, first, [p_x, p_y, p_z], count, 4, limit_bytes)?;
    let values = match field("encoding") {
        "raw" => read_floats(&mut file, &grid)?,
        "gzip" | "gz" => read_floats(&mut GzDecoder::new(file), &grid)?,
        _ => return Err(fault("has an encoding other than raw or gzip")),
    };
    let values = values.ok_or_else(|| fault("has damaged data, or less than its header declares"))?;
    Ok(Amplitude { grid, values, attributes })
}

/// Exactly N numbers, with or without parentheses and commas.
fn numbers<const N: usize>(text: &str) -> Option<[f64; N]> {
    let words = text.split(['(', ')', ',', ' ', '\t']).filter(|word| !word.is_empty());
    words.map(|word| word.parse().ok()).collect::<Option<Vec<f64>>>()?.try_into().ok()
}
