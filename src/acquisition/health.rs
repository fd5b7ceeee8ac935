//! The health of a cube: what can be told of a measurement before it is imaged.
//!
//! Takes a [`CubeSource`]; gives a [`Health`]: silent, loud and missing channels, levels, the noise, the mean range profile
//! and which sign of the phase the echoes have. It visits the samples once, in blocks, and keeps the columns of some
//! microphones, so that a cube of any size can be examined in little memory.

mod levels;
mod profile;
mod sign;

#[cfg(test)]
mod tests;

pub use levels::{ChannelLevels, OddChannel, OddChannels};
pub use profile::{MeanProfile, NoiseEstimate};
pub use sign::{LikelySign, PhaseSign, SignEvidence};

use super::{CubeSource, Detection, Instrument};
use crate::alloc::{try_filled, try_with_capacity};
use crate::error::{Error, Result};
use crate::progress::{Observer, advance, stage};
use glam::DVec3;
use levels::ChannelSums;
use num_complex::Complex32;
use serde::Serialize;

/// Maximum number of microphones of which the range profile is computed.
const MOST_COLUMNS: usize = 1024;

/// Maximum bytes of their samples.
const MOST_COLUMN_BYTES: u64 = 64 << 20;

/// Bytes of a block of samples, and of the samples of one tone at least.
const BLOCK_BYTES: u64 = 16 << 20;

/// What was found in a cube.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Health {
    /// How the signal was mixed down.
    pub detection: Detection,
    /// Whether the microphones form a lattice, which the fast method needs.
    pub on_a_lattice: bool,
    /// Number of samples that are NaN or infinite; they are left out of all levels and count as 0 in profiles.
    pub samples_not_finite: u64,
    /// Whether every finite sample is 0.
    pub all_zero: bool,
    /// Whether no sample of an in-phase cube is negative, though not all are 0: an echo's phase turns with the frequency, so
    /// such samples have an offset that was not removed, or are magnitudes.
    pub never_negative: bool,
    /// The microphones, in the cube's order.
    pub microphones: ChannelLevels,
    /// The tones, by ascending frequency.
    pub tones: ChannelLevels,
    /// Number of microphones of which the range profile was computed: evenly chosen, without odd ones.
    pub profiled_microphones: usize,
    /// The mean range profile, with the phase sign that the file declares; `None` where there is none, see
    /// [`Health::no_profile`].
    pub profile: Option<MeanProfile>,
    /// The noise, from that profile.
    pub noise: Option<NoiseEstimate>,
    /// The sign of the phase, from the profiles; `None` in phase, where there is no sign, and without profiles. Of several
    /// loudspeakers that of the first whose sign can be told.
    pub phase_sign: Option<PhaseSign>,
    /// Each of several loudspeakers; empty for one.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub transmissions: Vec<TransmissionHealth>,
    /// Why there is no range profile.
    pub no_profile: Option<String>,
}

/// What was found in the samples of one of several loudspeakers.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct TransmissionHealth {
    /// Where the loudspeaker is, m.
    pub source_m: [f64; 3],
    /// Level: rms of its finite samples; NaN (`null`) without any.
    pub rms: f64,
    /// That against the median of all loudspeakers that were heard, dB; `None` of a silent one.
    pub level_db: Option<f64>,
    /// The noise, as [`Health::noise`].
    pub noise: Option<NoiseEstimate>,
    /// The sign of the phase, as [`Health::phase_sign`].
    pub phase_sign: Option<PhaseSign>,
    /// The mean range profile, as [`Health::profile`]; its picture is drawn, and JSON is without it.
    #[serde(skip)]
    pub profile: Option<MeanProfile>,
}

impl TransmissionHealth {
    /// Whether it is silent, or 40 dB below the median.
    pub fn is_dead(&self) -> bool {
        self.level_db.is_none_or(|db| db < levels::DEAD_DB)
    }

    /// Whether it is 20 dB above the median.
    pub fn is_loud(&self) -> bool {
        self.level_db.is_some_and(|db| db > levels::LOUD_DB)
    }
}

