//! Changes to lines and their words: OBJ, MTL, CSV, run files, and headings of PLY, NRRD and VTI.

use crate::random::Random;

/// Numbers and words that mean something to one reader or another.
const WORDS: [&str; 26] = [
    "0",
    "-1",
    "1",
    "2",
    "3e38",
    "1e-320",
    "5e-324",
    "1e15",
    "-1e308",
    "1e309",
    "nan",
    "inf",
    "2147483648",
    "18446744073709551615",
    "true",
    "[]",
    "[0, 0, 0]",
    "{}",
    "\"\"",
    "list",
    "double",
    "end_header",
    "encoding: gzip",
    "\u{1b}]0;t\u{7}",
    "#",
    "/",
];

/// One to four changes to lines.
pub(super) fn change(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut lines: Vec<Vec<u8>> = bytes.split(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect();
    for _ in 0..random.whole(1, 4) {
        let (at, other) = (random.whole(0, lines.len() - 1), random.whole(0, lines.len() - 1));
        match random.whole(0, 6) {
            0 if lines.len() > 1 => drop(lines.remove(at)),
            1 => {
                let copies = random.whole(1, 60);
                let line = lines[other].clone();
                lines.splice(at..at, std::iter::repeat_n(line, copies));
            }
            2 => lines.swap(at, other),
            _ => lines[at] = with_another_word(&lines[at], random),
        }
    }
    lines.join(&b'\n')
}

/// The same for the first lines alone, before bytes that are no lines.
pub(super) fn change_heading(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let end = bytes.iter().position(|byte| !byte.is_ascii()).unwrap_or(bytes.len()).min(2000);
    let (heading, rest) = bytes.split_at(end);
    [change(heading, random), rest.to_vec()].concat()
}

/// The line with one word replaced, or one more.
fn with_another_word(line: &[u8], random: &mut Random) -> Vec<u8> {
    let is_between = |byte: u8| matches!(byte, b' ' | b',' | b'=' | b'/' | b'"' | b'[' | b']' | b'<' | b'>');
    let begins: Vec<usize> =
        (0..line.len()).filter(|&i| !is_between(line[i]) && (i == 0 || is_between(line[i - 1]))).collect();
    let word = random.one(&WORDS).as_bytes();
    if begins.is_empty() {
        return [line, word].concat();
    }
    let begin = *random.one(&begins);
    let end = begin + line[begin..].iter().position(|&byte| is_between(byte)).unwrap_or(line.len() - begin);
    let kept = if random.whole(0, 5) == 0 { begin } else { end };
    [&line[..begin], word, &line[kept..]].concat()
}
