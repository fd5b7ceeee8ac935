//! Voxels interpolated from those of a coarser grid, on which Eq. 13 is summed.
//!
//! With the phase of the middle frequency's echo at the middle of the array taken out, a term of Eq. 13 is
//! `e^{−i2π[f·path(p, r) − f_c·path(p, r_c)]/c}`. Along an axis it changes only by as much as a microphone sees a voxel from
//! another side than the middle of the array does, and a frequency differs from the middle one. Nodes that carry the fastest
//! of these changes may stand farther apart than the voxels; and they may stand on a lattice that the microphones share
//! where the voxels do not. The voxels follow from them by short interpolators along y, x and z.
//!
//! Even nodes, which convolution needs along x and y, and lines of back-projection along all axes, reach beyond the voxels by
//! half of an interpolator at either end of an axis. Along z, and wherever single microphones or tiles are summed, nodes within
//! the voxels serve, the outermost of which stand closer together: in all about half as many in a picture of 10⁵ pixels, fewer
//! still in small ones.
//!
//! Errors, relative to `Σ|w m| / Σw`: that of interpolation is measured on such terms; that of the sum on the nodes is
//! amplified by the sum of the weights' moduli.

mod ends;
mod resampling;
mod sink;
mod terms;

pub(super) use sink::Resampled;

use super::error_budget::ErrorBudget;
use super::numerics::{GridPlaces, IntervalNodes, Memo, Nodes, Taps};
use super::plan::cost::{Cost, complex_bytes};
use super::volume::Batch;
use crate::acquisition::Instrument;
use crate::grid::{Axis, Grid};
use crate::wave::two_legs::TwoLegs;
use glam::DVec3;
use terms::SampledTerms;

/// The most nodes along an axis that a voxel is made of.
const MOST_TAPS: usize = 40;

/// Grids of nodes that there can be.
const MOST_GRIDS: usize = 2;

/// The most nodes along an axis for each voxel: on a lattice of the microphones' more of them may take less.
const MOST_PER_VOXEL: usize = 2;

/// By how much nodes are tried closer together than the band of the voxels' box asks for: they reach beyond the box, where
/// terms change faster.
const CLOSER: [f64; 3] = [1.0, 0.8, 0.6];

/// Nodes along z have to be fewer than depths by this factor: the terms are measured on few, and some are added at both ends.
const FEWER: f64 = 0.8;

/// How many nodes at either end stand closer together where none is beyond the voxels, and by how much those between are
/// closer than their waves ask for, tried in turn. Found by trying.
const DENSE_NODES: [usize; 2] = [6, 9];
const CLOSER_WITHIN: [f64; 2] = [1.0, 0.9];

/// What waves may err by between these nodes, and what their weights are damped by, of the error along an axis: places made
/// of nodes to one side would take large ones.
const INSIDE: f64 = 0.7;
const DAMPING_WITHIN: f64 = 0.7;

/// A grid of nodes, and how voxels follow from them.
#[derive(Debug, Clone)]
pub(super) struct Upsampling {
    /// The voxels.
    fine: Grid,
    /// The nodes.
    pub(super) coarse: Grid,
    /// Along x, y and z.
    axes: [Measured; 3],
    carrier: Carrier,
    pub(super) error: InterpolationError,
}

/// Nodes along one axis, the largest error of interpolation from them, and the largest sum of the weights' moduli.
#[derive(Debug, Clone)]
struct Measured {
    nodes: Nodes,
    error: [f64; 2],
}

impl Measured {
    fn themselves(voxels: Axis) -> Self {
        Self { nodes: Nodes::themselves(&voxels), error: [0.0, 1.0] }
    }
}

/// What interpolation does to the error of the nodes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct InterpolationError {
    /// For exact nodes, relative to `Σ|w m| / Σw`.
    pub(super) own: f64,
    /// By how much errors of nodes can grow: the largest sum of the weights' moduli.
    pub(super) growth: f64,
}

impl InterpolationError {
    /// Of voxels that are nodes.
    pub(super) const NONE: Self = Self { own: 0.0, growth: 1.0 };

    /// What it leaves of a budget for the nodes.
    pub(super) fn left(self, budget: ErrorBudget) -> ErrorBudget {
        budget.after(self.own).before(self.growth)
    }

    /// The error of voxels whose nodes err by `error`.
    pub(super) fn with(self, error: f64) -> f64 {
        self.own + self.growth * error
    }
}

