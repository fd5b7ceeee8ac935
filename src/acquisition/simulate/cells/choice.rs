//! The choice of cells, panels and tones, and whether they are worth while, by counted operations.

use super::nodes::{NodeRule, PanelBox};
use super::pair::{IntervalTones, TonePair};
use super::panels::{PanelSize, panel_sizes};
use super::tree::{CellTree, ReflectorCell};
use super::{CellPlan, HELD_MICROPHONES, MicrophonePanel, PropagationModel};
use crate::acquisition::simulate::SimulateOptions;
use crate::acquisition::simulate::cost::{
    ACROSS, FACTOR, HELD_SUMS, LEGS, MOST_CYCLES, MOST_INTERVALS, PADDING, PAIR, PHASE, PRODUCT, SORTING,
    TILE_SHARE, TONE,
};
use crate::acquisition::simulate::terms::{ChebyshevNodes, LossModel, LossTerms};
use crate::acquisition::simulate::virtual_tones::TONE_DESIGNS;
use crate::acquisition::{Instrument, Tile, tiles};
use crate::reflectors::Reflectors;
use crate::wave::Geometry;
use glam::DVec3;
use rayon::prelude::*;
use std::slice::from_ref;

/// Fewer reflectors, or cells of fewer on average, are not worth while.
pub(super) const FEWEST: usize = 16_384;
const FEWEST_OF_CELL: usize = 8;

/// The first design of intervals, and the last one of cells.
const FIRST_OF_INTERVALS: usize = 5;
const LAST_OF_CELLS: usize = 6;

/// Microphones of a tile.
pub(super) const TILE: usize = 64;

/// Operations of a cell at a tile, and for the delay of a cell at a microphone and each of its tones.
const CELL: f64 = 6000.0;
const DELAY: f64 = 100.0;
const TURN: f64 = 16.0;
/// Of a node's field at a row of microphones, or at a microphone, per tone.
const NODE: f64 = 8.0;
/// Of cutting a reflector's cell once more.
const CUT: f64 = 100.0;

/// Tones, and the losses that go with them.
#[derive(Debug)]
pub(super) struct CellTones {
    /// The designs of intervals and of cells.
    designs: [usize; 2],
    pair: TonePair,
    loss_nodes: ChebyshevNodes,
    /// Maximum error of the nodes.
    tolerance: f64,
}

/// The array as the tiles of some tones.
#[derive(Debug)]
struct TileSize {
    count: usize,
    /// Pairs of y and z that the microphones of a tile have, on average.
    rows: f64,
}

impl<'a> CellPlan<'a> {
    /// Whether there may be a plan.
    pub(in super::super) fn is_possible(
        reflectors: &Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> bool {
        let many = reflectors.len() >= FEWEST && instrument.array.len() > TILE;
        // Cells know exact paths only, none that bend, and of pairs those that are alike with speakers that radiate alike.
        let beams = options.losses.speaker_radius > 0.0;
        let differ = instrument.has_differing_pairs()
            || (beams && matches!(instrument.geometry, Geometry::Pair { .. }));
        many && options.model == PropagationModel::Exact && instrument.interface.is_none() && !differ
    }

    /// The plan with the fewest operations, if they are fewer than `most`.
    pub(in super::super) fn find(
        reflectors: &'a Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
        most: f64,
    ) -> Option<Self> {
        if !Self::is_possible(reflectors, instrument, options) {
            return None;
        }
        let mut all = cell_tones(reflectors, instrument, options);
        // From the largest cells to the smallest, so that they are only cut further.
        all.sort_by(|a, b| b.pair.local.duration.total_cmp(&a.pair.local.duration));
        let positions = instrument.array.positions();
        let sizes = panel_sizes(positions);
        let of_tile = |tile: Tile| {
            let rows = rows_of(&tile, positions);
            (tile, rows)
        };
        let known: Vec<_> = tiles(positions, TILE, f64::INFINITY).into_iter().map(of_tile).collect();
        let mut tree = CellTree::new(reflectors)?;
        let mut best: Option<(f64, usize, usize, Vec<ReflectorCell>)> = None;
        for (index, tones) in all.iter().enumerate() {
            let radius = tones.radius(instrument);
            if radius * instrument.sweep.stop() * instrument.geometry.scanned_legs()
                > MOST_CYCLES * instrument.sound_speed
            {
                continue;
            }
            tree.cut(radius);
            if tree.cells.len() * FEWEST_OF_CELL > reflectors.len() {
                break;
            }
            let tile = tones.tile_size(instrument, &known);
            let costs = sizes.par_iter().map(|size| tones.cost(&tree, size, &tile, instrument, options));
            let costs: Vec<f64> = costs.collect();
            for (size, cost) in costs.into_iter().enumerate() {
                if cost < best.as_ref().map_or(most, |best| best.0) {
                    best = Some((cost, index, size, tree.cells.clone()));
                }
            }
        }
        let (_, index, size, cells) = best?;
        tree.cells = cells;
        let tones = all.swap_remove(index);
        tones.plan(tree, &sizes[size], reflectors, instrument, options)
    }
}

#[cfg(test)]
impl<'a> CellPlan<'a> {
    /// The plan with some tones and panels of some size, whatever it costs; `None` if tones do not meet the tolerance.
    pub(in super::super) fn forced(
        reflectors: &'a Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
        [tones, size]: [usize; 2],
    ) -> Option<Self> {
        let mut all = cell_tones(reflectors, instrument, options);
        let sizes = panel_sizes(instrument.array.positions());
        let tones = all.swap_remove(tones.checked_rem(all.len())?);
        let mut tree = CellTree::new(reflectors)?;
        tree.cut(tones.radius(instrument));
        tones.plan(tree, &sizes[size % sizes.len()], reflectors, instrument, options)
    }

