//! The text that every PLY file begins with: in what form the values are, and which.

use std::path::Path;

use crate::error::{Error, Result};

/// How the values after the header are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    /// Numbers in text, by blanks and lines apart.
    Ascii,
    /// Binary, lowest byte first.
    LittleEndian,
    /// Binary, highest byte first.
    BigEndian,
}

/// Type of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn of(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// Bytes in a binary file.
    pub(super) fn size(self) -> u64 {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// A value, or a list of values, that every row of an element has.
#[derive(Debug, PartialEq)]
pub(super) struct Property {
    pub(super) name: String,
    /// Type of the number of values in a list; `None` for a single value.
    pub(super) count: Option<Kind>,
    pub(super) kind: Kind,
}

/// A table of the file.
#[derive(Debug, PartialEq)]
pub(super) struct Element {
    pub(super) name: String,
    /// As declared: not to be believed.
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// The fewest bytes that a row takes: its lists empty, and of a text a digit and a blank for every number.
    pub(super) fn least_row(&self, format: Format) -> u64 {
        let size = |property: &Property| match format {
            Format::Ascii => 2,
            _ => property.count.unwrap_or(property.kind).size(),
        };
        self.properties.iter().map(size).sum()
    }

    /// The list of vertices that makes its rows faces or strips.
    pub(super) fn corners(&self) -> Option<&Property> {
        let is_wanted = |name: &str| matches!(name, "vertex_indices" | "vertex_index");
        self.properties.iter().find(|p| p.count.is_some() && is_wanted(&p.name))
    }
}

/// What the file says of itself.
#[derive(Debug, PartialEq)]
pub(super) struct Header {
    pub(super) format: Format,
    pub(super) elements: Vec<Element>,
    /// Bytes before the first value.
    pub(super) length: usize,
    /// Lines before the first value.
    pub(super) lines: usize,
}

impl Header {
    pub(super) fn read(bytes: &[u8], path: &Path) -> Result<Self> {
        let (mut format, mut elements) = (None, Vec::new());
        let (mut length, mut lines) = (0, 0);
        for line in bytes.split_inclusive(|&byte| byte == b'\n') {
            if !line.ends_with(b"\n") && bytes.starts_with(b"ply") {
                break;
            }
            (length, lines) = (length + line.len(), lines + 1);
            let refused =
                |problem: String| Error::input(format!("{}, line {lines}", path.display()), problem);
            let line = String::from_utf8_lossy(line);
            let words: Vec<&str> = line.split_whitespace().collect();
            match (lines, words.as_slice()) {
                (1, ["ply"]) | (2.., [] | ["comment" | "obj_info", ..]) => {}
                (1, _) => {
                    return Err(Error::input(path.display(), "is no PLY: its first line should be `ply`"));
                }
                (_, ["end_header"]) => {
                    let format = format.ok_or_else(|| {
                        refused("the header ends without a line such as `format ascii 1.0`".to_owned())
                    })?;
                    return Ok(Self { format, elements, length, lines });
                }
                (_, ["format", kind, version]) => {
                    format = Some(match (*kind, *version) {
                        ("ascii", "1.0") => Format::Ascii,
                        ("binary_little_endian", "1.0") => Format::LittleEndian,
                        ("binary_big_endian", "1.0") => Format::BigEndian,
                        _ => {
                            return Err(refused(format!(
                                "has the format `{kind} {version}`; ascii, binary_little_endian or binary_big_endian \
                                 1.0 was expected"
                            )));
                        }
                    });
                }
                (_, ["element", name, count]) => {
                    let count = count.parse().map_err(|_| {
                        refused(format!("declares `{count}` of `{name}`; a whole number was expected"))
                    })?;
                    elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
                }
                (_, ["property", kind @ .., name]) => {
                    let property = property(kind, name).ok_or_else(|| {
                        refused(format!(
                            "`{}` should read like `property float x` or `property list uchar int vertex_indices`",
                            words.join(" ")
                        ))
                    })?;
                    let element = elements.last_mut();
                    element
                        .ok_or_else(|| refused("has a property before the first `element`".to_owned()))?
                        .properties
                        .push(property);
                }
                _ => {
                    return Err(refused(format!(
                        "`{}` has no meaning in the header of a PLY; format, comment, element, property or end_header \
                         was expected",
                        line.trim().chars().take(80).collect::<String>()
                    )));
                }
            }
        }
        Err(Error::input(
            path.display(),
            if bytes.is_empty() { "is empty" } else { "is cut short: its header has no `end_header`" },
        ))
    }
}

fn property(kind: &[&str], name: &str) -> Option<Property> {
    let (count, kind) = match kind {
        ["list", count, kind] => (Some(Kind::of(count)?), Kind::of(kind)?),
        [kind] => (None, Kind::of(kind)?),
        _ => return None,
    };
    Some(Property { name: name.to_owned(), count, kind })
}
