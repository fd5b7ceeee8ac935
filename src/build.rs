//! Puts the commit into `holosonar --version`, and the guide's picture into its documentation.

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use std::path::Path;
use std::process::Command;
use std::{env, fs};

/// The picture that a chapter of the guide refers to.
const PICTURE: &str = "scenes/pictures/multipath.png";

fn main() {
    embed_picture();
    let git = |args: &[&str]| {
        let output = Command::new("git").args(args).output().ok()?;
        let text = String::from_utf8(output.stdout).ok()?;
        (output.status.success() && !text.trim().is_empty()).then(|| text.trim().to_owned())
    };
    // A source archive has no repository; its version number is all it can say.
    let commit = git(&["rev-parse", "--short=10", "HEAD"]);
    println!("cargo::rustc-env=HOLOSONAR_COMMIT={}", commit.as_deref().unwrap_or("unknown"));
    println!("cargo::rerun-if-changed=src/build.rs");
    if let Some(head) = git(&["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo::rerun-if-changed={head}");
    }
}

/// Writes a definition of the reference `[multipath]` whose target is the picture itself: documentation has no files beside it.
fn embed_picture() {
    println!("cargo::rerun-if-changed={PICTURE}");
    let folder = |name: &str| env::var_os(name).expect("cargo sets it for build scripts");
    let picture =
        fs::read(Path::new(&folder("CARGO_MANIFEST_DIR")).join(PICTURE)).expect("the guide's picture");
    let definition = format!("[multipath]: data:image/png;base64,{}\n\n", BASE64_STANDARD.encode(picture));
    fs::write(Path::new(&folder("OUT_DIR")).join("multipath.md"), definition)
        .expect("room for the guide's picture");
}
