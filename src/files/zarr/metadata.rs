//! `zarr.json` of an array: what of version 3 is read, checked and refused by name.

use super::codec::{Codec, IndexCoding};
use crate::error::{Error, Result};
use crate::files::input::open_regular;
use crate::files::npz::{Dtype, DtypeKind};
use crate::text::quoted;
use serde_json::Value;
use std::io::Read;
use std::path::Path;

/// Longest `zarr.json` accepted, bytes: a resolved run file takes a few thousand.
const LONGEST: u64 = 16 << 20;

/// The most axes of an array, as of NumPy's, and the most codecs after `bytes`.
const MOST_AXES: usize = 64;
const MOST_CODECS: usize = 4;

/// What was read, or what is wrong with it, without the place.
type Parsed<T> = std::result::Result<T, String>;

/// What the program understands of an array's metadata.
const ARRAY_KEYS: [&str; 11] = [
    "zarr_format",
    "node_type",
    "shape",
    "data_type",
    "chunk_grid",
    "chunk_key_encoding",
    "fill_value",
    "codecs",
    "attributes",
    "dimension_names",
    "storage_transformers",
];

/// How the coordinates of a chunk become the name of its file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct KeyCoding {
    /// Whether the name begins with `c`.
    prefixed: bool,
    separator: char,
}

/// An array.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ArrayMeta {
    pub(super) shape: Vec<usize>,
    pub(super) dtype: Dtype,
    /// The shape of what is in one file: a chunk or a shard.
    pub(super) file: Vec<usize>,
    /// The shape of what is decoded at once.
    pub(super) chunk: Vec<usize>,
    pub(super) codecs: Vec<Codec>,
    /// Of shards.
    pub(super) index: Option<IndexCoding>,
    pub(super) keys: KeyCoding,
    /// One element, in the array's endianness.
    pub(super) fill: Vec<u8>,
}

/// The parsed content of a `zarr.json`.
///
/// # Errors
/// A file that is missing or cannot be read, that is no JSON, or not of version 3.
pub(super) fn read_json(path: &Path) -> Result<Value> {
    let refuse = |problem: String| Err(Error::input(path.display(), problem));
    let mut text = Vec::new();
    let read = open_regular(path)?.take(LONGEST + 1).read_to_end(&mut text);
    read.map_err(|error| Error::reading(path, error))?;
    if text.len() as u64 > LONGEST {
        return refuse(format!("has more than {LONGEST} bytes, the most that metadata may take"));
    }
    let json: Value = match serde_json::from_slice(&text) {
        Ok(json) => json,
        Err(error) => return refuse(format!("is not the expected JSON: {error}")),
    };
    match json.get("zarr_format").and_then(Value::as_u64) {
        Some(3) => Ok(json),
        Some(version) => refuse(format!("is of Zarr version {version}; version 3 was expected")),
        None => refuse("does not say its `zarr_format`; 3 was expected".into()),
    }
}

impl ArrayMeta {
    /// Number of elements; `None` if it overflows.
    pub(super) fn elements(&self) -> Option<u64> {
        product(&self.shape)
    }

    /// Reads the metadata of an array.
    pub(super) fn parse(json: &Value) -> Parsed<Self> {
        if json["node_type"] != "array" {
            return Err("is no array; `node_type` \"array\" was expected".into());
        }
        for (key, value) in json.as_object().into_iter().flatten() {
            if !ARRAY_KEYS.contains(&key.as_str()) && value["must_understand"] != false {
                return Err(format!("has the unknown key `{}` in its zarr.json", quoted(key)));
            }
        }
        if json.get("storage_transformers").is_some_and(|list| list.as_array().is_none_or(|l| !l.is_empty()))
        {
            return Err("uses storage transformers, which are not supported".into());
        }
        let shape = sizes(&json["shape"]).ok_or("has no `shape`; a list of sizes was expected")?;
        let (grid, configuration) = named(&json["chunk_grid"]).ok_or("has no `chunk_grid`")?;
        if grid != "regular" {
            return Err(format!("has chunks of the grid \"{}\"; \"regular\" is supported", quoted(grid)));
        }
        let file = chunk_shape(&configuration["chunk_shape"], shape.len())?;
        let keys = KeyCoding::parse(&json["chunk_key_encoding"])?;
        let (codecs, shards) = CodecChain::parse(&json["codecs"])?;
        let CodecChain { big_endian, codecs } = codecs;
        let (chunk, index) = match shards {
            None => (file.clone(), None),
            Some((inner, index)) => {
                let inner = chunk_shape(inner, shape.len())?;
                if inner.iter().zip(&file).any(|(inner, outer)| outer % inner != 0) {
                    return Err(format!(
                        "has shards of {file:?}, which are no multiples of its chunks, {inner:?}"
                    ));
                }
                (inner, Some(index))
            }
        };
        let dtype = dtype(&json["data_type"], big_endian)?;
        let fill = fill_value(&json["fill_value"], dtype)?;
        Ok(Self { shape, dtype, file, chunk, codecs, index, keys, fill })
    }
}

