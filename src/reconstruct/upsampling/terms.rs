//! Terms of Eq. 13 without their carrier, sampled: how fast they change, and what interpolation makes of them.

use super::Carrier;
use crate::acquisition::Instrument;
use crate::grid::{Axis, Grid};
use crate::reconstruct::numerics::{Nodes, wave_error};
use crate::wave::Geometry;
use crate::wave::interval::greater;
use crate::wave::two_legs::TwoLegs;
use glam::DVec3;
use std::iter;

/// Places at which bands are sampled, along x, y and z.
const PLACES: [usize; 3] = [7, 7, 3];

/// Places at which errors are measured, along the axis that is tried and along the others.
const TRIED: usize = 15;
const ACROSS: usize = 3;

/// Places near either end at which they are measured, where nodes are uneven.
const AT_ENDS: usize = 12;

/// Places along the axis that are tried before others are looked at.
const TOGETHER: usize = 8;

/// Between these places errors are a little larger; by a twentieth where that was looked for.
const BETWEEN: f64 = 1.3;

/// The terms that a job can have: one frequency and one microphone each.
pub(super) struct SampledTerms<'a> {
    pub(super) instrument: &'a Instrument,
    pub(super) grid: &'a Grid,
    carrier: Carrier,
    /// The ends of the band, Hz.
    frequencies: [f64; 2],
    /// Places on the faces of the array's box and in its middle, between which all microphones are.
    microphones: Vec<DVec3>,
}

impl<'a> SampledTerms<'a> {
    pub(super) fn new(instrument: &'a Instrument, grid: &'a Grid) -> Self {
        let (low, high) = instrument.array.bounds();
        let axis = |axis: usize| {
            let count = if high[axis] > low[axis] { 3 } else { 1 };
            Axis { first: low[axis], pitch: 0.5 * (high[axis] - low[axis]), count }
        };
        let frame = Grid { x: axis(0), y: axis(1), z: axis(2) };
        Self {
            instrument,
            grid,
            carrier: Carrier::new(instrument),
            frequencies: [instrument.sweep.start(), instrument.sweep.stop()],
            microphones: frame.sampled([3, 3, 3]).collect(),
        }
    }

    /// Places all over the voxels' box, and those nearest to what paths begin and end at, where terms bend most.
    fn places(&self, count: [usize; 3]) -> impl Iterator<Item = DVec3> {
        let (low, high) = self.grid.bounds();
        let geometry = &self.instrument.geometry;
        let moving = self.microphones.iter().flat_map(|r| geometry.moving_ends(*r));
        let ends = moving.chain(match geometry {
            Geometry::FixedSource { source } => Some(*source),
            Geometry::Monostatic | Geometry::Pair { .. } => None,
        });
        self.grid.sampled(count).chain(ends.map(move |end| end.clamp(low, high)))
    }

    /// Microphones to try with a place: all over the array, and the nearest that there can be, by itself or its loudspeaker.
    fn microphones(&self, p: DVec3) -> impl Iterator<Item = DVec3> {
        let (low, high) = self.instrument.array.bounds();
        let ends = self.instrument.geometry.moving_ends(DVec3::ZERO);
        self.microphones.iter().copied().chain(ends.map(move |end| (p - end).clamp(low, high)))
    }

    /// How fast terms change along x, y and z at most, cycles per m.
    pub(super) fn bands(&self) -> [f64; 3] {
        let instrument = self.instrument;
        let mut fastest = DVec3::ZERO;
        for p in self.places(PLACES) {
            let carrier = instrument.sweep.centre() * self.carrier.legs.slope(p);
            for r in self.microphones(p) {
                let slope = TwoLegs::new(&instrument.geometry, r).slope(p);
                for f in self.frequencies {
                    fastest = fastest.max((f * slope - carrier).abs() / instrument.sound_speed);
                }
            }
        }
        // A volume far away may see all from one side.
        fastest.max(DVec3::splat(f64::MIN_POSITIVE)).to_array()
    }

