//! Showing a page in the browser that the system takes for HTML.

use holosonar::error::{Error, Result};
use std::path::Path;
use std::process::{Command, Stdio};

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
    let failed = |why: String| {
        Error::environment("--open", format!("{why}; open {} in a browser yourself", page.display()))
    };
    let quiet = command.arg(&page).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let status = quiet.status().map_err(|error| failed(format!("`{name}` cannot be started ({error})")))?;
    if status.success() { Ok(()) } else { Err(failed(format!("`{name}` ended with {status}"))) }
}
