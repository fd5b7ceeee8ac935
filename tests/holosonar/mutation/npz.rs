//! Changes to the arrays of an npz, behind right checksums.

use crate::random::Random;
use std::io::{Cursor, Read, Write};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// Lengths, types and orders as headers may state them.
const SHAPES: [&str; 8] = [
    "()",
    "(0,)",
    "(1,)",
    "(3, 2)",
    "(2, 3, 4)",
    "(4294967296,)",
    "(18446744073709551615,)",
    "(1000000, 1000000, 1000000)",
];
const TYPES: [&str; 9] = ["<f4", "<f8", ">f8", "<c8", "<c16", "<i8", "|u1", "|O", "<U5"];

/// The longest array that is changed.
const LONGEST: u64 = 1 << 20;

/// One to three changes to arrays; `None` if this is no zip file of some.
pub(super) fn change(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let mut archive = ZipArchive::new(Cursor::new(bytes)).ok()?;
    let mut arrays = Vec::new();
    for i in 0..archive.len().min(40) {
        let entry = archive.by_index(i).ok()?;
        let name = entry.name().ok()?.into_owned();
        let mut array = Vec::new();
        entry.take(LONGEST).read_to_end(&mut array).ok()?;
        arrays.push((name, array));
    }
    for _ in 0..random.whole(1, 3) {
        let last = arrays.len().checked_sub(1)?;
        let (at, other) = (random.whole(0, last), random.whole(0, last));
        match random.whole(0, 6) {
            0 => drop(arrays.remove(at)),
            1 => {
                let array = arrays[other].1.clone();
                arrays[at].1 = array;
            }
            2 => {
                let array = arrays[at].1.clone();
                arrays.push((format!("{}.npy", random.whole(0, 9)), array));
            }
            3 => {
                let data = heading(&arrays[at].1)?;
                let damaged = super::damage(&arrays[at].1[data..], random);
                arrays[at].1.truncate(data);
                arrays[at].1.extend(damaged);
            }
            _ => arrays[at].1 = with_another_header(&arrays[at].1, random)?,
        }
    }
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, array) in arrays {
        let method =
            *random.one(&[CompressionMethod::Stored, CompressionMethod::Stored, CompressionMethod::Deflated]);
        zip.start_file(name, SimpleFileOptions::default().compression_method(method)).ok()?;
        zip.write_all(&array).ok()?;
    }
    Some(zip.finish().ok()?.into_inner())
}

/// Where an array's numbers begin.
fn heading(array: &[u8]) -> Option<usize> {
    let length = u16::from_le_bytes(array.get(8..10)?.try_into().ok()?);
    Some(10 + usize::from(length)).filter(|end| *end <= array.len())
}

/// The array with another type, shape, order or damage in its header, whose length is right.
fn with_another_header(array: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let data = heading(array)?;
    let text = String::from_utf8_lossy(&array[10..data]).into_owned();
    let value = |key: &str| {
        let begin = text.find(key)? + key.len();
        let end = begin + text[begin..].find(if key.contains("shape") { ')' } else { ',' })?;
        Some(if key.contains("shape") { begin..end + 1 } else { begin..end })
    };
    let mut changed = text.clone();
    match random.whole(0, 3) {
        0 => changed.replace_range(value("'descr': ")?, &format!("'{}'", random.one(&TYPES))),
        1 => changed.replace_range(value("'shape': ")?, random.one::<&str>(&SHAPES)),
        2 => changed.replace_range(value("'fortran_order': ")?, "True"),
        _ => changed = String::from_utf8_lossy(&super::retouch(changed.as_bytes(), random)).into_owned(),
    }
    let length = u16::try_from(changed.len()).ok()?;
    Some([&array[..8], &length.to_le_bytes(), changed.as_bytes(), &array[data..]].concat())
}
