//! One tile's echoes: reflectors grouped by path length, and each group summed at the virtual tones.
//!
//! For a tile the reflectors are sorted into intervals of path length to its centre, so narrow that every path to
//! every microphone of the tile stays within the tones' duration about the interval's middle. The factor common to the
//! interval, `e^{i2πf·middle/c}`, is restored by the expansion.

pub(super) mod batch;

use super::paths::{outward_length, path_length};
use super::terms::{LossTerms, outward_spreading};
use super::virtual_tones::EquispacedTones;
use super::{PropagationModel, SimulateOptions};
use crate::acquisition::{Instrument, Tile};
use crate::alloc::{try_filled, try_with_capacity};
use crate::reflectors::Reflectors;
use crate::wave::offsets::{MOST_ECHOES, exact_offsets, linear_offsets};
use crate::wave::simd::phasors;
use batch::ReflectorBatch;
use glam::DVec3;

/// The sums of one group at one tile.
#[derive(Debug, Clone)]
pub(super) struct GroupSums {
    /// Middle of the group's path lengths, m.
    pub(super) middle: f64,
    /// `[K Q][2 × microphones]`: per term and tone all real parts, then all imaginary ones, without the middle's phase and
    /// absorption; K is 1 unless losses depend on the frequency.
    pub(super) sums: Vec<f32>,
}

/// The offsets of reflectors closer to a tile's centre than this many radii are computed in f64.
const NEAR: f64 = 2.0;

/// The path of a reflector's echo to the centre of a tile.
#[derive(Debug, Clone, Copy)]
pub(super) struct CentrePath {
    /// m.
    pub(super) length: f64,
    /// Maximum difference from the path length to any microphone of the tile, m.
    reach: f64,
    near: bool,
}

impl CentrePath {
    /// The path via `p`, which is `outward` m from the speaker.
    #[inline]
    pub(super) fn new(
        p: DVec3,
        outward: f64,
        tile: &Tile,
        instrument: &Instrument,
        model: PropagationModel,
    ) -> Self {
        let geometry = &instrument.geometry;
        let legs = geometry.return_legs();
        match model {
            // A bent path changes no faster than a straight one, but has no short formula.
            PropagationModel::Exact if instrument.interface.is_some() => {
                Self { length: instrument.path_length(p, tile.centre), reach: legs * tile.radius, near: true }
            }
            PropagationModel::Exact => {
                let mut path = Self { length: outward, reach: 0.0, near: false };
                for end in geometry.moving_ends(tile.centre) {
                    let q = p - end;
                    let distance = q.length();
                    // |q − d| lies between |q| − q̂·d and that + |d|²/2|q|, and within |q| ± |d|.
                    let bound =
                        (q.abs().dot(tile.half) + 0.5 * tile.radius * tile.radius) / distance.max(1e-300);
                    path.length += legs * distance;
                    path.reach += legs * bound.min(tile.radius);
                    path.near |= distance < NEAR * tile.radius;
                }
                path
            }
            PropagationModel::Linear => Self {
                length: geometry.linear_path_length(p, tile.centre),
                reach: legs * geometry.far_direction(p).abs().dot(tile.half),
                near: false,
            },
        }
    }
}

/// Intervals of path length for one tile: their start and width, m.
#[derive(Debug, Clone, Copy)]
pub(super) struct Intervals {
    first: f64,
    width: f64,
}

impl Intervals {
    /// The widest intervals in which no path leaves a duration that corresponds to `length` m.
    pub(super) fn new(paths: &[CentrePath], length: f64) -> Self {
        let (first, reach) = paths.iter().fold((f64::INFINITY, 0.0), |(first, reach), path| {
            (path.length.min(first), path.reach.max(reach))
        });
        Self { first, width: length - 2.0 * reach }
    }

    /// The number of the interval that contains a path.
    pub(super) fn place(&self, path: f64) -> u64 {
        ((path - self.first) / self.width) as u64
    }

