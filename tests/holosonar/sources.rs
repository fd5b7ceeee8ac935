//! Several loudspeakers one after another, and moved pairs: adjoints, the virtual array, and the way from run file to image.

use crate::binary::{done, done_json, json_file, refused};
use crate::named::assert_names;
use crate::support::{Random, position_of, relative_difference};
use glam::DVec3;
use holosonar::acquisition::{DataCube, Instrument, MicArray, SimulateOptions, Sweep, simulate};
use holosonar::export::volume_npz::read_volume_npz;
use holosonar::grid::{Axis, Grid};
use holosonar::reconstruct::{Method, ReconstructOptions, Window, reconstruct};
use holosonar::reflectors::Reflectors;
use holosonar::wave::Geometry;
use num_complex::Complex32;
use std::fmt::Write;
use std::fs;
use std::path::Path;

fn grid() -> Grid {
    let axis = |first, pitch, count| Axis { first, pitch, count };
    Grid { x: axis(-0.1, 0.02, 7), y: axis(-0.06, 0.02, 5), z: axis(0.5, 0.015, 4) }
}

fn sweep() -> Sweep {
    Sweep::stepped(9_000.0, 13_000.0, 200.0).unwrap()
}

/// Instruments of several loudspeakers and of a pair, with microphones on a lattice and scattered.
fn instruments(random: &mut Random) -> Vec<Instrument> {
    let mut point = |size: f64| {
        let mut along = |size: f64| random.uniform(-size, size);
        DVec3::new(along(size), along(size), along(0.1 * size))
    };
    let scattered = MicArray::from_positions((0..13).map(|_| point(0.2)).collect()).unwrap();
    let lattice = MicArray::rectangular([5, 4], [0.02; 2], DVec3::ZERO).unwrap();
    let mut instruments = Vec::new();
    for (array, sources) in [(lattice, 2), (scattered, 3)] {
        let instrument = Instrument::new(sweep(), array);
        let sources: Vec<DVec3> = (0..sources).map(|_| point(0.3)).collect();
        instruments.push(instrument.clone().with_sources(&sources).unwrap());
        instruments.push(instrument.clone().with_geometry(Geometry::Pair { offset: point(0.1) }));
        let own: Vec<DVec3> = instrument.array.positions().iter().map(|_| point(0.3)).collect();
        instruments.push(instrument.with_pairs(&own).unwrap());
    }
    // More loudspeakers than microphones, which change places.
    let few = MicArray::from_positions(vec![point(0.2), point(0.2)]).unwrap();
    let many: Vec<DVec3> = (0..6).map(|_| point(0.3)).collect();
    instruments.push(Instrument::new(sweep(), few).with_sources(&many).unwrap());
    instruments
}

/// `Re⟨K a, m⟩ = Re⟨a, K* m⟩` with `K* = reconstruction · n_tx · n_f · n_r`, reflectors on every voxel.
#[test]
fn simulation_and_reconstruction_are_adjoint() {
    let mut random = Random::new(77);
    let grid = grid();
    let positions: Vec<DVec3> = (0..grid.voxel_count() as usize).map(|v| position_of(&grid, v)).collect();
    let dot = |x: &[Complex32], y: &[Complex32]| -> f64 {
        x.iter().zip(y).map(|(x, y)| f64::from((x * y.conj()).re)).sum()
    };
    for instrument in instruments(&mut random) {
        let a: Vec<Complex32> = positions.iter().map(|_| random.complex()).collect();
        let reflectors = Reflectors::new(positions.clone(), a.clone()).unwrap();
        let ka = simulate(&reflectors, &instrument, &SimulateOptions::default()).unwrap();
        let samples: Vec<Complex32> = ka.samples.iter().map(|_| random.complex()).collect();
        let cube = DataCube::new(instrument.clone(), samples).unwrap();
        for method in [Method::Direct, Method::Backprojection, Method::Auto] {
            let options = ReconstructOptions::new(method, Window::None).with_tolerance(1e-5);
            let volume = reconstruct(&cube, &grid, &options).unwrap().volume;
            let (left, right) =
                (dot(&ka.samples, &cube.samples), dot(&a, &volume.samples) * cube.samples.len() as f64);
            let norm = |x: &[Complex32]| dot(x, x).sqrt();
            let error = (left - right).abs() / (norm(&ka.samples) * norm(&cube.samples));
            assert!(error < 1e-5, "{method} {:?}: {left} against {right}", instrument.geometry);
        }
    }
}

