//! Every parser under seeded mutations: a result or an input error, and never a panic, within limits of time and memory.
//!
//! `HOLOSONAR_MUTATIONS` sets the number of mutations per parser. `.ci/run` runs this in a release build.

use crate::binary::{shipped, small};
use crate::meshes::letter_glb;
use crate::mutation::{damage, restructure, retouch};
use crate::named::assert_names;
use crate::readers::{self, FORMATS, Format, LIMIT};
use crate::support::{Random, data};
use holosonar::acquisition::{
    ChannelResponse, DataCube, Instrument, MicArray, RecorderOptions, RecordingOptions, Reference,
    ResponseAxis, Sweep, WavFormat, write_recording,
};
use holosonar::config::{ANNOTATED, RunFile};
use holosonar::export::points_ply::{SceneMesh, ScenePoints};
use holosonar::export::volume_npz::read_volume_npz;
use holosonar::grid::{Axis, Grid, Volume};
use holosonar::pipeline::{JobOptions, truth_of_scene, write_depth, write_volume};
use holosonar::progress::Silent;
use holosonar::scene::{LoadOptions, Scene, Unit};
use holosonar::wave::Geometry;
use num_complex::Complex32;
use serde_json::json;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// A reader that takes longer for a file of a few kB hangs.
const HANGS: Duration = Duration::from_mins(1);

/// A file to be damaged, and the options for reading it.
#[derive(Clone)]
struct Original {
    name: String,
    bytes: Vec<u8>,
    options: LoadOptions,
}

/// A format, and files of it.
struct Parser {
    format: &'static Format,
    originals: Vec<Original>,
}

fn metres() -> LoadOptions {
    LoadOptions::default().with_unit(Unit::Metre)
}

fn original(path: &Path, options: LoadOptions) -> Original {
    let name = path.file_name().unwrap().to_str().unwrap().to_owned();
    Original { name, bytes: fs::read(path).unwrap(), options }
}

/// Comments of a run file left out, where damage means nothing.
fn dense(name: &str, text: &str) -> Original {
    let lines = text.lines().map(|line| line.split('#').next().unwrap().trim_end());
    let bytes = lines.collect::<Vec<_>>().join("\n").into_bytes();
    Original { name: name.to_owned(), bytes, options: LoadOptions::default() }
}

/// Small files of ours, in every format.
fn written(folder: &Path) {
    let sweep = Sweep::stepped(10_000.0, 10_400.0, 100.0).unwrap();
    let array = MicArray::rectangular([3, 2], [0.02; 2], glam::DVec3::ZERO).unwrap();
    let samples = (0..30).map(|i| Complex32::new(i as f32, 1.0)).collect();
    let points = ScenePoints::new(None, &array, &[glam::DVec3::ZERO]);
    points.write(&folder.join("points.ply"), &[]).unwrap();
    let scene = Scene::load(&shipped("meshes/corner.obj"), &metres()).unwrap();
    SceneMesh::decimated(&scene).write(&folder.join("mesh.ply"), &[]).unwrap();
    let cube = DataCube::new(Instrument::new(sweep, array), samples).unwrap();
    cube.write(&folder.join("cube.npz")).unwrap();
    let sources = [glam::DVec3::ZERO, glam::DVec3::X];
    let both = cube.instrument.clone().with_sources(&sources).unwrap();
    let samples = [&cube.samples[..]; 2].concat();
    DataCube::new(both, samples).unwrap().write(&folder.join("sources.npz")).unwrap();
    let pair = cube.instrument.clone().with_geometry(Geometry::Pair { offset: glam::DVec3::X });
    DataCube::new(pair, cube.samples.clone()).unwrap().write(&folder.join("pair.npz")).unwrap();
    let spread: Vec<glam::DVec3> = (0..6).map(|i| glam::DVec3::Y * f64::from(i)).collect();
    let pairs = cube.instrument.clone().with_pairs(&spread).unwrap();
    DataCube::new(pairs, cube.samples.clone()).unwrap().write(&folder.join("pairs.npz")).unwrap();
    let response = ChannelResponse::measure(&cube, glam::DVec3::Z, ResponseAxis::Both).unwrap();
    response.write(&folder.join("response.npz")).unwrap();
    let single = MicArray::from_positions(vec![glam::DVec3::ZERO]).unwrap();
    let heard = Instrument::new(cube.instrument.sweep.clone(), single);
    let heard = DataCube::new(heard, vec![Complex32::I; 5]).unwrap();
    let tones = RecordingOptions::tones(0.004).with_reference(Some(Reference::Channel(0)));
    for (name, format) in [("tones.wav", WavFormat::Int16), ("float.wav", WavFormat::Float32)] {
        let recorder = RecorderOptions::default().with_format(format);
        write_recording(&folder.join(name), &heard, &tones, &recorder, &Silent).unwrap();
    }
    let axis = |first, count| Axis { first, pitch: 0.1, count };
    let grid = Grid { x: axis(-0.2, 5), y: axis(-0.1, 3), z: axis(1.0, 4) };
    let volume = Volume::new(grid, (0..60).map(|i| Complex32::new(0.5, i as f32)).collect());
    let run = RunFile::load(&small("corner.toml"), &["grid.pitch=[0.2,0.2,0.2]".to_owned()]).unwrap();
    let facts = json!({ "sound_speed": 343.0, "bandwidth": 10_000.0, "program": "holosonar" });
    for name in ["volume.npz", "volume.exr", "volume.vti", "volume.nrrd"] {
        write_volume(&folder.join(name), &volume, &run.output, &facts).unwrap();
    }
    let (facts, map) = truth_of_scene(&run, &JobOptions::default()).unwrap();
    write_depth(&folder.join("depth.exr"), &map, &run, &facts).unwrap();
}