    /// Number of intervals that contain a path.
    pub(super) fn occupied(&self, paths: &[CentrePath]) -> usize {
        let mut places: Vec<u64> = paths.iter().map(|path| self.place(path.length)).collect();
        places.sort_unstable();
        places.dedup();
        places.len()
    }

    /// The middle of an interval, m.
    pub(super) fn middle(&self, place: u64) -> f64 {
        self.first + (place as f64 + 0.5) * self.width
    }
}

/// The inputs of every tile's sums.
#[derive(Debug)]
pub(super) struct Summation<'a> {
    reflectors: &'a Reflectors,
    /// The reflectors' path lengths from the speaker, m.
    outward: Vec<f64>,
    instrument: &'a Instrument,
    options: &'a SimulateOptions,
    tones: &'a EquispacedTones,
    /// Losses, if there are any.
    terms: Option<&'a LossTerms>,
}

impl<'a> Summation<'a> {
    pub(super) fn new(
        reflectors: &'a Reflectors,
        instrument: &'a Instrument,
        options: &'a SimulateOptions,
        tones: &'a EquispacedTones,
        terms: Option<&'a LossTerms>,
    ) -> Option<Self> {
        let mut outward = try_with_capacity(reflectors.len() as u64)?;
        outward.extend((0..reflectors.len()).map(|j| outward_length(reflectors, j, instrument)));
        Some(Self { reflectors, outward, instrument, options, tones, terms })
    }

    /// All groups of a tile with their sums, by ascending path length; `None` if they do not fit in memory.
    ///
    /// Memory: 32 bytes per reflector, and the sums.
    pub(super) fn groups(&self, tile: &Tile) -> Option<Vec<GroupSums>> {
        let outward = self.reflectors.positions().iter().zip(&self.outward);
        let mut paths: Vec<CentrePath> = try_with_capacity(outward.len() as u64)?;
        let (instrument, model) = (self.instrument, self.options.model);
        paths.extend(outward.map(|(&p, &outward)| CentrePath::new(p, outward, tile, instrument, model)));
        let intervals = Intervals::new(&paths, self.tones.duration * self.instrument.sound_speed);
        // Interval, nearness and index in one number: sorting groups the reflectors and preserves their order.
        let mut keys: Vec<u64> = try_with_capacity(paths.len() as u64)?;
        keys.extend(
            paths
                .iter()
                .enumerate()
                .map(|(j, path)| (intervals.place(path.length) << 1 | u64::from(path.near)) << 32 | j as u64),
        );
        keys.sort_unstable();
        let (mut batch, microphones) = (ReflectorBatch::default(), self.instrument.array.positions());
        let columns = self.tones.count() * self.terms.map_or(1, LossTerms::count);
        keys.chunk_by(|a, b| a >> 33 == b >> 33)
            .map(|group| {
                let middle = intervals.middle(group[0] >> 33);
                let mut sums = try_filled([0.0; 2], (columns * tile.microphones.len()) as u64)?;
                for run in group.chunk_by(|a, b| a >> 32 == b >> 32) {
                    let near = run[0] >> 32 & 1 == 1;
                    for some in run.chunks(MOST_ECHOES) {
                        let members = some.iter().map(|key| (key & u64::from(u32::MAX)) as usize);
                        self.fill(&members, &paths, middle, tile, &mut batch);
                        for (sums, &mic) in sums.chunks_exact_mut(columns).zip(&tile.microphones) {
                            self.add(microphones[mic], tile, near, &mut batch, sums);
                        }
                    }
                }
                Some(GroupSums { middle, sums: by_tone(&sums, columns)? })
            })
            .collect()
    }

