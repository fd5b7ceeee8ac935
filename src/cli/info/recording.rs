//! The facts of a recording: its format, and how loud its channels are.

use crate::error::Result;
use crate::files::wav::WavFile;
use serde_json::{Value, json};
use std::path::Path;

/// Frames that are read at once.
const BLOCK: u64 = 4096;

/// Decibels relative to full scale, to a tenth; none of silence.
fn decibels(level: f64) -> Option<f64> {
    (level > 0.0).then(|| (200.0 * level.log10()).round() / 10.0)
}

/// Format, duration, and level and peak of every channel.
///
/// # Errors
/// A file that is no WAV file, or not finite.
pub(super) fn facts(path: &Path) -> Result<Value> {
    let mut file = WavFile::open(path)?;
    let mut channels = vec![[0.0_f64; 2]; file.channels()];
    let count = channels.len();
    for first in (0..file.frames()).step_by(BLOCK as usize) {
        let frames = file.read(first, BLOCK.min(file.frames() - first))?;
        for (index, sample) in frames.iter().enumerate() {
            let [power, peak] = &mut channels[index % count];
            *power += f64::from(*sample).powi(2);
            *peak = peak.max(f64::from(sample.abs()));
        }
    }
    let frames = file.frames() as f64;
    Ok(json!({
        "kind": "recording",
        "format": file.described(),
        "frames": file.frames(),
        "seconds": file.seconds(),
        "levels_db": channels.iter().map(|[power, _]| decibels((power / frames).sqrt())).collect::<Vec<_>>(),
        "peaks_db": channels.iter().map(|[_, peak]| decibels(*peak)).collect::<Vec<_>>(),
    }))
}