/// The echo of the middle frequency at the middle of the array, whose phase is taken out.
#[derive(Debug, Clone, Copy)]
struct Carrier {
    legs: TwoLegs,
    /// f_c/c, 1/m.
    per_metre: f64,
}

impl Carrier {
    fn new(instrument: &Instrument) -> Self {
        Self {
            legs: TwoLegs::new(&instrument.geometry, instrument.array.centre()),
            per_metre: instrument.sweep.centre() / instrument.sound_speed,
        }
    }
}

impl Upsampling {
    /// The grids of nodes that may take less than the voxels themselves: as few depths as serve, with the voxels' own
    /// columns and rows, and with as few as serve and fit the microphones. Empty where nodes save nothing, and for a budget
    /// of 0.
    pub(super) fn find(instrument: &Instrument, grid: &Grid, budget: ErrorBudget) -> Vec<Self> {
        static LAST: Memo<(Instrument, Grid, ErrorBudget), Vec<Upsampling>> = Memo::new();
        if !are_possible(instrument, budget) {
            return Vec::new();
        }
        LAST.of((instrument.clone(), *grid, budget), || {
            let [usual, strict] = budget.upsampling_axis_measured();
            let found = Self::within(instrument, grid, budget, usual);
            if found.len() == MOST_GRIDS {
                return found;
            }
            let stricter = Self::within(instrument, grid, budget, strict);
            if stricter.len() > found.len() { stricter } else { found }
        })
    }

    /// With nodes whose error along each axis by itself is `most` at most.
    fn within(instrument: &Instrument, grid: &Grid, budget: ErrorBudget, most: f64) -> Vec<Self> {
        let terms = SampledTerms::new(instrument, grid);
        let lengths = Taps::lengths(budget.upsampling_axis(), MOST_TAPS);
        let bands = terms.bands();
        // Of the nodes whose pitch follows from the coarsest that serves, those that are fewest.
        let around = |axis: usize, origin: f64, pitch: &dyn Fn(f64) -> f64| {
            let voxels = [grid.x, grid.y, grid.z][axis];
            let coarsest = |fill: f64| (0.5 * fill / bands[axis]).min(voxels.last() - voxels.first);
            let nodes = |((taps, fill), closer): (&(Taps, f64), f64)| {
                nodes_around(&voxels, origin, pitch(closer * coarsest(*fill)), taps)
            };
            let mut possible: Vec<_> =
                lengths.iter().flat_map(|taps| CLOSER.map(|closer| nodes((taps, closer)))).collect();
            possible.retain(|nodes| nodes.axis.count <= MOST_PER_VOXEL * voxels.count + MOST_TAPS);
            possible.sort_by_key(|nodes| (nodes.axis.count, nodes.taps()));
            let mut hardest = 0;
            possible.into_iter().find_map(|nodes| {
                let error = terms.error(axis, &nodes, &mut hardest, |[error, _]| error <= most)?;
                Some(Measured { nodes, error })
            })
        };
        let own = [grid.x, grid.y, grid.z].map(Measured::themselves);
        // Nodes stay on the voxels' side of what paths begin and end at.
        let ends =
            [instrument.array.bounds().1.z, instrument.geometry.viewpoint(instrument.array.centre()).z];
        let few = |Measured { nodes, .. }: &Measured| {
            let crosses = ends.iter().any(|end| (*end < grid.z.first) != (*end < nodes.axis.first));
            nodes.axis.count as f64 <= FEWER * grid.z.count as f64 && !crosses
        };
        let along_z = || {
            (grid.z.count > 1).then(|| around(2, grid.z.first, &|coarsest| coarsest)).flatten().filter(few)
        };
        let lattice = instrument.array.lattice();
        let middle = instrument.geometry.moving_middle(DVec3::ZERO);
        let sideways = |axis: usize| {
            let (voxels, microphones) = match axis {
                0 => (grid.x, lattice.map(|l| l.x)),
                _ => (grid.y, lattice.map(|l| l.y)),
            };
            if voxels.count == 1 {
                return None;
            }
            match microphones.filter(|microphones| microphones.count > 1) {
                // The coarsest of their pitch and its whole fractions, from the middle of what moves on.
                Some(Axis { first, pitch, .. }) => {
                    around(axis, first + middle[axis], &|coarsest| pitch / (pitch / coarsest).ceil().max(1.0))
                }
                None => around(axis, voxels.first, &|coarsest| coarsest),
            }
        };
        let (z, (x, y)) = rayon::join(along_z, || rayon::join(|| sideways(0), || sideways(1)));
        let [own_x, own_y, own_z] = own;
        let z = z.unwrap_or(own_z);
        let columns = (x.is_some() || y.is_some())
            .then(|| [x.unwrap_or_else(|| own_x.clone()), y.unwrap_or_else(|| own_y.clone()), z.clone()]);
        let depths = z.nodes.interpolates().then_some([own_x, own_y, z]);
        [depths, columns]
            .into_iter()
            .flatten()
            .filter_map(|axes| Self::of_axes(&terms, axes, budget.upsampling()))
            .collect()
    }

