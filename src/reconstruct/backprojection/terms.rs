//! The terms that a job can have, sampled: one frequency and one microphone each, turned by the middle microphone's path.

use crate::acquisition::Setup;
use crate::grid::Grid;
use crate::wave::Geometry;
use glam::DVec3;
use num_complex::Complex64;
use std::f64::consts::TAU;

/// What the terms of a job can be: everything that a kernel depends on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Terms {
    geometry: Geometry,
    microphones: [DVec3; 2],
    /// Band edges, Hz.
    frequencies: [f64; 2],
    carrier: f64,
    sound_speed: f64,
}

/// How many samples are taken of each thing that a term depends on.
pub(super) struct Density {
    across: usize,
    depths: usize,
    along: usize,
    frequencies: usize,
}

/// What weights are fitted to.
pub(super) const FITTED: Density = Density { across: 3, depths: 3, along: 5, frequencies: 5 };

/// What errors are measured at.
pub(super) const MEASURED: Density = Density { across: 4, depths: 4, along: 4, frequencies: 4 };

/// `count` numbers from `low` to `high`.
fn evenly(low: f64, high: f64, count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| low + (high - low) * i as f64 / (count.max(2) - 1) as f64)
}

impl Terms {
    pub(super) fn of(setup: &Setup) -> Self {
        let (low, high) = setup.array.bounds();
        let frequencies = setup.sweep.frequencies();
        Self {
            geometry: setup.geometry,
            microphones: [low, high],
            frequencies: [frequencies[0], frequencies[frequencies.len() - 1]],
            carrier: setup.sweep.centre(),
            sound_speed: setup.sound_speed,
        }
    }

    fn middle(&self) -> DVec3 {
        self.microphones[0].midpoint(self.microphones[1])
    }

    /// The path length that images are turned by, m.
    pub(super) fn turned_path(&self, p: DVec3) -> f64 {
        self.geometry.path_length(p, self.middle())
    }

    /// f_c/c, 1/m.
    pub(super) fn carrier_per_metre(&self) -> f64 {
        self.carrier / self.sound_speed
    }

    /// Least distance of the box of voxels from microphones and speaker, m.
    pub(super) fn gap(&self, grid: &Grid) -> f64 {
        let corners = grid.corners();
        let gap =
            |low: DVec3, high: DVec3| (corners[0] - high).max(low - corners[7]).max(DVec3::ZERO).length();
        let back = gap(self.microphones[0], self.microphones[1]);
        match self.geometry {
            Geometry::FixedSource { source } => back.min(gap(source, source)),
            Geometry::Monostatic => back,
        }
    }

    /// Calls `take` with the values of many terms at the places `along` an axis (0 for x, 1 for y), the others being
    /// those of a grid.
    pub(super) fn sample(
        &self,
        grid: &Grid,
        axis: usize,
        along: &[f64],
        density: &Density,
        take: &mut dyn FnMut(&[Complex64]),
    ) {
        let other = 1 - axis;
        let across = [&grid.x, &grid.y][other];
        let [low, high] = self.microphones;
        let clamp = |t: f64| t.clamp(across.first, across.last());
        let mut rows: Vec<f64> = evenly(across.first, across.last(), density.across).collect();
        rows.push(clamp(self.middle()[other]));
        if let Geometry::FixedSource { source } = self.geometry {
            rows.push(clamp(source[other]));
        }
        let depth = |t: f64| grid.z.first + t * t * (grid.z.last() - grid.z.first);
        let mut values = vec![Complex64::ZERO; along.len()];
        let (mut paths, mut turned) = (vec![0.0; along.len()], vec![0.0; along.len()]);
        for z in evenly(0.0, 1.0, density.depths).map(depth) {
            for row in &rows {
                let point = |t: f64| {
                    let mut p = DVec3::new(0.0, 0.0, z);
                    (p[axis], p[other]) = (t, *row);
                    p
                };
                for (turned, t) in turned.iter_mut().zip(along) {
                    *turned = self.carrier * self.turned_path(point(*t));
                }
                // Steepest at the array's near and far ends, in the voxel's own row and depth.
                let mut far = vec![low[other], high[other]];
                far.push(row.clamp(low[other], high[other]));
                let near = [z.clamp(low.z, high.z), low.z];
                let mut ends: Vec<f64> = evenly(low[axis], high[axis], density.along).collect();
                ends.push(along[0].clamp(low[axis], high[axis]));
                for (r_axis, r_other, r_z) in ends.iter().flat_map(|a| {
                    let near = &near;
                    far.iter().flat_map(move |b| near.iter().map(move |c| (*a, *b, *c)))
                }) {
                    let mut r = DVec3::new(0.0, 0.0, r_z);
                    (r[axis], r[other]) = (r_axis, r_other);
                    for (path, t) in paths.iter_mut().zip(along) {
                        *path = self.geometry.path_length(point(*t), r);
                    }
                    for f in evenly(self.frequencies[0], self.frequencies[1], density.frequencies) {
                        for ((value, path), turned) in values.iter_mut().zip(&paths).zip(&turned) {
                            *value = Complex64::cis(-TAU / self.sound_speed * (f * path - turned));
                        }
                        take(&values);
                    }
                }
            }
        }
    }
}