impl Health {
    /// Examines the samples of `source`; of several loudspeakers the levels of microphones and tones, the profile and the
    /// noise are those of all, and the rest is there for each. Samples of a file are best read by
    /// [`CubeFile::unchecked`](super::CubeFile::unchecked), which passes on what is not finite.
    ///
    /// - Cost: one visit of the samples; n log n operations per frequency and examined microphone (at most 1024); and for
    ///   the sign at most 2·10⁷ evaluations of a path, about a second.
    /// - Memory: a block of 16 MiB (one tone at least), at most 64 MiB of columns and a quarter of `memory`, in bytes, and
    ///   some numbers per microphone and tone.
    /// - The result does not depend on the number of threads.
    ///
    /// # Errors
    /// Errors of reading; [`Error::OutOfMemory`]; [`Error::Interrupted`] if the observer asks to stop.
    ///
    /// ```
    /// use holosonar::glam::DVec3;
    /// use holosonar::acquisition::{Health, Instrument, MicArray, SimulateOptions, Sweep, simulate};
    /// use holosonar::progress::Silent;
    /// use holosonar::reflectors::Reflectors;
    /// use holosonar::num_complex::Complex32;
    ///
    /// let array = MicArray::rectangular([8, 8], [0.04, 0.04], DVec3::ZERO)?;
    /// let instrument = Instrument::new(Sweep::stepped(10e3, 14e3, 50.0)?, array);
    /// let echo = Reflectors::new(vec![DVec3::new(0.0, 0.1, 1.5)], vec![Complex32::ONE])?;
    /// let cube = simulate(&echo, &instrument, &SimulateOptions::default())?;
    /// let health = Health::of(&mut &cube, 1 << 30, &Silent)?;
    /// assert_eq!(health.microphones.dead.count, 0);
    /// let range = health.profile.expect("the tones are even").peaks[0].range;
    /// assert!((range - 1.5).abs() < 0.03);
    /// # Ok::<(), holosonar::error::Error>(())
    /// ```
    pub fn of(source: &mut dyn CubeSource, memory: u64, observer: &dyn Observer) -> Result<Self> {
        let instrument = source.instrument().clone();
        let survey = Survey::of(source, &instrument, memory, observer)?;
        stage(observer, "examining profiles", 0, || Ok(survey.judge(&instrument)))
    }
}

/// What one visit of the samples leaves.
struct Survey {
    microphones: ChannelSums,
    tones: ChannelSums,
    negative: bool,
    /// Microphones whose samples were kept.
    chosen: Vec<usize>,
    /// Their samples, `[n_tx, chosen, n_f]`; what is not finite is 0.
    columns: Vec<Complex32>,
    /// The loudspeakers.
    sources: ChannelSums,
}

impl Survey {
    fn of(
        source: &mut dyn CubeSource,
        instrument: &Instrument,
        memory: u64,
        observer: &dyn Observer,
    ) -> Result<Self> {
        let (n_f, n_mic) = (instrument.sweep.len(), instrument.array.len());
        let n_tx = instrument.transmissions();
        let no_room = || Error::out_of_memory("the levels of the channels do not fit in memory; free some");
        let sums = |n: usize| ChannelSums::new(n).ok_or_else(no_room);
        let room = MOST_COLUMN_BYTES.min(memory / 4) / (8 * n_f as u64 * n_tx as u64);
        let count = n_mic.min(MOST_COLUMNS).min(room as usize);
        let mut survey = Self {
            microphones: sums(n_mic)?,
            tones: sums(n_f)?,
            negative: false,
            chosen: (0..count).map(|i| i * n_mic / count).collect(),
            columns: try_filled(Complex32::ZERO, (n_tx * count * n_f) as u64).ok_or_else(no_room)?,
            sources: sums(n_tx)?,
        };
        let block = (BLOCK_BYTES / (8 * n_mic as u64)).max(1) as usize;
        stage(observer, "reading the cube", (n_tx * n_f) as u64, || {
            (0..n_tx).try_for_each(|tx| {
                source.visit_transmission(tx, block, &mut |range, samples| {
                    for (f, row) in range.clone().zip(samples.chunks_exact(n_mic)) {
                        survey.add(tx, f, n_f, row);
                    }
                    advance(observer, range.len() as u64)
                })
            })
        })?;
        Ok(survey)
    }

    /// Adds the samples of tone `f` of a transmission.
    fn add(&mut self, tx: usize, f: usize, n_f: usize, row: &[Complex32]) {
        for (r, m) in row.iter().enumerate() {
            self.microphones.add(r, *m);
            self.tones.add(f, *m);
            self.sources.add(tx, *m);
            self.negative |= m.re < 0.0;
        }
        let own = self.chosen.len() * n_f;
        for (column, r) in self.columns[tx * own..][..own].chunks_exact_mut(n_f).zip(&self.chosen) {
            column[f] = if row[*r].is_finite() { row[*r] } else { Complex32::ZERO };
        }
    }