/// Microphones as Acoular writes them.
const MICROPHONES: &str = "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<MicArray name=\"two\">\n\
    \t<pos Name=\"Point 1\" x=\"0.152\" y=\"0.1\" z=\"0\"/>\n\t<pos Name=\"Point 2\" x=\"-0.1\" y=\"0\" z=\"0\"/>\n</MicArray>\n";

/// A run file with the keys that exclude those of the shipped ones.
const SIZED: &str = "[scene]\nmesh = \"part.stl\"\nsize = 0.5\nup = \"z\"\nfit = [0.0, 0.0, 1.0]\n\
    [[materials]]\nname = \"*\"\nmaterial = \"mesh-fabric\"\ntransmittance = 0.5\n";

/// A Touchstone file of two ports.
const TOUCHSTONE: &str = "! VNA\n# kHz S DB R 50\n10 -40 1 -3 20 -3 20 -40 2 ! first\n10.1 -40 1 -4 -170 -3 20 -40 2\n\
    10.2 -40 1 -80 0.5e1 -3 20 -40 2\n";

/// A run file of an import.
const IMPORT: &str = "[import]\nsamples = [\"a.npy\", \"b.npy\"]\narrays = [0, \"Q\"]\naxes = [\"x\", \"y\", \"f\", \"iq\"]\n\
    offset = [2048, 2050.5]\nfrequencies = \"f\"\nfrequency_unit = \"kHz\"\npositions = \"mics.npy\"\nsources = \"s.csv\"\nname_unit = \"mm\"\n\
    parameter = \"S21\"\ncolumns = [\"f\", \"-\", \"db\", \"deg\"]\nphase_sign = -1\n[recording]\nsignal = \"broadband\"\nreference = \"sent.wav\"\n\
    microphones = [2, 1]\nlatency = \"direct\"\nresponse = 0.05\nformat = \"int16\"\ndwell = 1\nsettling = 0.5\n";

/// One whose positions are formulas.
const FORMULAS: &str = "[import]\nsamples = \"a.npy\"\npositions = { x = \"0.003 * ix\", y = \"-(iy - 2)*1e-2 + sin(2*pi*i/8)\", z = \"sqrt(i + 1) / 4 ^ 2\" }\n\
    [array]\ncount = [3, 2]\n";

/// A run file of several meshes.
const PARTS: &str = "[scene]\nfit = [0, 0, 1.5]\n[[scene.parts]]\nmesh = \"a.obj\"\nunit = \"mm\"\nname = \"cup\"\nmaterial = \"glass\"\n\
    [[scene.parts]]\nmesh = \"b.stl\"\nsize = 0.5\nup = \"z\"\nrotate = [0, 90, 0]\ntranslate = [0.1, 0, 0.2]\nscale = 1\n\
    [[scene.parts]]\nmesh = \"c.ply\"\nfit = [0, 0, 1]\n[[materials]]\nname = \"b*\"\nreflectance = 0.5\n";

