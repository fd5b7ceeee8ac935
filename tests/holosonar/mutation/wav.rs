//! Changes to the chunks of a WAV file, behind right lengths.

use crate::random::Random;

/// Numbers that formats and lengths may hold.
const NUMBERS: [u32; 10] = [0, 1, 2, 3, 8, 24, 0xfffe, 0xffff, 0x7fff_ffff, u32::MAX];

/// One to three changes to chunks; `None` if this is no WAV file.
pub(super) fn change(bytes: &[u8], random: &mut Random) -> Option<Vec<u8>> {
    let mut rest = bytes.strip_prefix(b"RIFF")?.get(8..)?;
    let mut chunks: Vec<(Vec<u8>, Vec<u8>)> = Vec::new();
    while rest.len() >= 8 && chunks.len() < 40 {
        let (name, after) = rest.split_at(4);
        let length = u32::from_le_bytes(after[..4].try_into().ok()?) as usize;
        let (content, after) = after[4..].split_at(length.min(after.len() - 4));
        chunks.push((name.to_vec(), content.to_vec()));
        rest = after.get(length % 2..).unwrap_or_default();
    }
    for _ in 0..random.whole(1, 3) {
        let last = chunks.len().checked_sub(1)?;
        let (at, other) = (random.whole(0, last), random.whole(0, last));
        match random.whole(0, 6) {
            0 => drop(chunks.remove(at)),
            1 => chunks.swap(at, other),
            2 => chunks.insert(at, (b"LIST".to_vec(), vec![7; random.whole(0, 9)])),
            3 => chunks.insert(at, chunks[other].clone()),
            4 => {
                let keep = random.whole(0, chunks[at].1.len());
                chunks[at].1.truncate(keep);
            }
            // The numbers of a format are at its beginning, and mean something.
            _ => {
                let content = &mut chunks[at].1;
                let place = 2 * random.whole(0, 19);
                let number = NUMBERS[random.whole(0, NUMBERS.len() - 1)].to_le_bytes();
                let width = 2 * random.whole(1, 2);
                if let Some(field) = content.get_mut(place..place + width) {
                    field.copy_from_slice(&number[..width]);
                }
            }
        }
    }
    let mut body = b"WAVE".to_vec();
    for (name, content) in chunks {
        body.extend([&name, &(content.len() as u32).to_le_bytes()[..], &content].concat());
        body.extend(vec![0; content.len() % 2]);
    }
    Some([b"RIFF", &(body.len() as u32).to_le_bytes()[..], &body].concat())
}
