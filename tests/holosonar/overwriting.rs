//! No command replaces one of its inputs, or writes two results into one file; under whatever names they are given.

#![cfg(unix)]

use crate::binary::{done, files_below, refused, shipped};
use crate::support::data;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

/// A folder with inputs of every kind, each of which some command reads.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("meshes")).unwrap();
    for name in ["meshes/point.csv", "meshes/corner.obj", "meshes/bracket.obj", "meshes/bracket.mtl"] {
        fs::copy(shipped(name), path(name)).unwrap();
    }
    fs::copy(data("scenes/f.gltf"), path("meshes/f.gltf")).unwrap();
    write_buffered_gltf(&path("meshes"));
    write_ply(&path("meshes/m.ply"));
    fs::write(path("mics.csv"), "x,y,z\n-0.1,-0.1,0\n0.1,-0.1,0\n-0.1,0.1,0\n0.12,0.1,0\n").unwrap();
    let grid = "[grid]\nx = [-0.3, 0.3]\ny = [-0.3, 0.3]\nz = [0.6, 1.0]\npitch = [0.1, 0.1, 0.1]\n";
    let sweep = "[sweep]\nstart = 10000.0\nstop = 14000.0\nstep = 500.0\n";
    let scene = |name: &str, mesh: &str, array: &str| {
        let text = format!(
            "[scene]\nmesh = \"{mesh}\"\n{}{sweep}[array]\n{array}\n{grid}[reflectors]\nspacing = 0.1\n",
            match mesh.rsplit('.').next() {
                Some("obj") => "unit = \"mm\"\n",
                Some("ply") => "unit = \"m\"\n",
                _ => "",
            }
        );
        fs::write(path(name), text).unwrap();
    };
    let array = "count = [5, 5]\npitch = [0.05, 0.05]";
    scene("r.toml", "meshes/point.csv", array);
    scene("mics.toml", "meshes/point.csv", "layout = \"file\"\nfile = \"mics.csv\"");
    scene("obj.toml", "meshes/bracket.obj", array);
    scene("gltf.toml", "meshes/b.gltf", array);
    scene("ply.toml", "meshes/m.ply", array);
    done(folder.path(), "simulate r.toml -o c.npz -q");
    done(folder.path(), "reconstruct c.npz -c r.toml -o v.npz -q");
    done(folder.path(), "truth obj.toml -o t.exr -q");
    done(folder.path(), "image r.toml -o own -q");
    folder
}

/// One triangle, whose corners are in a file of their own.
fn write_buffered_gltf(folder: &Path) {
    let corners = [[-0.2f32, -0.2, 0.8], [0.2, -0.2, 0.8], [0.0, 0.2, 0.8]];
    let bytes: Vec<u8> = corners.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    fs::write(folder.join("b.bin"), bytes).unwrap();
    let text = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"buffers":[{"uri":"b.bin","byteLength":36}],
        "bufferViews":[{"buffer":0,"byteLength":36}],"accessors":[{"bufferView":0,"componentType":5126,"count":3,
        "type":"VEC3","min":[-0.2,-0.2,0.8],"max":[0.2,0.2,0.8]}]}"#;
    fs::write(folder.join("b.gltf"), text).unwrap();
}

fn write_ply(path: &Path) {
    let text = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                element face 1\nproperty list uchar int vertex_indices\nend_header\n\
                -0.2 -0.2 0.8\n0.2 -0.2 0.8\n0 0.2 0.8\n3 0 1 2\n";
    fs::write(path, text).unwrap();
}

/// Name and content of everything in a folder.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    files_below(folder).into_iter().map(|path| (path.clone(), fs::read(path).unwrap_or_default())).collect()
}

/// The command must be refused, name all of `named`, and leave every file as it was.
#[track_caller]
fn assert_nothing_lost(folder: &Path, words: &str, named: &[&str]) {
    let before = contents(folder);
    refused(folder, words, 2, named);
    assert!(contents(folder) == before, "{words}: {:?}", files_below(folder));
}

