//! One thread's work on one depth where nodes and voxels lie on a single line: a two-dimensional image.
//!
//! There are no columns to fill the lanes, so sixteen tones fill them. The rest is as for a [plane](super::plane),
//! in one dimension and without symmetry.

use super::lattice::Sublattices;
use super::layout::Layout;
use super::padded_axis::{Offset, PaddedAxis};
use super::plane::farthest;
use super::pointwise::{multiply, sums};
use crate::alloc::{try_filled, try_with_capacity};
use crate::reconstruct::numerics::LaneFft;
use crate::wave::Geometry;
use crate::wave::simd::{LANES, Lanes, ROWS, lane_phasors, tone_phasors};
use glam::DVec3;
use num_complex::Complex32;
use std::ops::Range;

/// Geometry of one depth and voxel sublattice, and reused buffers.
#[derive(Debug)]
pub(crate) struct Line<'a> {
    pub(crate) layout: &'a Layout,
    /// The axis along which everything lies.
    pub(super) axis: usize,
    /// `|p − r|²` without the square of the depth, by lag, four times that for a scan:
    /// `[voxel part, node part, lag]`.
    pub(super) squares: Vec<f64>,
    /// The depth above the microphones, m, twice that for a scan.
    pub(super) height: f64,
    /// `|p − s|` per voxel of the sublattice, the same in all lanes, `[transmission, voxel]`; empty for a monostatic scan.
    pub(super) outward: Vec<[f64; LANES]>,
    pub(super) kernel: Vec<Lanes>,
    /// Spectra of the kernels, `[part, k]` in lanes of tones: those of all transmissions.
    pub(super) kernels: Vec<Lanes>,
    pub(super) transformed: Vec<Lanes>,
    pub(super) work: Vec<Lanes>,
    /// Products of spectra, real and imaginary parts exchanged.
    pub(super) products: Vec<Lanes>,
    /// The voxels' sums over sixteen tones.
    image: Vec<Complex32>,
}

/// Places along a line of a plane of rows of `n_x`.
pub(crate) fn places([x, y]: &Sublattices, axis: usize, n_x: usize) -> impl Iterator<Item = usize> + use<> {
    let first = y.start * n_x + x.start;
    let (count, stride) = if axis == 0 { (x.count, x.stride) } else { (y.count, y.stride * n_x) };
    (0..count).map(move |i| first + i * stride)
}

/// The square of the lateral distance of lag `i` of a pair of sublattices, m².
fn aside_squared(offset: &[Offset; 2], axis: usize, i: usize, padded: &PaddedAxis) -> f64 {
    let (lag, aside) = (offset[axis].lag(i, padded), offset[1 - axis].first);
    lag * lag + aside * aside
}

impl<'a> Line<'a> {
    /// Buffers for one thread; `None` when they do not fit in memory.
    pub(crate) fn new(layout: &'a Layout, axis: usize) -> Option<Self> {
        let padded = layout.along(axis);
        let n = padded.len();
        let zeros = || try_filled(Lanes::ZERO, n as u64);
        let mut squares = try_with_capacity((n * layout.pairs()) as u64)?;
        for offset in layout.offsets.iter().flatten() {
            let square = |aside: f64| layout.geometry.return_legs().powi(2) * aside;
            squares.extend((0..n).map(|i| square(aside_squared(offset, axis, i, padded))));
        }
        Some(Self {
            layout,
            axis,
            squares,
            height: 0.0,
            outward: Vec::new(),
            kernel: zeros()?,
            kernels: try_filled(Lanes::ZERO, (n * layout.node_parts.len()) as u64)?,
            transformed: zeros()?,
            work: zeros()?,
            products: zeros()?,
            image: Vec::new(),
        })
    }

    /// Goes to depth `iz` and sublattice `part` of the voxels; what is computed serves all tones.
    pub(super) fn place(&mut self, iz: usize, part: usize) {
        let Layout { lattice, grid, geometry, sources, .. } = self.layout;
        let z = grid.z.position(iz);
        self.height = geometry.return_legs() * (z - lattice.z);
        self.bend(z, part);
        self.outward.clear();
        let voxels = &self.layout.voxel_parts[part];
        for &source in sources {
            for place in places(voxels, self.axis, grid.x.count) {
                let (x, y) = (grid.x.position(place % grid.x.count), grid.y.position(place / grid.x.count));
                let p = DVec3::new(x, y, z);
                let length = match &self.layout.refraction {
                    None => p.distance(source),
                    Some(refraction) => refraction.leg_length(source, p),
                };
                self.outward.push([length; LANES]);
            }
            self.outward.resize(self.outward.len().next_multiple_of(ROWS), [0.0; LANES]);
        }
    }

