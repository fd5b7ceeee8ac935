//! The fields of all cells at one tile: interpolated to its microphones, turned by the delay of each cell, and added up by
//! path length.
//!
//! As reflectors elsewhere, cells are sorted into intervals of path length, each with tones of its own. A cell's few tones make
//! those of its interval by one fixed matrix, because both are about the same centre.

use super::sums::{CellField, spreading_legs};
use super::tree::ReflectorCell;
use super::{CellPlan, MicrophonePanel, PropagationModel};
use crate::acquisition::simulate::echoes::{CentrePath, GroupSums, Intervals};
use crate::acquisition::simulate::terms::LossTerms;
use crate::acquisition::simulate::{SimulateOptions, SimulationJob};
use crate::acquisition::{Instrument, Tile};
use crate::alloc::{try_with_capacity, try_zeroed};
use crate::linalg::product_f32;
use crate::wave::cells::{microphones_last, turn_and_add};
use crate::wave::simd::rows::weighted_rows;
use crate::wave::simd::{LANES, phasors};
use glam::DVec3;
use num_complex::Complex32;
use std::collections::BTreeMap;

/// The sums of a tile while cells are added to them.
#[derive(Debug)]
pub(super) struct TileGather<'a> {
    plan: &'a CellPlan<'a>,
    instrument: &'a Instrument,
    options: &'a SimulateOptions,
    panel: &'a MicrophonePanel,
    tile: &'a Tile,
    /// Where its microphones begin among those of the panel.
    first: usize,
    positions: Vec<DVec3>,
    intervals: Intervals,
    /// The intervals of some cell, ascending.
    places: Vec<u64>,
    /// Of every interval, `[K Q][2 × padded microphones]`.
    totals: Vec<Vec<f32>>,
    /// Pairs of y and z, m, and the pair of each microphone.
    rows: Vec<[f64; 2]>,
    row: Vec<usize>,
    /// Weights of nodes along y and z, `[row][z][y]`, and along x, `[microphone][x]`.
    row_weights: BTreeMap<[usize; 2], Vec<f32>>,
    x_weights: BTreeMap<usize, Vec<f32>>,
}

/// Buffers of a thread. Numbers beyond the last microphone of a tile are of another one; nothing reads their sums.
#[derive(Debug, Default)]
pub(super) struct GatherBuffers {
    along_rows: Vec<f32>,
    /// Some microphones' sums, and those of all, `[K Q][2 × padded microphones]`.
    some: Vec<f32>,
    all: Vec<f32>,
    tones: Vec<f32>,
    paths: Vec<f64>,
    phasors: [Vec<Complex32>; 2],
    /// Centre and step of the phasors, and the centre with the losses of a term, each as real and imaginary parts.
    planes: [[Vec<f32>; 2]; 3],
}

impl<'a> TileGather<'a> {
    /// Nothing yet; `None` if the sums do not fit in memory.
    pub(super) fn new(
        plan: &'a CellPlan<'a>,
        job: &SimulationJob<'a>,
        panel: &'a MicrophonePanel,
        tile: &'a Tile,
        first: usize,
    ) -> Option<Self> {
        let SimulationJob { instrument, options, .. } = *job;
        let cells = &plan.tree.cells;
        let mut paths = try_with_capacity(cells.len() as u64)?;
        paths.extend(cells.iter().map(|cell| cell.centre_path(tile, instrument)));
        let intervals = plan.intervals(&paths, instrument.sound_speed);
        let mut places: Vec<u64> = paths.iter().map(|path| intervals.place(path.length)).collect();
        places.sort_unstable();
        places.dedup();
        let positions: Vec<DVec3> =
            tile.microphones.iter().map(|&mic| instrument.array.positions()[mic]).collect();
        let width = 2 * positions.len().next_multiple_of(LANES);
        let length = (plan.columns() * width) as u64;
        let totals = places.iter().map(|_| try_zeroed(length)).collect::<Option<_>>()?;
        let mut rows: Vec<[f64; 2]> = Vec::new();
        let mut row = Vec::with_capacity(positions.len());
        for r in &positions {
            let own = [r.y, r.z];
            row.push(rows.iter().position(|row| *row == own).unwrap_or(rows.len()));
            if row.last() == Some(&rows.len()) {
                rows.push(own);
            }
        }
        Some(Self {
            plan,
            instrument,
            options,
            panel,
            tile,
            first,
            positions,
            intervals,
            places,
            totals,
            rows,
            row,
            row_weights: BTreeMap::new(),
            x_weights: BTreeMap::new(),
        })
    }

    /// Adds a cell.
    pub(super) fn add(&mut self, cell: usize, field: &CellField, buffers: &mut GatherBuffers) {
        let (local, tones) = (self.plan.local.count(), self.plan.tones.count());
        let terms = self.plan.terms.as_ref().map_or(1, LossTerms::count);
        let padded = self.positions.len().next_multiple_of(LANES);
        self.interpolate(field, terms * local, buffers);
        let cell = &self.plan.tree.cells[cell];
        let place = self.intervals.place(cell.centre_path(self.tile, self.instrument).length);
        let middle = self.intervals.middle(place);
        let Ok(group) = self.places.binary_search(&place) else { return };
        self.turn(cell, middle, buffers);
        let width = 2 * padded;
        for k in 0..terms {
            buffers.tones.resize(tones * width, 0.0);
            let sums = &buffers.all[k * local * width..][..local * width];
            product_f32(&mut buffers.tones, sums, &self.plan.local.weights, [width, local, tones]);
            let [centre, step, weighted] = &mut buffers.planes;
            for (weighted, centre) in weighted.iter_mut().zip(&*centre) {
                weighted.clear();
                weighted.extend_from_slice(centre);
            }
            if let Some(absorption) = self.plan.absorption.get(k) {
                for (i, path) in buffers.paths.iter().enumerate() {
                    let factor = (-absorption * path).exp() as f32;
                    for plane in weighted.iter_mut() {
                        plane[i] *= factor;
                    }
                }
            }
            let planes = [&*weighted, &*step].map(|[re, im]| [&re[..], &im[..]]);
            let totals = &mut self.totals[group][k * tones * width..][..tones * width];
            turn_and_add(planes[0], planes[1], &buffers.tones, totals);
        }
    }

