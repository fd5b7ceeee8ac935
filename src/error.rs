//! The crate's one error type: what is wrong, where, what was expected, and the cause.
//!
//! A message is one paragraph that says where (file, line, key, node), what is wrong, what was expected and
//! how to fix it. What a user can cause is always an [`Error`]; only a programmer's mistake panics. A caller that
//! handles errors matches [`Error::kind`], and finds the operating system's own error in [`source`](std::error::Error::source).
//!
//! # Example
//! ```
//! use holosonar::error::ErrorKind;
//! use holosonar::scene::{LoadOptions, Scene};
//! use std::path::Path;
//!
//! let error = Scene::load(Path::new("gone.obj"), &LoadOptions::default()).unwrap_err();
//! assert_eq!(error.kind(), ErrorKind::NotFound);
//! assert_eq!(error.place(), Some("gone.obj"));
//! assert!(std::error::Error::source(&error).is_some_and(|cause| cause.is::<std::io::Error>()));
//! ```

use crate::text::{message, one_line};
use std::fmt::{self, Display};
use std::io;
use std::path::Path;
use std::sync::Arc;

/// The kind of an error, for callers to match.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The request or an input file is wrong.
    InvalidInput,
    /// An input file is missing.
    NotFound,
    /// The operating system refused: a disk, a permission to write, a thread.
    Io,
    /// Something does not fit in memory.
    OutOfMemory,
    /// A result missed a requested limit.
    LimitMissed,
    /// The [`Observer`](crate::progress::Observer) asked to stop.
    Interrupted,
}

/// What went wrong, where, and why.
///
/// Two errors are equal when they have the same kind and the same message.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum Error {
    /// The request or an input file is wrong.
    #[non_exhaustive]
    InvalidInput {
        /// File, line, key, node or option at fault.
        place: String,
        /// What is wrong there, what was expected, and how to fix it.
        problem: String,
        /// The error of the operating system, if there was one.
        source: Option<Arc<io::Error>>,
    },
    /// An input file is missing.
    #[non_exhaustive]
    NotFound {
        /// The file.
        place: String,
        /// How to fix it.
        problem: String,
        /// The error of the operating system.
        source: Option<Arc<io::Error>>,
    },
    /// The operating system refused: a disk, a permission to write, a thread.
    #[non_exhaustive]
    Io {
        /// File or resource concerned.
        place: String,
        /// What failed.
        problem: String,
        /// The error of the operating system, if there was one.
        source: Option<Arc<io::Error>>,
    },
    /// Something does not fit in memory.
    #[non_exhaustive]
    OutOfMemory {
        /// What does not fit, and what would.
        problem: String,
    },
    /// A limit of `compare` or `check` was missed: which, by how much.
    LimitMissed(String),
    /// The observer asked to stop.
    Interrupted,
}

/// `Result` with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An error in the user's input.
    pub fn input(place: impl Display, problem: impl Into<String>) -> Self {
        Self::InvalidInput { place: place.to_string(), problem: problem.into(), source: None }
    }

    /// The same error at another place: the file or key from which the caller took the values. Errors other than invalid
    /// input are unchanged.
    #[must_use]
    pub fn at(mut self, at: impl Display) -> Self {
        if let Self::InvalidInput { place, .. } = &mut self {
            *place = at.to_string();
        }
        self
    }

    /// An error of the operating system.
    pub fn io(place: impl Display, problem: impl Into<String>) -> Self {
        Self::Io { place: place.to_string(), problem: problem.into(), source: None }
    }

    /// The same error with its cause, where the kind has one.
    #[must_use]
    pub fn with_source(mut self, cause: impl Into<io::Error>) -> Self {
        if let Self::InvalidInput { source, .. } | Self::NotFound { source, .. } | Self::Io { source, .. } =
            &mut self
        {
            *source = Some(Arc::new(cause.into()));
        }
        self
    }

    /// The error for something that does not fit in memory.
    pub fn out_of_memory(problem: impl Into<String>) -> Self {
        Self::OutOfMemory { problem: problem.into() }
    }

    /// An input file that could not be read: an input error when it is missing, a folder or not permitted.
    pub fn reading(path: &Path, error: io::Error) -> Self {
        let (place, kind) = (path.display().to_string(), error.kind());
        let problem = match kind {
            io::ErrorKind::NotFound => "no such file; check the path".to_owned(),
            io::ErrorKind::IsADirectory => "is a folder; a file was expected".to_owned(),
            io::ErrorKind::PermissionDenied => "may not be read (permission denied)".to_owned(),
            io::ErrorKind::NotADirectory => "no such file; a part of the path is not a folder".to_owned(),
            // What the system takes for no name at all: with a zero byte in it, or too long.
            io::ErrorKind::InvalidInput | io::ErrorKind::InvalidFilename => {
                format!("is not the name of a file: {error}")
            }
            _ => format!("cannot be read: {error}"),
        };
        let refusal = match kind {
            io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => {
                Self::NotFound { place, problem, source: None }
            }
            io::ErrorKind::IsADirectory
            | io::ErrorKind::PermissionDenied
            | io::ErrorKind::InvalidInput
            | io::ErrorKind::InvalidFilename => Self::input(place, problem),
            _ => Self::io(place, problem),
        };
        refusal.with_source(error)
    }

    /// An output file that could not be written.
    pub fn writing(path: &Path, error: io::Error) -> Self {
        Self::io(path.display(), format!("cannot be written: {error}")).with_source(error)
    }

    /// The kind of the error.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::InvalidInput { .. } => ErrorKind::InvalidInput,
            Self::NotFound { .. } => ErrorKind::NotFound,
            Self::Io { .. } => ErrorKind::Io,
            Self::OutOfMemory { .. } => ErrorKind::OutOfMemory,
            Self::LimitMissed(_) => ErrorKind::LimitMissed,
            Self::Interrupted => ErrorKind::Interrupted,
        }
    }

    /// The file, line, key, node, option or resource concerned, where there is one.
    pub fn place(&self) -> Option<&str> {
        match self {
            Self::InvalidInput { place, .. } | Self::NotFound { place, .. } | Self::Io { place, .. } => {
                Some(place)
            }
            Self::OutOfMemory { .. } => Some("memory"),
            Self::LimitMissed(_) | Self::Interrupted => None,
        }
    }

    /// The exit status of a process that ends with this error: 1 I/O or memory, 2 invalid or missing input, 3 a limit
    /// missed, 130 interrupted.
    pub fn exit_status(&self) -> u8 {
        match self.kind() {
            ErrorKind::Io | ErrorKind::OutOfMemory => 1,
            ErrorKind::InvalidInput | ErrorKind::NotFound => 2,
            ErrorKind::LimitMissed => 3,
            ErrorKind::Interrupted => 130,
        }
    }
}

