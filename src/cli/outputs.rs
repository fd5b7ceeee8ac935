//! Where a command writes, and what it says of it.

use super::inputs::has_extension;
use super::terminal::{Terminal, print};
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// Refuses an output name before any work is done for it.
pub(super) fn check_extension(path: &Path, extensions: &[&str]) -> Result<()> {
    if has_extension(path, extensions) {
        return Ok(());
    }
    let known = extensions.iter().map(|e| format!(".{e}")).collect::<Vec<_>>().join(", ");
    Err(Error::input(
        path.display(),
        format!("the extension decides the format; this command writes {known}"),
    ))
}

/// Makes the output folder first, so that a place that cannot be written is found before the long work; says whether it
/// was not there before.
pub(super) fn make_folder(folder: &Path) -> Result<bool> {
    let missing = !folder.exists();
    std::fs::create_dir_all(folder).map(|()| missing).map_err(|e| match e.kind() {
        std::io::ErrorKind::AlreadyExists | std::io::ErrorKind::NotADirectory => {
            Error::input(folder.display(), "is a file; a folder was expected")
        }
        _ => Error::writing(folder, e),
    })
}

/// Tells of the files that a command wrote.
pub(super) fn wrote(files: &[PathBuf], json: bool, terminal: &Terminal) -> Result<()> {
    if json {
        return print(&pretty(&serde_json::json!({ "files": files })));
    }
    if terminal.is_quiet() {
        return Ok(());
    }
    let lines: Vec<String> = files.iter().map(|path| format!("wrote {}\n", path.display())).collect();
    print(&lines.concat())
}

/// JSON as it is printed and written.
pub(super) fn pretty(value: &serde_json::Value) -> String {
    format!("{value:#}\n")
}
