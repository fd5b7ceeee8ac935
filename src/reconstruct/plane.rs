//! One thread's work on one depth: kernels, their transforms, products, and the way back onto the voxels.

use super::fft2::Scratch;
use super::lattice::{Part, Parts};
use super::layout::Layout;
use crate::grid::Axis;
use crate::wave::Geometry;
use crate::wave::simd::phasors;
use glam::DVec3;
use num_complex::Complex32;

/// Geometry of one depth and voxel sub-lattice, and buffers that are used again and again.
#[derive(Debug)]
pub(super) struct Plane<'a> {
    layout: &'a Layout<'a>,
    /// `|p − r|` by lag, in FFT order (negative lags wrapped to the end), doubled for a scan, `[part, n_y, n_x]`.
    lengths: Vec<f64>,
    /// `|p − s|` per voxel of the sub-lattice; empty for a monostatic scan.
    outward: Vec<f64>,
    kernel: Vec<Complex32>,
    outer: Vec<Complex32>,
    spectrum: Vec<Complex32>,
    sum: Vec<Complex32>,
    scratch: Scratch,
}

impl<'a> Plane<'a> {
    pub(super) fn new(layout: &'a Layout<'a>) -> Self {
        let zeros = || vec![Complex32::ZERO; layout.fft.len()];
        Self {
            layout,
            lengths: vec![0.0; layout.fft.len() * layout.node_parts.len()],
            outward: Vec::new(),
            kernel: zeros(),
            outer: Vec::new(),
            spectrum: zeros(),
            sum: zeros(),
            scratch: layout.fft.scratch(),
        }
    }

    /// Works out every length of depth `iz` on one sub-lattice; they serve all tones.
    pub(super) fn place(&mut self, iz: usize, voxels: &Parts) {
        let Layout { lattice, grid, fft, .. } = self.layout;
        let (z, [nodes_x, nodes_y], [pitch_x, pitch_y]) =
            (grid.z.position(iz), lattice.nodes(), lattice.common_pitch());
        let height = z - lattice.z;
        let legs = self.layout.geometry.return_legs();
        for (lengths, nodes) in self.lengths.chunks_exact_mut(fft.len()).zip(&self.layout.node_parts) {
            let offset = |axis: &Axis, voxels: Part, all: &Axis, nodes: Part| {
                axis.position(voxels.start) - all.position(nodes.start)
            };
            let (x0, y0) = (
                offset(&grid.x, voxels[0], &nodes_x, nodes[0]),
                offset(&grid.y, voxels[1], &nodes_y, nodes[1]),
            );
            for (iy, row) in lengths.chunks_exact_mut(fft.n_x()).enumerate() {
                let dy = y0 + lag(iy, fft.n_y(), voxels[1].count) * pitch_y;
                let square = dy * dy + height * height;
                for (ix, length) in row.iter_mut().enumerate() {
                    let dx = x0 + lag(ix, fft.n_x(), voxels[0].count) * pitch_x;
                    *length = legs * (dx * dx + square).sqrt();
                }
            }
        }
        self.outward.clear();
        if let Geometry::FixedSource { .. } = self.layout.geometry {
            let place = |axis: &Axis, part: Part, k: usize| axis.position(part.start + k * part.stride);
            for j in 0..voxels[1].count {
                for i in 0..voxels[0].count {
                    let p = DVec3::new(place(&grid.x, voxels[0], i), place(&grid.y, voxels[1], j), z);
                    self.outward.push(self.layout.geometry.outward_length(p));
                }
            }
        }
        self.outer.resize(self.outward.len(), Complex32::ZERO);
    }

    /// Adds tones to the voxels of the sub-lattice that was placed; `spectra` are those of [`Layout::spectra`].
    pub(super) fn accumulate(
        &mut self,
        per_metre: &[f64],
        spectra: &[Complex32],
        voxels: &mut [Complex32],
        part: &Parts,
    ) {
        let layout = self.layout;
        let n = layout.fft.len();
        let scan = self.outward.is_empty();
        if scan {
            self.sum.fill(Complex32::ZERO);
        }
        for (k, data) in per_metre.iter().zip(spectra.chunks_exact(n * layout.node_parts.len())) {
            for (part, (lengths, data)) in self.lengths.chunks_exact(n).zip(data.chunks_exact(n)).enumerate()
            {
                phasors(*k, lengths, &mut self.kernel);
                layout.fft.forward(&mut self.kernel, &mut self.spectrum, &mut self.scratch);
                let products = self.spectrum.iter().zip(data).map(|(a, b)| a * b);
                if part == 0 && !scan {
                    self.sum.iter_mut().zip(products).for_each(|(sum, product)| *sum = product);
                } else {
                    self.sum.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
                }
            }
            if scan {
                // No outer phase remains, so tones add up before the one inverse FFT.
                continue;
            }
            phasors(*k, &self.outward, &mut self.outer);
            let focused = layout.fft.inverse(&mut self.sum, part[1].count, &mut self.scratch);
            let outer = self.outer.chunks_exact(part[0].count);
            for ((focused, outer), row) in focused.chunks_exact(layout.fft.n_x()).zip(outer).zip(0..) {
                let to = voxel_row(voxels, layout.grid.x.count, part, row);
                for ((voxel, a), phase) in to.zip(focused).zip(outer) {
                    *voxel += a * phase;
                }
            }
        }
        if scan {
            let focused = layout.fft.inverse(&mut self.sum, part[1].count, &mut self.scratch);
            for (focused, row) in focused.chunks_exact(layout.fft.n_x()).zip(0..) {
                for (voxel, a) in voxel_row(voxels, layout.grid.x.count, part, row).zip(focused) {
                    *voxel += a;
                }
            }
        }
    }
}

/// The voxels of one row of a sub-lattice, in order.
fn voxel_row<'v>(
    voxels: &'v mut [Complex32],
    n_x: usize,
    [x, y]: &Parts,
    row: usize,
) -> impl Iterator<Item = &'v mut Complex32> + use<'v> {
    let start = (y.start + row * y.stride) * n_x;
    voxels[start..start + n_x][x.start..].iter_mut().step_by(x.stride)
}

/// The lag at place `i` of `n`: positive up to the last voxel, then the wrapped negative ones; what padding leaves
/// between them is never read.
fn lag(i: usize, n: usize, voxels: usize) -> f64 {
    if i < voxels { i as f64 } else { i as f64 - n as f64 }
}
