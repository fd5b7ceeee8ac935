//! What stays the same for all planes of a volume: sublattices, transforms, and where the data's spectra have their parts.

use super::kernel_path::KernelPath;
use super::lattice::{SharedLattice, Sublattices};
use super::padded_axis::{CircularShift, Offset, PaddedAxis};
use crate::acquisition::Instrument;
use crate::grid::Grid;
use crate::reconstruct::numerics::GridPlaces;
use crate::wave::simd::LANES;
use crate::wave::{Geometry, LegTable, Refraction};
use glam::DVec3;
use std::collections::HashSet;

/// What stays the same for all planes of a volume.
///
/// Spectra are kept by columns, in blocks of sixteen neighbouring k_x. A kernel that is even in x has the same column at
/// k_x and −k_x, so each block of kernels serves two *sides* of the data's spectra: a block of columns, and their
/// mirror images. The column k_x = n_x/2, which has no partner, is left out: see [`crate::reconstruct::convolution::plane`].
#[derive(Debug)]
pub(crate) struct Layout {
    pub(crate) lattice: SharedLattice,
    /// Where the voxels are: evenly spaced along x and y, but not necessarily along z.
    pub(crate) places: GridPlaces,
    pub(crate) geometry: Geometry,
    /// Where the loudspeakers of all transmissions are that share the kernels; none for a scan.
    pub(crate) sources: Vec<DVec3>,
    /// What kernels are the phase of.
    pub(crate) path: KernelPath,
    /// What paths do at an interface, if there is one.
    pub(crate) refraction: Option<Refraction>,
    pub(crate) x: PaddedAxis,
    pub(crate) y: PaddedAxis,
    pub(crate) node_parts: Vec<Sublattices>,
    pub(crate) voxel_parts: Vec<Sublattices>,
    /// The axis along which all nodes and voxels lie, if they lie on one line: then sixteen tones share the lanes.
    pub(crate) line: Option<usize>,
    /// `[voxel part][node part]`, along x and y.
    pub(crate) offsets: Vec<Vec<[Offset; 2]>>,
    /// What differs among the spectra of one tone: part of the nodes, and its circular shifts along x and y.
    pub(crate) placements: Vec<(usize, [CircularShift; 2])>,
}

impl Layout {
    pub(crate) fn new(lattice: SharedLattice, places: GridPlaces, instrument: &Instrument) -> Self {
        let grid = *places.grid();
        let (node_parts, voxel_parts) = (lattice.node_parts(), lattice.voxel_parts(&grid));
        let ([nodes_x, nodes_y], [pitch_x, pitch_y]) = (lattice.nodes(), lattice.common_pitch());
        let first = |axis: &crate::grid::Axis, index: usize| axis.position(index);
        let path = KernelPath::new(&instrument.geometry);
        let origin = path.origin();
        let offset = |voxels: &Sublattices, nodes: &Sublattices| {
            let x = first(&grid.x, voxels[0].start) - (first(&nodes_x, nodes[0].start) + origin.x);
            let y = first(&grid.y, voxels[1].start) - (first(&nodes_y, nodes[1].start) + origin.y);
            [Offset::new(x, pitch_x, voxels[0], nodes[0]), Offset::new(y, pitch_y, voxels[1], nodes[1])]
        };
        let mut offsets: Vec<Vec<[Offset; 2]>> =
            voxel_parts.iter().map(|v| node_parts.iter().map(|n| offset(v, n)).collect()).collect();
        let single = |axis: usize| node_parts.iter().chain(&voxel_parts).all(|part| part[axis].count == 1);
        let line = if single(1) { Some(0) } else { single(0).then_some(1) };
        let mut padded = |axis: usize| match line {
            Some(_) => PaddedAxis::around_line(offsets.iter().flatten().map(|o| &o[axis])),
            None => PaddedAxis::around(
                &mut offsets.iter_mut().flatten().map(|o| &mut o[axis]).collect::<Vec<_>>(),
                path.is_even(axis),
            ),
        };
        let (x, y) = (padded(0), padded(1));
        let (mut placements, mut known) = (Vec::new(), HashSet::new());
        for of_voxels in &offsets {
            for (part, offset) in of_voxels.iter().enumerate() {
                let placement = (part, offset.map(|o| o.shift));
                if known.insert(placement) {
                    placements.push(placement);
                }
            }
        }
        Self {
            lattice,
            places,
            geometry: instrument.geometry,
            sources: instrument.sources(),
            path,
            refraction: instrument.refraction(),
            x,
            y,
            node_parts,
            voxel_parts,
            line,
            offsets,
            placements,
        }
    }

    /// Whether all of a path moves with the microphone, so that no outer phase remains.
    pub(crate) fn scans(&self) -> bool {
        self.sources.is_empty()
    }

    /// How many voxels there are, and how far apart they are along x and y.
    pub(crate) fn grid(&self) -> &Grid {
        self.places.grid()
    }

    /// Points of one padded plane.
    pub(crate) fn points(&self) -> usize {
        self.x.len() * self.y.len()
    }

    /// Transmissions that share the kernels.
    pub(crate) fn transmissions(&self) -> usize {
        self.sources.len().max(1)
    }

    /// Complex numbers in the spectra of one tone of one transmission.
    pub(crate) fn transmission_len(&self) -> usize {
        self.points() * self.placements.len()
    }

    /// Complex numbers in one tone's spectra, of all transmissions.
    pub(crate) fn tone_len(&self) -> usize {
        self.transmission_len() * self.transmissions()
    }

    /// Work per tone and depth, in kernel transforms.
    pub(crate) fn pairs(&self) -> usize {
        self.node_parts.len() * self.voxel_parts.len()
    }

    /// Lengths of legs from depth `from` to `z`, for lateral distances up to the `farthest`; `None` without an interface,
    /// where they are straight.
    pub(crate) fn refracted(&self, from: f64, z: f64, farthest: impl FnOnce() -> f64) -> Option<LegTable> {
        self.refraction.as_ref().map(|refraction| refraction.table(from, z, farthest()))
    }

    /// The padded axis along x (0) or y (1).
    pub(crate) fn along(&self, axis: usize) -> &PaddedAxis {
        if axis == 0 { &self.x } else { &self.y }
    }

    /// 2 where the kernels are even in x, else 1.
    pub(crate) fn sides(&self) -> usize {
        if self.x.even { 2 } else { 1 }
    }

    /// Blocks of sixteen columns of kernels.
    pub(crate) fn blocks(&self) -> usize {
        self.x.lags() / LANES
    }

    /// The index k_x of a column; the mirror image of the first one is the one that is left out.
    pub(crate) fn column(&self, side: usize, k: usize) -> usize {
        match (side, k) {
            (0, k) => k,
            (_, 0) => self.x.len() / 2,
            (_, k) => self.x.len() - k,
        }
    }

    /// Where in a tone's spectra of a transmission, `[placement, block, side, k_y]`, those for a pair of sublattices begin.
    pub(crate) fn spectrum(&self, part: usize, offset: &[Offset; 2]) -> usize {
        let placement = (part, offset.map(|o| o.shift));
        let index = self.placements.iter().position(|p| *p == placement).expect("every pair was entered");
        index * self.x.len() * self.y.len() / LANES
    }
}