#[test]
fn threads_do_not_change_the_bytes() {
    let mut random = Random::new(78);
    for instrument in instruments(&mut random) {
        let count = instrument.transmissions() * instrument.sweep.len() * instrument.array.len();
        let cube = DataCube::new(instrument, (0..count).map(|_| random.complex()).collect()).unwrap();
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let options = ReconstructOptions::new(Method::Backprojection, Window::None);
            pool.install(|| reconstruct(&cube, &grid(), &options).unwrap().volume.samples)
        };
        assert_eq!(run(1), run(5));
    }
}

/// Sharpness `N ΣI²/(ΣI)²` of powers I, and their mean away from the points, in dB against the largest.
fn quality(volume: &holosonar::grid::Volume, points: &[DVec3]) -> [f64; 2] {
    let power: Vec<f64> = volume.samples.iter().map(|a| f64::from(a.norm_sqr())).collect();
    let sum: f64 = power.iter().sum();
    let sharpness = power.len() as f64 * power.iter().map(|p| p * p).sum::<f64>() / (sum * sum);
    let far = |voxel: usize| points.iter().all(|p| p.distance(position_of(&volume.grid, voxel)) > 0.12);
    let background: Vec<f64> = (0..power.len()).filter(|v| far(*v)).map(|v| power[v]).collect();
    let mean = background.iter().sum::<f64>() / background.len() as f64;
    [sharpness, 10.0 * (mean / power.iter().copied().fold(0.0, f64::max)).log10()]
}

/// 8 x 8 microphones with 16 loudspeakers see what 32 x 32 do with one.
#[test]
fn sixteen_sources_fill_a_small_array() {
    let points = [DVec3::new(0.1, -0.05, 1.0), DVec3::new(-0.16, 0.12, 1.05), DVec3::new(0.0, 0.2, 0.95)];
    let sweep = Sweep::stepped(10_000.0, 20_000.0, 400.0).unwrap();
    let pitch = 0.02;
    let square = |n: usize| MicArray::rectangular([n; 2], [pitch; 2], DVec3::ZERO).unwrap();
    let sources = MicArray::rectangular([4; 2], [8.0 * pitch; 2], DVec3::ZERO).unwrap();
    let small = Instrument::new(sweep.clone(), square(8));
    let several = small.clone().with_sources(sources.positions()).unwrap();
    let large = Instrument::new(sweep, square(32));
    let reflectors = Reflectors::new(points.to_vec(), vec![Complex32::ONE; 3]).unwrap();
    let lateral = Axis { first: -0.3, pitch: 0.015, count: 41 };
    let grid = Grid { x: lateral, y: lateral, z: Axis { first: 0.93, pitch: 0.01, count: 15 } };
    let options = ReconstructOptions::new(Method::Convolution, Window::None);
    let [few, full, alone] = [&several, &large, &small].map(|instrument| {
        let cube = simulate(&reflectors, instrument, &SimulateOptions::default()).unwrap();
        quality(&reconstruct(&cube, &grid, &options).unwrap().volume, &points)
    });
    println!("8 x 8 with 16: {few:.1?}; 32 x 32 with one: {full:.1?}; 8 x 8 with one: {alone:.1?}");
    assert!((few[0] / full[0] - 1.0).abs() < 0.25, "sharpness {few:?} {full:?}");
    assert!((few[1] - full[1]).abs() < 1.5, "background {few:?} {full:?}");
    assert!(alone[0] < 0.5 * full[0], "8 x 8 microphones alone are blurred: {alone:?}");
}

