//! Which lines, which nodes, and what they err by and take.

use super::band::{BlockBand, Choice};
use super::extent::Extent;
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
use crate::wave::simd::LANES;

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
const FINDING: f64 = 1e9;

/// An operation on sixteen lanes takes so much of one of other loops.
const DENSE: f64 = 0.8;

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
        let views = [0, 1].into_iter().filter_map(|along| LineView::new(instrument, grid, along));
        let mut priced: Vec<Priced> =
            views.filter_map(|view| Priced::new(instrument, view, &lengths)).collect();
        priced.sort_by(|a, b| a.price.operations.total_cmp(&b.price.operations));
        let (tried, untried) = priced.split_at(priced.partition_point(|p| p.price.operations < most));
        let found = tried.iter().find_map(|priced| priced.measured(instrument, budget));
        found.ok_or_else(|| untried.first().map_or(f64::INFINITY, |priced| priced.price.operations))
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
    price: Price,
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
        let choices = lengths.iter().flat_map(|rho| of_path.iter().map(move |path| [rho, path]));
        let priced =
            choices.map(|choice| (choice, Price::of(instrument, &view, &bands, &extent, at_once, choice)));
        let (choice, price) = priced.min_by(|(_, a), (_, b)| a.operations.total_cmp(&b.operations))?;
        let choice = choice.map(Clone::clone);
        Some(Self { view, bands, extent, at_once, choice, price })
    }

    /// With nodes as close as the error asks for.
    fn measured(&self, instrument: &Instrument, budget: ErrorBudget) -> Option<LinesPlan> {
        let Self { view, extent, price, .. } = self;
        let [rho, path] = &self.choice;
        let taps = [rho, path].map(|choice| choice.as_ref().map(|(taps, _)| taps));
        let trial = Trial::new(instrument, view);
        CLOSER.into_iter().find_map(|closer| {
            let nodes = |band: &BlockBand| band.nodes(view, extent, [rho, path], closer);
            let blocks: Vec<BlockNodes> = self.bands.iter().map(nodes).collect::<Option<_>>()?;
            let [error, growth] = trial.error(&blocks, taps);
            let more = 1.0 / (closer * closer);
            (error <= budget.interpolation()).then(|| LinesPlan {
                blocks,
                tables: taps.map(TapTable::new),
                error,
                growth,
                at_once: self.at_once,
                shells: Shells::new(extent.rho, price.shells),
                operations: price.operations + price.of_nodes * (more - 1.0),
                bytes: (price.bytes + price.node_bytes * more) as u64,
                view: view.clone(),
            })
        })
    }
}

/// What a choice of taps takes.
struct Price {
    operations: f64,
    /// Those of nodes.
    of_nodes: f64,
    shells: usize,
    /// Of one block's nodes.
    node_bytes: f64,
    /// Of the tones of all shells and of one block's voxels.
    bytes: f64,
}

impl Price {
    fn of(
        instrument: &Instrument,
        view: &LineView,
        bands: &[BlockBand],
        extent: &Extent,
        at_once: usize,
        choice: [&Choice; 2],
    ) -> Self {
        let [of_rho, of_path] =
            choice.map(|choice| choice.as_ref().map_or(1.0, |(taps, _)| taps.count() as f64));
        let (lines, microphones) = (view.lines.count as f64, view.microphones.count as f64);
        let slabs = view.depths.count.div_ceil(at_once) as f64;
        let across = extent.rho[1] - extent.rho[0];
        let (mut per_slab, mut most_nodes, mut most_tones) = (0.0, 0.0f64, 0.0f64);
        let shells_for = |tones: f64| {
            let bytes = tones * lines * microphones * COMPLEX as f64;
            ((MOST_TONES as f64 / bytes) as usize).clamp(1, MOST_SHELLS)
        };
        let sampled = extent.sampled.len() as f64;
        let [thickest, widest] =
            [0, 1].map(|axis| extent.sampled.iter().map(|widths| widths[axis]).fold(0.0, f64::max));
        // For paths that extend so far, m.
        let tones_of = |paths: f64| {
            let spread = instrument.sweep.bandwidth() * paths / instrument.sound_speed;
            tones_for(spread, 1e-5).min(instrument.sweep.len() as f64)
        };
        for band in bands {
            let [rho, path] = band.pitches(view, extent, choice);
            // Without a loudspeaker there is one node along the path.
            let along_path = |width: f64| if view.source.is_some() { width / path + of_path } else { 1.0 };
            let nodes: f64 = extent
                .sampled
                .iter()
                .map(|[depth, width]| (depth / rho + of_rho) * along_path(*width))
                .sum::<f64>()
                / sampled;
            let rings = thickest / rho + of_rho;
            let [nearest, farthest] = view.aside(band.middle);
            let back = extent.rho[0].hypot(farthest) - extent.rho[0].hypot(nearest);
            let paths = view.legs * (back + across / MOST_SHELLS as f64)
                + if view.source.is_some() { widest + of_path * path } else { 0.0 };
            let tones = tones_of(paths);
            let wide = (8 * LANES) as f64;
            let of_ring = tones * (lines * microphones * wide + (microphones + along_path(widest)) * PHASORS);
            per_slab += rings * of_ring + nodes * lines * tones * wide;
            (most_nodes, most_tones) = (most_nodes.max(nodes * lines), most_tones.max(tones));
        }
        let voxel = of_rho * (of_path + 2.0) * (4 * LANES) as f64 + PLACES;
        let rows = (view.depths.count * view.rows.count * bands.len()) as f64;
        let shells = shells_for(most_tones);
        let of_nodes = DENSE * slabs * per_slab;
        let [nearest, farthest] = view.aside(view.columns.first);
        let back = extent.rho[1].hypot(farthest) - extent.rho[0].hypot(nearest);
        let all_tones = tones_of(view.legs * back + widest);
        let of_shells = PRODUCT * shells as f64 * most_tones * all_tones * lines * microphones;
        Self {
            operations: FINDING + of_shells + of_nodes + DENSE * rows * lines * voxel,
            of_nodes,
            shells,
            node_bytes: most_nodes * (COMPLEX as usize * LANES) as f64,
            bytes: COMPLEX as f64
                * (most_tones * shells as f64 * lines * microphones
                    + (LANES * at_once * view.rows.count) as f64),
        }
    }
}
