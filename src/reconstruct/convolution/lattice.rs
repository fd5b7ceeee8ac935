//! How voxels and microphones share a lattice, so that the sum over microphones is a convolution.
//!
//! Along each axis the microphones are on nodes, and the voxel pitch is the node pitch divided by u or times v, both
//! whole. Then voxels split into u and nodes into v interleaved sublattices of one common pitch, and `p − r` depends on
//! the difference of indices alone between any two of them. Microphones that fit no such lattice are spread onto one.

use super::kernel_path::KernelPath;
use crate::acquisition::{Instrument, MicArray};
use crate::grid::{Axis, Grid};
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::{FILLS, Footprints, GridPlaces, Interpolator, Kernels, nodes_around};
use crate::reconstruct::plan::cost::PRODUCT;
use crate::reconstruct::silence;
use num_complex::Complex32;
use rayon::prelude::*;
use std::f64::consts::PI;
use std::ops::Range;

/// The most nodes that microphones are spread onto: some gigabytes of tones.
const MOST_NODES: usize = 1 << 22;

/// The most pairs of sublattices that a job may be divided into: each takes a transform of its own for every tone and depth.
const MOST_PAIRS: usize = 1 << 16;

/// One axis of a shared lattice.
#[derive(Debug, Clone)]
struct SharedAxis {
    nodes: Axis,
    /// Voxels per node pitch; 1 when `v` is not.
    u: usize,
    /// Nodes per voxel pitch; 1 when `u` is not.
    v: usize,
    /// How microphones are spread onto the nodes; `None` where they are on them.
    interpolator: Option<Interpolator>,
}

/// A shared lattice of voxels and nodes.
#[derive(Debug, Clone)]
pub(crate) struct SharedLattice {
    x: SharedAxis,
    y: SharedAxis,
    /// Height of the microphones' plane, m.
    pub(crate) z: f64,
    /// Whether the microphones are the nodes, in order.
    in_order: bool,
    /// Depths too near to the microphones for spreading, which have to be summed without nodes.
    pub(crate) near: Range<usize>,
}

/// Depths nearer than this many of the shortest waves may go without nodes. A kernel bends too sharply there for any but
/// very fine ones: from half a wave on they serve to any tolerance, from one and a half on they are hardly finer than
/// anywhere, and within a tenth none serve.
const NEAR: [f64; 4] = [0.1, 0.5, 1.0, 1.5];

/// One sublattice along one axis: its first index and how many there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Sublattice {
    pub(crate) start: usize,
    pub(crate) count: usize,
    pub(crate) stride: usize,
}

/// Sublattices along x and y together.
pub(crate) type Sublattices = [Sublattice; 2];

impl SharedLattice {
    /// The lattice, or those there are to choose among: the fewer depths have to be near, the finer the nodes. Spreads to
    /// within its share of the budget where the microphones fit none; a budget of 0 allows no spreading.
    ///
    /// # Errors
    /// A text: why there is none, and how to fix that.
    pub(crate) fn find(
        instrument: &Instrument,
        voxels: &GridPlaces,
        budget: ErrorBudget,
    ) -> Result<Vec<Self>, String> {
        if instrument.has_differing_pairs() {
            return Err("pairs that are not all the same way apart have no kernel in common".to_owned());
        }
        let mut near = NEAR.map(|waves| within(waves * shortest(instrument), instrument, voxels)).to_vec();
        near.dedup();
        let mut found = Vec::new();
        let mut misfit = String::new();
        for near in near {
            match Self::with(instrument, voxels, budget.spreading(), near) {
                // Where microphones are on nodes, no depth is too near.
                Ok(lattice) if lattice.exact() => {
                    let filled = (budget.all() > 0.0).then(|| lattice.filled()).flatten();
                    return Ok([Some(lattice), filled].into_iter().flatten().collect());
                }
                Ok(lattice) => found.push(lattice),
                Err(reason) => misfit = reason,
            }
        }
        if found.is_empty() { Err(misfit) } else { Ok(found) }
    }

