//! Arrays as text: zlib, then base64, which the page's script decodes.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::Write;

/// Bytes, compressed and encoded.
pub(super) fn pack(bytes: &[u8]) -> String {
    let mut zip = ZlibEncoder::new(Vec::new(), Compression::default());
    let packed = zip.write_all(bytes).and_then(|()| zip.finish());
    STANDARD.encode(packed.expect("a Vec takes whatever is written"))
}

/// Little-endian floats, compressed and encoded.
pub(super) fn pack_floats(values: &[f32]) -> String {
    pack(&values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>())
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use std::io::Read;

    #[test]
    fn packed_bytes_are_decoded() {
        let packed = STANDARD.decode(pack(b"as it was")).unwrap();
        let mut text = String::new();
        flate2::read::ZlibDecoder::new(&packed[..]).read_to_string(&mut text).unwrap();
        assert_eq!(text, "as it was");
    }
}
