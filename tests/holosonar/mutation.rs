//! Untrusted files: seeded damage to every kind of input gives a result or an error, never a panic.

use crate::binary::shipped;
use crate::support::{Random, data};
use holosonar::acquisition::DataCube;
use holosonar::config::{ANNOTATED, RunFile};
use holosonar::error::{Error, Result};
use holosonar::export::depth_exr::read_depth_map;
use holosonar::export::volume_npz::read_volume_npz;
use holosonar::pipeline::{JobOptions, truth_of_scene, write_depth};
use holosonar::reflectors::Reflectors;
use holosonar::scene::{LoadOptions, Scene, Unit};
use std::path::Path;

const LIMIT: u64 = 1 << 26;

/// Text that means something to one reader or another.
const WORDS: [&[u8]; 12] = [
    b"nan",
    b"-1",
    b"1e999",
    b"4294967296",
    b"18446744073709551615",
    b"\"",
    b"[",
    b"{}",
    b"\0",
    b"\n",
    b"-0.0",
    b"99999999999999999999",
];

/// One to four changes: a flipped bit, a random byte, a word, a run removed or doubled, the end cut off.
pub(crate) fn damage(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut damaged = bytes.to_vec();
    for _ in 0..random.whole(1, 4) {
        if damaged.is_empty() {
            break;
        }
        let at = random.whole(0, damaged.len() - 1);
        let end = (at + random.whole(1, 40)).min(damaged.len());
        match random.whole(0, 5) {
            0 => damaged[at] ^= 1 << random.whole(0, 7),
            1 => damaged[at] = random.whole(0, 255) as u8,
            2 => {
                let word = WORDS[random.whole(0, WORDS.len() - 1)];
                let end = (at + random.whole(0, 4)).min(damaged.len());
                damaged.splice(at..end, word.iter().copied());
            }
            3 => drop(damaged.drain(at..end)),
            4 => {
                let run = damaged[at..end].to_vec();
                damaged.splice(at..at, run);
            }
            _ => damaged.truncate(at),
        }
    }
    damaged
}

/// Up to three other digits in a text, so that its form stays and its numbers go wild; up to three other bytes in
/// anything else.
pub(crate) fn retouch(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut retouched = bytes.to_vec();
    let is_text = std::str::from_utf8(bytes).is_ok();
    let places: Vec<usize> = (0..bytes.len()).filter(|&i| !is_text || bytes[i].is_ascii_digit()).collect();
    for _ in 0..random.whole(1, 3).min(places.len()) {
        let at = places[random.whole(0, places.len() - 1)];
        retouched[at] = if is_text { b'0' + random.whole(0, 9) as u8 } else { random.whole(0, 255) as u8 };
    }
    retouched
}

/// Damages a file `times` times and reads the result; errors must be input errors and one paragraph long.
fn survives<T>(original: &Path, times: u64, read: impl Fn(&Path) -> Result<T>) {
    let bytes = std::fs::read(original).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(original.file_name().unwrap());
    let mut refused = 0;
    for seed in 0..times {
        std::fs::write(&path, damage(&bytes, &mut Random::new(seed))).unwrap();
        // Shown when the test fails: which damage it was.
        println!("{} with seed {seed}", original.display());
        match read(&path) {
            Ok(_) => {}
            Err(Error::InvalidInput { place, problem, .. } | Error::NotFound { place, problem, .. }) => {
                refused += 1;
                assert!(!place.is_empty() && !problem.contains("\n\n"), "{place}: {problem}");
            }
            Err(other) => panic!("{} is the file's fault: {other}", original.display()),
        }
    }
    assert!(refused * 3 > times, "only {refused} of {times} damaged files are noticed");
}

#[test]
fn run_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("annotated.toml");
    std::fs::write(&path, ANNOTATED).unwrap();
    survives_toml(&path);
    survives_toml(&shipped("transparent_foreground.toml"));
}

/// Most of a run file is comment, where damage means nothing.
fn survives_toml(path: &Path) {
    let folder = tempfile::tempdir().unwrap();
    let dense = folder.path().join("dense.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().map(|line| line.split('#').next().unwrap().trim_end());
    std::fs::write(&dense, lines.collect::<Vec<_>>().join("\n")).unwrap();
    survives(&dense, 150, |path| RunFile::load(path, &[]));
}

fn load(path: &Path) -> Result<Scene> {
    let mut options = LoadOptions::default();
    if path.extension().is_some_and(|e| e == "obj") {
        options.unit = Some(Unit::Metre);
    }
    Scene::load(path, &options)
}

#[test]
fn meshes() {
    survives(&shipped("meshes/corner.obj"), 200, load);
    survives(&shipped("meshes/transparent_foreground.gltf"), 200, load);
    survives(&data("scenes/f.gltf"), 200, load);
}

#[test]
fn binary_gltf() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("f.glb");
    std::fs::write(&path, glb()).unwrap();
    assert!(load(&path).is_ok());
    survives(&path, 200, load);
}

/// The letter F as a GLB of one JSON chunk, its buffer inside as a data URI.
pub(crate) fn glb() -> Vec<u8> {
    let mut json = std::fs::read(data("scenes/f.gltf")).unwrap();
    while !json.len().is_multiple_of(4) {
        json.push(b' ');
    }
    let mut glb = b"glTF".to_vec();
    for word in [2, 20 + json.len() as u32, json.len() as u32] {
        glb.extend(word.to_le_bytes());
    }
    glb.extend(b"JSON");
    glb.extend(json);
    glb
}

#[test]
fn reflector_lists() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("points.csv");
    std::fs::write(&path, "x,y,z,amplitude\n0.1,0.2,1.5,1\n-0.3,0.25,1.75,0.5\n1e-3,2,3,-4\n").unwrap();
    survives(&path, 200, Reflectors::read_csv);
}

#[test]
fn cubes_and_volumes() {
    survives(&data("reference/forward_quadrature.npz"), 100, |path| DataCube::read(path, LIMIT));
    survives(&data("reference/forward_in_phase.npz"), 100, |path| DataCube::read(path, LIMIT));
    survives(&data("reference/volume_in_phase_8mm.npz"), 100, |path| read_volume_npz(path, LIMIT));
}

#[test]
fn pictures() {
    let folder = tempfile::tempdir().unwrap();
    let run = RunFile::load(&shipped("corner.toml"), &["grid.z=[1.9,2.3]".to_owned()]).unwrap();
    let (facts, map) = truth_of_scene(&run, &JobOptions::default()).unwrap();
    let path = folder.path().join("truth.exr");
    write_depth(&path, &map, &run, &facts).unwrap();
    // Most of the file is compressed pixels, in which damage is seldom noticed: damage the headers alone too.
    survives_exr(&path, 200);
}

fn survives_exr(path: &Path, times: u64) {
    let bytes = std::fs::read(path).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let damaged = folder.path().join("damaged.exr");
    let mut refused = 0;
    for seed in 0..2 * times {
        let head = if seed % 2 == 0 { 2000.min(bytes.len()) } else { bytes.len() };
        let mut text = damage(&bytes[..head], &mut Random::new(seed));
        text.extend_from_slice(&bytes[head..]);
        std::fs::write(&damaged, text).unwrap();
        println!("seed {seed}");
        match read_depth_map(&damaged, LIMIT) {
            Ok(file) => assert_eq!(file.map.len(), file.map.x.count * file.map.y.count),
            Err(Error::InvalidInput { .. }) => refused += 1,
            Err(other) => panic!("it is the file's fault: {other}"),
        }
    }
    assert!(refused * 3 > times, "only {refused} of {} damaged files are noticed", 2 * times);
}
