//! The linear method: the far-field Fourier transform of Eq. 9, which the paper tried first and dropped.
//!
//! With the path of Eq. 6–7, `2|p| − p̂·r`, Eq. 13 reads
//!
//! `Â(p) = w/(Σ_f w_f · Σ_r w_r) · Σ_f e^{−i2πf·2|p|/c} Σ_r w_f w_r m(f, r) e^{+i2πf p̂·r/c}`,
//!
//! a Fourier transform over the array at `k = f·p̂₂/c`, so the angular axis scales with f (Eq. 9 drops that factor), and
//! one over the band. It is the adjoint of a simulation with `model = "linear"`, as Eq. 13 is that of Eq. 5, and images such
//! data as sharply. Of true data it is out of focus by the error of Eq. 6, about `r²/2|p|` of path: a wavelength
//! where an array of 1 m looks 7 m away at 20 kHz. `auto` never takes it.
//!
//! # How
//! The sum depends on direction and range alone, so it is worked out on a lattice of (p̂_x, p̂_y, |p|) and interpolated:
//! 1. per tone, two chirp-z transforms, x then y, of sixteen tones in the lanes ([`chirp`]); microphones on no lattice
//!    are first spread onto one;
//! 2. along the band one matrix product, since tones may be uneven and ranges are few;
//! 3. per voxel, a product of three short [`taper`]s.
//!
//! # Error
//! Against the sum above, for any data: at most `Π(1 + e) − 1` of `Σ|w m| / Σw`, over the measured errors e of up to three
//! tapers and of spreading along x and y. They are as long as the tolerance asks (0 counts as 10⁻⁶, and spreading ends at
//! some 3·10⁻⁶). Rounding of f32 adds some 10⁻⁶. How far the far field is from the truth is no part of it.

mod chirp;
mod taper;

use super::tones::FREQUENCIES;
use super::weights::Weights;
use super::{Made, Method, VolumeSink, no_room, room_for};
use crate::acquisition::{CubeSource, Setup};
use crate::error::Result;
use crate::grid::{Axis, Grid, zeros};
use crate::progress::{Observer, advance, stage};
use crate::wave::simd::{LANES, Lanes, leave_wide_registers};
use crate::wave::{Geometry, phasor};
use chirp::{Chirps, Nodes};
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use glam::DVec3;
use num_complex::Complex32;
use rayon::prelude::*;
use taper::{MOST_TAPS, Sampled, Taper};

/// The error that stands for a tolerance of 0.
const LEAST_TOLERANCE: f64 = 1e-6;

/// Most axes on which a taper is used: two of microphones, two of directions, one of ranges.
const AXES: f64 = 5.0;

/// Operations that reading one sample of the lattice is worth, by measurement: its product is two, but samples lie apart.
const GATHERED: f64 = 40.0;

/// Directions that one thread takes through the product along the band at a time.
const DIRECTIONS: usize = 256;

/// The lattice of directions and ranges for a job.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    grid: Grid,
    taper: Taper,
    /// Where ranges and directions count from: the speaker, or the origin of a scan.
    origin: DVec3,
    /// How often the way back is travelled.
    legs: f64,
    /// Height of the microphones above the origin, m.
    height: f64,
    /// Along x and y: where samples are put.
    nodes: [Nodes; 2],
    /// Along x and y: p̂_x and p̂_y.
    directions: [Sampled; 2],
    ranges: Sampled,
    /// Microphones, for those that stand on no lattice.
    scattered: Vec<[f64; 2]>,
    frequencies: Vec<f64>,
    sound_speed: f64,
}

/// Least and greatest component of the unit vector to a box along an axis: `along` are the box's ends there, `aside`
/// the least and greatest square of the rest.
fn components(along: [f64; 2], aside: [f64; 2]) -> [f64; 2] {
    let of = |a: f64, square: f64| if a == 0.0 { 0.0 } else { a / (a * a + square).sqrt() };
    let [low, high] = along;
    [
        of(low, if low > 0.0 { aside[1] } else { aside[0] }),
        of(high, if high > 0.0 { aside[0] } else { aside[1] }),
    ]
}