impl Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let problem = match self {
            Self::InvalidInput { problem, .. }
            | Self::NotFound { problem, .. }
            | Self::Io { problem, .. }
            | Self::OutOfMemory { problem }
            | Self::LimitMissed(problem) => problem,
            Self::Interrupted => "interrupted; no file was left incomplete",
        };
        match self.place() {
            Some(place) => write!(f, "{}: {}", one_line(place), message(problem)),
            None => f.write_str(&message(problem)),
        }
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::InvalidInput { source, .. } | Self::NotFound { source, .. } | Self::Io { source, .. } => {
                source.as_deref().map(|source| source as _)
            }
            _ => None,
        }
    }
}

impl PartialEq for Error {
    fn eq(&self, other: &Self) -> bool {
        self.kind() == other.kind() && self.to_string() == other.to_string()
    }
}

impl Eq for Error {}

/// A number of bytes in MiB or GiB, for messages.
pub(crate) fn gib(bytes: u64) -> String {
    let (mib, gib) = (f64::from(1 << 20), f64::from(1 << 30));
    let bytes = bytes as f64;
    if bytes < gib { format!("{:.0} MiB", bytes / mib) } else { format!("{:.1} GiB", bytes / gib) }
}

thread_local! {
    static GUARDED: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// Runs a third-party parser on this thread; `None` when it panicked.
///
/// Some crates panic on malformed files instead of returning an error. The caller turns `None` into an
/// [`Error::InvalidInput`]; a panic hook can ask [`is_guarded`] and stay silent.
pub(crate) fn guarded<T>(work: impl FnOnce() -> T) -> Option<T> {
    let outer = GUARDED.replace(true);
    let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
    GUARDED.set(outer);
    result.ok()
}

/// Whether this thread is inside [`guarded`], where a panic is handled and not a bug.
pub(crate) fn is_guarded() -> bool {
    GUARDED.get()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::error::Error as _;

    #[test]
    fn kinds_statuses_and_sources() {
        let path = Path::new("a.obj");
        let reading = |kind: io::ErrorKind| Error::reading(path, io::Error::new(kind, "told"));
        for (error, kind, status) in [
            (reading(io::ErrorKind::NotFound), ErrorKind::NotFound, 2),
            (reading(io::ErrorKind::PermissionDenied), ErrorKind::InvalidInput, 2),
            (reading(io::ErrorKind::NotADirectory), ErrorKind::NotFound, 2),
            (reading(io::ErrorKind::InvalidInput), ErrorKind::InvalidInput, 2),
            (reading(io::ErrorKind::InvalidFilename), ErrorKind::InvalidInput, 2),
            (reading(io::ErrorKind::TimedOut), ErrorKind::Io, 1),
            (Error::writing(path, io::ErrorKind::StorageFull.into()), ErrorKind::Io, 1),
        ] {
            assert_eq!((error.kind(), error.exit_status()), (kind, status), "{error}");
            assert_eq!(error.place(), Some("a.obj"));
            let source = error.source().expect("the system's").downcast_ref::<io::Error>();
            assert!(source.is_some(), "{error}");
        }
        assert!(reading(io::ErrorKind::TimedOut).to_string().contains("cannot be read: told"));
        for name in ["a\0.obj", &"a".repeat(5000)] {
            let refused = std::fs::File::open(name).expect_err("no name");
            assert_eq!(Error::reading(Path::new(name), refused).exit_status(), 2, "{name:?}");
        }
        let full = Error::out_of_memory("a cube does not fit");
        assert_eq!((full.to_string().as_str(), full.exit_status()), ("memory: a cube does not fit", 1));
        assert!(full.source().is_none() && Error::input("grid", "too large").source().is_none());
        assert_eq!(
            (Error::LimitMissed("by 2".into()).exit_status(), Error::Interrupted.exit_status()),
            (3, 130)
        );
        assert_ne!(Error::input("memory", "full"), Error::out_of_memory("full"), "they read the same");
    }
}
