//! Bad input through the binary: one paragraph that names the place, the right exit status, nothing left behind.

use crate::binary::{files_below, json, refused, run, shipped, small};
use crate::meshes::letter_glb;
use crate::named::assert_names;
use crate::support::{data, write_npz};
use num_complex::Complex32;
use std::fmt::Write;
use std::path::Path;

/// A folder with the given files in it.
fn folder_with(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    folder
}

/// `image` must refuse `words` with exit status 2 and leave no file in its output folder.
fn image_refuses(folder: &Path, words: &str, said: &[&str]) {
    refused(folder, &format!("image {words} -o out"), 2, said);
    assert_eq!(files_below(&folder.join("out")), Vec::<std::path::PathBuf>::new(), "{words}");
}

#[test]
fn inputs_that_are_not_there_or_something_else() {
    let folder = folder_with(&[("a.step", ""), ("notes.txt", "")]);
    for name in ["folder.toml", "folder.obj", "folder.csv", "folder.npz"] {
        std::fs::create_dir(folder.path().join(name)).unwrap();
        image_refuses(folder.path(), &format!("{name} --unit m"), &[name, "folder"]);
    }
    for name in ["none.toml", "none.obj", "none.gltf", "none.csv", "none.npz"] {
        image_refuses(folder.path(), &format!("{name} --set scene.occlusion=none"), &[name]);
    }
    for name in ["a.step", "notes.txt", "none", "out"] {
        image_refuses(folder.path(), name, &[name]);
    }
    refused(folder.path(), "info none.exr", 2, &["none.exr"]);
    refused(folder.path(), "depth none.npz -o d.exr", 2, &["none.npz"]);
    refused(folder.path(), "compare none.exr none.exr", 2, &["none.exr"]);
    refused(folder.path(), "check none.toml", 2, &["none.toml"]);
}

#[test]
fn run_files_with_mistakes() {
    for (text, said) in [
        ("[swep]\nstep = 20\n", &["run.toml:1", "[swep]", "[sweep]"][..]),
        ("[sweep]\nstpe = 20\n", &["run.toml:2", "`stpe`", "`step`"]),
        ("[sweep]\nstep = \"fast\"\n", &["run.toml:2", "`sweep.step`", "fast", "number"]),
        ("[sweep]\nstep = 20\nstep = 30\n", &["run.toml:3"]),
        ("[sweep\n", &["run.toml:1"]),
        ("[sweep]\nstep = nan\n", &["run.toml:2", "`sweep.step`"]),
        ("[sweep]\nstep = 30.0\n", &["run.toml:2", "`sweep.step`", "30", "333.3333"]),
        ("[scene]\nmesh = \"none.obj\"\nunit = \"m\"\nup = \"none\"\n", &["none.obj"]),
        ("[scene]\nmesh = \"\"\n", &["run.toml:2"]),
        ("[scene]\nmesh = \"a.obj\"\nunit = \"mile\"\n", &["run.toml:3", "mm"]),
        ("", &["[scene] mesh"]),
        ("[expect]\nbeauty = { min = 1 }\n", &["run.toml:2", "beauty"]),
        ("[grid]\nz = [-1.0, -0.5]\n", &["run.toml:2", "`grid.z`", "-1", "array"]),
        ("[grid]\nz = [2.0, 1.0]\n", &["run.toml:2"]),
    ] {
        let folder = folder_with(&[("run.toml", text)]);
        image_refuses(folder.path(), "run.toml", said);
    }
}

