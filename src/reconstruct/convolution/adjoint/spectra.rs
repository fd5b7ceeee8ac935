//! From the spectra of tones, in which depths have added up, to samples of the nodes.

use crate::error::Result;
use crate::reconstruct::convolution::layout::Layout;
use crate::reconstruct::convolution::line::places;
use crate::reconstruct::convolution::padded_axis::{CircularShift, Offset};
use crate::reconstruct::convolution::spectra::{Scratch, turn};
use crate::reconstruct::no_room;
use crate::reconstruct::volume::Batch;
use crate::wave::phasor;
use crate::wave::simd::{LANES, Lanes, transpose};
use num_complex::Complex32;
use rayon::prelude::*;

impl Layout {
    /// Samples of a transmission's nodes, `[tone, node]`, from the spectra of all: the adjoint of [`Layout::transform_into`].
    ///
    /// # Errors
    /// A thread's buffers do not fit in memory.
    pub(in crate::reconstruct::convolution) fn nodes_of(
        &self,
        (transmission, spectra): (usize, &[Lanes]),
        batch: Batch,
        nodes: &mut [Complex32],
    ) -> Result<()> {
        nodes.fill(Complex32::ZERO);
        let width = self.lattice.width();
        let count = nodes.len() / width;
        let no_room = || no_room(count as u64, width as u64);
        if let Some(axis) = self.line {
            self.nodes_of_line(axis, (transmission, spectra), nodes);
            return Ok(());
        }
        let points = self.points() / LANES;
        let tones = nodes.par_chunks_exact_mut(width).zip(spectra.par_chunks_exact(self.tone_len() / LANES));
        tones.with_min_len(batch.least_run(count)).try_for_each_init(
            || Scratch::new(self),
            |scratch, (nodes, spectra)| {
                let scratch = scratch.as_mut().ok_or_else(no_room)?;
                let spectra = spectra.chunks_exact(points).skip(transmission * self.placements.len());
                for (spectrum, placement) in spectra.zip(&self.placements) {
                    self.transform_back(spectrum, *placement, nodes, scratch);
                }
                Ok(())
            },
        )
    }

    /// Adds the samples of one placement's nodes.
    fn transform_back(
        &self,
        spectrum: &[Lanes],
        (part, shifts): (usize, [CircularShift; 2]),
        nodes: &mut [Complex32],
        scratch: &mut Scratch,
    ) {
        let scale = 1.0 / self.points() as f32;
        let [n_x, _] = self.lattice.nodes().map(|axis| axis.count);
        let [x, y] = self.node_parts[part];
        let (sides, n_y) = (self.sides(), self.y.len());
        for (spectrum, column) in spectrum.chunks_exact(n_y).zip(scratch.columns.chunks_exact_mut(n_y)) {
            self.y.fft.transform(spectrum, column, &mut scratch.work[..n_y]);
        }
        // The column that is left out stays zero.
        scratch.row.fill(Lanes::ZERO);
        for first in (0..y.count).step_by(LANES) {
            let rows = LANES.min(y.count - first);
            for (column, from) in scratch.columns.chunks_exact(n_y).enumerate() {
                let (block, side) = (column / sides, column % sides);
                let mut tile = [Lanes::ZERO; LANES];
                for (j, row) in tile[..rows].iter_mut().enumerate() {
                    *row = from[Offset::place(shifts[1], first + j, &self.y)];
                }
                transpose(&tile, &mut scratch.tile);
                for (k, row) in scratch.tile.iter_mut().enumerate() {
                    let k = block * LANES + k;
                    if side == 1 && shifts[0].half {
                        turn(row, phasor(-(k as f64) / self.x.len() as f64));
                    }
                    if (side, k) != (1, 0) {
                        scratch.row[self.column(side, k)] = *row;
                    }
                }
            }
            let work = &mut scratch.work[..self.x.len()];
            self.x.fft.transform(&scratch.row, &mut scratch.transformed, work);
            for lane in 0..rows {
                let to = &mut nodes[(y.start + (first + lane) * y.stride) * n_x..][..n_x];
                for (j, node) in to[x.start..].iter_mut().step_by(x.stride).enumerate() {
                    let from = &scratch.transformed[Offset::place(shifts[0], j, &self.x)];
                    *node += from.at(lane).conj() * scale;
                }
            }
        }
    }

    /// The same on a line.
    fn nodes_of_line(
        &self,
        axis: usize,
        (transmission, spectra): (usize, &[Lanes]),
        nodes: &mut [Complex32],
    ) {
        let fft = &self.along(axis).fft;
        let (n, parts, width) = (fft.len(), &self.node_parts, self.lattice.width());
        let (scale, n_x) = (1.0 / n as f32, self.lattice.nodes()[0].count);
        let tones = nodes.par_chunks_mut(LANES * width);
        let of_block = parts.len() * n;
        tones.zip(spectra.par_chunks_exact(self.transmissions() * of_block)).for_each_init(
            || [vec![Lanes::ZERO; n], vec![Lanes::ZERO; n]],
            |[transformed, work], (tones, spectra)| {
                let spectra = spectra[transmission * of_block..].chunks_exact(n);
                for (part, spectrum) in parts.iter().zip(spectra) {
                    fft.transform(spectrum, transformed, work);
                    for (lane, tone) in tones.chunks_exact_mut(width).enumerate() {
                        for (from, place) in transformed.iter().zip(places(part, axis, n_x)) {
                            tone[place] += from.at(lane).conj() * scale;
                        }
                    }
                }
            },
        );
    }
}
