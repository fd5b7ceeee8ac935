//! Which lines, which nodes, and what they err by and take.

use super::band::{BlockBand, Choice};
use super::extent::{Extent, RingExtent, spread};
use super::kernels::{MOST_TAPS, TapTable};
use super::nodes::BlockNodes;
use super::trial::Trial;
use super::view::LineView;
use crate::acquisition::Instrument;
use crate::grid::Grid;
use crate::reconstruct::compress::tones_for;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::numerics::Taps;
use crate::reconstruct::plan::cost::{COMPLEX, PRODUCT};
use crate::wave::interval::PathInterval;
use crate::wave::simd::{LANES, ROWS};
use rayon::prelude::*;

/// The most bytes of depths that are summed at a time. Every slab of them sums the nodes that it needs.
const MOST_BYTES: usize = 64 << 20;

/// The most bytes of the tones of all shells, and the most shells.
const MOST_TONES: usize = 64 << 20;
const MOST_SHELLS: usize = 16;

/// By how much nodes are tried closer together where they err too much.
const CLOSER: [f64; 6] = [1.0, 0.92, 0.84, 0.72, 0.6, 0.5];

/// Operations of a node's or a microphone's phasor, and of finding a voxel's places and weights, for all lanes.
const PHASORS: f64 = 400.0;
const PLACES: f64 = 1500.0;

/// Operations of finding the nodes, and what they err by.
const FINDING: f64 = 2e8;

/// An operation on sixteen lanes takes so much of one of other loops: on tones and nodes, and on the voxels made of them.
const DENSE: f64 = 0.7;
const DENSEST: f64 = 0.45;

/// An operation on nodes, which are in the second-level cache, takes as long as so many on the sums of microphones.
const NODE: f64 = 2.5;

/// Blocks whose nodes are priced.
const BANDS: usize = 7;

/// How one job is summed by lines.
#[derive(Debug, Clone)]
pub(crate) struct LinesPlan {
    pub(crate) view: LineView,
    pub(crate) blocks: Vec<BlockNodes>,
    /// Weights along ρ and along the path.
    pub(crate) tables: [TapTable; 2],
    /// Of interpolation, relative to `Σ|w m| / Σw`, and by how much it amplifies errors of nodes.
    pub(crate) error: f64,
    pub(crate) growth: f64,
    /// Depths that are summed at a time.
    pub(crate) at_once: usize,
    /// Ranges of ρ whose nodes share their tones.
    pub(crate) shells: Shells,
    pub(crate) operations: f64,
    /// Of the tones of all shells, and of one block's nodes and voxels.
    pub(crate) bytes: u64,
}

/// Ranges of ρ of equal thickness.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Shells {
    first: f64,
    thickness: f64,
    pub(crate) count: usize,
}

impl Shells {
    /// So many for all ρ.
    fn new([first, last]: [f64; 2], count: usize) -> Self {
        Self { first, thickness: ((last - first) / count as f64).max(f64::MIN_POSITIVE), count }
    }

    /// Which of them has this ρ.
    pub(crate) fn of(&self, rho: f64) -> usize {
        (((rho - self.first) / self.thickness).max(0.0) as usize).min(self.count - 1)
    }
}

impl LinesPlan {
    /// The plan of fewest operations, if it takes less than `most`; otherwise the least operations of those that were only
    /// priced because they take more. That is infinite where the microphones are on no lattice, or nodes would have no
    /// place.
    pub(crate) fn find(
        instrument: &Instrument,
        grid: &Grid,
        budget: ErrorBudget,
        most: f64,
    ) -> Result<Self, f64> {
        let lengths = Taps::lengths(budget.interpolation_axis(), MOST_TAPS).into_iter();
        let lengths: Vec<Choice> = lengths.map(Some).collect();
        let priced = |along| {
            LineView::new(instrument, grid, along).and_then(|view| Priced::new(instrument, view, &lengths))
        };
        let mut priced: Vec<Priced> = [0, 1].into_par_iter().filter_map(priced).collect();
        priced.sort_by(|a, b| a.operations.total_cmp(&b.operations));
        let (tried, untried) = priced.split_at(priced.partition_point(|p| p.operations < most));
        let found = tried.iter().find_map(|priced| priced.measured(instrument, budget));
        found.ok_or_else(|| untried.first().map_or(f64::INFINITY, |priced| priced.operations))
    }

    /// All path lengths of nodes, and what the two compressions may err by.
    pub(crate) fn compression(
        &self,
        instrument: &Instrument,
        grid: &Grid,
        budget: ErrorBudget,
    ) -> (PathInterval, ErrorBudget) {
        let paths = instrument.path_interval(grid, 0..grid.z.count);
        let reach = |block: &BlockNodes| block.path.reach() + self.view.legs * block.rho.reach();
        let margin = self.blocks.iter().map(reach).fold(0.0, f64::max);
        let interval =
            PathInterval { shortest: paths.shortest - margin, longest: paths.longest + margin, ..paths };
        (interval, budget.after(self.error).before(self.growth))
    }
}

