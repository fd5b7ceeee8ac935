#![allow(clippy::unwrap_used)]

use super::*;
use crate::named::assert_names;

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn a_failure_leaves_the_old_file_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("depth.exr");
    write_atomically(&path, |out| out.write_all(b"old")).unwrap();
    let error = write_atomically(&path, |out| {
        out.write_all(b"half of the n")?;
        Err(io::Error::other("disk full"))
    })
    .unwrap_err();
    assert_names(error.to_string(), &["depth.exr", "disk full"]);
    assert_eq!(error.exit_status(), 1);
    assert_eq!(fs::read(&path).unwrap(), b"old");
    assert_eq!(names(folder.path()), ["depth.exr"]);
}

#[test]
fn what_the_disk_begins_with_early_is_all_there_in_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("volume.npz");
    let mut file = AtomicFile::create(&path).unwrap();
    let mut whole = Vec::new();
    // Also nothing, and what does not end with a page.
    for (i, length) in [0, 5000, 0, 1, 300_000, 4096].into_iter().enumerate() {
        let bytes = vec![i as u8; length];
        file.file().write_all(&bytes).unwrap();
        whole.extend(bytes);
        file.begin_to_store();
        assert_eq!(file.begun, whole.len() as u64);
        assert_eq!(names(folder.path()).len(), 1);
    }
    assert!(!path.exists());
    file.commit().unwrap();
    assert_eq!(fs::read(&path).unwrap(), whole);
}

#[test]
fn a_missing_folder_is_made_and_an_old_file_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a/b/report.json");
    write_atomically(&path, |out| out.write_all(b"one")).unwrap();
    write_atomically(&path, |out| out.write_all(b"two")).unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"two");
    assert_eq!(names(&folder.path().join("a/b")), ["report.json"]);
}

#[test]
fn the_file_is_as_readable_as_any_other() {
    let folder = tempfile::tempdir().unwrap();
    let (ours, ordinary) = (folder.path().join("ours"), folder.path().join("ordinary"));
    write_atomically(&ours, |out| out.write_all(b"x")).unwrap();
    fs::write(&ordinary, b"x").unwrap();
    assert_eq!(fs::metadata(ours).unwrap().permissions(), fs::metadata(ordinary).unwrap().permissions());
}

#[test]
fn a_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let error = write_atomically(folder.path(), |_| Ok(())).unwrap_err();
    assert_eq!(error.exit_status(), 2, "{error}");
    assert!(write_atomically(Path::new(""), |_| Ok(())).is_err());
}

#[cfg(unix)]
#[test]
fn a_link_is_followed_and_a_device_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (target, link) = (folder.path().join("target"), folder.path().join("link"));
    fs::write(&target, b"old").unwrap();
    std::os::unix::fs::symlink(&target, &link).unwrap();
    write_atomically(&link, |out| out.write_all(b"new")).unwrap();
    assert_eq!(fs::read(&target).unwrap(), b"new");
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert_eq!(write_atomically(Path::new("/dev/null"), |_| Ok(())).unwrap_err().exit_status(), 2);
}

#[cfg(unix)]
#[test]
fn a_link_to_a_file_that_does_not_exist_yet_is_followed() {
    use std::os::unix::fs::symlink;
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("links")).unwrap();
    symlink("../new/cube.npz", path("links/first")).unwrap();
    symlink(path("links/first"), path("second")).unwrap();
    announce_output(&path("second")).unwrap();
    write_atomically(&path("second"), |out| out.write_all(b"x")).unwrap();
    assert_eq!(fs::read(path("new/cube.npz")).unwrap(), b"x");
    assert!(path("second").is_symlink() && path("links/first").is_symlink());
    symlink("round", path("round")).unwrap();
    let error = write_atomically(&path("round"), |_| Ok(())).unwrap_err();
    assert_names(error.to_string(), &["round", "loop"]);
    assert_eq!(error.exit_status(), 2);
}

#[cfg(unix)]
#[test]
fn the_mode_of_an_overwritten_file_is_kept() {
    use std::os::unix::fs::{MetadataExt, PermissionsExt};
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cube.npz");
    for mode in [0o600, 0o640, 0o666, 0o444] {
        fs::write(&path, "old").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        let old = fs::metadata(&path).unwrap();
        write_atomically(&path, |out| {
            // Already while it is written, it is no more readable than before.
            assert_eq!(out.get_ref().metadata()?.mode() & 0o777, mode);
            out.write_all(b"new")
        })
        .unwrap();
        let new = fs::metadata(&path).unwrap();
        assert_eq!((new.mode(), new.uid(), new.gid()), (old.mode(), old.uid(), old.gid()), "{mode:o}");
        assert_eq!(fs::read(&path).unwrap(), b"new");
        fs::remove_file(&path).unwrap();
    }
}

#[test]
fn a_failure_leaves_no_new_folder() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a/b/cube.npz");
    write_atomically(&path, |_| Err(io::Error::other("disk full"))).unwrap_err();
    assert_eq!(names(folder.path()), Vec::<String>::new());
    write_atomically(&path, |out| out.write_all(b"x")).unwrap();
    assert!(path.exists());
}

/// By no other program: between its start and its first instruction a process holds the locks of this one.
#[cfg(unix)]
pub(crate) fn make_pipe(path: &Path) -> rustix::io::Result<()> {
    use rustix::fs::{CWD, FileType, Mode, mknodat};
    mknodat(CWD, path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)
}

#[cfg(unix)]
#[test]
fn only_regular_files_are_opened() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("p.npz");
    make_pipe(&pipe).unwrap();
    for path in [&pipe, Path::new("/dev/zero"), Path::new("/dev/null")] {
        let error = open_input(path).unwrap_err();
        assert_eq!(error.exit_status(), 2);
        assert_names(error.to_string(), &[path.to_str().unwrap(), "pipe", "regular file"]);
    }
    assert_names(open_input(folder.path()).unwrap_err().to_string(), &["folder"]);
    assert_eq!(
        open_input(&folder.path().join("none")).unwrap_err().kind(),
        crate::error::ErrorKind::NotFound
    );
}
