//! `import`, from files as laboratories write them, to an image.

use crate::binary::{done, done_json, json, refused, run};
use crate::named::assert_names;
use holosonar::acquisition::DataCube;
use holosonar::export::volume_npz::read_volume_npz;
use num_complex::Complex32;
use std::fmt::Write;
use std::fs;
use std::path::Path;

/// What `[sweep]` and `[array]` say of the small cube, as options.
const SWEEP: &str = "--set sweep.start=10000 --set sweep.stop=12000 --set sweep.step=500";
const ARRAY: &str = "--set array.count=[7,5] --set array.pitch=0.02";

/// A folder with a simulated cube of 5 frequencies and 7 x 5 microphones.
fn workplace() -> (tempfile::TempDir, DataCube) {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("one.csv"), "x,y,z,amplitude\n0.02,-0.02,0.8,1\n").unwrap();
    done(folder.path(), &format!("simulate one.csv -o cube.npz {SWEEP} {ARRAY}"));
    let cube = DataCube::read(&folder.path().join("cube.npz"), 1 << 24).unwrap();
    (folder, cube)
}

/// Writes numbers as `numpy.save` does.
fn save(path: &Path, kind: &str, shape: &str, numbers: &[u8]) {
    let text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let head =
        [b"\x93NUMPY\x01\x00".as_slice(), &(text.len() as u16).to_le_bytes(), text.as_bytes()].concat();
    fs::write(path, [&head, numbers].concat()).unwrap();
}

/// The cube's samples with the axes [x, y, f, iq], in double precision, big-endian.
fn save_xyf(path: &Path, cube: &DataCube) {
    let mut numbers = Vec::new();
    for x in 0..7 {
        for y in 0..5 {
            for f in 0..5 {
                let m = cube.samples[f * 35 + y * 7 + x];
                numbers.extend(f64::from(m.re).to_be_bytes());
                numbers.extend(f64::from(m.im).to_be_bytes());
            }
        }
    }
    save(path, ">f8", "(7, 5, 5, 2)", &numbers);
}

#[test]
fn an_array_becomes_the_cube_that_it_was() {
    let (folder, cube) = workplace();
    let path = folder.path();
    save_xyf(&path.join("scan.npy"), &cube);
    let axes = "--set import.axes=[\"x\",\"y\",\"f\",\"iq\"]";
    let facts = done_json(path, &format!("import scan.npy -o again.npz {axes} {SWEEP} {ARRAY}"));
    let again = DataCube::read(&path.join("again.npz"), 1 << 24).unwrap();
    assert_eq!((&again.samples, &again.instrument), (&cube.samples, &cube.instrument));
    assert_eq!(
        (&facts["frequencies"], &facts["microphones"], &facts["phase_sign"]),
        (&5.into(), &35.into(), &1.into())
    );
    assert_names(facts["guesses"].to_string(), &["343", "phase_sign = 1", "speaker"]);
    let info = done_json(path, "info again.npz");
    assert_eq!(info["provenance"]["import"]["axes"], json("[\"x\", \"y\", \"f\", \"iq\"]"));
    // The same from a run file elsewhere, whose files are relative to it.
    fs::create_dir(path.join("lab")).unwrap();
    fs::rename(path.join("scan.npy"), path.join("lab/scan.npy")).unwrap();
    let text = "[import]\nsamples = \"scan.npy\"\naxes = [\"x\", \"y\", \"f\", \"iq\"]\nphase_sign = 1\n[sweep]\nstart = 10e3\n\
                stop = 12e3\nstep = 500\n[array]\ncount = [7, 5]\npitch = 0.02\nsource = [0, 0, 0]\n[medium]\n\
                sound_speed = 343\n";
    fs::write(path.join("lab/run.toml"), text).unwrap();
    let said = done(path, "import lab/run.toml -o third.npz");
    assert_names(&said, &["frequencies", "wrote third.npz", "lab/scan.npy"]);
    assert!(!said.contains("guessed"), "everything was said: {said}");
    assert_eq!(DataCube::read(&path.join("third.npz"), 1 << 24).unwrap().samples, cube.samples);
    // Nothing of it is in other results.
    assert!(done_json(path, "info lab/run.toml")["resolved"]["import"]["samples"].is_array());
    assert!(!done(path, "info cube.npz --json").contains("import"));
}

