//! One tile's echoes: reflectors grouped by path length, and each group summed at the virtual tones.
//!
//! For a tile the reflectors are sorted into intervals of path length to its centre, so narrow that every path to
//! every microphone of the tile stays within the tones' duration about the interval's middle. What is common to the
//! interval, `e^{i2πf·middle/c}`, is put back at the expansion.

use super::planes::Planes;
use super::terms::{Terms, outward_spreading};
use super::virtual_tones::VirtualTones;
use super::{PropagationModel, SimulateOptions};
use crate::acquisition::{Instrument, Tile};
use crate::alloc::{try_filled, try_with_capacity};
use crate::reflectors::Reflectors;
use crate::wave::Geometry;
use crate::wave::offsets::{Echoes, MOST_ECHOES, exact_offsets, linear_offsets, sum_over_tones};
use crate::wave::simd::phasors;
use glam::DVec3;

/// The sums of one group at one tile.
#[derive(Debug, Clone)]
pub(super) struct GroupSums {
    /// Middle of the group's path lengths, m.
    pub(super) middle: f64,
    /// `[K Q][2 × microphones]`: per term and tone all real parts, then all imaginary ones, with the middle's phase and
    /// absorption taken out; K is 1 unless losses depend on the frequency.
    pub(super) sums: Vec<f32>,
}

/// Reflectors nearer to a tile's centre than this many radii have their offsets in f64.
const NEAR: f64 = 2.0;

/// How a tile's centre sees a reflector.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    /// Path length to the centre, m.
    pub(super) path: f64,
    /// Greatest difference between that and the path to any microphone of the tile, m.
    reach: f64,
    near: bool,
}

impl Sight {
    /// The sight of `p`, whose way from the speaker is `outward` m.
    #[inline]
    pub(super) fn new(
        p: DVec3,
        outward: f64,
        tile: &Tile,
        geometry: &Geometry,
        model: PropagationModel,
    ) -> Self {
        let legs = geometry.return_legs();
        match model {
            PropagationModel::Exact => {
                let q = p - tile.centre;
                let distance = q.length();
                // |q − d| lies between |q| − q̂·d and that + |d|²/2|q|, and within |q| ± |d|.
                let bound = (q.abs().dot(tile.half) + 0.5 * tile.radius * tile.radius) / distance.max(1e-300);
                Self {
                    path: outward + legs * distance,
                    reach: legs * bound.min(tile.radius),
                    near: distance < NEAR * tile.radius,
                }
            }
            PropagationModel::Linear => Self {
                path: geometry.linear_path_length(p, tile.centre),
                reach: legs * geometry.far_direction(p).abs().dot(tile.half),
                near: false,
            },
        }
    }
}

/// Intervals of path length for one tile: where they start and how wide they are.
#[derive(Debug, Clone, Copy)]
pub(super) struct Intervals {
    first: f64,
    width: f64,
}

impl Intervals {
    /// The widest intervals in which no path leaves a duration worth `length` m of path.
    pub(super) fn new(sights: &[Sight], length: f64) -> Self {
        let (first, reach) = sights.iter().fold((f64::INFINITY, 0.0), |(first, reach), sight| {
            (sight.path.min(first), sight.reach.max(reach))
        });
        Self { first, width: length - 2.0 * reach }
    }

    fn place(&self, path: f64) -> u64 {
        ((path - self.first) / self.width) as u64
    }

    /// How many intervals hold a path.
    pub(super) fn occupied(&self, sights: &[Sight]) -> usize {
        let mut places: Vec<u64> = sights.iter().map(|sight| self.place(sight.path)).collect();
        places.sort_unstable();
        places.dedup();
        places.len()
    }

    fn middle(&self, place: u64) -> f64 {
        self.first + (place as f64 + 0.5) * self.width
    }
}

/// What every tile's sums are made of.
#[derive(Debug)]
pub(super) struct Summation<'a> {
    reflectors: &'a Reflectors,
    /// The reflectors' ways from the speaker, m.
    outward: Vec<f64>,
    instrument: &'a Instrument,
    options: &'a SimulateOptions,
    tones: &'a VirtualTones,
    /// Losses, if there are any.
    terms: Option<&'a Terms>,
}

impl<'a> Summation<'a> {
    pub(super) fn new(
        reflectors: &'a Reflectors,
        instrument: &'a Instrument,
        options: &'a SimulateOptions,
        tones: &'a VirtualTones,
        terms: Option<&'a Terms>,
    ) -> Option<Self> {
        let mut outward = try_with_capacity(reflectors.len() as u64)?;
        outward.extend(reflectors.positions().iter().map(|&p| instrument.geometry.outward_length(p)));
        Some(Self { reflectors, outward, instrument, options, tones, terms })
    }

