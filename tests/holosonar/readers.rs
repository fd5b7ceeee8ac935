//! Every reader of files in the library, by the format of the file; for the tests of parsers and for `tests/fuzz`.

use crate::mutation::Structure;
use holosonar::acquisition::{DataCube, MicArray};
use holosonar::config::RunFile;
use holosonar::error::{Error, Result};
use holosonar::export::amplitude::Amplitude;
use holosonar::export::depth_exr::read_depth_map;
use holosonar::export::points_ply::ScenePoints;
use holosonar::export::volume_npz::read_volume_npz;
use holosonar::reflectors::Reflectors;
use holosonar::scene::{LoadOptions, Scene};
use std::fs;
use std::path::Path;

/// Bytes that any array of a file may take.
pub(crate) const LIMIT: u64 = 1 << 24;

/// A format, and all that reads it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Format {
    /// The end of the file's name.
    pub(crate) extension: &'static str,
    pub(crate) structure: Structure,
    /// What each of its readers makes of a file.
    pub(crate) read: fn(&Path, &LoadOptions) -> Vec<Result<()>>,
}

/// Every format.
pub(crate) const FORMATS: [Format; 13] = [
    Format { extension: "toml", structure: Structure::Lines, read: run_file },
    Format { extension: "obj", structure: Structure::Lines, read: scene },
    Format { extension: "mtl", structure: Structure::Lines, read: material },
    Format { extension: "gltf", structure: Structure::Json, read: scene },
    Format { extension: "glb", structure: Structure::Glb, read: scene },
    Format { extension: "stl", structure: Structure::Heading, read: scene },
    Format { extension: "ply", structure: Structure::Heading, read: scene_or_points },
    Format { extension: "csv", structure: Structure::Lines, read: reflectors_or_microphones },
    Format { extension: "xml", structure: Structure::Lines, read: microphones },
    Format { extension: "npz", structure: Structure::Npz, read: cube_or_volume },
    Format { extension: "exr", structure: Structure::Exr, read: depth_or_amplitude },
    Format { extension: "vti", structure: Structure::Heading, read: amplitude },
    Format { extension: "nrrd", structure: Structure::Heading, read: amplitude },
];

/// Reads a file by all readers of its format; whether one of them took it. What they refuse must be the file's fault.
pub(crate) fn read(format: &Format, path: &Path, options: &LoadOptions) -> bool {
    let results = (format.read)(path, options);
    let taken = results.iter().any(Result::is_ok);
    for error in results.into_iter().filter_map(Result::err) {
        match error {
            Error::InvalidInput { place, problem, .. } | Error::NotFound { place, problem, .. } => {
                assert!(!place.is_empty() && !problem.contains("\n\n"), "{place}: {problem}");
                assert!(problem.chars().count() < 2000, "{place}: {problem:?}");
            }
            other => panic!("{} is the file's fault: {other}", path.display()),
        }
    }
    taken
}

fn run_file(path: &Path, _: &LoadOptions) -> Vec<Result<()>> {
    vec![RunFile::load(path, &[]).map(drop)]
}

fn scene(path: &Path, options: &LoadOptions) -> Vec<Result<()>> {
    vec![Scene::load(path, options).map(|scene| {
        assert!(scene.bounds().is_some_and(|(low, high)| low.is_finite() && high.is_finite()));
    })]
}

const TRIANGLE: &str = "v 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 3\n";

/// A material file, by a mesh that names it.
fn material(path: &Path, options: &LoadOptions) -> Vec<Result<()>> {
    let name = path.file_name().unwrap_or_default().display();
    let mesh_path = path.with_extension("obj");
    fs::write(&mesh_path, format!("mtllib {name}\nusemtl pane\n{TRIANGLE}")).unwrap();
    scene(&mesh_path, options)
}

fn scene_or_points(path: &Path, options: &LoadOptions) -> Vec<Result<()>> {
    let mut results = scene(path, options);
    results.push(ScenePoints::read(path, LIMIT).map(drop));
    results
}

fn reflectors_or_microphones(path: &Path, options: &LoadOptions) -> Vec<Result<()>> {
    let mut results = microphones(path, options);
    results.push(Reflectors::read_csv(path).map(drop));
    results
}

fn microphones(path: &Path, _: &LoadOptions) -> Vec<Result<()>> {
    vec![MicArray::read(path).map(drop)]
}

fn cube_or_volume(path: &Path, _: &LoadOptions) -> Vec<Result<()>> {
    vec![DataCube::read(path, LIMIT).map(drop), read_volume_npz(path, LIMIT).map(drop)]
}

fn depth_or_amplitude(path: &Path, options: &LoadOptions) -> Vec<Result<()>> {
    let mut results = amplitude(path, options);
    results.push(
        read_depth_map(path, LIMIT)
            .map(|file| assert_eq!(file.map.len(), file.map.x.count * file.map.y.count)),
    );
    results
}

fn amplitude(path: &Path, _: &LoadOptions) -> Vec<Result<()>> {
    vec![Amplitude::read(path, LIMIT).map(drop)]
}
