//! One thread's work on one depth: kernels, their transforms, products, and the inverse transforms onto the voxels.
//!
//! For each tone and pair of sublattices: phases of the kernel for sixteen rows at a time, transformed along x and
//! transposed into blocks of sixteen columns; each block transformed along y, multiplied with the data's spectra and
//! transformed back at once, so that no kernel's spectrum is ever stored; then back along x, and onto the voxels with
//! the outer phase.
//!
//! Where the kernel is even in y, half of its rows are computed and entered twice; where it is even in x, half of
//! each row is computed, and each column serves k_x and −k_x. The lag n_x/2 is read by no voxel, so its kernel
//! is chosen such that the column k_x = n_x/2, which has no partner, is zero.

#![allow(clippy::inline_always, clippy::needless_range_loop)]

use super::kernel_path::LegAtDepth;
use super::lattice::{Sublattice, Sublattices};
use super::layout::Layout;
use super::padded_axis::{Offset, PaddedAxis};
use super::pointwise::{focus, multiply};
use crate::alloc::{try_filled, try_with_capacity};
use crate::grid::Axis;
use crate::wave::simd::{LANES, Lanes, ROWS, dispatched, lane_phasors, transpose};
use glam::{DVec2, DVec3};
use num_complex::Complex32;

/// Geometry of one depth and voxel sublattice, and reused buffers.
#[derive(Debug)]
pub(crate) struct Plane<'a> {
    pub(crate) layout: &'a Layout,
    /// Offsets from every node sublattice.
    pub(super) offsets: &'a [[Offset; 2]],
    /// The part of the path that moves with the microphone, by lag, `[part, y block, x]` in lanes of y.
    lengths: Vec<[f64; LANES]>,
    /// `|p − s|` per voxel of the sublattice, `[transmission, y block, x]` in lanes of y; empty for a scan.
    pub(super) outward: Vec<[f64; LANES]>,
    /// The voxels of the sublattice, `[y block, x]` in lanes of y.
    pub(super) image: Vec<Lanes>,
    /// Kernels transformed along x, `[part, block, y]` in lanes of k_x.
    pub(super) columns: Vec<Lanes>,
    /// Spectra of the kernels, `[part, block, k_y]` in lanes of k_x, where several transmissions share them; else empty.
    pub(super) kernels: Vec<Lanes>,
    /// Products of spectra, `[block, side, k_y]`: of one block, or of all while tones add up. Real and imaginary parts
    /// are exchanged from here on, which makes forward transforms inverse ones.
    products: Vec<Lanes>,
    /// Products transformed back along y, `[y block, k_x]` in lanes of y.
    rows: Vec<Lanes>,
    /// For the adjoint: the voxels' spectrum, `[block, side, k_y]`; else empty.
    pub(super) field: Vec<Lanes>,
    pub(super) row: Vec<Lanes>,
    pub(super) transformed: Vec<Lanes>,
    pub(super) work: Vec<Lanes>,
}

impl<'a> Plane<'a> {
    /// Buffers for one thread, those for the adjoint or for Eq. 16 itself; `None` when they do not fit in memory.
    pub(crate) fn new(layout: &'a Layout, adjoint: bool) -> Option<Self> {
        let zeros = |n: usize| try_filled(Lanes::ZERO, n as u64);
        let (n_x, n_y, parts) = (layout.x.len(), layout.y.len(), layout.node_parts.len());
        let most = |axis: usize| layout.voxel_parts.iter().map(|p| p[axis].count).max().unwrap_or(1);
        let blocks = match (adjoint, layout.scans()) {
            (true, _) => 0,
            (false, true) => layout.blocks(),
            (false, false) => 1,
        };
        let (rows, field) = if adjoint { (0, layout.points() / LANES) } else { (most(1), 0) };
        let image = padded(most(0)) * most(1).div_ceil(LANES);
        Some(Self {
            layout,
            offsets: &[],
            lengths: try_filled([0.0; LANES], (parts * layout.x.lags() * layout.y.lags() / LANES) as u64)?,
            outward: try_with_capacity((image * layout.sources.len()) as u64)?,
            image: try_with_capacity(image as u64)?,
            columns: zeros(parts * layout.blocks() * n_y)?,
            kernels: zeros(if layout.transmissions() > 1 { parts * layout.blocks() * n_y } else { 0 })?,
            products: zeros(blocks * layout.sides() * n_y)?,
            rows: zeros(n_x * rows.div_ceil(LANES))?,
            field: zeros(field)?,
            row: zeros(n_x)?,
            transformed: zeros(n_x.max(n_y))?,
            work: zeros(n_x.max(n_y))?,
        })
    }