/// A folder with a scene of two points, seen by several loudspeakers.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("points.csv"), "x,y,z,amplitude\n0.03,-0.02,0.8,1\n-0.06,0.05,0.85,1\n")
        .unwrap();
    let run = "
        [scene]
        mesh = \"points.csv\"
        [sweep]
        start = 10000.0
        stop = 14000.0
        step = 200.0
        [array]
        count = [6, 6]
        pitch = 0.02
        sources = [[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.15, 0.0]]
        [grid]
        x = [-0.1, 0.1]
        y = [-0.1, 0.1]
        z = [0.75, 0.9]
        pitch = [0.02, 0.02, 0.01]
        [output]
        formats = [\"npz\"]
    ";
    fs::write(folder.path().join("r.toml"), run).unwrap();
    folder
}

fn volume(path: &Path) -> Vec<Complex32> {
    read_volume_npz(path, 1 << 30).unwrap().0.samples
}

#[test]
fn a_run_file_of_several_speakers_goes_all_the_way() {
    let folder = workplace();
    let path = folder.path();
    let plan = done(path, "plan r.toml");
    assert_names(&plan, &["seen as", "108 microphones", "3 speakers x 21 frequencies x 36 microphones"]);
    done(path, "simulate r.toml -o c.npz -q");
    done(path, "simulate r.toml -o d.npz -q -j 1");
    assert_eq!(fs::read(path.join("c.npz")).unwrap(), fs::read(path.join("d.npz")).unwrap());
    let facts = done_json(path, "info c.npz");
    assert_eq!(facts["speakers"], 3);
    assert_eq!(facts["sources_m"][2], serde_json::json!([0.0, 0.15, 0.0]));
    // From the scene, from its cube, and from the library: the same volume.
    done(path, "image r.toml -o scene -q");
    done(path, "image c.npz -c r.toml -o cube -q");
    done(path, "reconstruct c.npz -c r.toml -o v.npz -q");
    let cube = DataCube::read(&path.join("c.npz"), 1 << 30).unwrap();
    let read = volume(&path.join("v.npz"));
    let axis = |first, last, pitch| Axis::spanning(first, last, pitch).unwrap();
    let lateral = axis(-0.1, 0.1, 0.02);
    let grid = Grid { x: lateral, y: lateral, z: axis(0.75, 0.9, 0.01) };
    let direct = reconstruct(&cube, &grid, &ReconstructOptions::new(Method::Direct, Window::None)).unwrap();
    assert!(relative_difference(&read, &direct.volume.samples) < 1e-3);
    assert!(direct.volume.peak() > 0.7, "{}", direct.volume.peak());
    for folder in ["scene", "cube"] {
        assert_eq!(volume(&path.join(folder).join("volume.npz")), read);
        let report = json_file(&path.join(folder).join("report.json"));
        assert_eq!(report["plan"]["transmissions"], 3);
    }
    let depth = done_json(path, "info scene/depth.exr");
    assert!(depth["attributes"]["sonar:sources"].is_string(), "{depth}");
    // The depth map knows how sharply all of them see together.
    done(path, "depth v.npz -o depth.exr -q");
}

