//! Chunks: from elements to bytes of a file and back; and the index of a shard.

use crc::{CRC_32_ISCSI, Crc, Table};
use flate2::bufread::GzDecoder;
use flate2::write::GzEncoder;
use ruzstd::decoding::StreamingDecoder;
use std::io::{self, Read, Write};

/// CRC-32C, Castagnoli's.
static CRC32C: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISCSI);

/// What is done to the bytes of a chunk's elements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Codec {
    /// `gzip`, as flate2's default level writes it.
    Gzip,
    /// `zstd`, only read.
    Zstd,
    /// `crc32c`: a checksum at the end.
    Crc32c,
}

/// The place of a chunk in its shard: offset and bytes.
pub(super) type Place = (u64, u64);

/// What an index says of a chunk that is missing.
const MISSING: u64 = u64::MAX;

/// Applies codecs in turn.
pub(super) fn encode(mut bytes: Vec<u8>, codecs: &[Codec]) -> io::Result<Vec<u8>> {
    for codec in codecs {
        match codec {
            Codec::Gzip => {
                let mut out = GzEncoder::new(Vec::with_capacity(bytes.len()), flate2::Compression::default());
                out.write_all(&bytes)?;
                bytes = out.finish()?;
            }
            Codec::Crc32c => bytes.extend(CRC32C.checksum(&bytes).to_le_bytes()),
            Codec::Zstd => unreachable!("never written"),
        }
    }
    Ok(bytes)
}

/// The most bytes to which codecs can turn `length`, with room for a few that are careless.
pub(super) fn most_encoded(length: u64) -> u64 {
    length.saturating_add(length / 4).saturating_add(4096)
}

/// Undoes codecs; the result must have `length` bytes. The error says what is wrong.
pub(super) fn decode(mut bytes: Vec<u8>, codecs: &[Codec], length: usize) -> Result<Vec<u8>, String> {
    for (i, codec) in codecs.iter().enumerate().rev() {
        // Before the first compression the length is known; after it, it is bounded.
        let before = &codecs[..i];
        let exact = before.iter().all(|codec| *codec == Codec::Crc32c);
        let most = if exact {
            (length + 4 * before.len()) as u64
        } else {
            most_encoded(most_encoded(length as u64))
        };
        let mut rest = &bytes[..];
        let decoded = match codec {
            Codec::Gzip => inflated(GzDecoder::new(&mut rest), most, "gzip")?,
            Codec::Zstd => {
                let decoder = StreamingDecoder::new_with_max_window_size(&mut rest, most.max(1 << 20));
                let damaged = |error| format!("its zstd data are damaged ({error})");
                inflated(decoder.map_err(damaged)?, most, "zstd")?
            }
            Codec::Crc32c => {
                bytes = checked(bytes)?;
                continue;
            }
        };
        if !rest.is_empty() {
            return Err(format!("there are {} bytes after its compressed data", rest.len()));
        }
        bytes = decoded;
    }
    if bytes.len() == length {
        return Ok(bytes);
    }
    Err(format!("it has {} bytes; its shape requires {length}", bytes.len()))
}

/// All that a decoder gives, at most `most` bytes.
fn inflated(decoder: impl Read, most: u64, name: &str) -> Result<Vec<u8>, String> {
    let mut out = Vec::new();
    decoder
        .take(most + 1)
        .read_to_end(&mut out)
        .map_err(|error| format!("its {name} data are damaged ({error})"))?;
    if out.len() as u64 > most {
        return Err(format!("its {name} data inflate to more than the {most} bytes that its shape allows"));
    }
    Ok(out)
}

/// The bytes before their checksum.
fn checked(mut bytes: Vec<u8>) -> Result<Vec<u8>, String> {
    let Some((content, sum)) = bytes.split_last_chunk::<4>() else {
        return Err("it is too short for its crc32c".into());
    };
    if CRC32C.checksum(content) != u32::from_le_bytes(*sum) {
        return Err("its crc32c does not match".into());
    }
    bytes.truncate(bytes.len() - 4);
    Ok(bytes)
}

/// The index of a shard: where each chunk is, and a checksum.
pub(super) fn encode_index(places: &[Place]) -> Vec<u8> {
    let mut bytes: Vec<u8> = places
        .iter()
        .flat_map(|(offset, length)| [offset.to_le_bytes(), length.to_le_bytes()].concat())
        .collect();
    bytes.extend(CRC32C.checksum(&bytes).to_le_bytes());
    bytes
}

/// How an index is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct IndexCoding {
    pub(super) big_endian: bool,
    pub(super) crc32c: bool,
    pub(super) at_end: bool,
}

impl IndexCoding {
    /// Bytes of the index of so many chunks.
    pub(super) fn bytes(self, chunks: u64) -> Option<u64> {
        chunks.checked_mul(16)?.checked_add(if self.crc32c { 4 } else { 0 })
    }

    /// The places of the chunks, `None` where one is missing.
    pub(super) fn decode(self, bytes: Vec<u8>) -> Result<Vec<Option<Place>>, String> {
        let bytes =
            if self.crc32c { checked(bytes).map_err(|e| format!("in its index, {e}"))? } else { bytes };
        let number = |eight: [u8; 8]| {
            if self.big_endian { u64::from_be_bytes(eight) } else { u64::from_le_bytes(eight) }
        };
        let numbers: Vec<u64> = bytes.as_chunks::<8>().0.iter().map(|eight| number(*eight)).collect();
        Ok(numbers
            .as_chunks::<2>()
            .0
            .iter()
            .map(|&[offset, length]| (offset != MISSING || length != MISSING).then_some((offset, length)))
            .collect())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_castagnolis() {
        // The check value of RFC 3720.
        assert_eq!(CRC32C.checksum(b"123456789"), 0xe306_9283);
    }

    #[test]
    fn chunks_come_back_and_damage_is_noticed() {
        let bytes: Vec<u8> = (0..3000_u32).map(|i| ((i * i) >> 3) as u8).collect();
        for codecs in
            [&[][..], &[Codec::Gzip], &[Codec::Crc32c], &[Codec::Crc32c, Codec::Gzip, Codec::Crc32c]]
        {
            let encoded = encode(bytes.clone(), codecs).unwrap();
            assert_eq!(decode(encoded.clone(), codecs, bytes.len()).unwrap(), bytes);
            assert!(decode(encoded.clone(), codecs, bytes.len() - 1).is_err());
            assert!(decode(encoded[..encoded.len() - 1].to_vec(), codecs, bytes.len()).is_err());
            if let Some(Codec::Crc32c) = codecs.last() {
                for at in (0..encoded.len()).step_by(97) {
                    let mut damaged = encoded.clone();
                    damaged[at] ^= 4;
                    assert!(decode(damaged, codecs, bytes.len()).unwrap_err().contains("crc32c"));
                }
            }
        }
        // A megabyte of zeros in a chunk of ten bytes.
        let bomb = encode(vec![0; 1 << 20], &[Codec::Gzip]).unwrap();
        assert!(decode(bomb, &[Codec::Gzip], 10).unwrap_err().contains("more than the 10 bytes"));
    }

    #[test]
    fn an_index_comes_back() {
        let places = [(0, 5), (MISSING, MISSING), (5, 7)];
        let coding = IndexCoding { big_endian: false, crc32c: true, at_end: true };
        let encoded = encode_index(&places);
        assert_eq!(coding.bytes(3), Some(encoded.len() as u64));
        assert_eq!(coding.decode(encoded).unwrap(), [Some((0, 5)), None, Some((5, 7))]);
    }
}
