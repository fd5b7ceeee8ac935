//! One tile's echoes: reflectors grouped by path length, and each group summed at the virtual tones.
//!
//! For a tile the reflectors are sorted into intervals of path length to its centre, so narrow that every path to
//! every microphone of the tile stays within the tones' duration about the interval's middle. What is common to the
//! interval, `e^{i2πf·middle}`, is put back at the expansion.

use super::super::simulate::{PropagationModel, SimulateOptions};
use super::tiles::Tile;
use super::virtual_tones::VirtualTones;
use crate::reflectors::Reflectors;
use crate::wave::offsets::{Echoes, MOST_ECHOES, exact_offsets, linear_offsets, sum_over_tones};
use crate::wave::simd::{LANES, phasors};
use glam::DVec3;
use num_complex::Complex32;

/// The sums of one group at one tile.
#[derive(Debug, Clone)]
pub(super) struct GroupSums {
    /// Middle of the group's path lengths, m.
    pub(super) middle: f64,
    /// `[Q][2 × microphones]`: per tone all real parts, then all imaginary ones, with the middle's phase taken out.
    pub(super) sums: Vec<f32>,
}

/// Reflectors nearer to a tile's centre than this many radii have their offsets in f64.
const NEAR: f64 = 2.0;

/// How a tile's centre sees a reflector.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    /// Path length to the centre, m.
    path: f64,
    /// Greatest difference between that and the path to any microphone of the tile, m.
    reach: f64,
    near: bool,
}

impl Sight {
    pub(super) fn new(p: DVec3, tile: &Tile, options: &SimulateOptions) -> Self {
        let path = options.path_length(p, tile.centre);
        let radius = tile.radius();
        let (across, bend, near) = match options.model {
            PropagationModel::Exact => {
                let q = p - tile.centre;
                let distance = q.length();
                // |q − d| lies between |q| − q̂·d and that + |d|²/2|q|, and within |q| ± |d|.
                let per_metre = 1.0 / distance.max(f64::MIN_POSITIVE);
                let across = q.abs().dot(tile.half) * per_metre;
                (across, 0.5 * radius * radius * per_metre, distance < NEAR * radius)
            }
            PropagationModel::Linear => (options.geometry.far_direction(p).abs().dot(tile.half), 0.0, false),
        };
        let reach = options.geometry.return_legs() * (across + bend).min(radius);
        Self { path, reach, near }
    }
}

/// Intervals of path length for one tile: their start and width.
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

/// All groups of a tile with their sums, by ascending path length.
///
/// Memory: 16 bytes per reflector twice, and the sums.
pub(super) fn tile_sums(
    reflectors: &Reflectors,
    tile: &Tile,
    microphones: &[DVec3],
    options: &SimulateOptions,
    tones: &VirtualTones,
) -> Vec<GroupSums> {
    let sights: Vec<Sight> =
        reflectors.positions().iter().map(|&p| Sight::new(p, tile, options)).collect();
    let intervals = Intervals::new(&sights, tones.duration * options.sound_speed);
    // Interval, nearness and index in one number: sorting it groups the reflectors and keeps their order.
    let mut keys: Vec<u64> = sights
        .iter()
        .enumerate()
        .map(|(j, sight)| (intervals.place(sight.path) << 1 | u64::from(sight.near)) << 32 | j as u64)
        .collect();
    keys.sort_unstable();
    let offsets: Vec<DVec3> = tile.microphones.iter().map(|&i| microphones[i] - tile.centre).collect();
    let mut room = Planes::default();
    keys.chunk_by(|a, b| a >> 33 == b >> 33)
        .map(|group| {
            let middle = intervals.middle(group[0] >> 33);
            let mut sums = vec![[0.0; 2]; tones.count() * offsets.len()];
            for run in group.chunk_by(|a, b| a >> 32 == b >> 32) {
                let near = run[0] >> 32 & 1 == 1;
                for some in run.chunks(MOST_ECHOES) {
                    let members = some.iter().map(|key| (key & u64::from(u32::MAX)) as usize);
                    room.fill(reflectors, members, &sights, middle, tile, options, tones);
                    for (sums, &d) in sums.chunks_exact_mut(tones.count()).zip(&offsets) {
                        room.add(d, near.then_some(tile.centre), options, tones, sums);
                    }
                }
            }
            let mut split = Vec::with_capacity(2 * sums.len());
            for q in 0..tones.count() {
                for part in 0..2 {
                    split.extend(sums.iter().skip(q).step_by(tones.count()).map(|sum| sum[part] as f32));
                }
            }
            GroupSums { middle, sums: split }
        })
        .collect()
}

