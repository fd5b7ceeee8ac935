//! The part of a path that moves with the microphone, as a function of `p − r`: what a kernel is the phase of.
//!
//! It is the leg to the microphone; for a scan twice that leg; and for a pair that is moved the legs to both of its ends, `|p − r|`
//! and `|p − r − a|`. Lags are counted from the middle of a pair: about it a path is even along any axis along which the two are
//! level, and along one on which they lie.

use crate::wave::{Geometry, Refraction};
use glam::{DVec2, DVec3};

/// The legs from a voxel to what moves.
#[derive(Debug, Clone)]
pub(crate) struct KernelPath {
    /// Where legs end, from where lags are counted from, m.
    ends: Vec<DVec3>,
    /// How many times each is in the path.
    times: f64,
    /// Where lags are counted from, from the microphone, m.
    origin: DVec3,
}

/// A leg at one depth.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LegAtDepth {
    pub(crate) times: f64,
    /// Where it ends beside where lags are counted from, m.
    pub(crate) beside: DVec2,
    /// Depth of its end, m.
    pub(crate) end: f64,
    /// That of the voxels less that of its end, m.
    pub(crate) height: f64,
}

impl KernelPath {
    pub(crate) fn new(geometry: &Geometry) -> Self {
        let origin = geometry.moving_middle(DVec3::ZERO);
        Self { ends: geometry.moving_ends(-origin).collect(), times: geometry.return_legs(), origin }
    }

    /// Where lags are counted from, from the microphone, m.
    pub(crate) fn origin(&self) -> DVec3 {
        self.origin
    }

    /// How far apart the ends are along an axis, m.
    pub(crate) fn apart(&self, axis: usize) -> f64 {
        2.0 * self.origin[axis].abs()
    }

    /// Whether lags on both sides of zero along x (0) or y (1) have paths of one length.
    pub(crate) fn is_even(&self, axis: usize) -> bool {
        let across = [self.origin[1 - axis], self.origin.z];
        self.origin[axis] == 0.0 || across == [0.0; 2]
    }

    /// Its legs from voxels at depth `z` to microphones at depth `plane`, m.
    pub(crate) fn legs(&self, plane: f64, z: f64) -> impl Iterator<Item = LegAtDepth> + '_ {
        self.ends.iter().map(move |end| {
            let at = plane + (self.origin.z + end.z);
            LegAtDepth { times: self.times, beside: end.truncate(), end: at, height: z - at }
        })
    }

    /// The least distance of voxels at depth `z` from the planes of its ends, m; where paths bend, of straight legs that are as
    /// steep as bent ones up to so far beside their ends.
    pub(crate) fn height(&self, plane: f64, z: f64, bent: Option<(&Refraction, f64)>) -> f64 {
        let height = |leg: LegAtDepth| match bent {
            None => leg.height.abs(),
            Some((refraction, beside)) => refraction.steepest_height(leg.end, z, beside).abs(),
        };
        self.legs(plane, z).map(height).fold(f64::INFINITY, f64::min)
    }

    /// The only leg, where there is one.
    pub(crate) fn only_leg(&self, plane: f64, z: f64) -> Option<LegAtDepth> {
        let mut legs = self.legs(plane, z);
        legs.next().filter(|_| legs.next().is_none())
    }
}

impl LegAtDepth {
    /// The square of the distance beside its end of a place `lag` beside where lags are counted from, m².
    pub(crate) fn beside_squared(&self, lag: DVec2) -> f64 {
        (lag - self.beside).length_squared()
    }
}
