//! Neighbours in a shared output folder: links, pipes and files of others under the name of a checkpoint, and journals that
//! others have sealed. The job is done as if nothing were there, and what others own stays as it is.

use super::signals::signal_command;
use super::{
    RECONSTRUCT, a_state, assert_same, contents, end, reused, start, states, undisturbed, workplace,
};
use crate::binary::{Outcome, command};
use crate::named::assert_names;
use std::fs;
use std::os::unix::fs::{PermissionsExt, chown, symlink};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Blocks are stored at once, so that whatever has the journal's name is replaced.
fn storing() -> String {
    format!("{} --checkpoint-every 0", RECONSTRUCT.words)
}

/// The end of a process that must not take longer than a minute, as one that waits for a pipe does.
fn end_soon(mut child: Child) -> Outcome {
    let begun = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begun.elapsed() > Duration::from_mins(1) {
            child.kill().unwrap();
            panic!("still running: {:?}", end(child));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    end(child)
}

#[test]
fn links_and_pipes_are_replaced_and_what_they_lead_to_is_untouched() {
    let folder = workplace();
    let folder = folder.path();
    let (expected, _) = undisturbed(folder, &RECONSTRUCT);
    let (path, state) = a_state(folder);
    let (victim, missing) = (folder.join("victim"), folder.join("missing"));
    // The victim is an intact journal of this very job: what keeps it from being read is how it is reached.
    fs::rename(&path, &victim).unwrap();
    let pipe = || assert!(Command::new("mkfifo").arg(&path).status().unwrap().success());
    let plants: [(&str, &dyn Fn()); 4] = [
        ("symbolic link", &|| symlink(&victim, &path).unwrap()),
        ("symbolic link", &|| symlink(&missing, &path).unwrap()),
        ("hard link", &|| fs::hard_link(&victim, &path).unwrap()),
        ("pipe", &pipe),
    ];
    for (what, plant) in plants {
        fs::create_dir_all(folder.join(RECONSTRUCT.output)).unwrap();
        plant();
        let ran = end_soon(start(folder, &storing()));
        assert_eq!((ran.status, reused(&ran)), (0, 0), "{what}: {}", ran.stderr);
        assert_names(&ran.stderr, &["note: ", path.file_name().unwrap().to_str().unwrap(), what]);
        assert_same(folder, &RECONSTRUCT, &expected);
        assert!(fs::read(&victim).unwrap() == state, "{what}: written to");
        assert!(!missing.exists(), "{what}: created");
        fs::remove_dir_all(folder.join(RECONSTRUCT.output)).unwrap();
    }
}

#[test]
fn a_journal_sealed_by_another_is_not_used() {
    let folder = workplace();
    let folder = folder.path();
    let (expected, _) = undisturbed(folder, &RECONSTRUCT);
    // This user has a secret from now on.
    let (path, _) = a_state(folder);
    let by = |homes: [(&str, &Path); 2], words: &str| {
        let mut command = command(folder, words.split_whitespace());
        command.env_remove("XDG_STATE_HOME").envs(homes);
        command
    };
    let theirs = folder.join("theirs");
    fs::create_dir(&theirs).unwrap();
    // A user with another secret, and one without any, who has no home.
    for homes in [
        [("XDG_STATE_HOME", theirs.as_path()), ("HOME", theirs.as_path())],
        [("XDG_STATE_HOME", Path::new("/proc/none")), ("HOME", Path::new("/proc/none"))],
    ] {
        fs::remove_dir_all(folder.join(RECONSTRUCT.output)).unwrap();
        let ran = signal_command(folder, &RECONSTRUCT, by(homes, &storing()), &["-TERM"]);
        assert_eq!(ran.status, 143, "{}", ran.stderr);
        assert_eq!(states(folder, &RECONSTRUCT), std::slice::from_ref(&path), "of the same name");
        let state = fs::read(&path).unwrap();
        let ran = end(start(folder, RECONSTRUCT.words));
        assert_eq!((ran.status, reused(&ran)), (0, 0), "{}", ran.stderr);
        assert_names(&ran.stderr, &["note: ", path.file_name().unwrap().to_str().unwrap(), "this user"]);
        assert_same(folder, &RECONSTRUCT, &expected);
        // Who sealed it resumes from it.
        write_state(&path, &state);
        let ran = end(spawned(by(homes, RECONSTRUCT.words)));
        assert!(ran.status == 0 && reused(&ran) > 0, "{}", ran.stderr);
        assert_same(folder, &RECONSTRUCT, &expected);
    }
    assert_eq!(fs::read_dir(theirs.join("holosonar")).unwrap().count(), 1, "one secret");
}

/// Writes a journal as its owner alone may.
fn write_state(path: &Path, bytes: &[u8]) {
    fs::write(path, bytes).unwrap();
    fs::set_permissions(path, fs::Permissions::from_mode(0o600)).unwrap();
}

fn spawned(mut command: Command) -> Child {
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

#[cfg(target_os = "linux")]
#[test]
fn a_sparse_journal_takes_no_memory() {
    let folder = workplace();
    let folder = folder.path();
    let (expected, _) = undisturbed(folder, &RECONSTRUCT);
    let (path, state) = a_state(folder);
    // After the blocks, and in place of one, whose heading then claims all that follows.
    let mut claimed = state.clone();
    claimed[96 + 16..96 + 24].copy_from_slice(&(6_u64 << 30).to_le_bytes());
    for state in [state, claimed] {
        fs::create_dir_all(folder.join(RECONSTRUCT.output)).unwrap();
        write_state(&path, &state);
        fs::File::options().write(true).open(&path).unwrap().set_len(7 << 30).unwrap();
        let peak = crate::memory::measured(folder, &format!("--memory 200MiB {}", RECONSTRUCT.words));
        println!("a journal of 7 GiB: {} MiB of memory", peak >> 20);
        assert!(peak < 200 << 20, "{peak} bytes");
        assert_same(folder, &RECONSTRUCT, &expected);
        fs::remove_dir_all(folder.join(RECONSTRUCT.output)).unwrap();
    }
}

/// Somebody else: a user who owns nothing, with a copy of the program that may be run.
struct Nobody {
    programs: tempfile::TempDir,
    secrets: PathBuf,
}

/// The number of the user who owns nothing.
const NOBODY: u32 = 65534;

impl Nobody {
    /// The user, for jobs in `folder`; `None` where this process may not run a program as somebody else.
    fn of(folder: &Path) -> Option<Self> {
        let programs = tempfile::tempdir().unwrap();
        for folder in [programs.path(), folder] {
            fs::set_permissions(folder, fs::Permissions::from_mode(0o777)).unwrap();
        }
        let nobody = Self { secrets: programs.path().join("state"), programs };
        fs::create_dir(&nobody.secrets).unwrap();
        fs::copy(env!("CARGO_BIN_EXE_holosonar"), nobody.program()).unwrap();
        let ran = chown(&nobody.secrets, Some(NOBODY), None)
            .and_then(|()| nobody.command(folder, "--version").output())
            .map_err(|error| error.to_string());
        match ran {
            Ok(output) if output.status.success() => return Some(nobody),
            Ok(output) => println!("skipped: {}", String::from_utf8_lossy(&output.stderr)),
            Err(error) => println!("skipped: no program can be run as another user here: {error}"),
        }
        None
    }

    fn program(&self) -> PathBuf {
        self.programs.path().join("holosonar")
    }

    fn command(&self, folder: &Path, words: &str) -> Command {
        let mut command = Command::new("setpriv");
        let user = format!("--reuid={NOBODY}");
        command.args([&user, "--regid=65534", "--clear-groups"]).arg(self.program());
        command.args(words.split_whitespace()).current_dir(folder).stdin(Stdio::null());
        command.env("XDG_STATE_HOME", &self.secrets);
        command
    }
}

#[test]
fn the_checkpoint_of_another_owner_is_neither_read_nor_removed() {
    let folder = workplace();
    let folder = folder.path();
    let (expected, _) = undisturbed(folder, &RECONSTRUCT);
    let Some(nobody) = Nobody::of(folder) else { return };
    // A shared folder as /tmp is: everybody creates files, and removes only their own.
    let shared = folder.join(RECONSTRUCT.output);
    let share = || {
        let _ = fs::remove_dir_all(&shared);
        fs::create_dir(&shared).unwrap();
        fs::set_permissions(&shared, fs::Permissions::from_mode(0o1777)).unwrap();
    };
    share();
    let ran = signal_command(folder, &RECONSTRUCT, nobody.command(folder, &storing()), &["-TERM"]);
    assert_eq!(ran.status, 143, "{}", ran.stderr);
    let path = states(folder, &RECONSTRUCT).remove(0);
    let name = path.file_name().unwrap().to_str().unwrap().to_owned();
    let state = fs::read(&path).unwrap();
    let assert_stays = |outcome: &Outcome| {
        assert_eq!((outcome.status, reused(outcome)), (0, 0), "{}", outcome.stderr);
        assert!(fs::read(&path).unwrap() == state, "touched");
        fs::remove_file(&path).unwrap();
        assert_same(folder, &RECONSTRUCT, &expected);
        share();
        write_state(&path, &state);
    };
    // The same job of this user has a checkpoint of its own.
    let ran = end(start(folder, &storing()));
    assert!(!ran.stderr.contains(&name), "{}", ran.stderr);
    assert_stays(&ran);
    // The same file, of another owner, who let everybody read it; it cannot be replaced either.
    fs::set_permissions(&path, fs::Permissions::from_mode(0o644)).unwrap();
    let ran = end(spawned(nobody.command(folder, &storing())));
    assert_names(&ran.stderr, &["note: ", &name, "another user", "no further blocks"]);
    assert_stays(&ran);
    // Given back to its owner, it is resumed from.
    chown(&path, Some(NOBODY), None).unwrap();
    let ran = end(spawned(nobody.command(folder, RECONSTRUCT.words)));
    assert!(ran.status == 0 && reused(&ran) > 0, "{}", ran.stderr);
    assert_same(folder, &RECONSTRUCT, &expected);
}

#[test]
fn a_home_of_another_user_gets_no_secret() {
    let folder = workplace();
    let folder = folder.path();
    undisturbed(folder, &RECONSTRUCT);
    let Some(nobody) = Nobody::of(folder) else { return };
    // As with `sudo`, which keeps the home of the user who calls it.
    let mut command = command(folder, storing().split_whitespace());
    command.env("XDG_STATE_HOME", &nobody.secrets);
    let ran = signal_command(folder, &RECONSTRUCT, command, &["-TERM"]);
    assert_eq!(ran.status, 143, "{}", ran.stderr);
    assert_eq!(fs::read_dir(&nobody.secrets).unwrap().count(), 0);
    assert!(!contents(&folder.join(RECONSTRUCT.output)).is_empty(), "a journal is stored all the same");
}