    /// All groups of a tile with their sums, by ascending path length; `None` when they do not fit in memory.
    ///
    /// Memory: 32 bytes per reflector, and the sums.
    pub(super) fn groups(&self, tile: &Tile) -> Option<Vec<GroupSums>> {
        let places = self.reflectors.positions().iter().zip(&self.outward);
        let mut sights: Vec<Sight> = try_with_capacity(places.len() as u64)?;
        let (geometry, model) = (&self.instrument.geometry, self.options.model);
        sights.extend(places.map(|(&p, &outward)| Sight::new(p, outward, tile, geometry, model)));
        let intervals = Intervals::new(&sights, self.tones.duration * self.instrument.sound_speed);
        // Interval, nearness and index in one number: sorting it groups the reflectors and keeps their order.
        let mut keys: Vec<u64> = try_with_capacity(sights.len() as u64)?;
        keys.extend(
            sights.iter().enumerate().map(|(j, sight)| {
                (intervals.place(sight.path) << 1 | u64::from(sight.near)) << 32 | j as u64
            }),
        );
        keys.sort_unstable();
        let (mut planes, microphones) = (Planes::default(), self.instrument.array.positions());
        let columns = self.tones.count() * self.terms.map_or(1, Terms::count);
        keys.chunk_by(|a, b| a >> 33 == b >> 33)
            .map(|group| {
                let middle = intervals.middle(group[0] >> 33);
                let mut sums = try_filled([0.0; 2], (columns * tile.microphones.len()) as u64)?;
                for run in group.chunk_by(|a, b| a >> 32 == b >> 32) {
                    let near = run[0] >> 32 & 1 == 1;
                    for some in run.chunks(MOST_ECHOES) {
                        let members = some.iter().map(|key| (key & u64::from(u32::MAX)) as usize);
                        self.lay_out(&members, &sights, middle, tile, &mut planes);
                        for (sums, &mic) in sums.chunks_exact_mut(columns).zip(&tile.microphones) {
                            self.add(microphones[mic], tile, near, &mut planes, sums);
                        }
                    }
                }
                Some(GroupSums { middle, sums: by_tone(&sums, columns)? })
            })
            .collect()
    }

    /// Fills the planes with some reflectors as the tile's centre sees them.
    fn lay_out(
        &self,
        members: &(impl Iterator<Item = usize> + Clone),
        sights: &[Sight],
        middle: f64,
        tile: &Tile,
        planes: &mut Planes,
    ) {
        let (options, Instrument { geometry, sound_speed, .. }) = (self.options, self.instrument);
        planes.resize(members.clone().count());
        for ((from_middle, path), j) in
            planes.from_middle.iter_mut().zip(&mut planes.paths).zip(members.clone())
        {
            *path = sights[j].path;
            *from_middle = *path - middle;
        }
        phasors(self.tones.centre / sound_speed, &planes.from_middle, &mut planes.phasors);
        let per_metre = self.tones.step / sound_speed;
        for (i, j) in members.clone().enumerate() {
            let p = self.reflectors.positions()[j];
            planes.positions[i] = p;
            let toward = match options.model {
                PropagationModel::Exact => {
                    let q = p - tile.centre;
                    planes.distance[i] = q.length() as f32;
                    q
                }
                PropagationModel::Linear => geometry.far_direction(p),
            };
            for (plane, x) in planes.toward.iter_mut().zip(toward.to_array()) {
                plane[i] = x as f32;
            }
            planes.turn[i] = (planes.from_middle[i] * per_metre) as f32;
            let spreading = outward_spreading(self.outward[j], geometry, options) as f32;
            let a = self.reflectors.amplitudes()[j] * planes.phasors[i] * spreading;
            planes.amplitude[0][i] = a.re;
            planes.amplitude[1][i] = a.im;
        }
        if let Some(terms) = self.terms {
            planes.lossy.lay_out(terms, members, &planes.positions, &planes.from_middle, tile.centre);
        }
    }

    /// Adds the echoes of the planes at the microphone at `r` to its sums.
    fn add(&self, r: DVec3, tile: &Tile, near: bool, planes: &mut Planes, sums: &mut [[f64; 2]]) {
        let toward = [&planes.toward[0][..], &planes.toward[1], &planes.toward[2]];
        let Instrument { geometry, sound_speed, .. } = self.instrument;
        let legs = geometry.return_legs();
        let d = (r - tile.centre).as_vec3().to_array();
        if near {
            // Among the microphones offsets cancel or are no small part of the distance.
            for ((offset, &p), path) in planes.offsets.iter_mut().zip(&planes.positions).zip(&planes.paths) {
                *offset = (self.options.model.path_length(geometry, p, r) - path) as f32;
            }
        } else if self.options.model == PropagationModel::Exact {
            exact_offsets(toward, &planes.distance, d, legs as f32, &mut planes.offsets);
        } else {
            linear_offsets(toward, d, legs as f32, &mut planes.offsets);
        }
        let per_metre = [self.tones.centre, self.tones.step].map(|f| (f / sound_speed) as f32);
        let Some(terms) = self.terms else {
            let echoes =
                Echoes { turn: &planes.turn, amplitude: [&planes.amplitude[0], &planes.amplitude[1]] };
            return sum_over_tones(echoes, &planes.offsets, per_metre, sums);
        };
        let Planes { amplitude, weighted, offsets, lossy, turn, .. } = planes;
        let spread_legs = if self.options.losses.spreading { legs } else { 0.0 };
        lossy.look(d, offsets, spread_legs);
        for (k, sums) in sums.chunks_exact_mut(self.tones.count()).enumerate() {
            let factors = lossy.factors(terms, k);
            for (weighted, amplitude) in weighted.iter_mut().zip(&*amplitude) {
                weighted.clear();
                weighted.extend(amplitude.iter().zip(factors).map(|(a, factor)| a * factor));
            }
            let echoes = Echoes { turn, amplitude: [&weighted[0], &weighted[1]] };
            sum_over_tones(echoes, offsets, per_metre, sums);
        }
    }
}

/// `[microphone][K Q]` turned to `[K Q][part][microphone]`; `None` when it does not fit in memory.
fn by_tone(sums: &[[f64; 2]], tones: usize) -> Option<Vec<f32>> {
    let mut turned = try_with_capacity(2 * sums.len() as u64)?;
    for q in 0..tones {
        for part in 0..2 {
            turned.extend(sums.iter().skip(q).step_by(tones).map(|sum| sum[part] as f32));
        }
    }
    Some(turned)
}
