//! Files nobody vouches for: seeded damage to every kind of input gives a result or an error, never a panic.

use crate::binary::shipped;
use crate::support::{Random, data};
use holosonar::acquisition::DataCube;
use holosonar::config::{ANNOTATED, RunFile};
use holosonar::error::{Error, Result};
use holosonar::export::depth_exr::read_depth_map;
use holosonar::export::volume_npz::read_volume_npz;
use holosonar::progress::Silent;
use holosonar::reflectors::Reflectors;
use holosonar::scene::{LoadOptions, Scene, Unit};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

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
fn damage(bytes: &[u8], random: &mut Random) -> Vec<u8> {
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
fn retouch(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut retouched = bytes.to_vec();
    let is_text = std::str::from_utf8(bytes).is_ok();
    let places: Vec<usize> = (0..bytes.len()).filter(|&i| !is_text || bytes[i].is_ascii_digit()).collect();
    for _ in 0..random.whole(1, 3).min(places.len()) {
        let at = places[random.whole(0, places.len() - 1)];
        retouched[at] = if is_text { b'0' + random.whole(0, 9) as u8 } else { random.whole(0, 255) as u8 };
    }
    retouched
}

/// Damages a file `times` times and reads what comes of it; errors must be the file's fault and one paragraph long.
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
            Err(Error::Input { place, problem }) => {
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
    Scene::load(path, &options, &Silent)
}

#[test]
fn meshes() {
    survives(&shipped("meshes/corner.obj"), 200, load);
    survives(&shipped("meshes/transparent_foreground.gltf"), 200, load);
    survives(&data("scenes/f.gltf"), 200, load);
}

/// `HOLOSONAR_MUTATIONS` in the environment, or `otherwise`.
fn count(otherwise: u64) -> u64 {
    std::env::var("HOLOSONAR_MUTATIONS").map_or(otherwise, |count| count.parse().unwrap())
}

#[test]
fn every_kind_of_scene() {
    hunt(count(3_000));
}

#[test]
#[ignore = "about two minutes"]
fn every_kind_of_scene_a_hundred_thousand_times() {
    hunt(count(100_000));
}

/// No input of a few kB may keep a reader this long: then it hangs.
const HANGS: Duration = Duration::from_mins(1);

/// What a hunter reads, and since when: file, seed of the damage, time.
type Prey = Mutex<Option<(PathBuf, u64, Instant)>>;

/// Damages the files of `tests/data/scenes` and those that ship, `times` in all, and reads what comes of it. A
/// reader that panics or hangs fails the test, which then names the file and the seed.
fn hunt(times: u64) {
    let mut files = crate::scenes::inputs();
    let mut metres = LoadOptions::default();
    metres.unit = Some(Unit::Metre);
    for name in ["scenes/obj/first.mtl", "scenes/obj/second library.mtl", "scenes/obj/contradiction.mtl"] {
        files.push((data(name), metres.clone()));
    }
    for name in ["corner.obj", "bracket.obj", "transparent_foreground.gltf", "point.csv"] {
        let options = if name.ends_with("obj") { metres.clone() } else { LoadOptions::default() };
        files.push((shipped("meshes").join(name), options));
    }
    let files: Arc<[_]> = files.into();
    let (next, refused) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let started = Instant::now();
    let hunters: Vec<_> = (0..std::thread::available_parallelism().map_or(1, usize::from))
        .map(|_| {
            let (files, next, refused) = (files.clone(), next.clone(), refused.clone());
            let prey: Arc<Prey> = Arc::default();
            let noted = prey.clone();
            let hunter = std::thread::spawn(move || {
                let folder = tempfile::tempdir().unwrap();
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= times {
                        return;
                    }
                    let (file, options) = &files[seed as usize % files.len()];
                    *noted.lock().unwrap() = Some((file.clone(), seed, Instant::now()));
                    let read = survived(file, options, seed, folder.path());
                    *noted.lock().unwrap() = None;
                    refused.fetch_add(u64::from(!read), Ordering::Relaxed);
                }
            });
            (hunter, prey)
        })
        .collect();
    while !hunters.iter().all(|(hunter, _)| hunter.is_finished()) {
        std::thread::sleep(Duration::from_millis(20));
        for (_, prey) in &hunters {
            let prey = prey.lock().unwrap().clone();
            if let Some((file, seed, _)) = prey.filter(|(.., since)| since.elapsed() > HANGS) {
                panic!("{} with seed {seed} hangs", file.display());
            }
        }
    }
    for (hunter, _) in hunters {
        hunter.join().unwrap();
    }
    let (seconds, refused) = (started.elapsed().as_secs_f64(), refused.load(Ordering::Relaxed));
    println!(
        "{times} damaged scenes of {} files in {seconds:.1} s ({:.0}/s), {refused} of them refused",
        files.len(),
        times as f64 / seconds
    );
    assert!(refused * 3 > times, "only {refused} of {times} damaged files are noticed");
}

/// Whether a damaged file was read; otherwise the error must be the file's fault.
fn survived(file: &Path, options: &LoadOptions, seed: u64, folder: &Path) -> bool {
    let (bytes, mut random) = (std::fs::read(file).unwrap(), Random::new(seed));
    // Not `seed % 2`: the number of files may be even.
    let gently = random.whole(0, 1) == 0;
    let bytes = if gently { retouch(&bytes, &mut random) } else { damage(&bytes, &mut random) };
    let mut path = folder.join(file.file_name().unwrap());
    std::fs::write(&path, bytes).unwrap();
    let kind = file.extension().and_then(|e| e.to_str());
    if kind == Some("mtl") {
        let mesh = format!("mtllib {}\nusemtl pane\n{TRIANGLE}", path.file_name().unwrap().display());
        path.set_extension("obj");
        std::fs::write(&path, mesh).unwrap();
    }
    let read = || match kind {
        Some("csv") => Reflectors::read_csv(&path).map(drop),
        _ => Scene::load(&path, options, &Silent).map(|scene| {
            assert!(scene.bounds().is_some_and(|(low, high)| low.is_finite() && high.is_finite()));
        }),
    };
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(read));
    match outcome.unwrap_or_else(|_| panic!("{} with seed {seed} panics", file.display())) {
        Ok(()) => true,
        Err(Error::Input { place, problem }) => {
            assert!(!place.is_empty() && !problem.contains("\n\n"), "seed {seed}, {place}: {problem}");
            false
        }
        Err(other) => panic!("{} with seed {seed} is the file's fault: {other}", file.display()),
    }
}

const TRIANGLE: &str = "v 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 3\n";

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
    let (facts, map) = holosonar::pipeline::truth_of_scene(&run, false, &Silent).unwrap();
    let path = folder.path().join("truth.exr");
    holosonar::pipeline::write_depth(&path, &map, &run, &facts).unwrap();
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
            Err(Error::Input { .. }) => refused += 1,
            Err(other) => panic!("it is the file's fault: {other}"),
        }
    }
    assert!(refused * 3 > times, "only {refused} of {} damaged files are noticed", 2 * times);
}