#[test]
fn an_output_that_is_an_input_is_refused_by_every_command() {
    let folder = workplace();
    let folder = folder.path();
    fs::create_dir(folder.join("deep")).unwrap();
    // The command, the input that is at stake, and the output, which becomes a link to it if it is another name.
    let deep = "--set grid.pitch=[0.3,0.3,0.0005]";
    let cases = [
        ("simulate r.toml -o OUT", "meshes/point.csv", "a.npz"),
        ("simulate r.toml -o OUT", "r.toml", "a.npz"),
        ("simulate mics.toml -o OUT", "mics.csv", "a.npz"),
        ("simulate obj.toml -o OUT", "meshes/bracket.obj", "a.npz"),
        ("simulate obj.toml -o OUT", "meshes/bracket.mtl", "a.npz"),
        ("simulate gltf.toml -o OUT", "meshes/b.gltf", "a.npz"),
        ("simulate gltf.toml -o OUT", "meshes/b.bin", "a.npz"),
        ("reconstruct c.npz -c r.toml -o OUT", "c.npz", "c.npz"),
        ("reconstruct c.npz -c r.toml -o OUT", "c.npz", "./own/../c.npz"),
        ("reconstruct c.npz -c r.toml -o fresh.vti -o OUT", "c.npz", "a.nrrd"),
        ("reconstruct c.npz -c r.toml -o OUT", "r.toml", "a.exr"),
        (&format!("reconstruct c.npz -c r.toml -o deep/v.exr {deep}"), "c.npz", "deep/v.0512.exr"),
        ("depth v.npz -o OUT", "v.npz", "a.exr"),
        ("depth v.npz -c r.toml -o OUT", "r.toml", "a.ply"),
        ("truth ply.toml -o OUT", "meshes/m.ply", "meshes/m.ply"),
        ("truth gltf.toml -o OUT", "meshes/b.bin", "a.exr"),
        ("oracle ply.toml -o OUT", "meshes/m.ply", "meshes/m.ply"),
        ("compare t.exr t.exr --png OUT", "t.exr", "a.png"),
        ("psf r.toml -o new", "r.toml", "new/psf.json"),
        ("psf mics.toml -o new", "mics.csv", "new/psf.png"),
        ("plan r.toml --sweep sweep.step=500,250 -o new", "r.toml", "new/sweep.png"),
        ("plan mics.toml --sweep sweep.step=500,250 -o new", "mics.csv", "new/sweep.json"),
        ("report own", "own/depth.exr", "own/report.html"),
        ("report own", "own/report.json", "own/report.html"),
        ("image meshes/volume.npz -c r.toml -o meshes", "meshes/volume.npz", "meshes/volume.npz"),
        ("image c.npz -c r.toml -o new", "c.npz", "new/volume.npz"),
        ("image c.npz -c r.toml -o new", "r.toml", "new/report.html"),
        ("image obj.toml -o new", "meshes/bracket.mtl", "new/report.json"),
        ("image gltf.toml -o new", "meshes/b.bin", "new/truth.png"),
        ("image gltf.toml -o new", "meshes/b.bin", "new/mesh.ply"),
        ("image gltf.toml -o new", "meshes/b.bin", "new/depth_return2.png"),
        ("image gltf.toml -o new", "meshes/b.bin", "new/volume.0512.exr"),
        (
            "image ply.toml -o meshes --set scene.mesh=meshes/scene.ply",
            "meshes/scene.ply",
            "meshes/scene.ply",
        ),
    ];
    fs::copy(folder.join("c.npz"), folder.join("meshes/volume.npz")).unwrap();
    fs::copy(folder.join("meshes/m.ply"), folder.join("meshes/scene.ply")).unwrap();
    let page = fs::read(folder.join("own/report.html")).unwrap();
    for (words, input, output) in cases {
        let words = words.replace("OUT", output);
        let words = if words.starts_with("image") {
            // All formats, so that every name is an output.
            format!("{words} --set output.formats=[\"exr\",\"npz\"]")
        } else {
            words
        };
        let (from, to) = (folder.join(input), folder.join(output));
        let names: Vec<&str> = [input, output].iter().map(|path| path.rsplit('/').next().unwrap()).collect();
        let named = [names[0], names[1], "overwritten"];
        if to.exists() && from.canonicalize().unwrap() == to.canonicalize().unwrap() {
            assert_nothing_lost(folder, &words, &named);
            continue;
        }
        let linked: [fn(&Path, &Path) -> std::io::Result<()>; 2] =
            [|from, to| fs::hard_link(from, to), |from, to| symlink(from, to)];
        for link in linked {
            fs::create_dir_all(to.parent().unwrap()).unwrap();
            let _ = fs::remove_file(&to);
            link(&from, &to).unwrap();
            assert_nothing_lost(folder, &words, &named);
            fs::remove_file(&to).unwrap();
        }
    }
    // The names themselves are free.
    fs::write(folder.join("own/report.html"), page).unwrap();
    done(folder, "simulate gltf.toml -o a.npz -q");
    done(folder, "image obj.toml -o new -q");
}

#[test]
fn two_outputs_in_one_file_are_refused() {
    let folder = workplace();
    let folder = folder.path();
    symlink("b.npz", folder.join("dangling.npz")).unwrap();
    let deep = "--set grid.pitch=[0.3,0.3,0.0005]";
    for (outputs, named) in [
        ("-o a.npz -o a.npz", ["a.npz", "twice"]),
        ("-o a.npz -o b.vti -o ./a.npz", ["a.npz", "same file"]),
        ("-o a.npz -o own/../a.npz", ["a.npz", "same file"]),
        ("-o missing/a.npz -o missing/a.npz", ["missing/a.npz", "twice"]),
        ("-o b.npz -o dangling.npz", ["dangling.npz", "b.npz"]),
        (&format!("-o v.exr -o v.0512.exr {deep}"), ["v.0512.exr", "twice"]),
    ] {
        assert_nothing_lost(folder, &format!("reconstruct c.npz -c r.toml {outputs}"), &named);
    }
    fs::remove_file(folder.join("own/depth.png")).unwrap();
    symlink("report.json", folder.join("own/depth.png")).unwrap();
    assert_nothing_lost(folder, "image r.toml -o own", &["depth.png", "report.json", "same file"]);
    // A file that is read twice is fine, and so are results that replace older ones.
    done(folder, "compare t.exr t.exr --png error.png");
    done(folder, "reconstruct c.npz -c r.toml -o v.npz -o w.npz -q");
    done(folder, "report own -q");
}