/// The taps of fewest operations along one axis.
struct Priced {
    view: LineView,
    bands: Vec<BlockBand>,
    extent: Extent,
    at_once: usize,
    choice: [Choice; 2],
    operations: f64,
}

impl Priced {
    /// `None` where nodes would have no place.
    fn new(instrument: &Instrument, view: LineView, lengths: &[Choice]) -> Option<Self> {
        let plane = view.rows.count * view.columns.count * COMPLEX as usize;
        let at_once = (MOST_BYTES / plane).clamp(1, view.depths.count);
        let extent = Extent::of(&view, at_once);
        if extent.rho[0] <= 0.0 {
            return None;
        }
        let blocks = (0..view.columns.count).step_by(LANES);
        let bands: Option<Vec<BlockBand>> =
            blocks.map(|first| BlockBand::of(instrument, &view, first, &extent)).collect();
        let bands = bands?;
        let of_path = if view.source.is_some() { lengths } else { &[None] };
        let seen = (&view, &bands[..], &extent);
        let of_rho = |rho| {
            let rings = Rings::of(seen, (rho, 1.0));
            let priced = |path| Price::of(instrument, seen, at_once, ([rho, path], 1.0), &rings).operations;
            let priced = of_path.iter().map(|path| ([rho, path], priced(path)));
            priced.collect::<Vec<_>>()
        };
        let priced: Vec<_> = lengths.par_iter().flat_map_iter(of_rho).collect();
        let (choice, operations) = priced.into_iter().min_by(|(_, a), (_, b)| a.total_cmp(b))?;
        let choice = choice.map(Clone::clone);
        Some(Self { view, bands, extent, at_once, choice, operations })
    }

    /// With nodes as close as the error asks for.
    fn measured(&self, instrument: &Instrument, budget: ErrorBudget) -> Option<LinesPlan> {
        let Self { view, bands, extent, at_once, .. } = self;
        let [rho, path] = &self.choice;
        let taps = [rho, path].map(|choice| choice.as_ref().map(|(taps, _)| taps));
        let trial = Trial::new(instrument, view);
        CLOSER.into_iter().find_map(|closer| {
            let nodes = |band: &BlockBand| band.nodes(view, extent, [rho, path], closer);
            let blocks: Vec<BlockNodes> = bands.iter().map(nodes).collect::<Option<_>>()?;
            let [error, growth] = trial.error(&blocks, taps);
            (error <= budget.interpolation()).then(|| {
                let seen = (view, &bands[..], extent);
                let rings = Rings::of(seen, (rho, closer));
                let price = Price::of(instrument, seen, *at_once, ([rho, path], closer), &rings);
                LinesPlan {
                    blocks,
                    tables: taps.map(TapTable::new),
                    error,
                    growth,
                    at_once: *at_once,
                    shells: Shells::new(extent.rho, price.shells),
                    operations: price.operations,
                    bytes: price.bytes as u64,
                    view: view.clone(),
                }
            })
        })
    }
}

/// Nodes of one ρ, in which shell that is, and the least and the most that microphones are from them, both ways in a scan, m.
struct PricedRing {
    extent: RingExtent,
    shell: usize,
    back: [f64; 2],
}

/// What lines see, of which choices of taps are priced.
type Seen<'a> = (&'a LineView, &'a [BlockBand], &'a Extent);

/// The rings of one choice of taps along ρ, `[band, voxels]`, of the bands that are priced.
struct Rings(Vec<Vec<Vec<PricedRing>>>);

impl Rings {
    fn of((view, bands, extent): Seen<'_>, (rho, closer): (&Choice, f64)) -> Self {
        // How far microphones are from any column.
        let asides = [view.columns.first, view.columns.position(view.columns.count / 2), view.columns.last()];
        let asides = asides.map(|column| view.aside(column));
        let nearest = asides.iter().map(|aside| aside[0]).fold(f64::INFINITY, f64::min);
        let farthest = asides.iter().map(|aside| aside[1]).fold(0.0, f64::max);
        let shells = Shells::new(extent.rho, MOST_SHELLS);
        let priced = |extent: RingExtent| PricedRing {
            shell: shells.of(extent.rho),
            back: [nearest, farthest].map(|aside| view.legs * extent.rho.hypot(aside)),
            extent,
        };
        let of_band = |band: &BlockBand| {
            let [pitch, _] = band.pitches(view, extent, [rho, &None]);
            let reach = taps_of(rho) * (closer * pitch);
            let carrier = |rho: f64| (rho * rho + band.aside * band.aside).sqrt();
            extent.sampled.iter().map(|seen| seen.rings(reach, carrier).map(priced).collect()).collect()
        };
        Self(spread(bands.len(), BANDS).map(|band| of_band(&bands[band])).collect())
    }
}

