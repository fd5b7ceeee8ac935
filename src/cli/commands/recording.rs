//! What `simulate` tells of a recording that it wrote.

use crate::acquisition::RecordingSize;
use crate::cli::outputs::{print_json, print_written};
use crate::cli::summary;
use crate::cli::terminal::{Terminal, print};
use crate::config::RunFile;
use crate::error::Result;
use serde_json::json;
use std::path::Path;

/// Shows the size of a recording, and what `import` must be told of it.
pub(super) fn show(
    run: &RunFile,
    output: &Path,
    (size, gain_db): (RecordingSize, f64),
    terminal: &Terminal,
) -> Result<()> {
    let mut facts = json!({
        "kind": "recording",
        "channels": size.channels,
        "seconds": size.seconds,
        "sample_rate_hz": run.recording.sample_rate,
        "format": run.recording.format,
        "gain_db": gain_db,
    });
    if terminal.json() {
        facts["recording"] = output.display().to_string().into();
        facts["bytes"] = size.bytes.into();
        return print_json(&facts);
    }
    if !terminal.is_quiet() {
        let mut text = summary::facts(&facts);
        if gain_db != 0.0 && run.recording.gain_db.is_none() {
            let advice = format!(
                "import with --set recording.gain_db={gain_db} to have the simulated amplitudes again\n"
            );
            text.push_str(&advice);
        }
        print(&text)?;
    }
    print_written(&[output.to_owned()], terminal)
}
