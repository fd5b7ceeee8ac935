//! Every command once, through the binary, and what it promises: streams, exit status, equal bytes.

use crate::binary::{
    command, done, done_json, files_below, json, json_file, names_below, refused, run, shipped,
};
use crate::named::assert_names;
use crate::support::data;
use holosonar::export::depth_exr::read_depth_map;
use holosonar::export::volume_npz::read_volume_npz;
use std::io::Read;
use std::path::Path;
use std::process::Stdio;

const LIMIT: u64 = 1 << 30;

/// A folder with the point scene and a small scene of the letter F, both of which image in under a second.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let copy = |from: &Path, to: &str| {
        let to = folder.path().join(to);
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::fs::copy(from, to).unwrap();
    };
    copy(&shipped("point.toml"), "point.toml");
    copy(&shipped("meshes/point.csv"), "meshes/point.csv");
    copy(&data("scenes/f.gltf"), "f.gltf");
    let scene = "[scene]\nmesh = \"f.gltf\"\n[sweep]\nstep = 200.0\n[array]\ncount = [15, 15]\npitch = [0.05, 0.05]\n\
                 [grid]\nx = [-0.5, 0.5]\ny = [-0.6, 0.6]\nz = [1.8, 2.2]\npitch = [0.05, 0.05, 0.01]\n\
                 [output]\nformats = [\"exr\", \"npz\", \"vti\", \"nrrd\", \"vdb\"]\n[expect]\ncompleteness = { min = 0.1 }\n";
    std::fs::write(folder.path().join("f.toml"), scene).unwrap();
    folder
}

#[test]
fn image_writes_what_it_reports() {
    let folder = workplace();
    let report = done_json(folder.path(), "image f.toml -o out");
    let mut listed: Vec<String> = serde_json::from_value(report["files"].clone()).unwrap();
    listed.sort();
    assert_eq!(listed, names_below(&folder.path().join("out")));
    for name in [
        "depth.exr",
        "truth.exr",
        "volume.exr",
        "volume.npz",
        "volume.vti",
        "volume.nrrd",
        "volume.vdb",
        "depth.ply",
        "scene.ply",
        "mesh.ply",
        "depth.png",
        "report.html",
    ] {
        assert!(listed.iter().any(|listed| listed == name), "{name} is not among {listed:?}");
    }
    assert_eq!(report, json_file(&folder.path().join("out/report.json")));
    // Second returns have a figure where there are some.
    let second = "depth_return2.png";
    assert!(!listed.iter().any(|listed| listed == second));
    let deep = "image f.toml -o deep --set grid.z=[1.2,2.6] --set depth.confidence_db=-40";
    assert!(done_json(folder.path(), deep)["files"].as_array().unwrap().iter().any(|file| file == second));
    assert!(folder.path().join("deep").join(second).is_file());
}

#[test]
fn the_stages_one_by_one_give_what_image_gives() {
    let folder = workplace();
    let path = folder.path();
    for scene in ["point", "f"] {
        done(path, &format!("image {scene}.toml -o {scene}-out"));
        done(path, &format!("simulate {scene}.toml -o {scene}.npz"));
        done(path, &format!("reconstruct {scene}.npz -c {scene}.toml -o {scene}-v.npz -o {scene}-v.exr"));
        done(path, &format!("depth {scene}-v.npz -c {scene}.toml -o {scene}-d.exr"));
        done(path, &format!("image {scene}.npz -c {scene}.toml -o {scene}-cube"));
        let volume = |name: String| read_volume_npz(&path.join(name), LIMIT).unwrap().0;
        let depth = |name: String| read_depth_map(&path.join(name), LIMIT).unwrap().map;
        let (whole, map) =
            (volume(format!("{scene}-out/volume.npz")), depth(format!("{scene}-out/depth.exr")));
        assert!(whole.peak() > 0.0 && map.accepted() > 0, "{scene}: {}", whole.peak());
        assert_eq!(volume(format!("{scene}-v.npz")), whole, "{scene}");
        assert_eq!(volume(format!("{scene}-cube/volume.npz")), whole, "{scene}");
        // Compared as text, in which NaN equals NaN.
        let text = |map| format!("{map:?}");
        assert_eq!(text(depth(format!("{scene}-d.exr"))), text(map.clone()), "{scene}");
        assert_eq!(text(depth(format!("{scene}-cube/depth.exr"))), text(map), "{scene}");
        assert!(path.join(format!("{scene}-v.exr")).is_file());
    }
    done(path, "truth f.toml -o truth.exr");
    // The files differ in one attribute: a truth alone knows of no method of reconstruction.
    let truth = |name: &str| format!("{:?}", read_depth_map(&path.join(name), LIMIT).unwrap().map);
    assert_eq!(truth("truth.exr"), truth("f-out/truth.exr"));
}

