//! Rules for the sources, checked by reading them: imports follow the order of the modules, only the binary prints, `unsafe`
//! is in two files, inputs are opened in one place, files are short, and nothing refers to documents that a reader does not
//! have.

mod citations;
mod names;
mod opening;
mod paths;
mod sizes;

use crate::binary::files_below;
use std::fs;
use std::path::{Path, PathBuf};

/// A source file: its path, its module from the crate's root and its text.
struct Source {
    path: PathBuf,
    module: Vec<String>,
    text: String,
}

impl Source {
    fn new(path: PathBuf, below: &Path, text: String) -> Self {
        let module = below.with_extension("").iter().map(|part| part.to_str().unwrap().to_owned()).collect();
        Self { path, module, text }
    }

    /// The module of `lib.rs` that it belongs to.
    fn room(&self) -> &str {
        &self.module[0]
    }

    /// What it names within the crate, as paths from the root.
    fn paths(&self) -> Vec<Vec<String>> {
        paths::paths(&self.text, &self.module.iter().map(String::as_str).collect::<Vec<_>>())
    }
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Every source file of the library and the binary.
fn sources() -> Vec<Source> {
    let src = root().join("src");
    let rust = files_below(&src).into_iter().filter(|path| path.extension().is_some_and(|e| e == "rs"));
    rust.map(|path| {
        let text = fs::read_to_string(&path).unwrap();
        Source::new(path.clone(), path.strip_prefix(&src).unwrap(), text)
    })
    .collect()
}

/// The modules in the order of `lib.rs`.
fn order() -> Vec<String> {
    let lib = fs::read_to_string(root().join("src/lib.rs")).unwrap();
    let names = |line: &str| {
        Some(line.strip_prefix("pub ").unwrap_or(line).strip_prefix("mod ")?.strip_suffix(';')?.to_owned())
    };
    lib.lines().filter_map(names).filter(|name| !FOR_TESTS.contains(&name.as_str())).collect()
}

/// Modules of `lib.rs` that unit tests alone see.
const FOR_TESTS: [&str; 1] = ["named"];

/// Files that belong to no module of the library: its list of modules, the binary and the build script.
const BINARY: [&str; 3] = ["lib", "main", "build"];

/// Imports against the order, one line each, and how many imports were looked at.
fn strange_imports(sources: &[Source], order: &[String]) -> (Vec<String>, usize) {
    let place = |name: &str| order.iter().position(|module| module == name);
    let (mut strange, mut checked) = (Vec::new(), 0);
    for source in sources.iter().filter(|source| !BINARY.contains(&source.room())) {
        let path = source.path.display();
        let Some(own) = place(source.room()) else {
            strange.push(format!("{path} belongs to no module of lib.rs"));
            continue;
        };
        for import in source.paths() {
            // The root itself, as in `pub(crate)` or `use crate as ...`.
            let Some(name) = import.first() else { continue };
            checked += 1;
            match place(name) {
                Some(other) if other <= own => {}
                Some(_) => strange.push(format!(
                    "{path} imports `{}`, which is below `{}`",
                    import.join("::"),
                    source.room()
                )),
                None if FOR_TESTS.contains(&name.as_str()) => {}
                None => strange
                    .push(format!("{path} imports `{}`, which is no module of lib.rs", import.join("::"))),
            }
        }
    }
    (strange, checked)
}

#[test]
fn a_module_imports_only_from_modules_above_it() {
    let order = order();
    assert!(order.len() > 10, "lib.rs lists its modules in order: {order:?}");
    let (strange, checked) = strange_imports(&sources(), &order);
    assert!(strange.is_empty(), "{}", strange.join("\n"));
    assert!(checked > 500, "the test reads paths: {checked}");
}

#[test]
fn imports_against_the_order_are_noticed_in_every_form() {
    let order = ["error", "wave", "scene", "plan", "pipeline"].map(str::to_owned);
    let strange = |file: &str, text: &str| {
        let source = Source::new(PathBuf::from(file), Path::new(file), text.to_owned());
        strange_imports(&[source], &order).0
    };
    for (file, text) in [
        ("wave.rs", "use crate::pipeline::image;"),
        ("wave.rs", "use crate::{error::{Error, Result}, pipeline};"),
        ("wave.rs", "pub(crate) use crate::{\n    error::Result,\n    scene::{\n        Scene,\n    },\n};"),
        ("wave/simd.rs", "use super::super::plan::Plan;"),
        ("wave/simd.rs", "mod tests {\n    use super::super::super::{error::Result, plan::Plan};\n}"),
        ("wave/simd.rs", "fn f() -> crate::scene::Scene { g!(1) }"),
        ("wave.rs", "use crate::*;"),
        ("wave.rs", "use super::*;"),
        ("wave.rs", "use crate::Scene;"),
        ("wave.rs", "use super::super::Scene;"),
        ("stray.rs", ""),
    ] {
        assert_eq!(strange(file, text).len(), 1, "{file}: {text}: {:?}", strange(file, text));
    }
    let fine = "use crate::{error, wave::{simd::{self, Level}, Geometry}};\nuse super::material;\n// use crate::plan;\n\
                mod tests {\n    use super::*;\n    use crate::named::assert_names;\n}";
    assert_eq!(strange("scene/obj.rs", fine), Vec::<String>::new());
}

#[test]
fn reconstruction_cannot_see_the_scene() {
    let hidden = ["scene", "reflectors", "truth", "metrics"];
    let blind = sources().into_iter().filter(|source| ["reconstruct", "depth"].contains(&source.room()));
    let mut checked = 0;
    for source in blind {
        for import in source.paths() {
            checked += 1;
            let seen = import.first().is_some_and(|name| hidden.contains(&name.as_str()));
            assert!(
                !seen,
                "{} imports `{}`: it could see the truth",
                source.path.display(),
                import.join("::")
            );
        }
    }
    assert!(checked > 100, "{checked}");
}

#[test]
fn only_the_binary_prints() {
    for source in sources().iter().filter(|source| !["main", "cli", "build"].contains(&source.room())) {
        for call in ["println!(", "eprintln!(", "print!(", "std::process::exit"] {
            assert!(!source.text.contains(call), "{} calls {call}", source.path.display());
        }
    }
}

/// Blocks of `unsafe` code; the guide's chapter on security says so, too.
const UNSAFE_BLOCKS: usize = 6;

#[test]
fn unsafe_code_is_six_blocks_in_two_files() {
    let ours = ["wave/simd.rs", "wave/simd/transpose.rs"];
    let is_ours = |source: &Source| ours.iter().any(|file| source.path.ends_with(file));
    let (ours, others): (Vec<_>, Vec<_>) = sources().into_iter().partition(is_ours);
    for source in others {
        let is_unsafe = source.text.contains("unsafe {") || source.text.contains("allow(unsafe_code)");
        assert!(!is_unsafe, "{}", source.path.display());
    }
    assert_eq!(
        ours.iter().map(|source| source.text.matches("unsafe {").count()).sum::<usize>(),
        UNSAFE_BLOCKS
    );
}
