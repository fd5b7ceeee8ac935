//! Changes to the attributes and chunks of an OpenEXR file of one part, whose table of offsets is put right.

use crate::random::Random;
use std::ops::Range;

/// Limits of something, as words of four bytes.
const WORDS: [u32; 10] = [0, 1, 2, 4, 255, 1 << 16, (1 << 31) - 1, 1 << 31, u32::MAX, 0x3f80_0000];

/// Counters of DWA chunks, sizes and offsets, as words of eight.
const COUNTERS: [u64; 6] = [0, 1, 1 << 20, 1 << 35, u64::MAX >> 1, u64::MAX];

/// Types of attributes.
const TYPES: [&str; 10] = [
    "box2i",
    "chlist",
    "compression",
    "lineOrder",
    "string",
    "stringvector",
    "tiledesc",
    "preview",
    "v2f",
    "unheard-of",
];

/// An attribute; offsets are those of the file.
struct Attribute {
    /// From the first byte of the name.
    begin: usize,
    kind: Range<usize>,
    value: Range<usize>,
}

/// One to three changes; `None` if the header is none.
pub(super) fn change(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let mut file = bytes.to_vec();
    for _ in 0..random.whole(1, 3) {
        let (attributes, table) = header(&file)?;
        let at = random.whole(0, attributes.len().checked_sub(1)?);
        let Attribute { begin, kind, value } = &attributes[at];
        let (whole, value) = (*begin..value.end, value.clone());
        match random.whole(0, 6) {
            0 => replace(&mut file, table, whole, &[]),
            1 => {
                let copy = file[whole.clone()].to_vec();
                replace(&mut file, table, whole.end..whole.end, &copy);
            }
            2 => replace(&mut file, table, kind.clone(), random.one(&TYPES).as_bytes()),
            3 => {
                let changed = super::damage(&file[value.clone()], random);
                let sized = [&(changed.len() as u32).to_le_bytes(), &*changed].concat();
                replace(&mut file, table, value.start - 4..value.end, &sized);
            }
            4 => overwrite(&mut file, value, &random.one(&WORDS).to_le_bytes(), random),
            5 => overwrite(&mut file, table..bytes.len(), &random.one(&COUNTERS).to_le_bytes(), random),
            _ => {
                // Chunks begin with coordinates, a size and, where compressed so, counters.
                let offset = file.get(table..table + 8)?.try_into().ok()?;
                let chunk = usize::try_from(u64::from_le_bytes(offset)).ok()?;
                let end = chunk.saturating_add(120).min(file.len());
                overwrite(&mut file, chunk.min(end)..end, &random.one(&COUNTERS).to_le_bytes(), random);
            }
        }
    }
    Some(file)
}

/// The attributes of the first header, and where the table of offsets begins.
fn header(file: &[u8]) -> Option<(Vec<Attribute>, usize)> {
    let word = |at: usize| Some(u32::from_le_bytes(file.get(at..at + 4)?.try_into().ok()?) as usize);
    let end_of_text = |at: usize| Some(at + file.get(at..)?.iter().take(256).position(|byte| *byte == 0)?);
    let (mut attributes, mut begin) = (Vec::new(), 8);
    while *file.get(begin)? != 0 {
        let kind = end_of_text(begin)? + 1;
        let kind = kind..end_of_text(kind)?;
        let value = kind.end + 5;
        let end = value.checked_add(word(value - 4)?).filter(|end| *end < file.len())?;
        attributes.push(Attribute { begin, kind, value: value..end });
        begin = end;
    }
    Some((attributes, begin + 1))
}

/// Replaces a range before the table of offsets, which all move.
fn replace(file: &mut Vec<u8>, table: usize, range: Range<usize>, with: &[u8]) {
    let moved = (with.len() as u64).wrapping_sub(range.len() as u64);
    let mut at = table;
    let mut end = file.len();
    while at + 8 <= end.min(file.len()) {
        let offset = u64::from_le_bytes(std::array::from_fn(|i| file[at + i]));
        // The first chunk follows the table.
        end = end.min(usize::try_from(offset).unwrap_or(end));
        file[at..at + 8].copy_from_slice(&offset.wrapping_add(moved).to_le_bytes());
        at += 8;
    }
    file.splice(range, with.iter().copied());
}

/// Writes a word somewhere in a range, at a multiple of its size from the range's beginning, if it fits.
fn overwrite(file: &mut [u8], range: Range<usize>, word: &[u8], random: &mut Random) {
    let Some(slots) =
        file.get(range.clone()).map(|slots| slots.len() / word.len()).filter(|slots| *slots > 0)
    else {
        return;
    };
    let at = range.start + word.len() * random.whole(0, slots - 1);
    file[at..at + word.len()].copy_from_slice(word);
}