#[test]
fn compare_and_check_exit_with_3_when_a_limit_is_missed() {
    let folder = workplace();
    let path = folder.path();
    done(path, "image f.toml -o out");
    let kept = done_json(path, "compare out/truth.exr out/truth.exr --min completeness=1 --max rmse=0");
    assert_eq!(kept["metrics"]["completeness"], 1.0);
    assert_eq!(kept["limits"].as_array().unwrap().len(), 2);
    let missed = run(path, "compare out/depth.exr out/truth.exr --min completeness=1.01");
    assert_eq!(missed.status, 3, "{missed:?}");
    assert_names(missed.stdout, &["completeness"]);
    assert!(missed.stderr.starts_with("error: "), "{}", missed.stderr);
    assert_names(missed.stderr, &["completeness", "1.01"]);
    let scored = done_json(path, "compare out/depth.exr out/truth.exr");
    let report = json_file(&path.join("out/report.json"));
    let [a, b] = [&scored, &report].map(|v| v["metrics"]["completeness"].as_f64().unwrap());
    assert!((a - b).abs() < 1e-9, "compare finds {a}, image found {b}");

    assert!(done(path, "check f.toml").starts_with("ok "));
    let missed = run(path, "check f.toml f.toml --set expect.completeness.min=1.0");
    assert_eq!((missed.status, missed.stdout.lines().count()), (3, 2), "{missed:?}");
    assert!(missed.stdout.starts_with("MISSED"));
    refused(path, "check point.toml", 2, &["point.toml", "[expect]"]);
}

#[test]
fn info_names_every_kind() {
    let folder = workplace();
    let path = folder.path();
    done(path, "image f.toml -o out");
    done(path, "simulate f.toml -o cube.npz");
    for (file, kind) in [
        ("cube.npz", "data cube"),
        ("out/volume.npz", "volume"),
        ("out/depth.exr", "depth map"),
        ("out/volume.exr", "volume, seen from the front"),
        ("out/volume.vti", "volume"),
        ("out/volume.nrrd", "volume"),
        ("out/depth.ply", "points"),
        ("out/scene.ply", "points"),
        ("out/mesh.ply", "mesh"),
        ("f.gltf", "mesh"),
        ("meshes/point.csv", "reflectors"),
        ("f.toml", "run file"),
    ] {
        assert_eq!(done_json(path, &format!("info {file}"))["kind"], kind);
        assert!(done(path, &format!("info {file}")).contains(kind));
    }
}

#[test]
fn init_writes_a_run_file_that_images() {
    let folder = tempfile::tempdir().unwrap();
    let said = done(folder.path(), "init try");
    assert_names(said, &["holosonar image try/corner.toml"]);
    refused(folder.path(), "init try", 2, &["try/corner.toml"]);
    let coarse = "--set sweep.step=500 --set grid.pitch=[0.06666666666666667,0.06666666666666667,0.02]";
    let report = done_json(folder.path(), &format!("image try/corner.toml -o out {coarse}"));
    assert!(report["accepted"].as_u64().unwrap() > 50, "{report}");
}

#[test]
fn a_refused_request_leaves_no_folder() {
    let folder = workplace();
    refused(folder.path(), "image point.toml -o fresh --set sweep.step=-1", 2, &["sweep.step"]);
    assert!(!folder.path().join("fresh").exists());
    std::fs::create_dir(folder.path().join("there")).unwrap();
    refused(folder.path(), "image point.toml -o there --set sweep.step=-1", 2, &["sweep.step"]);
    assert!(folder.path().join("there").exists(), "what was there stays");
}

#[test]
fn completions_help_and_version() {
    let folder = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        assert!(done(folder.path(), &format!("completions {shell}")).contains("reconstruct"), "{shell}");
    }
    let version = done(folder.path(), "--version");
    let commit = version.split_once('(').unwrap().1.trim_end().trim_end_matches(')');
    assert!(version.starts_with(concat!("holosonar ", env!("CARGO_PKG_VERSION"))), "{version}");
    assert!(!commit.is_empty(), "{version}");
    assert!(done(folder.path(), "image --help").contains("--output"));
}

