//! What the system limits, shares or disguises: pipes, sizes of files, stacks, threads, and folders that another process
//! uses.

#![cfg(unix)]

use crate::binary::{Outcome, command, done, files_below, names_below, refused, run, shipped};
use crate::named::assert_names;
use std::fs::{self, File};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// A folder with the point scene as `r.toml`, its cube and its volume.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("meshes")).unwrap();
    fs::copy(shipped("point.toml"), folder.path().join("r.toml")).unwrap();
    fs::copy(shipped("meshes/point.csv"), folder.path().join("meshes/point.csv")).unwrap();
    done(folder.path(), "simulate r.toml -o c.npz -q");
    folder
}

/// Runs the program by a line of the shell, in which `$0` is the program.
fn shell(folder: &Path, line: &str) -> Outcome {
    let mut shell = Command::new("sh");
    shell.current_dir(folder).args(["-c", line, env!("CARGO_BIN_EXE_holosonar")]).stdin(Stdio::null());
    Outcome::of(shell.output().unwrap())
}

/// Runs the program, which must end within some seconds.
fn soon(folder: &Path, words: &str) -> Outcome {
    let mut command = command(folder, words.split_whitespace());
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > Duration::from_secs(20) {
            child.kill().unwrap();
            panic!("{words}: still running");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    Outcome::of(child.wait_with_output().unwrap())
}

#[test]
fn pipes_and_devices_are_refused_as_inputs() {
    let folder = workplace();
    let folder = folder.path();
    let text = fs::read_to_string(folder.join("r.toml")).unwrap();
    let listed =
        text.replace("count = [11, 11]\npitch = [0.03, 0.03]", "layout = \"file\"\nfile = \"none.csv\"");
    fs::write(folder.join("listed.toml"), listed).unwrap();
    let names = ["p.npz", "p.exr", "p.vti", "p.nrrd", "p.ply", "p.obj", "p.csv", "p.xml", "p.toml", "p.gltf"];
    for pipe in [true, false] {
        for name in names {
            let path = folder.join(name);
            let _ = fs::remove_file(&path);
            if pipe {
                assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
            } else {
                symlink("/dev/zero", &path).unwrap();
            }
        }
        for words in [
            "info p.npz",
            "info p.exr",
            "info p.vti",
            "info p.nrrd",
            "info p.ply",
            "info p.gltf",
            "info p.csv",
            "info p.toml",
            "simulate p.obj -o x.npz --unit m",
            "simulate p.csv -o x.npz",
            "simulate listed.toml -o x.npz --set array.file=p.xml",
            "simulate listed.toml -o x.npz --set array.file=p.csv",
            "reconstruct p.npz -o x.npz",
            "reconstruct c.npz -c p.toml -o x.npz",
            "depth p.npz -o x.exr",
            "compare p.exr p.exr",
            "image p.npz -o new",
            "plan p.gltf",
            "psf p.csv",
        ] {
            let ran = soon(folder, words);
            assert_eq!(ran.status, 2, "{words}: {}", ran.stderr);
            let pipe = words.split([' ', '=']).find(|word| word.starts_with("p.")).unwrap();
            assert_names(ran.stderr, &["error: ", pipe, "pipe or a device", "regular file"]);
        }
    }
    fs::create_dir(folder.join("own")).unwrap();
    assert!(Command::new("mkfifo").arg(folder.join("own/report.json")).status().unwrap().success());
    let ran = soon(folder, "report own");
    assert_eq!(ran.status, 2, "{}", ran.stderr);
    assert_names(ran.stderr, &["report.json", "pipe"]);
    assert!(!folder.join("new").exists() && !folder.join("x.npz").exists());
}

#[test]
fn a_limit_on_the_size_of_files_is_an_error() {
    let folder = workplace();
    let folder = folder.path();
    fs::write(folder.join("old.npz"), "an older cube").unwrap();
    let before = names_below(folder);
    for words in ["simulate r.toml -o made/cube.npz", "simulate r.toml -o old.npz", "image r.toml -o made"] {
        let ran = shell(folder, &format!("ulimit -f 8 && exec \"$0\" {words} -q"));
        assert_eq!(ran.status, 1, "{words}: {}", ran.stderr);
        assert_names(&ran.stderr, &["error: ", "cannot be written"]);
        if words.starts_with("image") {
            let left = names_below(&folder.join("made"));
            assert!(left.iter().all(|name| !name.starts_with('.')), "{left:?}");
        } else {
            assert_eq!(names_below(folder), before, "{words}");
            assert!(!folder.join("made").exists(), "{words}: a new folder stays");
        }
    }
    assert_eq!(fs::read(folder.join("old.npz")).unwrap(), b"an older cube");
}

#[test]
fn help_that_cannot_be_printed_is_an_error() {
    let Ok(full) = File::options().write(true).open("/dev/full") else { return };
    let folder = tempfile::tempdir().unwrap();
    for words in
        ["--help", "--version", "image --help", "help image", "help files", "help", "completions bash"]
    {
        let mut command = command(folder.path(), words.split_whitespace());
        command.stdout(full.try_clone().unwrap()).stderr(Stdio::piped());
        let ran = Outcome::of(command.spawn().unwrap().wait_with_output().unwrap());
        assert_eq!(ran.status, 1, "{words}: {}", ran.stderr);
        assert_names(ran.stderr, &["error: standard output: "]);
    }
    assert_eq!(run(folder.path(), "--help").status, 0);
    assert_eq!(run(folder.path(), "--version").status, 0);
    assert_eq!(run(folder.path(), "").status, 2);
    assert_eq!(run(folder.path(), "simulate").status, 2);
}

#[test]
fn threads_beyond_a_few_per_core_are_not_started() {
    let folder = workplace();
    let folder = folder.path();
    done(folder, "simulate r.toml -o few.npz -q -j 2");
    let ran = run(folder, "simulate r.toml -o many.npz -j 60000 -v");
    assert_eq!(ran.status, 0, "{}", ran.stderr);
    let warned = ran.stderr.lines().find(|line| line.starts_with("warning: ")).unwrap();
    assert_names(warned, &["--threads 60000", "are used", "cores"]);
    let started = ran.stderr.lines().find_map(|line| line.trim().split_once(" threads, ")).unwrap().0;
    assert!((1..=2048).contains(&started.parse::<u32>().unwrap()), "{started}");
    assert!(fs::read(folder.join("few.npz")).unwrap() == fs::read(folder.join("many.npz")).unwrap());
    assert!(!run(folder, "simulate r.toml -o few.npz -j 16").stderr.contains("--threads"));
}

#[test]
fn stacks_hold_or_the_environment_is_refused() {
    let folder = workplace();
    let folder = folder.path();
    done(folder, "image r.toml -o expected -q");
    let ran = shell(folder, "ulimit -s 64 && exec \"$0\" image r.toml -o made -q");
    assert_eq!(ran.status, 0, "{}", ran.stderr);
    for name in ["volume.exr", "depth.exr"] {
        let bytes = |folder_name: &str| fs::read(folder.join(folder_name).join(name)).unwrap();
        assert!(bytes("made") == bytes("expected"), "{name}");
    }
    // It rules the stacks of libraries' threads, too.
    let ran = shell(folder, "RUST_MIN_STACK=1024 exec \"$0\" image r.toml -o made -q");
    assert_eq!(ran.status, 2, "{}", ran.stderr);
    assert_names(ran.stderr, &["RUST_MIN_STACK", "1024", "unset"]);
}

#[test]
fn a_folder_that_another_process_writes_into_is_refused() {
    let folder = workplace();
    let folder = folder.path();
    done(folder, "image r.toml -o own -q");
    let before = contents(&folder.join("own"));
    let other = File::open(folder.join("own")).unwrap();
    other.lock().unwrap();
    for words in [
        "image r.toml -o own",
        "image c.npz -c r.toml -o ./own --set reconstruct.window=hann",
        "psf r.toml -o own",
        "plan r.toml --sweep sweep.step=100,200 -o own",
        "reproduce -o own",
        "report own",
        "init own",
        "man own",
    ] {
        refused(folder, words, 2, &["own", "in use", "another"]);
    }
    assert!(contents(&folder.join("own")) == before);
    // Single files are complete or not there; two of them do not disturb each other.
    done(folder, "simulate r.toml -o own/cube.npz -q");
    drop(other);
    done(folder, "image r.toml -o own -q");
}

#[test]
fn of_two_jobs_in_one_folder_one_is_refused_and_the_other_is_whole() {
    let folder = workplace();
    let folder = folder.path();
    let job = |window: &str| {
        let words = format!(
            "image r.toml -o own -q --set reconstruct.method=direct --set grid.pitch=[0.01,0.01,0.005] --set reconstruct.window={window}"
        );
        command(folder, words.split_whitespace())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    };
    let jobs = ["none", "hann"].map(|window| (window, job(window)));
    let ran = jobs.map(|(window, child)| (window, Outcome::of(child.wait_with_output().unwrap())));
    let done: Vec<_> = ran.iter().filter(|(_, ran)| ran.status == 0).collect();
    assert_eq!(done.len(), 1, "{ran:?}");
    let refused = ran.iter().find(|(_, ran)| ran.status != 0).unwrap();
    assert_eq!(refused.1.status, 2);
    assert_names(&refused.1.stderr, &["own", "in use"]);
    let report = fs::read_to_string(folder.join("own/report.json")).unwrap();
    assert!(report.contains(&format!("\"window\": \"{}\"", done[0].0)), "{report}");
}

/// Name and content of everything in a folder.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    files_below(folder).into_iter().map(|path| (path.clone(), fs::read(path).unwrap())).collect()
}
