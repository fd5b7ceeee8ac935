//! The figure of a cube's health: levels of microphones and tones, and the mean range profile.

use super::canvas::Canvas;
use super::chart::line;
use super::{ColourMap, Panel, Scale, layout};
use crate::acquisition::{ChannelLevels, CubeSource, Detection, Health, MeanProfile, TransmissionHealth};
use crate::error::Result;
use std::path::Path;

/// Levels that are drawn, dB: from dead to loud, and below the strongest echo.
const LEVELS: [f64; 2] = [-40.0, 20.0];
const ECHOES_DB: f64 = 100.0;

/// Most speakers whose profiles are drawn.
const MOST_SPEAKERS: usize = 8;

const AGAINST: &str = "against the median / dB";

/// Draws the levels of the microphones, as a map on a lattice, those of the tones, and the mean range profile with both
/// signs of the phase; of several loudspeakers their levels, too, and the profile of each of the first eight.
///
/// # Errors
/// As [`crate::files::write_atomically`].
pub(crate) fn write_health_figure(path: &Path, health: &Health, cube: &dyn CubeSource) -> Result<()> {
    let instrument = cube.instrument();
    let mut pictures = vec![match instrument.array.lattice() {
        Some(lattice) if lattice.x.count > 1 && lattice.y.count > 1 => {
            let levels = decibels(&health.microphones);
            let range = |pick: fn(f64, f64) -> f64, start| {
                levels.iter().copied().filter(|v| v.is_finite()).fold(start, pick)
            };
            let scale = Scale::Sequential {
                map: ColourMap::Viridis,
                range: [range(f64::min, -1.0).max(LEVELS[0]), range(f64::max, 1.0).min(LEVELS[1])],
                label: "level against the median / dB".into(),
            };
            let values: Vec<f32> = levels.iter().map(|v| *v as f32).collect();
            let nothing = "silent or missing".into();
            let title = "level by microphone";
            layout::draw(&[Panel { nothing, ..Panel::new(title, values, lattice.x, lattice.y, scale) }], 1)
        }
        _ => {
            let places: Vec<f64> = (0..health.microphones.count).map(|i| i as f64).collect();
            line(
                "level by microphone",
                ["microphone", AGAINST],
                &places,
                &[(String::new(), decibels(&health.microphones))],
            )
        }
    }];
    let frequencies = instrument.sweep.frequencies();
    pictures.push(line(
        "level by tone",
        ["frequency / Hz", AGAINST],
        frequencies,
        &[(String::new(), decibels(&health.tones))],
    ));
    let both_signs = health.detection == Detection::Quadrature;
    if let Some(profile) = &health.profile {
        pictures.push(profile_by_range("mean range profile", profile, both_signs));
    }
    if !health.transmissions.is_empty() {
        let numbers: Vec<f64> = (0..health.transmissions.len()).map(|i| i as f64).collect();
        let level = |each: &TransmissionHealth| each.level_db.unwrap_or(f64::NAN);
        let levels = health.transmissions.iter().map(level).collect();
        pictures.push(line("level by speaker", ["speaker", AGAINST], &numbers, &[(String::new(), levels)]));
    }
    for (number, each) in health.transmissions.iter().enumerate().take(MOST_SPEAKERS) {
        if let Some(profile) = &each.profile {
            pictures.push(profile_by_range(&format!("range profile, speaker {number}"), profile, both_signs));
        }
    }
    Canvas::in_pairs(&pictures).write_png(path)
}

/// The power of echoes by their range, with both signs of the phase where there is one.
fn profile_by_range(title: &str, profile: &MeanProfile, both_signs: bool) -> Canvas {
    let strongest = profile.power.iter().copied().fold(0.0, f64::max);
    let level = |power: &f64| 10.0 * power.log10();
    let shown = |power: &f64| level(&power.max(strongest * 10_f64.powf(-ECHOES_DB / 10.0)));
    let ranges: Vec<f64> = (0..profile.power.len()).map(|k| k as f64 * profile.range_pitch).collect();
    let declared: Vec<f64> = profile.power.iter().map(shown).collect();
    let mut series = vec![("phase sign as declared".to_owned(), declared)];
    if both_signs {
        let mut opposite = series[0].1.clone();
        // The conjugate's profile is the same backwards.
        opposite[1..].reverse();
        series.push(("opposite phase sign".to_owned(), opposite));
    }
    line(title, ["range (half of the path) / m", "power / dB"], &ranges, &series)
}

/// Levels against their median, dB; NaN where there is none.
fn decibels(levels: &ChannelLevels) -> Vec<f64> {
    (0..levels.count).map(|i| levels.level_db(i).unwrap_or(f64::NAN)).collect()
}
