//! Plates, and scenes from files that a test writes.
#![allow(clippy::unwrap_used)]

use super::{LoadOptions, Material, Scene, Triangle};
use crate::error::Result;
use crate::named::Warnings;
use glam::DVec3;

/// A rectangle at depth z, of two triangles.
pub(crate) fn plate([x0, x1]: [f64; 2], [y0, y1]: [f64; 2], z: f64, material: u32) -> [Triangle; 2] {
    let [a, b, c, d] = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)].map(|(x, y)| DVec3::new(x, y, z));
    [[a, b, c], [a, c, d]].map(|vertices| Triangle { vertices, material })
}

pub(crate) fn material(reflectance: f64, transmittance: f64) -> Material {
    Material { reflectance, transmittance, ..Material::opaque("") }
}

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
