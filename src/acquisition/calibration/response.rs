//! Responses of speaker and microphones: their file, their division, their measurement with a target at a known place.

use super::{multiply_tones, need_phases};
use crate::acquisition::import::frequency_response;
use crate::acquisition::{DataCube, Detection, TraceColumn};
use crate::choice::choice;
use crate::error::{Error, Result};
use crate::files::arrays::fault;
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
        /// Each of several speakers: gains and phases.
        Speaker = "speaker",
        /// The product of all three.
        All = "all",
    }
}

/// What a chain of speakers and microphones does to an echo: `frequency[f] · microphone[r] · source[tx]`.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ChannelResponse {
    /// `[n_f]`; empty: 1 at all.
    pub frequency: Vec<Complex32>,
    /// `[n_mic]`; empty: 1 at all.
    pub microphone: Vec<Complex32>,
    /// `[n_tx]`, of several loudspeakers; empty: 1 at all.
    pub source: Vec<Complex32>,
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
const SOURCE: &str = "source_response";
const FORMAT: &str = "holosonar-calibration";

impl ChannelResponse {
    /// Measures the response with the cube of a small target at `target`, m, alone in the room or the only one that a gate
    /// left. Its rms over all samples is 1, so that dividing by it keeps amplitudes. Only the product of the axes is known:
    /// a gain or phase that they have in common may be in any of them.
    ///
    /// Cost: some operations per sample; of several axes 20 times that.
    ///
    /// # Errors
    /// An in-phase cube, which has no phases; the response of speakers where there is one; a silent cube.
    pub fn measure(cube: &DataCube, target: DVec3, axis: ResponseAxis) -> Result<Self> {
        need_phases(&cube.instrument, "--reference")?;
        let count = cube.instrument.transmissions();
        let fits = axis.fits();
        if fits[SPEAKERS] && count == 1 {
            let problem = format!(
                "was made with one speaker, whose response is in that of tones and microphones; --per {axis} is for several"
            );
            return Err(Error::input("--reference", problem));
        }
        let ratios = Ratios::of(cube, target);
        let [n_f, n_mic] = [cube.instrument.sweep.len(), cube.instrument.array.len()];
        let mut factors = [n_f, n_mic, count].map(|n| vec![Complex64::ONE; n]);
        let fitted: Vec<usize> = (0..fits.len()).filter(|axis| fits[*axis]).collect();
        let rounds = if fitted.len() > 1 { ROUNDS } else { 1 };
        for _ in 0..rounds {
            for axis in &fitted {
                factors[*axis] = ratios.fitted(&factors, *axis);
                // The scale stays with the first of them.
                if let Some(scale) = Some(rms(&factors[*axis])).filter(|rms| *rms > 0.0 && *axis != fitted[0])
                {
                    factors[*axis].iter_mut().for_each(|factor| *factor /= scale);
                    factors[fitted[0]].iter_mut().for_each(|factor| *factor *= scale);
                }
            }
        }
        let (whole, missed) = ratios.power(&factors);
        let scales = factors.each_ref().map(|values| rms(values));
        if !(whole > 0.0 && scales.iter().all(|scale| *scale > 0.0)) {
            return Err(Error::input("--reference", "is silent; nothing can be measured with it"));
        }
        let single = |axis: usize| {
            let scaled = factors[axis].iter().map(|v| v / scales[axis]);
            let values = scaled.map(|v| Complex32::new(v.re as f32, v.im as f32)).collect();
            if fits[axis] { values } else { Vec::new() }
        };
        Ok(Self {
            frequency: single(TONES),
            microphone: single(MICROPHONES),
            source: single(SPEAKERS),
            frequencies: cube.instrument.sweep.frequencies().to_vec(),
            explained: 1.0 - missed / whole,
        })
    }

