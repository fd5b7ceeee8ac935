//! The panels of microphones that are considered, of one size after another.

use super::choice::TILE;
use super::nodes::{NodeRule, PanelBox};
use super::tree::ReflectorCell;
use crate::acquisition::{Tile, tiles};
use glam::DVec3;

/// Cells and panels that are sampled for the estimate.
const SAMPLED_CELLS: usize = 12;
const SAMPLED_PANELS: usize = 3;

/// Panels of one size.
#[derive(Debug)]
pub(super) struct PanelSize {
    /// How often the array is halved.
    pub(super) times: usize,
    pub(super) panels: Vec<Tile>,
}

/// The panels that are considered: the array, and its halves, quarters .. as long as they have several tiles.
pub(super) fn panel_sizes(positions: &[DVec3]) -> Vec<PanelSize> {
    std::iter::successors(PanelSize::new(positions, 0), |last| last.halved(positions)).collect()
}

/// Most microphones of a panel where the array is halved so often; `None` for fewer than a tile has.
fn panel_microphones(positions: &[DVec3], times: usize) -> Option<usize> {
    let count = positions.len().div_ceil(1usize.checked_shl(u32::try_from(times).ok()?)?);
    (times == 0 || count >= TILE).then_some(count)
}

impl PanelSize {
    /// Of an array that is halved so often; `None` if its parts are smaller than a tile.
    pub(super) fn new(positions: &[DVec3], times: usize) -> Option<Self> {
        let count = panel_microphones(positions, times)?;
        Some(Self { times, panels: tiles(positions, count, f64::INFINITY) })
    }

    /// Of the array halved once more, in less time.
    fn halved(&self, positions: &[DVec3]) -> Option<Self> {
        let times = self.times + 1;
        let count = panel_microphones(positions, times)?;
        Some(Self { times, panels: Tile::cut_further(&self.panels, positions, count, f64::INFINITY) })
    }

    /// The places at which a cell is summed at a panel, on average, and its nodes, all and along x; 0 where it has none.
    pub(super) fn places(&self, cells: &[ReflectorCell], rule: &NodeRule) -> (f64, [f64; 2]) {
        let every = |count: usize, most: usize| count.div_ceil(most);
        let (mut places, mut nodes, mut along_x, mut sampled) = (0.0, 0.0, 0.0, 0.0);
        for cell in cells.iter().step_by(every(cells.len(), SAMPLED_CELLS)) {
            for panel in self.panels.iter().step_by(every(self.panels.len(), SAMPLED_PANELS)) {
                let microphones = panel.microphones.len();
                let counts = rule.counts_for(cell, &PanelBox::of(panel), microphones);
                places += counts.map_or(microphones, |counts| counts.iter().product()) as f64;
                nodes += counts.map_or(0, |counts| counts.iter().product()) as f64;
                along_x += counts.map_or(0, |counts| counts[0]) as f64;
                sampled += 1.0;
            }
        }
        (places / sampled, [nodes / sampled, along_x / sampled])
    }
}
