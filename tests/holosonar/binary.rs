//! The program as a user starts it: arguments in; exit status, standard output and standard error out.

use crate::named::assert_names;
use serde_json::Value;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// What one run of the program left.
#[derive(Debug)]
pub(crate) struct Outcome {
    pub(crate) status: i32,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

impl Outcome {
    /// What a process that has ended left; a status of −1 is a signal's.
    pub(crate) fn of(output: Output) -> Self {
        Self {
            status: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }
}

/// Where the program has this user's secret during tests, rather than in the home of whoever runs them.
pub(crate) const STATE_HOME: &str = concat!(env!("CARGO_TARGET_TMPDIR"), "/state");

/// The program, ready to be started in `folder`.
pub(crate) fn command<S: AsRef<OsStr>>(folder: &Path, args: impl IntoIterator<Item = S>) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_holosonar"));
    command.current_dir(folder).args(args).stdin(Stdio::null()).env_remove("NO_COLOR");
    command.env("XDG_STATE_HOME", STATE_HOME);
    command
}

/// Runs the program in `folder` on words separated by blanks.
pub(crate) fn run(folder: &Path, words: &str) -> Outcome {
    run_command(words, &mut command(folder, words.split_whitespace()))
}

/// Runs a command, which must not panic; `words` describe it in messages.
pub(crate) fn run_command(words: &str, command: &mut Command) -> Outcome {
    let ran = Outcome::of(command.output().unwrap());
    assert!(!ran.stderr.contains("panicked"), "{words}: {}", ran.stderr);
    ran
}

/// As [`run`], and it must succeed; gives standard output.
pub(crate) fn done(folder: &Path, words: &str) -> String {
    let ran = run(folder, words);
    assert_eq!(ran.status, 0, "{words}: {}", ran.stderr);
    ran.stdout
}

/// As [`done`] with `--json`; gives the value that was printed.
pub(crate) fn done_json(folder: &Path, words: &str) -> Value {
    json(&done(folder, &format!("{words} --json")))
}

pub(crate) fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap()
}

/// The value in a JSON file.
pub(crate) fn json_file(path: &Path) -> Value {
    json(&std::fs::read_to_string(path).unwrap())
}

/// As [`run`], and it must fail with `status`, in one paragraph that begins `error:` and names all of `named`.
#[track_caller]
pub(crate) fn refused(folder: &Path, words: &str, status: i32, named: &[&str]) {
    let ran = run(folder, words);
    assert_eq!(ran.status, status, "{words}: {}{}", ran.stdout, ran.stderr);
    assert_eq!(ran.stdout, "", "{words}: a failure has no results");
    let errors: Vec<&str> = ran.stderr.lines().filter(|line| !line.starts_with("warning: ")).collect();
    assert!(errors.len() == 1 && errors[0].starts_with("error: "), "{words}: {}", ran.stderr);
    assert_names(errors[0], named);
}

/// Names of everything below `folder`, sorted.
pub(crate) fn files_below(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            if path.is_dir() { folders.push(path) } else { files.push(path) }
        }
    }
    files.sort();
    files
}

/// Names of the files below `folder`, without their folders, sorted.
pub(crate) fn names_below(folder: &Path) -> Vec<String> {
    let name = |path: &PathBuf| path.file_name().unwrap().to_str().unwrap().to_owned();
    let mut names: Vec<_> = files_below(folder).iter().map(name).collect();
    names.sort();
    names
}

/// A scene for tests that takes a fraction of a second: with few microphones and large voxels, or shipped and small anyway.
pub(crate) fn small(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/small").join(name);
    if path.exists() { path } else { shipped(name) }
}

/// A scene that the repository ships.
pub(crate) fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name)
}