    /// Fills a batch with some reflectors, relative to the tile's centre.
    fn fill(
        &self,
        members: &(impl Iterator<Item = usize> + Clone),
        centre_paths: &[CentrePath],
        middle: f64,
        tile: &Tile,
        batch: &mut ReflectorBatch,
    ) {
        let (options, Instrument { geometry, sound_speed, .. }) = (self.options, self.instrument);
        batch.resize(members.clone().count());
        batch.directive.clear();
        if !self.reflectors.transmit_lengths().is_empty() {
            let some = members.clone().enumerate().filter(|(_, j)| self.reflectors.has_directivity(*j));
            batch.directive.extend(some.map(|(i, j)| (i as u32, j as u32)));
        }
        for ((from_middle, path), j) in
            batch.from_middle.iter_mut().zip(&mut batch.paths).zip(members.clone())
        {
            *path = centre_paths[j].length;
            *from_middle = *path - middle;
        }
        phasors(self.tones.centre / sound_speed, &batch.from_middle, &mut batch.phasors);
        let per_metre = self.tones.step / sound_speed;
        for (i, j) in members.clone().enumerate() {
            let p = self.reflectors.positions()[j];
            batch.positions[i] = p;
            let toward = match options.model {
                PropagationModel::Exact => {
                    let q = p - tile.centre;
                    batch.distance[i] = q.length() as f32;
                    q
                }
                PropagationModel::Linear => geometry.far_direction(p),
            };
            for (plane, x) in batch.toward.iter_mut().zip(toward.to_array()) {
                plane[i] = x as f32;
            }
            batch.turn[i] = (batch.from_middle[i] * per_metre) as f32;
            batch.members[i] = j as u32;
            let spreading = match self.reflectors.transmit(j) {
                // The amplitude has it.
                Some(_) => 1.0,
                None => outward_spreading(self.outward[j], geometry, options) as f32,
            };
            let a = self.reflectors.amplitudes()[j] * batch.phasors[i] * spreading;
            batch.amplitude[0][i] = a.re;
            batch.amplitude[1][i] = a.im;
        }
        if let Some(terms) = self.terms {
            batch.losses.fill(terms, members, &batch.positions, &batch.from_middle, tile.centre);
        }
    }

    /// Adds the batch's echoes at the microphone at `r` to its sums.
    fn add(&self, r: DVec3, tile: &Tile, near: bool, batch: &mut ReflectorBatch, sums: &mut [[f64; 2]]) {
        let toward = [&batch.toward[0][..], &batch.toward[1], &batch.toward[2]];
        let Instrument { geometry, sound_speed, .. } = self.instrument;
        let legs = geometry.return_legs();
        let d = (r - tile.centre).as_vec3().to_array();
        if near {
            // Close to the microphones, the f32 series loses digits or does not converge.
            for ((offset, path), &j) in batch.offsets.iter_mut().zip(&batch.paths).zip(&batch.members) {
                let length = path_length(self.reflectors, j as usize, r, self.instrument, self.options);
                *offset = (length - path) as f32;
            }
        } else if self.options.model == PropagationModel::Exact {
            exact_offsets(toward, &batch.distance, d, legs as f32, &mut batch.offsets);
        } else {
            linear_offsets(toward, d, legs as f32, &mut batch.offsets);
        }
        let per_metre = [self.tones.centre, self.tones.step].map(|f| (f / sound_speed) as f32);
        let spread_legs = self.options.losses.spreading.then_some(legs);
        batch.hear(|j| self.reflectors.directivity(j, r));
        batch.add(per_metre, self.terms, (&[d], spread_legs), sums);
    }
}

/// `[microphone][K Q]` transposed to `[K Q][part][microphone]`; `None` if it does not fit in memory.
fn by_tone(sums: &[[f64; 2]], tones: usize) -> Option<Vec<f32>> {
    let mut transposed = try_with_capacity(2 * sums.len() as u64)?;
    for q in 0..tones {
        for part in 0..2 {
            transposed.extend(sums.iter().skip(q).step_by(tones).map(|sum| sum[part] as f32));
        }
    }
    Some(transposed)
}
