//! Showing a page in the browser that the system takes for HTML.

use crate::error::{Error, Result};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// How long a browser's starter may take to fail, in tenths of a second.
const PATIENCE: u32 = 20;

/// Opens a file; does not wait for the browser to end.
pub(super) fn open(page: &Path) -> Result<()> {
    // A bare `-name.html` would be taken for an option.
    let page = std::path::absolute(page).unwrap_or_else(|_| page.to_path_buf());
    let mut command = if cfg!(target_os = "macos") {
        Command::new("open")
    } else if cfg!(windows) {
        // The empty word is the title of a window that `start` would otherwise take the path for.
        let mut command = Command::new("cmd");
        command.args(["/C", "start", ""]);
        command
    } else {
        Command::new("xdg-open")
    };
    let name = command.get_program().to_string_lossy().into_owned();
    let failed =
        |why: String| Error::io("--open", format!("{why}; open {} in a browser yourself", page.display()));
    let quiet = command.arg(&page).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = quiet.spawn().map_err(|error| failed(format!("`{name}` cannot be started ({error})")))?;
    // Some starters stay for as long as the browser does; one that fails does so at once.
    for _ in 0..PATIENCE {
        match child.try_wait() {
            Ok(Some(status)) if status.success() => return Ok(()),
            Ok(Some(status)) => return Err(failed(format!("`{name}` ended with {status}"))),
            _ => std::thread::sleep(Duration::from_millis(100)),
        }
    }
    Ok(())
}
