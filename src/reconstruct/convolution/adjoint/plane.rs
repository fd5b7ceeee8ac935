//! One thread's work on one depth: the voxels' spectrum, and its products with those of the kernels.

use crate::reconstruct::convolution::layout::Layout;
use crate::reconstruct::convolution::plane::{Plane, padded};
use crate::reconstruct::convolution::pointwise::{focus, multiply};
use crate::wave::simd::{LANES, Lanes, lane_phasors, transpose};
use num_complex::Complex32;

impl Plane<'_> {
    /// Adds the products of kernels and voxels `[y, x]` of one sublattice of depth `iz` to spectra of tones,
    /// `[tone, transmission, placement, block, side, k_y]`.
    pub(in crate::reconstruct::convolution) fn correlate(
        &mut self,
        iz: usize,
        part: usize,
        per_metre: &[f64],
        voxels: &[Complex32],
        spectra: &mut [Lanes],
    ) {
        self.place(iz, part);
        let layout = self.layout;
        self.hold_conjugates(part, voxels);
        let scan = layout.scans();
        if scan {
            // No outer phase: all tones have the voxels' spectrum in common.
            self.transform_voxels(None, part);
        }
        for (k, spectra) in per_metre.iter().zip(spectra.chunks_exact_mut(layout.tone_len() / LANES)) {
            if layout.transmissions() > 1 {
                for node_part in 0..layout.node_parts.len() {
                    self.kernel(*k, node_part);
                }
                self.keep_kernels();
            }
            let of_transmission = spectra.chunks_exact_mut(layout.transmission_len() / LANES);
            for (transmission, spectra) in of_transmission.enumerate() {
                if !scan {
                    self.transform_voxels(Some((*k, transmission)), part);
                }
                for node_part in 0..layout.node_parts.len() {
                    if self.kernels.is_empty() {
                        self.kernel(*k, node_part);
                    }
                    self.add_products(node_part, spectra);
                }
            }
        }
    }

    /// Holds the conjugate voxels of a sublattice in lanes of y.
    fn hold_conjugates(&mut self, part: usize, voxels: &[Complex32]) {
        let layout: &Layout = self.layout;
        let [x, y] = layout.voxel_parts[part];
        let width = padded(x.count);
        self.image.clear();
        self.image.resize(width * y.count.div_ceil(LANES), Lanes::ZERO);
        for iy in 0..y.count {
            let row = &voxels[(y.start + iy * y.stride) * layout.grid().x.count..][..layout.grid().x.count];
            let (block, lane) = (&mut self.image[iy / LANES * width..][..x.count], iy % LANES);
            for (voxel, to) in row[x.start..].iter().step_by(x.stride).zip(block) {
                (to.re[lane], to.im[lane]) = (voxel.re, -voxel.im);
            }
        }
    }

    /// The spectrum of the voxels, with the outer phase of a tone and transmission, `[block, side, k_y]` in lanes of k_x; transformed back
    /// rather than forth, with real and imaginary parts exchanged.
    fn transform_voxels(&mut self, tone: Option<(f64, usize)>, part: usize) {
        let layout: &Layout = self.layout;
        let ([x, y], sides) = (layout.voxel_parts[part], layout.sides());
        let (n_x, n_y, width) = (layout.x.len(), layout.y.len(), padded(x.count));
        self.columns.fill(Lanes::ZERO);
        for (rows, image) in self.image.chunks_exact(width).enumerate() {
            let (row, outer) = (&mut self.row[..n_x], &mut self.transformed[..width]);
            match tone {
                Some((k, transmission)) => {
                    let first = transmission * self.image.len() + rows * width;
                    lane_phasors(&[k; LANES], &self.outward[first..][..width], outer);
                }
                None => outer.fill(Lanes { re: [1.0; LANES], im: [0.0; LANES] }),
            }
            multiply(image, outer, &mut row[..width], false);
            // What pads the image is zero, but beyond its rows lanes may hold anything.
            row[x.count..].fill(Lanes::ZERO);
            let transformed = &mut self.transformed[..n_x];
            layout.x.fft.transform(row, transformed, &mut self.work[..n_x]);
            let lanes = LANES.min(y.count - rows * LANES);
            for (column, to) in self.field.chunks_exact_mut(n_y).enumerate() {
                let (block, side) = (column / sides, column % sides);
                let mut tile = [Lanes::ZERO; LANES];
                for (k, row) in tile.iter_mut().enumerate() {
                    *row = transformed[layout.column(side, block * LANES + k)];
                }
                let mut rows_of_tile = [Lanes::ZERO; LANES];
                transpose(&tile, &mut rows_of_tile);
                to[rows * LANES..][..lanes].copy_from_slice(&rows_of_tile[..lanes]);
            }
        }
        for column in self.field.chunks_exact_mut(n_y) {
            column[y.count..].fill(Lanes::ZERO);
            let transformed = &mut self.transformed[..n_y];
            layout.y.fft.transform(column, transformed, &mut self.work[..n_y]);
            column.copy_from_slice(transformed);
        }
    }

    /// Adds the products of one node sublattice's kernels to its spectra.
    fn add_products(&mut self, part: usize, spectra: &mut [Lanes]) {
        let layout: &Layout = self.layout;
        let (n_y, sides) = (layout.y.len(), layout.sides());
        let spectra = &mut spectra[layout.spectrum(part, &self.offsets[part])..];
        let columns = &self.columns[part * layout.blocks() * n_y..][..layout.blocks() * n_y];
        for (block, column) in columns.chunks_exact(n_y).enumerate() {
            let kept = (part * layout.blocks() + block) * n_y;
            let kernel = if let Some(kept) = self.kernels.get(kept..kept + n_y) {
                kept
            } else {
                let kernel = &mut self.transformed[..n_y];
                layout.y.fft.transform(column, kernel, &mut self.work[..n_y]);
                kernel
            };
            let sides = block * sides * n_y..(block + 1) * sides * n_y;
            let of_sides = spectra[sides.clone()].chunks_exact_mut(n_y);
            for (sum, field) in of_sides.zip(self.field[sides].chunks_exact(n_y)) {
                focus(field, kernel, sum);
            }
        }
    }
}
