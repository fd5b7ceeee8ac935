//! The container of a glTF file: JSON or GLB, and the buffers it refers to.
//!
//! `gltf::import_buffers` 1.4 is not used: it follows `file:` URIs and `..` out of the mesh's folder, panics on a name
//! that is not UTF-8, and allocates whatever size a file declares.

use std::borrow::Cow;
use std::cell::Cell;
use std::fmt::Display;
use std::path::PathBuf;

use ::gltf::json;
use base64::engine::general_purpose::STANDARD_PAD_INDIFFERENT;
use base64::{Engine as _, decoded_len_estimate};
use percent_encoding::percent_decode_str;

use super::super::files::{self, MeshFile};
use crate::alloc::try_with_capacity;
use crate::error::{Error, Result};
use crate::text::quoted;

/// A parsed file and its buffers, none of them shorter than declared.
pub(super) struct Document<'a> {
    pub(super) file: MeshFile<'a>,
    pub(super) root: json::Root,
    pub(super) buffers: Vec<Vec<u8>>,
    /// Number of sparse values that may still be read.
    allowance: Cell<u64>,
}

/// Maximum number of sparse values of all accessors together. Sparse accessors, and the primitives that refer to them,
/// may share bytes, so the length of the file does not limit their work.
const MOST_SPARSE_VALUES: u64 = 1 << 30;

impl<'a> Document<'a> {
    pub(super) fn open(file: MeshFile<'a>) -> Result<Self> {
        let mut bytes = file.read()?;
        // The content decides, not the file name: exporters confuse .gltf and .glb.
        let (text, binary) = if bytes.starts_with(b"glTF") {
            split_glb(&bytes).map_err(|problem| file.refused(problem))?
        } else {
            (if bytes.starts_with(BOM) { BOM.len() } else { 0 }..bytes.len(), None)
        };
        let root = parse(&bytes[text]).map_err(|error| {
            let what = if error.is_eof() { "is cut short" } else { "is not valid glTF 2.0" };
            file.refused(format!("{what}: {error}"))
        })?;
        if !root.asset.version.starts_with("2.") {
            let version = &root.asset.version;
            return Err(file.refused(format!("is glTF {version}; only version 2 is supported")));
        }
        for extension in &root.extensions_required {
            if !is_read_or_harmless(extension) {
                return Err(unsupported_extension(file.path.display(), extension));
            }
        }
        let allowance = Cell::new(MOST_SPARSE_VALUES);
        let mut document = Self { file, root, buffers: Vec::new(), allowance };
        // Reuses the file's own bytes instead of copying them.
        let mut binary = binary.map(|part| {
            bytes.truncate(part.end);
            bytes.drain(..part.start);
            bytes
        });
        for i in 0..document.root.buffers.len() {
            let buffer = document.buffer(i, &mut binary)?;
            document.buffers.push(buffer);
        }
        Ok(document)
    }

    /// Whether the file declares that it uses an extension.
    pub(super) fn uses(&self, extension: &str) -> bool {
        [&self.root.extensions_used, &self.root.extensions_required]
            .into_iter()
            .flatten()
            .any(|name| name == extension)
    }

    /// Counts the values of a sparse accessor, and refuses too many.
    pub(super) fn spend(&self, values: u64, place: &str) -> Result<()> {
        let left = self.allowance.get().checked_sub(values);
        self.allowance.set(left.unwrap_or(0));
        left.map(drop).ok_or_else(|| {
            Error::input(
                place,
                format!("replaces, with others, over {MOST_SPARSE_VALUES} sparse values; export without sparse accessors"),
            )
        })
    }

    /// An element of the file, for messages.
    pub(super) fn place(&self, kind: &str, index: usize, name: Option<&String>) -> String {
        let name = name.map(|name| format!(" (`{}`)", quoted(name))).unwrap_or_default();
        format!("{}, {kind} {index}{name}", self.file.path.display())
    }