/// The product of sizes, `None` if it overflows.
pub(super) fn product(sizes: &[usize]) -> Option<u64> {
    sizes.iter().try_fold(1_u64, |product, &n| product.checked_mul(n as u64))
}

fn sizes(json: &Value) -> Option<Vec<usize>> {
    let list = json.as_array().filter(|list| list.len() <= MOST_AXES)?;
    list.iter().map(|size| usize::try_from(size.as_u64()?).ok()).collect()
}

fn chunk_shape(json: &Value, axes: usize) -> Parsed<Vec<usize>> {
    sizes(json)
        .filter(|sizes| sizes.len() == axes && sizes.iter().all(|&n| n > 0) && product(sizes).is_some())
        .ok_or_else(|| format!("has a `chunk_shape` that is not a list of {axes} sizes of 1 or more"))
}

/// Name and configuration of an extension point, which may be a name alone.
fn named(json: &Value) -> Option<(&str, &Value)> {
    json.as_str()
        .map(|name| (name, &Value::Null))
        .or_else(|| Some((json["name"].as_str()?, &json["configuration"])))
}

impl KeyCoding {
    fn parse(json: &Value) -> Parsed<Self> {
        let (name, configuration) = named(json).ok_or("has no `chunk_key_encoding`")?;
        let (prefixed, default) = match name {
            "default" => (true, "/"),
            "v2" => (false, "."),
            other => {
                return Err(format!("names its chunks by \"{}\"; \"default\" is supported", quoted(other)));
            }
        };
        let separator = match configuration.get("separator").unwrap_or(&Value::Null) {
            Value::Null => default,
            Value::String(text) if text == "/" || text == "." => text,
            _ => return Err("has a `separator` of chunk names other than \"/\" or \".\"".into()),
        };
        Ok(Self { prefixed, separator: if separator == "/" { '/' } else { '.' } })
    }

    /// The name of a chunk's file, below the array's folder.
    pub(super) fn name(self, coordinates: &[usize]) -> String {
        let mut words: Vec<String> = coordinates.iter().map(usize::to_string).collect();
        if self.prefixed {
            words.insert(0, "c".to_owned());
        } else if words.is_empty() {
            words.push("0".to_owned());
        }
        words.join(&self.separator.to_string())
    }
}

/// The codecs of a chunk.
struct CodecChain {
    big_endian: bool,
    codecs: Vec<Codec>,
}

impl CodecChain {
    /// The codecs of an array's chunks, and if those are in shards their shape and how the index is stored.
    fn parse(json: &Value) -> Parsed<(Self, Option<(&Value, IndexCoding)>)> {
        let list = json.as_array().ok_or("has no `codecs`")?;
        let Some(("sharding_indexed", configuration)) = list.first().and_then(named) else {
            return Ok((Self::of_chunk(json)?, None));
        };
        if list.len() > 1 {
            return Err("has codecs after its shards, which are not supported".into());
        }
        let of_index =
            Self::of_chunk(&configuration["index_codecs"]).map_err(|e| format!("{e} (of its index)"))?;
        let crc32c = match of_index.codecs[..] {
            [] => false,
            [Codec::Crc32c] => true,
            _ => return Err("has an index that is compressed, which is not supported".into()),
        };
        let at_end = match configuration.get("index_location").map_or(Some("end"), Value::as_str) {
            Some("end") => true,
            Some("start") => false,
            _ => return Err("has an `index_location` that is neither \"start\" nor \"end\"".into()),
        };
        let index = IndexCoding { big_endian: of_index.big_endian, crc32c, at_end };
        Ok((Self::of_chunk(&configuration["codecs"])?, Some((&configuration["chunk_shape"], index))))
    }

