//! Spreading: microphones that are on no lattice, moved onto one.
//!
//! As a function of the microphone's place r the kernel `e^{−ik|p−r|}` is band-limited to `k sin θ_max`, the steepest
//! angle at which a voxel is seen. So `K(p − r) = Σ_g φ(r − g) K(p − g)` with g on a fine enough lattice and a short
//! least-squares interpolator φ, and adding each sample to a few nodes with those weights gives the same image. The
//! number of taps follows from the error, which is measured on the spherical kernels themselves.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

use super::interpolator::Taps;
use crate::grid::Axis;
use crate::wave::interval::greater;
use crate::wave::simd::{LANES, dispatched, sin_cos_exact};
use std::f64::consts::{PI, TAU};

/// The kernels that an axis of nodes has to carry: `e^{−ik√(x² + h²)}` for |x| up to `aside` and any h from `height`
/// on; of pairs `e^{−ik/2·(√((x + a)² + h²) + √((x − a)² + h'²))}`, 2a apart.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Kernels {
    /// k, radians per m; of both legs where both move.
    pub(crate) wavenumber: f64,
    /// Least distance of a voxel from the plane of microphones, m.
    pub(crate) height: f64,
    /// Largest distance of voxel and microphone along the axis, or of a voxel and the middle of a pair, m.
    pub(crate) aside: f64,
    /// How far apart a pair is along the axis, m; else 0.
    pub(crate) apart: f64,
}

impl Kernels {
    /// Steepest change along the axis within `margin` m more than `aside`, radians per m.
    pub(crate) fn band(&self, margin: f64) -> f64 {
        let steepness = |aside: f64| aside / aside.hypot(self.height).max(f64::MIN_POSITIVE);
        let [near, far] = [-0.5, 0.5].map(|half| steepness(self.aside + margin + half * self.apart));
        self.wavenumber * 0.5 * (near + far)
    }

    /// Pitch of nodes of which the steepest change takes the part `fill` of the band, some taps beyond the last
    /// microphone included, m.
    pub(crate) fn pitch_filled(&self, fill: f64) -> f64 {
        // Steeper changes want a finer pitch, and a finer pitch reaches less far beyond: a fixed point from below.
        (0..16).fold(fill * PI / self.wavenumber, |pitch, _| fill * PI / self.band(8.0 * pitch))
    }
}

/// Least-squares weights for a band, with a measured error.
#[derive(Debug, Clone)]
pub(crate) struct Interpolator {
    taps: Taps,
    /// The largest interpolation error of any kernel, at any place, relative to one.
    pub(crate) error: f64,
}

/// How much of the nodes' band the steepest wave may take, tried in turn. Nodes cost transforms and taps next to
/// nothing, so the fullest comes first. At 0.5, twelve taps keep every kernel to 10⁻⁴ and fourteen to 2.5·10⁻⁵; at 0.6
/// twelve leave 10⁻³. The image errs much less, since the errors of many microphones do not add up.
pub(crate) const FILLS: [f64; 6] = [0.7, 0.6, 0.5, 0.375, 0.25, 0.125];

/// Errors are measured from where that would be such a part of the tolerance: what they usually come to in the end.
const BEGIN: f64 = 0.5;

/// The most taps that are tried.
const MOST_TAPS: usize = 22;

impl Interpolator {
    /// The shortest interpolator that carries the kernels on nodes `pitch` m apart to within `tolerance`, or the
    /// longest that is tried, with an error above it.
    pub(crate) fn new(kernels: &Kernels, pitch: f64, tolerance: f64) -> Self {
        let edge = |taps: usize| kernels.band(pitch * taps as f64 / 2.0) * pitch;
        let of = |taps: usize| {
            let mut interpolator = Self { taps: Taps::new(taps, edge(taps)), error: 0.0 };
            interpolator.error = interpolator.measure(kernels, pitch, tolerance);
            interpolator
        };
        // With each two taps more the error falls by about tan²(edge/4), from one.
        let about = |taps: usize| (edge(taps) / 4.0).tan().powi(taps as i32);
        let usual = (2..MOST_TAPS).step_by(2).find(|taps| about(*taps) <= BEGIN * tolerance);
        let begin = usual.unwrap_or(MOST_TAPS);
        let (mut taps, mut found) = (begin, of(begin));
        while found.error > tolerance && taps < MOST_TAPS {
            taps += 2;
            found = of(taps);
        }
        // Where the first did already, fewer may.
        while found.error <= tolerance && taps <= begin && taps > 2 {
            let fewer = of(taps - 2);
            if fewer.error > tolerance {
                break;
            }
            (taps, found) = (taps - 2, fewer);
        }
        found
    }

