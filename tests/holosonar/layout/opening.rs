//! Files are opened in one place, where pipes are refused and outputs are kept off inputs.

use super::{Source, sources};
use std::path::PathBuf;

/// Ways to open or replace a file that bypass `open_input` and `write_atomically`.
const BYPASSES: [&str; 8] = [
    "File::open(",
    "File::create(",
    "File::options(",
    "OpenOptions::new(",
    "fs::read(",
    "fs::read_to_string(",
    "fs::write(",
    "fs::copy(",
];

/// Where that is done: the place itself, checkpoints, which have rules of their own, and the system's own files.
const PLACES: [&[&str]; 3] = [&["files"], &["checkpoint"], &["plan", "memory"]];

/// Lines of the program, not of its tests, that open a file elsewhere.
fn bypasses(sources: &[Source]) -> Vec<String> {
    let mut found = Vec::new();
    for source in sources {
        let names: Vec<&str> = source.module.iter().map(String::as_str).collect();
        let is_test = names.iter().any(|name| *name == "tests" || name.ends_with("_tests"));
        if is_test || source.room() == "build" || PLACES.iter().any(|place| names.starts_with(place)) {
            continue;
        }
        let code = source.text.split("#[cfg(test)]\n#[allow").next().unwrap_or_default();
        let code = code.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
        for (number, line) in (1..).zip(code.lines()).filter(|(_, line)| !line.trim_start().starts_with("//"))
        {
            let opens = BYPASSES.iter().any(|bypass| {
                let before = line.split(bypass).next().unwrap_or_default();
                // Not `CubeFile::open(`.
                before.len() < line.len() && !before.ends_with(|c: char| c.is_alphanumeric() || c == '_')
            });
            if opens {
                found.push(format!("{}:{number}: {}", source.path.display(), line.trim()));
            }
        }
    }
    found
}

#[test]
fn inputs_are_opened_in_one_place() {
    let found = bypasses(&sources());
    assert!(found.is_empty(), "open inputs with `open_input`:\n{}", found.join("\n"));
}

#[test]
fn another_way_to_open_a_file_is_noticed() {
    let of = |file: &str, text: &str| {
        let path = PathBuf::from(file);
        bypasses(&[Source::new(path.clone(), &path, text.to_owned())]).len()
    };
    assert_eq!(
        of("scene/obj.rs", "let text = std::fs::read_to_string(path)?;\nlet file = File::open(path)?;"),
        2
    );
    assert_eq!(of("scene/obj.rs", "let cube = CubeFile::open(path)?;\n// File::open(path)"), 0);
    assert_eq!(of("scene/obj.rs", "use x;\n#[cfg(test)]\nmod tests {\n    fs::write(a, b);\n}"), 0);
    assert_eq!(of("files/input.rs", "File::options()") + of("scene/obj/tests.rs", "fs::write(a, b)"), 0);
}