/// Least and greatest square on an interval.
fn squares([low, high]: [f64; 2]) -> [f64; 2] {
    let least = if low <= 0.0 && high >= 0.0 { 0.0 } else { low.abs().min(high.abs()) };
    [least * least, low.abs().max(high.abs()).powi(2)]
}

/// Least and greatest product of numbers of two intervals.
fn products([a, b]: [f64; 2], [c, d]: [f64; 2]) -> [f64; 2] {
    let all = [a * c, a * d, b * c, b * d];
    [all.into_iter().fold(f64::INFINITY, f64::min), all.into_iter().fold(f64::NEG_INFINITY, f64::max)]
}

impl Plan {
    /// The lattice that keeps `tolerance`.
    ///
    /// # Errors
    /// In words: microphones that lie in no plane of constant z.
    pub(super) fn new(setup: &Setup, grid: &Grid, tolerance: f64) -> std::result::Result<Self, String> {
        let (low, high) = setup.array.bounds();
        if high.z - low.z > 1e-6 * setup.shortest_wavelength() {
            return Err(format!("the microphones lie in no plane of constant z ({} to {} m)", low.z, high.z));
        }
        let origin = match setup.geometry {
            Geometry::FixedSource { source } => source,
            Geometry::Monostatic => DVec3::ZERO,
        };
        let (legs, c) = (setup.geometry.return_legs(), setup.sound_speed);
        let share = tolerance.max(LEAST_TOLERANCE) / AXES / 1.1;
        let taper = Taper::new(share);
        let (first, last) = grid.bounds();
        let ends: [[f64; 2]; 3] = std::array::from_fn(|i| [first[i] - origin[i], last[i] - origin[i]]);
        let square = ends.map(squares);
        let per_metre = [setup.sweep.start() * legs / c, setup.sweep.stop() * legs / c];
        let mics: [[f64; 2]; 2] = std::array::from_fn(|i| [low[i] - origin[i], high[i] - origin[i]]);
        let lattice = setup.array.lattice().map(|lattice| [lattice.x, lattice.y]);
        let of_axis = |i: usize| {
            let aside = [0, 1].map(|end| square[1 - i][end] + square[2][end]);
            let ends = components(ends[i], aside);
            let steepest = per_metre[1] * ends[0].abs().max(ends[1].abs());
            let nodes = match lattice {
                Some(axes) => Nodes::on_lattice(Axis { first: axes[i].first - origin[i], ..axes[i] }),
                // Longer spreading costs next to nothing beside longer tapers.
                None => Nodes::among(mics[i], steepest, 0.5 * share),
            };
            let directions = Sampled::new(ends, products(per_metre, nodes.ends()), &taper);
            (nodes, directions)
        };
        let [(x, u), (y, v)] = [of_axis(0), of_axis(1)];
        let height = low.z - origin.z;
        // Of p̂·r the height of the plane's part goes with the range, for each direction by itself.
        let slack = legs * height.abs() / 2.0;
        let nearest = square.iter().map(|s| s[0]).sum::<f64>().sqrt() - slack;
        let farthest = square.iter().map(|s| s[1]).sum::<f64>().sqrt() + slack;
        let band = [-2.0 * setup.sweep.stop() / c, -2.0 * setup.sweep.start() / c];
        let scattered = match lattice {
            Some(_) => Vec::new(),
            None => setup.array.positions().iter().map(|r| [r.x - origin.x, r.y - origin.y]).collect(),
        };
        Ok(Self {
            grid: *grid,
            origin,
            legs,
            height,
            nodes: [x, y],
            directions: [u, v],
            ranges: Sampled::new([nearest, farthest], band, &taper),
            taper,
            scattered,
            frequencies: setup.sweep.frequencies().to_vec(),
            sound_speed: c,
        })
    }

    /// Number of directions.
    fn directions_len(&self) -> u64 {
        (self.directions[0].count() as u64).saturating_mul(self.directions[1].count() as u64)
    }