    /// Computes every length of depth `iz` on sublattice `part` of the voxels; they serve all tones.
    pub(super) fn place(&mut self, iz: usize, part: usize) {
        let Layout { lattice, places, x, y, path, .. } = self.layout;
        let (grid, z) = (places.grid(), places.at(2, iz));
        let voxels = &self.layout.voxel_parts[part];
        self.offsets = &self.layout.offsets[part];
        self.columns.fill(Lanes::ZERO);
        self.lengths.fill([0.0; LANES]);
        for LegAtDepth { times, beside, end, height } in path.legs(lattice.z, z) {
            let refracted = self.layout.refracted(end, z, || {
                let along = |axis: usize| {
                    let padded = self.layout.along(axis);
                    let lags = |offset: &[Offset; 2]| {
                        farthest((0..padded.lags()).map(|i| offset[axis].lag(i, padded) - beside[axis]))
                    };
                    farthest(self.offsets.iter().map(lags))
                };
                along(0).hypot(along(1))
            });
            let of_parts = self.lengths.chunks_exact_mut(x.lags() * y.lags() / LANES);
            for (lengths, offset) in of_parts.zip(self.offsets) {
                match &refracted {
                    None => add_leg(lengths, offset, [x, y], beside, |dx, dy| {
                        times * (dx * dx + (dy * dy + height * height)).sqrt()
                    }),
                    Some(table) => {
                        add_leg(lengths, offset, [x, y], beside, |dx, dy| times * table.length(dx.hypot(dy)));
                    }
                }
            }
        }
        self.outward.clear();
        for &source in &self.layout.sources {
            let at = |axis: &Axis, part: Sublattice, k: usize| axis.position(part.start + k * part.stride);
            let width = padded(voxels[0].count);
            let place =
                |i: usize, j: usize| DVec3::new(at(&grid.x, voxels[0], i), at(&grid.y, voxels[1], j), z);
            let refracted = self.layout.refracted(source.z, z, || {
                let last = [width, voxels[1].count.next_multiple_of(LANES)].map(|n| n - 1);
                let corners = [[0, 0], [last[0], 0], [0, last[1]], last].map(|[i, j]| place(i, j));
                farthest(corners.map(|p| p.truncate().distance(source.truncate())).into_iter())
            });
            for first in (0..voxels[1].count).step_by(LANES) {
                for i in 0..width {
                    self.outward.push(std::array::from_fn(|lane| {
                        let p = place(i, first + lane);
                        match &refracted {
                            None => p.distance(source),
                            Some(table) => table.length(p.truncate().distance(source.truncate())),
                        }
                    }));
                }
            }
        }
    }

    /// Adds tones to one sublattice of the voxels of depth `iz`; `spectra` are those of [`Layout::transform_into`].
    pub(crate) fn add(
        &mut self,
        iz: usize,
        part: usize,
        per_metre: &[f64],
        spectra: &[Lanes],
        voxels: &mut [Complex32],
    ) {
        self.place(iz, part);
        let layout = self.layout;
        let part = &layout.voxel_parts[part];
        let scan = layout.scans();
        self.image.clear();
        self.image.resize(padded(part[0].count) * part[1].count.div_ceil(LANES), Lanes::ZERO);
        self.exchange(voxels, part, |voxel, re, im| (*re, *im) = (voxel.re, voxel.im));
        if scan {
            self.products.fill(Lanes::ZERO);
        }
        for (k, spectra) in per_metre.iter().zip(spectra.chunks_exact(layout.tone_len() / LANES)) {
            for node_part in 0..layout.node_parts.len() {
                self.kernel(*k, node_part);
            }
            self.keep_kernels();
            let of_transmission = spectra.chunks_exact(layout.transmission_len() / LANES);
            for (transmission, spectra) in of_transmission.enumerate() {
                for block in 0..layout.blocks() {
                    if scan {
                        // No outer phase remains, so tones add up before the one inverse FFT.
                        self.multiply(block, block, spectra);
                    } else {
                        self.multiply(block, 0, spectra);
                        self.back_along_y(block, 0, part);
                    }
                }
                if !scan {
                    self.back_along_x(Some((*k, transmission)), part);
                }
            }
        }
        if scan {
            for block in 0..layout.blocks() {
                self.back_along_y(block, block, part);
            }
            self.back_along_x(None, part);
        }
        self.exchange(voxels, part, |voxel, re, im| *voxel = Complex32::new(*re, *im));
    }

