//! Zones of ranges, each with nodes of its own along x and y.
//!
//! From farther away a tile's microphones are seen in directions that differ less, so its image changes more slowly
//! sideways, and fewer nodes serve. A place is first made of nodes along y and x at every ρ, and along ρ last, so that no zone
//! needs nodes beyond its ends.

use super::frame::bands;
use super::nodes::{TileLattice, usual_count};
use super::terms::{Terms, TileDistances};
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::IntervalNodes;
use crate::wave::simd::rows::WIDE;
use std::ops::Range;

/// The most zones of a tile, and how many of the columns of the one before it each may have, to be worth its weights.
const MOST_ZONES: usize = 4;
const FEWER: f64 = 0.9;

/// The nodes along x and y that a tile has at some ranges.
#[derive(Debug, Clone)]
pub(crate) struct Zone {
    /// The first node along ρ at which it has them.
    pub(crate) from: usize,
    /// How much of all ranges that is.
    pub(crate) share: f64,
    pub(crate) nodes: [IntervalNodes; 2],
}

impl Zone {
    /// At all ranges.
    pub(crate) fn whole(nodes: [IntervalNodes; 2]) -> Self {
        Self { from: 0, share: 1.0, nodes }
    }

    /// Columns of nodes.
    pub(crate) fn columns(&self) -> usize {
        self.nodes[0].len() * self.nodes[1].len()
    }
}

impl TileLattice {
    /// The same with the fewer nodes along x and y, the farther away these are; what that errs by is not yet measured.
    pub(crate) fn zoned(&self, terms: &Terms<'_>, distances: &TileDistances, budget: ErrorBudget) -> Self {
        let node = |range: f64| (range / self.pitch).max(0.0) as usize;
        let (first, last) = (node(distances.shortest), node(distances.longest) + 1);
        // Zones as long as they are far away, so that each saves as much; those before the last in whole vectors.
        let whole = |node: f64| (node / WIDE as f64).round() as usize * WIDE;
        let farther = last as f64 / first.max(1) as f64;
        let begin = |zone: usize| {
            let grown = farther.powf(zone as f64 / MOST_ZONES as f64);
            whole(first as f64 * grown)
        };
        let mut begins: Vec<usize> = (1..MOST_ZONES).map(begin).collect();
        begins.dedup();
        begins.retain(|from| first < *from && *from < last);
        let tolerance = budget.interpolation_axis_of_few();
        let nodes = |from: usize| {
            let bands = bands(&Terms { from: self.pitch * from as f64, ..*terms });
            [0, 1].map(|axis: usize| {
                let nearest = self.sideways()[axis];
                let places = terms.points.along(axis);
                let ends = [places[0], places[places.len() - 1]];
                let usual =
                    |band: f64| usual_count(band * (ends[1] - ends[0]), self.taps_sideways, tolerance);
                let count =
                    (nearest.len() as f64 * usual(bands[axis]) / usual(nearest.band())).ceil() as usize;
                if !nearest.interpolates() || count >= nearest.len() {
                    return nearest.clone();
                }
                IntervalNodes::new(ends, count, self.taps_sideways, bands[axis], tolerance)
            })
        };
        let mut zones = vec![self.zones[0].clone()];
        for from in begins {
            let zone = Zone { from, share: 1.0, nodes: nodes(from) };
            if zone.columns() as f64 <= FEWER * zones[zones.len() - 1].columns() as f64 {
                zones.push(zone);
            }
        }
        let mut end = last;
        for zone in zones.iter_mut().rev() {
            zone.share = (end - zone.from.max(first)) as f64 / (last - first) as f64;
            end = zone.from;
        }
        Self { zones, taps: self.taps.clone(), ..*self }
    }

    /// Nodes along ρ at which tiles have the nodes of a zone.
    pub(crate) fn along_zone(&self, zone: usize) -> Range<usize> {
        self.zones[zone].from..self.zones.get(zone + 1).map_or(usize::MAX, |next| next.from)
    }

    /// Columns of nodes as there are on average at every ρ.
    pub(crate) fn mean_columns(&self) -> f64 {
        self.zones.iter().map(|zone| zone.share * zone.columns() as f64).sum()
    }
}
