//! Slabs of depths that share their tones: how thick they are, and which of them share a decomposition.
//!
//! Both by a fixed model of the cost of decompositions and transforms, so that the same job is always divided in the
//! same way.

use super::layout::Layout;
use crate::acquisition::Instrument;
use crate::blocks::runs;
use crate::reconstruct::compress::{candidates_for, finders, tones_for};
use crate::reconstruct::volume::Batch;
use crate::wave::interval::PathInterval;
use crate::wave::simd::LANES;
use std::ops::Range;

/// What skeletons usually may err by.
const USUAL: f64 = 3e-5;

/// Depths per thread that are worked on before they are passed on: enough to keep every thread busy.
const PLANES_PER_THREAD: usize = 8;

/// Slabs that together take no more numbers than this are always worked on at a time, with about this many tones each:
/// threads take time to wake.
const SMALL: usize = 1 << 20;
const TONES: usize = 32;

/// Candidates for the number of depths in a slab.
const THICKNESSES: [usize; 14] = [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128];

/// What slabs cost, in points of a transform.
#[derive(Debug, Clone, Copy)]
struct Costs {
    /// Of a tone at one depth.
    depth: f64,
    /// Of a tone in a slab: its data's spectra.
    spectra: f64,
    /// Of a tone in a slab: its product over all nodes.
    product: f64,
    /// Tones of which one costs what all do.
    lanes: f64,
    /// Tones of the volume.
    of_volume: f64,
}

/// How the depths of a volume are divided.
#[derive(Debug, Clone)]
pub(crate) struct Slabs {
    /// Depths in a slab.
    pub(crate) thickness: usize,
    costs: Costs,
}

impl Costs {
    fn new(layout: &Layout, of_volume: f64) -> Self {
        let points = layout.points() as f64;
        Self {
            // One transform of a kernel, and one back for each transmission.
            depth: ((1 + layout.transmissions()) * layout.pairs()) as f64 * points,
            spectra: (layout.transmissions() * layout.node_parts.len()) as f64 * points,
            product: 0.05 * of_volume * (layout.transmissions() * layout.lattice.width()) as f64,
            // On a line, sixteen tones cost what one does.
            lanes: if layout.line.is_some() { LANES as f64 } else { 1.0 },
            of_volume,
        }
    }

    /// Of the tones for an interval of `spread` B·T, at this many depths.
    fn tones(&self, spread: f64, depths: usize) -> f64 {
        let tones = tones_for(spread, USUAL).min(self.of_volume);
        let whole = (tones / self.lanes).ceil() * self.lanes;
        whole * (depths as f64 * self.depth + self.spectra) + tones * self.product
    }

    /// Of a decomposition for such an interval, by its rows and columns.
    fn decomposed(&self, spread: f64) -> f64 {
        let rows = 1.7 * spread + 36.0;
        4e4 + 0.18 * rows * rows * candidates_for(spread).min(self.of_volume)
    }

    /// Whether a slab of this many depths should take the tones of a longer interval than find its own.
    fn share(&self, longer: f64, own: f64, depths: usize) -> bool {
        longer >= own && self.tones(longer, depths) - self.tones(own, depths) <= self.decomposed(own)
    }
}

impl Slabs {
    /// The division that costs least: thin slabs need fewer tones each, but every slab pays for its own spectra and
    /// decompositions.
    pub(crate) fn new(instrument: &Instrument, layout: &Layout) -> Self {
        let depths = layout.grid().z.count;
        let paths: Vec<Vec<PathInterval>> =
            (0..depths).map(|iz| instrument.path_intervals(layout.places.bounds(iz..iz + 1))).collect();
        // Depths are in order, and so are their paths.
        let spread = |planes: Range<usize>| {
            let ends = paths[planes.start].iter().zip(&paths[planes.end - 1]);
            let paths = ends.map(|(first, last)| PathInterval { shortest: first.shortest, ..*last });
            instrument.sweep.bandwidth() * paths.map(|paths| paths.duration()).fold(0.0, f64::max)
        };
        let of_volume = (2.0 * spread(0..depths) + 8.0).min(instrument.sweep.len() as f64);
        let costs = Costs::new(layout, of_volume);
        let cost = |thickness: usize| {
            let slabs = runs(depths, thickness).map(|planes| (spread(planes.clone()), planes.len()));
            let slabs: Vec<_> = slabs.collect();
            let finders = finders(&slabs, |longer, own, depths| costs.share(longer, own, depths));
            let of = |(i, finder): (usize, &usize)| {
                let found = if i == *finder { costs.decomposed(slabs[i].0) } else { 0.0 };
                found + costs.tones(slabs[*finder].0, slabs[i].1)
            };
            finders.iter().enumerate().map(of).sum::<f64>()
        };
        let possible = THICKNESSES.into_iter().filter(|&thickness| thickness == 1 || thickness <= depths);
        let priced = possible.map(|thickness| (thickness, cost(thickness)));
        let (thickness, _) = priced.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((1, 0.0));
        Self { thickness, costs }
    }

    /// Whether a slab of this many depths, its paths `own` B·T apart, takes the tones of a slab before it, whose are `longer`.
    pub(crate) fn share(&self, longer: f64, own: f64, depths: usize) -> bool {
        self.costs.share(longer, own, depths)
    }

    /// The batch for this many threads where memory does not matter.
    pub(crate) fn usual_batch(&self, layout: &Layout, threads: usize) -> Batch {
        let thickness = self.thickness;
        let nodes = layout.transmissions() * layout.lattice.width();
        let slab = (layout.tone_len() + nodes) * TONES + layout.grid().plane_len() * thickness;
        let at_once = (PLANES_PER_THREAD * threads / thickness).max(SMALL / slab).max(1);
        let slabs = at_once.min(layout.grid().z.count.div_ceil(thickness));
        Batch { slabs, ..Batch::of_threads(threads) }
    }
}
