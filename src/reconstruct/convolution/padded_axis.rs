//! One axis of the padded convolution: its length, its transform, and where lags, nodes and voxels lie on it.
//!
//! The kernel is a function of `p − r = (l + t)·pitch`, with a whole lag l and a rest t in 0 .. 1. Where t is 0 or ½ the
//! lags on both sides of zero have the same kernels. A padded axis that is centred on them needs only half of the phases
//! and transforms; to centre it, the nodes are shifted circularly by a whole number of places. Any other rest is served
//! too, by an axis padded for all lags, without symmetry.

use super::lattice::Sublattice;
use crate::reconstruct::numerics::{LaneFft, fast_size};
use crate::wave::simd::{LANES, ROWS};

/// One axis of the padded convolution.
#[derive(Debug)]
pub(crate) struct PaddedAxis {
    pub(crate) fft: LaneFft,
    /// Whether the kernel is even on it for every pair of sublattices.
    pub(crate) even: bool,
}

/// A sublattice of voxels, seen from one of nodes, along one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Offset {
    /// Position of the first voxel less that of the first node, m.
    pub(crate) first: f64,
    pub(crate) pitch: f64,
    voxels: usize,
    nodes: usize,
    pub(crate) shift: CircularShift,
}

/// How the nodes are shifted along a padded axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub(crate) struct CircularShift {
    /// Places by which nodes are moved back.
    pub(crate) places: isize,
    /// Whether lag l mirrors −1 − l rather than −l: the rest is ½ rather than 0.
    pub(crate) half: bool,
}

/// The largest remainder, in pitches, that is treated as none; it shifts no phase by more than 10⁻⁶ cycles.
const WHOLE: f64 = 1e-7;

/// How much longer than necessary a padded axis may become for symmetry to pay.
const LONGER: f64 = 1.2;

impl Offset {
    pub(crate) fn new(first: f64, pitch: f64, voxels: Sublattice, nodes: Sublattice) -> Self {
        Self { first, pitch, voxels: voxels.count, nodes: nodes.count, shift: CircularShift::default() }
    }

    /// The shift that makes the kernel even, and the padded length it takes.
    fn even(&self) -> Option<(CircularShift, usize)> {
        let halves = 2.0 * self.first / self.pitch;
        let nearest = halves.round();
        // Also false for what is not finite.
        let close = (halves - nearest).abs() <= 2.0 * WHOLE && nearest.abs() < 1e9;
        let (places, half) = ((nearest / 2.0).floor() as isize, nearest.rem_euclid(2.0) == 1.0);
        let above = self.voxels as isize + places;
        let below = self.nodes as isize - places - isize::from(half);
        close.then(|| (CircularShift { places, half }, 2 * above.max(below).max(1) as usize))
    }

    /// The lag at place `i` of `n`, from the first voxel and node, m: positive up to the last voxel, then the wrapped
    /// negative ones; what padding leaves between them is never read. Of an even kernel, the first half is asked for.
    pub(crate) fn lag(&self, i: usize, padded: &PaddedAxis) -> f64 {
        let wraps = !padded.even && i >= self.voxels;
        let place = i as isize - if wraps { padded.len() as isize } else { 0 };
        self.first + (place - self.shift.places) as f64 * self.pitch
    }

    /// Where node `j` lies.
    pub(crate) fn place(shift: CircularShift, j: usize, padded: &PaddedAxis) -> usize {
        (j as isize - shift.places).rem_euclid(padded.len() as isize) as usize
    }
}

