//! The crate's one error type, grouped by who can put it right.
//!
//! A message is one paragraph that says where (file, line, key, node), what is wrong, what was expected and
//! how to mend it. What a user can cause is always an [`Error`]; only a programmer's mistake panics.

use std::fmt::Display;
use std::io;
use std::path::Path;

/// What went wrong, by who can mend it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The request or an input file is wrong; the user mends it. Exit status 2.
    #[error("{place}: {problem}")]
    Input {
        /// File, line, key, node or option at fault.
        place: String,
        /// What is wrong there, what was expected, and how to mend it.
        problem: String,
    },
    /// The machine failed: disk, permissions, memory. Exit status 1.
    #[error("{place}: {problem}")]
    Environment {
        /// File or resource concerned.
        place: String,
        /// What failed.
        problem: String,
    },
    /// A limit of `compare` or `check` was missed. Exit status 3.
    #[error("{0}")]
    Limit(String),
    /// The user asked to stop. Exit status 130.
    #[error("interrupted; nothing was left half-written")]
    Interrupted,
}

/// `Result` with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// A mistake in what the user gave.
    pub fn input(place: impl Display, problem: impl Into<String>) -> Self {
        Self::Input { place: place.to_string(), problem: problem.into() }
    }

    /// A failure of the machine.
    pub fn environment(place: impl Display, problem: impl Into<String>) -> Self {
        Self::Environment { place: place.to_string(), problem: problem.into() }
    }

    /// The same mistake at another place: that of the file or key the caller took the values from. What is not the user's
    /// to mend stays as it is.
    ///
    /// ```
    /// use holosonar::acquisition::Sweep;
    ///
    /// let error = Sweep::stepped(20e3, 10e3, 20.0).map_err(|e| e.at("run.toml, [sweep]")).unwrap_err();
    /// assert!(error.to_string().starts_with("run.toml, [sweep]: "));
    /// ```
    #[must_use]
    pub fn at(self, place: impl Display) -> Self {
        match self {
            Self::Input { problem, .. } => Self::Input { place: place.to_string(), problem },
            other => other,
        }
    }

    /// An input file that could not be read: the user's to mend when it is missing, a folder or forbidden.
    pub fn reading(path: &Path, error: &io::Error) -> Self {
        let place = path.display();
        match error.kind() {
            io::ErrorKind::NotFound => Self::input(place, "no such file; check the path"),
            io::ErrorKind::IsADirectory => Self::input(place, "is a folder, a file was expected"),
            io::ErrorKind::PermissionDenied => Self::input(place, "may not be read (permission denied)"),
            _ => Self::environment(place, format!("cannot be read: {error}")),
        }
    }

    /// An output file that could not be written.
    pub fn writing(path: &Path, error: &io::Error) -> Self {
        Self::environment(path.display(), format!("cannot be written: {error}"))
    }

    /// The process's exit status for this error (DESIGN: 1 environment, 2 request, 3 limit, 130 interrupted).
    pub fn exit_status(&self) -> u8 {
        match self {
            Self::Environment { .. } => 1,
            Self::Input { .. } => 2,
            Self::Limit(_) => 3,
            Self::Interrupted => 130,
        }
    }
}

/// Bytes as people read them.
pub fn gib(bytes: u64) -> String {
    let (mib, gib) = (f64::from(1 << 20), f64::from(1 << 30));
    let bytes = bytes as f64;
    if bytes < gib { format!("{:.0} MiB", bytes / mib) } else { format!("{:.1} GiB", bytes / gib) }
}

thread_local! {
    static GUARDED: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// Runs a foreign parser on this thread; `None` when it panicked on what it was given.
///
/// Some crates panic on malformed files instead of returning an error. The caller turns `None` into an
/// [`Error::Input`]; a panic hook can ask [`is_guarded`] and stay silent.
pub fn guarded<T>(work: impl FnOnce() -> T) -> Option<T> {
    let outer = GUARDED.replace(true);
    let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
    GUARDED.set(outer);
    result.ok()
}

/// Whether this thread is inside [`guarded`], where a panic is an answer and not a mistake.
pub fn is_guarded() -> bool {
    GUARDED.get()
}