#[test]
fn a_run_file_of_a_pair_goes_all_the_way() {
    let folder = workplace();
    let path = folder.path();
    let pair = "--set array.geometry=pair --set array.source_offset=[0.05,0,0]";
    let text = fs::read_to_string(path.join("r.toml")).unwrap();
    let without: Vec<&str> = text.lines().filter(|line| !line.contains("sources")).collect();
    fs::write(path.join("p.toml"), without.join("\n")).unwrap();
    done(path, &format!("simulate p.toml -o p.npz -q {pair}"));
    let facts = done_json(path, "info p.npz");
    assert_eq!((&facts["geometry"], &facts["speakers"]), (&"pair".into(), &1.into()));
    let plan = done(path, &format!("plan p.toml {pair}"));
    assert_names(&plan, &["seen as", "6 x 6 microphones", "* convolution"]);
    assert!(!plan.contains("not used: "), "{plan}");
    let grid = "--set grid.x=[-0.1,0.1] --set grid.y=[-0.1,0.1] --set grid.z=[0.75,0.9] --set grid.pitch=[0.02,0.02,0.01]";
    done(path, &format!("image p.npz -o out -q {grid} --set 'output.formats=[\"npz\"]'").replace('\'', ""));
    let report = json_file(&path.join("out/report.json"));
    assert!(report["peak_amplitude"].as_f64().unwrap() > 0.8);
    assert_eq!(report["method"], "convolution");
    // By every method.
    for method in ["direct", "backprojection"] {
        done(path, &format!("image p.npz -o {method} -q {grid} --set reconstruct.method={method}"));
        let found = volume(&path.join("out/volume.npz"));
        assert!(relative_difference(&volume(&path.join(method).join("volume.npz")), &found) < 1e-3);
    }
}

/// Pairs about a common midpoint, and a sparse part of all pairs, from a file and by import.
#[test]
fn pairs_that_differ_go_all_the_way() {
    let folder = workplace();
    let path = folder.path();
    let (mut microphones, mut speakers) = ("x,y,z\n".to_owned(), "x,y,z\n".to_owned());
    for i in 0..24 {
        let t = f64::from(i) * 0.01;
        writeln!(microphones, "{},{},0", 0.02 + t, 0.1 - 0.5 * t).unwrap();
        // Every third is of another speaker that stands still.
        let [x, y] = if i % 3 == 0 { [-0.1, 0.05] } else { [0.02 - t, 0.1 + 0.3 * t] };
        writeln!(speakers, "{x},{y},0").unwrap();
    }
    fs::write(path.join("mics.csv"), microphones).unwrap();
    fs::write(path.join("speakers.csv"), speakers).unwrap();
    let text = fs::read_to_string(path.join("r.toml")).unwrap();
    let without = ["sources", "count", "pitch = 0.02"];
    let kept: Vec<&str> = text.lines().filter(|line| !without.iter().any(|w| line.contains(w))).collect();
    let array = "[array]\ngeometry = \"pair\"\nsource_file = \"speakers.csv\"\nlayout = \"file\"\nfile = \"mics.csv\"";
    fs::write(path.join("p.toml"), kept.join("\n").replace("[array]", array)).unwrap();
    assert_names(done(path, "plan p.toml"), &["seen as", "24 microphones", "not used: pairs that are not"]);
    done(path, "simulate p.toml -o p.npz -q");
    done(path, "simulate p.toml -o q.npz -q -j 1");
    assert_eq!(fs::read(path.join("p.npz")).unwrap(), fs::read(path.join("q.npz")).unwrap());
    let facts = done_json(path, "info p.npz");
    assert_eq!((&facts["geometry"], &facts["pairs"]), (&"pair".into(), &24.into()));
    assert!(facts["source_offset_m"].is_null());
    let health = done_json(path, "info p.npz --health");
    assert!(health.is_object(), "{health}");
    // From the scene, from its cube, and as written.
    done(path, "image p.toml -o scene -q");
    done(path, "image p.npz -c p.toml -o cube -q");
    let cube = DataCube::read(&path.join("p.npz"), 1 << 24).unwrap();
    let found = volume(&path.join("scene/volume.npz"));
    assert_eq!(volume(&path.join("cube/volume.npz")), found);
    let axis = |first, last, pitch| Axis::spanning(first, last, pitch).unwrap();
    let lateral = axis(-0.1, 0.1, 0.02);
    let grid = Grid { x: lateral, y: lateral, z: axis(0.75, 0.9, 0.01) };
    let options = ReconstructOptions::new(Method::Direct, Window::None);
    let direct = reconstruct(&cube, &grid, &options).unwrap().volume;
    assert!(relative_difference(&found, &direct.samples) < 1e-3);
    done(path, "depth cube/volume.npz -o depth.exr -q");
    // The samples of the cube, `[f, pair]`, by import.
    let samples: Vec<u8> =
        cube.samples.iter().flat_map(|m| [m.re, m.im]).flat_map(f32::to_le_bytes).collect();
    let header = "{'descr': '<c8', 'fortran_order': False, 'shape': (21, 24), }";
    let header = format!("{header:<117}\n");
    let bytes =
        [b"\x93NUMPY\x01\x00".as_slice(), &118_u16.to_le_bytes(), header.as_bytes(), &samples].concat();
    fs::write(path.join("s.npy"), bytes).unwrap();
    let import = "[import]\nsamples = \"s.npy\"\naxes = [\"f\", \"pair\"]\nsources = \"speakers.csv\"\nphase_sign = 1\n\
                  [sweep]\nstart = 10e3\nstop = 14e3\nstep = 200\n[array]\nlayout = \"file\"\nfile = \"mics.csv\"\n\
                  [medium]\nsound_speed = 343.0\n";
    fs::write(path.join("i.toml"), import).unwrap();
    done(path, "import i.toml -o i.npz -q");
    let imported = DataCube::read(&path.join("i.npz"), 1 << 24).unwrap();
    assert_eq!(imported.instrument, cube.instrument);
    assert_eq!(imported.samples, cube.samples);
    // What cannot take them says so.
    refused(path, "image p.npz -c p.toml -o out --set refine.method=fista", 2, &["pair", "convolution"]);
    refused(path, "image p.npz -c p.toml -o out --set reconstruct.method=convolution", 2, &["pair"]);
    fs::write(path.join("speakers.csv"), "x,y,z\n0,0,0\n").unwrap();
    refused(path, "simulate p.toml -o out.npz", 2, &["[array] source_file", "1", "24"]);
}