    /// The lattice that serves all depths but those `near`, each axis to within `tolerance`.
    fn with(
        instrument: &Instrument,
        places: &GridPlaces,
        tolerance: f64,
        near: Range<usize>,
    ) -> Result<Self, String> {
        let (grid, (low, high)) = (places.grid(), instrument.array.bounds());
        let shortest = shortest(instrument);
        if high.z - low.z > 1e-6 * shortest {
            return Err(format!("the microphones are in no plane of constant z ({} to {} m)", low.z, high.z));
        }
        let (plane, refraction) = (low.z, instrument.refraction());
        let path = KernelPath::new(&instrument.geometry);
        let axis = |axis: usize, voxels: &Axis, mics: Option<&Axis>| {
            let (name, low, high) = (["x", "y"][axis], low[axis], high[axis]);
            let misfit = match exact(name, voxels, mics, [low, high], shortest) {
                Ok(axis) => return Ok(axis),
                Err(misfit) => misfit,
            };
            if tolerance <= 0.0 {
                return Err(misfit);
            }
            let far = (0..grid.z.count).filter(|iz| !near.contains(iz));
            let (apart, middle) = (path.apart(axis), path.origin()[axis]);
            let aside = (voxels.last() - middle - low).abs().max((high + middle - voxels.first).abs());
            let bent = refraction.as_ref().map(|refraction| (refraction, aside + 0.5 * apart));
            let heights = far.map(|iz| path.height(plane, places.at(2, iz), bent));
            let height = heights.fold(f64::INFINITY, f64::min);
            if height == f64::INFINITY {
                return Err(format!("{misfit}, and all voxels are too near to the array for spreading"));
            }
            let kernels = Kernels { wavenumber: 2.0 * PI / shortest, height, aside, apart };
            spread_axis((voxels, voxels.first - middle), [low, high], &kernels, tolerance).ok_or_else(|| {
                format!("{misfit}, and voxels {height} m from the array are too near for spreading")
            })
        };
        let lattice = instrument.array.lattice();
        let x = axis(0, &grid.x, lattice.map(|l| &l.x))?;
        let y = axis(1, &grid.y, lattice.map(|l| &l.y))?;
        let nodes = x.nodes.count.saturating_mul(y.nodes.count);
        if nodes > MOST_NODES.max(instrument.array.len()) {
            return Err(format!(
                "{} microphones over {:.1} x {:.1} m are too few for a lattice of {nodes} nodes",
                instrument.array.len(),
                high.x - low.x,
                high.y - low.y
            ));
        }
        let pairs = [(&x, grid.x.count), (&y, grid.y.count)]
            .map(|(axis, voxels)| axis.u.min(voxels).saturating_mul(axis.v.min(axis.nodes.count)));
        let pairs = pairs[0].saturating_mul(pairs[1]);
        if pairs > MOST_PAIRS {
            return Err(format!(
                "the pitches of voxels and microphones differ so much that a lattice of both would be {pairs} pairs of \
                 sublattices; use pitches that are more alike"
            ));
        }
        let mut found = Self { x, y, z: f64::midpoint(low.z, high.z), in_order: false, near };
        if found.exact() {
            found.in_order = instrument.array.lattice().is_some() && found.width() == instrument.array.len();
            found.near = 0..0;
        }
        Ok(found)
    }

    /// The same with silent nodes between the microphones, as close as the voxels: one sublattice of voxels instead of many,
    /// with one large kernel, which is more often even. `None` where nodes are as close already, or would be too many.
    fn filled(&self) -> Option<Self> {
        let along = |axis: &SharedAxis| {
            let Axis { first, pitch, count } = axis.nodes;
            let nodes = Axis { first, pitch: pitch / axis.u as f64, count: (count - 1) * axis.u + 1 };
            SharedAxis { nodes, u: 1, ..axis.clone() }
        };
        let filled = Self { x: along(&self.x), y: along(&self.y), in_order: false, ..self.clone() };
        let differs = self.x.u.max(self.y.u) > 1;
        (differs && filled.width() <= MOST_NODES).then_some(filled)
    }

    /// Whether all microphones are on nodes.
    fn exact(&self) -> bool {
        self.x.interpolator.is_none() && self.y.interpolator.is_none()
    }

    /// The largest error of spreading, relative to one; 0 where the microphones are on nodes.
    pub(crate) fn error(&self) -> f64 {
        let of = |axis: &SharedAxis| axis.interpolator.as_ref().map_or(0.0, |i| i.error);
        (1.0 + of(&self.x)) * (1.0 + of(&self.y)) - 1.0
    }

    /// Whether samples have to be spread onto the nodes, which takes memory for both at a time.
    pub(crate) fn spreads(&self) -> bool {
        !self.in_order
    }

    /// How many nodes a microphone is spread onto along x and y.
    fn taps(&self) -> [usize; 2] {
        [&self.x, &self.y].map(|axis| axis.interpolator.as_ref().map_or(1, Interpolator::taps))
    }

