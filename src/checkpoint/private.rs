//! Files that this user alone may have written: opened without following a link or waiting for anybody, and looked at before
//! they are read.
//!
//! Output folders may be shared, and anybody who may write there may give any name to anything: a link to a file of ours, a
//! pipe, a device, a file of their own. Takes a path; gives the file, if it is an ordinary one of this user with no other
//! name that nobody else may write, or says why not. Where a system has no owners of files, that part is left out.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io;
use std::path::Path;

/// What is at a path where a private file is expected.
#[derive(Debug)]
pub(super) enum Found {
    /// Nothing.
    Nothing,
    /// An ordinary file of this user alone.
    Private(File),
    /// Anything else, and what, as a predicate: "is a symbolic link".
    Other(String),
}

/// What others may do with a private file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Others {
    /// They must not write it; they may read it. The file is opened for writing, too.
    Read,
    /// They must do neither. The file is opened for reading alone.
    Nothing,
}

/// Opens a private file, if it is one; never waits, and never opens what is no ordinary file.
pub(super) fn open(path: &Path, others: Others) -> Found {
    let opened = || {
        // Before it is opened, since that alone may have an effect on a device; and after it, since the name may have been
        // given to something else in between.
        if let Some(problem) = objection(&fs::symlink_metadata(path)?, others) {
            return Ok(Found::Other(problem));
        }
        let file = options(others == Others::Read).open(path)?;
        let metadata = file.metadata()?;
        Ok(match objection(&metadata, others) {
            Some(problem) => Found::Other(problem),
            None if links(&metadata) == 0 => Found::Nothing, // deleted in between
            None => Found::Private(file),
        })
    };
    opened().unwrap_or_else(|error: io::Error| match error.kind() {
        io::ErrorKind::NotFound => Found::Nothing,
        _ => Found::Other(format!("cannot be opened ({error})")),
    })
}

/// Whether a path is that of an ordinary file of this user alone; it is not opened.
pub(super) fn is_private(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|metadata| objection(&metadata, Others::Read).is_none())
}

/// Creates a private file where nothing is yet, not even a dangling link.
pub(super) fn create(path: &Path) -> io::Result<File> {
    let mut options = options(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.create_new(true).open(path)
}

fn options(write: bool) -> OpenOptions {
    let mut options = OpenOptions::new();
    options.read(true).write(write);
    #[cfg(unix)]
    {
        use rustix::fs::OFlags;
        let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY;
        std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, flags.bits() as i32);
    }
    options
}

/// Why a file is not private, as a predicate; `None` if it is.
fn objection(metadata: &Metadata, others: Others) -> Option<String> {
    let kind = metadata.file_type();
    if kind.is_symlink() {
        return Some("is a symbolic link".to_owned());
    }
    if kind.is_dir() {
        return Some("is a folder".to_owned());
    }
    if !kind.is_file() {
        return Some("is a pipe, a socket or a device".to_owned());
    }
    if !is_of_user(metadata) {
        return Some("belongs to another user".to_owned());
    }
    if links(metadata) > 1 {
        return Some("has other names, too (hard links)".to_owned());
    }
    permits(metadata, others).then(|| {
        let problem = if others == Others::Read { "be changed" } else { "be read or changed" };
        format!("may {problem} by other users")
    })
}

/// The user who runs this process, as a number; the same for all where a system has no such numbers.
pub(super) fn user() -> u32 {
    #[cfg(unix)]
    {
        rustix::process::geteuid().as_raw()
    }
    #[cfg(not(unix))]
    {
        0
    }
}

/// Whether a file or folder belongs to this user.
pub(super) fn is_of_user(metadata: &Metadata) -> bool {
    #[cfg(unix)]
    {
        std::os::unix::fs::MetadataExt::uid(metadata) == user()
    }
    #[cfg(not(unix))]
    {
        metadata.is_file() || metadata.is_dir()
    }
}

/// Number of names of a file.
fn links(metadata: &Metadata) -> u64 {
    #[cfg(unix)]
    {
        std::os::unix::fs::MetadataExt::nlink(metadata)
    }
    #[cfg(not(unix))]
    {
        u64::from(metadata.is_file())
    }
}

/// Whether the file's mode permits more to others than they may.
fn permits(metadata: &Metadata, others: Others) -> bool {
    #[cfg(unix)]
    {
        let denied = if others == Others::Read { 0o022 } else { 0o077 };
        std::os::unix::fs::MetadataExt::mode(metadata) & denied != 0
    }
    #[cfg(not(unix))]
    {
        let _ = (metadata, others);
        false
    }
}