#[test]
fn what_takes_one_speaker_says_so() {
    let folder = workplace();
    let path = folder.path();
    done(path, "simulate r.toml -o c.npz -q");
    refused(path, "image c.npz -c r.toml -o out --set array.source=[0,0,1]", 2, &["array.source", "3"]);
}

#[test]
fn several_speakers_are_refined_together() {
    let folder = workplace();
    let path = folder.path();
    done(path, "image r.toml -o plain -q");
    done(path, "image r.toml -o refined -q --set refine.method=fista");
    let report = json_file(&path.join("refined/report.json"));
    assert_eq!((&report["method"], &report["plan"]["transmissions"]), (&"convolution".into(), &3.into()));
    assert!(report["refinement"]["misfit"].as_f64().unwrap() < 0.5, "{}", report["refinement"]);
    let [plain, refined] = ["plain", "refined"].map(|name| volume(&path.join(name).join("volume.npz")));
    assert!(relative_difference(&refined, &plain) > 0.01);
}

/// Speakers and microphones that differ, measured with a target and divided out of the scene.
#[test]
fn responses_of_several_speakers_are_measured_and_divided_out() {
    let folder = workplace();
    let path = folder.path();
    fs::write(path.join("ball.csv"), "x,y,z,amplitude\n0.02,0.01,0.9,1\n").unwrap();
    done(path, "simulate r.toml -o scene.npz -q");
    done(path, "simulate r.toml -o ball.npz -q --set scene.mesh=ball.csv");
    let read = |name: &str| DataCube::read(&path.join(name), 1 << 24).unwrap();
    for name in ["scene", "ball"] {
        let mut cube = read(&format!("{name}.npz"));
        let (n_mic, all) = (cube.instrument.array.len(), cube.samples.len());
        for (i, m) in cube.samples.iter_mut().enumerate() {
            let (tx, r) = (i / (all / 3), i % n_mic);
            let error =
                |k: usize, of: f64| Complex32::from_polar(0.6 + 0.3 * (k % 3) as f32, (of * k as f64) as f32);
            *m *= error(tx + 1, 1.9) * error(r, 2.7);
        }
        cube.write(&path.join(format!("wrong_{name}.npz"))).unwrap();
    }
    let measured =
        done_json(path, "calibrate --reference wrong_ball.npz --at 0.02,0.01,0.9 --per all -o all.npz");
    assert_eq!((&measured["speakers"], &measured["microphones"]), (&3.into(), &36.into()));
    assert!(measured["explained"].as_f64().unwrap() > 0.9999, "{measured}");
    let facts = done_json(path, "info all.npz");
    assert_eq!(facts["speakers"]["count"], 3);
    done(path, "calibrate wrong_scene.npz -o mended.npz -q --set calibration.response=all.npz");
    let (right, mended) = (read("scene.npz"), read("mended.npz"));
    // But for a factor of all.
    let scale = mended.samples[7] / right.samples[7];
    let scaled: Vec<Complex32> = right.samples.iter().map(|m| m * scale).collect();
    assert!(relative_difference(&mended.samples, &scaled) < 1e-4);
    // Without the speakers something is left.
    let both =
        done_json(path, "calibrate --reference wrong_ball.npz --at 0.02,0.01,0.9 --per both -o both.npz");
    assert!(both["explained"].as_f64().unwrap() < 0.9, "{both}");
    done(path, "simulate r.toml -o one.npz -q --set array.source=[0.1,0,0]");
    refused(path, "calibrate one.npz -o out.npz --set calibration.response=all.npz", 2, &["3 speakers", "1"]);
    refused(
        path,
        "calibrate --reference one.npz --at 0,0,1 --per speaker -o out.npz",
        2,
        &["--per", "one speaker"],
    );
}

