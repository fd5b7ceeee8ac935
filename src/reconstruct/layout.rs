//! What stays the same for all planes of a volume: sub-lattices, transforms, and the data's spectra.

use super::fft2::Fft2;
use super::lattice::{Parts, SharedLattice};
use crate::grid::Grid;
use crate::wave::Geometry;
use num_complex::Complex32;
use rayon::prelude::*;

/// What stays the same for all planes of a volume.
#[derive(Debug)]
pub(super) struct Layout<'a> {
    pub(super) lattice: &'a SharedLattice,
    pub(super) grid: Grid,
    pub(super) geometry: Geometry,
    pub(super) fft: Fft2,
    pub(super) node_parts: Vec<Parts>,
    pub(super) voxel_parts: Vec<Parts>,
}

impl<'a> Layout<'a> {
    pub(super) fn new(lattice: &'a SharedLattice, grid: Grid, geometry: Geometry) -> Self {
        let (node_parts, voxel_parts) = (lattice.node_parts(), lattice.voxel_parts(&grid));
        let most = |parts: &[Parts], axis: usize| parts.iter().map(|p| p[axis].count).max().unwrap_or(1);
        let size = |axis: usize| most(&node_parts, axis) + most(&voxel_parts, axis) - 1;
        let fft = Fft2::at_least(size(0), size(1));
        Self { lattice, grid, geometry, fft, node_parts, voxel_parts }
    }

    /// Elements of one tone's spectra.
    pub(super) fn tone_len(&self) -> usize {
        self.fft.len() * self.node_parts.len()
    }

    /// Work per tone and depth, in kernel transforms.
    pub(super) fn pairs(&self) -> usize {
        self.node_parts.len() * self.voxel_parts.len()
    }

    /// Spectra of the nodes' samples, `[tone, part, k_x, k_y]`; the inverse transform's scale is folded in.
    pub(super) fn spectra(&self, nodes: &[Complex32]) -> Vec<Complex32> {
        let scale = 1.0 / self.fft.len() as f32;
        let [n_x, _] = self.lattice.nodes().map(|axis| axis.count);
        let tones = nodes.len() / self.lattice.width();
        let mut spectra = vec![Complex32::ZERO; tones * self.tone_len()];
        spectra.par_chunks_exact_mut(self.fft.len()).enumerate().for_each_init(
            || (self.fft.scratch(), Vec::new()),
            |(scratch, padded), (index, spectrum)| {
                let (tone, part) = (index / self.node_parts.len(), index % self.node_parts.len());
                let nodes = &nodes[tone * self.lattice.width()..][..self.lattice.width()];
                let [x, y] = self.node_parts[part];
                padded.clear();
                padded.resize(y.count * self.fft.n_x(), Complex32::ZERO);
                for (row, padded) in padded.chunks_exact_mut(self.fft.n_x()).enumerate() {
                    let from = &nodes[(y.start + row * y.stride) * n_x..][..n_x];
                    for (to, from) in padded.iter_mut().zip(from[x.start..].iter().step_by(x.stride)) {
                        *to = from * scale;
                    }
                }
                self.fft.forward(padded, spectrum, scratch);
            },
        );
        spectra
    }
}
