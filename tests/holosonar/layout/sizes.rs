//! Files that can be read in one go, and folders that hold one idea.

use super::{Source, root, sources};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Most lines of a source file.
const LINES: usize = 400;

/// Most entries of a folder; `a.rs` and the folder `a` are one.
const ENTRIES: usize = 14;

/// Files that are too long, each with its length.
fn long(sources: &[Source]) -> Vec<String> {
    let lengths = sources.iter().map(|source| (source, source.text.lines().count()));
    lengths
        .filter(|(_, n)| *n > LINES)
        .map(|(source, n)| format!("{}: {n} lines", source.path.display()))
        .collect()
}

/// Folders below `folder` that hold too much. `folder` itself is the list of rooms, as long as that of `lib.rs`.
fn crowded(folder: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = below(folder);
    while let Some(folder) = folders.pop() {
        // Not what Python and a build leave there.
        let is_made =
            |path: &PathBuf| path.ends_with("__pycache__") || path.extension().is_some_and(|e| e == "so");
        let entries = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path());
        let names = entries.filter(|path| !is_made(path)).map(|path| path.with_extension(""));
        let count = names.collect::<BTreeSet<_>>().len();
        if count > ENTRIES {
            found.push(format!("{}: {count} entries", folder.display()));
        }
        folders.extend(below(&folder));
    }
    found
}

fn below(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.filter(|path| path.is_dir()).collect()
}

#[test]
fn files_are_short_and_folders_hold_little() {
    let long = long(&sources());
    assert!(long.is_empty(), "more than {LINES} lines:\n{}", long.join("\n"));
    let crowded = crowded(&root().join("src"));
    assert!(crowded.is_empty(), "more than {ENTRIES} entries:\n{}", crowded.join("\n"));
}

#[test]
fn a_long_file_and_a_full_folder_are_noticed() {
    let of = |lines: usize| Source::new(PathBuf::from("a.rs"), Path::new("a.rs"), "x\n".repeat(lines));
    assert_eq!(long(&[of(LINES), of(LINES + 1)]), [format!("a.rs: {} lines", LINES + 1)]);
    let folder = tempfile::tempdir().unwrap();
    let room = folder.path().join("room/inner");
    fs::create_dir_all(room.join("a0")).unwrap();
    for i in 0..ENTRIES {
        fs::write(room.join(format!("a{i}.rs")), "").unwrap();
        fs::write(folder.path().join(format!("b{i}.rs")), "").unwrap();
    }
    assert_eq!(crowded(folder.path()), Vec::<String>::new());
    fs::write(room.join("more.css"), "").unwrap();
    assert_eq!(crowded(folder.path()), [format!("{}: {} entries", room.display(), ENTRIES + 1)]);
}