    /// `None` if all axes together err by more than `tolerance`.
    fn of_axes(terms: &SampledTerms<'_>, axes: [Measured; 3], tolerance: f64) -> Option<Self> {
        let own = own_error(axes.each_ref().map(|axis| axis.error));
        let growth = axes.iter().map(|axis| axis.error[1]).product();
        let [along_x, along_y, along_z] = axes.each_ref().map(|axis| axis.nodes.axis);
        let coarse = Grid { x: along_x, y: along_y, z: along_z };
        let carrier = Carrier::new(terms.instrument);
        let error = InterpolationError { own, growth };
        (own <= tolerance).then_some(Self { fine: *terms.grid, coarse, axes, carrier, error })
    }

    /// The same with none of the nodes beyond the voxels: towards both ends of an axis they stand closer together instead.
    /// Fewer, for a method that sums at any place. `None` where that saves nothing.
    pub(super) fn within_voxels(&self, instrument: &Instrument, budget: ErrorBudget) -> Option<Self> {
        let terms = SampledTerms::new(instrument, &self.fine);
        let most = budget.upsampling_axis_within();
        let (lengths, bands) = (Taps::lengths(INSIDE * most, MOST_TAPS), terms.bands());
        let along = |axis: usize| {
            let (weights, even) = ((&lengths[..], bands[axis], DAMPING_WITHIN * most), &self.axes[axis]);
            fewest_within(axis, &terms, weights, even, |[error, _]| error <= most)
        };
        let (z, (x, y)) = rayon::join(|| along(2), || rayon::join(|| along(0), || along(1)));
        let axes = [x, y, z];
        let is_uneven = axes.iter().any(|axis| axis.nodes.uneven().is_some());
        is_uneven.then(|| Self::of_axes(&terms, axes, budget.upsampling())).flatten()
    }

    /// The same with no depths of nodes before or behind the voxels, of these nodes or else of the voxels of `grid`; for a
    /// method that sums at any depth. `None` where that saves nothing.
    pub(super) fn depths_within(
        nodes: Option<&Self>,
        (instrument, grid): (&Instrument, &Grid),
        budget: ErrorBudget,
    ) -> Option<Self> {
        type Job = (Instrument, Grid, ErrorBudget, [(usize, bool); 3]);
        static LAST: Memo<Job, Option<Upsampling>> = Memo::new();
        if !are_possible(instrument, budget) {
            return None;
        }
        let of_axis = |Measured { nodes, .. }: &Measured| (nodes.axis.count, nodes.interpolates());
        let known = nodes.map_or([(0, false); 3], |nodes| nodes.axes.each_ref().map(of_axis));
        LAST.of((instrument.clone(), *grid, budget, known), || {
            Self::find_depths_within(nodes, (instrument, grid), budget)
        })
    }

    fn find_depths_within(
        nodes: Option<&Self>,
        (instrument, grid): (&Instrument, &Grid),
        budget: ErrorBudget,
    ) -> Option<Self> {
        let terms = SampledTerms::new(instrument, grid);
        let ([most, _], within) = (budget.upsampling_axis_measured(), budget.upsampling_axis_within());
        let own = [grid.x, grid.y, grid.z].map(Measured::themselves);
        let [x, y, even] = nodes.map_or(own, |nodes| nodes.axes.clone());
        let lengths = Taps::lengths(INSIDE * within, MOST_TAPS);
        // The more weights amplify the errors of the other axes, the less they may err by.
        let serves = |z: [f64; 2]| z[0] <= most && own_error([x.error, y.error, z]) <= budget.upsampling();
        let weights = (&lengths[..], terms.bands()[2], DAMPING_WITHIN * most);
        let z = fewest_within(2, &terms, weights, &even, serves);
        z.nodes.uneven()?;
        Self::of_axes(&terms, [x, y, z], budget.upsampling())
    }

    /// Where the nodes are.
    pub(super) fn places(&self) -> GridPlaces {
        GridPlaces::uneven(&self.coarse, self.axes.each_ref().map(|axis| axis.nodes.uneven()))
    }