    /// Where paths bend at an interface, their squares are those of the whole length, and there is no height to add.
    fn bend(&mut self, z: f64, part: usize) {
        let layout = self.layout;
        let (padded, legs) = (layout.along(self.axis), layout.geometry.return_legs());
        let offsets = &layout.offsets[part];
        let aside = |offset: &[Offset; 2], i: usize| aside_squared(offset, self.axis, i, padded).sqrt();
        let all = || (0..padded.len()).flat_map(|i| offsets.iter().map(move |offset| (offset, i)));
        let farthest = || farthest(all().map(|(offset, i)| aside(offset, i)));
        let Some(table) = layout.refracted(layout.lattice.z, z, farthest) else { return };
        self.height = 0.0;
        let of_part = padded.len() * layout.node_parts.len();
        let squares = self.squares[part * of_part..][..of_part].chunks_exact_mut(padded.len());
        for (squares, offset) in squares.zip(offsets) {
            for (i, square) in squares.iter_mut().enumerate() {
                *square = (legs * table.length(aside_squared(offset, self.axis, i, padded).sqrt())).powi(2);
            }
        }
    }

    /// Adds tones to one sublattice of the voxels of depth `iz`; `data` are those of [`Layout::transform_into`].
    pub(crate) fn add(
        &mut self,
        iz: usize,
        part: usize,
        per_metre: &[f64],
        data: &[Lanes],
        voxels: &mut [Complex32],
    ) {
        self.place(iz, part);
        let fft = &self.layout.along(self.axis).fft;
        let n = fft.len();
        let of_part = n * self.layout.node_parts.len();
        let squares = part * of_part..(part + 1) * of_part;
        let part = &self.layout.voxel_parts[part];
        let scan = self.layout.geometry == Geometry::Monostatic;
        let of_block = of_part * self.layout.transmissions();
        for (block, (tones, spectra)) in per_metre.chunks(LANES).zip(data.chunks_exact(of_block)).enumerate()
        {
            let mut k = [0.0; LANES];
            k[..tones.len()].copy_from_slice(tones);
            self.keep_kernels(fft, &k, squares.clone());
            for (transmission, spectra) in spectra.chunks_exact(of_part).enumerate() {
                let pairs = self.kernels.chunks_exact(n).zip(spectra.chunks_exact(n));
                for (part, (kernel, data)) in pairs.enumerate() {
                    multiply(kernel, data, &mut self.products, part > 0 || (scan && block > 0));
                }
                if !scan {
                    let width = self.outward.len() / self.layout.transmissions();
                    let outer = self.kernel.get_mut(..width).expect("no more voxels than lags");
                    lane_phasors(&k, &self.outward[transmission * width..][..width], outer);
                    self.back(fft, voxels, part);
                }
            }
        }
        if scan {
            // No outer phase remains, so tones add up before the one inverse FFT.
            self.kernel.fill(Lanes { re: [1.0; LANES], im: [0.0; LANES] });
            self.back(fft, voxels, part);
        }
    }

    /// Spectra of the kernels of sixteen tones, once for all transmissions that share them.
    pub(super) fn keep_kernels(&mut self, fft: &LaneFft, per_metre: &[f64; LANES], squares: Range<usize>) {
        let parts = self.squares[squares].chunks_exact(fft.len());
        for (squares, kernel) in parts.zip(self.kernels.chunks_exact_mut(fft.len())) {
            tone_phasors(per_metre, squares, self.height, &mut self.kernel);
            fft.transform(&self.kernel, kernel, &mut self.work);
        }
    }

    /// Transforms the products back and adds all tones to the voxels, with the outer phases, which the kernels' buffer
    /// holds.
    fn back(&mut self, fft: &LaneFft, voxels: &mut [Complex32], part: &Sublattices) {
        fft.transform(&self.products, &mut self.transformed, &mut self.work);
        self.image.clear();
        self.image.resize(part[self.axis].count.next_multiple_of(ROWS), Complex32::ZERO);
        let width = self.image.len();
        sums(&self.transformed[..width], &self.kernel[..width], &mut self.image);
        let places = places(part, self.axis, self.layout.grid.x.count);
        for (place, sum) in places.zip(&self.image) {
            voxels[place] += sum;
        }
    }
}
