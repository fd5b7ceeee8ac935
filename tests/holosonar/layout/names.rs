//! No two types of one name, so that a name says which type is meant wherever it stands.

use super::{Source, sources};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The type that a line declares: a struct, an enum or a trait, outside functions and blocks.
fn declared(line: &str) -> Option<&str> {
    let line = line.strip_prefix("pub(").and_then(|rest| Some(rest.split_once(") ")?.1)).unwrap_or(line);
    let line = line.strip_prefix("pub ").unwrap_or(line);
    let rest = ["struct ", "enum ", "trait ", "union "].iter().find_map(|word| line.strip_prefix(word))?;
    rest.split(|c: char| !(c.is_alphanumeric() || c == '_')).next()
}

/// Names that more than one type has, each with the files that declare it.
fn shared(sources: &[Source]) -> Vec<String> {
    let mut files: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for source in sources {
        for name in source.text.lines().filter_map(declared) {
            files.entry(name).or_default().push(source.path.display().to_string());
        }
    }
    let shared = files.into_iter().filter(|(_, files)| files.len() > 1);
    shared.map(|(name, files)| format!("{name}: {}", files.join(", "))).collect()
}

#[test]
fn no_two_types_have_one_name() {
    let shared = shared(&sources());
    assert!(shared.is_empty(), "rename all but one:\n{}", shared.join("\n"));
}

#[test]
fn a_name_that_two_types_share_is_noticed() {
    let source = |name: &str, text: &str| Source::new(PathBuf::from(name), Path::new(name), text.to_owned());
    let a = source("a.rs", "pub(super) struct Plan<'a> {\n    x: &'a str,\n}\nstruct Planes;\n");
    let b = source("b.rs", "/// A struct Planes.\npub enum Plan {}\nfn f() {\n    struct Planes;\n}\n");
    assert_eq!(shared(&[a, b]), ["Plan: a.rs, b.rs"]);
}
