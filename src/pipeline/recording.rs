//! The recording of a scene: what an audio interface would store while the scene is measured.

use super::job::JobOptions;
use super::memory::MemoryBudget;
use super::prepared_scene::PreparedScene;
use super::{identity, simulate};
use crate::acquisition::{Detection, InstrumentElement, RecordingSize, write_recording};
use crate::config::RunFile;
use crate::error::{Error, Result};
use crate::files::extension;
use std::path::Path;

/// Simulates a scene and writes its recording, `.wav`, as `[recording]` says; returns its size and the gain of the
/// microphones' channels, dB. The checkpoint is used as by [`super::image_scene`], for the cube.
///
/// # Errors
/// Those of [`super::simulate_scene`] and [`RecordingSize::of`]; another extension.
pub fn record_scene(run: &RunFile, path: &Path, job: &JobOptions) -> Result<(RecordingSize, f64)> {
    let JobOptions { checkpoint, observer, .. } = *job;
    if extension(path) != "wav" {
        return Err(Error::input(path.display(), "recordings are written as .wav; give this extension"));
    }
    let quiet = recorded(run)?;
    let (recording, recorder) = (run.recording_options(), run.recorder_options());
    let size = RecordingSize::of(&quiet.instrument()?, &recording, &recorder)?;
    let prepared = PreparedScene::of(&MemoryBudget::of(&quiet), job.known(), false, observer)?;
    prepared.warn(run, job, observer);
    checkpoint.check_space(size.bytes)?;
    checkpoint.open(&identity::of_scene("simulate", &quiet, &prepared), observer)?;
    let cube = simulate(&quiet, &prepared, checkpoint, observer)?;
    let gain_db = write_recording(path, &cube, &recording, &recorder, observer)?;
    Ok((size, gain_db))
}

/// The run file of the cube of which a recording is made.
///
/// # Errors
/// A run file of which no recording can be made.
pub(super) fn recorded(run: &RunFile) -> Result<RunFile> {
    check_electronics(run)?;
    if run.coding.kind.is_some() {
        let problem = "tells speakers apart that sound at once, and a recording has one after another; write a cube (.npz)";
        return Err(Error::input("[coding]", problem));
    }
    // Both phases are in a time signal, whichever are detected later, and the noise is in the signal.
    let mut quiet = run.clone();
    (quiet.detection.kind, quiet.detection.snr_db) = (Detection::Quadrature, None);
    Ok(quiet)
}

/// Refuses electronics behind the microphone, of which a recording shows nothing.
fn check_electronics(run: &RunFile) -> Result<()> {
    use InstrumentElement::{AmplifierBand, MicrophoneBand};
    let elements = run.electronics().map_or(Vec::new(), |electronics| electronics.elements());
    let Some(element) = elements.into_iter().find(|e| ![AmplifierBand, MicrophoneBand].contains(e)) else {
        return Ok(());
    };
    let problem = format!(
        "has a {element}, and a recording is what the microphones hear: only amplifier_band and microphone_band are in it; \
         write a cube (.npz), and see decay, format and sample_rate of [recording]"
    );
    Err(Error::input("[instrument]", problem))
}