#[test]
fn results_on_one_stream_and_everything_else_on_the_other() {
    let folder = workplace();
    let ran = run(folder.path(), "image point.toml -o out -v");
    assert_eq!(ran.status, 0);
    assert!(ran.stdout.contains("voxels") && !ran.stdout.contains("warning"), "{}", ran.stdout);
    assert!(ran.stderr.contains("warning: ") && ran.stderr.contains("simulating"), "{}", ran.stderr);
    assert!(!ran.stderr.contains('\u{1b}'), "no colours and no bars without a terminal");
    let stages = ["image point.toml -o out", "simulate point.toml -o c.npz", "truth f.toml -o t.exr"];
    for words in stages {
        let ran = run(folder.path(), &format!("-q {words}"));
        assert_eq!((ran.status, ran.stdout.as_str(), ran.stderr.as_str()), (0, "", ""), "{words}");
        json(&done(folder.path(), &format!("{words} --json -q")));
    }
}

#[test]
fn a_closed_pipe_ends_quietly() {
    let folder = workplace();
    let commands =
        ["completions bash", "man", "plan f.toml", "info f.gltf", "image point.toml -o out", "check f.toml"];
    for words in commands {
        let mut child = command(folder.path(), words.split(' '))
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        let mut said = String::new();
        child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        assert!(child.wait().unwrap().success(), "{words}: {said}");
        assert!(!said.contains("panicked") && !said.contains("error"), "{words}: {said}");
    }
}

#[test]
fn any_number_of_threads_writes_the_same_bytes() {
    let folder = workplace();
    let path = folder.path();
    for scene in ["point", "f"] {
        for threads in [1, 3] {
            done(
                path,
                &format!("image {scene}.toml -o {scene}{threads} -j {threads} --set detection.snr_db=10"),
            );
            done(path, &format!("simulate {scene}.toml -o {scene}{threads}/cube.npz -j {threads}"));
        }
        let files = |threads: usize| files_below(&path.join(format!("{scene}{threads}")));
        let (one, three) = (files(1), files(3));
        assert!(one.len() >= 7 && one.len() == three.len());
        for (a, b) in one.iter().zip(&three) {
            assert_eq!(a.file_name(), b.file_name());
            let [mut a_bytes, mut b_bytes] = [a, b].map(|path| std::fs::read(path).unwrap());
            if a.ends_with("report.html") {
                [a_bytes, b_bytes] = [a_bytes, b_bytes].map(|bytes| without_timings(&bytes).into_bytes());
            }
            if a.ends_with("report.json") {
                [a_bytes, b_bytes] = [a_bytes, b_bytes].map(|bytes| {
                    let mut report = json(std::str::from_utf8(&bytes).unwrap());
                    assert!(report.as_object_mut().unwrap().remove("timings").is_some());
                    report.to_string().into_bytes()
                });
            }
            assert!(a_bytes == b_bytes, "{} differs from {}", a.display(), b.display());
        }
    }
}

/// A page without the one object of its report that may differ between two runs.
fn without_timings(page: &[u8]) -> String {
    let page = std::str::from_utf8(page).unwrap();
    let (before, timings) = page.split_once("\"timings\": {").expect("the page holds the report's timings");
    let (seconds, after) = timings.split_once('}').unwrap();
    assert!(seconds.contains("\"write\""), "{seconds}");
    format!("{before}{after}")
}

#[test]
fn the_page_can_be_made_again_later() {
    let folder = workplace();
    let path = folder.path();
    done(path, "image f.toml -o out");
    let page = path.join("out/report.html");
    let first = std::fs::read(&page).unwrap();
    std::fs::remove_file(&page).unwrap();
    assert_names(done(path, "report out"), &[Path::new("out").join("report.html").to_str().unwrap()]);
    assert!(std::fs::read(&page).unwrap() == first, "the very page that `image` wrote");
    // Any of the volume's formats will do, and so will none.
    for gone in ["npz", "nrrd", "vti"] {
        std::fs::remove_file(path.join(format!("out/volume.{gone}"))).unwrap();
        done(path, "report out");
        assert!(std::fs::read(&page).unwrap() == first, "without volume.{gone}");
    }
    for gone in ["volume.exr", "mesh.ply", "scene.ply", "truth.exr", "depth.exr"] {
        std::fs::remove_file(path.join("out").join(gone)).unwrap();
        done(path, "report out");
        assert!(std::fs::metadata(&page).unwrap().len() < first.len() as u64, "without {gone}");
    }
    done(path, "image f.toml -o bare --set output.report=false --set output.points=false");
    for missing in ["report.html", "depth.ply", "scene.ply", "mesh.ply"] {
        assert!(!path.join("bare").join(missing).exists(), "{missing}");
    }
    done(path, "report bare --json");
    refused(path, "report nowhere", 2, &["nowhere"]);
    refused(path, "report .", 2, &[".", "report.json"]);
    std::fs::write(path.join("out/report.json"), "[1]").unwrap();
    refused(path, "report out", 2, &["report.json", "report"]);
    std::fs::write(path.join("bare/volume.npz"), "no zip").unwrap();
    refused(path, "report bare", 2, &["volume.npz"]);
}

