//! What stays the same for all planes of a volume: sub-lattices, transforms, and the data's spectra.

use super::batch::Batch;
use super::circle::{Circle, Offset, Turn};
use super::lanes::transpose;
use super::lattice::{Parts, SharedLattice};
use super::line;
use super::no_room;
use crate::error::Result;
use crate::grid::{Grid, filled};
use crate::wave::simd::{LANES, Lanes};
use crate::wave::{Geometry, phasor};
use num_complex::Complex32;
use rayon::prelude::*;

/// What stays the same for all planes of a volume.
///
/// Spectra are kept by columns, in blocks of sixteen neighbouring k_x. A kernel that is even in x has the same column at
/// k_x and −k_x, so each block of kernels serves two *sides* of the data's spectra: a block of columns, and their
/// mirror images. The column k_x = n_x/2, which has no partner, is left out: see [`super::plane`].
#[derive(Debug)]
pub(super) struct Layout<'a> {
    pub(super) lattice: &'a SharedLattice,
    pub(super) grid: Grid,
    pub(super) geometry: Geometry,
    pub(super) x: Circle,
    pub(super) y: Circle,
    pub(super) node_parts: Vec<Parts>,
    pub(super) voxel_parts: Vec<Parts>,
    /// The axis along which all nodes and voxels lie, if they lie on one line: then sixteen tones share the lanes.
    pub(super) line: Option<usize>,
    /// `[voxel part][node part]`, along x and y.
    pub(super) offsets: Vec<Vec<[Offset; 2]>>,
    /// What differs among the spectra of one tone: part of the nodes, and its turns along x and y.
    placements: Vec<(usize, [Turn; 2])>,
}

impl<'a> Layout<'a> {
    pub(super) fn new(lattice: &'a SharedLattice, grid: Grid, geometry: Geometry) -> Self {
        let (node_parts, voxel_parts) = (lattice.node_parts(), lattice.voxel_parts(&grid));
        let ([nodes_x, nodes_y], [pitch_x, pitch_y]) = (lattice.nodes(), lattice.common_pitch());
        let first = |axis: &crate::grid::Axis, index: usize| axis.position(index);
        let offset = |voxels: &Parts, nodes: &Parts| {
            let x = first(&grid.x, voxels[0].start) - first(&nodes_x, nodes[0].start);
            let y = first(&grid.y, voxels[1].start) - first(&nodes_y, nodes[1].start);
            [Offset::new(x, pitch_x, voxels[0], nodes[0]), Offset::new(y, pitch_y, voxels[1], nodes[1])]
        };
        let mut offsets: Vec<Vec<[Offset; 2]>> =
            voxel_parts.iter().map(|v| node_parts.iter().map(|n| offset(v, n)).collect()).collect();
        let single = |axis: usize| node_parts.iter().chain(&voxel_parts).all(|part| part[axis].count == 1);
        let line = if single(1) { Some(0) } else { single(0).then_some(1) };
        let mut circle = |axis: usize| match line {
            Some(_) => Circle::around_line(offsets.iter().flatten().map(|o| &o[axis])),
            None => {
                Circle::around(&mut offsets.iter_mut().flatten().map(|o| &mut o[axis]).collect::<Vec<_>>())
            }
        };
        let (x, y) = (circle(0), circle(1));
        let mut placements = Vec::new();
        for of_voxels in &offsets {
            for (part, offset) in of_voxels.iter().enumerate() {
                let placement = (part, offset.map(|o| o.turn));
                if !placements.contains(&placement) {
                    placements.push(placement);
                }
            }
        }
        Self { lattice, grid, geometry, x, y, node_parts, voxel_parts, line, offsets, placements }
    }

    /// Points of one padded plane.
    pub(super) fn points(&self) -> usize {
        self.x.len() * self.y.len()
    }

    /// Complex numbers in one tone's spectra.
    pub(super) fn tone_len(&self) -> usize {
        self.points() * self.placements.len()
    }

    /// Work per tone and depth, in kernel transforms.
    pub(super) fn pairs(&self) -> usize {
        self.node_parts.len() * self.voxel_parts.len()
    }

    /// The circle along an axis.
    pub(super) fn along(&self, axis: usize) -> &Circle {
        if axis == 0 { &self.x } else { &self.y }
    }

    /// 2 where the kernels are even in x, else 1.
    pub(super) fn sides(&self) -> usize {
        if self.x.even { 2 } else { 1 }
    }

    /// Blocks of sixteen columns of kernels.
    pub(super) fn blocks(&self) -> usize {
        self.x.lags() / LANES
    }

    /// The place on the circle of k_x of a column; the mirror image of the first one is the one that is left out.
    pub(super) fn column(&self, side: usize, k: usize) -> usize {
        match (side, k) {
            (0, k) => k,
            (_, 0) => self.x.len() / 2,
            (_, k) => self.x.len() - k,
        }
    }

    /// Where in a tone's spectra, `[placement, block, side, k_y]`, those for a pair of sub-lattices begin.
    pub(super) fn spectrum(&self, part: usize, offset: &[Offset; 2]) -> usize {
        let placement = (part, offset.map(|o| o.turn));
        let index = self.placements.iter().position(|p| *p == placement).expect("every pair was entered");
        index * self.x.len() * self.y.len() / LANES
    }

