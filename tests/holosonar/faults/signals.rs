//! Ctrl-C and SIGTERM, once and twice.

use super::{IMAGE, Job, assert_same, end, reused, start, states, undisturbed, workplace};
use crate::binary::{Outcome, STATE_HOME, command, done, files_below};
use crate::named::assert_names;
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Starts a job and sends it signals as soon as it has stored a block.
pub(super) fn signal(folder: &Path, job: &Job, options: &str, signals: &[&str]) -> Outcome {
    let words = format!("{} {options}", job.words);
    signal_command(folder, job, command(folder, words.split_whitespace()), signals)
}

/// The same for a command that does the job.
pub(super) fn signal_command(folder: &Path, job: &Job, mut command: Command, signals: &[&str]) -> Outcome {
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let begun = Instant::now();
    while states(folder, job).is_empty() && begun.elapsed() < Duration::from_mins(1) {
        std::thread::sleep(Duration::from_millis(1));
    }
    for signal in signals {
        Command::new("kill").args([*signal, &child.id().to_string()]).status().unwrap();
    }
    end(child)
}

#[test]
fn a_signal_ends_the_block_and_says_how_to_resume() {
    let folder = workplace();
    let folder = folder.path();
    let (expected, _) = undisturbed(folder, &IMAGE);
    for (name, status) in [("-INT", 130), ("-TERM", 143)] {
        let ran = signal(folder, &IMAGE, "--checkpoint-every 0", &[name]);
        assert_eq!(ran.status, status, "{}", ran.stderr);
        let [state] = &states(folder, &IMAGE)[..] else { panic!("one state: {:?}", states(folder, &IMAGE)) };
        // Where the checkpoint is, and that the same command resumes from it.
        let state = state.file_name().unwrap().to_str().unwrap();
        assert_names(ran.stderr, &["interrupted", "block", state, "same command"]);
        let ran = end(start(folder, IMAGE.words));
        assert_eq!(ran.status, 0, "{}", ran.stderr);
        assert!(reused(&ran) > 0, "{}", ran.stderr);
        println!("{name}: {} blocks were not computed again", reused(&ran));
        assert_same(folder, &IMAGE, &expected);
        fs::remove_dir_all(folder.join(IMAGE.output)).unwrap();
    }
}

/// A job of long blocks, and its outputs.
const SLOW: Job =
    Job { words: "reconstruct slow.npz -c slow.toml -o made/volume.npz -o made/volume.exr", output: "made" };
const OUTPUTS: [&str; 2] = ["made/volume.exr", "made/volume.npz"];

/// Puts older outputs where a job will write.
fn write_older(folder: &Path) {
    let _ = fs::remove_dir_all(folder.join(SLOW.output));
    fs::create_dir(folder.join(SLOW.output)).unwrap();
    for name in OUTPUTS {
        fs::write(folder.join(name), format!("an older {name}")).unwrap();
    }
}

/// That the older outputs are as they were, and that no other file has a name that anybody would take for one.
fn assert_older(folder: &Path) {
    for name in OUTPUTS {
        assert_eq!(fs::read(folder.join(name)).unwrap(), format!("an older {name}").into_bytes());
    }
    let shown = |path: &PathBuf| !path.file_name().unwrap().to_str().unwrap().starts_with('.');
    let found: Vec<PathBuf> = files_below(&folder.join(SLOW.output)).into_iter().filter(shown).collect();
    assert_eq!(found, OUTPUTS.map(|name| folder.join(name)));
}

fn send(signal: &str, process: &str) {
    // A process that has ended meanwhile cannot be sent any.
    let _ = Command::new("kill").args([signal, process]).stderr(Stdio::null()).status();
}

/// Maximum number of tries to send a second signal before the block ends.
const TRIES: usize = 20;