/// A run of reflectors in planes, as the kernels want them.
#[derive(Debug, Default)]
struct Planes {
    positions: Vec<DVec3>,
    /// Path lengths to the centre, whole and from the group's middle, m.
    paths: Vec<f64>,
    from_middle: Vec<f64>,
    phasors: Vec<Complex32>,
    toward: [Vec<f32>; 3],
    distance: Vec<f32>,
    turn: Vec<f32>,
    amplitude: [Vec<f32>; 2],
    offsets: Vec<f32>,
}

impl Planes {
    #[allow(clippy::too_many_arguments)]
    fn fill(
        &mut self,
        reflectors: &Reflectors,
        members: impl Iterator<Item = usize> + Clone,
        sights: &[Sight],
        middle: f64,
        tile: &Tile,
        options: &SimulateOptions,
        tones: &VirtualTones,
    ) {
        self.positions.clear();
        self.positions.extend(members.clone().map(|j| reflectors.positions()[j]));
        self.paths.clear();
        self.paths.extend(members.clone().map(|j| sights[j].path));
        self.from_middle.clear();
        self.from_middle.extend(self.paths.iter().map(|path| path - middle));
        let count = self.positions.len();
        self.phasors.resize(count, Complex32::ZERO);
        phasors(tones.centre / options.sound_speed, &self.from_middle, &mut self.phasors);
        let padded = count.next_multiple_of(LANES);
        for plane in self.toward.iter_mut().chain(&mut self.amplitude).chain([&mut self.turn]) {
            plane.clear();
            plane.resize(padded, 0.0);
        }
        // What pads has no amplitude; a distance keeps its offset finite.
        self.distance.clear();
        self.distance.resize(padded, 1.0);
        self.offsets.clear();
        self.offsets.resize(padded, 0.0);
        let per_metre = tones.step / options.sound_speed;
        for (i, j) in members.enumerate() {
            let toward = match options.model {
                PropagationModel::Exact => {
                    let q = self.positions[i] - tile.centre;
                    self.distance[i] = q.length() as f32;
                    q
                }
                PropagationModel::Linear => options.geometry.far_direction(self.positions[i]),
            };
            for (plane, x) in self.toward.iter_mut().zip(toward.to_array()) {
                plane[i] = x as f32;
            }
            self.turn[i] = (self.from_middle[i] * per_metre) as f32;
            let a = reflectors.amplitudes()[j] * self.phasors[i];
            self.amplitude[0][i] = a.re;
            self.amplitude[1][i] = a.im;
        }
    }

    /// Adds the run's echoes at the microphone that lies at `d` from the tile's centre to its sums.
    ///
    /// For reflectors among the microphones, the centre itself is given, and the offsets are f64 differences.
    fn add(
        &mut self,
        d: DVec3,
        near: Option<DVec3>,
        options: &SimulateOptions,
        tones: &VirtualTones,
        sums: &mut [[f64; 2]],
    ) {
        let toward = [&self.toward[0][..], &self.toward[1], &self.toward[2]];
        let (microphone, legs) = (d.as_vec3().to_array(), options.geometry.return_legs() as f32);
        if let Some(centre) = near {
            for ((offset, &p), path) in self.offsets.iter_mut().zip(&self.positions).zip(&self.paths) {
                *offset = (options.path_length(p, centre + d) - path) as f32;
            }
        } else if options.model == PropagationModel::Exact {
            exact_offsets(toward, &self.distance, microphone, legs, &mut self.offsets);
        } else {
            linear_offsets(toward, microphone, legs, &mut self.offsets);
        }
        let per_metre = [tones.centre, tones.step].map(|f| (f / options.sound_speed) as f32);
        let echoes =
            Echoes { turn: &self.turn, amplitude: [&self.amplitude[0], &self.amplitude[1]] };
        sum_over_tones(echoes, &self.offsets, per_metre, sums);
    }
}
