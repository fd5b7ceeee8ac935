//! Levels of channels, microphones or tones, and those that are out of line.

use super::{median, quantile};
use crate::acquisition::profile::decibels;
use crate::alloc::try_filled;
use glam::DVec3;
use num_complex::Complex32;
use serde::Serialize;

/// A channel this far below the median is dead, dB.
pub(super) const DEAD_DB: f64 = -40.0;

/// A channel this far above the median is loud, dB.
pub(super) const LOUD_DB: f64 = 20.0;

/// How many channels of a kind are named.
const NAMED: usize = 8;

/// The levels of all microphones, or of all tones.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ChannelLevels {
    /// Number of channels.
    pub count: usize,
    /// Median of the levels that are not 0, rms; 0 if all are. It is the reference of dead and loud, and as a median is not
    /// moved by either, as long as they are fewer than half.
    pub median: f64,
    /// From the 10th to the 90th percentile of the levels that are not 0, dB.
    pub spread_db: Option<f64>,
    /// Those of level 0 or more than 40 dB below the median, though at least one sample is finite.
    pub dead: OddChannels,
    /// Those more than 20 dB above the median.
    pub loud: OddChannels,
    /// Those with samples that are not finite.
    pub not_finite: OddChannels,
    /// Level of every channel: rms of its finite samples; NaN (`null`) without any.
    pub rms: Vec<f64>,
}

/// Channels of one kind.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct OddChannels {
    /// How many there are.
    pub count: usize,
    /// The first eight.
    pub first: Vec<OddChannel>,
}

/// A microphone or tone that is out of line.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct OddChannel {
    /// Its index in the cube, counted from 0; on a lattice row by row.
    pub index: usize,
    /// A microphone's position, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// A tone's frequency, Hz.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frequency_hz: Option<f64>,
    /// Its level against the median, dB; `None` for level 0 or without finite samples.
    pub level_db: Option<f64>,
    /// How many of its samples are not finite.
    pub samples_not_finite: u64,
}

impl OddChannel {
    pub(super) fn at(index: usize) -> Self {
        Self { index, position_m: None, frequency_hz: None, level_db: None, samples_not_finite: 0 }
    }

    pub(super) fn microphone(index: usize, position: DVec3) -> Self {
        Self { position_m: Some(position.to_array()), ..Self::at(index) }
    }

    pub(super) fn tone(index: usize, frequency: f64) -> Self {
        Self { frequency_hz: Some(frequency), ..Self::at(index) }
    }
}

impl ChannelLevels {
    /// A channel's level against the median, dB.
    pub fn level_db(&self, index: usize) -> Option<f64> {
        decibels((self.rms[index] / self.median).powi(2))
    }

    /// Whether a channel is neither dead nor loud.
    pub(in crate::acquisition) fn is_usual(&self, index: usize) -> bool {
        self.level_db(index).is_some_and(|db| (DEAD_DB..=LOUD_DB).contains(&db))
    }
}

/// Sums over the samples of every channel.
pub(super) struct ChannelSums {
    /// Sum of |m|² of the finite samples, and their number.
    power: Vec<(f64, u64)>,
    missing: Vec<u64>,
}

impl ChannelSums {
    /// `None` where there is no memory.
    pub(super) fn new(count: usize) -> Option<Self> {
        let n = count as u64;
        Some(Self { power: try_filled((0.0, 0), n)?, missing: try_filled(0, n)? })
    }

    pub(super) fn add(&mut self, channel: usize, m: Complex32) {
        if m.is_finite() {
            let (power, count) = &mut self.power[channel];
            *power += f64::from(m.re).powi(2) + f64::from(m.im).powi(2);
            *count += 1;
        } else {
            self.missing[channel] += 1;
        }
    }

    /// How many channels there are.
    pub(super) fn len(&self) -> usize {
        self.missing.len()
    }

    /// How many samples of a channel are not finite.
    pub(super) fn missing(&self, channel: usize) -> u64 {
        self.missing[channel]
    }

    /// How many samples are not finite.
    pub(super) fn not_finite(&self) -> u64 {
        self.missing.iter().sum()
    }

    /// The levels; `describe` gives a channel's place.
    pub(super) fn judge(&self, describe: &dyn Fn(usize) -> OddChannel) -> ChannelLevels {
        // 0/0 is NaN: without finite samples there is no level.
        let rms: Vec<f64> = self.power.iter().map(|(power, n)| (power / *n as f64).sqrt()).collect();
        let heard = || rms.iter().copied().filter(|rms| *rms > 0.0);
        let median = median(heard()).unwrap_or(0.0);
        let spread = quantile(heard(), 0.9).zip(quantile(heard(), 0.1));
        let mut levels = ChannelLevels {
            count: rms.len(),
            median,
            spread_db: spread.and_then(|(high, low)| decibels((high / low).powi(2))),
            dead: OddChannels::default(),
            loud: OddChannels::default(),
            not_finite: OddChannels::default(),
            rms,
        };
        for (i, missing) in self.missing.iter().enumerate() {
            let odd =
                || OddChannel { level_db: levels.level_db(i), samples_not_finite: *missing, ..describe(i) };
            let relative = 20.0 * (levels.rms[i] / median).log10();
            // Where all are 0 so is the median, and 0/0 is no number.
            let kinds = [levels.rms[i] == 0.0 || relative < DEAD_DB, relative > LOUD_DB, *missing > 0];
            let odd = kinds.contains(&true).then(odd);
            let lists = [&mut levels.dead, &mut levels.loud, &mut levels.not_finite];
            for (list, _) in lists.into_iter().zip(kinds).filter(|(_, is)| *is) {
                list.count += 1;
                if list.first.len() < NAMED {
                    list.first.extend(odd.clone());
                }
            }
        }
        levels
    }
}