    /// Floating-point operations, to within a factor of two.
    pub(super) fn operations(&self) -> f64 {
        let tones = self.frequencies.len() as f64;
        let [n_x, n_y] = [0, 1].map(|i| self.nodes[i].count() as f64);
        let [n_u, n_v] = [0, 1].map(|i| self.directions[i].count() as f64);
        // Two transforms, and what stands around them.
        let chirp = |n: f64| 2.0 * n * (2.0 * 5.0 * n.max(2.0).log2() + 10.0);
        let lateral = n_y * chirp(n_x + n_u) + n_u * chirp(n_y + n_v);
        let taps = self.taper.taps() as f64;
        tones * (lateral + 8.0 * n_u * n_v * self.ranges.count() as f64)
            + self.grid.voxel_count() as f64 * (500.0 + GATHERED * taps.powi(3))
    }

    /// Bytes at the peak beside samples and volume.
    pub(super) fn bytes(&self, threads: usize) -> u64 {
        let (directions, complex) = (self.directions_len(), size_of::<Complex32>() as u64);
        let block = FREQUENCIES.min(self.frequencies.len()).next_multiple_of(LANES) as u64;
        let scratch = 3 * (self.nodes[0].count() as u64 + directions) * size_of::<Lanes>() as u64;
        directions
            .saturating_mul(complex)
            .saturating_mul(self.ranges.count() as u64 + block)
            .saturating_add(scratch.saturating_mul(threads as u64))
            .saturating_add((self.grid.x.count as u64).saturating_mul(self.grid.y.count as u64) * complex)
    }

    /// The greatest error of all tapers together, relative to one.
    fn error(&self) -> f64 {
        let sampled = self.directions.iter().chain([&self.ranges]).filter(|s| s.count() > 1).count();
        let spread: f64 = self.nodes.iter().map(|nodes| 1.0 + nodes.error()).product();
        (1.0 + self.taper.error).powi(sampled as i32) * spread - 1.0
    }
}

