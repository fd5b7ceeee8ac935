//! Reading `OpenEXR` files that may be hostile: what the decoder will allocate is bounded before it runs.
//!
//! The exr crate allocates what a file declares: a structure of hundreds of bytes for an attribute of ten, buffers of the
//! size of a tile (which may be larger than the image), and, for DWA compression, whatever the counters of a chunk say.
//! An allocation that fails ends the process. So the headers are counted before they are parsed, the buffers before the
//! pixels are decoded, and the counters of DWA chunks are compared with the pixels that the chunk can hold.

use super::{ExrParts, no_room};
use crate::alloc::try_with_capacity;
use crate::error::{self, Error, Result};
use crate::files::open_input;
use exr::block::chunk::{Chunk, CompressedBlock};
use exr::meta::header::Header;
use exr::meta::{BlockDescription, compute_chunk_count};
use exr::prelude as ex;
use exr::prelude::traits::*;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek};
use std::path::Path;

/// Bytes that the parser takes for a part and for an attribute, both twice: as parsed, and copied into the image.
const PART_BYTES: u128 = 4096;
const ATTRIBUTE_BYTES: u128 = 1024;

/// Bytes that the parser takes per byte of an attribute's value; lists of channels and of texts become structures.
const VALUE_COPIES: u128 = 4;
const LIST_COPIES: u128 = 40;

/// The longest name of an attribute, with some margin; the parser refuses longer ones.
const LONGEST_NAME: u64 = 300;

/// Bytes per chunk: its offset as read and as sorted, and its place in a vector that grows by doubling.
const CHUNK_BYTES: u128 = 192;

/// How often the decoder has a block in memory: decompressed, reordered, converted, and scratch of the wavelet or cosine
/// transforms.
const BLOCK_COPIES: u128 = 7;

/// More channels than any renderer writes in one part; looking one up takes time in proportion.
const MOST_CHANNELS: usize = 4096;

/// Reads every flat part of a file, where that takes at most `limit_bytes`, including `own` bytes that the caller will
/// take for parts with these headers.
///
/// # Errors
/// A missing or damaged file, deep data, or one that takes more memory than the limit, or than there is.
pub(in crate::export) fn read_parts(
    path: &Path,
    limit_bytes: u64,
    own: impl FnOnce(&[Header]) -> u128,
) -> Result<ExrParts> {
    let open = || open_input(path).map(BufReader::new);
    let fits = |bytes: u128, what: &str| {
        if bytes <= u128::from(limit_bytes) {
            return Ok(());
        }
        let problem = format!(
            "takes {bytes} bytes of memory to read, by its {what}, more than the limit of {limit_bytes}; raise the limit \
             (--memory), or save it with fewer pixels, channels or attributes"
        );
        Err(Error::input(path.display(), problem))
    };
    let headers = declared_by_headers(open()?).map_err(|error| Error::reading(path, error))?;
    fits(headers, "headers")?;
    let meta = guarded(path, {
        let file = open()?;
        || ex::MetaData::read_from_buffered(file, false)
    })?;
    if let Some(header) = meta.headers.iter().find(|header| header.channels.list.len() > MOST_CHANNELS) {
        let problem = format!(
            "has a part of {} channels; expected {MOST_CHANNELS} at most",
            header.channels.list.len()
        );
        return Err(Error::input(path.display(), problem));
    }
    // The pixels come first: the number of chunks is computed without overflow only for images that fit in memory.
    let pixels = meta.headers.iter().map(pixel_bytes).fold(headers, u128::saturating_add);
    fits(pixels, "pixels")?;
    let blocks = guarded(path, || Ok(decoding_bytes(&meta.headers)))?;
    let all = pixels.saturating_add(blocks.max(own(&meta.headers)));
    fits(all, "blocks of pixels")?;
    // The decoder allocates infallibly.
    let room = u64::try_from(all).ok().and_then(try_with_capacity::<u8>);
    room.map(drop).ok_or_else(|| {
        let size = meta.headers.first().map_or([0, 0], |header| [header.layer_size.0, header.layer_size.1]);
        no_room(size)
    })?;
    if meta.headers.iter().any(is_dwa) {
        guarded(path, {
            let file = open()?;
            || check_dwa_chunks(file)
        })?;
    }
    // Decoding uses only this thread, because a panic on another one could not be caught.
    guarded(path, {
        let file = open()?;
        || {
            read()
                .no_deep_data()
                .largest_resolution_level()
                .all_channels()
                .all_layers()
                .all_attributes()
                .non_parallel()
                .from_buffered(file)
        }
    })
}