    /// The field at the microphones, in `buffers.all`.
    fn interpolate(&mut self, field: &CellField, columns: usize, buffers: &mut GatherBuffers) {
        let (count, width) = (self.positions.len(), CellField::width(columns));
        let padded = count.next_multiple_of(LANES);
        let GatherBuffers { along_rows, some, all, .. } = buffers;
        all.resize(width * padded, 0.0);
        let Some([nx, ny, nz]) = field.counts else {
            let own = &field.sums[self.first * width..][..count * width];
            for (block, some) in own.chunks(LANES * width).enumerate() {
                microphones_last(some, width, &mut all[block * LANES..], padded);
            }
            return;
        };
        let whole = &self.panel.whole;
        let rows = self.row_weights.entry([ny, nz]).or_insert_with(|| {
            let of_row = |[y, z]: &[f64; 2]| {
                let (ys, zs) = (whole.weights(1, ny, *y), whole.weights(2, nz, *z));
                zs.into_iter().flat_map(move |z| ys.clone().into_iter().map(move |y| (y * z) as f32))
            };
            self.rows.iter().flat_map(of_row).collect()
        });
        let along_x = self.x_weights.entry(nx).or_insert_with(|| {
            let of_microphone = |r: &DVec3| whole.weights(0, nx, r.x).into_iter().map(|w| w as f32);
            self.positions.iter().flat_map(of_microphone).collect()
        });
        along_rows.resize(nx * width * self.rows.len(), 0.0);
        let of_rows: Vec<(usize, &[f32])> = rows.chunks_exact(ny * nz).map(|weights| (0, weights)).collect();
        weighted_rows(&of_rows, &field.sums, nx * width, along_rows);
        some.resize(LANES * width, 0.0);
        let microphones = self.row.chunks(LANES).zip(along_x.chunks(LANES * nx));
        for (block, (row, weights)) in microphones.enumerate() {
            let places: Vec<(usize, &[f32])> =
                row.iter().map(|row| row * nx * width).zip(weights.chunks_exact(nx)).collect();
            weighted_rows(&places, along_rows, width, &mut some[..places.len() * width]);
            microphones_last(some, width, &mut all[block * LANES..], padded);
        }
    }

    /// The phasors of the cell's centre at the microphones, in `buffers.planes`.
    fn turn(&self, cell: &ReflectorCell, middle: f64, buffers: &mut GatherBuffers) {
        let Instrument { geometry, sound_speed, .. } = self.instrument;
        let legs = geometry.return_legs();
        let padded = self.positions.len().next_multiple_of(LANES);
        let outward = cell.outward_length(self.instrument) - middle;
        let GatherBuffers { paths, phasors: turns, planes, .. } = buffers;
        paths.clear();
        paths.extend(self.positions.iter().map(|r| {
            let moving = geometry.moving_ends(*r).map(|end| legs * end.distance(cell.centre));
            moving.fold(outward, |sum, leg| sum + leg)
        }));
        for (turns, f) in turns.iter_mut().zip([self.plan.tones.centre, self.plan.tones.step]) {
            turns.resize(paths.len(), Complex32::ZERO);
            phasors(f / sound_speed, paths, turns);
        }
        if self.options.losses.spreading {
            for (z, r) in turns[0].iter_mut().zip(&self.positions) {
                *z *= spreading_legs(self.instrument, *r, cell.centre).recip() as f32;
            }
        }
        for ([re, im], turns) in planes.iter_mut().zip(&*turns) {
            for plane in [&mut *re, &mut *im] {
                plane.resize(padded, 0.0);
            }
            for ((re, im), z) in re.iter_mut().zip(im).zip(turns) {
                (*re, *im) = (z.re, z.im);
            }
        }
    }

    /// The sums by interval; `None` if they do not fit in memory.
    pub(super) fn finish(self) -> Option<Vec<GroupSums>> {
        let (count, padded) = (self.positions.len(), self.positions.len().next_multiple_of(LANES));
        let groups = self.places.iter().zip(self.totals).map(|(place, totals)| {
            let mut sums = try_with_capacity((totals.len() / padded * count) as u64)?;
            sums.extend(totals.chunks_exact(padded).flat_map(|part| &part[..count]));
            Some(GroupSums { middle: self.intervals.middle(*place), sums })
        });
        groups.collect()
    }
}

impl ReflectorCell {
    /// The path of its centre to that of a tile.
    fn centre_path(&self, tile: &Tile, instrument: &Instrument) -> CentrePath {
        let outward = self.outward_length(instrument);
        CentrePath::new(self.centre, outward, tile, instrument, PropagationModel::Exact)
    }
}

impl CellPlan<'_> {
    /// Intervals in which every path via a cell stays, not only that of its centre.
    fn intervals(&self, paths: &[CentrePath], sound_speed: f64) -> Intervals {
        Intervals::new(paths, (self.tones.duration - self.local.duration) * sound_speed)
    }
}