#[test]
fn touchstone_files_by_their_names_become_a_cube() {
    let (folder, cube) = workplace();
    let path = folder.path();
    fs::create_dir(path.join("scan")).unwrap();
    for mic in 0..35 {
        let mut text = "! VNA\n# kHz S RI R 50\n".to_owned();
        for f in 0..5 {
            let m = cube.samples[f * 35 + mic].conj();
            writeln!(text, "{} 0 0 {} {} 0 0 0 0", 10.0 + 0.5 * f as f64, m.re, m.im).unwrap();
        }
        fs::write(path.join(format!("scan/x{}_y{}.s2p", 2 * (mic % 7), 2 * (mic / 7))), text).unwrap();
    }
    let words = "import scan/x{x}_y{y}.s2p -o s.npz --set import.name_unit=cm --set array.centre=[0,0,0]";
    let facts = done_json(path, words);
    assert_eq!((&facts["phase_sign"], &facts["parameter"]), (&(-1).into(), &"S21".into()));
    assert_eq!(facts["array_shape"], json("[5, 7]"));
    let read = DataCube::read(&path.join("s.npz"), 1 << 24).unwrap();
    assert!(read.samples.iter().zip(&cube.samples).all(|(a, b)| (a - b).norm() < 1e-6));
    refused(path, "import scan -o s.npz", 2, &["scan", "folder", "x{x}_y{y}.s2p"]);
    refused(path, "import scan/x{x}_y{y}.s2p -o t.npz", 2, &["name_unit", "unit"]);
    assert!(!path.join("t.npz").exists());
    let other = "import scan/x{x}_y{y}.s2p -o t.npz --set import.name_unit=cm --set import.parameter=S31";
    refused(path, other, 2, &["x0_y0.s2p", "S31", "2 ports"]);
}

#[test]
fn what_cannot_be_known_is_refused() {
    let (folder, cube) = workplace();
    let path = folder.path();
    save_xyf(&path.join("scan.npy"), &cube);
    let import = |more: &str| format!("import scan.npy -o a.npz {more}");
    refused(path, &import(ARRAY), 2, &["[sweep]", "start, stop and step"]);
    // A default is no measurement.
    refused(path, &import(&format!("{ARRAY} --set sweep.step=500")), 2, &["[sweep]"]);
    refused(path, &import(SWEEP), 2, &["[array]", "pitch"]);
    refused(path, &import(&format!("{SWEEP} {ARRAY}")), 2, &["scan.npy", "ways", "axes ="]);
    let both =
        format!("{SWEEP} {ARRAY} --set detection.kind=in-phase --set import.axes=[\"x\",\"y\",\"f\",\"iq\"]");
    refused(path, &import(&both), 2, &["[detection] kind", "complex"]);
    refused(path, &import("--set import.samples=b.npy"), 2, &["import.samples"]);
    refused(path, &import("--set import.axes=[\"x\",\"z\"]"), 2, &["import.axes", "z"]);
    refused(path, &import("--set import.offset=middle"), 2, &["import.offset", "\"mean\""]);
    refused(path, &import("--set import.phase_sign=2"), 2, &["import.phase_sign", "-1"]);
    refused(path, &import("--set import.columns=[\"f\",\"re\",\"db\"]"), 2, &["import.columns", "db, deg"]);
    refused(path, "import scan.npy -o scan.npy", 2, &["scan.npy", ".npz"]);
    refused(path, "import cube.npz -o cube.npz", 2, &["cube.npz"]);
    refused(path, "import gone.npy -o a.npz", 2, &["gone.npy"]);
    save(&path.join("adc.npy"), "<u2", "(7, 5, 5)", &[0, 8].repeat(175));
    let axes = "--set import.axes=[\"x\",\"y\",\"f\"]";
    refused(
        path,
        &format!("import adc.npy -o a.npz {axes} {SWEEP} {ARRAY}"),
        2,
        &["adc.npy", "unsigned", "offset"],
    );
    assert!(!path.join("a.npz").exists());
    let mean = format!("import adc.npy -o a.npz {axes} {SWEEP} {ARRAY} --set import.offset=mean --json");
    let ran = run(path, &mean);
    assert_eq!(json(&ran.stdout)["offset"], 2048.0, "{}", ran.stderr);
}

/// Samples of a cube in single precision, for a header with this shape.
fn save_samples(path: &Path, shape: &str, samples: &[Complex32]) {
    let parts = samples.iter().flat_map(|m| [m.re, m.im]).flat_map(f32::to_le_bytes);
    save(path, "<c8", shape, &parts.collect::<Vec<_>>());
}