#[test]
fn numbers_beyond_reason() {
    let folder = tempfile::tempdir().unwrap();
    let point = shipped("point.toml");
    for (set, said) in [
        ("array.count=[4000000000,4000000000]", "array.count"),
        ("array.count=[4000000000,1]", "array"),
        ("array.count=[0,1]", "array.count"),
        ("array.count=[-1,1]", "array.count"),
        ("array.extent=[1e30,1e30]", "array"),
        ("array.pitch=[1e30,1e30]", "array"),
        ("array.centre=[0,0,1e30]", "array"),
        ("grid.pitch=[1e-12,1e-12,1e-12]", "grid"),
        ("grid.pitch=[0,1,1]", "grid.pitch"),
        ("grid.x=[-1e30,1e30]", "grid.x"),
        ("grid.x=[1e30,1e30]", "grid"),
        ("grid.count=[4000000000,4000000000,4000000000]", "grid"),
        ("grid.pitch=[1e-6,1e-6,1e-6]", "GiB"),
        ("grid.pitch=[4e-10,4e-10,1e-3]", "GiB"),
        ("sweep.step=1e-9", "sweep.step"),
        ("sweep.step=0.0", "sweep.step"),
        ("sweep.start=-1.0", "sweep.start"),
        ("sweep.stop=inf", "sweep.stop"),
        ("medium.sound_speed=0.0", "sound_speed"),
        ("depth.returns=4000000000", "depth.returns"),
        ("depth.median=2", "depth.median"),
        ("reflectors.spacing=-1.0", "reflectors.spacing"),
        ("reflectors.seed=-1", "reflectors.seed"),
        ("nonsense", "--set"),
    ] {
        image_refuses(folder.path(), &format!("{} --set {set}", point.display()), &[said]);
    }
    let corner = small("corner.toml");
    for (set, said) in [
        ("scene.scale=1e30", "1e9 m"),
        ("scene.translate=[1e300,0,0]", "1e9 m"),
        ("scene.rotate=[nan,0,0]", "scene.rotate"),
        ("reflectors.spacing=1e-9", "[reflectors] spacing"),
        ("scene.scale=0.0", "scene.scale"),
        ("scene.sensor=camera:A", "sensor"),
    ] {
        image_refuses(folder.path(), &format!("{} --set {set}", corner.display()), &[said]);
    }
    // Odd, but someone may mean them; they end soon and well.
    for set in ["medium.sound_speed=1e300", "depth.separation=1e300", "depth.smoothing=[1e9,1e9,1e9]"] {
        let ran = run(folder.path(), &format!("-q image {} -o odd --set {set}", point.display()));
        assert!(matches!(ran.status, 0 | 2), "{set}: {ran:?}");
    }
}

#[test]
fn options_that_make_no_sense() {
    let folder =
        folder_with(&[("file", ""), ("part.step", "ISO-10303-21;"), ("bare.toml", "[sweep]\nstep = 40.0\n")]);
    let (point, corner) = (shipped("point.toml"), small("corner.toml"));
    let (point, corner) = (point.display(), corner.display());
    let path = folder.path();
    image_refuses(path, &format!("{point} --threads 0"), &["--threads"]);
    image_refuses(path, &format!("{point} -c {corner}"), &["--config"]);
    refused(path, &format!("image {point} -o file"), 2, &["file", "folder"]);
    refused(path, &format!("image {point} -o file/below"), 2, &["file/below", "folder"]);
    refused(path, &format!("simulate {point} -o cube.xyz"), 2, &["cube.xyz", ".npz"]);
    refused(path, &format!("truth {corner} -o truth.jpg"), 2, &["truth.jpg", ".exr"]);
    refused(path, &format!("truth {point} -o truth.exr"), 2, &["point.csv", "depth"]);
    refused(path, &format!("truth {corner} -o {}", path.display()), 2, &["extension"]);
    refused(
        path,
        &format!("reconstruct {corner} -o v.npz"),
        2,
        &["corner.toml", "data cube", "simulate", "-c"],
    );
    refused(path, &format!("depth {corner} -o d.exr"), 2, &["corner.toml", "volume", "reconstruct"]);
    refused(path, "image . -o out", 2, &["folder", ".toml"]);
    refused(path, "image part.step -o out", 2, &["part.step", "FreeCAD", ".stl"]);
    refused(path, "simulate bare.toml -o c.npz", 2, &["bare.toml", "[scene] mesh"]);
    refused(path, "init part.step", 2, &["part.step", "folder"]);
    refused(path, "compare a.exr b.exr --min beauty=1", 2, &["--min", "beauty", "completeness"]);
    refused(path, "compare a.exr b.exr --max rmse=low", 2, &["--max", "rmse=low"]);
    let given = ["bare.toml", "file", "part.step"].map(|name| path.join(name));
    assert_eq!(files_below(path), given, "nothing is left behind");
}

