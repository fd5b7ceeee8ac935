//! Which unfinished files and folders there are, so that a process that ends at once, within a long call, can remove them.
//!
//! Everywhere else they are removed by whoever made them; the list serves only the end by a signal.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The paths, in the order in which they were listed.
#[derive(Debug)]
struct List(Mutex<Vec<PathBuf>>);

/// Those of this process.
static LIST: List = List(Mutex::new(Vec::new()));

/// A file, a store or an empty folder to be removed if the process ends while this exists.
#[derive(Debug)]
pub(crate) struct Unfinished {
    list: &'static List,
    path: PathBuf,
}

impl Unfinished {
    /// Makes something at a path of its own and lists it; the process does not end in between.
    ///
    /// # Errors
    /// Those of `make`.
    pub(crate) fn make<T>(
        make: impl FnOnce() -> io::Result<T>,
        path: impl FnOnce(&T) -> &Path,
    ) -> io::Result<(T, Self)> {
        LIST.make(make, path)
    }

    /// Lists what exists already.
    pub(crate) fn listed(path: &Path) -> Self {
        LIST.locked().push(path.to_owned());
        Self { list: &LIST, path: path.to_owned() }
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        let mut listed = self.list.locked();
        if let Some(at) = listed.iter().position(|path| *path == self.path) {
            listed.remove(at);
        }
    }
}

/// Removes everything in the list, the last first; of folders, unfinished stores and those that are then empty. Nothing more
/// can be listed until the returned value is dropped: the process is meant to end before.
pub(crate) fn remove_all() -> impl Sized {
    LIST.remove_all()
}

impl List {
    fn locked(&self) -> MutexGuard<'_, Vec<PathBuf>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn make<T>(
        &'static self,
        make: impl FnOnce() -> io::Result<T>,
        path: impl FnOnce(&T) -> &Path,
    ) -> io::Result<(T, Unfinished)> {
        let mut listed = self.locked();
        let made = make()?;
        let path = path(&made).to_owned();
        listed.push(path.clone());
        Ok((made, Unfinished { list: self, path }))
    }

    /// As [`remove_all`]; `None` if a disk that does not answer holds the list up.
    fn remove_all(&self) -> Option<MutexGuard<'_, Vec<PathBuf>>> {
        let try_lock = |_| {
            let listed = self.0.try_lock().ok();
            if listed.is_none() {
                std::thread::sleep(Duration::from_millis(5));
            }
            listed
        };
        let mut listed = (0..20).find_map(try_lock)?;
        while let Some(path) = listed.pop() {
            let _ = match path.is_dir() {
                // A store.
                true if path.extension().is_some_and(|e| e == "part") => fs::remove_dir_all(path),
                true => fs::remove_dir(path),
                false => fs::remove_file(path),
            };
        }
        Some(listed)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn what_is_unfinished_is_removed_and_what_is_finished_stays() {
        let list: &'static List = Box::leak(Box::new(List(Mutex::default())));
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let make = |name: &str| {
            let made = path(name);
            list.make(|| fs::write(&made, "half").map(|()| made.clone()), |made| made).unwrap().1
        };
        let (done, _open) = (make("done"), make("open"));
        drop(done);
        fs::create_dir(path("new")).unwrap();
        let (_new, _within) = (list.make(|| Ok(path("new")), |new| new), make("new/within"));
        fs::create_dir(path("full")).unwrap();
        fs::write(path("full/result"), "whole").unwrap();
        let _full = list.make(|| Ok(path("full")), |full| full);
        assert!(list.make(|| Err::<PathBuf, _>(io::Error::other("full")), |made| made).is_err());
        assert!(list.remove_all().is_some_and(|listed| listed.is_empty()));
        let left = ["done", "open", "new", "full", "full/result"].map(|name| path(name).exists());
        assert_eq!(left, [true, false, false, true, true]);
    }
}
