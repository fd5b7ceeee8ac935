//! Time recordings: WAV files, of all microphones or of some each.

use super::{FileSamples, ImportOptions, names, place_of_key, positions_of, sweep_of, typed_frequencies};
use crate::acquisition::recording::demodulate;
use crate::acquisition::{Detection, Instrument};
use crate::error::{Error, Result};
use crate::wave::{DEFAULT_SOUND_SPEED, Geometry};

/// Recordings in the order of the microphones, with what is said of them in [`ImportOptions::recording`].
///
/// # Errors
/// As [`demodulate`]; what nobody said of frequencies and positions.
pub(super) fn read_recordings(
    options: &ImportOptions,
    guesses: &mut Vec<String>,
    warnings: &mut Vec<String>,
) -> Result<FileSamples> {
    if options.phase_sign == Some(-1) {
        let problem =
            "is -1, and the sign of a recording's phases is known: they fall with the path, and are turned";
        return Err(Error::input(place_of_key("phase_sign"), problem));
    }
    let (files, positions) = match &options.samples[..] {
        [pattern] if names::is_pattern(pattern) => names::find(pattern, options, guesses)?,
        files => (files.to_vec(), positions_of(options, None)?),
    };
    let sweep = sweep_of(options, typed_frequencies(options, None)?, None, "")?;
    let instrument = Instrument::new(sweep.0.clone(), positions.array.clone())
        .with_geometry(options.geometry.unwrap_or(Geometry::ORIGIN))
        .with_sound_speed(options.sound_speed.unwrap_or(DEFAULT_SOUND_SPEED));
    instrument.check()?;
    let mut found = demodulate(&files, &instrument, &options.recording, options.limit())?;
    guesses.append(&mut found.guesses);
    warnings.append(&mut found.warnings);
    let real = options.detection == Some(Detection::InPhase);
    if real {
        found.samples.iter_mut().for_each(|m| m.im = 0.0);
    }
    let place = place_of_key("samples");
    let phase_sign = Some(1);
    Ok(FileSamples { samples: found.samples, real, sweep, positions, place, phase_sign, facts: found.facts })
}