    /// Writes the response, `.npz`: `frequency_response` `[n_f]`, `microphone_response` `[n_mic]`, `source_response` `[n_tx]`,
    /// as far as they were measured, `frequencies`, `meta`.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be written; an existing file is then unchanged.
    pub fn write(&self, path: &Path) -> Result<()> {
        let meta = json!({ "format": FORMAT, "version": 1, "explained": self.explained });
        write_npz(path, |npz| {
            let axes = [(FREQUENCY, &self.frequency), (MICROPHONE, &self.microphone), (SOURCE, &self.source)];
            for (name, values) in axes {
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
        let known = [FREQUENCY, MICROPHONE, SOURCE, "frequencies", "meta"];
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
                return Err(fault(path, name, "must be a list of finite numbers"));
            }
            Ok(array.data)
        };
        let (frequency, microphone, source) = (read(FREQUENCY)?, read(MICROPHONE)?, read(SOURCE)?);
        if frequency.is_empty() && microphone.is_empty() && source.is_empty() {
            return refuse(format!(
                "is no response: it has none of `{FREQUENCY}`, `{MICROPHONE}` and `{SOURCE}`"
            ));
        }
        let frequencies = if npz.contains("frequencies") { npz.f64("frequencies")?.data } else { Vec::new() };
        let meta = if npz.contains("meta") { npz.text("meta")? } else { String::new() };
        // Written by someone else, it may be missing, and nothing depends on it.
        let meta: serde_json::Value = serde_json::from_str(&meta).unwrap_or_default();
        let explained = meta["explained"].as_f64().unwrap_or(f64::NAN);
        Ok(Self { frequency, microphone, source, frequencies, explained })
    }

    /// Whether a file's arrays are those of a response.
    pub(crate) fn is_of(npz: &NpzReader) -> bool {
        [FREQUENCY, MICROPHONE, SOURCE].into_iter().any(|name| npz.contains(name))
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
        let (microphone, source) = (Vec::new(), Vec::new());
        Ok(Self { frequency, microphone, source, frequencies, explained: f64::NAN })
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
        let count = cube.instrument.transmissions();
        if !self.source.is_empty() && self.source.len() != count {
            return wrong("speakers", self.source.len(), count);
        }
        if cube.instrument.detection == Detection::InPhase
            && [&self.frequency, &self.microphone, &self.source]
                .into_iter()
                .flatten()
                .any(|value| value.im != 0.0)
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
        let (speakers, weak_speakers) = inverse(&self.source);
        let of_speaker = cube.samples.len() / count;
        for (samples, factor) in cube.samples.chunks_exact_mut(of_speaker).zip(&speakers) {
            for m in samples {
                *m *= factor;
            }
        }
        let axes = [(!tones.is_empty(), "frequencies"), (!mics.is_empty(), "microphones")];
        let axes = axes.into_iter().chain([(!speakers.is_empty(), "speakers")]);
        let what =
            axes.filter(|(divided, _)| *divided).map(|(_, what)| what).collect::<Vec<_>>().join(" and ");
        let silenced = match weak_tones + weak_mics + weak_speakers {
            0 => String::new(),
            n => format!("; {n} of them hardly respond and are silenced"),
        };
        Ok(format!("divided by the response of {what}{silenced}"))
    }
}

/// How often each axis is fitted while the others stay.
const ROUNDS: usize = 20;

/// The axes of factors, by number.
const TONES: usize = 0;
const MICROPHONES: usize = 1;
const SPEAKERS: usize = 2;

impl ResponseAxis {
    /// Whether factors of tones, of microphones and of speakers are fitted.
    fn fits(self) -> [bool; 3] {
        match self {
            Self::Frequency => [true, false, false],
            Self::Microphone => [false, true, false],
            Self::Both => [true, true, false],
            Self::Speaker => [false, false, true],
            Self::All => [true; 3],
        }
    }
}

fn rms(values: &[Complex64]) -> f64 {
    (values.iter().map(Complex64::norm_sqr).sum::<f64>() / values.len() as f64).sqrt()
}

/// What is left of samples when the phase of the path by way of the target is taken away, `[n_tx, n_f, n_mic]`.
struct Ratios {
    counts: [usize; 3],
    values: Vec<Complex64>,
}

impl Ratios {
    fn of(cube: &DataCube, target: DVec3) -> Self {
        let instrument = &cube.instrument;
        let (f, n_mic) = (instrument.sweep.frequencies(), instrument.array.len());
        let counts = [f.len(), n_mic, instrument.transmissions()];
        let mut values = Vec::with_capacity(cube.samples.len());
        for (tx, samples) in cube.samples.chunks_exact(f.len() * n_mic).enumerate() {
            let one = instrument.transmission(tx);
            let delays: Vec<f64> =
                (0..n_mic).map(|r| one.path_length_at(target, r) / one.sound_speed).collect();
            for (row, f) in samples.chunks_exact(n_mic).zip(f) {
                values.extend(row.iter().zip(&delays).map(|(m, delay)| {
                    let m = m * phasor(-f * delay);
                    Complex64::new(m.re.into(), m.im.into())
                }));
            }
        }
        Self { counts, values }
    }

    /// Visits each with its tone, microphone and speaker.
    fn visit(&self, mut visit: impl FnMut([usize; 3], Complex64)) {
        let [n_f, n_mic, _] = self.counts;
        for (row, values) in self.values.chunks_exact(n_mic).enumerate() {
            for (r, value) in values.iter().enumerate() {
                visit([row % n_f, r, row / n_f], *value);
            }
        }
    }

    /// The factors of one axis that explain most, with those of the others as they are.
    fn fitted(&self, factors: &[Vec<Complex64>; 3], axis: usize) -> Vec<Complex64> {
        let mut sums = vec![Complex64::ZERO; self.counts[axis]];
        let others = [(axis + 1) % 3, (axis + 2) % 3];
        self.visit(|at, value| {
            sums[at[axis]] +=
                value * others.map(|other| factors[other][at[other]].conj()).iter().product::<Complex64>();
        });
        let squares = |other: usize| factors[other].iter().map(Complex64::norm_sqr).sum::<f64>();
        let norm = squares(others[0]) * squares(others[1]);
        sums.into_iter().map(|sum| sum / norm).collect()
    }

    /// The power of all, and what the factors leave of it.
    fn power(&self, factors: &[Vec<Complex64>; 3]) -> (f64, f64) {
        let (mut whole, mut missed) = (0.0, 0.0);
        self.visit(|[f, r, tx], value| {
            whole += value.norm_sqr();
            missed +=
                (value - factors[TONES][f] * factors[MICROPHONES][r] * factors[SPEAKERS][tx]).norm_sqr();
        });
        (whole, missed)
    }
}

/// The factors that undo a response, and how many channels are too weak for that and become 0.
fn inverse(response: &[Complex32]) -> (Vec<Complex32>, usize) {
    let mut norms: Vec<f32> = response.iter().map(|value| value.norm()).collect();
    norms.sort_unstable_by(f32::total_cmp);
    let least = norms.get(norms.len() / 2).map_or(0.0, |median| LEAST * median);
    let weak = norms.iter().filter(|norm| **norm <= least).count();
    let factor = |value: &Complex32| if value.norm() <= least { Complex32::ZERO } else { value.inv() };
    (response.iter().map(factor).collect(), weak)
}