#[cfg(unix)]
#[test]
fn a_place_that_cannot_be_written_is_an_io_error() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let locked = folder.path().join("locked");
    std::fs::create_dir(&locked).unwrap();
    std::fs::set_permissions(&locked, std::fs::Permissions::from_mode(0o555)).unwrap();
    if std::fs::write(locked.join("probe"), "").is_ok() {
        return; // This user may write anywhere.
    }
    let point = shipped("point.toml");
    refused(folder.path(), &format!("image {} -o locked/out", point.display()), 1, &["locked/out"]);
    refused(folder.path(), &format!("simulate {} -o locked/c.npz", point.display()), 1, &["locked/c.npz"]);
}

#[test]
fn meshes_with_mistakes() {
    let triangle = "v 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 3\n";
    for (text, options, said) in [
        ("v 0 0 1\nv nan 0 1\nv 0 1 1\nf 1 2 3\n", "--unit m", &["mesh.obj", "finite"][..]),
        ("v 0 0 1\nv 0 0 1\nv 0 1 1\nf 1 2 3\n", "--unit m", &["mesh.obj", "triangle"]),
        ("", "--unit m", &["mesh.obj", "triangle"]),
        ("v 0 0 1\n", "--unit m", &["mesh.obj", "triangle"]),
        (triangle, "", &["mesh.obj", "--unit", "mm (1.00 mm)"]),
        (triangle, "--unit parsec", &["unit", "parsec"]),
        ("v 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 9\n", "--unit m", &["mesh.obj", "line 4"]),
        ("v 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 x\n", "--unit m", &["mesh.obj", "line 4"]),
    ] {
        let folder = folder_with(&[("mesh.obj", text)]);
        image_refuses(folder.path(), &format!("mesh.obj {options}"), said);
        // `info` needs no unit.
        let status = if options.is_empty() { 0 } else { 2 };
        assert_eq!(run(folder.path(), &format!("info mesh.obj {options}")).status, status, "{text}");
    }
}

#[test]
fn truncated_files_are_noticed_at_every_length() {
    let gltf = std::fs::read(data("scenes/f.gltf")).unwrap();
    let cube = data("reference/forward_in_phase.npz");
    for (name, bytes, step) in
        [("a.gltf", gltf, 37), ("a.glb", letter_glb(), 37), ("a.npz", std::fs::read(cube).unwrap(), 1999)]
    {
        let folder = tempfile::tempdir().unwrap();
        let whole = bytes.trim_ascii_end().len();
        for length in (0..whole).step_by(step) {
            std::fs::write(folder.path().join(name), &bytes[..length]).unwrap();
            refused(folder.path(), &format!("info {name}"), 2, &[name]);
        }
        std::fs::write(folder.path().join(name), &bytes).unwrap();
        assert_eq!(run(folder.path(), &format!("info {name}")).status, 0, "{name} whole");
    }
}

/// Name, samples, their shape, frequencies, positions, `meta`, and the array that the error must name.
type Case<'a> = (&'a str, &'a [Complex32], &'a [usize], &'a [f64], &'a [f64], &'a str, &'a str);

