//! Nothing in the repository refers to a document that is not in it.

use super::root;
use crate::binary::files_below;
use std::fs;

/// Working papers of this project that its readers do not have. In halves, so that this list is none of their mentions.
const ELSEWHERE: [&str; 7] = [
    concat!("DES", "IGN"),
    concat!("PHYS", "ICS"),
    concat!("ENG", "INE"),
    concat!("TAB", "LE1"),
    concat!("PIT", "FALLS"),
    concat!("STY", "LE"),
    concat!("USE", "RS"),
];

/// Lines that refer to a document that is not here, with their numbers. Of Rust the comments count, for a constant may have such a
/// name, and what reads as a reference: `NAME.md`, `NAME section`, `NAME Q1`.
fn citations(is_rust: bool, text: &str) -> Vec<(usize, &str)> {
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let cites = |line: &&str| {
        let comment = if is_rust { line.find("//").unwrap_or(line.len()) } else { 0 };
        ELSEWHERE.iter().any(|name| {
            line.match_indices(name).any(|(at, _)| {
                let (before, after) = (&line[..at], &line[at + name.len()..]);
                let question = after
                    .strip_prefix(" Q")
                    .is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit()));
                let reference = after.starts_with(".md") || after.starts_with(" section") || question;
                !before.ends_with(is_word)
                    && !after.starts_with(is_word)
                    && (at > comment || !is_rust || reference)
            })
        })
    };
    text.lines().enumerate().filter(|(_, line)| cites(line)).map(|(i, line)| (i + 1, line)).collect()
}

#[test]
fn no_line_refers_to_a_document_that_is_not_here() {
    let folders = ["src", "tests", "benches", "scenes", ".ci"];
    let alone = ["README.md", "CHANGELOG.md", "Cargo.toml", ".gitignore"];
    let mut found = Vec::new();
    let mut read = 0;
    for path in folders
        .iter()
        .flat_map(|name| files_below(&root().join(name)))
        .chain(alone.iter().map(|name| root().join(name)))
    {
        // Binary files are no text.
        let Ok(text) = fs::read_to_string(&path) else { continue };
        read += 1;
        let is_rust = path.extension().is_some_and(|e| e == "rs");
        let place = path.strip_prefix(root()).unwrap().display();
        found.extend(
            citations(is_rust, &text).iter().map(|(line, text)| format!("{place}:{line}: {}", text.trim())),
        );
    }
    assert!(read > 200, "the test reads files: {read}");
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn references_are_told_from_names() {
    let [design, physics, .., style, users] = ELSEWHERE;
    for text in [
        format!("/// As {physics} Q6 says."),
        format!("let a = 1; // {design} section 3"),
        format!("//! ({design}: 1 environment, 2 request)"),
        format!("/// {physics}' `cad`: a sphere"),
        format!("println!(\"see {users}.md\");"),
        format!("bail!(\"see {design} section 4\");"),
    ] {
        assert_eq!(citations(true, &text), [(1, text.as_str())]);
    }
    let readme = format!("one\nas in {style}\n");
    assert_eq!(citations(false, &readme).len(), 1);
    for text in [
        format!("const {style}: &str = include_str!(\"page/style.css\"); // the page's"),
        format!("// MY_{style} and {design}S"),
        "/// The design, the physics and the style of users.".to_owned(),
    ] {
        assert_eq!(citations(true, &text), [], "{text}");
    }
}
