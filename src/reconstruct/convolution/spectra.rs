//! The data's spectra: samples of nodes, transformed once per slab for all of its depths.

use super::layout::Layout;
use super::line::places;
use super::padded_axis::{CircularShift, Offset};
use crate::alloc::{try_filled, try_with_capacity};
use crate::error::Result;
use crate::reconstruct::compress::Tones;
use crate::reconstruct::no_room;
use crate::reconstruct::volume::Batch;
use crate::wave::phasor;
use crate::wave::simd::{LANES, Lanes, transpose};
use num_complex::Complex32;
use rayon::prelude::*;

/// Vectors of a room that one thread fills at a time, of 2 MiB.
const FILLED: usize = 1 << 14;

impl Layout {
    /// Spectra of the nodes' samples, `[tone, transmission, placement, block, side, k_y]`; the inverse transform's scale is
    /// folded in. On a line, those of [`transform_line`].
    ///
    /// # Errors
    /// A thread's buffers do not fit in memory.
    pub(crate) fn transform_into(
        &self,
        transmissions: &[Tones],
        batch: Batch,
        spectra: &mut [Lanes],
    ) -> Result<()> {
        if let Some(axis) = self.line {
            transform_line(self, axis, transmissions, spectra);
            return Ok(());
        }
        let tones = transmissions[0].per_metre.len();
        let no_room = || no_room(tones as u64, self.lattice.width() as u64);
        let planes = spectra.par_chunks_exact_mut(self.x.len() * self.y.len() / LANES);
        let run = batch.least_run(planes.len());
        planes.with_min_len(run).enumerate().try_for_each_init(
            || Scratch::new(self),
            |scratch, (index, spectrum)| {
                let scratch = scratch.as_mut().ok_or_else(no_room)?;
                let (index, placement) = (index / self.placements.len(), index % self.placements.len());
                let (tone, transmission) = (index / transmissions.len(), index % transmissions.len());
                let nodes = &transmissions[transmission].samples;
                let nodes = &nodes[tone * self.lattice.width()..][..self.lattice.width()];
                self.transform(nodes, self.placements[placement], spectrum, scratch);
                Ok(())
            },
        )
    }

    /// Buffers for the spectra of this many tones.
    ///
    /// # Errors
    /// They do not fit in memory.
    pub(crate) fn room(&self, tones: usize) -> Result<Vec<Lanes>> {
        let count = self.spectra_len(tones);
        let mut room = try_with_capacity(count as u64)
            .ok_or_else(|| no_room(tones as u64, self.lattice.width() as u64))?;
        // By all threads: the first to write to a page waits for it.
        (0..count).into_par_iter().with_min_len(FILLED).map(|_| Lanes::ZERO).collect_into_vec(&mut room);
        Ok(room)
    }

    /// The part of it that this many tones take.
    pub(crate) fn part<'b>(&self, room: &'b mut [Lanes], tones: usize) -> &'b mut [Lanes] {
        &mut room[..self.spectra_len(tones)]
    }

    /// Length of the spectra of this many tones.
    pub(crate) fn spectra_len(&self, tones: usize) -> usize {
        match self.line {
            Some(axis) => {
                let of_block = self.transmissions() * self.node_parts.len() * self.along(axis).len();
                tones.div_ceil(LANES) * of_block
            }
            None => tones * self.tone_len() / LANES,
        }
    }

    /// The spectrum of one tone's nodes at one placement, `[block, side, k_y]`.
    fn transform(
        &self,
        nodes: &[Complex32],
        (part, shifts): (usize, [CircularShift; 2]),
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
                    let to = &mut scratch.row[Offset::place(shifts[0], j, &self.x)];
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
                    if side == 1 && shifts[0].half {
                        // The spectrum of a kernel with its mirror between the lags is even but for e^{iπk/n}.
                        turn(row, phasor(-(k as f64) / self.x.len() as f64));
                    }
                }
                transpose(&tile, &mut scratch.tile);
                for (j, row) in scratch.tile[..rows].iter().enumerate() {
                    to[Offset::place(shifts[1], first + j, &self.y)] = *row;
                }
            }
        }
        for (column, spectrum) in scratch.columns.chunks_exact(n_y).zip(spectrum.chunks_exact_mut(n_y)) {
            self.y.fft.transform(column, spectrum, &mut scratch.work[..n_y]);
        }
    }
}

/// Spectra of the nodes' samples, `[tone / 16, transmission, part, k]` in lanes of tones; the inverse transform's scale is
/// folded in.
fn transform_line(layout: &Layout, axis: usize, transmissions: &[Tones], spectra: &mut [Lanes]) {
    let fft = &layout.along(axis).fft;
    let (n, parts, width) = (fft.len(), &layout.node_parts, layout.lattice.width());
    let (scale, n_x) = (1.0 / n as f32, layout.lattice.nodes()[0].count);
    spectra.par_chunks_exact_mut(n).enumerate().for_each_init(
        || [vec![Lanes::ZERO; n], vec![Lanes::ZERO; n]],
        |[row, work], (index, spectrum)| {
            let (index, part) = (index / parts.len(), index % parts.len());
            let (block, transmission) = (index / transmissions.len(), index % transmissions.len());
            let nodes = &transmissions[transmission].samples;
            row.fill(Lanes::ZERO);
            for (lane, tone) in nodes.chunks_exact(width).skip(block * LANES).take(LANES).enumerate() {
                for (to, place) in row.iter_mut().zip(places(&parts[part], axis, n_x)) {
                    (to.re[lane], to.im[lane]) = (tone[place].re * scale, tone[place].im * scale);
                }
            }
            fft.transform(row, spectrum, work);
        },
    );
}

/// Multiplies every lane by one number.
pub(super) fn turn(row: &mut Lanes, by: Complex32) {
    for (re, im) in row.re.iter_mut().zip(&mut row.im) {
        let product = Complex32::new(*re, *im) * by;
        (*re, *im) = (product.re, product.im);
    }
}

/// One thread's buffers.
pub(super) struct Scratch {
    pub(super) row: Vec<Lanes>,
    pub(super) transformed: Vec<Lanes>,
    pub(super) work: Vec<Lanes>,
    pub(super) columns: Vec<Lanes>,
    pub(super) tile: [Lanes; LANES],
}

impl Scratch {
    /// `None` when they do not fit in memory.
    pub(super) fn new(layout: &Layout) -> Option<Self> {
        let zeros = |n: usize| try_filled(Lanes::ZERO, n as u64);
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
