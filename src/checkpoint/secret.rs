//! The secret by which this user's checkpoints are recognised: 32 random bytes in a file of the user's own.
//!
//! It is in `$XDG_STATE_HOME/holosonar`, or `~/.local/state/holosonar`, and created with the first checkpoint. Where there
//! is no such folder of the user, or none that can be written, there is no secret; what then protects a checkpoint is its
//! owner alone.

use super::private::{self, Found, Others};
#[cfg(feature = "python")]
use crate::error::{Error, Result};
use std::env;
use std::fs::{self, DirBuilder};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// Bytes of a secret.
pub(crate) type Secret = [u8; 32];

/// The file's name.
const NAME: &str = "checkpoint.key";

/// The folder of the secret; it need not exist.
pub(super) fn folder() -> Option<PathBuf> {
    // A relative path is to be ignored, as the XDG Base Directory Specification says.
    let absolute = |path: PathBuf| path.is_absolute().then_some(path);
    let chosen = env::var_os("XDG_STATE_HOME").map(PathBuf::from).and_then(absolute);
    let state = chosen.or_else(|| Some(env::home_dir().and_then(absolute)?.join(".local/state")))?;
    Some(state.join("holosonar"))
}

/// The secret, if there is one.
pub(super) fn read(folder: &Path) -> Option<Secret> {
    try_read(folder).ok()
}

/// The secret, which is created if there is none.
///
/// # Errors
/// Why there is none, and none can be created.
pub(super) fn read_or_create(folder: &Path) -> io::Result<Secret> {
    match try_read(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            // If another process is quicker, its secret is the one.
            create(folder).or_else(|error| match error.kind() {
                io::ErrorKind::AlreadyExists => Ok(()),
                _ => Err(error),
            })?;
            try_read(folder)
        }
        found => found,
    }
}

/// The secret, for workers of the user that do not share its folder.
///
/// # Errors
/// As [`read_or_create`]; no folder for it.
#[cfg(feature = "python")]
pub(crate) fn of_user() -> Result<Secret> {
    let refuse = |problem: String| Error::io("the secret that seals units", problem);
    let folder =
        folder().ok_or_else(|| refuse("has no folder; set XDG_STATE_HOME to one of yours".into()))?;
    read_or_create(&folder).map_err(|error| refuse(error.to_string()))
}

fn try_read(folder: &Path) -> io::Result<Secret> {
    let path = folder.join(NAME);
    let refuse = |problem: &str| Err(io::Error::other(format!("{} {problem}", path.display())));
    let file = match private::open(&path, Others::Nothing) {
        Found::Nothing => return Err(io::ErrorKind::NotFound.into()),
        Found::Other(problem) => return refuse(&problem),
        Found::Private(file) => file,
    };
    let mut bytes = Vec::new();
    file.take(size_of::<Secret>() as u64 + 1).read_to_end(&mut bytes)?;
    Secret::try_from(bytes).or_else(|_| refuse("is no secret of 32 bytes"))
}

fn create(folder: &Path) -> io::Result<()> {
    // With `sudo`, say, the home may be another user's, who could not use a folder that we create there.
    let existing = folder.ancestors().find(|folder| folder.exists()).unwrap_or(folder);
    if !private::is_of_user(&fs::metadata(existing)?) {
        return Err(io::Error::other(format!("{} belongs to another user", existing.display())));
    }
    let mut builder = DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.recursive(true).create(folder)?;
    let mut secret = Secret::default();
    getrandom::fill(&mut secret).map_err(io::Error::other)?;
    // Only its owner may read a temporary file; it gets its name when it is complete, unless there is one of that name.
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    file.write_all(&secret)?;
    file.as_file().sync_all()?;
    file.persist_noclobber(folder.join(NAME)).map(drop).map_err(|error| error.error)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_is_created_once_for_this_user_alone() {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("state/holosonar");
        assert_eq!(read(&folder), None);
        assert!(!folder.exists(), "reading creates nothing");
        let secret = read_or_create(&folder).unwrap();
        assert_ne!(secret, Secret::default());
        assert_eq!((read(&folder), read_or_create(&folder).unwrap()), (Some(secret), secret));
        assert_ne!(read_or_create(&home.path().join("other")).unwrap(), secret);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "nothing temporary is left");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let path = folder.join(NAME);
            assert_eq!(fs::metadata(&path).unwrap().permissions().mode() & 0o777, 0o600);
            assert_eq!(fs::metadata(&folder).unwrap().permissions().mode() & 0o777, 0o700);
            fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
            assert_eq!(read(&folder), None, "others know it");
            let error = read_or_create(&folder).unwrap_err().to_string();
            assert!(error.contains("checkpoint.key may be read"), "{error}");
        }
    }

    #[test]
    fn a_damaged_secret_and_a_folder_that_cannot_be_are_none() {
        let home = tempfile::tempdir().unwrap();
        read_or_create(home.path()).unwrap();
        let path = home.path().join(NAME);
        for length in [0, 31, 33, 1000] {
            fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(length).unwrap();
            assert!(read(home.path()).is_none() && read_or_create(home.path()).is_err(), "{length} bytes");
        }
        assert!(read_or_create(&path.join("holosonar")).is_err(), "inside a file");
    }
}