#[test]
fn a_depth_map_becomes_points_by_its_extension() {
    let folder = workplace();
    let path = folder.path();
    done(path, "image f.toml -o out");
    done(path, "depth out/volume.npz -c f.toml -o d.ply");
    // The comments may differ in the last digit of a number that has been through JSON.
    let vertices = |name: &str| {
        let bytes = std::fs::read(path.join(name)).unwrap();
        let at = bytes.windows(14).position(|words| words == b"element vertex").unwrap();
        bytes[at..].to_vec()
    };
    assert!(vertices("d.ply") == vertices("out/depth.ply"));
    done(path, "truth f.toml -o truth.ply");
    let count = |file: &str| done_json(path, &format!("info {file}"))["count"].as_u64().unwrap();
    let report = json_file(&path.join("out/report.json"));
    assert_eq!(count("d.ply"), report["accepted"].as_u64().unwrap());
    assert_eq!(count("out/scene.ply"), report["reflectors"].as_u64().unwrap() + 15 * 15 + 1);
    assert!(count("truth.ply") > 0);
}

#[test]
fn half_floats_and_uncompressed_files_say_the_same() {
    let folder = workplace();
    let path = folder.path();
    done(path, "image f.toml -o whole");
    done(
        path,
        "image f.toml -o half --set output.float16=true --set output.compression=none --set output.components=complex",
    );
    let depth = |out: &str| read_depth_map(&path.join(out).join("depth.exr"), LIMIT).unwrap().map;
    let (whole, half) = (depth("whole"), depth("half"));
    assert_eq!(
        format!("{:?}", whole.picked.depth),
        format!("{:?}", half.picked.depth),
        "depths keep 32 bits"
    );
    assert_ne!(whole.picked.strength, half.picked.strength);
    let greatest = whole.picked.strength.iter().copied().fold(0.0, f32::max);
    for (a, b) in whole.picked.strength.iter().zip(&half.picked.strength) {
        assert!((a - b).abs() <= greatest / 2048.0, "{a} {b}");
    }
    let ran = run(
        path,
        "image f.toml -o faint --set output.float16=true --set materials=[{name=\"*\",reflectance=1e-6}]",
    );
    assert_eq!(ran.status, 0, "{ran:?}");
    assert!(ran.stderr.contains("float16"), "{}", ran.stderr);
}

#[test]
fn a_vdb_leaves_out_what_is_below_its_threshold() {
    let folder = workplace();
    let path = folder.path();
    done(path, "simulate point.toml -o cube.npz");
    let lengths = ["-60.0", "-40.0", "-10.0"].map(|level| {
        let set = format!("--set output.vdb_threshold_db={level}");
        done(path, &format!("reconstruct cube.npz -c point.toml -o v.vdb {set}"));
        let bytes = std::fs::read(path.join("v.vdb")).unwrap();
        let said = [
            b"sonar:thresholdDb\x06\0\0\0double\x08\0\0\0",
            &level.parse::<f64>().unwrap().to_le_bytes()[..],
        ];
        assert!(bytes.windows(39).any(|window| window == said.concat()), "{level}");
        bytes.len()
    });
    assert!(lengths.is_sorted_by(|more, fewer| more > fewer), "{lengths:?}");
}

#[test]
fn a_cube_without_a_grid_gets_one_suggested_that_works() {
    let folder = workplace();
    let path = folder.path();
    for scene in ["point", "f"] {
        done(path, &format!("simulate {scene}.toml -o cube.npz"));
        for words in ["image cube.npz -o out", "reconstruct cube.npz -o v.npz"] {
            let ran = run(path, words);
            assert_eq!(ran.status, 2, "{ran:?}");
            assert!(files_below(&path.join("out")).is_empty() && !path.join("v.npz").exists());
            let table = &ran.stderr[ran.stderr.find("\n[grid]\n").expect("a table to paste")..];
            std::fs::write(path.join("pasted.toml"), table).unwrap();
        }
        done(path, &format!("-q image cube.npz -c pasted.toml -o {scene}-pasted"));
        let found = read_volume_npz(&path.join(format!("{scene}-pasted/volume.npz")), LIMIT).unwrap().0;
        assert!(found.peak() > 0.0 && found.grid.voxel_count() > 1000, "{:?}", found.grid);
    }
    // The point at (0, 0, 0.8) is in the suggested grid and has its full amplitude.
    let volume = read_volume_npz(&path.join("point-pasted/volume.npz"), LIMIT).unwrap().0;
    assert!(volume.peak() > 0.8, "{}", volume.peak());
}
