//! The header of an NPY array: element type, order and shape.
//!
//! A strict parser of the one Python literal that `NumPy` writes there, for format versions 1 to 3.

use crate::text::quoted;
use std::io::{self, Read};

/// Longest header accepted, bytes. `NumPy`'s own limit is 10 000.
const LONGEST: usize = 1 << 16;

/// What kind of number or text an element is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::files) enum DtypeKind {
    Float,
    Complex,
    Signed,
    Unsigned,
    /// `S`: bytes.
    Bytes,
    /// `U`: four bytes a character.
    Characters,
}

/// The type of one element.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::files) struct Dtype {
    pub(in crate::files) kind: DtypeKind,
    /// Bytes of one element.
    pub(in crate::files) size: u64,
    pub(in crate::files) big_endian: bool,
}

/// An NPY header.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct NpyHeader {
    pub(super) dtype: Dtype,
    pub(super) fortran: bool,
    pub(super) shape: Vec<usize>,
    /// Bytes before the first element.
    pub(super) length: u64,
}

impl NpyHeader {
    /// Number of elements; `None` if it overflows.
    pub(super) fn elements(&self) -> Option<u64> {
        self.shape.iter().try_fold(1_u64, |product, &n| product.checked_mul(n as u64))
    }

    /// Reads a header and leaves `input` at the first element. The error says what is wrong, without the place.
    pub(super) fn read(input: &mut impl Read) -> Result<Self, String> {
        let mut start = [0; 8];
        fill(input, &mut start)?;
        if start[..6] != *b"\x93NUMPY" {
            return Err("does not start with the signature of an NPY array".into());
        }
        let bytes_of_length = match start[6] {
            1 => 2,
            2 | 3 => 4,
            version => return Err(format!("has NPY version {version}; versions 1 to 3 are supported")),
        };
        let mut length = [0; 4];
        fill(input, &mut length[..bytes_of_length])?;
        let length = u32::from_le_bytes(length) as usize;
        if length > LONGEST {
            return Err(format!("has a header of {length} bytes; at most {LONGEST} are supported"));
        }
        let mut text = vec![0; length];
        fill(input, &mut text)?;
        let text = String::from_utf8(text).map_err(|_| "has a header that is not text".to_owned())?;
        let mut header = Parser { rest: &text }.header()?;
        header.length = (start.len() + bytes_of_length + length) as u64;
        Ok(header)
    }
}

/// Reads exactly as many bytes as `buffer` holds.
fn fill(input: &mut impl Read, buffer: &mut [u8]) -> Result<(), String> {
    input.read_exact(buffer).map_err(|error| match error.kind() {
        io::ErrorKind::UnexpectedEof => "ends within its header; the file is truncated".to_owned(),
        _ => format!("cannot be read: {error}"),
    })
}

/// Reads `{'descr': '<c8', 'fortran_order': False, 'shape': (3, 4), }` from the front of `rest`.
struct Parser<'a> {
    rest: &'a str,
}

impl<'a> Parser<'a> {
    fn header(&mut self) -> Result<NpyHeader, String> {
        let (mut dtype, mut fortran, mut shape) = (None, None, None);
        self.expect("{")?;
        while !self.take("}") {
            let key = self.quoted()?;
            self.expect(":")?;
            match key {
                "descr" => dtype = Some(self.dtype()?),
                "fortran_order" => fortran = Some(self.truth()?),
                "shape" => shape = Some(self.shape()?),
                _ => return Err(format!("has the unknown header key `{}`", quoted(key))),
            }
            if !self.take(",") {
                self.expect("}")?;
                break;
            }
        }
        if !self.rest.trim().is_empty() {
            return Err("has text after its header".into());
        }
        match (dtype, fortran, shape) {
            (Some(dtype), Some(fortran), Some(shape)) => Ok(NpyHeader { dtype, fortran, shape, length: 0 }),
            _ => Err("has a header without `descr`, `fortran_order` or `shape`".into()),
        }
    }

    fn take(&mut self, mark: &str) -> bool {
        self.rest = self.rest.trim_start();
        let after = self.rest.strip_prefix(mark);
        self.rest = after.unwrap_or(self.rest);
        after.is_some()
    }

    fn expect(&mut self, mark: &str) -> Result<(), String> {
        if self.take(mark) { Ok(()) } else { Err(format!("has a header in which `{mark}` is missing")) }
    }

