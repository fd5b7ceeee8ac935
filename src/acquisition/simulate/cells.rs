//! The simulation by cells, for many reflectors: boxes of them are summed at a few nodes of large panels of microphones.
//!
//! With the path of a cell's centre taken out, its field at the microphones of a panel is smooth in space and in frequency.
//! It is [summed](sums) at a few [nodes](nodes) of the panel and a few tones, fewer the smaller the [cell](tree), and from there
//! [interpolated](gather) to the microphones, tile by tile: first the field, then its tones, which make those of the tile's
//! intervals of path length. These are expanded into all frequencies as elsewhere. So a reflector is summed at some hundred
//! nodes instead of at every microphone. A count of operations chooses cells, panels and tones ([choice]).
//!
//! Where a cell is too close to a panel, its microphones are the nodes.

mod choice;
mod gather;
mod nodes;
mod pair;
mod panels;
mod sums;
mod tree;

use super::columns::Columns;
use super::cost::HELD_SUMS;
use super::echoes::GroupSums;
use super::expand::Expansion;
use super::stored::PlanNumbers;
use super::terms::LossTerms;
use super::virtual_tones::{EquispacedTones, TONE_DESIGNS};
use super::{PropagationModel, SimulateOptions, SimulationJob, no_room};
use crate::acquisition::{Instrument, Tile};
use crate::error::Result;
use crate::progress::{Observer, advance};
use crate::reflectors::Reflectors;
use choice::{CellTones, FEWEST, TILE};
use gather::{GatherBuffers, TileGather};
use nodes::{NodeRule, PanelBox};
use num_complex::Complex32;
use panels::PanelSize;
use rayon::prelude::*;
use std::ops::Range;
use sums::{CellField, CellSummation};
use tree::CellTree;

/// Microphones at whose nodes cells are summed.
#[derive(Debug)]
struct MicrophonePanel {
    whole: PanelBox,
    /// Their indices in the array, tile after tile.
    microphones: Vec<usize>,
    /// Its tiles among those of the plan.
    tiles: Range<usize>,
}

/// Cells, panels, tones and terms of a simulation.
#[derive(Debug)]
pub(super) struct CellPlan<'a> {
    /// The designs of tones, and how often the array is halved into panels.
    choice: [usize; 3],
    tree: CellTree<'a>,
    panels: Vec<MicrophonePanel>,
    tiles: Vec<Tile>,
    rule: NodeRule,
    /// Tones of an interval of path lengths, and of a cell, which make those of an interval.
    tones: EquispacedTones,
    local: EquispacedTones,
    /// Losses, if there are any, and α at their frequencies, Np/m; empty without absorption.
    terms: Option<LossTerms>,
    absorption: Vec<f64>,
    /// Weights of the expansion, `[n_f][K Q]`.
    weights: Vec<f32>,
    /// Microphones whose sums are in memory at a time; at least one panel.
    held: usize,
}

/// Maximum number of sums of cells in memory, 4 bytes each, and of microphones whose sums are in memory at a time.
const HELD_FIELDS: usize = 8_388_608;
const HELD_MICROPHONES: f64 = 16_384.0;

/// Bytes of the weights of nodes for a microphone, about: as many as there are nodes along x, and along y, for ten numbers
/// of nodes.
const WEIGHTS: u64 = 2048;

/// Estimated bytes of the sums of so many `reflectors` by cells, if they are many enough, where there are so many groups in
/// intervals of the longest duration, with K terms.
pub(super) fn bytes(reflectors: u64, microphones: usize, groups: f64, terms: usize) -> u64 {
    if reflectors < FEWEST as u64 || microphones <= TILE {
        return 0;
    }
    let held = (microphones as f64).min(HELD_MICROPHONES);
    let columns = (2 * TONE_DESIGNS[TONE_DESIGNS.len() - 1].pairs + 1) * terms;
    let sums = (held * groups * columns as f64).min(HELD_SUMS);
    (size_of::<f32>() * HELD_FIELDS) as u64
        + size_of::<Complex32>() as u64 * sums as u64
        + WEIGHTS * held as u64
}

impl<'a> CellPlan<'a> {
    /// The numbers by which another process finds it.
    pub(super) fn numbers(&self) -> PlanNumbers {
        let chosen = self.choice.map(|chosen| chosen as u32);
        let cells = self.tree.cells.iter().map(|cell| cell.members.clone());
        PlanNumbers { chosen, order: self.tree.order.clone(), parts: cells.collect() }
    }

