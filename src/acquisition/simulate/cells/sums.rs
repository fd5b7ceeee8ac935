//! Cells summed at the tones: at the nodes of a panel, or, where these do not serve, at its microphones.

use super::MicrophonePanel;
use super::tree::{CellTree, ReflectorCell};
use crate::acquisition::Instrument;
use crate::acquisition::simulate::SimulateOptions;
use crate::acquisition::simulate::echoes::batch::ReflectorBatch;
use crate::acquisition::simulate::terms::{LossTerms, outward_spreading};
use crate::acquisition::simulate::virtual_tones::EquispacedTones;
use crate::alloc::try_zeroed;
use crate::reflectors::Reflectors;
use crate::wave::NEAREST_LEG;
use crate::wave::cells::cell_offsets;
use crate::wave::offsets::MOST_ECHOES;
use crate::wave::simd::{LANES, phasors};
use glam::DVec3;

/// The offsets at places closer to a cell's centre than this many radii are computed in f64.
const NEAR: f64 = 2.0;

/// The sums of one cell at one panel, without the path of its centre.
#[derive(Debug)]
pub(super) struct CellField {
    /// Numbers of nodes along x, y and z; `None` for the microphones themselves.
    pub(super) counts: Option<[usize; 3]>,
    /// `[place][K Q]`, each a real and an imaginary part, padded to [`CellField::width`]; nodes by z, y and x, x fastest.
    pub(super) sums: Vec<f32>,
}

impl CellField {
    /// The numbers of a place with so many columns, with padding.
    pub(super) fn width(columns: usize) -> usize {
        (2 * columns).next_multiple_of(2 * LANES)
    }
}

/// The inputs of every cell's sums.
#[derive(Debug, Clone, Copy)]
pub(super) struct CellSummation<'a> {
    pub(super) reflectors: &'a Reflectors,
    pub(super) tree: &'a CellTree<'a>,
    pub(super) instrument: &'a Instrument,
    pub(super) options: &'a SimulateOptions,
    /// Tones of a cell.
    pub(super) tones: &'a EquispacedTones,
    pub(super) terms: Option<&'a LossTerms>,
}

