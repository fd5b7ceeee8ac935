//! The recording of a scene: what an audio interface would store while the scene is measured.

use super::identity;
use super::job::JobOptions;
use super::memory::MemoryBudget;
use super::prepared_scene::{Held, PreparedScene};
use crate::acquisition::{Detection, Electronics, OutputFilter, RecordingSize, write_heard};
use crate::checkpoint::{CheckpointStore, GracefulStop, Stage};
use crate::config::RunFile;
use crate::error::{Error, Result};
use crate::files::extension;
use crate::plan::JobArrays;
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
    let budget = MemoryBudget::of(&quiet);
    let prepared = PreparedScene::of(&budget, job.known(), Held::Cube, observer)?;
    prepared.warn(run, job, observer);
    let options = &prepared.measurement.options;
    // A cube is kept of each harmonic.
    let harmonics = options.simulations(prepared.instrument()) as u64;
    let arrays = JobArrays { samples: prepared.arrays.samples.saturating_mul(harmonics), ..prepared.arrays };
    arrays.peak(0).check(prepared.instrument(), budget.limit, |_| Vec::new())?;
    checkpoint.check_space(size.bytes)?;
    checkpoint.open(&identity::of_scene("simulate", &quiet, &prepared), observer)?;
    let heard = {
        let stop = GracefulStop::new(checkpoint, observer);
        let mut store = CheckpointStore::new(checkpoint, Stage::Cube, &stop);
        prepared.hear(0.5 * f64::from(recorder.sample_rate), &mut store, &stop)?
    };
    let gain_db = write_heard(path, &heard, &recording, &recorder, observer)?;
    Ok((size, gain_db))
}

/// The run file of what the microphones hear, of which a recording is made.
///
/// # Errors
/// A run file of which no recording can be made.
pub(super) fn recorded(run: &RunFile) -> Result<RunFile> {
    run.electronics().as_ref().map_or(Ok(()), Electronics::check_recording)?;
    if run.coding.kind.is_some() {
        let problem = "tells speakers apart that sound at once, and a recording has one after another; write a cube (.npz)";
        return Err(Error::input("[coding]", problem));
    }
    // Both phases are in a time signal, whichever are detected later, and the noise is in the signal.
    let mut quiet = run.clone();
    (quiet.detection.kind, quiet.detection.snr_db) = (Detection::Quadrature, None);
    if !quiet.instrument.harmonics_db.is_empty() {
        // Whatever reads it later, all harmonics are heard.
        quiet.instrument.filter = OutputFilter::Integration;
    }
    Ok(quiet)
}
