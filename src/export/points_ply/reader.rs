//! Reading the vertices of a PLY, of this program and many others, and the triangles of one of this program.

use crate::error::{Error, Result};
use crate::files::open_input;
use crate::files::ply::{Element, Format, Header, Scalar};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Maximum length of a header, bytes.
const LONGEST_HEADER: u64 = 1 << 20;

/// The names of the columns of a list of three: its length and its values.
pub(super) const LIST_OF_THREE: [&str; 4] = ["length", "first", "second", "third"];

/// A binary little-endian PLY.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Ply {
    /// Comments of the header, in order.
    pub(crate) comments: Vec<String>,
    /// The vertices.
    pub(crate) vertices: PlyTable,
    /// The triangles, where they were asked for; the columns of their list are those of [`LIST_OF_THREE`].
    pub(super) triangles: Option<PlyTable>,
}

/// A table of rows of equal length.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PlyTable {
    /// Number of rows.
    pub(crate) count: usize,
    properties: Vec<PlyColumn>,
    stride: usize,
    data: Vec<u8>,
}

impl Ply {
    /// Reads a file whose vertices come first and take at most `limit_bytes`.
    ///
    /// # Errors
    /// A missing or damaged file, another encoding, lists among the vertices, or other elements before them.
    pub(crate) fn read(path: &Path, limit_bytes: u64) -> Result<Self> {
        Self::read_tables(path, limit_bytes, false)
    }

    /// Reads a file of vertices and then triangles, which together take at most `limit_bytes`.
    ///
    /// # Errors
    /// As [`Ply::read`]; other elements after the vertices, or other faces than triangles.
    pub(super) fn read_mesh(path: &Path, limit_bytes: u64) -> Result<Self> {
        Self::read_tables(path, limit_bytes, true)
    }

    fn read_tables(path: &Path, limit_bytes: u64, mesh: bool) -> Result<Self> {
        let fault = |problem: &str| {
            let faces = if mesh { ", followed by triangles" } else { "" };
            Error::input(
                path.display(),
                format!(
                    "{problem}; a binary little-endian PLY whose vertices come first{faces} was expected"
                ),
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
        file.seek(SeekFrom::Start(length.bytes as u64)).map_err(failed)?;
        let mut left = limit_bytes;
        let mut elements = header.elements.into_iter();
        let mut table = |name: &str, lists: bool| -> Result<PlyTable> {
            let element = elements.next().filter(|element| element.name == name);
            let element =
                element.ok_or_else(|| fault(&format!("has no element `{name}` where it should be")))?;
            let (properties, stride) = columns(element.clone(), lists)
                .ok_or_else(|| fault(&format!("has lists in its element `{name}`")))?;
            let bytes = u128::from(element.count) * stride as u128;
            if bytes > u128::from(left) {
                return Err(fault(&format!("declares {bytes} bytes, more than the limit of {left}")));
            }
            left -= bytes as u64;
            let mut data = Vec::new();
            (&mut file).take(bytes as u64).read_to_end(&mut data).map_err(failed)?;
            if data.len() as u128 != bytes {
                return Err(fault(&format!("has fewer rows of `{name}` than its header declares")));
            }
            Ok(PlyTable { count: element.count as usize, properties, stride, data })
        };
        let vertices = table("vertex", false)?;
        let triangles = if mesh { Some(table("face", true)?) } else { None };
        Ok(Self { comments: header.comments, vertices, triangles })
    }
}

/// Name, type and offset within a row of a property.
type PlyColumn = (String, Scalar, usize);

/// The columns of an element and the length of its rows; `None` for one with lists, or with others than of three if these
/// are allowed.
fn columns(element: Element, lists: bool) -> Option<(Vec<PlyColumn>, usize)> {
    let (mut columns, mut stride) = (Vec::new(), 0);
    let mut add = |name: &str, scalar: Scalar| {
        columns.push((name.to_owned(), scalar, stride));
        stride += scalar.size();
    };
    for property in element.properties {
        match property.count {
            None => add(&property.name, property.scalar),
            Some(count) if lists => {
                let [length, values @ ..] = LIST_OF_THREE;
                add(length, count);
                for name in values {
                    add(name, property.scalar);
                }
            }
            Some(_) => return None,
        }
    }
    Some((columns, stride))
}

impl PlyTable {
    /// Names of the properties, in order.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.properties.iter().map(|(name, ..)| name.as_str())
    }

    /// One property of every row.
    pub(crate) fn column(&self, name: &str) -> Option<Vec<f64>> {
        let (_, scalar, at) = self.properties.iter().find(|(other, ..)| other == name)?;
        let number = |row: &[u8]| scalar.number(&row[*at..], Format::LittleEndian).unwrap_or(f64::NAN);
        Some(self.data.chunks_exact(self.stride).map(number).collect())
    }

    /// Several properties of every row.
    pub(super) fn columns<const N: usize>(&self, names: [&str; N]) -> Option<Vec<[f64; N]>> {
        let columns: Option<Vec<_>> = names.iter().map(|name| self.column(name)).collect();
        let columns = columns?;
        Some((0..self.count).map(|row| std::array::from_fn(|k| columns[k][row])).collect())
    }
}
