//! What reading a PLY file will take, by its header.

use std::path::Path;

use glam::DVec3;

use super::super::needs::{Glimpse, MeshNeeds};
use crate::files::ply::{Element, Format, Header};

/// Bytes at the beginning of a file that hold its header, and at the end of a text that say how its faces are.
const START: u64 = 1 << 16;

/// Counts the rows that the header declares, as far as the file can hold them. How many corners binary faces have follows from
/// their bytes; of a text it is taken from the last ones.
pub(in super::super) fn needs(glimpse: &mut Glimpse) -> Option<MeshNeeds> {
    let start = glimpse.bytes(0, START);
    let (header, length) = Header::read(&start, Path::new("")).ok()?;
    let mut left = glimpse.length - length.bytes as u64;
    let (mut rows, mut corners, mut vertices) = (0, 0, 0);
    for (i, element) in header.elements.iter().enumerate() {
        let least = element.least_row(header.format).max(1);
        let count = element.count.min(left / least);
        let bytes = match element.corners() {
            None => count * least,
            Some(list) => {
                // What the later elements take at least is not theirs.
                let later = header.elements[i + 1..].iter();
                let later: u64 = later.map(|e| e.count.saturating_mul(e.least_row(header.format))).sum();
                let bytes = left.saturating_sub(later);
                let in_lists = match header.format {
                    Format::Ascii => (count as f64 * corners_at_the_end(glimpse, element)) as u64,
                    _ => bytes.saturating_sub(count * least) / list.scalar.size() as u64,
                };
                corners += in_lists;
                rows += count;
                bytes
            }
        };
        if element.name == "vertex" {
            vertices += count;
        }
        left = left.saturating_sub(bytes);
    }
    let reading = glimpse.length + vertices * size_of::<DVec3>() as u64 + 8 * (rows + corners);
    let triangles = corners.saturating_sub(2 * rows);
    Some(MeshNeeds { triangles, counted: header.format != Format::Ascii, reading, ..MeshNeeds::default() })
}

/// Corners of a face of a text on average, as its last lines have them: 3 where they do not say.
fn corners_at_the_end(glimpse: &mut Glimpse, element: &Element) -> f64 {
    let end = glimpse.bytes(glimpse.length.saturating_sub(START), START);
    let before = element.properties.iter().take_while(|p| p.count.is_none()).count();
    let count = |line: &[u8]| -> Option<f64> {
        let words: Vec<&str> = std::str::from_utf8(line).ok()?.split_ascii_whitespace().collect();
        let count: usize = words.get(before)?.parse().ok()?;
        (words.len() > before + count && count >= 3).then_some(count as f64)
    };
    let counts: Vec<f64> = end.split(|&byte| byte == b'\n').skip(1).filter_map(count).collect();
    if counts.is_empty() { 3.0 } else { counts.iter().sum::<f64>() / counts.len() as f64 }
}
