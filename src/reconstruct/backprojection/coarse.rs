//! Fewer voxels than asked for, and the others between them.
//!
//! Turned by `e^{+i2πf_c·path(p, r₀)/c}`, r₀ the middle of the array, an image changes slowly along x and y: what is left
//! of a term is `e^{−i2π(f·path(p, r) − f_c·path(p, r₀))/c}`. Where voxels lie closer than that asks for, nodes farther
//! apart carry it, and each voxel is a short sum over nodes. The weights of each column are fitted to the terms
//! themselves, by least squares; the error is measured on many more of them.

use super::terms::{Density, FITTED, MEASURED, Terms};
use crate::acquisition::Setup;
use crate::grid::{Axis, Grid};
use crate::wave::interval::greater;
use crate::wave::simd::phasors;
use faer::linalg::solvers::SolveLstsq;
use faer::{Mat, c64};
use glam::DVec3;
use num_complex::{Complex32, Complex64};
use rayon::prelude::*;

/// Pitches of nodes that are tried, in voxels.
const RATIOS: [f64; 11] = [1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0];

/// The most taps that are tried.
const MOST_TAPS: usize = 24;

/// The share of the tolerance that each axis may use when it is tried at a few columns.
const PROBED_SHARE: f64 = 0.15;

/// The share of the tolerance that both axes together may use.
pub(super) const SHARE: f64 = 0.5;

/// About what weights amplify errors of nodes by, both axes together.
pub(super) const USUAL_AMPLIFICATION: f64 = 4.0;

/// Nodes along one axis, and how many of them each voxel is summed from.
#[derive(Debug, Clone, Copy)]
struct Nodes {
    axis: Axis,
    taps: usize,
}

impl Nodes {
    /// The voxels themselves.
    fn same(voxels: Axis) -> Self {
        Self { axis: voxels, taps: 1 }
    }

    /// Nodes `ratio` voxels apart that begin on the first voxel, and half the taps more at both ends.
    fn spaced(voxels: &Axis, ratio: f64, taps: usize) -> Self {
        let (pitch, beyond) = (ratio * voxels.pitch, taps / 2 - 1);
        let reached = ((voxels.count - 1) as f64 / ratio).floor() as usize;
        let axis = Axis { first: voxels.first - pitch * beyond as f64, pitch, count: reached + taps };
        Self { axis, taps }
    }

    /// The first node that a voxel is summed from.
    fn first(&self, position: f64) -> usize {
        let own = ((position - self.axis.first) / self.axis.pitch + 1e-9).floor() as usize;
        (own + 1 - self.taps.div_ceil(2)).min(self.axis.count - self.taps)
    }

    /// The fewest nodes that a few columns near the edges, where images change most, do with; the voxels themselves if
    /// none do.
    fn fewest(terms: &Terms, grid: &Grid, axis: usize, tolerance: f64) -> Self {
        let voxels = [grid.x, grid.y][axis];
        let (mut best, mut taps) = (Self::same(voxels), 6);
        for ratio in RATIOS {
            loop {
                if taps > MOST_TAPS || voxels.count < 2 * taps {
                    return best;
                }
                let nodes = Self::spaced(&voxels, ratio, taps);
                let within = |i: usize| {
                    let place = voxels.position(i);
                    let column = nodes.column(terms, grid, axis, place);
                    let error = |density| nodes.error(terms, grid, axis, place, &column, density);
                    // The fitted samples tell most misfits at less expense.
                    error(&FITTED) <= tolerance && error(&MEASURED) <= tolerance
                };
                if [1, 2, voxels.count - 3, voxels.count - 2].into_iter().all(within) {
                    if nodes.axis.count < best.axis.count {
                        best = nodes;
                    }
                    break;
                }
                taps += 2;
            }
        }
        best
    }

    /// The voxel's place, then those of its nodes.
    fn places(&self, position: f64) -> Vec<f64> {
        let first = self.first(position);
        std::iter::once(position).chain((0..self.taps).map(|a| self.axis.position(first + a))).collect()
    }