    /// Number of nodes each sample goes to.
    pub(crate) fn taps(&self) -> usize {
        self.taps.count()
    }

    /// Of each microphone at `positions` m, the first node that it goes to and the weights from there on; the nodes reach far
    /// enough to both sides.
    pub(crate) fn onto(&self, nodes: &Axis, positions: &[f64]) -> Vec<(usize, Vec<f64>)> {
        let own = |position: &f64| (position - nodes.first) / nodes.pitch;
        let after: Vec<f64> = positions.iter().map(|r| own(r) - own(r).floor()).collect();
        let weights = self.taps.weights_of(&after);
        let footprint = |(n, position): (usize, &f64)| {
            let first = own(position).floor() as isize + self.taps.first();
            assert!(
                first >= 0 && first as usize + self.taps() <= nodes.count,
                "nodes reach beyond every microphone by half the taps"
            );
            (first as usize, weights.col_as_slice(n).to_vec())
        };
        positions.iter().enumerate().map(footprint).collect()
    }

    /// The largest `|K(x) − Σ_a w_a K(x_a)|` over the kernels, and between two nodes; the search ends with the first
    /// place where it is above `enough`.
    fn measure(&self, kernels: &Kernels, pitch: f64, enough: f64) -> f64 {
        let mut worst = 0.0;
        // From the middle on, where most interpolators err most; the other half is the mirror image, and on a node there is
        // no error.
        for t in [4, 3, 2, 1].map(|i| f64::from(i) / 8.0) {
            let (mut offsets, mut weights) = ([0.0; PLACES], [0.0; PLACES]);
            for (a, w) in self.taps.weights(t).into_iter().enumerate() {
                offsets[a] = pitch * ((a as isize + self.taps.first()) as f64 - t);
                weights[a] = w;
            }
            // And the place itself.
            weights[self.taps()] = -1.0;
            let used = (self.taps() + 1).next_multiple_of(LANES);
            let (offsets, weights) = (&offsets[..used], &weights[..used]);
            // Low kernels bend most, high ones are nearly plane waves; both are steepest far aside.
            let legs = if kernels.apart > 0.0 { 2 } else { 1 };
            let cycles_per_metre = kernels.wavenumber / (TAU * legs as f64);
            for heights in HEIGHTS.into_iter().take(if legs > 1 { HEIGHTS.len() } else { OF_ONE_LEG }) {
                let heights = heights.map(|factor| factor * kernels.height);
                for j in (0..=20).rev().flat_map(|j| [-j, j]) {
                    let (x, mut sum) = (kernels.aside * f64::from(j) / 20.0, [0.0; 2]);
                    let half = 0.5 * kernels.apart;
                    let places = [[x + half, heights[0]], [x - half, heights[1]]];
                    sum_of_kernels(cycles_per_metre, &places[..legs], offsets, weights, &mut sum);
                    worst = greater(worst, sum[0].hypot(sum[1]));
                    if worst > enough {
                        return worst;
                    }
                }
            }
        }
        worst
    }
}

/// Heights at which kernels are measured, of both legs of a pair, and how many of them also serve one leg.
const HEIGHTS: [[f64; 2]; 5] = [[1.0, 1.0], [1.5, 1.5], [3.0, 3.0], [1.0, 3.0], [3.0, 1.0]];
const OF_ONE_LEG: usize = 3;

/// The most places at which kernels are summed, whole lanes of them: the taps and one more.
const PLACES: usize = (MOST_TAPS + 1).next_multiple_of(LANES);