impl PaddedAxis {
    /// The padded axis for all pairs of sublattices along an axis, whose nodes are shifted to suit it where kernels may be even.
    pub(crate) fn around(offsets: &mut [&mut Offset], may_be_even: bool) -> Self {
        let general = all(offsets.iter().map(|o| &**o), LANES);
        let shifts: Option<Vec<(CircularShift, usize)>> =
            offsets.iter().map(|offset| offset.even().filter(|_| may_be_even)).collect();
        if let Some(shifts) = shifts {
            let longest = shifts.iter().map(|(_, n)| *n).max().unwrap_or(1);
            // An array far to the side would need an excessive length.
            if longest <= 2 * general {
                let n = fast_size(longest, 2 * LANES);
                if n as f64 <= LONGER * general as f64 {
                    offsets.iter_mut().zip(shifts).for_each(|(offset, (shift, _))| offset.shift = shift);
                    return Self { fft: LaneFft::new(n), even: true };
                }
            }
        }
        Self { fft: LaneFft::new(general), even: false }
    }

    /// A padded axis for lanes of tones, without symmetry.
    pub(crate) fn around_line<'o>(offsets: impl Iterator<Item = &'o Offset>) -> Self {
        Self { fft: LaneFft::new(all(offsets, ROWS)), even: false }
    }

    pub(crate) fn len(&self) -> usize {
        self.fft.len()
    }

    /// Lags whose kernels have to be computed.
    pub(crate) fn lags(&self) -> usize {
        if self.even { self.len() / 2 } else { self.len() }
    }

    /// Where the lag that mirrors `i` is, if there is one; the remaining place is never read.
    pub(crate) fn mirrored(&self, i: usize, half: bool) -> Option<usize> {
        match (self.even, half) {
            (false, _) => None,
            (true, true) => Some(self.len() - 1 - i),
            (true, false) => (i > 0).then(|| self.len() - i),
        }
    }
}

/// The padded length that holds every lag, a multiple of `step`.
fn all<'o>(offsets: impl Iterator<Item = &'o Offset>, step: usize) -> usize {
    fast_size(offsets.map(|o| o.voxels + o.nodes - 1).max().unwrap_or(1), step)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether each voxel finds each node's kernel where the convolution looks for it.
    fn assert_lags(first: f64, voxels: usize, nodes: usize, even: bool) {
        let part = |count| Sublattice { start: 0, count, stride: 1 };
        let pitch = 0.01;
        let mut offset = Offset::new(first * pitch, pitch, part(voxels), part(nodes));
        let padded = PaddedAxis::around(&mut [&mut offset], true);
        assert_eq!(padded.even, even, "first {first}, {voxels} voxels, {nodes} nodes");
        let mut lags = vec![f64::NAN; padded.len()];
        for i in 0..padded.lags() {
            lags[i] = offset.lag(i, &padded);
            if let Some(mirrored) = padded.mirrored(i, offset.shift.half) {
                lags[mirrored] = lags[i];
            }
        }
        for i in 0..voxels {
            for j in 0..nodes {
                let place = Offset::place(offset.shift, j, &padded);
                let lag = lags[(i + padded.len() - place) % padded.len()];
                let expected = (first + i as f64 - j as f64) * pitch;
                assert!((lag.abs() - expected.abs()).abs() < 1e-12, "{first}: {lag} for {expected}");
            }
        }
    }

    #[test]
    fn every_voxel_finds_the_kernel_of_every_node() {
        // One centre, by whole and by half pitches; nearly one; anywhere; far aside.
        assert_lags(-32.0, 128, 64, true);
        assert_lags(-31.5, 127, 64, true);
        assert_lags(0.5, 63, 64, true);
        assert_lags(17.0, 30, 64, true);
        assert_lags(-31.0, 128, 64, false);
        assert_lags(-10.0, 90, 64, true);
        assert_lags(-31.75, 128, 64, false);
        assert_lags(500.0, 128, 64, false);
        assert_lags(-5000.0, 3, 4, false);
        for (voxels, nodes) in [(1, 1), (1, 16), (17, 1), (16, 16), (40, 3)] {
            for quarters in -90..90 {
                let first = f64::from(quarters) / 4.0;
                let part = |count| Sublattice { start: 0, count, stride: 1 };
                let even =
                    PaddedAxis::around(&mut [&mut Offset::new(first, 1.0, part(voxels), part(nodes))], true)
                        .even;
                assert_lags(first, voxels, nodes, even);
            }
        }
    }
}