    /// Visits every voxel of the sublattice beside its place in the image.
    fn exchange(
        &mut self,
        voxels: &mut [Complex32],
        [x, y]: &Sublattices,
        visit: impl Fn(&mut Complex32, &mut f32, &mut f32),
    ) {
        for iy in 0..y.count {
            let (block, lane) = (&mut self.image[iy / LANES * padded(x.count)..][..x.count], iy % LANES);
            let start = (y.start + iy * y.stride) * self.layout.grid().x.count;
            let row = &mut voxels[start..start + self.layout.grid().x.count];
            for (voxel, lanes) in row[x.start..].iter_mut().step_by(x.stride).zip(block) {
                visit(voxel, &mut lanes.re[lane], &mut lanes.im[lane]);
            }
        }
    }

    /// Kernels of one tone and node sublattice, transformed along x and transposed.
    pub(super) fn kernel(&mut self, per_metre: f64, part: usize) {
        let Layout { x, y, .. } = self.layout;
        let [along_x, along_y] = self.offsets[part].map(|offset| offset.shift.half);
        let lengths = &self.lengths[part * x.lags() * y.lags() / LANES..][..x.lags() * y.lags() / LANES];
        let columns = &mut self.columns[part * self.layout.blocks() * y.len()..];
        let transformed = &mut self.transformed[..x.len()];
        for (rows, lengths) in lengths.chunks_exact(x.lags()).enumerate() {
            lane_phasors(&[per_metre; LANES], lengths, &mut self.row[..x.lags()]);
            if x.even {
                mirror(&mut self.row, along_x);
            }
            x.fft.transform(&self.row, transformed, &mut self.work[..x.len()]);
            let tiles = transformed.as_chunks::<LANES>().0;
            for (tile, column) in
                tiles.iter().zip(columns.chunks_exact_mut(y.len())).take(self.layout.blocks())
            {
                let mut rows_of_tile = [Lanes::ZERO; LANES];
                transpose(tile, &mut rows_of_tile);
                for (i, lanes) in rows_of_tile.iter().enumerate() {
                    let i = rows * LANES + i;
                    column[i] = *lanes;
                    if let Some(mirrored) = y.mirrored(i, along_y) {
                        column[mirrored] = *lanes;
                    }
                }
            }
        }
    }

    /// Transforms the kernels along y, once for all transmissions that share them.
    pub(super) fn keep_kernels(&mut self) {
        let y = &self.layout.y;
        let columns = self.columns.chunks_exact(y.len());
        for (kernel, column) in self.kernels.chunks_exact_mut(y.len()).zip(columns) {
            y.fft.transform(column, kernel, &mut self.work[..y.len()]);
        }
    }

    /// Adds one block's products of kernels and data to block `to` of the products.
    fn multiply(&mut self, block: usize, to: usize, spectra: &[Lanes]) {
        let layout = self.layout;
        let (n_y, sides) = (layout.y.len(), layout.sides());
        let scan = layout.scans();
        let products = &mut self.products[to * sides * n_y..][..sides * n_y];
        for (part, offset) in self.offsets.iter().enumerate() {
            let column = (part * layout.blocks() + block) * n_y..(part * layout.blocks() + block + 1) * n_y;
            let kernel = if let Some(kept) = self.kernels.get(column.clone()) {
                kept
            } else {
                let kernel = &mut self.transformed[..n_y];
                layout.y.fft.transform(&self.columns[column], kernel, &mut self.work[..n_y]);
                kernel
            };
            let data = &spectra[layout.spectrum(part, offset) + block * sides * n_y..][..sides * n_y];
            for (product, data) in products.chunks_exact_mut(n_y).zip(data.chunks_exact(n_y)) {
                multiply(kernel, data, product, part > 0 || scan);
            }
        }
    }

