//! Writing `OpenEXR` files: blocks of pixels are made, encoded by all threads and written some at a time.
//!
//! The exr crate's own writer copies the headers of all parts for every block, and starts threads of its own.

use super::{ascii, encode};
use crate::error::{Error, Result};
use crate::export::volume::Component;
use crate::export::{Attribute, Compression, Encoding};
use crate::files::write_atomically;
use exr::block::chunk::{Chunk, CompressedBlock, CompressedScanLineBlock};
use exr::block::writer::ChunksWriter;
use exr::block::{BlockIndex, UncompressedBlock, enumerate_ordered_header_block_indices};
use exr::meta::BlockDescription;
use exr::meta::attribute::{ChannelDescription, LineOrder, SampleType, Text};
use exr::meta::header::{Header, LayerAttributes};
use exr::prelude::{self as ex, f16};
use num_complex::Complex32;
use rayon::prelude::*;
use smallvec::SmallVec;
use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;

/// Bytes of the blocks that are encoded together.
const TOGETHER: usize = 4 << 20;

/// Rows of a compressed block.
const LINES: u64 = 16;

/// Compression that would save less than this part of a block is left out, as readers expect of a block that it enlarges.
const LEAST_SAVED: f64 = 0.03;

/// A part to be written.
#[derive(Debug)]
pub(in crate::export) struct OutputPart<'a> {
    header: Header,
    /// In the order of their names.
    channels: Vec<Pixels<'a>>,
}

/// The pixels of a channel, row by row.
#[derive(Debug)]
pub(in crate::export) enum Pixels<'a> {
    /// The numbers themselves.
    Held(Vec<f32>),
    /// A number of each of these samples.
    Of(&'a [Complex32], Component),
}

impl Pixels<'_> {
    fn len(&self) -> usize {
        match self {
            Self::Held(values) => values.len(),
            Self::Of(samples, _) => samples.len(),
        }
    }

    /// Appends some of the pixels in 16 or 32 bits.
    fn append(&self, pixels: Range<usize>, half: bool, bytes: &mut Vec<u8>) {
        let mut add = |value: f32| {
            if half {
                bytes.extend_from_slice(&f16::from_f32(value).to_ne_bytes());
            } else {
                bytes.extend_from_slice(&value.to_ne_bytes());
            }
        };
        match self {
            Self::Held(values) => values[pixels].iter().for_each(|value| add(*value)),
            Self::Of(samples, component) => samples[pixels].iter().for_each(|sample| add(component(sample))),
        }
    }
}