/// Files of every format.
fn parsers() -> Vec<Parser> {
    let folder = tempfile::tempdir().unwrap();
    written(folder.path());
    let text = |name: &str, text: &str| Original {
        name: name.to_owned(),
        bytes: text.as_bytes().to_vec(),
        options: LoadOptions::default(),
    };
    let wide = |name: &str, text: &str| {
        let units = std::iter::once(0xfeff).chain(text.encode_utf16());
        Original {
            name: name.to_owned(),
            bytes: units.flat_map(u16::to_le_bytes).collect(),
            options: metres(),
        }
    };
    let npy = |name: &str, kind: &str, shape: &str, bytes: u8| {
        let head = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n");
        let length = (head.len() as u16).to_le_bytes();
        let data: Vec<u8> = (0..bytes).map(|i| i % 63).collect();
        let bytes = [b"\x93NUMPY\x01\x00".as_slice(), &length, head.as_bytes(), &data].concat();
        Original { name: name.to_owned(), bytes, options: LoadOptions::default() }
    };
    let foreground = fs::read_to_string(small("transparent_foreground.toml")).unwrap();
    let mut all = vec![
        dense("annotated.toml", ANNOTATED),
        dense("foreground.toml", &foreground),
        text("sized.toml", SIZED),
        text("parts.toml", PARTS),
        wide("wide.obj", "# Würfel\nv 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 3\n"),
        text("points.csv", "x,y,z,amplitude\n0.1,0.2,1.5,1\n-0.3,0.25,1.75,0.5\n1e-3,2,3,-4\n"),
        text("microphones.csv", "x,y,z\n0.1,0.2,0\n-0.3,0.25,0\n1e-3,2,0\n"),
        text("microphones.xml", MICROPHONES),
        text("trace.csv", "f,db,deg\n10000,-3.5,20\n10100,-4,-170\n10200,-80,0\n"),
        text("vna.s2p", TOUCHSTONE),
        text("import.toml", IMPORT),
        text("formulas.toml", FORMULAS),
        npy("samples.npy", "<f4", "(3, 2, 5, 2)", 240),
        npy("raw.npy", ">u2", "(5, 6)", 60),
        Original { bytes: letter_glb(), ..text("f.glb", "") },
        original(&shipped("meshes/corner.obj"), metres()),
        original(&shipped("meshes/transparent_foreground.gltf"), LoadOptions::default()),
    ];
    let ours = [
        "cube.npz",
        "sources.npz",
        "pair.npz",
        "pairs.npz",
        "response.npz",
        "tones.wav",
        "float.wav",
        "volume.npz",
        "depth.exr",
        "volume.exr",
        "volume.vti",
        "volume.nrrd",
        "points.ply",
        "mesh.ply",
    ];
    all.extend(ours.map(|name| original(&folder.path().join(name), LoadOptions::default())));
    let independent = ["forward_quadrature.npz", "forward_in_phase.npz", "volume_in_phase_8mm.npz"];
    all.extend(independent.map(|name| original(&data("reference").join(name), LoadOptions::default())));
    let libraries = ["first.mtl", "second library.mtl", "contradiction.mtl"];
    all.extend(libraries.map(|name| original(&data("scenes/obj").join(name), metres())));
    all.extend(crate::scenes::inputs().into_iter().map(|(path, options)| original(&path, options)));
    let of = |format: &'static Format| {
        let extension =
            |file: &Original| Path::new(&file.name).extension().is_some_and(|e| e == format.extension);
        Parser { format, originals: all.iter().filter(|file| extension(file)).cloned().collect() }
    };
    FORMATS.iter().map(of).collect()
}

/// What a thread is reading: file, seed of the damage, and since when.
type Reading = Mutex<Option<(String, u64, Instant)>>;

/// Damages the files of a parser `times` times in all, reads them and returns the number of refusals. A reader that
/// panics or hangs fails the test, which then names the file and the seed.
fn fuzz(parser: Parser, times: u64) -> u64 {
    let parser = Arc::new(parser);
    let (next, refused) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let threads: Vec<_> = (0..std::thread::available_parallelism().map_or(1, usize::from))
        .map(|_| {
            let (parser, next, refused) = (parser.clone(), next.clone(), refused.clone());
            let reading: Arc<Reading> = Arc::default();
            let noted = reading.clone();
            let thread = std::thread::spawn(move || {
                // In memory where that can be, for the disk would take most of the time.
                let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= times {
                        return;
                    }
                    let original = &parser.originals[seed as usize % parser.originals.len()];
                    *noted.lock().unwrap() = Some((original.name.clone(), seed, Instant::now()));
                    let read = survived(&parser, original, seed, folder.path());
                    *noted.lock().unwrap() = None;
                    refused.fetch_add(u64::from(!read), Ordering::Relaxed);
                }
            });
            (thread, reading)
        })
        .collect();
    while !threads.iter().all(|(thread, _)| thread.is_finished()) {
        std::thread::sleep(Duration::from_millis(5));
        for (_, reading) in &threads {
            let reading = reading.lock().unwrap().clone();
            if let Some((file, seed, _)) = reading.filter(|(.., since)| since.elapsed() > HANGS) {
                panic!("{file} with seed {seed} hangs");
            }
        }
    }
    for (thread, _) in threads {
        thread.join().unwrap();
    }
    refused.load(Ordering::Relaxed)
}