    /// Transforms block `from` of the products back along y and transposes the voxels' rows.
    fn back_along_y(&mut self, block: usize, from: usize, part: &Sublattices) {
        let layout = self.layout;
        let (n_x, n_y, sides) = (layout.x.len(), layout.y.len(), layout.sides());
        let products = &self.products[from * sides * n_y..][..sides * n_y];
        for (side, product) in products.chunks_exact(n_y).enumerate() {
            let transformed = &mut self.transformed[..n_y];
            layout.y.fft.transform(product, transformed, &mut self.work[..n_y]);
            let tiles = transformed.as_chunks::<LANES>().0;
            for (tile, rows) in
                tiles.iter().zip(self.rows.chunks_exact_mut(n_x)).take(part[1].count.div_ceil(LANES))
            {
                let mut columns = [Lanes::ZERO; LANES];
                transpose(tile, &mut columns);
                for (k, column) in columns.iter().enumerate() {
                    rows[layout.column(side, block * LANES + k)] = *column;
                }
            }
        }
    }

    /// Transforms the voxels' rows back along x and adds them to the image, with the outer phase of a tone and transmission.
    fn back_along_x(&mut self, tone: Option<(f64, usize)>, part: &Sublattices) {
        let (x, width, plane) = (&self.layout.x, padded(part[0].count), self.image.len());
        for (block, image) in self.image.chunks_exact_mut(width).enumerate() {
            let transformed = &mut self.transformed[..x.len()];
            let from = &self.rows[block * x.len()..][..x.len()];
            x.fft.transform(from, transformed, &mut self.work[..x.len()]);
            let outer = &mut self.row[..width];
            match tone {
                Some((k, transmission)) => {
                    let first = transmission * plane + block * width;
                    lane_phasors(&[k; LANES], &self.outward[first..][..width], outer);
                }
                None => outer.fill(Lanes { re: [1.0; LANES], im: [0.0; LANES] }),
            }
            focus(&transformed[..width], outer, image);
        }
    }
}

/// Adds a leg that ends `beside` to the lengths of one pair of sublattices, `[y block, x]` in lanes of y.
#[inline(always)]
fn add_leg(
    lengths: &mut [[f64; LANES]],
    [along_x, along_y]: &[Offset; 2],
    [x, y]: [&PaddedAxis; 2],
    beside: DVec2,
    length: impl Fn(f64, f64) -> f64,
) {
    for (block, row) in lengths.chunks_exact_mut(x.lags()).enumerate() {
        let dy: [f64; LANES] = std::array::from_fn(|lane| along_y.lag(block * LANES + lane, y) - beside.y);
        for (ix, lengths) in row.iter_mut().enumerate() {
            let dx = along_x.lag(ix, x) - beside.x;
            for (sum, dy) in lengths.iter_mut().zip(dy) {
                *sum += length(dx, dy);
            }
        }
    }
}

/// The largest modulus.
pub(super) fn farthest(distances: impl Iterator<Item = f64>) -> f64 {
    distances.map(f64::abs).fold(0.0, f64::max)
}

/// Columns of voxels in the layout of the vector code.
pub(super) fn padded(width: usize) -> usize {
    width.next_multiple_of(ROWS)
}

/// Fills the second half of an even kernel's row from its first.
#[inline(always)]
fn mirror_body(row: &mut [Lanes], half: bool) {
    let n = row.len();
    if half {
        for i in 0..n / 2 {
            row[n - 1 - i] = row[i];
        }
        return;
    }
    // The column n/2 is the sum with alternating signs; n is a multiple of four, so lag n/2 has a plus.
    let mut alternating = Lanes::ZERO;
    for i in 0..n / 2 {
        let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
        let weight = if i == 0 { sign } else { 2.0 * sign };
        for l in 0..LANES {
            alternating.re[l] -= weight * row[i].re[l];
            alternating.im[l] -= weight * row[i].im[l];
        }
        if i > 0 {
            row[n - i] = row[i];
        }
    }
    row[n / 2] = alternating;
}

dispatched! {
    fn mirror = mirror_body(row: &mut [Lanes], half: bool)
}
