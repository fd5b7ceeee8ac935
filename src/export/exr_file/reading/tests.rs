#![allow(clippy::unwrap_used)]

use super::*;
use crate::export::depth_exr::read_depth_map;
use crate::named::assert_names;

/// The bytes of an attribute.
fn attribute(name: &str, kind: &str, value: &[u8]) -> Vec<u8> {
    let size = (value.len() as u32).to_le_bytes();
    [name.as_bytes(), &[0], kind.as_bytes(), &[0], &size, value].concat()
}

fn integers(values: &[i32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// A file of one part of 4 x 4 pixels with a channel `Z` of floats, these attributes more, and no pixels.
fn file_with(tiled: bool, more: &[Vec<u8>]) -> Vec<u8> {
    let flags: u32 = if tiled { 0x202 } else { 2 };
    let channel = [b"Z\0".as_slice(), &integers(&[2]), &[0; 4], &integers(&[1, 1]), &[0]].concat();
    let window = integers(&[0, 0, 3, 3]);
    let one = 1.0_f32.to_le_bytes();
    [
        &[0x76, 0x2f, 0x31, 0x01],
        flags.to_le_bytes().as_slice(),
        &attribute("channels", "chlist", &channel),
        &attribute("compression", "compression", &[0]),
        &attribute("dataWindow", "box2i", &window),
        &attribute("displayWindow", "box2i", &window),
        &attribute("lineOrder", "lineOrder", &[0]),
        &attribute("pixelAspectRatio", "float", &one),
        &attribute("screenWindowCenter", "v2f", &[0; 8]),
        &attribute("screenWindowWidth", "float", &one),
        &more.concat(),
        &[0],
    ]
    .concat()
}

fn refusal(bytes: &[u8], limit: u64) -> String {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    let error = read_depth_map(file.path(), limit).unwrap_err();
    assert_eq!(error.exit_status(), 2, "{error}");
    error.to_string()
}

#[test]
fn attributes_are_counted_before_they_are_parsed() {
    // 100 000 attributes of ten bytes each, which the parser turns into some hundred megabytes.
    let many: Vec<_> = (0..100_000).map(|i| attribute(&format!("{i:x}"), "x", &[])).collect();
    let bytes = file_with(false, &many);
    assert!(bytes.len() < 1 << 21);
    assert_names(refusal(&bytes, 32 << 20), &["headers", "33554432", "--memory"]);
    // A list of texts becomes structures, too; what is cut off does not count.
    let texts = file_with(false, &[attribute("a", "stringvector", &vec![0; 1 << 20])]);
    assert_names(refusal(&texts, 32 << 20), &["headers", "33554432"]);
    let cut = &file_with(false, &[attribute("a", "x", &vec![0; 1 << 20])])[..400];
    assert_names(refusal(cut, 32 << 20), &["not a readable EXR"]);
}

#[test]
fn a_tile_larger_than_the_limit_is_refused() {
    let tiles = |size: i32| attribute("tiles", "tiledesc", &[integers(&[size, size]), vec![0]].concat());
    assert_names(refusal(&file_with(true, &[tiles(1 << 29)]), 100 << 20), &["blocks", "104857600"]);
    // Here the pixels are missing, but nothing is too large.
    assert_names(refusal(&file_with(true, &[tiles(64)]), 100 << 20), &["not a readable EXR"]);
}

#[test]
fn a_part_of_absurdly_many_channels_is_refused() {
    let channel = |i: usize| {
        let name = format!("{i:06}\0");
        [name.as_bytes(), &integers(&[2]), &[0; 4], &integers(&[1, 1])].concat()
    };
    let list: Vec<u8> = (0..5000).flat_map(channel).chain([0]).collect();
    let bytes = file_with(false, &[attribute("channels", "chlist", &list)]);
    assert_names(refusal(&bytes, 1 << 30), &["5000 channels", "4096"]);
}

#[test]
fn what_is_made_of_the_pixels_counts() {
    let file = tempfile::NamedTempFile::new().unwrap();
    // Wide half floats: the map takes many times their bytes.
    let samples = vec![ex::f16::from_f32(2.0); 1 << 18];
    let channel = ex::AnyChannel::new("Z", ex::FlatSamples::F16(samples));
    let layer = ex::Layer::new(
        (1 << 9, 1 << 9),
        ex::LayerAttributes::named("render"),
        ex::Encoding::FAST_LOSSLESS,
        ex::AnyChannels::sort([channel].into_iter().collect()),
    );
    ex::Image::from_layer(layer).write().to_file(file.path()).unwrap();
    assert_eq!(read_depth_map(file.path(), 16 << 20).unwrap().map.accepted(), 1 << 18);
    assert!(read_depth_map(file.path(), 4 << 20).is_err(), "512 KiB of half floats become megabytes");
}

/// A depth map of another program in one chunk of DWA compression.
fn dwa() -> Vec<u8> {
    let mut bytes = io::Cursor::new(Vec::new());
    let channels = ["R", "Z"].map(|name| {
        let samples = (0..32 * 32).map(|i| 2.0 + (i % 32) as f32 * 0.01).collect();
        ex::AnyChannel::new(name, ex::FlatSamples::F32(samples))
    });
    let encoding = ex::Encoding {
        compression: ex::Compression::DWAA(None),
        blocks: ex::Blocks::ScanLines,
        line_order: ex::LineOrder::Increasing,
    };
    let channels = ex::AnyChannels::sort(channels.into_iter().collect());
    let layer = ex::Layer::new((32, 32), ex::LayerAttributes::named("render"), encoding, channels);
    ex::Image::from_layer(layer).write().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

#[test]
fn counters_of_dwa_chunks_are_checked() {
    let bytes = dwa();
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), &bytes).unwrap();
    let depth = read_depth_map(file.path(), 1 << 24).unwrap().map.picked.depth;
    assert!((0..32).all(|i| depth[32 * i + 5] == 2.0 + 5.0 * 0.01), "depths are stored exactly");
    // The only offset leads to the chunk behind it, which begins with its line and its size.
    let at = |start: usize| u64::from_le_bytes(bytes[start..start + 8].try_into().unwrap());
    let chunk = 8 + (0..bytes.len() - 8).find(|&i| at(i) == i as u64 + 8).unwrap();
    for counter in [1, 6, 7, 8, 9] {
        let mut damaged = bytes.clone();
        let place = chunk + 8 + 8 * counter;
        damaged[place..place + 8].copy_from_slice(&55_834_574_852_u64.to_le_bytes());
        assert_names(refusal(&damaged, 1 << 24), &["DWA", "ZIP"]);
    }
}
