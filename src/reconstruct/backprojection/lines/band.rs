//! How fast the images of lines change, and the nodes that carry that.

use super::extent::Extent;
use super::nodes::{BlockNodes, Ruler};
use super::view::LineView;
use crate::acquisition::Instrument;
use crate::reconstruct::numerics::Taps;
use crate::wave::simd::LANES;
use std::ops::Range;

/// How far nodes reach beyond the voxels at most, relative to how far these are from the lines and from the loudspeaker.
const BEYOND: f64 = 0.3;

/// Taps along one coordinate, and how much of the nodes' band the fastest change takes.
pub(crate) type Choice = Option<(Taps, f64)>;

/// What a block's images change by.
pub(crate) struct BlockBand {
    pub(crate) columns: Range<usize>,
    pub(crate) middle: f64,
    pub(crate) aside: f64,
    /// How fast terms change without their carrier along ρ and along the path, cycles per m.
    pub(crate) fastest: [f64; 2],
}

impl BlockBand {
    /// Of up to sixteen columns; `None` where they are too near to the loudspeaker.
    pub(crate) fn of(
        instrument: &Instrument,
        view: &LineView,
        first: usize,
        extent: &Extent,
    ) -> Option<Self> {
        let columns = first..(first + LANES).min(view.columns.count);
        let ends = [view.columns.position(columns.start), view.columns.position(columns.end - 1)];
        let middle = f64::midpoint(ends[0], ends[1]);
        let per_metre =
            [instrument.sweep.start(), instrument.sweep.stop()].map(|f| f / instrument.sound_speed);
        let carrier = instrument.sweep.centre() / instrument.sound_speed;
        let [lowest, highest] = extent.rho;
        let rhos = [lowest, 0.75 * lowest + 0.25 * highest, f64::midpoint(lowest, highest), highest];
        // How much faster the outward length changes in the middle than at the ends, where nodes are before all voxels.
        let ratios = match view.source {
            None => [0.0; 2],
            Some([x, ..]) => {
                let own = extent.outward.max(1e-9);
                let at = |end: f64| own / (own * own + (end - x).powi(2) - (middle - x).powi(2)).sqrt();
                ends.map(at)
            }
        };
        if ratios.iter().any(|ratio| !ratio.is_finite()) {
            return None;
        }
        let asides: Vec<f64> = ends.iter().flat_map(|end| view.aside(*end)).collect();
        let most = asides.iter().copied().fold(0.0, f64::max);
        let along_rho = |aside: f64| {
            let mut fastest = 0.0f64;
            for rho in rhos {
                let own = rho / rho.hypot(aside);
                for microphone in &asides {
                    let slope = rho / rho.hypot(*microphone);
                    for f in per_metre {
                        for ratio in ratios {
                            let turns = match view.source {
                                None => view.legs * (f * slope - carrier * own),
                                Some(_) => f * (slope - own) + (f - carrier) * own * (1.0 - ratio),
                            };
                            fastest = fastest.max(turns.abs());
                        }
                    }
                }
            }
            fastest
        };
        let possible = (0..=24).map(|k| most * f64::from(k) / 24.0);
        let best = possible.map(|aside| (aside, along_rho(aside))).min_by(|a, b| a.1.total_cmp(&b.1))?;
        let half = 0.5 * (per_metre[1] - per_metre[0]);
        let along_path = half * ratios[0].max(ratios[1]).max(1.0);
        // A band of nothing has nodes as far apart as the voxels extend.
        let least = 0.5 / (highest - lowest).max(1e-3 / carrier);
        Some(Self { columns, middle, aside: best.0, fastest: [best.1.max(least), along_path.max(least)] })
    }

    /// Pitches along ρ and along the path.
    pub(crate) fn pitches(&self, view: &LineView, extent: &Extent, choice: [&Choice; 2]) -> [f64; 2] {
        let from_source = if view.source.is_some() { extent.outward } else { f64::INFINITY };
        let room = [extent.rho[0].min(from_source), from_source];
        [0, 1].map(|axis| {
            choice[axis].as_ref().map_or(1.0, |(taps, fill)| {
                // Nodes beyond the voxels, where terms change faster, stay near to them.
                (0.5 * fill / self.fastest[axis]).min(BEYOND * room[axis] / (taps.count() / 2) as f64)
            })
        })
    }

    /// The nodes; `None` where some would have no place.
    pub(crate) fn nodes(
        &self,
        view: &LineView,
        extent: &Extent,
        choice: [&Choice; 2],
        closer: f64,
    ) -> Option<BlockNodes> {
        let [rho, path] = self.pitches(view, extent, choice);
        let [of_rho, of_path] = choice.map(|choice| choice.as_ref().map_or(1, |(taps, _)| taps.count()));
        let back = extent.rho[0].hypot(self.aside);
        let nodes = BlockNodes {
            columns: self.columns.clone(),
            middle: self.middle,
            aside: self.aside,
            rho: Ruler::before(extent.rho[0], closer * rho, of_rho),
            path: match view.source {
                Some(_) => Ruler::before(extent.outward + back, closer * path, of_path),
                None => Ruler { first: 0.0, pitch: 1.0, taps: 1 },
            },
        };
        let outward = extent.outward - nodes.path.reach() - nodes.rho.reach();
        let squares = nodes.squares(view, outward * outward);
        let placed =
            view.source.is_none() || (outward > 0.0 && squares.into_iter().all(|square| square > 0.0));
        (nodes.rho.first > 0.0 && placed).then_some(nodes)
    }
}
