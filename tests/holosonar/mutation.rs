//! Seeded damage to files, for the tests of parsers and for `tests/fuzz`: of bytes, and of what formats are made of, behind
//! lengths and checksums that are right.

// Paths, so that both crates find these files.
#[path = "mutation/exr.rs"]
mod exr;
#[path = "mutation/json.rs"]
mod json;
#[path = "mutation/lines.rs"]
mod lines;
#[path = "mutation/npz.rs"]
mod npz;
#[path = "mutation/wav.rs"]
mod wav;

use crate::random::Random;

/// What a file is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Structure {
    /// Lines of words.
    Lines,
    /// A JSON document.
    Json,
    /// Chunks, of which the first is a JSON document.
    Glb,
    /// A heading of lines, and bytes.
    Heading,
    /// A zip file of NumPy arrays.
    Npz,
    /// Attributes, a table of offsets, chunks.
    Exr,
    /// Chunks with their lengths.
    Wav,
}

/// A file in which something of its structure is changed, with lengths and checksums as they should be then; bytes are
/// changed where that cannot be.
pub(crate) fn restructure(bytes: &[u8], structure: Structure, random: &mut Random) -> Vec<u8> {
    let changed = match structure {
        Structure::Lines => Some(lines::change(bytes, random)),
        Structure::Heading => Some(lines::change_heading(bytes, random)),
        Structure::Json => json::change(bytes, random),
        Structure::Glb => json::change_glb(bytes, random),
        Structure::Npz => npz::change(bytes, random),
        Structure::Exr => exr::change(bytes, random),
        Structure::Wav => wav::change(bytes, random),
    };
    changed.unwrap_or_else(|| damage(bytes, random))
}

/// Text that means something to one reader or another.
const WORDS: [&[u8]; 12] = [
    b"nan",
    b"-1",
    b"1e999",
    b"4294967296",
    b"18446744073709551615",
    b"\"",
    b"[",
    b"{}",
    b"\0",
    b"\n",
    b"-0.0",
    b"99999999999999999999",
];

/// One to four changes: a flipped bit, a random byte, a word, a run removed or doubled, the end cut off.
pub(crate) fn damage(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut damaged = bytes.to_vec();
    for _ in 0..random.whole(1, 4) {
        if damaged.is_empty() {
            break;
        }
        let at = random.whole(0, damaged.len() - 1);
        let end = (at + random.whole(1, 40)).min(damaged.len());
        match random.whole(0, 5) {
            0 => damaged[at] ^= 1 << random.whole(0, 7),
            1 => damaged[at] = random.whole(0, 255) as u8,
            2 => {
                let word = WORDS[random.whole(0, WORDS.len() - 1)];
                let end = (at + random.whole(0, 4)).min(damaged.len());
                damaged.splice(at..end, word.iter().copied());
            }
            3 => drop(damaged.drain(at..end)),
            4 => {
                let run = damaged[at..end].to_vec();
                damaged.splice(at..at, run);
            }
            _ => damaged.truncate(at),
        }
    }
    damaged
}

/// Up to three other digits in a text, so that its form stays and its numbers go wild; up to three other bytes in
/// anything else.
pub(crate) fn retouch(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut retouched = bytes.to_vec();
    let is_text = std::str::from_utf8(bytes).is_ok();
    let places: Vec<usize> = (0..bytes.len()).filter(|&i| !is_text || bytes[i].is_ascii_digit()).collect();
    for _ in 0..random.whole(1, 3).min(places.len()) {
        let at = places[random.whole(0, places.len() - 1)];
        retouched[at] = if is_text { b'0' + random.whole(0, 9) as u8 } else { random.whole(0, 255) as u8 };
    }
    retouched
}
