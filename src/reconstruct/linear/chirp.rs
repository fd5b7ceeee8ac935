//! The Fourier transform over the array at `k = f·u/c`, for even steps of the direction cosine u and any f.
//!
//! A chirp-z transform: with `nj = (n² + j² − (j − n)²)/2` the sum over nodes n becomes a convolution with a chirp, whose
//! rate takes f (Bluestein; Rabiner, Schafer and Rader 1969). Sixteen tones fill the lanes, each with a chirp of
//! its own, so rows and columns need no transposition.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

use super::super::lanes::{LaneFft, fast_size};
use super::super::spread::{self, Footprint, Interpolator, Kernels, nodes_around};
use super::taper::{Sampled, Taper};
use crate::grid::{Axis, filled, zeros};
use crate::wave::phasor;
use crate::wave::simd::{LANES, Lanes, ROWS, dispatched};
use num_complex::Complex32;
use std::f64::consts::TAU;

/// Where samples are put along an axis.
#[derive(Debug, Clone)]
pub(super) struct Nodes {
    axis: Axis,
    /// How scattered microphones get onto the nodes.
    interpolator: Option<Interpolator>,
}

/// Changes over all microphones below which they stand in one place, cycles.
const ONE_PLACE: f64 = 1e-9;

/// So far away, m, waves are plane.
const FAR: f64 = 1e6;

impl Nodes {
    /// Microphones that stand on a lattice themselves.
    pub(super) fn on_lattice(axis: Axis) -> Self {
        Self { axis, interpolator: None }
    }

    /// Nodes among microphones anywhere between two ends, for plane waves of up to `steepest` cycles per m.
    pub(super) fn among([low, high]: [f64; 2], steepest: f64, tolerance: f64) -> Self {
        if steepest * (high - low) < ONE_PLACE {
            return Self::on_lattice(Axis { first: f64::midpoint(low, high), pitch: 1.0, count: 1 });
        }
        let wavenumber = TAU * steepest * std::f64::consts::SQRT_2;
        let kernels = Kernels { wavenumber, height: FAR, aside: FAR };
        let pitch = kernels.pitch_filled(0.5);
        let interpolator = Interpolator::new(&kernels, pitch, tolerance);
        let axis = nodes_around([low, high], low, pitch, &interpolator);
        Self { axis, interpolator: Some(interpolator) }
    }

    pub(super) fn count(&self) -> usize {
        self.axis.count
    }

    /// The first and the last node.
    pub(super) fn ends(&self) -> [f64; 2] {
        [self.axis.first, self.axis.last()]
    }

    /// The error of spreading, relative to one.
    pub(super) fn error(&self) -> f64 {
        self.interpolator.as_ref().map_or(0.0, |interpolator| interpolator.error)
    }
}

/// The transforms along both axes.
#[derive(Debug)]
pub(super) struct Chirps<'a> {
    nodes: &'a [Nodes; 2],
    directions: &'a [Sampled; 2],
    ffts: [LaneFft; 2],
}

/// The factors of one axis for sixteen tones.
#[derive(Debug)]
struct Factors {
    /// On the nodes, beforehand.
    before: Vec<Lanes>,
    /// The chirp's spectrum.
    kernel: Vec<Lanes>,
    /// On the directions, afterwards; the scale of the inverse transform is folded in.
    after: Vec<Lanes>,
}

#[inline(always)]
fn times_body(a: &[Lanes], b: &[Lanes], to: &mut [Lanes]) {
    for ((a, b), to) in a.iter().zip(b).zip(to) {
        for l in 0..LANES {
            let z = a.at(l) * b.at(l);
            (to.re[l], to.im[l]) = (z.re, z.im);
        }
    }
}

dispatched! {
    /// Products, number by number; as many as the shortest slice has.
    fn times = times_body(a: &[Lanes], b: &[Lanes], to: &mut [Lanes])
}

/// Exchanges real and imaginary parts, which makes a forward transform an inverse one.
fn exchange(numbers: &mut [Lanes]) {
    for z in numbers {
        std::mem::swap(&mut z.re, &mut z.im);
    }
}

/// Sixteen numbers from a function of the lane; tones that are missing are zero.
fn lanes(tones: &[f64], of: impl Fn(f64) -> Complex32) -> Lanes {
    let mut lanes = Lanes::ZERO;
    for (lane, tone) in tones.iter().enumerate() {
        let z = of(*tone);
        (lanes.re[lane], lanes.im[lane]) = (z.re, z.im);
    }
    lanes
}

impl<'a> Chirps<'a> {
    pub(super) fn new(nodes: &'a [Nodes; 2], directions: &'a [Sampled; 2]) -> Self {
        let ffts =
            [0, 1].map(|i| LaneFft::new(fast_size(nodes[i].count() + directions[i].count() - 1, ROWS)));
        Self { nodes, directions, ffts }
    }

    /// Where scattered microphones go; none for a lattice, whose samples are the nodes in order.
    pub(super) fn footprints(&self, scattered: &[[f64; 2]]) -> Vec<[Footprint; 2]> {
        spread::footprints(scattered, |i, positions| match &self.nodes[i].interpolator {
            Some(interpolator) => Footprint::spread(positions, &self.nodes[i].axis, interpolator),
            None => positions.iter().map(|_| Footprint::on_node(0)).collect(),
        })
    }

