//! The A-scan: the range profile of one microphone, with its peaks (Eqs. 3 and 4).
//!
//! Takes a [`CubeSource`] and the weights of the frequencies; gives an [`AScan`]. What one microphone hears tells how long
//! paths are, not where they lead: it is the paper's measurement before there is an array.

use super::profile::{ProfilePeak, SweepTransform, decibels, local_maxima, unambiguous_path};
use super::{CubeSource, Detection, Instrument};
use crate::alloc::try_filled;
use crate::error::{Error, Result};
use crate::progress::{Observer, advance, stage};
use crate::text::quoted;
use crate::with_fields::with_fields;
use num_complex::Complex32;
use serde::Serialize;
use std::str::FromStr;

/// Values of a profile for each frequency: fine enough for a parabola to find the top of any window's peak to a thousandth
/// of the resolution.
const FINER: usize = 8;

/// Microphones that the mean is of at the most, evenly chosen, and the operations of their sums where the frequencies are
/// uneven.
const MOST_MICROPHONES: usize = 1024;
const MOST_OPERATIONS: usize = 2_000_000_000;

/// Bytes of a block of samples while the cube is read.
const BLOCK_BYTES: u64 = 16 << 20;

/// Peaks that are weaker than this relative to the first are not listed, nor those less than this above the median, dB.
const BELOW_DB: f64 = 40.0;
const ABOVE_DB: f64 = 6.0;

/// By how much sidelobes of other peaks may be exceeded where several meet.
const SIDELOBE_MARGIN: f64 = 1.5;

/// Which microphone an A-scan is of.
///
/// ```
/// use holosonar::acquisition::ScannedMicrophone;
///
/// assert_eq!("12".parse(), Ok(ScannedMicrophone::Number(12)));
/// assert_eq!("0.1,-0.2".parse(), Ok(ScannedMicrophone::Nearest([0.1, -0.2])));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ScannedMicrophone {
    /// By its number, in the cube's order, counted from 0.
    Number(usize),
    /// The one nearest to the centre of the array.
    Centre,
    /// The one nearest to x and y, m.
    Nearest([f64; 2]),
    /// The mean power of all; of 1024 evenly chosen ones, if there are more.
    Mean,
}

impl FromStr for ScannedMicrophone {
    type Err = Error;

    /// Reads a number, `centre`, `mean`, or `x,y`.
    fn from_str(typed: &str) -> Result<Self> {
        let numbers: Option<Vec<f64>> =
            typed.split(',').map(|part| part.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
        match (typed.trim(), typed.trim().parse(), numbers.as_deref()) {
            ("centre", ..) => Ok(Self::Centre),
            ("mean", ..) => Ok(Self::Mean),
            (_, Ok(number), _) => Ok(Self::Number(number)),
            (_, _, Some([x, y])) => Ok(Self::Nearest([*x, *y])),
            _ => {
                let problem = format!(
                    "\"{}\" was expected to be a number counted from 0, \"centre\", \"mean\", or x,y in m",
                    quoted(typed)
                );
                Err(Error::input("microphone", problem))
            }
        }
    }
}

/// What an A-scan is of.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct AScanOptions {
    /// The microphone, or the mean.
    pub microphone: ScannedMicrophone,
    /// Number of the loudspeaker, if there are several.
    pub transmission: usize,
    /// Number of peaks that are listed at the most.
    pub peaks: usize,
}

with_fields! {
    AScanOptions {
        with_microphone(microphone: ScannedMicrophone),
        with_transmission(transmission: usize),
        with_peaks(peaks: usize),
    }
}

impl Default for AScanOptions {
    /// The microphone in the centre, the first loudspeaker, ten peaks.
    fn default() -> Self {
        Self { microphone: ScannedMicrophone::Centre, transmission: 0, peaks: 10 }
    }
}

/// A range profile of one microphone, or the mean of several.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct AScan {
    /// Number of the microphone; `None` of a mean.
    pub microphone: Option<usize>,
    /// Where it is, or the centre of the array, m.
    pub position_m: [f64; 3],
    /// How many microphones it is of.
    pub microphones: usize,
    /// Where the loudspeaker is, m.
    pub source_m: [f64; 3],
    /// How the signal was mixed down.
    pub detection: Detection,
    /// Resolution of the range, c/2B, m (Eq. 10), without a window.
    pub range_resolution: f64,
    /// Width of a peak at half of its power, with the window, m of range.
    pub peak_width: f64,
    /// The longest path that the step tells apart, m: c/δf in quadrature, half of it in phase (Eq. 11); of uneven
    /// frequencies that of their mean distance, and no path is repeated exactly.
    pub unambiguous_path: f64,
    /// Whether the frequencies are evenly spaced.
    pub even: bool,
    /// From one value to the next, m of path; the first is at 0.
    pub path_pitch: f64,
    /// Amplitude of each value: an echo of amplitude 1 peaks at 1.
    pub amplitude: Vec<f64>,
    /// The strongest peaks that are no sidelobes of stronger ones, strongest first.
    pub peaks: Vec<ProfilePeak>,
    /// Median level of the profile, dB.
    pub median_db: Option<f64>,
    /// The frequencies, Hz.
    pub frequencies: Vec<f64>,
    /// The samples of the microphone, real and imaginary part: the correlation waveform (Eq. 3); empty of a mean.
    pub samples: Vec<[f32; 2]>,
}