    /// Spectra of the nodes' samples, `[tone, placement, block, side, k_y]`; the inverse transform's scale is folded in.
    /// On a line, those of [`line::transform_into`].
    ///
    /// # Errors
    /// A thread's buffers do not fit in memory.
    pub(super) fn transform_into(
        &self,
        nodes: &[Complex32],
        batch: Batch,
        spectra: &mut [Lanes],
    ) -> Result<()> {
        if let Some(axis) = self.line {
            line::transform_into(self, axis, nodes, spectra);
            return Ok(());
        }
        let tones = nodes.len() / self.lattice.width();
        let no_room = || no_room(tones as u64, self.lattice.width() as u64);
        let planes = spectra.par_chunks_exact_mut(self.x.len() * self.y.len() / LANES);
        let run = batch.least_run(planes.len());
        planes.with_min_len(run).enumerate().try_for_each_init(
            || Scratch::new(self),
            |scratch, (index, spectrum)| {
                let scratch = scratch.as_mut().ok_or_else(no_room)?;
                let (tone, placement) = (index / self.placements.len(), index % self.placements.len());
                let nodes = &nodes[tone * self.lattice.width()..][..self.lattice.width()];
                self.transform(nodes, self.placements[placement], spectrum, scratch);
                Ok(())
            },
        )
    }

    /// Room for the spectra of so many tones.
    ///
    /// # Errors
    /// They do not fit in memory.
    pub(super) fn room(&self, tones: usize) -> Result<Vec<Lanes>> {
        filled(Lanes::ZERO, self.spectra_len(tones) as u64)
            .ok_or_else(|| no_room(tones as u64, self.lattice.width() as u64))
    }

    /// So much of it as so many tones take.
    pub(super) fn part<'b>(&self, room: &'b mut [Lanes], tones: usize) -> &'b mut [Lanes] {
        &mut room[..self.spectra_len(tones)]
    }

    /// Length of the spectra of so many tones.
    fn spectra_len(&self, tones: usize) -> usize {
        match self.line {
            Some(axis) => tones.div_ceil(LANES) * self.node_parts.len() * self.along(axis).len(),
            None => tones * self.tone_len() / LANES,
        }
    }

    /// The spectrum of one tone's nodes at one placement, `[block, side, k_y]`.
    fn transform(
        &self,
        nodes: &[Complex32],
        (part, turns): (usize, [Turn; 2]),
        spectrum: &mut [Lanes],
        scratch: &mut Scratch,
    ) {
        let scale = 1.0 / (self.x.len() * self.y.len()) as f32;
        let [n_x, _] = self.lattice.nodes().map(|axis| axis.count);
        let [x, y] = self.node_parts[part];
        let (sides, n_y) = (self.sides(), self.y.len());
        scratch.columns.fill(Lanes::ZERO);
        for first in (0..y.count).step_by(LANES) {
            let rows = LANES.min(y.count - first);
            scratch.row.fill(Lanes::ZERO);
            for lane in 0..rows {
                let from = &nodes[(y.start + (first + lane) * y.stride) * n_x..][..n_x];
                for (j, node) in from[x.start..].iter().step_by(x.stride).enumerate() {
                    let to = &mut scratch.row[Offset::place(turns[0], j, &self.x)];
                    (to.re[lane], to.im[lane]) = (node.re * scale, node.im * scale);
                }
            }
            let work = &mut scratch.work[..self.x.len()];
            self.x.fft.transform(&scratch.row, &mut scratch.transformed, work);
            for (column, to) in scratch.columns.chunks_exact_mut(n_y).enumerate() {
                let (block, side) = (column / sides, column % sides);
                let mut tile = [Lanes::ZERO; LANES];
                for (k, row) in tile.iter_mut().enumerate() {
                    let k = block * LANES + k;
                    if (side, k) != (1, 0) {
                        *row = scratch.transformed[self.column(side, k)];
                    }
                    if side == 1 && turns[0].half {
                        // The spectrum of a kernel with its mirror between the lags is even but for e^{iπk/n}.
                        turn(row, phasor(-(k as f64) / self.x.len() as f64));
                    }
                }
                transpose(&tile, &mut scratch.tile);
                for (j, row) in scratch.tile[..rows].iter().enumerate() {
                    to[Offset::place(turns[1], first + j, &self.y)] = *row;
                }
            }
        }
        for (column, spectrum) in scratch.columns.chunks_exact(n_y).zip(spectrum.chunks_exact_mut(n_y)) {
            self.y.fft.transform(column, spectrum, &mut scratch.work[..n_y]);
        }
    }
}

/// Multiplies every lane by one number.
fn turn(row: &mut Lanes, by: Complex32) {
    for (re, im) in row.re.iter_mut().zip(&mut row.im) {
        let product = Complex32::new(*re, *im) * by;
        (*re, *im) = (product.re, product.im);
    }
}

/// One thread's buffers.
struct Scratch {
    row: Vec<Lanes>,
    transformed: Vec<Lanes>,
    work: Vec<Lanes>,
    columns: Vec<Lanes>,
    tile: [Lanes; LANES],
}

impl Scratch {
    /// `None` when they do not fit in memory.
    fn new(layout: &Layout) -> Option<Self> {
        let zeros = |n: usize| filled(Lanes::ZERO, n as u64);
        let (n_x, n_y) = (layout.x.len(), layout.y.len());
        Some(Self {
            row: zeros(n_x)?,
            transformed: zeros(n_x)?,
            work: zeros(n_x.max(n_y))?,
            columns: zeros(n_x * n_y / LANES)?,
            tile: [Lanes::ZERO; LANES],
        })
    }
}