    /// What the sum on the nodes takes, and to make voxels of them.
    pub(super) fn with<'a>(&self, cost: Cost<'a>) -> Cost<'a> {
        let Cost { operations, usual, bytes } = cost;
        let (operations, own) = (operations + self.operations(), self.voxel_bytes());
        let bytes = move |batch: Batch| bytes(batch).saturating_add(own(batch.workers));
        Cost { operations, usual, bytes: Box::new(bytes) }
    }

    /// Operations for all voxels.
    fn operations(&self) -> f64 {
        let [columns, rows, depths] =
            [self.coarse.x, self.coarse.y, self.coarse.z].map(|axis| axis.count as f64);
        let [x, y, z] = self.axes.each_ref().map(|axis| 4.0 * axis.nodes.taps() as f64);
        let wide = self.fine.y.count as f64;
        let plane = self.fine.plane_len() as f64;
        let sideways = depths * (60.0 * columns * rows + y * columns * wide + 4.0 * x * plane);
        sideways + (z + 60.0) * self.fine.voxel_count() as f64
    }
}

/// The fewest nodes along one axis whose error and sum of moduli serve: within the voxels, by one of these lengths for changes
/// of up to `band` cycles per m with weights damped so, or the `even` ones, or the voxels themselves.
fn fewest_within(
    axis: usize,
    terms: &SampledTerms<'_>,
    (lengths, band, damping): (&[(Taps, f64)], f64, f64),
    even: &Measured,
    serves: impl Fn([f64; 2]) -> bool,
) -> Measured {
    let voxels = [terms.grid.x, terms.grid.y, terms.grid.z][axis];
    let fewer = even.nodes.axis.count.min(voxels.count);
    let extent = voxels.last() - voxels.first;
    let spacings = CLOSER_WITHIN.into_iter().flat_map(|closer| DENSE_NODES.map(|dense| (closer, dense)));
    let mut possible = Vec::new();
    for (closer, dense) in spacings {
        for (taps, fill) in lengths {
            let (pitch, waves) = (closer * 0.5 * fill / band, (taps.count(), band));
            // Not even listed where they would be millions.
            if extent / pitch < fewer as f64 {
                possible.extend(IntervalNodes::even_inside(&voxels, pitch, dense, waves, damping));
            }
        }
    }
    possible.retain(|nodes| nodes.len() < fewer);
    possible.sort_by_key(|nodes| (nodes.len(), nodes.taps()));
    let mut hardest = 0;
    let measured = |nodes| {
        let nodes = Nodes::within(nodes);
        Some(Measured { error: terms.error(axis, &nodes, &mut hardest, &serves)?, nodes })
    };
    let found = possible.into_iter().find_map(measured);
    let fewer_are_even = even.nodes.axis.count < voxels.count;
    found.unwrap_or_else(|| if fewer_are_even { even.clone() } else { Measured::themselves(voxels) })
}

/// The largest error of voxels made of exact nodes, along y first, then x, then z.
fn own_error([x, y, z]: [[f64; 2]; 3]) -> f64 {
    z[0] + z[1] * (x[0] + x[1] * y[0])
}

/// Whether there may be nodes: the carrier that is taken out is that of straight paths by way of one loudspeaker, or of pairs
/// that are alike.
fn are_possible(instrument: &Instrument, budget: ErrorBudget) -> bool {
    let several = instrument.transmissions() > 1 || instrument.has_differing_pairs();
    budget.upsampling_axis() > 0.0 && !several && instrument.interface.is_none()
}

/// The most depths of nodes that a grid can have, and the most bytes of one.
pub(crate) fn most_nodes(grid: &Grid) -> [u64; 2] {
    let along = |axis: &Axis| (MOST_PER_VOXEL * axis.count + MOST_TAPS) as u64;
    [along(&grid.z), complex_bytes(along(&grid.x) as f64 * along(&grid.y) as f64)]
}

/// Nodes around all voxels of an axis, whole pitches from `origin`.
fn nodes_around(voxels: &Axis, origin: f64, pitch: f64, taps: &Taps) -> Nodes {
    let own = |position: f64| ((position - origin) / pitch + 1e-9).floor();
    let (low, high) = (own(voxels.first), own(voxels.last()));
    let first = origin + pitch * (low + taps.first() as f64);
    // Of a pitch that is hardly a number there are more than can be counted.
    let count = ((high - low) as usize).saturating_add(taps.count());
    Nodes::with_taps(Axis { first, pitch, count }, taps.clone())
}

#[cfg(test)]
mod ends_tests;
#[cfg(test)]
mod tests;