/// Runs a reader that may fail or panic on damaged input.
fn guarded<T>(path: &Path, read: impl FnOnce() -> ex::Result<T>) -> Result<T> {
    let refused = |problem: &str| {
        Error::input(
            path.display(),
            format!("is not a readable EXR file ({problem}); an OpenEXR file with flat pixels was expected"),
        )
    };
    match error::guarded(read) {
        Some(Ok(value)) => Ok(value),
        // A damaged offset leads to the end of the file, or to an invalid position.
        Some(Err(ex::Error::Io(error)))
            if !matches!(error.kind(), io::ErrorKind::UnexpectedEof | io::ErrorKind::InvalidInput) =>
        {
            Err(Error::reading(path, error))
        }
        Some(Err(error)) => Err(refused(&error.to_string())),
        None => Err(refused("its contents are inconsistent")),
    }
}

/// About how many bytes the parser takes for all headers. Ends where the parser would find a fault.
fn declared_by_headers(mut file: BufReader<File>) -> io::Result<u128> {
    let mut start = [0; 8];
    if read_up_to(&mut file, &mut start)? < start.len() {
        return Ok(0);
    }
    let end = file.get_ref().metadata()?.len();
    let multipart = u32::from_le_bytes([start[4], start[5], start[6], start[7]]) & 0x1000 != 0;
    let mut bytes: u128 = 0;
    loop {
        bytes += PART_BYTES;
        let mut attributes = 0_u64;
        while let Some([name, kind]) = name_and_kind(&mut file)? {
            if name.is_empty() {
                break;
            }
            let mut size = [0; 4];
            if read_up_to(&mut file, &mut size)? < size.len() {
                return Ok(bytes);
            }
            let size = u32::from_le_bytes(size);
            let is_list = [&b"chlist"[..], b"stringvector"].contains(&kind.as_slice());
            let copies = if is_list { LIST_COPIES } else { VALUE_COPIES };
            bytes += ATTRIBUTE_BYTES;
            // A value that is cut off by the end of the file does not count: the parser allocates what it reads.
            let left = end.saturating_sub(file.stream_position()?);
            bytes += copies * u128::from(u64::from(size).min(left));
            file.seek_relative(i64::from(size))?;
            attributes += 1;
        }
        // An empty header ends the list in a multi-part file.
        if attributes == 0 || !multipart {
            return Ok(bytes);
        }
    }
}

/// The name of the next attribute and its type, without the zeros that end them; both empty at the end of a header, `None`
/// at the end of the file or where there is no name.
fn name_and_kind(file: &mut BufReader<File>) -> io::Result<Option<[Vec<u8>; 2]>> {
    let mut texts = [Vec::new(), Vec::new()];
    for text in &mut texts {
        file.by_ref().take(LONGEST_NAME).read_until(0, text)?;
        if text.pop() != Some(0) {
            return Ok(None);
        }
        if text.is_empty() {
            break;
        }
    }
    Ok(Some(texts))
}

/// Fills as much of a buffer as there is left of the file.
fn read_up_to(file: &mut BufReader<File>, buffer: &mut [u8]) -> io::Result<usize> {
    let mut filled = 0;
    while filled < buffer.len() {
        match file.read(&mut buffer[filled..])? {
            0 => break,
            more => filled += more,
        }
    }
    Ok(filled)
}

/// Bytes of a part's pixels, of which only the largest level is read.
fn pixel_bytes(header: &Header) -> u128 {
    let pixels = header.layer_size.0 as u128 * header.layer_size.1 as u128;
    pixels.saturating_mul(header.channels.bytes_per_pixel as u128)
}