    /// Weights that make a voxel at `position` of its nodes.
    fn column(&self, terms: &Terms, grid: &Grid, axis: usize, position: f64) -> Vec<Complex64> {
        let n = self.taps;
        let mut rows: Vec<Complex64> = Vec::new();
        terms.sample(grid, axis, &self.places(position), &FITTED, &mut |values| rows.extend(values));
        let count = rows.len() / (n + 1);
        let samples = faer::MatRef::from_row_major_slice(&rows, count, n + 1);
        let (wanted, nodes) = (samples.subcols(0, 1), samples.subcols(1, n));
        let mut normal: Mat<c64> = nodes.adjoint() * nodes;
        for a in 0..n {
            // Neighbouring nodes are nearly dependent; rounding is kept from being amplified.
            normal[(a, a)] += RIDGE * count as f64;
        }
        let right: Mat<c64> = nodes.adjoint() * wanted;
        let solution = normal.qr().solve_lstsq(&right);
        (0..n).map(|a| solution[(a, 0)]).collect()
    }

    /// The greatest error of a column's weights for any sampled term.
    fn error(
        &self,
        terms: &Terms,
        grid: &Grid,
        axis: usize,
        position: f64,
        column: &[Complex64],
        density: &Density,
    ) -> f64 {
        let mut worst = 0.0f64;
        terms.sample(grid, axis, &self.places(position), density, &mut |values| {
            let sum: Complex64 = column.iter().zip(&values[1..]).map(|(w, v)| w * v).sum();
            worst = greater(worst, (sum - values[0]).norm());
        });
        worst
    }
}

/// What keeps the normal equations from being singular, relative to their diagonal.
const RIDGE: f64 = 1e-13;

/// A coarse lattice that was found worth while.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lattice {
    terms: Terms,
    nodes: [Nodes; 2],
}

impl Lattice {
    /// Finds the fewest nodes for voxels that are close enough; `None` where there are not many voxels, or they come too
    /// near to microphones or speaker for a few samples to stand for all terms.
    pub(super) fn find(setup: &Setup, grid: &Grid, tolerance: f64) -> Option<Self> {
        let terms = Terms::of(setup);
        let reach = DVec3::new(grid.x.last() - grid.x.first, grid.y.last() - grid.y.first, 0.0).max_element();
        if terms.gap(grid) < reach / 4.0 {
            return None;
        }
        let share = PROBED_SHARE * tolerance;
        let nodes_y = Nodes::fewest(&terms, grid, 1, share);
        let nodes_x = Nodes::fewest(&terms, &Grid { y: nodes_y.axis, ..*grid }, 0, share);
        let lattice = Self { terms, nodes: [nodes_x, nodes_y] };
        (nodes_x.taps > 1 || nodes_y.taps > 1).then_some(lattice)
    }

    /// The nodes, at the depths of the voxels.
    pub(super) fn grid(&self, voxels: &Grid) -> Grid {
        Grid { x: self.nodes[0].axis, y: self.nodes[1].axis, z: voxels.z }
    }

    /// Operations that [`Lattice::interpolation`] and its use take, by a fixed model.
    pub(super) fn operations(&self, voxels: &Grid) -> f64 {
        let [x, y] = self.nodes.map(|nodes| nodes.taps as f64);
        let (n_x, n_y) = (voxels.x.count as f64, voxels.y.count as f64);
        let rows = self.nodes[1].axis.count as f64;
        let found = 3e5 * (n_x * x + n_y * y);
        found + voxels.z.count as f64 * (8.0 * n_x * (rows * x + n_y * y) + 100.0 * n_x * n_y)
    }

    /// All weights, or `None` if they do not keep to their share of the tolerance.
    pub(super) fn interpolation(&self, voxels: &Grid, tolerance: f64) -> Option<Interpolation> {
        let [nodes_x, nodes_y] = self.nodes;
        // Rows of nodes are interpolated along x first, then the voxels' columns along y.
        let x = Columns::new(&self.terms, &Grid { y: nodes_y.axis, ..*voxels }, 0, nodes_x);
        let y = Columns::new(&self.terms, voxels, 1, nodes_y);
        let error = y.error + y.amplification * x.error;
        let amplification = x.amplification * y.amplification;
        let within = error <= SHARE * tolerance && amplification < 4.0 * USUAL_AMPLIFICATION;
        within.then_some(Interpolation { terms: self.terms, x, y, error, amplification })
    }
}

