//! Reading the vertices of a PLY: enough for files of ours and of many others.

use crate::error::{Error, Result};
use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;

/// Longest header that is read.
const LONGEST_HEADER: u64 = 1 << 20;

/// The vertices of a binary little-endian PLY.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Ply {
    /// Number of vertices.
    pub(crate) count: usize,
    /// Comments of the header, in order.
    pub(crate) comments: Vec<String>,
    /// Name, type and place within a vertex of every property.
    properties: Vec<(String, Scalar, usize)>,
    stride: usize,
    data: Vec<u8>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scalar {
    Byte,
    Integer,
    Float,
    Double,
}

impl Scalar {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "uchar" | "uint8" => Self::Byte,
            "int" | "int32" => Self::Integer,
            "float" | "float32" => Self::Float,
            "double" | "float64" => Self::Double,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::Byte => 1,
            Self::Integer | Self::Float => 4,
            Self::Double => 8,
        }
    }
}

impl Ply {
    /// Reads a file whose vertices come first and take no more than `limit_bytes`.
    ///
    /// # Errors
    /// A missing or damaged file, another encoding, properties of other types than uchar, int, float and double.
    pub(crate) fn read(path: &Path, limit_bytes: u64) -> Result<Self> {
        let fault = |problem: &str| {
            Error::input(
                path.display(),
                format!("{problem}; a binary little-endian PLY whose vertices come first was expected"),
            )
        };
        let file = File::open(path).map_err(|error| Error::reading(path, error))?;
        let mut file = BufReader::new(file);
        let mut header = (&mut file).take(LONGEST_HEADER);
        let mut ply =
            Self { count: 0, comments: Vec::new(), properties: Vec::new(), stride: 0, data: Vec::new() };
        let (mut elements, mut begun) = (0, false);
        loop {
            let mut line = Vec::new();
            header.read_until(b'\n', &mut line).map_err(|error| Error::reading(path, error))?;
            let Some(line) = line.strip_suffix(b"\n") else { return Err(fault("ends within its header")) };
            let line = String::from_utf8_lossy(line).trim_end().to_owned();
            let words: Vec<&str> = line.split_whitespace().collect();
            match words[..] {
                ["ply"] if !begun => begun = true,
                _ if !begun => return Err(fault("does not begin as a PLY does")),
                ["format", "binary_little_endian", _] => {}
                ["format", ..] => return Err(fault("has another encoding")),
                ["comment", ..] => ply.comments.push(line["comment".len()..].trim_start().to_owned()),
                ["element", "vertex", count] if elements == 0 => {
                    ply.count = count.parse().map_err(|_| fault("does not say how many vertices it has"))?;
                    elements = 1;
                }
                ["element", ..] if elements == 0 => {
                    return Err(fault("has other elements before its vertices"));
                }
                ["element", ..] => elements += 1,
                ["property", kind, name] if elements == 1 => {
                    let kind = Scalar::named(kind).ok_or_else(|| fault("has properties of another type"))?;
                    ply.properties.push((name.to_owned(), kind, ply.stride));
                    ply.stride += kind.size();
                }
                ["property", ..] if elements == 1 => return Err(fault("has lists among its vertices")),
                ["end_header"] => break,
                _ => {}
            }
        }
        let bytes = (ply.count as u128) * ply.stride as u128;
        if bytes > u128::from(limit_bytes) {
            return Err(fault(&format!("declares {bytes} bytes, more than the limit of {limit_bytes}")));
        }
        file.take(bytes as u64).read_to_end(&mut ply.data).map_err(|error| Error::reading(path, error))?;
        if elements == 0 || ply.data.len() as u128 != bytes {
            return Err(fault("holds fewer vertices than its header says"));
        }
        Ok(ply)
    }

    /// Names of the properties, in order.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.properties.iter().map(|(name, ..)| name.as_str())
    }

    /// One property of every vertex.
    pub(crate) fn column(&self, name: &str) -> Option<Vec<f64>> {
        let (_, kind, at) = self.properties.iter().find(|(other, ..)| other == name)?;
        let number = |vertex: &[u8]| match (kind, &vertex[*at..*at + kind.size()]) {
            (Scalar::Byte, &[a]) => f64::from(a),
            (Scalar::Integer, &[a, b, c, d]) => f64::from(i32::from_le_bytes([a, b, c, d])),
            (Scalar::Float, &[a, b, c, d]) => f64::from(f32::from_le_bytes([a, b, c, d])),
            (Scalar::Double, &[a, b, c, d, e, f, g, h]) => f64::from_le_bytes([a, b, c, d, e, f, g, h]),
            _ => f64::NAN,
        };
        Some(self.data.chunks_exact(self.stride).map(number).collect())
    }
}
