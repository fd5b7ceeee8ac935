//! Reading the vertices of a PLY, of this program and many others.

use crate::error::{Error, Result};
use crate::files::open_input;
use crate::files::ply::{Format, Header, Scalar};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Maximum length of a header, bytes.
const LONGEST_HEADER: u64 = 1 << 20;

/// The vertices of a binary little-endian PLY.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Ply {
    /// Number of vertices.
    pub(crate) count: usize,
    /// Comments of the header, in order.
    pub(crate) comments: Vec<String>,
    /// Name, type and offset within a vertex of every property.
    properties: Vec<(String, Scalar, usize)>,
    stride: usize,
    data: Vec<u8>,
}

impl Ply {
    /// Reads a file whose vertices come first and take at most `limit_bytes`.
    ///
    /// # Errors
    /// A missing or damaged file, another encoding, lists among the vertices, or other elements before them.
    pub(crate) fn read(path: &Path, limit_bytes: u64) -> Result<Self> {
        let fault = |problem: &str| {
            Error::input(
                path.display(),
                format!("{problem}; a binary little-endian PLY whose vertices come first was expected"),
            )
        };
        let failed = |error: io::Error| Error::reading(path, error);
        let mut file = open_input(path)?;
        let mut start = Vec::new();
        (&mut file).take(LONGEST_HEADER).read_to_end(&mut start).map_err(failed)?;
        let (header, length) = Header::read(&start, path)?;
        if header.format != Format::LittleEndian {
            return Err(fault("is in another encoding"));
        }
        let vertices = header.elements.into_iter().next().filter(|element| element.name == "vertex");
        let vertices = vertices.ok_or_else(|| fault("does not begin with its vertices"))?;
        let (mut properties, mut stride) = (Vec::new(), 0);
        for property in vertices.properties {
            if property.count.is_some() {
                return Err(fault("has lists among its vertices"));
            }
            properties.push((property.name, property.scalar, stride));
            stride += property.scalar.size();
        }
        let bytes = u128::from(vertices.count) * stride as u128;
        if bytes > u128::from(limit_bytes) {
            return Err(fault(&format!("declares {bytes} bytes, more than the limit of {limit_bytes}")));
        }
        let mut data = Vec::new();
        file.seek(SeekFrom::Start(length.bytes as u64)).map_err(failed)?;
        file.take(bytes as u64).read_to_end(&mut data).map_err(failed)?;
        if data.len() as u128 != bytes {
            return Err(fault("has fewer vertices than its header declares"));
        }
        Ok(Self { count: vertices.count as usize, comments: header.comments, properties, stride, data })
    }

    /// Names of the properties, in order.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.properties.iter().map(|(name, ..)| name.as_str())
    }

    /// One property of every vertex.
    pub(crate) fn column(&self, name: &str) -> Option<Vec<f64>> {
        let (_, scalar, at) = self.properties.iter().find(|(other, ..)| other == name)?;
        let number = |vertex: &[u8]| scalar.number(&vertex[*at..], Format::LittleEndian).unwrap_or(f64::NAN);
        Some(self.data.chunks_exact(self.stride).map(number).collect())
    }
}