    fn quoted(&mut self) -> Result<&'a str, String> {
        let quote = if self.take("'") { "'" } else { "\"" };
        if quote == "\"" {
            self.expect(quote)?;
        }
        let end = self.rest.find(quote).ok_or("has an unterminated string in its header")?;
        let text = &self.rest[..end];
        self.rest = &self.rest[end + 1..];
        Ok(text)
    }

    fn truth(&mut self) -> Result<bool, String> {
        let found = [("True", true), ("False", false)].into_iter().find(|(word, _)| self.take(word));
        let found = found.ok_or("has a header whose `fortran_order` is neither True nor False")?;
        Ok(found.1)
    }

    fn shape(&mut self) -> Result<Vec<usize>, String> {
        let mut shape = Vec::new();
        self.expect("(")?;
        while !self.take(")") {
            self.rest = self.rest.trim_start();
            let end = self.rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(self.rest.len());
            let size = self.rest[..end].parse().map_err(|_| "has a shape that is not a tuple of sizes")?;
            shape.push(size);
            self.rest = &self.rest[end..];
            if !self.take(",") {
                self.expect(")")?;
                break;
            }
        }
        // NumPy itself supports no more than 64 axes.
        if shape.len() > 64 { Err("has more than 64 axes".into()) } else { Ok(shape) }
    }

    fn dtype(&mut self) -> Result<Dtype, String> {
        self.rest = self.rest.trim_start();
        if self.rest.starts_with('[') {
            return Err("is a structured array; plain numbers were expected".into());
        }
        let name = self.quoted()?;
        let supported = "complex64, complex128, float32, float64 and integers are supported";
        let refused = || format!("has the type `{}`; {supported}", quoted(name));
        let (big_endian, rest) = match name.as_bytes() {
            [b'<' | b'|', rest @ ..] => (false, rest),
            [b'=', rest @ ..] => (cfg!(target_endian = "big"), rest),
            [b'>', rest @ ..] => (true, rest),
            _ => return Err(refused()),
        };
        let [kind, digits @ ..] = rest else { return Err(refused()) };
        if *kind == b'O' {
            return Err("contains Python objects, which are never read; save plain numbers".into());
        }
        let size: u64 =
            std::str::from_utf8(digits).ok().and_then(|digits| digits.parse().ok()).ok_or_else(refused)?;
        let (kind, size) = match (kind, size) {
            (b'f', 4 | 8) => (DtypeKind::Float, size),
            (b'c', 8 | 16) => (DtypeKind::Complex, size),
            (b'i', 1 | 2 | 4 | 8) => (DtypeKind::Signed, size),
            (b'u', 1 | 2 | 4 | 8) => (DtypeKind::Unsigned, size),
            (b'S', _) => (DtypeKind::Bytes, size),
            (b'U', _) => (DtypeKind::Characters, size.checked_mul(4).ok_or_else(refused)?),
            _ => return Err(refused()),
        };
        Ok(Dtype { kind, size, big_endian })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::named::assert_names;

    fn parse(text: &str) -> Result<NpyHeader, String> {
        Parser { rest: text }.header()
    }

    #[test]
    fn numpys_own_headers_are_understood() {
        let header = parse("{'descr': '>c16', 'fortran_order': True, 'shape': (3, 4, 5), }   \n").unwrap();
        assert_eq!(header.dtype, Dtype { kind: DtypeKind::Complex, size: 16, big_endian: true });
        assert!(header.fortran);
        assert_eq!(header.shape, [3, 4, 5]);
        assert_eq!(parse("{'descr': '|u1', 'fortran_order': False, 'shape': (7,), }").unwrap().shape, [7]);
        assert!(parse("{'descr': '<U12', 'fortran_order': False, 'shape': (), }").unwrap().shape.is_empty());
    }

    #[test]
    fn anything_else_is_refused_and_what_is_wrong_is_named() {
        for (text, word) in [
            ("{'descr': '|O', 'fortran_order': False, 'shape': ()}", "objects"),
            ("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': ()}", "structured"),
            ("{'descr': '<f2', 'fortran_order': False, 'shape': ()}", "`<f2`"),
            ("{'descr': '<f4', 'fortran_order': 0, 'shape': ()}", "`fortran_order`"),
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (-1,)}", "shape"),
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999999999999999,)}", "shape"),
            ("{'descr': '<f4', 'fortran_order': False}", "`shape`"),
            ("{'descr': '<f4', 'fortran_order': False, 'shape': (1,)} x", "header"),
            ("{'descr': '<f4", "header"),
            ("", "`{`"),
        ] {
            assert_names(parse(text).unwrap_err(), &[word]);
        }
    }
}