    /// The bytes of a buffer; the first may be the `binary` chunk of the file, which is then taken.
    fn buffer(&self, index: usize, binary: &mut Option<Vec<u8>>) -> Result<Vec<u8>> {
        let buffer = &self.root.buffers[index];
        let place = || self.place("buffer", index, buffer.name.as_ref());
        let refused = |problem: String| Error::input(place(), problem);
        let own = if index == 0 && buffer.uri.is_none() { binary.take() } else { None };
        let mut bytes = match (&buffer.uri, own) {
            (Some(uri), _) if uri.starts_with("data:") => decode_data_uri(uri).map_err(refused)?,
            (Some(uri), _) => {
                let file = self.external(uri).map_err(refused)?;
                let bytes = MeshFile { path: &file, ..self.file }.read();
                bytes.map_err(|error| refused(error.to_string()))?
            }
            (None, Some(binary)) => binary,
            (None, _) => {
                let meshopt = self.root.extensions_used.iter().find(|e| e.contains("meshopt_compression"));
                return Err(match meshopt {
                    Some(extension) => unsupported_extension(place(), extension),
                    None => refused("has no uri, and the file has no binary chunk for it".to_owned()),
                });
            }
        };
        let expected = buffer.byte_length.0;
        if (bytes.len() as u64) < expected {
            return Err(refused(format!("is cut short: {} of {expected} bytes", bytes.len())));
        }
        bytes.truncate(expected as usize);
        Ok(bytes)
    }

    fn external(&self, uri: &str) -> std::result::Result<PathBuf, String> {
        if uri.contains(':') {
            return Err(format!(
                "refers to `{}`; only files in the folder of the mesh are read",
                quoted(uri)
            ));
        }
        let name = decode_percent(uri).ok_or_else(|| format!("has a malformed uri `{}`", quoted(uri)))?;
        files::beside(self.file.path, &name)
    }
}

/// The typed JSON. The crate demands more than the specification where a scene has no nodes or an extension provides
/// a texture's image, so a second attempt leaves out what is not needed here.
fn parse(text: &[u8]) -> std::result::Result<json::Root, serde_json::Error> {
    // Always by the crate's own function, which is compiled with it; a generic one is compiled again here.
    json::Root::from_slice(text).or_else(|error| {
        let Ok(serde_json::Value::Object(mut root)) = serde_json::from_slice(text) else { return Err(error) };
        for unused in ["textures", "images", "samplers", "animations", "skins"] {
            root.remove(unused);
        }
        let scenes = root.get_mut("scenes").and_then(serde_json::Value::as_array_mut);
        for scene in scenes.into_iter().flatten().filter_map(serde_json::Value::as_object_mut) {
            scene.entry("nodes").or_insert_with(|| serde_json::json!([]));
        }
        // The first error has the line number.
        let text = serde_json::Value::Object(root).to_string();
        json::Root::from_slice(text.as_bytes()).map_err(|_| error)
    })
}

/// Whether an extension is read, or changes how a surface looks but not where it is.
fn is_read_or_harmless(extension: &str) -> bool {
    let prefixes = [
        "KHR_mesh_quantization",
        "EXT_mesh_gpu_instancing",
        "KHR_materials_",
        "KHR_texture_",
        "KHR_lights_",
        "EXT_texture_",
        "EXT_lights_",
        "MSFT_texture_",
        "KHR_xmp",
    ];
    prefixes.iter().any(|prefix| extension.starts_with(prefix))
}

/// The error for an extension without which the geometry cannot be read, with a way to remove it.
pub(super) fn unsupported_extension(place: impl Display, extension: &str) -> Error {
    let fix = match extension {
        "KHR_draco_mesh_compression" | "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            "`gltf-transform copy in.glb out.glb` (npm package @gltf-transform/cli) writes the mesh without compression"
        }
        _ => "export the mesh without it",
    };
    Error::input(
        place,
        format!("requires the extension {}, which is not supported; {fix}", quoted(extension)),
    )
}

