//! Arrays as text: zlib, then base64, as the page's script unpacks them.

use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::io::Write;

/// Bytes, packed.
pub(super) fn pack(bytes: &[u8]) -> String {
    let mut zip = ZlibEncoder::new(Vec::new(), Compression::default());
    let packed = zip.write_all(bytes).and_then(|()| zip.finish());
    base64(&packed.expect("a Vec takes whatever is written"))
}

/// Little-endian floats, packed.
pub(super) fn pack_floats(values: &[f32]) -> String {
    pack(&values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>())
}

/// RFC 4648, with padding.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let bits =
            three.iter().enumerate().fold(0_u32, |bits, (i, byte)| bits | u32::from(*byte) << (16 - 8 * i));
        for k in 0..4 {
            let letter = LETTERS[(bits >> (18 - 6 * k) & 63) as usize];
            text.push(if k <= three.len() { char::from(letter) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use std::io::Read;

    #[test]
    fn base64_as_in_the_rfc() {
        for (bytes, text) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xfe]), "+//+");
    }

    #[test]
    fn zlib_gives_the_bytes_back() {
        let mut zip = ZlibEncoder::new(Vec::new(), Compression::default());
        zip.write_all(b"as it was").unwrap();
        let packed = zip.finish().unwrap();
        assert_eq!(pack(b"as it was"), base64(&packed));
        let mut text = String::new();
        flate2::read::ZlibDecoder::new(&packed[..]).read_to_string(&mut text).unwrap();
        assert_eq!(text, "as it was");
    }
}