/// How many nodes a place is made of along one coordinate.
fn taps_of(choice: &Choice) -> f64 {
    choice.as_ref().map_or(1.0, |(taps, _)| taps.count() as f64)
}

/// What a choice of taps takes.
struct Price {
    operations: f64,
    shells: usize,
    /// Of the tones of all shells, and of one block's nodes and voxels.
    bytes: f64,
}

impl Price {
    fn of(
        instrument: &Instrument,
        (view, bands, extent): Seen<'_>,
        at_once: usize,
        (choice, closer): ([&Choice; 2], f64),
        Rings(rings): &Rings,
    ) -> Self {
        let [of_rho, of_path] = choice.map(taps_of);
        let (lines, microphones) = (view.lines.count as f64, view.microphones.count as f64);
        let slabs = view.depths.count.div_ceil(at_once) as f64;
        let (mut per_tone, mut most_nodes) = (0.0, 0.0f64);
        let shells_for = |tones: f64| {
            let bytes = tones * lines * microphones * COMPLEX as f64;
            ((MOST_TONES as f64 / bytes) as usize).clamp(1, MOST_SHELLS)
        };
        let sampled = extent.sampled.len() as f64;
        let thickest = extent.sampled.iter().map(|seen| seen.across).fold(0.0, f64::max);
        // For paths that extend so far, m.
        let tones_of = |paths: f64| {
            let spread = instrument.sweep.bandwidth() * paths / instrument.sound_speed;
            tones_for(spread, 1e-5).min(instrument.sweep.len() as f64)
        };
        let scans = view.source.is_none();
        // All blocks share the tones of a shell: those for the paths of all nodes of its rings.
        let mut ends = vec![[f64::INFINITY, f64::NEG_INFINITY]; MOST_SHELLS];
        let some = spread(bands.len(), BANDS);
        let share = bands.len() as f64 / some.clone().count() as f64;
        for (band, rings) in some.map(|band| &bands[band]).zip(rings) {
            let [rho, path] = band.pitches(view, extent, choice).map(|pitch| closer * pitch);
            let beyond = if scans { 0.0 } else { 0.5 * of_path * path };
            let (mut nodes, mut widest) = (0.0, 0.0f64);
            for (seen, rings) in extent.sampled.iter().zip(rings) {
                let mut along_path = 0.0;
                for PricedRing { extent, shell, back } in rings {
                    let [low, high] = extent.outward;
                    let whole = ((high - low + 2.0 * beyond) / path / ROWS as f64).ceil().max(1.0);
                    let count = if scans { 1.0 } else { whole } * ROWS as f64;
                    along_path += count;
                    widest = widest.max(count);
                    let [least, most] = &mut ends[*shell];
                    *least = least.min(low - beyond + back[0]);
                    *most = most.max(high + beyond + back[1]);
                }
                let found = rings.len() as f64;
                nodes += (seen.across / rho + of_rho) * along_path / found.max(1.0) / sampled;
            }
            let rings = thickest / rho + of_rho;
            let wide = (8 * LANES) as f64;
            per_tone += rings * (lines * microphones * wide + (microphones + widest) * PHASORS)
                + NODE * nodes * lines * wide;
            most_nodes = most_nodes.max(nodes * lines);
        }
        let tones = |[least, most]: &[f64; 2]| (least <= most).then(|| tones_of(most - least));
        let of_shells: Vec<f64> = ends.iter().filter_map(tones).collect();
        let most_tones = of_shells.iter().copied().fold(0.0, f64::max);
        let usual_tones = of_shells.iter().sum::<f64>() / of_shells.len().max(1) as f64;
        let all = ends.iter().copied().reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]);
        let all_tones = all.map_or(0.0, |[least, most]| tones_of(most - least));
        let per_slab = usual_tones * share * per_tone;
        let voxel = of_rho * (of_path + 2.0) * (4 * LANES) as f64 + PLACES;
        let rows = (view.depths.count * view.rows.count * bands.len()) as f64;
        let shells = shells_for(most_tones);
        let of_nodes = slabs * per_slab;
        let of_shells = PRODUCT * shells as f64 * most_tones * all_tones * lines * microphones;
        Self {
            operations: FINDING + DENSE * (of_shells + of_nodes) + DENSEST * rows * lines * voxel,
            shells,
            bytes: COMPLEX as f64
                * (most_tones * shells as f64 * lines * microphones
                    + most_nodes * LANES as f64
                    + (LANES * at_once * view.rows.count) as f64),
        }
    }
}