/// Gives the volume to `sink` by the formula above.
pub(super) fn linear(
    source: &mut dyn CubeSource,
    weights: &Weights,
    plan: &Plan,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<Made> {
    let (n_f, n_mic) = (plan.frequencies.len(), source.setup().array.len());
    let (directions, ranges) = (plan.directions_len(), plan.ranges.count());
    let mut polar =
        zeros(directions.saturating_mul(ranges as u64)).ok_or_else(|| no_room(directions, ranges as u64))?;
    let chirps = Chirps::new(&plan.nodes, &plan.directions);
    let footprints = chirps.footprints(&plan.scattered);
    let mut modulus = 0.0;
    stage(observer, "transforming", n_f as u64, || {
        source.visit(FREQUENCIES, &mut |range, block| {
            let rows: Vec<&[Complex32]> = block.chunks_exact(n_mic).collect();
            modulus += range.clone().zip(&rows).map(|(f, row)| weights.modulus(f, row)).sum::<f64>();
            let tones: Vec<usize> = range.clone().collect();
            let groups: Option<Vec<Vec<Lanes>>> = tones
                .par_chunks(LANES)
                .zip(rows.par_chunks(LANES))
                .map(|(tones, rows)| {
                    let samples = tones.iter().zip(rows).map(|(f, row)| weights.weighted(*f, row));
                    let nodes = chirps.nodes(samples, &footprints)?;
                    let per_metre: Vec<f64> =
                        tones.iter().map(|f| plan.frequencies[*f] * plan.legs / plan.sound_speed).collect();
                    chirps.transform(&nodes, &per_metre, &plan.taper)
                })
                .collect();
            let groups = groups.ok_or_else(|| no_room(tones.len() as u64, n_mic as u64))?;
            along_band(plan, &plan.frequencies[range.clone()], &groups, &mut polar);
            advance(observer, range.len() as u64)
        })
    })?;
    let made = Made { method: Method::Linear, error_bound: plan.error() * modulus };
    sink.begin(&made)?;
    interpolate(plan, &polar, sink, observer)?;
    Ok(made)
}

/// Adds a block of tones to all directions and ranges: `polar[d, l] += Σ_q P[d, q] e^{−i2π·2(f_q − f_c)R_l/c}`, f_c the
/// middle of the band, which the voxels put back.
fn along_band(plan: &Plan, frequencies: &[f64], groups: &[Vec<Lanes>], polar: &mut [Complex32]) {
    let (n_r, n_f) = (plan.ranges.count(), frequencies.len());
    let phases: Vec<Complex32> = frequencies
        .par_iter()
        .flat_map_iter(|f| {
            let cycles = -2.0 * f / plan.sound_speed;
            let correction = plan.ranges.correction(cycles, &plan.taper);
            let beyond = cycles - plan.ranges.carrier();
            plan.ranges.positions().map(move |range| phasor(beyond * range) * correction)
        })
        .collect();
    let phases = MatRef::from_row_major_slice(&phases, n_f, n_r);
    polar.par_chunks_mut(DIRECTIONS * n_r).enumerate().for_each_init(
        || vec![Complex32::ZERO; DIRECTIONS * n_f],
        |spectra, (chunk, polar)| {
            let first = chunk * DIRECTIONS;
            let spectra = &mut spectra[..polar.len() / n_r * n_f];
            for (d, spectrum) in spectra.chunks_exact_mut(n_f).enumerate() {
                for (tones, group) in spectrum.chunks_mut(LANES).zip(groups) {
                    for (lane, tone) in tones.iter_mut().enumerate() {
                        *tone = group[first + d].at(lane);
                    }
                }
            }
            let rows = polar.len() / n_r;
            let spectra = MatRef::from_row_major_slice(spectra, rows, n_f);
            let to = MatMut::from_row_major_slice_mut(polar, rows, n_r);
            matmul(to, Accum::Add, spectra, phases, Complex32::ONE, Par::Seq);
            leave_wide_registers();
        },
    );
}

/// Gives every voxel what stands at its direction and range.
fn interpolate(
    plan: &Plan,
    polar: &[Complex32],
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<()> {
    let grid = &plan.grid;
    let mut voxels = room_for(&Grid { z: Axis { count: 1, ..grid.z }, ..*grid })?;
    stage(observer, "reconstructing", grid.z.count as u64, || {
        for iz in 0..grid.z.count {
            voxels.par_chunks_mut(grid.x.count).enumerate().for_each(|(iy, row)| {
                for (ix, voxel) in row.iter_mut().enumerate() {
                    *voxel = at(plan, polar, grid.position(ix, iy, iz) - plan.origin);
                }
            });
            sink.take(iz, &voxels)?;
            advance(observer, 1)?;
        }
        Ok(())
    })
}

/// The value at a place given from the origin.
fn at(plan: &Plan, polar: &[Complex32], place: DVec3) -> Complex32 {
    let unit = place.normalize_or_zero();
    let range = place.length() - plan.legs * unit.z * plan.height / 2.0;
    let [u, v] = &plan.directions;
    let (mut w_u, mut w_v, mut w_r) = ([0.0; MOST_TAPS], [0.0; MOST_TAPS], [0.0; MOST_TAPS]);
    let (u_first, w_u) = u.weights(unit.x, &plan.taper, &mut w_u);
    let (v_first, w_v) = v.weights(unit.y, &plan.taper, &mut w_v);
    let (r_first, w_r) = plan.ranges.weights(range, &plan.taper, &mut w_r);
    let mut sums = [0.0f32; 2 * MOST_TAPS];
    let sums = &mut sums[..2 * w_r.len()];
    for (i, w_v) in w_v.iter().enumerate() {
        for (j, w_u) in w_u.iter().enumerate() {
            let direction = (v_first + i) * u.count() + u_first + j;
            let row = &polar[direction * plan.ranges.count() + r_first..][..w_r.len()];
            let weight = w_u * w_v;
            for (sum, value) in sums.iter_mut().zip(bytemuck::cast_slice::<Complex32, f32>(row)) {
                *sum += weight * value;
            }
        }
    }
    let mut total = Complex32::ZERO;
    for (pair, w) in sums.chunks_exact(2).zip(w_r) {
        total += Complex32::new(pair[0], pair[1]) * *w;
    }
    total * phasor(u.carrier() * unit.x + v.carrier() * unit.y + plan.ranges.carrier() * range)
}
