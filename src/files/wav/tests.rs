#![allow(clippy::unwrap_used)]

use super::*;
use crate::named::assert_names;
use std::fs;

const NUMBERS: [f32; 6] = [0.5, -1.0, 0.25, 0.125, -0.375, 0.0];

fn written(format: WavFormat) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.wav");
    write_wav(&path, (2, 48_000, format), |put| {
        put(&NUMBERS[..2])?;
        put(&NUMBERS[2..])
    })
    .unwrap();
    (folder, path)
}

#[test]
fn every_format_is_read_as_it_was_written() {
    for &format in WavFormat::ALL {
        let (_folder, path) = written(format);
        let mut file = WavFile::open(&path).unwrap();
        assert_eq!((file.channels(), file.frames(), file.sample_rate()), (2, 3, 48_000.0), "{format}");
        assert_eq!(file.read(0, 3).unwrap(), NUMBERS, "{format}");
        assert_eq!(file.read(1, 1).unwrap(), NUMBERS[2..4], "{format}");
        assert!(file.read(3, 0).unwrap().is_empty());
        assert!(file.described().contains("48000 Hz"), "{}", file.described());
    }
}

#[test]
fn chunks_before_the_samples_are_passed_over_also_of_odd_lengths() {
    let (_folder, path) = written(WavFormat::Int16);
    let bytes = fs::read(&path).unwrap();
    let odd = [&bytes[..12], b"iXML\x03\0\0\0<a>\0", &bytes[12..]].concat();
    fs::write(&path, odd).unwrap();
    assert_eq!(WavFile::open(&path).unwrap().read(0, 3).unwrap(), NUMBERS);
}

#[test]
fn what_is_no_complete_recording_is_refused() {
    let (_folder, path) = written(WavFormat::Int16);
    let bytes = fs::read(&path).unwrap();
    let data = bytes.len() - 12 - 8;
    let with = |at: usize, new: &[u8]| [&bytes[..at], new, &bytes[at + new.len()..]].concat();
    for (content, parts) in [
        (bytes[..bytes.len() - 1].to_vec(), &["12 bytes", "11", "cut off"][..]),
        (bytes[..30].to_vec(), &["ends within"]),
        (bytes[..data].to_vec(), &["ends before"]),
        (with(data + 4, &[0; 4]), &["no samples"]),
        (with(data + 4, &[0xff; 4]), &["4294967295", "save it again"]),
        (with(data + 4, &[10, 0, 0, 0]), &["10 bytes", "multiple of 4"]),
        (with(0, b"RF64"), &["RF64", "4 GiB"]),
        (with(0, b"fLaC"), &["FLAC"]),
        (with(20, &[2]), &["compressed"]),
        (with(22, &[0]), &["zero channels"]),
        (b"hello".to_vec(), &["no WAV file"]),
    ] {
        fs::write(&path, content).unwrap();
        let error = WavFile::open(&path).unwrap_err();
        assert_eq!(error.exit_status(), 2);
        assert_names(error.to_string(), parts);
    }
    let (_folder, path) = written(WavFormat::Float32);
    let mut bytes = fs::read(&path).unwrap();
    let end = bytes.len();
    bytes[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    fs::write(&path, bytes).unwrap();
    let error = WavFile::open(&path).unwrap().read(0, 3).unwrap_err();
    assert_names(error.to_string(), &["not finite", "channel 1", "frame 2"]);
}

#[test]
fn more_than_32_bits_of_length_are_refused() {
    assert_eq!(check_wav_size("a.wav", 1 << 20, 8, WavFormat::Int24).unwrap(), 24 << 20);
    let error = check_wav_size("a.wav", 1 << 30, 2, WavFormat::Int16).unwrap_err();
    assert_names(error.to_string(), &["a.wav", "4.0 GiB", "2 channels"]);
    assert!(check_wav_size("a.wav", 1, 70_000, WavFormat::Int16).is_err());
    assert!(check_wav_size("a.wav", u64::MAX, 70_000, WavFormat::Int16).is_err());
}