/// The weights of every voxel along one axis.
#[derive(Debug)]
struct Columns {
    nodes: Nodes,
    first: Vec<usize>,
    /// `[count, taps]`.
    weights: Vec<Complex32>,
    error: f64,
    /// The greatest sum of the moduli of a voxel's weights.
    amplification: f64,
}

impl Columns {
    fn new(terms: &Terms, grid: &Grid, axis: usize, nodes: Nodes) -> Self {
        let voxels = [grid.x, grid.y][axis];
        let first = voxels.positions().map(|t| nodes.first(t)).collect();
        if nodes.taps == 1 {
            let weights = vec![Complex32::ONE; voxels.count];
            return Self { nodes, first, weights, error: 0.0, amplification: 1.0 };
        }
        let of = |i: usize| {
            let column = nodes.column(terms, grid, axis, voxels.position(i));
            let error = nodes.error(terms, grid, axis, voxels.position(i), &column, &MEASURED);
            (column, error)
        };
        let columns: Vec<(Vec<Complex64>, f64)> = (0..voxels.count).into_par_iter().map(of).collect();
        let modulus = |column: &[Complex64]| column.iter().map(|w| w.norm()).sum::<f64>();
        Self {
            nodes,
            first,
            error: columns.iter().map(|(_, error)| *error).fold(0.0, greater),
            amplification: columns.iter().map(|(column, _)| modulus(column)).fold(1.0, greater),
            weights: columns.iter().flat_map(|(column, _)| column).map(single).collect(),
        }
    }

    fn of(&self, voxel: usize) -> (usize, &[Complex32]) {
        (self.first[voxel], &self.weights[voxel * self.nodes.taps..][..self.nodes.taps])
    }
}

fn single(z: &Complex64) -> Complex32 {
    Complex32::new(z.re as f32, z.im as f32)
}

/// How voxels follow from nodes.
#[derive(Debug)]
pub(super) struct Interpolation {
    terms: Terms,
    x: Columns,
    y: Columns,
    /// Bound on the error for exact nodes, relative to `Σ|w m| / Σw`, from measured errors.
    pub(super) error: f64,
    /// By how much errors of nodes can grow.
    pub(super) amplification: f64,
}

impl Interpolation {
    /// A plane of voxels from a plane of nodes at the same depth.
    pub(super) fn plane(&self, nodes: &mut [Complex32], voxels: &Grid, z: f64, plane: &mut [Complex32]) {
        let (nodes_x, nodes_y) = (self.x.nodes.axis, self.y.nodes.axis);
        let per_metre = self.terms.carrier_per_metre();
        let turn = |x: &Axis, y: f64, sign: f64, row: &mut [Complex32]| {
            let length = |x: f64| self.terms.turned_path(DVec3::new(x, y, z));
            let lengths: Vec<f64> = x.positions().map(length).collect();
            let mut turns = vec![Complex32::ZERO; lengths.len()];
            phasors(sign * per_metre, &lengths, &mut turns);
            row.iter_mut().zip(turns).for_each(|(value, turn)| *value *= turn);
        };
        let mut rows = vec![Complex32::ZERO; nodes_y.count * voxels.x.count];
        for (j, (from, to)) in
            nodes.chunks_exact_mut(nodes_x.count).zip(rows.chunks_exact_mut(voxels.x.count)).enumerate()
        {
            turn(&nodes_x, nodes_y.position(j), 1.0, from);
            for (i, value) in to.iter_mut().enumerate() {
                let (first, weights) = self.x.of(i);
                *value = weights.iter().zip(&from[first..]).map(|(w, node)| w * node).sum();
            }
        }
        for (j, to) in plane.chunks_exact_mut(voxels.x.count).enumerate() {
            let (first, weights) = self.y.of(j);
            to.fill(Complex32::ZERO);
            for (w, from) in weights.iter().zip(rows.chunks_exact(voxels.x.count).skip(first)) {
                to.iter_mut().zip(from).for_each(|(value, row)| *value += w * row);
            }
            turn(&voxels.x, voxels.y.position(j), -1.0, to);
        }
    }
}
