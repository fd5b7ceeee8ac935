//! Responses of speaker and microphones: their file, their division, their measurement with a target at a known place.

use super::{multiply_tones, need_phases};
use crate::acquisition::import::frequency_response;
use crate::acquisition::{DataCube, Detection, TraceColumn};
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::files::npz::{NpzReader, write_npz};
use crate::text::quoted;
use crate::wave::phasor;
use glam::DVec3;
use num_complex::{Complex32, Complex64};
use serde_json::json;
use std::path::Path;

choice! {
    /// What a response is measured for.
    pub enum ResponseAxis: "per" {
        /// Each frequency: speaker, cables, converters.
        Frequency = "frequency",
        /// Each microphone: gains and phases.
        Microphone = "microphone",
        /// The product of both.
        Both = "both",
    }
}

/// What a chain of speaker and microphones does to an echo: `frequency[f] · microphone[r]`.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ChannelResponse {
    /// `[n_f]`; empty: 1 at all.
    pub frequency: Vec<Complex32>,
    /// `[n_mic]`; empty: 1 at all.
    pub microphone: Vec<Complex32>,
    /// Hz, of which the response was measured; empty: not known.
    frequencies: Vec<f64>,
    /// Share of the samples' power that it explained, 1 for a perfect target; NaN where it was not measured.
    pub explained: f64,
}

/// A channel whose response is so far below the median's is silenced: dividing would raise its noise.
const LEAST: f32 = 1e-3;

/// The arrays of a file.
const FREQUENCY: &str = "frequency_response";
const MICROPHONE: &str = "microphone_response";
const FORMAT: &str = "holosonar-calibration";

impl ChannelResponse {
    /// Measures the response with the cube of a small target at `target`, m, alone in the room or the only one that a gate
    /// left. Its rms over all samples is 1, so that dividing by it keeps amplitudes.
    ///
    /// Cost: some operations per sample; of both axes 20 times that.
    ///
    /// # Errors
    /// An in-phase cube, which has no phases; one of several loudspeakers; a silent one.
    pub fn measure(cube: &DataCube, target: DVec3, axis: ResponseAxis) -> Result<Self> {
        need_phases(&cube.instrument, "--reference")?;
        cube.instrument.need_one_source("--reference")?;
        let instrument = &cube.instrument;
        let (f, n_mic) = (instrument.sweep.frequencies(), instrument.array.len());
        let lengths: Vec<f64> = instrument
            .array
            .positions()
            .iter()
            .map(|r| instrument.path_length(target, *r) / instrument.sound_speed)
            .collect();
        // What is left when the phase of the path is taken away.
        let ratio = |i: usize, r: usize| {
            let m = cube.samples[i * n_mic + r] * phasor(-f[i] * lengths[r]);
            Complex64::new(m.re.into(), m.im.into())
        };
        let mut tones = vec![Complex64::ONE; f.len()];
        let mut mics = vec![Complex64::ONE; n_mic];
        let rounds = if axis == ResponseAxis::Both { ROUNDS } else { 1 };
        for _ in 0..rounds {
            if axis != ResponseAxis::Microphone {
                let norm: f64 = mics.iter().map(Complex64::norm_sqr).sum();
                for (i, tone) in tones.iter_mut().enumerate() {
                    *tone = (0..n_mic).map(|r| ratio(i, r) * mics[r].conj()).sum::<Complex64>() / norm;
                }
            }
            if axis != ResponseAxis::Frequency {
                let norm: f64 = tones.iter().map(Complex64::norm_sqr).sum();
                for (r, mic) in mics.iter_mut().enumerate() {
                    *mic = (0..f.len()).map(|i| ratio(i, r) * tones[i].conj()).sum::<Complex64>() / norm;
                }
            }
            let mean = (mics.iter().map(Complex64::norm_sqr).sum::<f64>() / n_mic as f64).sqrt();
            if axis == ResponseAxis::Both && mean > 0.0 {
                for mic in &mut mics {
                    *mic /= mean;
                }
                for tone in &mut tones {
                    *tone *= mean;
                }
            }
        }
        let (mut whole, mut missed) = (0.0, 0.0);
        for (i, tone) in tones.iter().enumerate() {
            for (r, mic) in mics.iter().enumerate() {
                let m = ratio(i, r);
                whole += m.norm_sqr();
                missed += (m - tone * mic).norm_sqr();
            }
        }
        let rms = |values: &[Complex64]| {
            (values.iter().map(Complex64::norm_sqr).sum::<f64>() / values.len() as f64).sqrt()
        };
        let scale = [rms(&tones), rms(&mics)];
        if !(whole > 0.0 && scale[0] > 0.0 && scale[1] > 0.0) {
            return Err(Error::input("--reference", "is silent; nothing can be measured with it"));
        }
        let single = |values: &[Complex64], scale: f64| {
            values.iter().map(|v| Complex32::new((v.re / scale) as f32, (v.im / scale) as f32)).collect()
        };
        Ok(Self {
            frequency: if axis == ResponseAxis::Microphone { Vec::new() } else { single(&tones, scale[0]) },
            microphone: if axis == ResponseAxis::Frequency { Vec::new() } else { single(&mics, scale[1]) },
            frequencies: f.to_vec(),
            explained: 1.0 - missed / whole,
        })
    }

    /// Writes the response, `.npz`: `frequency_response` `[n_f]`, `microphone_response` `[n_mic]`, `frequencies`, `meta`.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be written; an existing file is then unchanged.
    pub fn write(&self, path: &Path) -> Result<()> {
        let meta = json!({ "format": FORMAT, "version": 1, "explained": self.explained });
        write_npz(path, |npz| {
            for (name, values) in [(FREQUENCY, &self.frequency), (MICROPHONE, &self.microphone)] {
                if !values.is_empty() {
                    npz.complex(name, &[values.len()], values)?;
                }
            }
            npz.f64("frequencies", &[self.frequencies.len()], &self.frequencies)?;
            npz.text("meta", &meta.to_string())
        })
    }