impl CellSummation<'_> {
    /// K Q.
    pub(super) fn columns(&self) -> usize {
        self.tones.count() * self.terms.map_or(1, LossTerms::count)
    }

    /// The sums of a cell; `None` if they do not fit in memory.
    pub(super) fn field(
        &self,
        cell: &ReflectorCell,
        panel: &MicrophonePanel,
        counts: Option<[usize; 3]>,
    ) -> Option<CellField> {
        let microphones = self.instrument.array.positions();
        let places = match counts {
            Some(counts) => panel.whole.nodes(counts),
            None => panel.microphones.iter().map(|&mic| microphones[mic]).collect(),
        };
        let columns = self.columns();
        let mut all = try_zeroed((places.len() * columns) as u64)?;
        let mut batch = ReflectorBatch::default();
        for members in self.tree.order[cell.members.clone()].chunks(MOST_ECHOES) {
            self.fill(members, cell, &mut batch);
            for (&place, sums) in places.iter().zip(all.chunks_exact_mut(columns)) {
                self.add(place, cell, &mut batch, sums);
            }
        }
        let width = CellField::width(columns);
        let mut sums = try_zeroed((places.len() * width) as u64)?;
        let of_places = all.chunks_exact(columns).zip(sums.chunks_exact_mut(width));
        for (place, (of_place, sums)) in places.iter().zip(of_places) {
            // Relative to the cell's centre, so that the field stays smooth.
            let scale = if self.options.losses.spreading {
                spreading_legs(self.instrument, *place, cell.centre)
            } else {
                1.0
            };
            for (padded, sum) in sums.iter_mut().zip(of_place.iter().flatten()) {
                *padded = (sum * scale) as f32;
            }
        }
        Some(CellField { counts, sums })
    }

    /// Fills a batch with some reflectors, relative to the cell's centre.
    fn fill(&self, members: &[u32], cell: &ReflectorCell, batch: &mut ReflectorBatch) {
        let Instrument { geometry, sound_speed, .. } = self.instrument;
        batch.resize(members.len());
        let middle = cell.outward_length(self.instrument);
        batch.directive.clear();
        if cell.directive {
            batch.directive.extend((0_u32..).zip(members).map(|(i, &j)| (i, j)));
        }
        let all = self.reflectors.positions();
        for (i, &j) in members.iter().enumerate() {
            let p = all[j as usize];
            batch.positions[i] = p;
            let transmit = self.reflectors.transmit(j as usize);
            batch.paths[i] = transmit.unwrap_or_else(|| geometry.outward_length(p));
            batch.from_middle[i] = batch.paths[i] - middle;
            for (plane, x) in batch.toward.iter_mut().zip((p - cell.centre).to_array()) {
                plane[i] = x as f32;
            }
        }
        phasors(self.tones.centre / sound_speed, &batch.from_middle, &mut batch.phasors);
        let per_metre = self.tones.step / sound_speed;
        for (i, &j) in members.iter().enumerate() {
            batch.turn[i] = (batch.from_middle[i] * per_metre) as f32;
            let spreading = match cell.transmit {
                // The amplitude has it.
                Some(_) => 1.0,
                None => outward_spreading(batch.paths[i], geometry, self.options) as f32,
            };
            let a = self.reflectors.amplitudes()[j as usize] * batch.phasors[i] * spreading;
            batch.amplitude[0][i] = a.re;
            batch.amplitude[1][i] = a.im;
        }
        if let Some(terms) = self.terms {
            let members = members.iter().map(|&j| j as usize);
            batch.losses.fill(terms, &members, &batch.positions, &batch.from_middle, cell.centre);
        }
    }

    /// Adds the batch's echoes at a place to its sums.
    fn add(&self, place: DVec3, cell: &ReflectorCell, batch: &mut ReflectorBatch, sums: &mut [[f64; 2]]) {
        let geometry = &self.instrument.geometry;
        let legs = geometry.return_legs();
        let (mut ends, mut count) = ([[0.0; 3]; 2], 0);
        for (n, end) in geometry.moving_ends(place).enumerate() {
            let q = end - cell.centre;
            let (distance, q) = (q.length(), q.as_vec3().to_array());
            if distance <= NEAR * cell.radius {
                // Close to the reflectors, the f32 series loses digits or does not converge.
                for (offset, p) in batch.of_leg.iter_mut().zip(&batch.positions) {
                    *offset = (legs * (p.distance(end) - distance)) as f32;
                }
            } else {
                let beside = [&batch.toward[0][..], &batch.toward[1], &batch.toward[2]];
                cell_offsets(beside, q, distance as f32, legs as f32, &mut batch.of_leg);
            }
            if n == 0 {
                std::mem::swap(&mut batch.offsets, &mut batch.of_leg);
            } else {
                batch.offsets.iter_mut().zip(&batch.of_leg).for_each(|(sum, of_leg)| *sum += of_leg);
            }
            (ends[n], count) = (q, n + 1);
        }
        let per_metre =
            [self.tones.centre, self.tones.step].map(|f| (f / self.instrument.sound_speed) as f32);
        batch.hear(|j| self.reflectors.directivity(j, place));
        batch.add(
            per_metre,
            self.terms,
            (&ends[..count], self.options.losses.spreading.then_some(legs)),
            sums,
        );
    }
}

/// By how much spreading over the legs that move with a microphone at `r` weakens the echo of `p`: their product, each 1 cm at least.
pub(super) fn spreading_legs(instrument: &Instrument, r: DVec3, p: DVec3) -> f64 {
    let geometry = &instrument.geometry;
    let legs = geometry.moving_ends(r).map(|end| end.distance(p).max(NEAREST_LEG));
    legs.product::<f64>().powf(geometry.return_legs())
}