    fn judge(mut self, instrument: &Instrument) -> Health {
        let Instrument { sweep, array, detection, .. } = instrument;
        let at_mic = |i: usize| OddChannel::microphone(i, array.positions()[i]);
        let at_tone = |i: usize| OddChannel::tone(i, sweep.frequencies()[i]);
        let microphones = self.microphones.judge(&at_mic);
        let tones = self.tones.judge(&at_tone);
        let samples_not_finite = self.tones.not_finite();
        let all_zero = microphones.median == 0.0;
        let mut health = Health {
            detection: *detection,
            on_a_lattice: array.lattice().is_some(),
            samples_not_finite,
            all_zero,
            never_negative: *detection == Detection::InPhase && !self.negative && !all_zero,
            microphones,
            tones,
            profiled_microphones: 0,
            profile: None,
            noise: None,
            phase_sign: None,
            transmissions: Vec::new(),
            no_profile: None,
        };
        self.drop_odd(&health.microphones, sweep.len());
        health.profiled_microphones = self.chosen.len();
        match profile::obstacle(instrument, self.chosen.len()) {
            Some(obstacle) => health.no_profile = Some(obstacle.to_owned()),
            None => self.profiles(instrument, &mut health),
        }
        if instrument.transmissions() > 1 {
            health.transmissions = self.of_each(instrument, health.no_profile.is_none());
            let known = |each: &&TransmissionHealth| {
                each.phase_sign.is_some_and(|sign| sign.likely != LikelySign::Unknown)
            };
            let told = health.transmissions.iter().find(known).or(health.transmissions.first());
            health.phase_sign = told.and_then(|each| each.phase_sign);
        }
        health
    }

    /// Drops the columns of microphones that are dead, loud, or lack a tenth of their samples or more: a single loud one
    /// would hide all others.
    fn drop_odd(&mut self, levels: &ChannelLevels, n_f: usize) {
        let kept = |r: usize| {
            levels.is_usual(r) && 10 * self.microphones.missing(r) < (self.sources.len() * n_f) as u64
        };
        let keep: Vec<bool> = self.chosen.iter().map(|r| kept(*r)).collect();
        let n_tx = self.sources.len();
        let mut to = 0;
        for (from, keep) in (0..n_tx).flat_map(|_| &keep).enumerate() {
            if *keep {
                self.columns.copy_within(from * n_f..(from + 1) * n_f, to * n_f);
                to += 1;
            }
        }
        self.columns.truncate(to * n_f);
        let mut keep = keep.iter();
        self.chosen.retain(|_| keep.next() == Some(&true));
    }

    fn profiles(&self, instrument: &Instrument, health: &mut Health) {
        let profile = profile::mean(instrument, &self.columns);
        health.noise = Some(profile::noise(&profile, &self.columns, instrument));
        if health.detection == Detection::Quadrature && instrument.transmissions() == 1 {
            health.phase_sign = Some(sign::judge(instrument, &profile, &self.chosen, &self.columns));
        }
        health.profile = Some(profile);
    }

    /// What there is of each loudspeaker.
    fn of_each(&self, instrument: &Instrument, has_profile: bool) -> Vec<TransmissionHealth> {
        let levels = self.sources.judge(&OddChannel::at);
        let own = self.chosen.len() * instrument.sweep.len();
        let each = |(tx, source): (usize, DVec3)| {
            let mut health = TransmissionHealth {
                source_m: source.to_array(),
                rms: levels.rms[tx],
                level_db: levels.level_db(tx),
                noise: None,
                phase_sign: None,
                profile: None,
            };
            if has_profile {
                let (instrument, columns) = (instrument.transmission(tx), &self.columns[tx * own..][..own]);
                let profile = profile::mean(&instrument, columns);
                health.noise = Some(profile::noise(&profile, columns, &instrument));
                let has_sign = instrument.detection == Detection::Quadrature;
                health.phase_sign =
                    has_sign.then(|| sign::judge(&instrument, &profile, &self.chosen, columns));
                health.profile = Some(profile);
            }
            health
        };
        instrument.sources().into_iter().enumerate().map(each).collect()
    }
}

/// The median of some numbers; `None` of none, or where there is no memory for a copy.
fn median(values: impl Iterator<Item = f64> + Clone) -> Option<f64> {
    quantile(values, 0.5)
}

/// The value below which a share of some numbers lies.
fn quantile(values: impl Iterator<Item = f64> + Clone, share: f64) -> Option<f64> {
    let mut sorted = try_with_capacity(values.clone().count() as u64)?;
    sorted.extend(values);
    sorted.sort_unstable_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    Some(sorted[(share * last as f64).round() as usize])
}
