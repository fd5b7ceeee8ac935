//! Corrections of a measured cube: channels that lie, the empty room, responses of speaker and microphones, delays, and
//! what comes from outside the scene.
//!
//! A [`Calibration`] is applied in a fixed order, each step to what the last has left: `mask`, `code`, `background`, `high_pass`,
//! `response`, `delay`, `gate`, `tilt`. Every step is a linear operation on the samples but the choice of the mask, and each says
//! in words what it did. [`ChannelResponse`] is measured with a target at a known place.

mod background;
mod gate;
mod mask;
mod response;
#[cfg(test)]
mod tests;

pub use background::Background;
pub use mask::{AutoWord, ChannelMask};
pub use response::{ChannelResponse, ResponseAxis};

use super::{DataCube, Detection, Instrument, SourceCode, TraceColumn};
use crate::error::{Error, Result};
use crate::files::extension;
use crate::progress::{Observer, stage};
use crate::wave::phasor;
use glam::DVec3;
use num_complex::Complex32;
use std::path::PathBuf;

/// The corrections of a cube; the default is none.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Calibration {
    /// Microphones that are silenced.
    pub mask: ChannelMask,
    /// How loudspeakers that sounded at once are told apart, where the cube's transmissions are the sweeps of a code.
    pub code: Option<SourceCode>,
    /// The loudspeakers that are told apart, m; empty: those of the cube.
    pub loudspeakers: Vec<DVec3>,
    /// What is subtracted of every sample.
    pub background: Option<Background>,
    /// Diameter of the disc around a microphone, m, whose mean at each frequency is subtracted: what is the same there is
    /// no echo of a near scene.
    pub high_pass: Option<f64>,
    /// File of responses by which samples are divided: `.npz` as [`ChannelResponse::write`] writes it; of frequencies
    /// alone also `.csv`, or phases in rad as `.npy`.
    pub response: Option<PathBuf>,
    /// The columns of a `.csv`; empty: as its header says.
    pub columns: Vec<TraceColumn>,
    /// -1 if the phases of a `.csv` or `.npy` fall with the path.
    pub phase_sign: i32,
    /// How much longer the recorded paths are than those through the air, m.
    pub delay: f64,
    /// The paths that are kept, from and to, m.
    pub gate: Option<[f64; 2]>,
    /// Angles by which the microphones are turned about the array's centre, degrees: about x, then about y.
    pub tilt: [f64; 2],
    /// Maximum bytes of a file's array in memory.
    pub memory: u64,
}

impl Calibration {
    /// Whether it changes nothing.
    pub fn is_empty(&self) -> bool {
        let Self { mask, code, background, high_pass, response, delay, gate, tilt, .. } = self;
        *mask == ChannelMask::default()
            && code.is_none()
            && background.is_none()
            && high_pass.is_none()
            && response.is_none()
            && *delay == 0.0
            && gate.is_none()
            && *tilt == [0.0; 2]
    }

    /// Corrects the samples of `cube`, of several loudspeakers those of each, which need not be finite before, and says what
    /// was done; the words are also in the cube's provenance.
    ///
    /// Cost: a few operations per sample, of the gate n log n, of the high-pass as many as microphones in its disc.
    /// Memory: that of the cube again for a background file.
    ///
    /// # Errors
    /// Samples that are not finite in microphones that are not masked; files that are missing or of another instrument;
    /// responses and delays of in-phase cubes, which have no phase; a gate longer than the path that is unambiguous.
    pub fn apply(&self, cube: &mut DataCube, observer: &dyn Observer) -> Result<Vec<String>> {
        let (masked, mut words) = self.mask.find(cube, observer)?;
        silence(cube, &masked, 0.0);
        super::cube::check_all_finite("samples", &cube.instrument, &cube.samples)?;
        if let Some(code) = &self.code {
            words.push(code.decode_cube(cube, &self.loudspeakers)?);
        }
        if let Some(background) = &self.background {
            words.push(stage(observer, "subtracting the background", 0, || {
                background.subtract(cube, &masked, self.memory)
            })?);
        }
        if let Some(diameter) = self.high_pass {
            let rows = (cube.instrument.transmissions() * cube.instrument.sweep.len()) as u64;
            let subtracted = stage(observer, "subtracting the neighbours' mean", rows, || {
                background::subtract_neighbours(cube, &masked, diameter, observer)
            });
            words.push(subtracted?);
        }
        if let Some(path) = &self.response {
            let response = match extension(path).as_str() {
                "npz" => ChannelResponse::read(path, self.memory)?,
                _ => ChannelResponse::of_frequencies(path, &self.columns, self.phase_sign, self.memory)?,
            };
            words.push(response.divide(cube).map_err(|error| error.at(path.display()))?);
        }
        if self.delay != 0.0 {
            need_phases(&cube.instrument, "[calibration] delay")?;
            let turns = self.delay / cube.instrument.sound_speed;
            let factors: Vec<Complex32> =
                cube.instrument.sweep.frequencies().iter().map(|f| phasor(-f * turns)).collect();
            multiply_tones(cube, &factors);
            words.push(format!("paths shortened by {} m", self.delay));
        }
        if let Some(paths) = self.gate {
            words.push(stage(observer, "gating", 0, || gate::keep(cube, paths))?);
        }
        if self.tilt != [0.0; 2] {
            let array = cube.instrument.array.tilted(self.tilt)?;
            cube.instrument = cube.instrument.clone().with_moved(array);
            words.push(format!("array tilted by {}° about x and {}° about y", self.tilt[0], self.tilt[1]));
        }
        // The mean over all microphones would be lower by those that are silent.
        let heard = masked.iter().filter(|masked| !**masked).count();
        silence(cube, &masked, masked.len() as f32 / heard as f32 - 1.0);
        note(cube, &words);
        Ok(words)
    }
}

/// Silences masked microphones and raises the others by a share.
fn silence(cube: &mut DataCube, masked: &[bool], raise: f32) {
    if !masked.contains(&true) {
        return;
    }
    for row in cube.samples.chunks_exact_mut(masked.len()) {
        for (m, masked) in row.iter_mut().zip(masked) {
            // Zero times what is not finite is not 0.
            *m = if *masked { Complex32::ZERO } else { *m * (1.0 + raise) };
        }
    }
}

/// Refuses a correction of phases where there are none.
fn need_phases(instrument: &Instrument, place: &str) -> Result<()> {
    if instrument.detection == Detection::Quadrature {
        return Ok(());
    }
    let problem = "turns phases, and in-phase samples have none; record both, I and Q";
    Err(Error::input(place, problem))
}

/// Multiplies all samples of each tone, of every transmission, by a factor.
fn multiply_tones(cube: &mut DataCube, factors: &[Complex32]) {
    let n_mic = cube.instrument.array.len();
    for (row, factor) in cube.samples.chunks_exact_mut(n_mic).zip(factors.iter().cycle()) {
        for m in row {
            *m *= factor;
        }
    }
}

/// Adds words on corrections to the provenance.
pub(crate) fn note(cube: &mut DataCube, words: &[String]) {
    if !cube.provenance.is_object() {
        cube.provenance = serde_json::json!({});
    }
    let mut all = cube.provenance["calibration"].as_array().cloned().unwrap_or_default();
    all.extend(words.iter().map(|word| word.as_str().into()));
    cube.provenance["calibration"] = all.into();
}