#[test]
fn cubes_with_mistakes() {
    let frequencies = [10_000.0, 11_000.0, 12_000.0];
    let places = [0.0, 0.0, 0.0, 0.1, 0.0, 0.0];
    let good = [Complex32::ONE; 6];
    let mut nan = good;
    nan[4].im = f32::NAN;
    let cases: [Case; 10] = [
        ("shape", &good, &[2, 3], &frequencies, &places, "{}", "`samples`"),
        ("axes", &good, &[6], &frequencies, &places, "{}", "`samples`"),
        ("nan", &nan, &[3, 2], &frequencies, &places, "{}", "`samples`"),
        ("descending", &good, &[3, 2], &[3.0, 2.0, 1.0], &places, "{}", "`frequencies`"),
        ("silent", &good, &[3, 2], &[0.0, 1.0, 2.0], &places, "{}", "`frequencies`"),
        (
            "nowhere",
            &good,
            &[3, 2],
            &frequencies,
            &[0.0, 0.0, f64::NAN, 0.1, 0.0, 0.0],
            "{}",
            "`mic_positions`",
        ),
        ("odd", &good, &[3, 2], &frequencies, &places[..4], "{}", "`mic_positions`"),
        ("meta", &good, &[3, 2], &frequencies, &places, "no json", "`meta`"),
        ("speed", &good, &[3, 2], &frequencies, &places, r#"{"sound_speed": -1}"#, "`meta`"),
        ("real", &good, &[3, 2], &frequencies, &places, r#"{"detection": "in-phase"}"#, "`samples`"),
    ];
    let folder = tempfile::tempdir().unwrap();
    for (name, samples, shape, frequencies, places, meta, said) in cases {
        let file = format!("{name}.npz");
        let columns = if places.len() == 6 { 3 } else { 2 };
        write_npz(
            &folder.path().join(&file),
            &[
                ("samples", "<c8", shape, bytemuck::cast_slice(samples)),
                ("frequencies", "<f8", &[frequencies.len()], bytemuck::cast_slice(frequencies)),
                ("mic_positions", "<f8", &[places.len() / columns, columns], bytemuck::cast_slice(places)),
                ("meta", "|u1", &[meta.len()], meta.as_bytes()),
            ],
        );
        // With somewhere to look, so that nothing but the cube is at fault.
        let grid = "--set grid.x=[0,0.1] --set grid.y=[0,0.1] --set grid.z=[1,1.1]";
        image_refuses(folder.path(), &format!("{file} {grid}"), &[&file, said]);
    }
    // An array of Python objects, which only an interpreter could read.
    std::fs::copy(data("npz/object.npz"), folder.path().join("object.npz")).unwrap();
    image_refuses(folder.path(), "object.npz", &["object.npz", "`samples`"]);
}

#[test]
fn reflector_lists_with_mistakes() {
    for (text, said) in [
        ("", &["points.csv", "empty"][..]),
        ("0,0,1,1\n", &["points.csv:1"]),
        ("x,y,z\n0,0,1\n", &["points.csv:1"]),
        ("x,y,z,amplitude\n0,0,1\n", &["points.csv:2"]),
        ("x,y,z,amplitude\n0,0,1,1\n0,0,one,1\n", &["points.csv:3"]),
        ("x,y,z,amplitude\n0,0,1,nan\n", &["points.csv:2"]),
        ("x,y,z,amplitude\n0,0,1,1e300\n", &["points.csv:2"]),
        ("x,y,z,amplitude\n", &["points.csv", "reflectors"]),
        ("x,y,z,amplitude\n0,0,-1,1\n", &["[scene]", "array"]),
    ] {
        let folder = folder_with(&[("points.csv", text)]);
        image_refuses(folder.path(), "points.csv", said);
    }
}

#[test]
fn a_single_frequency_is_refused_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    // A step would be ignored with one frequency; the array and the grid would take minutes.
    let long = "--set sweep.stop=10000.0 --set array.count=[500,500] --set grid.pitch=[0.01,0.01,0.001]";
    for scene in ["point.toml", "corner.toml"] {
        image_refuses(folder.path(), &format!("{} {long}", small(scene).display()), &["bandwidth"]);
    }
    write_npz(
        &folder.path().join("tone.npz"),
        &[
            ("samples", "<c8", &[1, 2], bytemuck::cast_slice(&[Complex32::ONE; 2])),
            ("frequencies", "<f8", &[1], bytemuck::cast_slice(&[10_000.0])),
            ("mic_positions", "<f8", &[2, 3], bytemuck::cast_slice(&[0.0, 0.0, 0.0, 0.1, 0.0, 0.0])),
        ],
    );
    image_refuses(folder.path(), "tone.npz", &["bandwidth"]);
}

/// Runs `image` on a shipped scene; gives warnings and the number of pixels with a return.
fn images(scene: &str, options: &str) -> (String, u64) {
    let folder = tempfile::tempdir().unwrap();
    let ran = run(folder.path(), &format!("image {} -o out --json {options}", small(scene).display()));
    assert_eq!(ran.status, 0, "{options}: {}", ran.stderr);
    (ran.stderr, json(&ran.stdout)["accepted"].as_u64().unwrap())
}

#[test]
fn little_is_enough() {
    assert!(images("point.toml", "--set array.count=[1,1]").1 > 0);
    assert!(images("point.toml", "--set array.count=[1,11]").1 > 0);
    let one_voxel = "--set grid.x=[0.0,0.0] --set grid.y=[0.0,0.0] --set grid.z=[0.8,0.8]";
    assert_eq!(images("point.toml", one_voxel).1, 1);
    assert!(images("point.toml", "--set sweep.step=4000.0").1 > 0);
}

#[test]
fn scenes_that_cannot_be_seen_are_warned_about() {
    let coarse = "--set sweep.step=1000 --set grid.pitch=[0.06666666666666667,0.06666666666666667,0.05]";
    let (said, accepted) = images("corner.toml", &format!("--set scene.translate=[0,0,-5] {coarse}"));
    // The reflectors that are left out, and that nothing is accepted, each with the key to change.
    assert_names(said, &["array", "z <= 0", "[scene] translate", "[depth] confidence_db"]);
    assert_eq!(accepted, 0, "a silent cube has no returns");
    for away in ["[5,0,0]", "[0,0,1.5]"] {
        let (said, _) = images("corner.toml", &format!("--set scene.translate={away} {coarse}"));
        assert_names(said, &["warning: ", "outside", "grid"]);
    }
    let (said, _) = images("point.toml", "--set grid.z=[3.0,3.2]");
    assert_names(said, &["warning: ", "outside", "grid"]);
}

#[test]
fn a_speaker_in_or_on_a_wall_is_no_reason_to_fail() {
    // Walls: a box whose face contains the speaker, a box around it, and a triangle in front of it.
    let mut boxes = String::new();
    for (x, y, z) in [(-0.1, -0.1, -0.1), (-0.1, -0.1, 0.0)] {
        for i in 0..8 {
            let pick = |bit: i32, low: f64| if i & bit == 0 { low } else { low + 0.2 };
            writeln!(boxes, "v {} {} {}", pick(1, x), pick(2, y), pick(4, z)).unwrap();
        }
        for face in ["1 2 4 3", "5 6 8 7", "1 2 6 5", "3 4 8 7", "1 3 7 5", "2 4 8 6"] {
            let shifted = face.split(' ').map(|v| (v.parse::<i32>().unwrap() - 9).to_string());
            writeln!(boxes, "f {}", shifted.collect::<Vec<_>>().join(" ")).unwrap();
        }
    }
    boxes.push_str("v -0.3 -0.3 1\nv 0.3 -0.3 1\nv 0 0.3 1\nf -3 -2 -1\n");
    let folder = folder_with(&[("walls.obj", &boxes)]);
    let run_file = "[scene]\nmesh = \"walls.obj\"\nunit = \"m\"\nup = \"none\"\n[sweep]\nstep = 500.0\n[array]\ncount = [7, 7]\n\
                    [grid]\nx = [-0.3, 0.3]\ny = [-0.3, 0.3]\nz = [0.5, 1.2]\npitch = [0.05, 0.05, 0.02]\n";
    std::fs::write(folder.path().join("walls.toml"), run_file).unwrap();
    for source in ["[0.0,0.0,0.0]", "[0.0,0.0,0.05]", "[0.0,0.0,1.0]", "[0.1,0.1,0.1]"] {
        let ran = run(folder.path(), &format!("image walls.toml -o out --set array.source={source}"));
        assert_eq!(ran.status, 0, "{source}: {}", ran.stderr);
    }
}