    /// Reads what [`ChannelResponse::write`] writes; `limit` bounds the bytes of an array.
    ///
    /// # Errors
    /// A file without a response; values that are not finite; unknown arrays.
    pub fn read(path: &Path, limit: u64) -> Result<Self> {
        let mut npz = NpzReader::open(path, limit)?;
        let refuse = |problem: String| Err(Error::input(path.display(), problem));
        let known = [FREQUENCY, MICROPHONE, "frequencies", "meta"];
        if let Some(unknown) = npz.names().find(|name| !known.contains(name)) {
            let unknown = quoted(unknown);
            return refuse(format!("has the array `{unknown}`; a response has {}", known.join(", ")));
        }
        let mut read = |name: &str| -> Result<Vec<Complex32>> {
            if !npz.contains(name) {
                return Ok(Vec::new());
            }
            let array = npz.complex(name)?;
            if array.shape.len() != 1 || array.data.iter().any(|value| !value.is_finite()) {
                let place = format!("{}, array `{name}`", path.display());
                return Err(Error::input(place, "must be a list of finite numbers"));
            }
            Ok(array.data)
        };
        let (frequency, microphone) = (read(FREQUENCY)?, read(MICROPHONE)?);
        if frequency.is_empty() && microphone.is_empty() {
            return refuse(format!("is no response: it has neither `{FREQUENCY}` nor `{MICROPHONE}`"));
        }
        let frequencies = if npz.contains("frequencies") { npz.f64("frequencies")?.data } else { Vec::new() };
        let meta = if npz.contains("meta") { npz.text("meta")? } else { String::new() };
        // Written by someone else, it may be missing, and nothing depends on it.
        let meta: serde_json::Value = serde_json::from_str(&meta).unwrap_or_default();
        let explained = meta["explained"].as_f64().unwrap_or(f64::NAN);
        Ok(Self { frequency, microphone, frequencies, explained })
    }

    /// Whether a file's arrays are those of a response.
    pub(crate) fn is_of(npz: &NpzReader) -> bool {
        npz.contains(FREQUENCY) || npz.contains(MICROPHONE)
    }

    /// Reads the response of each frequency from a `.csv`, or its phase in rad from a `.npy`; `sign` as
    /// [`Calibration::phase_sign`](super::Calibration::phase_sign).
    ///
    /// # Errors
    /// A malformed file; the message names the line.
    pub fn of_frequencies(path: &Path, columns: &[TraceColumn], sign: i32, limit: u64) -> Result<Self> {
        let (frequencies, mut frequency) = frequency_response(path, columns, limit)?;
        if sign < 0 {
            for value in &mut frequency {
                *value = value.conj();
            }
        }
        let frequencies = frequencies.unwrap_or_default();
        Ok(Self { frequency, microphone: Vec::new(), frequencies, explained: f64::NAN })
    }

    /// Divides the samples by it and says so.
    pub(super) fn divide(&self, cube: &mut DataCube) -> Result<String> {
        let own = cube.instrument.sweep.frequencies();
        let n_mic = cube.instrument.array.len();
        let wrong = |what: &str, found: usize, expected: usize| {
            Err(Error::input("response", format!("is of {found} {what}; the cube has {expected}")))
        };
        if !self.frequency.is_empty() {
            if self.frequency.len() != own.len() {
                return wrong("frequencies", self.frequency.len(), own.len());
            }
            let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-6 * a.abs();
            if !self.frequencies.is_empty() && !own.iter().zip(&self.frequencies).all(near) {
                return Err(Error::input("response", "is of other frequencies than the cube"));
            }
        }
        if !self.microphone.is_empty() && self.microphone.len() != n_mic {
            return wrong("microphones", self.microphone.len(), n_mic);
        }
        if cube.instrument.detection == Detection::InPhase
            && [&self.frequency, &self.microphone].into_iter().flatten().any(|value| value.im != 0.0)
        {
            need_phases(&cube.instrument, "response")?;
        }
        let (tones, weak_tones) = inverse(&self.frequency);
        let (mics, weak_mics) = inverse(&self.microphone);
        if !tones.is_empty() {
            multiply_tones(cube, &tones);
        }
        if !mics.is_empty() {
            for row in cube.samples.chunks_exact_mut(n_mic) {
                row.iter_mut().zip(&mics).for_each(|(m, factor)| *m *= factor);
            }
        }
        let what = match (tones.is_empty(), mics.is_empty()) {
            (false, true) => "frequencies",
            (true, _) => "microphones",
            (false, false) => "frequencies and microphones",
        };
        let silenced = match weak_tones + weak_mics {
            0 => String::new(),
            n => format!("; {n} of them hardly respond and are silenced"),
        };
        Ok(format!("divided by the response of {what}{silenced}"))
    }
}

/// How often each axis is fitted while the other stays.
const ROUNDS: usize = 20;

/// The factors that undo a response, and how many channels are too weak for that and become 0.
fn inverse(response: &[Complex32]) -> (Vec<Complex32>, usize) {
    let mut norms: Vec<f32> = response.iter().map(|value| value.norm()).collect();
    norms.sort_unstable_by(f32::total_cmp);
    let least = norms.get(norms.len() / 2).map_or(0.0, |median| LEAST * median);
    let weak = norms.iter().filter(|norm| **norm <= least).count();
    let factor = |value: &Complex32| if value.norm() <= least { Complex32::ZERO } else { value.inv() };
    (response.iter().map(factor).collect(), weak)
}