    /// Codecs without shards.
    fn of_chunk(json: &Value) -> Parsed<Self> {
        let list = json.as_array().ok_or("has no `codecs`")?;
        let mut big_endian = None;
        let mut codecs = Vec::new();
        for codec in list {
            let (name, configuration) = named(codec).ok_or("has a codec without a name")?;
            match (name, big_endian) {
                ("bytes", None) => {
                    big_endian = Some(match configuration.get("endian").and_then(Value::as_str) {
                        Some("big") => true,
                        Some("little") => false,
                        // Of single bytes.
                        None if configuration.get("endian").is_none() => false,
                        _ => return Err("has an `endian` that is neither \"little\" nor \"big\"".into()),
                    });
                }
                ("gzip", Some(_)) => codecs.push(Codec::Gzip),
                ("zstd", Some(_)) => codecs.push(Codec::Zstd),
                ("crc32c", Some(_)) => codecs.push(Codec::Crc32c),
                _ => {
                    return Err(format!(
                        "uses the codec `{}`; bytes, and after it gzip, zstd and crc32c, are supported, also in \
                         sharding_indexed",
                        quoted(name)
                    ));
                }
            }
        }
        if codecs.len() > MOST_CODECS {
            return Err(format!("has more than {MOST_CODECS} codecs after `bytes`"));
        }
        big_endian.map(|big_endian| Self { big_endian, codecs }).ok_or("has no codec `bytes`".into())
    }
}

fn dtype(json: &Value, big_endian: bool) -> Parsed<Dtype> {
    let refused = |name: &str| {
        format!(
            "has the type `{}`; complex64, complex128, float32, float64 and integers are supported",
            quoted(name)
        )
    };
    let name = match json {
        Value::String(name) => name,
        other => return Err(refused(&other.to_string())),
    };
    let (kind, size) = match name.as_str() {
        "float32" => (DtypeKind::Float, 4),
        "float64" => (DtypeKind::Float, 8),
        "complex64" => (DtypeKind::Complex, 8),
        "complex128" => (DtypeKind::Complex, 16),
        "int8" => (DtypeKind::Signed, 1),
        "int16" => (DtypeKind::Signed, 2),
        "int32" => (DtypeKind::Signed, 4),
        "int64" => (DtypeKind::Signed, 8),
        "uint8" => (DtypeKind::Unsigned, 1),
        "uint16" => (DtypeKind::Unsigned, 2),
        "uint32" => (DtypeKind::Unsigned, 4),
        "uint64" => (DtypeKind::Unsigned, 8),
        other => return Err(refused(other)),
    };
    Ok(Dtype { kind, size, big_endian })
}

/// The bytes of one element that is missing.
fn fill_value(json: &Value, dtype: Dtype) -> Parsed<Vec<u8>> {
    let wrong =
        || format!("has the `fill_value` {}, which its type does not have", quoted(&json.to_string()));
    let bytes = match dtype.kind {
        DtypeKind::Complex => {
            let parts = json.as_array().filter(|parts| parts.len() == 2).ok_or_else(wrong)?;
            let part = |part: &Value| float(part, dtype.size / 2, dtype.big_endian).ok_or_else(wrong);
            [part(&parts[0])?, part(&parts[1])?].concat()
        }
        DtypeKind::Float => float(json, dtype.size, dtype.big_endian).ok_or_else(wrong)?,
        _ => {
            let number =
                json.as_i64().map(i128::from).or_else(|| json.as_u64().map(i128::from)).ok_or_else(wrong)?;
            let bits = 8 * dtype.size as u32;
            let (least, most) = if dtype.kind == DtypeKind::Signed {
                (-(1_i128 << (bits - 1)), (1_i128 << (bits - 1)) - 1)
            } else {
                (0, (1_i128 << bits) - 1)
            };
            if !(least..=most).contains(&number) {
                return Err(wrong());
            }
            ordered(&number.to_le_bytes()[..dtype.size as usize], dtype.big_endian)
        }
    };
    Ok(bytes)
}

/// A number as fill values are written: also as a word, or by its bits.
fn float(json: &Value, size: u64, big_endian: bool) -> Option<Vec<u8>> {
    let number = match json {
        Value::Number(number) => number.as_f64()?,
        Value::String(text) => match text.as_str() {
            "NaN" => f64::NAN,
            "Infinity" => f64::INFINITY,
            "-Infinity" => f64::NEG_INFINITY,
            bits => {
                let bits = u64::from_str_radix(bits.strip_prefix("0x")?, 16).ok()?;
                return Some(ordered(&bits.to_le_bytes()[..size as usize], big_endian));
            }
        },
        _ => return None,
    };
    let bytes =
        if size == 4 { (number as f32).to_le_bytes().to_vec() } else { number.to_le_bytes().to_vec() };
    Some(ordered(&bytes, big_endian))
}

/// Little-endian bytes in the order of the array.
fn ordered(little: &[u8], big_endian: bool) -> Vec<u8> {
    if big_endian { little.iter().rev().copied().collect() } else { little.to_vec() }
}

#[cfg(test)]
mod tests;
