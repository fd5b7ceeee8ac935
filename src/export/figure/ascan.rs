//! The figure of an A-scan: the range profile of a microphone, and the correlation waveform that it was made of.

use super::canvas::Canvas;
use super::chart::line;
use crate::acquisition::{AScan, Detection};
use crate::error::Result;
use std::path::Path;

/// Levels that are drawn, dB below the strongest.
const SHOWN_DB: f64 = 80.0;

/// Samples of the waveform that are drawn, from the first on; more would be a band without waves.
const WAVES: usize = 200;

/// Draws the levels of a profile over the range or, if `path`, over the whole path, and the samples over the frequency
/// (Eq. 3).
///
/// # Errors
/// As [`crate::files::write_atomically`].
pub(crate) fn write_ascan_figure(file: &Path, scan: &AScan, path: bool) -> Result<()> {
    let strongest = scan.amplitude.iter().copied().fold(0.0, f64::max);
    let least = strongest * 10_f64.powf(-SHOWN_DB / 20.0);
    let levels: Vec<f64> = scan.amplitude.iter().map(|value| 20.0 * value.max(least).log10()).collect();
    let pitch = if path { scan.path_pitch } else { 0.5 * scan.path_pitch };
    let places: Vec<f64> = (0..levels.len()).map(|k| k as f64 * pitch).collect();
    let title = match scan.microphone {
        Some(microphone) => format!("range profile of microphone {microphone}"),
        None => format!("mean range profile of {} microphones", scan.microphones),
    };
    let label = if path { "path / m" } else { "range (half of the path) / m" };
    let mut pictures = vec![line(&title, [label, "level / dB"], &places, &[(String::new(), levels)])];
    if !scan.samples.is_empty() {
        let shown = scan.samples.len().min(WAVES);
        let part = |i: usize| scan.samples[..shown].iter().map(|m| f64::from(m[i])).collect::<Vec<_>>();
        let mut series = vec![("in phase".to_owned(), part(0))];
        if scan.detection == Detection::Quadrature {
            series.push(("quadrature".to_owned(), part(1)));
        }
        let all = scan.samples.len();
        let title =
            if shown < all { format!("samples, the first {shown} of {all}") } else { "samples".to_owned() };
        pictures.push(line(&title, ["frequency / Hz", "m"], &scan.frequencies[..shown], &series));
    }
    Canvas::in_pairs(&pictures).write_png(file)
}