/// Bytes that decoding takes besides the pixels: tables of chunks, and the largest block in the forms it goes through.
///
/// # Panics
/// Where the exr crate does: for tiles without a size.
fn decoding_bytes(headers: &[Header]) -> u128 {
    let chunks: u128 = headers
        .iter()
        .map(|header| compute_chunk_count(header.compression, header.layer_size, header.blocks) as u128)
        .sum();
    let block = headers.iter().map(|header| {
        let size = header.max_block_pixel_size();
        let per_pixel = header.channels.bytes_per_pixel as u128;
        let declared = (size.0 as u128).saturating_mul(size.1 as u128).saturating_mul(per_pixel);
        let rows = header.layer_size.1.min(size.1) as u128;
        let within = rows.saturating_mul(header.layer_size.0.min(size.0) as u128).saturating_mul(per_pixel);
        // A chunk as read may be as large as its tile, whatever part of that the image fills. Uncompressed lines are short.
        let read = if matches!(header.blocks, BlockDescription::Tiles(_)) { declared } else { within };
        read.saturating_add(BLOCK_COPIES.saturating_mul(within))
    });
    block.max().unwrap_or(0).saturating_add(CHUNK_BYTES.saturating_mul(chunks))
}

fn is_dwa(header: &Header) -> bool {
    matches!(header.compression, ex::Compression::DWAA(_) | ex::Compression::DWAB(_))
}

/// Compares the counters of every DWA chunk with the pixels that it can hold: the decoder allocates what they say.
fn check_dwa_chunks(file: BufReader<File>) -> ex::Result<()> {
    let chunks = exr::block::read(file, false)?;
    let headers = chunks.headers().to_vec();
    let largest = |_: &ex::MetaData, tile: exr::block::chunk::TileCoordinates, _: exr::block::BlockIndex| {
        tile.is_largest_resolution_level()
    };
    for chunk in chunks.filter_chunks(false, largest)? {
        let chunk = chunk?;
        let header = headers.get(chunk.layer_index).filter(|header| is_dwa(header));
        if let Some(header) = header {
            check_dwa_chunk(header, &chunk)?;
        }
    }
    Ok(())
}

/// See `DwaCompressor` of the `OpenEXR` library: eleven counters of eight bytes each, the version first.
fn check_dwa_chunk(header: &Header, chunk: &Chunk) -> ex::Result<()> {
    let bytes = match &chunk.compressed_block {
        CompressedBlock::ScanLine(block) => &block.compressed_pixels_le,
        CompressedBlock::Tile(block) => &block.compressed_pixels_le,
        _ => return Err(ex::Error::NotSupported("deep data".into())),
    };
    let place = header.get_block_data_indices(&chunk.compressed_block)?;
    let size = header.get_absolute_block_pixel_coordinates(place)?.size;
    let all = (size.0 * size.1 * header.channels.bytes_per_pixel) as u64;
    // A chunk that compression would not make smaller is stored as it is.
    if bytes.len() as u64 == all {
        return Ok(());
    }
    let counters: Vec<u64> =
        bytes.as_chunks::<8>().0.iter().take(11).map(|eight| u64::from_le_bytes(*eight)).collect();
    let [_, unknown, _, _, _, _, tokens, raw, coefficients, means, _] = counters[..] else {
        return Err(ex::Error::Invalid("a DWA chunk without its counters".into()));
    };
    // Transforms are of 8 x 8 pixels, with one mean and 63 other coefficients each.
    let blocks = (size.0.div_ceil(8) * size.1.div_ceil(8) * header.channels.list.len()) as u64;
    // Runs are encoded in twice their bytes at the most.
    let possible =
        unknown <= all && raw <= all && tokens <= 2 * all && coefficients <= 64 * blocks && means <= blocks;
    if possible {
        return Ok(());
    }
    Err(ex::Error::Invalid(
        "a chunk of DWA compression declares more than its pixels; save it with ZIP".into(),
    ))
}

#[cfg(test)]
mod tests;