    /// The plan of such numbers; `None` if they are none of this job.
    pub(super) fn of_numbers(
        PlanNumbers { chosen, order, parts }: PlanNumbers,
        reflectors: &'a Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> Option<Self> {
        let [intervals, cells, times] = chosen.map(|chosen| chosen as usize);
        if order.len() != reflectors.len() || !Self::is_possible(reflectors, instrument, options) {
            return None;
        }
        let size = PanelSize::new(instrument.array.positions(), times)?;
        let tones = CellTones::of([intervals, cells], reflectors, instrument, options)?;
        let tree = CellTree::in_order(reflectors, order, parts);
        tones.plan(tree, &size, reflectors, instrument, options)
    }
}

impl CellPlan<'_> {
    /// K Q of an interval: sums per microphone.
    fn columns(&self) -> usize {
        self.tones.count() * self.terms.as_ref().map_or(1, LossTerms::count)
    }

    /// Fills the samples, `[n_f, n_mic]`.
    pub(super) fn simulate(
        &self,
        job: &SimulationJob<'_>,
        columns: &mut Columns,
        observer: &dyn Observer,
    ) -> Result<()> {
        let mut missing = vec![false; self.tiles.len()];
        for (k, (tile, missing)) in self.tiles.iter().zip(&mut missing).enumerate() {
            if columns.load(k, &tile.microphones)? {
                advance(observer, tile.microphones.len() as u64)?;
            } else {
                *missing = true;
            }
        }
        let is_missing = |panel: &&MicrophonePanel| panel.tiles.clone().any(|k| missing[k]);
        let panels: Vec<&MicrophonePanel> = self.panels.iter().filter(is_missing).collect();
        let mut rest = &panels[..];
        while !rest.is_empty() {
            // As many panels as the limit allows; their grouping does not affect the sums.
            let mut held = 0;
            let fitting = rest.iter().take_while(|panel| {
                held += panel.microphones.len();
                held <= self.held
            });
            let (panels, later) = rest.split_at(fitting.count().max(1));
            rest = later;
            self.fill(panels, &missing, job, columns, observer)?;
            columns.save_if_due()?;
        }
        Ok(())
    }

    /// Fills the missing tiles of some panels.
    fn fill(
        &self,
        panels: &[&MicrophonePanel],
        missing: &[bool],
        job: &SimulationJob<'_>,
        columns: &mut Columns,
        observer: &dyn Observer,
    ) -> Result<()> {
        let mut places = Vec::new();
        for (at, panel) in panels.iter().enumerate() {
            let mut first = 0;
            for k in panel.tiles.clone() {
                if missing[k] {
                    places.push((at, k, first));
                }
                first += self.tiles[k].microphones.len();
            }
        }
        let mut gathers: Vec<TileGather<'_>> = places
            .par_iter()
            .map(|&(at, k, first)| TileGather::new(self, job, panels[at], &self.tiles[k], first))
            .collect::<Option<_>>()
            .ok_or_else(no_room)?;
        let summation = CellSummation {
            reflectors: job.reflectors,
            tree: &self.tree,
            instrument: job.instrument,
            options: job.options,
            tones: &self.local,
            terms: self.terms.as_ref(),
        };
        // A cell has at most as many nodes as its panel has microphones.
        let most: usize = panels.iter().map(|panel| panel.microphones.len()).sum();
        let at_a_time = (HELD_FIELDS / (most * CellField::width(summation.columns()))).max(1);
        let cells: Vec<usize> = (0..self.tree.cells.len()).collect();
        let (count, mut done, mut reported) =
            (places.iter().map(|&(_, k, _)| self.tiles[k].microphones.len()).sum::<usize>(), 0, 0);
        for some in cells.chunks(at_a_time) {
            let fields: Vec<CellField> = (0..panels.len() * some.len())
                .into_par_iter()
                .map(|i| {
                    let (panel, cell) = (panels[i / some.len()], &self.tree.cells[some[i % some.len()]]);
                    let counts = self.rule.counts_for(cell, &panel.whole, panel.microphones.len());
                    summation.field(cell, panel, counts)
                })
                .collect::<Option<_>>()
                .ok_or_else(no_room)?;
            gathers.par_iter_mut().zip(&places).for_each_init(
                GatherBuffers::default,
                |buffers, (gather, (at, _, _))| {
                    for (cell, field) in some.iter().zip(&fields[at * some.len()..]) {
                        gather.add(*cell, field, buffers);
                    }
                },
            );
            done += some.len();
            let finished = count * done / cells.len();
            advance(observer, (finished - reported) as u64)?;
            reported = finished;
        }
        let sums: Vec<Vec<GroupSums>> =
            gathers.into_iter().map(TileGather::finish).collect::<Option<_>>().ok_or_else(no_room)?;
        let tiles: Vec<(usize, &Tile)> = places.iter().map(|&(_, k, _)| (k, &self.tiles[k])).collect();
        Expansion::new(&self.weights, self.terms.as_ref()).record(job, &tiles, &sums, columns)
    }
}