    /// How many cells at panels have nodes, and how many are too close for them.
    pub(in super::super) fn interpolated(&self) -> [usize; 2] {
        let pairs =
            self.panels.iter().flat_map(|panel| self.tree.cells.iter().map(move |cell| (cell, panel)));
        let counts = pairs.map(|(cell, panel)| {
            usize::from(self.rule.counts_for(cell, &panel.whole, panel.microphones.len()).is_none())
        });
        counts.fold([0; 2], |mut all, without| {
            all[without] += 1;
            all
        })
    }
}

/// Pairs of y and z that the microphones of a tile have.
fn rows_of(tile: &Tile, positions: &[DVec3]) -> usize {
    let of = |&mic: &usize| [positions[mic].y.to_bits(), positions[mic].z.to_bits()];
    let mut rows: Vec<_> = tile.microphones.iter().map(of).collect();
    rows.sort_unstable();
    rows.dedup();
    rows.len()
}

/// All tones of intervals and cells that meet the tolerance.
fn cell_tones(reflectors: &Reflectors, instrument: &Instrument, options: &SimulateOptions) -> Vec<CellTones> {
    let model = LossModel::new(reflectors, instrument, options);
    let of_intervals = |design: usize| {
        Some((design, IntervalTones::find(&model, TONE_DESIGNS[design], instrument, options)?))
    };
    let found: Vec<_> =
        (FIRST_OF_INTERVALS..TONE_DESIGNS.len()).into_par_iter().filter_map(of_intervals).collect();
    found
        .par_iter()
        .flat_map_iter(|(design, tones)| {
            (0..=LAST_OF_CELLS).filter_map(move |local| CellTones::with(tones, [*design, local], instrument))
        })
        .collect()
}

impl CellTones {
    /// Those of two designs, if they meet the tolerance.
    pub(super) fn of(
        designs: [usize; 2],
        reflectors: &Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> Option<Self> {
        let (model, design) =
            (LossModel::new(reflectors, instrument, options), *TONE_DESIGNS.get(designs[0])?);
        Self::with(&IntervalTones::find(&model, design, instrument, options)?, designs, instrument)
    }

    /// Some tones of intervals with those of cells, if both meet the tolerance.
    fn with(of_intervals: &IntervalTones, designs: [usize; 2], instrument: &Instrument) -> Option<Self> {
        let IntervalTones { tones, loss_nodes, tolerance } = of_intervals;
        let pair = TonePair::find(tones, &instrument.sweep, *TONE_DESIGNS.get(designs[1])?, *tolerance)?;
        Some(Self { designs, pair, loss_nodes: loss_nodes.clone(), tolerance: *tolerance })
    }

    /// The maximum radius of a cell, m: both the way to a reflector and the ways back differ by no more than its distance from
    /// the centre, and twice that is half a duration.
    fn radius(&self, instrument: &Instrument) -> f64 {
        0.25 * self.pair.local.duration * instrument.sound_speed
    }

    /// The length of path in which the centres of an interval's cells are, at all microphones of a tile, m.
    fn length(&self, instrument: &Instrument) -> f64 {
        (self.pair.tones.duration - self.pair.local.duration) * instrument.sound_speed
    }

    /// The maximum radius of a tile, m.
    fn tile_radius(&self, instrument: &Instrument) -> f64 {
        0.5 * TILE_SHARE * self.length(instrument) / instrument.geometry.scanned_legs()
    }

    /// The array as these tones' tiles: those that are `known` whatever the tones, cut further where they are too large.
    fn tile_size(&self, instrument: &Instrument, known: &[(Tile, usize)]) -> TileSize {
        let (radius, positions) = (self.tile_radius(instrument), instrument.array.positions());
        let (mut count, mut sum) = (0, 0);
        for (tile, rows) in known {
            if tile.radius <= radius {
                (count, sum) = (count + 1, sum + rows);
                continue;
            }
            let cut = Tile::cut_further(from_ref(tile), positions, TILE, radius);
            (count, sum) =
                (count + cut.len(), sum + cut.iter().map(|tile| rows_of(tile, positions)).sum::<usize>());
        }
        TileSize { count, rows: sum as f64 / count as f64 }
    }

    fn rule(&self, instrument: &Instrument, options: &SimulateOptions) -> NodeRule {
        let Instrument { sweep, geometry, sound_speed, .. } = instrument;
        let per_metre = geometry.return_legs() * sweep.stop() / sound_speed;
        // A piston is as selective as reflectors spread over it.
        let piston = options.losses.microphone_radius + options.losses.speaker_radius;
        NodeRule::new(per_metre, 0.5 * self.tolerance, piston).with_ends(geometry.moving_ends(DVec3::ZERO))
    }

    /// Operations with panels of one size.
    fn cost(
        &self,
        tree: &CellTree<'_>,
        size: &PanelSize,
        tile: &TileSize,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> f64 {
        let Instrument { sweep, array, .. } = instrument;
        let (n_mic, n_f, n_p) = (array.len() as f64, sweep.len() as f64, tree.order.len() as f64);
        let terms = self.loss_nodes.nodes.len() as f64;
        let (tones, local) = (self.pair.tones.count() as f64, self.pair.local.count() as f64);
        let rule = self.rule(instrument, options);
        let length = self.length(instrument);
        let groups = path_spread(tree, instrument) / (length * (1.0 - 0.7 * TILE_SHARE)) + 1.0;
        if groups > MOST_INTERVALS || self.held(groups) < size.panels[0].microphones.len() as f64 {
            return f64::INFINITY;
        }
        let lossy = f64::from(u8::from(options.losses.any()));
        let echo = lossy * LEGS + terms * (PAIR + lossy * FACTOR + TONE * local);
        let tiles = tile.count as f64;
        let delayed = n_mic * (DELAY + terms * tones * (TURN + PRODUCT * local));
        let mut all = 0.0;
        for like in tree.cells.chunk_by(ReflectorCell::is_like) {
            let members = like.iter().map(|cell| cell.members.len()).sum::<usize>() as f64;
            let (places, [nodes, along_x]) = size.places(like, &rule);
            let cells = like.len() as f64;
            let summed = size.panels.len() as f64
                * places
                * ((members + PADDING * cells) * echo + cells * ACROSS * terms * local);
            let interpolated = NODE * terms * local * (tile.rows * tiles * nodes + n_mic * along_x);
            all += summed + cells * (interpolated + delayed + CELL * tiles);
        }
        let expanded = n_mic * groups * n_f * (PHASE + PRODUCT * terms * tones);
        all + expanded + n_p * (SORTING + 20.0 * CUT)
    }

    /// Microphones whose sums are in memory at a time.
    fn held(&self, groups: f64) -> f64 {
        let columns = self.pair.tones.count() * self.loss_nodes.nodes.len();
        (HELD_SUMS / (groups * columns as f64)).min(HELD_MICROPHONES)
    }

    /// The plan with these tones; `None` if a loss is not a smooth function.
    pub(super) fn plan<'a>(
        self,
        tree: CellTree<'a>,
        size: &PanelSize,
        reflectors: &Reflectors,
        instrument: &Instrument,
        options: &SimulateOptions,
    ) -> Option<CellPlan<'a>> {
        let rule = self.rule(instrument, options);
        let radius = self.tile_radius(instrument);
        let positions = instrument.array.positions();
        let (mut panels, mut all): (_, Vec<Tile>) = (Vec::new(), Vec::new());
        for panel in &size.panels {
            let first = all.len();
            all.extend(Tile::cut_further(from_ref(panel), positions, TILE, radius));
            let microphones = all[first..].iter().flat_map(|tile| &tile.microphones).copied().collect();
            panels.push(MicrophonePanel { whole: PanelBox::of(panel), microphones, tiles: first..all.len() });
        }
        let groups = path_spread(&tree, instrument) / (self.length(instrument) * (1.0 - TILE_SHARE)) + 1.0;
        let held = self.held(groups) as usize;
        let choice = [self.designs[0], self.designs[1], size.times];
        let TonePair { mut tones, local } = self.pair;
        let mut weights = std::mem::take(&mut tones.weights);
        let (mut terms, mut absorption) = (None, Vec::new());
        if options.losses.any() {
            let model = LossModel::new(reflectors, instrument, options);
            let half = 0.5 * tones.duration * instrument.sound_speed;
            let losses = LossTerms::new(&self.loss_nodes, &model, half, reflectors, instrument, options)?;
            weights = losses.weights(&weights);
            terms = Some(losses);
            if options.losses.air.is_some() {
                absorption = self.loss_nodes.nodes.iter().map(|&f| options.losses.absorption(f)).collect();
            }
        }
        Some(CellPlan {
            choice,
            tree,
            panels,
            tiles: all,
            rule,
            tones,
            local,
            terms,
            absorption,
            weights,
            held,
        })
    }
}

/// The difference of the longest and the shortest path to the array, about.
fn path_spread(tree: &CellTree<'_>, instrument: &Instrument) -> f64 {
    let Instrument { array, geometry, .. } = instrument;
    let centre = array.centre();
    let paths = tree.cells.iter().map(|cell| match cell.transmit {
        Some([middle, _]) => middle + cell.centre.distance(centre),
        None => geometry.path_length(cell.centre, centre),
    });
    let (low, high) =
        paths.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), path| (path.min(low), path.max(high)));
    high - low + array.extent().length()
}