#[test]
fn cubes_of_several_speakers_are_examined_and_corrected() {
    let folder = workplace();
    let path = folder.path();
    done(path, "simulate r.toml -o c.npz -q");
    let health = done_json(path, "info c.npz --health -o out");
    assert_eq!(health, json_file(&path.join("out/health.json")));
    assert_eq!(health["transmissions"].as_array().map(Vec::len), Some(3));
    // A panel of levels, and one for each of them.
    let height = |png: &str| {
        let bytes = fs::read(path.join(png)).unwrap();
        u32::from_be_bytes(bytes[20..24].try_into().unwrap())
    };
    done(path, "simulate r.toml -o one.npz -q --set array.source=[0.1,0,0]");
    done(path, "info one.npz --health -o of_one");
    assert!(height("out/health.png") > height("of_one/health.png") * 3 / 2);
    assert_names(done(path, "info c.npz --health"), &["speakers", "level", "nothing is wrong"]);
    done(path, "calibrate c.npz -o d.npz -q --set calibration.delay=0.1");
    let read = |name: &str| DataCube::read(&path.join(name), 1 << 24).unwrap();
    assert_eq!(read("d.npz").instrument, read("c.npz").instrument);
    assert!(relative_difference(&read("d.npz").samples, &read("c.npz").samples) > 0.5);
    done(path, "calibrate d.npz -o e.npz -q --set calibration.delay=-0.1");
    assert!(relative_difference(&read("e.npz").samples, &read("c.npz").samples) < 1e-5);
    // What `image` corrects is what `calibrate` writes.
    done(path, "image d.npz -c r.toml -o of_d -q --set calibration.delay=-0.1");
    done(path, "image e.npz -c r.toml -o of_e -q");
    let samples = |name: &str| read_volume_npz(&path.join(name).join("volume.npz"), 1 << 24).unwrap().0;
    assert_eq!(samples("of_d"), samples("of_e"));
}
