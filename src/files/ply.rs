//! Reads and writes the header of PLY files, which declares the format of the values and their tables.
//!
//! Converts the first bytes of an untrusted file into a [`Header`], or a [`Header`] into the text to be written. Meshes
//! and point clouds differ only in their tables, so both use this one header.
//!
//! `ply-rs-bw` 4.0, the maintained crate for PLY, is not used: it makes as many rows as a header declares, even of
//! elements without properties, so that a file of 72 bytes takes 9 s and any amount of memory, and its allocations abort.

use std::fmt;
use std::path::Path;

use crate::error::{Error, Result};
use crate::text::quoted;

/// How the values after the header are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Format {
    /// Numbers in text, separated by white space.
    Ascii,
    /// Binary, least significant byte first.
    LittleEndian,
    /// Binary, most significant byte first.
    BigEndian,
}

impl Format {
    const ALL: [Self; 3] = [Self::Ascii, Self::LittleEndian, Self::BigEndian];

    fn name(self) -> &'static str {
        match self {
            Self::Ascii => "ascii",
            Self::LittleEndian => "binary_little_endian",
            Self::BigEndian => "binary_big_endian",
        }
    }
}

/// Type of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    /// Each type with its two names; the first one is written.
    const NAMES: [(Self, [&'static str; 2]); 8] = [
        (Self::I8, ["char", "int8"]),
        (Self::U8, ["uchar", "uint8"]),
        (Self::I16, ["short", "int16"]),
        (Self::U16, ["ushort", "uint16"]),
        (Self::I32, ["int", "int32"]),
        (Self::U32, ["uint", "uint32"]),
        (Self::F32, ["float", "float32"]),
        (Self::F64, ["double", "float64"]),
    ];

    fn of(word: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(_, names)| names.contains(&word)).map(|(scalar, _)| *scalar)
    }

    /// Bytes in a binary file.
    pub(crate) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The first number in `bytes` of a binary file, as f64, which represents each of the types exactly; `None` when there
    /// are too few bytes.
    pub(crate) fn number(self, bytes: &[u8], format: Format) -> Option<f64> {
        /// The first bytes, least significant first.
        fn first<const N: usize>(bytes: &[u8], format: Format) -> Option<[u8; N]> {
            let mut first = *bytes.first_chunk()?;
            if format == Format::BigEndian {
                first.reverse();
            }
            Some(first)
        }
        Some(match self {
            Self::I8 => f64::from(i8::from_le_bytes(first(bytes, format)?)),
            Self::U8 => f64::from(u8::from_le_bytes(first(bytes, format)?)),
            Self::I16 => f64::from(i16::from_le_bytes(first(bytes, format)?)),
            Self::U16 => f64::from(u16::from_le_bytes(first(bytes, format)?)),
            Self::I32 => f64::from(i32::from_le_bytes(first(bytes, format)?)),
            Self::U32 => f64::from(u32::from_le_bytes(first(bytes, format)?)),
            Self::F32 => f64::from(f32::from_le_bytes(first(bytes, format)?)),
            Self::F64 => f64::from_le_bytes(first(bytes, format)?),
        })
    }
}

impl fmt::Display for Scalar {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = Self::NAMES.iter().find(|(scalar, _)| scalar == self).map(|(_, names)| names[0]);
        f.write_str(names.unwrap_or_default())
    }
}

/// A value, or a list of values, that every row of an element has.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Property {
    pub(crate) name: String,
    /// Type of the number of values in a list; `None` for a single value.
    pub(crate) count: Option<Scalar>,
    /// Type of the value or values.
    pub(crate) scalar: Scalar,
}

/// A table of the file.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Element {
    pub(crate) name: String,
    /// Number of rows; in a file that is read only declared, so it is not trusted.
    pub(crate) count: u64,
    pub(crate) properties: Vec<Property>,
}

impl Element {
    /// Minimum number of bytes of a row: its lists empty, and in a text a digit and a blank for every number.
    pub(crate) fn least_row(&self, format: Format) -> u64 {
        let size = |property: &Property| match format {
            Format::Ascii => 2,
            _ => property.count.unwrap_or(property.scalar).size() as u64,
        };
        self.properties.iter().map(size).sum()
    }

    /// The list of vertices that makes its rows faces or strips.
    pub(crate) fn corners(&self) -> Option<&Property> {
        let is_wanted = |name: &str| matches!(name, "vertex_indices" | "vertex_index");
        self.properties.iter().find(|p| p.count.is_some() && is_wanted(&p.name))
    }
}

/// The header of a file; its [`Display`](fmt::Display) is the text of the header.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Header {
    pub(crate) format: Format,
    /// Comments, one line each, in order.
    pub(crate) comments: Vec<String>,
    pub(crate) elements: Vec<Element>,
}

/// The length of a header: what precedes the first value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Length {
    pub(crate) bytes: usize,
    pub(crate) lines: usize,
}