#[inline(always)]
fn sum_of_kernels_body(
    cycles_per_metre: f64,
    legs: &[[f64; 2]],
    offsets: &[f64],
    weights: &[f64],
    sum: &mut [f64; 2],
) {
    let (mut re, mut im) = ([0.0; LANES], [0.0; LANES]);
    for (offsets, weights) in offsets.as_chunks::<LANES>().0.iter().zip(weights.as_chunks::<LANES>().0) {
        let mut lengths = [0.0; LANES];
        for [x, height] in legs {
            for l in 0..LANES {
                let at = x + offsets[l];
                lengths[l] += (at * at + height * height).sqrt();
            }
        }
        for l in 0..LANES {
            let (sin, cos) = sin_cos_exact(lengths[l] * cycles_per_metre);
            re[l] += weights[l] * cos;
            im[l] += weights[l] * sin;
        }
    }
    *sum = [re.iter().sum(), im.iter().sum()];
}

dispatched! {
    /// `Σ w e^{i2π·cycles_per_metre·L(offset)}`, with `L = Σ √((x + offset)² + height²)` over legs of x and height.
    fn sum_of_kernels = sum_of_kernels_body(
        cycles_per_metre: f64,
        legs: &[[f64; 2]],
        offsets: &[f64],
        weights: &[f64],
        sum: &mut [f64; 2],
    )
}

/// The nodes along one axis for microphones between `low` and `high` m, whole pitches from `origin`.
pub(crate) fn nodes_around(
    [low, high]: [f64; 2],
    origin: f64,
    pitch: f64,
    interpolator: &Interpolator,
) -> Axis {
    let margin = interpolator.taps() / 2;
    let below = ((low - origin) / pitch).floor() - margin as f64;
    let above = ((high - origin) / pitch).floor() + 1.0 + margin as f64;
    Axis { first: origin + below * pitch, pitch, count: ((above - below) as usize).saturating_add(1) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use num_complex::Complex64;

    fn kernels(height: f64) -> Kernels {
        Kernels { wavenumber: 366.0, height, aside: 0.7, apart: 0.0 }
    }

    /// The kernel of a voxel `x` m aside, `height` m away: of a pair, whose two ends are at other heights.
    fn kernel(kernels: &Kernels, x: f64, height: f64) -> Complex64 {
        let half = 0.5 * kernels.apart;
        let legs =
            [(x + half).hypot(height), (x - half).hypot(if half > 0.0 { height + 0.1 } else { height })];
        Complex64::cis(-0.5 * kernels.wavenumber * (legs[0] + legs[1]))
    }

    #[test]
    fn more_taps_for_a_smaller_tolerance() {
        let kernels = kernels(1.0);
        let mut last = 0;
        for (tolerance, most) in [(1e-2, 6), (1e-3, 10), (1e-4, 12), (1e-5, 16)] {
            let interpolator = Interpolator::new(&kernels, kernels.pitch_filled(0.5), tolerance);
            assert!(interpolator.error <= tolerance, "{:e} above {tolerance:e}", interpolator.error);
            assert!(
                interpolator.taps() >= last && interpolator.taps() <= most,
                "{} taps",
                interpolator.taps()
            );
            last = interpolator.taps();
        }
    }

    #[test]
    fn a_kernel_between_nodes_is_the_kernel_at_the_sample() {
        for apart in [0.0, 0.2, 0.9] {
            let kernels = Kernels { apart, ..kernels(0.5) };
            let pitch = kernels.pitch_filled(0.5);
            let interpolator = Interpolator::new(&kernels, pitch, 1e-4);
            assert!(interpolator.error <= 1e-4);
            let nodes = nodes_around([-0.3, 0.4], 0.011, pitch, &interpolator);
            for position in [-0.3, -0.123_4, 0.0, 0.271_8, 0.4] {
                let (first, weights) = &interpolator.onto(&nodes, &[position])[0];
                for voxel in [-0.3, -0.1, 0.05, 0.35] {
                    let kernel = |x: f64| kernel(&kernels, voxel - x, 0.62);
                    let at = |a: usize| kernel(nodes.position(first + a));
                    let sum: Complex64 = weights.iter().enumerate().map(|(a, w)| at(a) * w).sum();
                    assert!((sum - kernel(position)).norm() < 1.01e-4, "{apart} {position} {voxel}");
                }
            }
        }
    }

    #[test]
    fn a_voxel_in_the_plane_of_the_microphones_is_not_pretended_to() {
        let kernels = kernels(0.0);
        assert!(Interpolator::new(&kernels, kernels.pitch_filled(0.5), 1e-2).error > 1e-2);
    }
}