#[test]
fn a_second_signal_ends_it_at_once() {
    let folder = workplace();
    let folder = folder.path();
    let (expected, _) = undisturbed(folder, &SLOW);
    for (signal, status) in [("-INT", 130), ("-TERM", 143)] {
        let at_once = (0..TRIES).any(|_| {
            write_older(folder);
            let mut child = start(folder, &format!("{} --checkpoint-every 0 -v", SLOW.words));
            // The last that is said before the work.
            let mut said = BufReader::new(child.stderr.take().unwrap());
            let mut line = String::new();
            while !line.contains("of memory") {
                line.clear();
                assert!(said.read_line(&mut line).unwrap() > 0, "ended before any signal");
            }
            // Two that come too close together are one to the process: there are more where those came from.
            while child.try_wait().unwrap().is_none() {
                send(signal, &child.id().to_string());
                std::thread::sleep(Duration::from_millis(5));
            }
            let mut rest = String::new();
            said.read_to_string(&mut rest).unwrap();
            let ran = end(child);
            assert_eq!(ran.status, status, "{rest}");
            assert_older(folder);
            // If the block ended first, the checkpoint is stored, and the message says so.
            let in_order = rest.contains("interrupted");
            assert!(in_order || (rest.is_empty() && states(folder, &SLOW).is_empty()), "{rest}");
            !in_order
        });
        assert!(at_once, "{signal}: the block ended first each time");
    }
    let ran = end(start(folder, SLOW.words));
    assert_eq!(ran.status, 0, "{}", ran.stderr);
    assert_same(folder, &SLOW, &expected);
}

#[test]
fn a_second_signal_leaves_the_terminal_clean() {
    let folder = workplace();
    let folder = folder.path();
    done(folder, "simulate slow.toml -o slow.npz -q");
    // On a terminal of its own.
    let line = format!("echo $$ > process && exec {} {}", env!("CARGO_BIN_EXE_holosonar"), SLOW.words);
    let script = || {
        let mut script = Command::new("script");
        script.args(["-qec", &line, "/dev/null"]).current_dir(folder).stdin(Stdio::null());
        script
            .env("TERM", "xterm")
            .env("XDG_STATE_HOME", STATE_HOME)
            .env("SHELL", "/bin/sh")
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
    };
    for _ in 0..TRIES {
        let _ = fs::remove_dir_all(folder.join(SLOW.output));
        let Ok(mut terminal) = script() else {
            println!("skipped: there is no `script` to make a terminal");
            return;
        };
        // Until a bar is drawn.
        let mut shown = Vec::new();
        let mut out = terminal.stdout.take().unwrap();
        let mut some = [0; 4096];
        while !String::from_utf8_lossy(&shown).contains("reconstructing") {
            let count = out.read(&mut some).unwrap();
            if count == 0 {
                println!("skipped: `script` makes no terminal here: {}", String::from_utf8_lossy(&shown));
                return;
            }
            shown.extend(&some[..count]);
        }
        let process = fs::read_to_string(folder.join("process")).unwrap();
        let mut ended = None;
        while ended.is_none() {
            send("-INT", process.trim());
            std::thread::sleep(Duration::from_millis(5));
            ended = terminal.try_wait().unwrap();
        }
        out.read_to_end(&mut shown).unwrap();
        let shown = String::from_utf8_lossy(&shown);
        assert_eq!(ended.and_then(|status| status.code()), Some(130), "{shown}");
        if !shown.contains("interrupted") {
            // The line is empty, the cursor is to be seen, and nothing comes after that.
            assert!(shown.ends_with("\r\u{1b}[2K\u{1b}[?25h"), "{shown:?}");
            return;
        }
    }
    panic!("the block ended first each time");
}

/// A command that is within a call that asks nobody, here a write into a pipe that nobody reads.
#[test]
fn a_signal_ends_a_command_that_hangs_within_a_second() {
    let folder = workplace();
    for (signal, status) in [("-INT", 130), ("-TERM", 143)] {
        let (unread, mut full) = std::io::pipe().unwrap();
        // As much as a pipe holds.
        std::io::Write::write_all(&mut full, &vec![0; 1 << 16]).unwrap();
        let mut command = command(folder.path(), ["completions", "bash", "-v"]);
        let mut child = command.stdout(full).stderr(Stdio::piped()).spawn().unwrap();
        // What it says before it works, and after it listens to signals.
        let (mut said, mut line) = (BufReader::new(child.stderr.take().unwrap()), String::new());
        said.read_line(&mut line).unwrap();
        std::thread::sleep(Duration::from_millis(300));
        assert!(child.try_wait().unwrap().is_none(), "it has written into a full pipe");
        let begun = Instant::now();
        send(signal, &child.id().to_string());
        let ran = end(child);
        assert!(begun.elapsed() < Duration::from_secs(3), "{:?}", begun.elapsed());
        said.read_line(&mut line).unwrap();
        assert_eq!(ran.status, status, "{line}");
        assert_names(line, &["interrupted"]);
        drop(unread);
    }
}
