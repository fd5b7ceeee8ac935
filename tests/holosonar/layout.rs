//! The code map of DESIGN section 6, held by reading the sources.

use std::fs;
use std::path::{Path, PathBuf};

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// Every source file with its module's name: the first part of its path below `src`.
fn modules() -> Vec<(String, PathBuf, String)> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    files.sort();
    files
        .into_iter()
        .map(|path| {
            let below = path.strip_prefix(&root).unwrap();
            let module = below.iter().next().unwrap().to_str().unwrap().trim_end_matches(".rs").to_owned();
            let text = fs::read_to_string(&path).unwrap();
            (module, path.clone(), text)
        })
        .collect()
}

/// The modules in the order of `lib.rs`.
fn order() -> Vec<String> {
    let lib = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/lib.rs")).unwrap();
    lib.lines()
        .filter_map(|line| line.strip_prefix("pub ").unwrap_or(line).strip_prefix("mod ")?.strip_suffix(';'))
        .map(str::to_owned)
        .collect()
}

/// The names that follow `crate::` anywhere in a file, comments and doc links aside.
fn imports(text: &str) -> Vec<String> {
    text.lines()
        .filter(|line| !line.trim_start().starts_with("//"))
        .flat_map(|line| line.split("crate::").skip(1).map(str::to_owned).collect::<Vec<_>>())
        .map(|rest| rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect())
        .collect()
}

#[test]
fn a_module_imports_only_from_modules_above_it() {
    let order = order();
    assert!(order.len() > 10, "lib.rs lists its modules in order: {order:?}");
    let place = |name: &str| order.iter().position(|m| m == name);
    let mut checked = 0;
    for (module, path, text) in modules() {
        if ["lib", "main", "build", "cli"].contains(&module.as_str()) {
            continue;
        }
        let Some(own) = place(&module) else {
            panic!("{} belongs to no module of lib.rs", path.display());
        };
        for import in imports(&text) {
            let Some(other) = place(&import) else { continue };
            checked += 1;
            assert!(other <= own, "{} imports `{import}`, which stands below `{module}`", path.display());
        }
    }
    assert!(checked > 50, "the test reads `use crate::` lines: {checked}");
}

#[test]
fn reconstruction_cannot_see_the_scene() {
    for (module, path, text) in modules() {
        if module == "reconstruct" || module == "depth" {
            for import in imports(&text) {
                assert!(
                    !["scene", "reflectors", "truth", "metrics"].contains(&import.as_str()),
                    "{} imports `{import}`: it could see the truth",
                    path.display()
                );
            }
        }
    }
}

#[test]
fn only_the_binary_prints() {
    for (module, path, text) in modules() {
        if !["main", "cli", "build"].contains(&module.as_str()) {
            for call in ["println!(", "eprintln!(", "print!(", "std::process::exit"] {
                assert!(!text.contains(call), "{} calls {call}", path.display());
            }
        }
    }
}

#[test]
fn unsafe_code_stands_in_one_file() {
    for (_, path, text) in modules() {
        if !path.ends_with("wave/simd.rs") {
            assert!(!text.contains("unsafe {") && !text.contains("allow(unsafe_code)"), "{}", path.display());
        }
    }
}