/// Three speakers in one array, in files of their own and as a list of microphones' files: always the cube that was simulated.
#[test]
fn several_speakers_become_the_cube_that_was_simulated() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    fs::write(path.join("one.csv"), "x,y,z,amplitude\n0.02,-0.02,0.8,1\n").unwrap();
    fs::write(path.join("speakers.csv"), "x,y,z\n0,0,0\n0.2,0,0\n0,-0.1,0.05\n").unwrap();
    let sources = "--set array.sources=[[0,0,0],[0.2,0,0],[0,-0.1,0.05]]";
    done(path, &format!("simulate one.csv -o cube.npz {SWEEP} {ARRAY} {sources}"));
    let read = |name: &str| DataCube::read(&path.join(name), 1 << 24).unwrap();
    let cube = read("cube.npz");
    fs::write(path.join("lab.toml"), "[import]\nsamples = \"all.npy\"\n").unwrap();
    save_samples(&path.join("all.npy"), "(3, 5, 5, 7)", &cube.samples);
    for tx in 0..3 {
        save_samples(&path.join(format!("s{tx}.npy")), "(5, 5, 7)", cube.transmission(tx));
        fs::create_dir(path.join(format!("s{tx}"))).unwrap();
        for mic in 0..35 {
            let text = (0..5).fold("f,re,im\n".to_owned(), |text, f| {
                let m = cube.transmission(tx)[f * 35 + mic];
                text + &format!("{},{},{}\n", 10_000 + 500 * f, m.re, m.im)
            });
            fs::write(path.join(format!("s{tx}/m{mic}.csv")), text).unwrap();
        }
    }
    let axes = |axes: &str| format!("--set import.axes={axes}");
    let in_file = "--set import.sources=speakers.csv";
    let lists = "--set import.samples=[\"s0.npy\",\"s1.npy\",\"s2.npy\"]";
    let patterns = "--set import.samples=[\"s0/m{i}.csv\",\"s1/m{i}.csv\",\"s2/m{i}.csv\"]";
    let list = "--set array.count=[35,1] --set array.pitch=0.02";
    for (given, said) in [
        (format!("{sources} {ARRAY} {}", axes("[\"tx\",\"f\",\"y\",\"x\"]")), ""),
        (format!("{in_file} {ARRAY} {}", axes("[\"tx\",\"f\",\"y\",\"x\"]")), ""),
        (format!("{sources} {ARRAY} {lists} {}", axes("[\"f\",\"y\",\"x\"]")), "1 of them for each speaker"),
        (format!("{in_file} {ARRAY} {lists} {}", axes("[\"f\",\"y\",\"x\"]")), "1 of them for each speaker"),
        (format!("{in_file} {list} {patterns}"), "1 of them for each speaker"),
    ] {
        let facts = done_json(path, &format!("import lab.toml -o again.npz {SWEEP} {given}"));
        let again = read("again.npz");
        assert_eq!(again.samples, cube.samples, "{given}");
        assert_eq!(again.instrument.sources(), cube.instrument.sources());
        assert_eq!((&facts["speakers"], &facts["sources_m"][2]), (&3.into(), &json("[0.0, -0.1, 0.05]")));
        assert!(facts["guesses"].to_string().contains(said), "{facts}");
        if !given.contains("m{i}") {
            assert_eq!(again.instrument, cube.instrument);
        }
    }
    let grid = "--set grid.x=[-0.04,0.04] --set grid.y=[-0.04,0.04] --set grid.z=[0.75,0.85] --set grid.pitch=[0.01,0.01,0.01]";
    done(
        path,
        &format!(
            "import all.npy -o again.npz {SWEEP} {ARRAY} {in_file} {}",
            axes("[\"tx\",\"f\",\"y\",\"x\"]")
        ),
    );
    done(path, &format!("reconstruct again.npz -o again_v.npz -q {grid}"));
    done(path, &format!("reconstruct cube.npz -o cube_v.npz -q {grid}"));
    let volume = |name: &str| read_volume_npz(&path.join(name), 1 << 24).unwrap().0;
    assert_eq!(volume("again_v.npz"), volume("cube_v.npz"));
}