impl Header {
    /// Reads the header of a file of which `bytes` are the first, or all; `path` is for messages.
    ///
    /// # Errors
    /// Another kind of file, an invalid line, or no `end_header` in the bytes; the message names the line.
    pub(crate) fn read(bytes: &[u8], path: &Path) -> Result<(Self, Length)> {
        let (mut format, mut comments, mut elements) = (None, Vec::new(), Vec::<Element>::new());
        let mut length = Length { bytes: 0, lines: 0 };
        for line in bytes.split_inclusive(|&byte| byte == b'\n') {
            if !line.ends_with(b"\n") && bytes.starts_with(b"ply") {
                break;
            }
            length = Length { bytes: length.bytes + line.len(), lines: length.lines + 1 };
            let refused =
                |problem: String| Error::input(format!("{}, line {}", path.display(), length.lines), problem);
            let line = String::from_utf8_lossy(line);
            let words: Vec<&str> = line.split_whitespace().collect();
            match (length.lines, words.as_slice()) {
                (1, ["ply"]) | (2.., [] | ["obj_info", ..]) => {}
                (1, _) => {
                    return Err(Error::input(path.display(), "is not a PLY: its first line must be `ply`"));
                }
                (_, ["comment", ..]) => {
                    comments.push(line.trim()["comment".len()..].trim_start().to_owned());
                }
                (_, ["end_header"]) => {
                    let format = format.ok_or_else(|| {
                        refused("the header ends without a line such as `format ascii 1.0`".to_owned())
                    })?;
                    return Ok((Self { format, comments, elements }, length));
                }
                (_, ["format", name, version]) => {
                    let known = Format::ALL.into_iter().find(|f| f.name() == *name && *version == "1.0");
                    format = Some(known.ok_or_else(|| {
                        refused(format!(
                            "has the format `{}`; ascii, binary_little_endian or binary_big_endian 1.0 was expected",
                            quoted(&format!("{name} {version}"))
                        ))
                    })?);
                }
                (_, ["element", name, count]) => {
                    let count = count.parse().map_err(|_| {
                        let (count, name) = (quoted(count), quoted(name));
                        refused(format!("declares `{count}` of `{name}`; a whole number was expected"))
                    })?;
                    elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
                }
                (_, ["property", kind @ .., name]) => {
                    let property = property(kind, name).ok_or_else(|| {
                        refused(format!(
                            "`{}` must have the form `property float x` or `property list uchar int vertex_indices`",
                            quoted(&words.join(" "))
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
                        "`{}` is not valid in the header of a PLY; format, comment, element, property or end_header \
                         was expected",
                        quoted(line.trim())
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
    let (count, scalar) = match kind {
        ["list", count, scalar] => (Some(Scalar::of(count)?), Scalar::of(scalar)?),
        [scalar] => (None, Scalar::of(scalar)?),
        _ => return None,
    };
    Some(Property { name: name.to_owned(), count, scalar })
}

impl fmt::Display for Header {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "ply\nformat {} 1.0", self.format.name())?;
        for comment in &self.comments {
            writeln!(f, "comment {comment}")?;
        }
        for element in &self.elements {
            writeln!(f, "element {} {}", element.name, element.count)?;
            for Property { name, count, scalar } in &element.properties {
                match count {
                    Some(count) => writeln!(f, "property list {count} {scalar} {name}")?,
                    None => writeln!(f, "property {scalar} {name}")?,
                }
            }
        }
        writeln!(f, "end_header")
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_header_survives_writing_and_reading() {
        let property = |(scalar, _): (Scalar, _)| [(None, scalar), (Some(Scalar::U8), scalar)];
        let properties = Scalar::NAMES.into_iter().flat_map(property).enumerate();
        let properties = properties
            .map(|(i, (count, scalar))| Property { name: format!("p{i}"), count, scalar })
            .collect::<Vec<_>>();
        for format in Format::ALL {
            let element = |name: &str, count| {
                let (name, properties) = (name.to_owned(), properties.clone());
                Element { name, count, properties }
            };
            let header = Header {
                format,
                comments: vec!["two  blanks, é".to_owned(), String::new()],
                elements: vec![element("vertex", 3), element("face", u64::MAX)],
            };
            let text = header.to_string();
            let lines = text.lines().count();
            let (read, length) = Header::read((text.clone() + "rest").as_bytes(), Path::new("")).unwrap();
            assert_eq!((read, length), (header, Length { bytes: text.len(), lines }));
            for cut in 0..text.len() {
                assert!(Header::read(&text.as_bytes()[..cut], Path::new("")).is_err(), "cut at {cut}");
            }
        }
    }

    #[test]
    fn numbers_of_either_byte_order_are_decoded() {
        let cases: [(Scalar, &[u8], f64); 8] = [
            (Scalar::I8, &(-2i8).to_be_bytes(), -2.0),
            (Scalar::U8, &[254], 254.0),
            (Scalar::I16, &(-300i16).to_be_bytes(), -300.0),
            (Scalar::U16, &65_000u16.to_be_bytes(), 65_000.0),
            (Scalar::I32, &(-70_000i32).to_be_bytes(), -70_000.0),
            (Scalar::U32, &u32::MAX.to_be_bytes(), f64::from(u32::MAX)),
            (Scalar::F32, &0.1f32.to_be_bytes(), f64::from(0.1f32)),
            (Scalar::F64, &0.1f64.to_be_bytes(), 0.1),
        ];
        for (scalar, bytes, number) in cases {
            assert_eq!(bytes.len(), scalar.size());
            assert_eq!(scalar.number(&[bytes, &[7]].concat(), Format::BigEndian), Some(number));
            let little: Vec<u8> = bytes.iter().rev().copied().collect();
            assert_eq!(scalar.number(&little, Format::LittleEndian), Some(number));
            assert_eq!(scalar.number(&bytes[1..], Format::BigEndian), None);
        }
    }
}