    /// Samples of up to sixteen tones on the nodes, `[y, x]`; `None` when they do not fit in memory.
    pub(super) fn nodes(
        &self,
        tones: impl Iterator<Item = impl Iterator<Item = Complex32>>,
        footprints: &[[Footprint; 2]],
    ) -> Option<Vec<Lanes>> {
        let n_x = self.nodes[0].count();
        let mut nodes = filled(Lanes::ZERO, (n_x * self.nodes[1].count()) as u64)?;
        for (lane, samples) in tones.enumerate() {
            let mut samples: Vec<Complex32> = samples.collect();
            if !footprints.is_empty() {
                let mut plane = zeros(nodes.len() as u64)?;
                spread::spread(&samples, footprints, n_x, &mut plane);
                samples = plane;
            }
            for (node, z) in nodes.iter_mut().zip(samples) {
                (node.re[lane], node.im[lane]) = (z.re, z.im);
            }
        }
        Some(nodes)
    }

    /// The factors along an axis, for tones given as f·legs/c.
    fn factors(&self, i: usize, tones: &[f64], taper: &Taper) -> Factors {
        let (x, u, fft) = (&self.nodes[i].axis, &self.directions[i], &self.ffts[i]);
        let (n, m, length) = (x.count, u.count(), fft.len());
        let axis = u.axis();
        let rate = x.pitch * axis.pitch / 2.0;
        let before = (0..n).map(|k| {
            lanes(tones, |tone| {
                let (place, k) = (x.position(k), k as f64);
                phasor(tone * (place * axis.first + rate * k * k)) * u.correction(tone * place, taper)
            })
        });
        let after = (0..m).map(|j| {
            lanes(tones, |tone| {
                let (direction, j) = (axis.position(j), j as f64);
                let cycles = tone * (j * axis.pitch * x.first + rate * j * j) - u.carrier() * direction;
                phasor(cycles) / length as f32
            })
        });
        let chirp = |lag: usize| lanes(tones, |tone| phasor(-tone * rate * (lag * lag) as f64));
        let mut kernel = vec![Lanes::ZERO; length];
        for lag in 0..n.max(m) {
            let z = chirp(lag);
            if lag < m {
                kernel[lag] = z;
            }
            if lag > 0 && lag < n {
                kernel[length - lag] = z;
            }
        }
        let (mut spectrum, mut work) = (vec![Lanes::ZERO; length], vec![Lanes::ZERO; length]);
        fft.transform(&kernel, &mut spectrum, &mut work);
        Factors { before: before.collect(), kernel: spectrum, after: after.collect() }
    }

    /// The transform of sixteen tones, `[v, u]`, without the directions' carriers; `None` when it does not fit in memory.
    pub(super) fn transform(&self, nodes: &[Lanes], tones: &[f64], taper: &Taper) -> Option<Vec<Lanes>> {
        let [n_x, n_y] = [0, 1].map(|i| self.nodes[i].count());
        let [n_u, n_v] = [0, 1].map(|i| self.directions[i].count());
        let mut half = filled(Lanes::ZERO, (n_u * n_y) as u64)?;
        let along_x = self.factors(0, tones, taper);
        let mut line = Line::new(self.ffts[0].len());
        for (y, row) in nodes.chunks_exact(n_x).enumerate() {
            let out = line.run(row, &along_x, &self.ffts[0]);
            for (u, z) in out.iter().enumerate() {
                half[u * n_y + y] = *z;
            }
        }
        let mut whole = filled(Lanes::ZERO, (n_u * n_v) as u64)?;
        let along_y = self.factors(1, tones, taper);
        let mut line = Line::new(self.ffts[1].len());
        for (u, column) in half.chunks_exact(n_y).enumerate() {
            let out = line.run(column, &along_y, &self.ffts[1]);
            for (v, z) in out.iter().enumerate() {
                whole[v * n_u + u] = *z;
            }
        }
        Some(whole)
    }
}

/// Buffers for one line after another.
#[derive(Debug)]
struct Line {
    padded: Vec<Lanes>,
    spectrum: Vec<Lanes>,
    work: Vec<Lanes>,
}

impl Line {
    fn new(length: usize) -> Self {
        let zeros = || vec![Lanes::ZERO; length];
        Self { padded: zeros(), spectrum: zeros(), work: zeros() }
    }

    /// One line of nodes at all directions.
    fn run(&mut self, from: &[Lanes], factors: &Factors, fft: &LaneFft) -> &[Lanes] {
        let Self { padded, spectrum, work } = self;
        times(from, &factors.before, &mut padded[..from.len()]);
        padded[from.len()..].fill(Lanes::ZERO);
        fft.transform(padded, spectrum, work);
        times(spectrum, &factors.kernel, padded);
        exchange(padded);
        fft.transform(padded, spectrum, work);
        let count = factors.after.len();
        exchange(&mut spectrum[..count]);
        times(&spectrum[..count], &factors.after, &mut padded[..count]);
        &padded[..count]
    }
}
