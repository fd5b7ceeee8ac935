//! Loads scenes from files that a test writes.
#![allow(clippy::unwrap_used)]

use super::{LoadOptions, Scene};
use crate::error::Result;
use crate::named::Warnings;

/// Writes files into a folder and loads the last of them; returns the scene and the warnings.
pub(super) fn load_files<B: AsRef<[u8]>>(
    files: &[(&str, B)],
    options: &LoadOptions,
) -> (Result<Scene>, String) {
    let (folder, warnings) = (tempfile::tempdir().unwrap(), Warnings::default());
    for (name, bytes) in files {
        std::fs::write(folder.path().join(name), bytes).unwrap();
    }
    let path = folder.path().join(files[files.len() - 1].0);
    (Scene::load_with(&path, options, &warnings), warnings.list().join("\n"))
}

/// The scene of a file that gives no warning.
pub(super) fn clean((scene, warnings): (Result<Scene>, String)) -> Scene {
    assert_eq!(warnings, "");
    scene.unwrap()
}

/// The message of the input error for a file, which it names.
#[track_caller]
pub(super) fn refusal((scene, _): (Result<Scene>, String), name: &str) -> String {
    let error = scene.unwrap_err();
    assert_eq!(error.exit_status(), 2);
    let message = error.to_string();
    assert!(message.contains(name), "{message}");
    message
}