impl<'a> OutputPart<'a> {
    /// A part of `width` x `height` pixels; `R`, `G`, `B` and `Y` may take 16 bits, every other channel takes 32.
    ///
    /// Later attributes replace earlier ones of the same name.
    ///
    /// # Panics
    /// If a channel does not have one sample per pixel, or an attribute's name does not start with `sonar:`.
    pub(in crate::export) fn new(
        name: Option<&str>,
        [width, height]: [usize; 2],
        mut channels: Vec<(String, Pixels<'a>)>,
        attributes: &[(String, Attribute)],
        encoding: Encoding,
    ) -> Self {
        let mut own = LayerAttributes {
            layer_name: name.map(ascii),
            software_name: Some(ascii(concat!("holosonar ", env!("CARGO_PKG_VERSION")))),
            ..LayerAttributes::default()
        };
        for (name, value) in attributes {
            // Any other name could replace an attribute that readers need.
            assert!(name.starts_with("sonar:"), "attribute `{name}`: the name must start with `sonar:`");
            own.other.insert(ascii(name), encode(value));
        }
        channels.sort_by(|a, b| a.0.cmp(&b.0));
        let described = |(name, pixels): &(String, Pixels)| {
            assert_eq!(pixels.len(), width * height, "channel {name}: one sample per pixel");
            let half = encoding.float16 && ["R", "G", "B", "Y"].contains(&name.as_str());
            ChannelDescription::named(ascii(name), if half { SampleType::F16 } else { SampleType::F32 })
        };
        let compression = match encoding.compression {
            Compression::Zip => ex::Compression::ZIP16,
            Compression::None => ex::Compression::Uncompressed,
        };
        let header = Header::new(Text::default(), (width, height), channels.iter().map(described).collect())
            .with_encoding(compression, BlockDescription::ScanLines, LineOrder::Increasing)
            .with_attributes(own);
        Self { header, channels: channels.into_iter().map(|(_, pixels)| pixels).collect() }
    }

    /// All its attributes, those that readers know and others.
    pub(in crate::export) fn attributes(&mut self) -> &mut LayerAttributes {
        &mut self.header.own_attributes
    }

    /// The rows of a block: of each row the channels one after another.
    fn block(&self, index: BlockIndex) -> UncompressedBlock {
        let (width, height) = (index.pixel_size.0, index.pixel_size.1);
        let mut data = Vec::with_capacity(width * height * self.header.channels.bytes_per_pixel);
        for row in index.pixel_position.1..index.pixel_position.1 + height {
            for (channel, pixels) in self.header.channels.list.iter().zip(&self.channels) {
                let half = channel.sample_type == SampleType::F16;
                pixels.append(row * width..(row + 1) * width, half, &mut data);
            }
        }
        UncompressedBlock { index, data }
    }

    /// The bytes of a block in the file.
    fn encoded(&self, index: BlockIndex, headers: &[Header]) -> ex::Result<Chunk> {
        let block = self.block(index);
        if self.header.compression == ex::Compression::Uncompressed || worth_compressing(&block.data) {
            return block.compress_to_chunk(headers);
        }
        let position = index.pixel_position.to_i32();
        let section = ex::IntegerBounds::new(position, index.pixel_size);
        let uncompressed = ex::Compression::Uncompressed;
        let compressed_pixels_le =
            uncompressed.compress_image_section_to_le(&self.header, block.data, section)?;
        let compressed_block = CompressedBlock::ScanLine(CompressedScanLineBlock {
            y_coordinate: position.1,
            compressed_pixels_le,
        });
        Ok(Chunk { layer_index: index.layer, compressed_block })
    }
}

/// Whether Huffman's code makes the differences that EXR's ZIP stores much shorter: between every second byte.
///
/// Most numbers of a measured volume are noise but for their exponents, and take as long to deflate as to compute.
fn worth_compressing(bytes: &[u8]) -> bool {
    let mut counts = [0u32; 256];
    for (byte, before) in bytes.iter().skip(2).zip(bytes) {
        counts[usize::from(byte.wrapping_sub(*before))] += 1;
    }
    let all = bytes.len() as f64;
    let bits = |count: &u32| f64::from(*count) * (all / f64::from((*count).max(1))).log2();
    counts.iter().map(bits).sum::<f64>() < (1.0 - LEAST_SAVED) * 8.0 * all
}

/// Bytes that [`write_parts`] takes beside pixels that are held, for so many parts of rows of so many bytes.
pub(in crate::export) fn writing_bytes(parts: usize, row: u64) -> u64 {
    // A block as it is, reordered, deflated, and copied; a header and its copy.
    let block = (TOGETHER as u64).max(LINES.saturating_mul(row));
    block.saturating_mul(4).saturating_add(8192 * parts as u64)
}

/// Writes the parts; one part makes a single-part file. The same parts give the same bytes.
///
/// # Errors
/// As [`write_atomically`].
pub(in crate::export) fn write_parts(path: &Path, parts: &[OutputPart]) -> Result<()> {
    let Some(first) = parts.first() else {
        return Err(Error::input(path.display(), "cannot be written: an EXR file needs at least one part"));
    };
    let (width, height) = (first.header.layer_size.0, first.header.layer_size.1);
    if [width, height].iter().any(|&n| n == 0 || i32::try_from(n).is_err()) {
        return Err(Error::input(
            path.display(),
            format!("an EXR image cannot have {width} x {height} pixels"),
        ));
    }
    let largest = parts.iter().map(|part| part.header.max_block_byte_size()).max().unwrap_or(1);
    let together = (TOGETHER / largest.max(1)).max(1);
    write_atomically(path, |out| {
        let headers: SmallVec<_> = parts.iter().map(|part| part.header.clone()).collect();
        exr::block::write(&mut *out, headers, true, |meta, chunks| {
            let mut blocks = enumerate_ordered_header_block_indices(&meta.headers);
            loop {
                let next: Vec<(usize, BlockIndex)> = blocks.by_ref().take(together).collect();
                if next.is_empty() {
                    return Ok(());
                }
                let encoded = next
                    .into_par_iter()
                    .map(|(place, index)| Ok((place, parts[index.layer].encoded(index, &meta.headers)?)));
                for (place, chunk) in encoded.collect::<ex::Result<Vec<_>>>()? {
                    chunks.write_chunk(place, chunk)?;
                }
            }
        })
        .map_err(|error| match error {
            ex::Error::Io(error) => error,
            error => io::Error::other(error.to_string()),
        })?;
        sort_headers(out)
    })
}

/// Puts the attributes of every header in alphabetical order.
///
/// The exr crate stores them in a hash map and writes them in an order that differs from run to run. The size of the
/// headers does not change, so nothing else in the file moves.
fn sort_headers(out: &mut BufWriter<&File>) -> io::Result<()> {
    out.flush()?;
    let mut file = *out.get_ref();
    file.seek(SeekFrom::Start(4))?;
    let mut input = BufReader::new(file);
    let mut flags = [0; 4];
    input.read_exact(&mut flags)?;
    let multipart = u32::from_le_bytes(flags) & 0x1000 != 0;
    let mut sorted = Vec::new();
    loop {
        let mut attributes = Vec::new();
        while let Some(attribute) = next_attribute(&mut input)? {
            attributes.push(attribute);
        }
        // An empty header ends the list in a multi-part file.
        let last = attributes.is_empty() || !multipart;
        attributes.sort();
        sorted.extend(attributes.into_iter().flatten());
        sorted.push(0);
        if last {
            break;
        }
    }
    drop(input);
    file.seek(SeekFrom::Start(8))?;
    file.write_all(&sorted)
}

/// The bytes of one attribute (name, type, size, value), or `None` at the end of a header.
fn next_attribute(input: &mut impl BufRead) -> io::Result<Option<Vec<u8>>> {
    let mut bytes = Vec::new();
    for _name_then_type in 0..2 {
        if input.read_until(0, &mut bytes)? == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        if bytes == [0] {
            return Ok(None);
        }
    }
    let mut size = [0; 4];
    input.read_exact(&mut size)?;
    bytes.extend_from_slice(&size);
    let start = bytes.len();
    bytes.resize(start + u32::from_le_bytes(size) as usize, 0);
    input.read_exact(&mut bytes[start..])?;
    Ok(Some(bytes))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::{channel_of, floats, read_parts};
    use super::*;

    /// The size of a file of two parts, which are read as they were written.
    fn written(values: &[f32], size: [usize; 2], encoding: Encoding) -> u64 {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("parts.exr");
        let samples: Vec<Complex32> = values.iter().map(|value| Complex32::new(0.0, *value)).collect();
        let part = |name: &str| {
            let channels = vec![
                ("re".to_owned(), Pixels::Held(values.to_vec())),
                ("Y".to_owned(), Pixels::Of(&samples, |sample| sample.im)),
            ];
            OutputPart::new(Some(name), size, channels, &[], encoding)
        };
        write_parts(&path, &[part("a"), part("b")]).unwrap();
        let read = read_parts(&path, 1 << 28, |_| 0).unwrap();
        assert_eq!(read.layer_data.len(), 2);
        let halves: Vec<f32> = values.iter().map(|value| f16::from_f32(*value).to_f32()).collect();
        for part in &read.layer_data {
            let channel = |name: &str| floats(&channel_of(part, name).unwrap().sample_data);
            assert!(channel("re") == values, "bit for bit");
            assert!(channel("Y") == if encoding.float16 { &halves } else { values }, "in 16 or 32 bits");
        }
        std::fs::metadata(&path).unwrap().len()
    }

    #[test]
    fn only_what_becomes_shorter_is_compressed() {
        let size = [61, 77];
        // Of a quadratic sequence, in which differences are as scattered as values.
        let noise: Vec<f32> = (0..61 * 77)
            .map(|i: u32| 0.5 + (f64::from(i * i) * 0.618_033_989).fract() as f32 / 2.0)
            .collect();
        let steps: Vec<f32> = (0..61 * 77).map(|i| (i / 610) as f32).collect();
        for float16 in [false, true] {
            let bytes = 2 * noise.len() as u64 * if float16 { 6 } else { 8 };
            for compression in [Compression::Zip, Compression::None] {
                let encoding = Encoding { float16, compression };
                let size_of_noise = written(&noise, size, encoding);
                // In half floats the exponents are most of a byte, and shorten even noise.
                let whole = (bytes..bytes + 5000).contains(&size_of_noise);
                assert!(whole || (float16 && compression == Compression::Zip), "{size_of_noise} of {bytes}");
                let size_of_steps = written(&steps, size, encoding);
                let short = size_of_steps < bytes / 10;
                assert_eq!(short, compression == Compression::Zip, "{size_of_steps} of {bytes}");
            }
        }
    }
}