    /// The largest error of voxels made of nodes along an axis for any sampled term, and the largest sum of the weights'
    /// moduli; `None` as soon as what is measured of both does not serve. Of the places tried, `hardest` comes first and is set
    /// to the one that does not: other nodes often fail at the same.
    pub(super) fn error(
        &self,
        axis: usize,
        nodes: &Nodes,
        hardest: &mut usize,
        serves: impl Fn([f64; 2]) -> bool,
    ) -> Option<[f64; 2]> {
        let (mut worst, mut moduli) = (0.0f64, 1.0f64);
        if !nodes.interpolates() {
            return Some([worst, moduli]);
        }
        let per_metre = self.frequencies.map(|f| f / self.instrument.sound_speed);
        let of_weights = |weights: &[f64]| weights.iter().map(|w| w.abs()).sum::<f64>();
        let mut tried: Vec<(usize, DVec3)> = self.tried(axis, nodes).into_iter().enumerate().collect();
        let first = *hardest % tried.len();
        tried.rotate_left(first);
        let mut places: Vec<f64> = Vec::new();
        for (_, p) in &tried {
            if !places.contains(&p[axis]) {
                places.push(p[axis]);
            }
        }
        let (mut around, mut carried, mut lengths) = (Vec::new(), Vec::new(), Vec::new());
        let (mut cycles, mut waves) = (Vec::new(), Vec::new());
        // The weights of some places take hardly longer than those of one, but that one is often enough.
        let (alone, others) = places.split_at(1);
        for places in iter::once(alone).chain(others.chunks(TOGETHER)) {
            for (place, (nodes, weights)) in places.iter().zip(nodes.around(places)) {
                moduli = moduli.max(of_weights(&weights));
                around.clear();
                around.extend(nodes.into_iter().chain([*place]));
                carried.resize(around.len(), 0.0);
                lengths.resize(around.len(), 0.0);
                cycles.resize(around.len(), 0.0);
                for (index, p) in tried.iter().filter(|(_, p)| p[axis] == *place) {
                    self.carrier.legs.along(axis, *p, &around, &mut carried);
                    for r in self.microphones(*p) {
                        TwoLegs::new(&self.instrument.geometry, r).along(axis, *p, &around, &mut lengths);
                        for k in per_metre {
                            for ((cycles, carried), length) in cycles.iter_mut().zip(&carried).zip(&lengths) {
                                *cycles = self.carrier.per_metre * carried - k * length;
                            }
                            worst = greater(worst, wave_error(&weights, &cycles, &mut waves));
                            if worst.is_nan() || !serves([BETWEEN * worst, moduli]) {
                                *hardest = *index;
                                return None;
                            }
                        }
                    }
                }
            }
        }
        Some([BETWEEN * worst, moduli])
    }

    /// Voxels at which nodes along an axis are tried: those near the ends first, where uneven ones fail as a rule.
    fn tried(&self, axis: usize, nodes: &Nodes) -> Vec<DVec3> {
        let voxels = [self.grid.x, self.grid.y, self.grid.z][axis];
        let mut count = [ACROSS; 3];
        count[axis] = TRIED;
        let nearest =
            |position: f64| voxels.position(((position - voxels.first) / voxels.pitch).round() as usize);
        let at_ends =
            nodes.uneven().map_or(Vec::new(), |uneven| at_ends(&voxels, uneven, nodes.taps(), nearest));
        let mut across = count;
        across[axis] = 1;
        let ends = self.places(across).flat_map(|p| at_ends.iter().map(move |end| along(p, axis, *end)));
        ends.chain(self.places(count).map(|p| along(p, axis, nearest(p[axis])))).collect()
    }
}

/// The place along an axis from another.
fn along(mut p: DVec3, axis: usize, place: f64) -> DVec3 {
    p[axis] = place;
    p
}

/// Voxels near both ends, which are made of nodes to one side.
fn at_ends(voxels: &Axis, nodes: &[f64], taps: usize, nearest: impl Fn(f64) -> f64) -> Vec<f64> {
    let reach = nodes[taps.min(nodes.len() - 1)] - voxels.first;
    let place = |i: usize| reach * i as f64 / AT_ENDS as f64;
    let both = |i: usize| [nearest(voxels.first + place(i)), nearest(voxels.last() - place(i))];
    (0..AT_ENDS).flat_map(both).collect()
}
