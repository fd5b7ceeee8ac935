//! Slabs of depths that share their tones: how thick they are, and which of them share a decomposition.
//!
//! Both by a fixed model of the cost of decompositions and transforms, so that the same job is always divided in the
//! same way.

use super::layout::Layout;
use crate::acquisition::Instrument;
use crate::blocks::runs;
use crate::reconstruct::compress::{candidates_for, finders, tones_for, volume_tones};
use crate::reconstruct::plan::cost::PRODUCT;
use crate::reconstruct::volume::Batch;
use crate::wave::interval::PathInterval;
use crate::wave::simd::LANES;
use std::iter;
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

/// A product of samples as points of a transform, and those of a stretch's tones for each sample of the volume's, which come
/// from memory.
const PRODUCT_POINTS: f64 = 0.05;
pub(super) const STRETCHED: f64 = 25.0;

/// Finding a stretch's tones, whatever they are, and the weights of each of the volume's in them.
const FOUND: f64 = 1e6;
const FOUND_EACH: f64 = 200.0;

/// Volumes of fewer tones have no stretches, which hardly save anything there.
const LEAST_FOR_STRETCHES: f64 = 256.0;

/// What slabs cost, in points of a transform.
#[derive(Debug, Clone, Copy)]
struct Costs {
    /// Of a tone at one depth.
    depth: f64,
    /// Of a tone in a slab: its data's spectra.
    spectra: f64,
    /// Of a product of samples at all nodes.
    product: f64,
    /// Of making a stretch's tones of one of the volume's.
    stretched: f64,
    /// Of spreading one tone of a stretch.
    spread: f64,
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
    /// Slabs whose tones are made of those of a stretch, or all of them, which then are made of the volume's.
    pub(crate) stretch: usize,
    costs: Costs,
}

impl Costs {
    fn new(instrument: &Instrument, layout: &Layout, of_volume: f64) -> Self {
        let points = layout.points() as f64;
        let microphones = (layout.transmissions() * instrument.array.len()) as f64;
        Self {
            // One transform of a kernel, and one back for each transmission.
            depth: ((1 + layout.transmissions()) * layout.pairs()) as f64 * points,
            spectra: (layout.transmissions() * layout.node_parts.len()) as f64 * points,
            product: PRODUCT_POINTS * (layout.transmissions() * layout.lattice.width()) as f64,
            stretched: STRETCHED * PRODUCT_POINTS * microphones,
            spread: PRODUCT_POINTS / PRODUCT * layout.lattice.spreading_operations(&instrument.array),
            // On a line, sixteen tones cost what one does.
            lanes: if layout.line.is_some() { LANES as f64 } else { 1.0 },
            of_volume,
        }
    }

    /// Tones for an interval of `spread` B·T.
    fn tones(&self, spread: f64) -> f64 {
        tones_for(spread, USUAL).min(self.of_volume)
    }

    /// Of the tones for an interval of `spread` B·T, at this many depths.
    fn summed(&self, spread: f64, depths: usize) -> f64 {
        self.in_whole_lanes(self.tones(spread)) * (depths as f64 * self.depth + self.spectra)
    }

    /// So many tones, and those that are summed with them at no cost.
    fn in_whole_lanes(&self, tones: f64) -> f64 {
        (tones / self.lanes).ceil() * self.lanes
    }

    /// Of making the tones of slabs of these B·T of the volume's.
    fn made(&self, slabs: &[f64]) -> f64 {
        let all: f64 = slabs.iter().map(|slab| self.tones(*slab)).sum();
        self.of_volume * (all * self.product + self.spread)
    }

    /// The same of those of some stretches, the longest of so much B·T, which are of so many depths in all.
    fn made_in_stretches(&self, (count, longest): (usize, f64), slabs: &[f64], depths: usize) -> f64 {
        let own = volume_tones(longest).min(self.of_volume);
        let all: f64 = slabs.iter().map(|slab| self.tones(*slab)).sum();
        // What stretches err by is made up for by a tone more for each slab.
        let more = depths as f64 * self.depth + slabs.len() as f64 * (self.spectra + own * self.product);
        let each = self.of_volume * self.stretched + own * self.spread;
        FOUND + FOUND_EACH * self.of_volume + count as f64 * each + all * own * self.product + more
    }

    /// Of a decomposition for such an interval, by its rows and columns.
    fn decomposed(&self, spread: f64) -> f64 {
        let rows = 1.7 * spread + 36.0;
        4e4 + 0.18 * rows * rows * candidates_for(spread).min(self.of_volume)
    }

    /// Whether a slab of this many depths should take the tones of a longer interval than find its own.
    fn share(&self, longer: f64, own: f64, depths: usize) -> bool {
        let of = |spread| self.summed(spread, depths) + self.tones(spread) * self.of_volume * self.product;
        longer >= own && of(longer) - of(own) <= self.decomposed(own)
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
        let of_volume = volume_tones(spread(0..depths)).min(instrument.sweep.len() as f64);
        let costs = Costs::new(instrument, layout, of_volume);
        // Depths that are not spread for have tones of the volume's.
        let narrows = layout.lattice.near.is_empty() && of_volume >= LEAST_FOR_STRETCHES;
        let divided = |thickness: usize| {
            let slabs = runs(depths, thickness).map(|planes| (spread(planes.clone()), planes.len()));
            let slabs: Vec<_> = slabs.collect();
            let finders = finders(&slabs, |longer, own, depths| costs.share(longer, own, depths));
            let of = |(i, finder): (usize, &usize)| {
                let found = if i == *finder { costs.decomposed(slabs[i].0) } else { 0.0 };
                found + costs.summed(slabs[*finder].0, slabs[i].1)
            };
            let summed: f64 = finders.iter().enumerate().map(of).sum();
            let spreads: Vec<f64> = finders.iter().map(|finder| slabs[*finder].0).collect();
            let all = slabs.len();
            let made = |stretch: usize| {
                let stretches = runs(depths, stretch * thickness);
                let count = stretches.len();
                let longest = stretches.map(spread).fold(0.0, f64::max);
                let made = if stretch < all {
                    costs.made_in_stretches((count, longest), &spreads, depths)
                } else {
                    costs.made(&spreads)
                };
                (stretch, summed + made)
            };
            let fewer = (0..).map(|e| 1usize << e).take_while(|stretch| *stretch < all && narrows);
            let (stretch, cost) =
                iter::once(all).chain(fewer).map(made).min_by(|a, b| a.1.total_cmp(&b.1))?;
            Some((Self { thickness, stretch, costs }, cost))
        };
        let possible = THICKNESSES.into_iter().filter(|&thickness| thickness == 1 || thickness <= depths);
        let best = possible.filter_map(divided).min_by(|a, b| a.1.total_cmp(&b.1));
        best.map_or(Self { thickness: 1, stretch: depths, costs }, |(slabs, _)| slabs)
    }

    /// So many tones of a slab, and those that are summed with them at no cost.
    pub(crate) fn in_whole_lanes(&self, tones: f64) -> f64 {
        self.costs.in_whole_lanes(tones)
    }

    /// The same in stretches of so many slabs: of more than there are, tones are made of the volume's.
    pub(crate) fn in_stretches(self, stretch: usize) -> Self {
        Self { stretch, ..self }
    }

    /// The depths of each stretch; none where tones are made of the volume's.
    pub(crate) fn stretches(&self, depths: usize) -> Vec<Range<usize>> {
        let each = self.stretch.saturating_mul(self.thickness);
        if each < depths { runs(depths, each).collect() } else { Vec::new() }
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