/// The byte order mark that some programs write before the text.
pub(super) const BOM: &[u8] = b"\xef\xbb\xbf";

/// Byte range of a part of a file.
type Part = std::ops::Range<usize>;

/// The JSON and the binary chunk of a GLB file (glTF 2.0 specification, 4.4).
fn split_glb(bytes: &[u8]) -> std::result::Result<(Part, Option<Part>), String> {
    let word = |at: usize| bytes.get(at..)?.first_chunk().map(|word| u32::from_le_bytes(*word));
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err("is cut short within its header".to_owned());
    };
    if version != 2 {
        return Err(format!("is GLB version {version}; only version 2 is supported"));
    }
    if (bytes.len() as u64) < u64::from(length) {
        return Err(format!("is cut short: {} of {length} bytes", bytes.len()));
    }
    let (mut text, mut binary) = (None, None);
    let mut at = 12;
    while let (Some(size), Some(kind)) = (word(at), word(at + 4)) {
        let size = size as usize;
        let chunk = at + 8..at + 8 + size;
        bytes.get(chunk.clone()).ok_or("is cut short within a chunk")?;
        match &kind.to_le_bytes() {
            b"JSON" if text.is_none() => text = Some(chunk),
            b"BIN\0" if binary.is_none() => binary = Some(chunk),
            _ => {}
        }
        at += 8 + size;
    }
    text.map(|text| (text, binary)).ok_or_else(|| "has no JSON chunk".to_owned())
}

fn decode_data_uri(uri: &str) -> std::result::Result<Vec<u8>, String> {
    let data = uri.split_once(";base64,").map(|(_, data)| data);
    let data = data.ok_or("has a data uri that is not base64")?;
    let mut bytes = try_with_capacity(decoded_len_estimate(data.len()) as u64)
        .ok_or_else(|| "has a data uri too long for memory".to_owned())?;
    STANDARD_PAD_INDIFFERENT
        .decode_vec(data, &mut bytes)
        .map_err(|error| format!("has a data uri with malformed base64: {error}"))?;
    Ok(bytes)
}

/// Decodes `%20` and the like; `None` for malformed ones, and when the result is not UTF-8.
fn decode_percent(uri: &str) -> Option<Cow<'_, str>> {
    // The crate leaves malformed ones unchanged; RFC 3986 has no `%` without two digits.
    let is_encoded = |rest: &str| rest.bytes().take(2).filter(u8::is_ascii_hexdigit).count() == 2;
    if !uri.split('%').skip(1).all(is_encoded) {
        return None;
    }
    percent_decode_str(uri).decode_utf8().ok()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn data_uris_are_padded_or_not_and_refused_where_malformed() {
        for (text, plain) in [("", ""), ("Zg==", "f"), ("Zm8", "fo"), ("Zm9v", "foo"), ("Zm9vYg==", "foob")] {
            let uri = format!("data:application/octet-stream;base64,{text}");
            assert_eq!(decode_data_uri(&uri).unwrap(), plain.as_bytes());
        }
        assert_eq!(decode_data_uri("data:;base64,//79+w==").unwrap(), [0xff, 0xfe, 0xfd, 0xfb]);
        for bad in ["Z", "Zm-v", "Zm 9v", "Zm9v====", "=Zg="] {
            let problem = decode_data_uri(&format!("data:;base64,{bad}")).unwrap_err();
            assert!(problem.contains("malformed base64: "), "{bad}: {problem}");
        }
    }

    #[test]
    fn percent_signs_are_decoded_or_refused() {
        assert_eq!(decode_percent("a%20b%C3%A9").unwrap(), "a bé");
        for bad in ["%", "%2", "%zz", "%ff", "%+1", "%20%", "%2é"] {
            assert!(decode_percent(bad).is_none(), "{bad}");
        }
    }
}