impl AScan {
    /// Reads one microphone's samples and transforms them; `weights` has one weight for each frequency.
    ///
    /// - Cost: one visit of the samples, and n log n operations per microphone; n² of uneven frequencies.
    /// - Memory: the chosen microphones' samples, and a block of 16 MiB.
    ///
    /// # Errors
    /// A single frequency; a microphone or loudspeaker that there is not; errors of reading; [`Error::OutOfMemory`];
    /// [`Error::Interrupted`] if the observer asks to stop.
    ///
    /// # Panics
    /// If there is not one weight for each frequency.
    ///
    /// ```
    /// use holosonar::glam::DVec3;
    /// use holosonar::acquisition::{AScan, AScanOptions, Instrument, MicArray, SimulateOptions, Sweep, simulate};
    /// use holosonar::num_complex::Complex32;
    /// use holosonar::progress::Silent;
    /// use holosonar::reflectors::Reflectors;
    ///
    /// let instrument = Instrument::new(Sweep::stepped(10e3, 14e3, 50.0)?, MicArray::from_positions(vec![DVec3::ZERO])?);
    /// let echo = Reflectors::new(vec![DVec3::new(0.0, 0.0, 1.5)], vec![Complex32::ONE])?;
    /// let cube = simulate(&echo, &instrument, &SimulateOptions::default())?;
    /// let scan = AScan::of(&mut &cube, &[1.0; 81], &AScanOptions::default(), &Silent)?;
    /// assert_eq!(scan.peaks.len(), 1);
    /// assert!((scan.peaks[0].range - 1.5).abs() < 1e-3 && scan.peaks[0].level_db.abs() < 0.01);
    /// # Ok::<(), holosonar::error::Error>(())
    /// ```
    pub fn of(
        source: &mut dyn CubeSource,
        weights: &[f64],
        options: &AScanOptions,
        observer: &dyn Observer,
    ) -> Result<Self> {
        let whole = source.instrument().clone();
        let (n_f, n_mic) = (whole.sweep.len(), whole.array.len());
        assert_eq!(weights.len(), n_f, "one weight for each frequency");
        let chosen = chosen(&whole, options)?;
        let columns = columns(source, options.transmission, &chosen, observer)?;
        let instrument = whole.transmission(options.transmission);
        let transform = SweepTransform::new(&instrument, weights, FINER);
        let mut power = stage(observer, "transforming", 0, || Ok(transform.mean_power(&columns)))?;
        let mut path = unambiguous_path(&instrument);
        if instrument.detection == Detection::InPhase {
            // The other half is its mirror image.
            power.truncate(power.len() / 2 + 1);
            path *= 0.5;
        }
        // An in-phase echo has half of its amplitude at the negative path.
        let gain = instrument.detection.weight().powi(2);
        for value in &mut power {
            *value *= gain;
        }
        let mut sorted = power.clone();
        sorted.sort_unstable_by(f64::total_cmp);
        let median_db = decibels(sorted[sorted.len() / 2]);
        let sidelobes = transform.sidelobes();
        let single = (options.microphone != ScannedMicrophone::Mean).then(|| chosen[0]);
        let position = single.map_or(instrument.array.centre(), |r| instrument.array.positions()[r]);
        let found = local_maxima(
            &power,
            transform.pitch / 2.0,
            median_db.map_or(f64::NEG_INFINITY, |db| db + ABOVE_DB),
        );
        Ok(Self {
            microphone: single,
            position_m: position.to_array(),
            microphones: chosen.len().min(n_mic),
            source_m: single
                .map_or(instrument.geometry, |r| instrument.geometry_of(r))
                .source_of(position)
                .to_array(),
            detection: instrument.detection,
            range_resolution: instrument.sound_speed / (2.0 * instrument.sweep.bandwidth()),
            peak_width: width(&sidelobes) * transform.pitch,
            unambiguous_path: path,
            even: instrument.sweep.step().is_some(),
            path_pitch: transform.pitch,
            peaks: listed(found, &sidelobes, &transform, (instrument.detection, options.peaks)),
            amplitude: power.iter().map(|value| value.sqrt()).collect(),
            median_db,
            frequencies: instrument.sweep.frequencies().to_vec(),
            samples: if single.is_some() {
                columns.iter().map(|m| [m.re, m.im]).collect()
            } else {
                Vec::new()
            },
        })
    }
}