    /// Operations of spreading one tone of an array.
    pub(crate) fn spreading_operations(&self, array: &MicArray) -> f64 {
        let [x, y] = self.taps();
        match array.lattice() {
            _ if self.in_order => 0.0,
            Some(lattice) => PRODUCT * (x * array.len() + y * lattice.y.count * self.x.nodes.count) as f64,
            None => PRODUCT * (x * y * array.len()) as f64,
        }
    }

    /// Bytes of [`SharedLattice::spreading`] for an array.
    pub(crate) fn footprint_bytes(&self, array: &MicArray) -> u64 {
        let places = array.lattice().map_or([array.len(); 2], |lattice| [lattice.x.count, lattice.y.count]);
        if self.in_order { 0 } else { Footprints::bytes(self.taps(), places) }
    }

    /// Nodes along x and y.
    pub(crate) fn nodes(&self) -> [Axis; 2] {
        [self.x.nodes, self.y.nodes]
    }

    /// Number of nodes.
    pub(crate) fn width(&self) -> usize {
        self.x.nodes.count * self.y.nodes.count
    }

    /// The interleaved sublattices of the nodes.
    pub(crate) fn node_parts(&self) -> Vec<Sublattices> {
        product(&parts(self.x.v, self.x.nodes.count), &parts(self.y.v, self.y.nodes.count))
    }

    /// The interleaved sublattices of the voxels.
    pub(crate) fn voxel_parts(&self, grid: &Grid) -> Vec<Sublattices> {
        product(&parts(self.x.u, grid.x.count), &parts(self.y.u, grid.y.count))
    }

    /// Pitch of every sublattice along x and y, m.
    pub(crate) fn common_pitch(&self) -> [f64; 2] {
        [&self.x, &self.y].map(|axis| axis.nodes.pitch * axis.v as f64)
    }

    /// How every microphone is spread onto the nodes.
    pub(crate) fn spreading(&self, array: &MicArray) -> Spreading<'_> {
        if self.in_order {
            return Spreading { lattice: self, footprints: None };
        }
        let along = |axis: usize, positions: &[f64]| {
            let axis = [&self.x, &self.y][axis];
            if let Some(interpolator) = &axis.interpolator {
                return interpolator.onto(&axis.nodes, positions);
            }
            let index = |r: &f64| ((r - axis.nodes.first) / axis.nodes.pitch).round() as usize;
            positions.iter().map(|r| (index(r), vec![1.0])).collect()
        };
        // Those of a lattice are in rows.
        let columns = array.lattice().map(|lattice| lattice.x.count);
        let (first, each) = (columns.unwrap_or(array.len()), columns.unwrap_or(1));
        let x: Vec<f64> = array.positions()[..first].iter().map(|r| r.x).collect();
        let y: Vec<f64> = array.positions().iter().step_by(each).map(|r| r.y).collect();
        let footprints = Footprints::new([&x, &y], columns.is_some(), self.x.nodes.count, along);
        Spreading { lattice: self, footprints: Some(footprints) }
    }
}

/// How samples of microphones are spread onto the nodes of a lattice.
#[derive(Debug)]
pub(crate) struct Spreading<'a> {
    lattice: &'a SharedLattice,
    /// `None` when the microphones are the nodes, in order.
    footprints: Option<Footprints>,
}

impl Spreading<'_> {
    /// Samples of microphones, in rows of `n_mic`, as samples of nodes, in rows of [`SharedLattice::width`].
    ///
    /// # Errors
    /// They do not fit in memory.
    pub(crate) fn onto_nodes(&self, samples: Vec<Complex32>) -> crate::error::Result<Vec<Complex32>> {
        let Some(footprints) = &self.footprints else { return Ok(samples) };
        let (n_mic, width) = (footprints.microphones(), self.lattice.width());
        let mut nodes = silence(samples.len() / n_mic, width)?;
        nodes.par_chunks_exact_mut(width).zip(samples.par_chunks_exact(n_mic)).for_each_init(
            Vec::new,
            |row, (plane, samples)| {
                // Zeros by writing, on its own thread: pages that are read before they are written are mapped twice.
                plane.fill(Complex32::ZERO);
                footprints.spread(samples, row, plane);
            },
        );
        Ok(nodes)
    }

    /// The adjoint: samples of nodes, in rows of [`SharedLattice::width`], as samples of microphones, in rows of `n_mic`.
    ///
    /// # Errors
    /// They do not fit in memory.
    pub(crate) fn onto_microphones(&self, nodes: Vec<Complex32>) -> crate::error::Result<Vec<Complex32>> {
        let Some(footprints) = &self.footprints else { return Ok(nodes) };
        let (n_mic, width) = (footprints.microphones(), self.lattice.width());
        let mut samples = silence(nodes.len() / width, n_mic)?;
        samples
            .par_chunks_exact_mut(n_mic)
            .zip(nodes.par_chunks_exact(width))
            .for_each_init(Vec::new, |row, (samples, plane)| footprints.gather(plane, row, samples));
        Ok(samples)
    }
}