/// Whether a damaged file was read; otherwise the error must be the file's fault.
fn survived(parser: &Parser, original: &Original, seed: u64, folder: &Path) -> bool {
    let mut random = Random::new(seed);
    let bytes = &original.bytes;
    let damaged = match random.whole(0, 4) {
        0 => retouch(bytes, &mut random),
        // Headings decide more than what follows, where damage is seldom noticed.
        1 => {
            let (head, rest) = bytes.split_at(bytes.len().min(600));
            [damage(head, &mut random), rest.to_vec()].concat()
        }
        2 => damage(bytes, &mut random),
        _ => restructure(bytes, parser.format.structure, &mut random),
    };
    let path = folder.join(&original.name);
    fs::write(&path, damaged).unwrap();
    let read = std::panic::AssertUnwindSafe(|| readers::read(parser.format, &path, &original.options));
    std::panic::catch_unwind(read).unwrap_or_else(|_| panic!("{} with seed {seed}: see above", original.name))
}

fn fuzz_all(times: u64) {
    let times = std::env::var("HOLOSONAR_MUTATIONS").map_or(times, |count| count.parse().unwrap());
    let begun = Instant::now();
    for parser in parsers() {
        let (name, files, since) = (parser.format.extension, parser.originals.len(), Instant::now());
        assert!(files > 0, "{name} has nothing to read");
        let refused = fuzz(parser, times);
        let rate = times as f64 / since.elapsed().as_secs_f64();
        println!("{name}: {times} damaged files of {files}, {refused} refused, 0 panics, {rate:.0}/s");
        assert!(refused * 5 > times, "{name}: only {refused} of {times} damaged files are noticed");
        assert!(refused < times, "{name}: nothing is read, so nothing was tried");
    }
    println!("in {:.0} s", begun.elapsed().as_secs_f64());
}

#[test]
fn every_parser() {
    fuzz_all(600);
}

#[test]
#[ignore = "some minutes"]
fn every_parser_a_hundred_thousand_times() {
    fuzz_all(100_000);
}

/// Inputs that once took seconds, memory or the terminal, or ended in a panic.
#[test]
fn past_findings_are_survived() {
    let folder = tempfile::tempdir().unwrap();
    let (mut files, begun) = (0, Instant::now());
    for format in &FORMATS {
        let findings =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/regressions").join(format.extension);
        for finding in crate::binary::files_below(&findings) {
            // Under a name that has the format's ending.
            let path = folder.path().join("input").with_extension(format.extension);
            fs::copy(&finding, &path).unwrap();
            let options = if format.extension.starts_with("gl") { LoadOptions::default() } else { metres() };
            readers::read(format, &path, &options);
            files += 1;
            assert!(begun.elapsed() < HANGS, "{} hangs", finding.display());
        }
    }
    assert!(files > 20, "{files} findings");
}

#[test]
fn a_zip_bomb_is_refused_by_its_size() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bomb.npz");
    let mut zip = zip::ZipWriter::new(fs::File::create(&path).unwrap());
    let options =
        zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
    // 64 MiB of zeros in 64 kB.
    for name in ["frequencies.npy", "samples.npy", "mic_positions.npy", "z.npy", "meta.npy"] {
        let (kind, bytes) = if name == "meta.npy" { ("|u1", 1) } else { ("<f8", 8) };
        let mut header =
            format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({},), }}", (64 << 20) / bytes);
        header += &" ".repeat(117 - header.len());
        header.push('\n');
        zip.start_file(name, options).unwrap();
        zip.write_all(b"\x93NUMPY\x01\x00\x76\x00").unwrap();
        zip.write_all(header.as_bytes()).unwrap();
        zip.write_all(&vec![0; 64 << 20]).unwrap();
    }
    zip.finish().unwrap();
    assert!(fs::metadata(&path).unwrap().len() < 1 << 20);
    let cube = DataCube::read(&path, LIMIT).unwrap_err();
    assert_eq!(cube.exit_status(), 2);
    assert_names(cube.to_string(), &["bomb.npz", "`meta`", "67108864 bytes", "16777216"]);
    let volume = read_volume_npz(&path, LIMIT).unwrap_err();
    assert_eq!(volume.exit_status(), 2);
    assert_names(volume.to_string(), &["bomb.npz"]);
}
