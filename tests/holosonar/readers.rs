//! Every reader of files in the library, by the format of the file; for the tests of parsers and for `tests/fuzz`.

use crate::mutation::Structure;
use holosonar::acquisition::{
    ArrayName, ChannelResponse, DataCube, ImportAxis, ImportOptions, MeanWord, MicArray, RawOffset,
    RecordingOptions, Reference, Sweep, TraceColumn, import,
};
use holosonar::config::RunFile;
use holosonar::error::{Error, Result};
use holosonar::export::amplitude::Amplitude;
use holosonar::export::depth_exr::read_depth_map;
use holosonar::export::points_ply::{SceneMesh, ScenePoints};
use holosonar::export::volume_npz::read_volume_npz;
use holosonar::glam::DVec3;
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
pub(crate) const FORMATS: [Format; 16] = [
    Format { extension: "toml", structure: Structure::Lines, read: run_file },
    Format { extension: "obj", structure: Structure::Lines, read: scene },
    Format { extension: "mtl", structure: Structure::Lines, read: material },
    Format { extension: "gltf", structure: Structure::Json, read: scene },
    Format { extension: "glb", structure: Structure::Glb, read: scene },
    Format { extension: "stl", structure: Structure::Heading, read: scene },
    Format { extension: "ply", structure: Structure::Heading, read: scene_or_points },
    Format { extension: "csv", structure: Structure::Lines, read: reflectors_or_microphones },
    Format { extension: "xml", structure: Structure::Lines, read: microphones },
    Format { extension: "npz", structure: Structure::Npz, read: cube_volume_or_response },
    Format { extension: "npy", structure: Structure::Heading, read: samples },
    Format { extension: "s2p", structure: Structure::Lines, read: samples },
    Format { extension: "wav", structure: Structure::Wav, read: recording },
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
    results.push(SceneMesh::read(path, LIMIT).map(drop));
    results
}

fn reflectors_or_microphones(path: &Path, options: &LoadOptions) -> Vec<Result<()>> {
    let mut results = microphones(path, options);
    results.push(Reflectors::read_csv(path).map(drop));
    let mut options = import_options(path);
    options.columns = vec![TraceColumn::Frequency, TraceColumn::Decibel, TraceColumn::Degree];
    results.push(import(&options).map(drop));
    results.extend(samples(path, &LoadOptions::default()));
    results
}

/// An import of one file, of one microphone if it says nothing about several.
fn import_options(path: &Path) -> ImportOptions {
    let mut options = ImportOptions::new(vec![path.to_owned()]);
    options.array = Some(MicArray::rectangular([1, 1], [1.0; 2], DVec3::ZERO).unwrap());
    options.memory = Some(LIMIT);
    options
}

fn samples(path: &Path, _: &LoadOptions) -> Vec<Result<()>> {
    let one = import_options(path);
    let mut many = one.clone();
    many.array = Some(MicArray::rectangular([3, 2], [0.02; 2], DVec3::ZERO).unwrap());
    many.sweep = Some(Sweep::stepped(10_000.0, 10_400.0, 100.0).unwrap());
    many.offset = Some(RawOffset::Mean(MeanWord::Mean));
    let mut typed = many.clone();
    typed.axes = vec![ImportAxis::X, ImportAxis::Y, ImportAxis::Frequency, ImportAxis::Plane];
    let mut several = many.clone();
    several.sources = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
    several.axes =
        vec![ImportAxis::Transmission, ImportAxis::Microphone, ImportAxis::Frequency, ImportAxis::Plane];
    several.array = Some(MicArray::rectangular([2, 1], [0.02; 2], DVec3::ZERO).unwrap());
    several.source_file =
        Some(path.to_owned()).filter(|path| path.extension().is_some_and(|end| end == "csv"));
    [one, many, typed, several].iter().map(|options| import(options).map(drop)).collect()
}

/// Tones and a broadband signal with a reference, and all channels with none.
fn recording(path: &Path, _: &LoadOptions) -> Vec<Result<()>> {
    let mut stepped = import_options(path);
    stepped.sweep = Some(Sweep::stepped(10_000.0, 10_400.0, 100.0).unwrap());
    stepped.recording = RecordingOptions::tones(0.004).with_reference(Some(Reference::Channel(0)));
    let mut broadband = stepped.clone();
    broadband.recording = RecordingOptions::broadband(Reference::Channel(0));
    let mut both = stepped.clone();
    both.array = Some(MicArray::rectangular([2, 1], [0.02; 2], DVec3::ZERO).unwrap());
    both.recording = RecordingOptions::tones(0.004);
    [stepped, broadband, both].iter().map(|options| import(options).map(drop)).collect()
}

fn microphones(path: &Path, _: &LoadOptions) -> Vec<Result<()>> {
    vec![MicArray::read(path).map(drop)]
}

fn cube_volume_or_response(path: &Path, _: &LoadOptions) -> Vec<Result<()>> {
    let mut results = vec![DataCube::read(path, LIMIT).map(drop), read_volume_npz(path, LIMIT).map(drop)];
    results.push(ChannelResponse::read(path, LIMIT).map(drop));
    let mut options = import_options(path);
    options.frequencies = Some("frequencies".into());
    options.positions = Some("mic_positions".into());
    options.arrays = vec![ArrayName::Name("samples".to_owned())];
    results.push(import(&options).map(drop));
    results
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
