//! One thread's work on one depth where nodes and voxels lie on a single line: a two-dimensional image.
//!
//! There are no columns to fill the lanes, so sixteen tones fill them. The rest is as for a [plane](super::plane),
//! in one dimension and without symmetry.

use super::kernel_path::LegAtDepth;
use super::lattice::Sublattices;
use super::layout::Layout;
use super::padded_axis::{Offset, PaddedAxis};
use super::plane::farthest;
use super::pointwise::{multiply, sums};
use crate::alloc::{try_filled, try_with_capacity};
use crate::reconstruct::numerics::LaneFft;
use crate::wave::simd::{LANES, Lanes, ROWS, lane_phasors, tone_phasors};
use glam::{DVec2, DVec3};
use num_complex::Complex32;
use std::ops::Range;

/// Geometry of one depth and voxel sublattice, and reused buffers.
#[derive(Debug)]
pub(crate) struct Line<'a> {
    pub(crate) layout: &'a Layout,
    /// The axis along which everything lies.
    pub(super) axis: usize,
    /// The square of the part of the path that moves with the microphone, by lag: `[voxel part, node part, lag]`, m². Of one
    /// straight leg without the square of its height, so that it serves all depths.
    pub(super) squares: Vec<f64>,
    /// The height of one straight leg, as many times as it is gone, m; else 0.
    pub(super) height: f64,
    /// `|p − s|` per voxel of the sublattice, the same in all lanes, `[transmission, voxel]`; empty for a scan.
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

/// Lag `i` of a pair of sublattices along an axis, and the only one across it, m.
fn lag(offset: &[Offset; 2], axis: usize, i: usize, padded: &PaddedAxis) -> DVec2 {
    let [along, across] = [offset[axis].lag(i, padded), offset[1 - axis].first];
    if axis == 0 { DVec2::new(along, across) } else { DVec2::new(across, along) }
}

impl<'a> Line<'a> {
    /// Buffers for one thread; `None` when they do not fit in memory.
    pub(crate) fn new(layout: &'a Layout, axis: usize) -> Option<Self> {
        let padded = layout.along(axis);
        let n = padded.len();
        let zeros = || try_filled(Lanes::ZERO, n as u64);
        let mut squares = try_with_capacity((n * layout.pairs()) as u64)?;
        let leg = layout.path.only_leg(0.0, 0.0);
        for offset in layout.offsets.iter().flatten() {
            let square = |leg: LegAtDepth, i: usize| {
                leg.times.powi(2) * leg.beside_squared(lag(offset, axis, i, padded))
            };
            squares.extend((0..n).map(|i| leg.map_or(0.0, |leg| square(leg, i))));
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
        let Layout { lattice, places: voxels, path, sources, .. } = self.layout;
        let (grid, z) = (voxels.grid(), voxels.at(2, iz));
        match path.only_leg(lattice.z, z) {
            Some(leg) if self.layout.refraction.is_none() => self.height = leg.times * leg.height,
            _ => self.measure(z, part),
        }
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

    /// The whole lengths at depth `z`, squared, of several legs or bent ones.
    fn measure(&mut self, z: f64, part: usize) {
        let (layout, axis) = (self.layout, self.axis);
        let padded = layout.along(axis);
        let offsets = &layout.offsets[part];
        let of_part = padded.len() * layout.node_parts.len();
        let lengths = &mut self.squares[part * of_part..][..of_part];
        lengths.fill(0.0);
        for leg in layout.path.legs(layout.lattice.z, z) {
            let aside = |offset: &[Offset; 2], i: usize| leg.beside_squared(lag(offset, axis, i, padded));
            let all = || (0..padded.len()).flat_map(|i| offsets.iter().map(move |offset| (offset, i)));
            let farthest = || farthest(all().map(|(offset, i)| aside(offset, i))).sqrt();
            let table = layout.refracted(leg.end, z, farthest);
            let length = |aside: f64| match &table {
                None => (aside + leg.height * leg.height).sqrt(),
                Some(table) => table.length(aside.sqrt()),
            };
            for (lengths, offset) in lengths.chunks_exact_mut(padded.len()).zip(offsets) {
                for (i, sum) in lengths.iter_mut().enumerate() {
                    *sum += leg.times * length(aside(offset, i));
                }
            }
        }
        for length in lengths {
            *length *= *length;
        }
        self.height = 0.0;
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
        let scan = self.layout.scans();
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
        let places = places(part, self.axis, self.layout.grid().x.count);
        for (place, sum) in places.zip(&self.image) {
            voxels[place] += sum;
        }
    }
}