/// The microphones that are transformed.
fn chosen(instrument: &Instrument, options: &AScanOptions) -> Result<Vec<usize>> {
    let (n_f, n_mic, n_tx) = (instrument.sweep.len(), instrument.array.len(), instrument.transmissions());
    if n_f < 2 {
        let problem = "is a single frequency, of which no range follows; the range resolution is c/2B";
        return Err(Error::input("the cube's `frequencies`", problem));
    }
    if options.transmission >= n_tx {
        let problem =
            format!("there is no number {}; the cube has {n_tx}, counted from 0", options.transmission);
        return Err(Error::input("loudspeaker", problem));
    }
    let centre = instrument.array.centre();
    match options.microphone {
        ScannedMicrophone::Number(microphone) if microphone < n_mic => Ok(vec![microphone]),
        ScannedMicrophone::Centre => Ok(vec![instrument.array.nearest([centre.x, centre.y])]),
        ScannedMicrophone::Nearest(place) => Ok(vec![instrument.array.nearest(place)]),
        ScannedMicrophone::Number(microphone) => {
            let problem = format!("there is no number {microphone}; the cube has {n_mic}, counted from 0");
            Err(Error::input("microphone", problem))
        }
        ScannedMicrophone::Mean => {
            let literal = instrument.sweep.step().is_none();
            let sums = if literal { MOST_OPERATIONS / (FINER * n_f * n_f) } else { MOST_MICROPHONES };
            let count = n_mic.min(MOST_MICROPHONES).min(sums.max(1));
            Ok((0..count).map(|i| i * n_mic / count).collect())
        }
    }
}

/// The samples of some microphones, `[microphone, n_f]`.
///
/// # Errors
/// Errors of reading; [`Error::OutOfMemory`]; [`Error::Interrupted`].
pub(crate) fn columns(
    source: &mut dyn CubeSource,
    transmission: usize,
    chosen: &[usize],
    observer: &dyn Observer,
) -> Result<Vec<Complex32>> {
    let (n_f, n_mic) = (source.instrument().sweep.len(), source.instrument().array.len());
    let no_room =
        || Error::out_of_memory("the samples of the microphones do not fit in memory; choose one of them");
    let mut columns = try_filled(Complex32::ZERO, (chosen.len() * n_f) as u64).ok_or_else(no_room)?;
    let block = (BLOCK_BYTES / (8 * n_mic as u64)).max(1) as usize;
    stage(observer, "reading the cube", n_f as u64, || {
        source.visit_transmission(transmission, block, &mut |range, samples| {
            for (f, row) in range.clone().zip(samples.chunks_exact(n_mic)) {
                for (column, r) in columns.chunks_exact_mut(n_f).zip(chosen) {
                    column[f] = row[*r];
                }
            }
            advance(observer, range.len() as u64)
        })
    })?;
    Ok(columns)
}

/// Full width of a peak at half of its power, in values of half a path.
fn width(sidelobes: &[f64]) -> f64 {
    let half = 0.5_f64.sqrt();
    let below = sidelobes.iter().position(|value| *value < half).unwrap_or(sidelobes.len());
    let Some(before) = below.checked_sub(1) else { return 0.0 };
    let (above, under) = (sidelobes[before], sidelobes.get(below).copied().unwrap_or(0.0));
    // Twice the distance to one side, in values of path, is the width in path; half of that is the width in range.
    before as f64 + (above - half) / (above - under).max(f64::MIN_POSITIVE)
}

/// The peaks that sidelobes of stronger ones do not explain.
fn listed(
    found: Vec<ProfilePeak>,
    sidelobes: &[f64],
    transform: &SweepTransform,
    (detection, most): (Detection, usize),
) -> Vec<ProfilePeak> {
    let n = transform.len;
    // The highest sidelobe about a distance: tops are half a lobe from where they are due.
    let from = |distance: f64| {
        let middle = distance.abs() as usize;
        let around = middle.saturating_sub(FINER)..=(middle + FINER).min(n - 1);
        sidelobes[around].iter().copied().fold(0.0, f64::max)
    };
    let strongest = found.first().map_or(0.0, |peak| peak.level_db);
    let mut kept: Vec<ProfilePeak> = Vec::new();
    for peak in found {
        let place = |peak: &ProfilePeak| 2.0 * peak.range / transform.pitch;
        let amplitude = |peak: &ProfilePeak| 10_f64.powf(peak.level_db / 20.0);
        let explained: f64 = kept
            .iter()
            .map(|other| {
                let mirrored = match detection {
                    Detection::Quadrature => 0.0,
                    Detection::InPhase => from(place(&peak) + place(other)),
                };
                amplitude(other) * (from(place(&peak) - place(other)) + mirrored)
            })
            .sum();
        if kept.len() == most || peak.level_db < strongest - BELOW_DB {
            break;
        }
        if amplitude(&peak) > SIDELOBE_MARGIN * explained {
            kept.push(peak);
        }
    }
    kept
}

#[cfg(test)]
mod tests;