/// The shortest wave, as short again where both legs move, m.
fn shortest(instrument: &Instrument) -> f64 {
    instrument.sound_speed / instrument.sweep.stop() / instrument.geometry.scanned_legs()
}

/// Depths nearer to the microphones' plane than `distance` m.
fn within(distance: f64, instrument: &Instrument, places: &GridPlaces) -> Range<usize> {
    let (plane, path) = (instrument.array.bounds().0.z, KernelPath::new(&instrument.geometry));
    let near = |iz: &usize| path.height(plane, places.at(2, *iz), None) < distance;
    let depths = places.grid().z.count;
    let first = (0..depths).find(near).unwrap_or(0);
    first..first + (first..depths).take_while(near).count()
}

/// `count` indices distributed in turn over `ways` sublattices.
fn parts(ways: usize, count: usize) -> Vec<Sublattice> {
    (0..ways.min(count))
        .map(|start| Sublattice { start, count: (count - start).div_ceil(ways), stride: ways })
        .collect()
}

fn product(x: &[Sublattice], y: &[Sublattice]) -> Vec<Sublattices> {
    y.iter().flat_map(|y| x.iter().map(move |x| [*x, *y])).collect()
}

/// The microphones' own lattice as nodes, if the voxels' pitch is compatible with it.
fn exact(
    name: &str,
    voxels: &Axis,
    mics: Option<&Axis>,
    [low, high]: [f64; 2],
    shortest: f64,
) -> Result<SharedAxis, String> {
    let shared = |nodes: Axis, u: usize, v: usize| SharedAxis { nodes, u, v, interpolator: None };
    // A single place or a single voxel has no pitch that could fail to fit.
    if high - low <= 1e-9 * shortest.min(1.0) {
        return Ok(shared(Axis { first: low, pitch: voxels.pitch, count: 1 }, 1, 1));
    }
    let mics = mics.ok_or("the microphones are on no regular lattice")?;
    if voxels.count == 1 {
        return Ok(shared(*mics, 1, 1));
    }
    // The mismatch adds up over the aperture; a millionth of a wavelength does no harm.
    let fits = |a: f64, b: f64| (a - b).abs() * mics.count.max(voxels.count) as f64 <= 1e-6 * shortest;
    let u = (mics.pitch / voxels.pitch).round().max(1.0);
    if fits(mics.pitch, u * voxels.pitch) {
        return Ok(shared(*mics, u as usize, 1));
    }
    let v = (voxels.pitch / mics.pitch).round().max(1.0);
    if fits(voxels.pitch, v * mics.pitch) {
        return Ok(shared(*mics, 1, v as usize));
    }
    Err(format!(
        "the voxel pitch along {name}, {} m, is neither a whole multiple nor a whole fraction of the microphones' {} m \
         ({} m would be)",
        voxels.pitch,
        mics.pitch,
        mics.pitch / u
    ))
}

/// Nodes for microphones between `low` and `high`, fine enough for the steepest wave, and whole pitches from `origin`, which may
/// make the kernel even: half of the transforms. `None` when even much finer ones would not keep the tolerance.
fn spread_axis(
    (voxels, origin): (&Axis, f64),
    [low, high]: [f64; 2],
    kernels: &Kernels,
    tolerance: f64,
) -> Option<SharedAxis> {
    FILLS.into_iter().find_map(|fill| {
        let coarsest = kernels.pitch_filled(fill);
        let (u, v, pitch) = if voxels.count == 1 {
            (1, 1, coarsest)
        } else if coarsest >= voxels.pitch {
            let u = (coarsest / voxels.pitch).floor();
            (u as usize, 1, voxels.pitch * u)
        } else {
            let v = (voxels.pitch / coarsest).ceil();
            (1, v as usize, voxels.pitch / v)
        };
        let interpolator = Interpolator::new(kernels, pitch, tolerance);
        (interpolator.error <= tolerance).then(|| {
            let nodes = nodes_around([low, high], origin, pitch, &interpolator);
            SharedAxis { nodes, u, v, interpolator: Some(interpolator) }
        })
    })
}