#[test]
fn speakers_and_samples_must_agree() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    for (name, shape, count) in
        [("all.npy", "(3, 5, 5, 7)", 525), ("a.npy", "(5, 5, 7)", 175), ("b.npy", "(4, 5, 7)", 140)]
    {
        save_samples(&path.join(name), shape, &vec![Complex32::ONE; count]);
    }
    fs::write(path.join("none.csv"), "x,y,z\n").unwrap();
    fs::write(path.join("lab.toml"), "[import]\nsamples = \"all.npy\"\n").unwrap();
    save(&path.join("flat.npy"), "<f8", "(3, 2)", &[0; 48]);
    let all = "--set import.axes=[\"tx\",\"f\",\"y\",\"x\"]";
    let one = "--set import.axes=[\"f\",\"y\",\"x\"]";
    let two = "--set array.sources=[[0,0,0],[1,0,0]]";
    let three = "--set array.sources=[[0,0,0],[1,0,0],[0,1,0]]";
    for (given, parts) in [
        (all.to_owned(), vec!["[import] axes", "\"tx\"", "where the speakers were", "[array]"]),
        (format!("{all} {two}"), vec!["all.npy", "\"tx\"", "3 long", "2 was expected"]),
        (format!("{one} {three}"), vec!["all.npy", "[3, 5, 5, 7]", "names 3 axes"]),
        (two.to_owned(), vec!["all.npy", "2 loudspeakers", "5 frequencies"]),
        (
            format!("{one} {three} --set import.samples=a.npy"),
            vec!["a.npy", "no axis \"tx\"", "3 loudspeakers", "files"],
        ),
        (format!("{one} {two} --set import.samples=[\"a.npy\",\"b.npy\"]"), vec!["b.npy", "\"f\"", "4 long"]),
        (
            format!("{three} --set import.samples=[\"a.csv\",\"b.csv\"]"),
            vec!["[import] samples", "2 files", "3 speakers"],
        ),
        (format!("{all} --set array.geometry=monostatic"), vec!["[array] geometry", "scan", "\"tx\""]),
        (format!("{all} --set import.sources=none.csv"), vec!["none.csv"]),
        (format!("{all} --set import.sources=flat.npy"), vec!["[import] sources", "[3, 2]", "[n, 3]"]),
        (format!("{all} --set import.sources=speakers"), vec!["[import] sources", ".npz", ".csv"]),
    ] {
        refused(path, &format!("import lab.toml -o x.npz {SWEEP} {ARRAY} {given}"), 2, &parts);
    }
    assert!(!path.join("x.npz").exists());
    let text = "[import]\nsamples = \"all.npy\"\nsources = \"s.csv\"\n[array]\nsource = [1, 0, 0]\n";
    fs::write(path.join("both.toml"), text).unwrap();
    refused(path, "import both.toml -o x.npz", 2, &["[import] sources", "array.source", "keep one"]);
}

#[test]
fn positions_by_formulas_are_those_of_the_array() {
    let (folder, cube) = workplace();
    let path = folder.path();
    save_samples(&path.join("scan.npy"), "(5, 5, 7)", &cube.samples);
    let formulas = |y: &str| format!("--set import.positions={{x=\"0.02*(ix-3)\",y=\"{y}\"}}");
    let import = |y: &str, more: &str| {
        let axes = "--set import.axes=[\"f\",\"y\",\"x\"]";
        format!("import scan.npy -o again.npz {SWEEP} {axes} {more} {}", formulas(y))
    };
    let facts = done_json(path, &import("0.02*iy-0.04", "--set array.count=[7,5]"));
    assert_eq!(facts["positions_from"], "formulas");
    let again = DataCube::read(&path.join("again.npz"), 1 << 24).unwrap();
    assert_eq!(again.samples, cube.samples);
    let [own, found] = [&cube, &again].map(|cube| cube.instrument.array.clone());
    assert!(found.lattice().is_some());
    assert!(own.positions().iter().zip(found.positions()).all(|(a, b)| a.distance(*b) < 1e-15));
    for (y, more, parts) in [
        ("0.02*iz", "--set array.count=[7,5]", ["formula of y", "`iz`", "ix, iy"]),
        ("0.02*", "--set array.count=[7,5]", ["formula of y", "no formula", ""]),
        ("1/iy", "--set array.count=[7,5]", ["[import] positions", "inf", "iy = 0"]),
        ("iy", "", ["[import] positions", "count", "[array]"]),
        ("iy", ARRAY, ["[import] positions", "array.pitch", "keep one"]),
    ] {
        refused(path, &import(y, more), 2, &parts);
    }
}
