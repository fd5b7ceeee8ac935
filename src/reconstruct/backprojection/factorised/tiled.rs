//! Back-projection level by level: the smallest tiles onto nodes of their own, those onto the nodes of larger ones, and the
//! largest onto the voxels.

use super::frame::{Frame, halved};
use super::held::{DepthColumns, FilledNodes, HeldNodes};
use super::leaves::Leaves;
use super::levels::{Halvings, TileLevels};
use super::merge::ROWS;
use super::tree::Tree;
use crate::acquisition::{Instrument, Tile};
use crate::error::Result;
use crate::progress::advance;
use crate::reconstruct::backprojection::SeriesBudget;
use crate::reconstruct::backprojection::profile::Band;
use crate::reconstruct::compress::VolumeTones;
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::job::Job;
use crate::reconstruct::numerics::GridPlaces;
use crate::reconstruct::volume::SlabDriver;
use crate::reconstruct::{Method, ReconstructionInfo};
use crate::wave::interval::PathInterval;
use num_complex::Complex32;
use rayon::prelude::*;

/// By how much interpolation is assumed to amplify errors of nodes when work is estimated.
const USUAL_GROWTH: f64 = 25.0;

/// The budget of nodes that is assumed when work is estimated.
pub(crate) fn usual_budget(budget: ErrorBudget) -> ErrorBudget {
    budget.before_interpolation(USUAL_GROWTH)
}

/// The band of nodes' range profiles and the budget of its series: what interpolation leaves of the budget, divided by how
/// much it amplifies errors of the nodes.
fn series_budget(levels: &TileLevels, band: Band, budget: ErrorBudget) -> (Band, SeriesBudget) {
    let budget = budget.after(levels.error).before(levels.growth);
    let band = Band { tolerance: budget.series(), ..band };
    (band, SeriesBudget::new(&band, levels.half, budget))
}

/// All path lengths at which profiles of nodes are expanded, m, for tiles of this radius.
fn interval(levels: &TileLevels, instrument: &Instrument, points: &GridPlaces, radius: f64) -> PathInterval {
    let paths = instrument.path_interval_within(points.bounds(0..points.grid().z.count));
    let thickness = levels.levels[0].pitch * (levels.block[2] + 2) as f64;
    let margin = levels.margin() + thickness + instrument.geometry.return_legs() * radius + levels.half;
    PathInterval { shortest: paths.shortest - margin, longest: paths.longest + margin, ..paths }
}

/// All path lengths at which profiles of nodes are expanded, and what the two compressions may err by.
pub(crate) fn compression(
    levels: &TileLevels,
    instrument: &Instrument,
    points: &GridPlaces,
    band: Band,
    budget: ErrorBudget,
) -> (PathInterval, ErrorBudget) {
    let tiles = halved(instrument.array.positions(), levels.levels[0].times);
    let radius = tiles.iter().map(|tile| tile.radius).fold(0.0, f64::max);
    let (_, budget) = series_budget(levels, band, budget);
    (interval(levels, instrument, points, radius), budget.tones)
}

/// What one job needs of its nodes.
pub(crate) struct Tiled<'a> {
    plan: &'a TileLevels,
    points: &'a GridPlaces,
    band: Band,
    tree: Tree<'a>,
    /// The smallest tiles, with their microphones.
    leaves: Vec<Tile>,
    /// For each of the largest tiles, those of every level that it is made of; where the largest are the smallest, too, all
    /// together.
    frames: Vec<Vec<Vec<Frame>>>,
}

impl<'a> Tiled<'a> {
    pub(crate) fn new(
        plan: &'a TileLevels,
        instrument: &Instrument,
        points: &'a GridPlaces,
        band: Band,
    ) -> Self {
        let halvings = Halvings::of(instrument);
        let tiles = halvings.tiles(&plan.levels);
        let groups = if tiles.len() > 1 { tiles[tiles.len() - 1].len() } else { 1 };
        let frames = |group: usize| {
            let of_level = |tiles: &&[Tile]| {
                let each = tiles.len() / groups;
                let frame = |tile: &Tile| Frame::new(&instrument.geometry, tile.centre);
                tiles[group * each..][..each].iter().map(frame).collect()
            };
            tiles.iter().map(of_level).collect()
        };
        let columns = [0, 1].map(|axis| points.along(axis));
        Self {
            plan,
            points,
            band,
            tree: Tree::new(&plan.levels, columns, band.carrier / band.sound_speed),
            leaves: halved(instrument.array.positions(), plan.levels[0].times),
            frames: (0..groups).map(frames).collect(),
        }
    }

    /// The depths of a slab of nodes.
    fn depths(&self, slab: usize) -> DepthColumns {
        let first = slab * self.plan.slab;
        DepthColumns(
            (first..(first + self.plan.slab).min(self.points.grid().z.count))
                .map(|z| self.points.at(2, z))
                .collect(),
        )
    }

    /// Gives the volume to the job's sink.
    pub(crate) fn image(self, job: Job<'_>) -> Result<ReconstructionInfo> {
        let Job { source, mut kept, weights, grid, interpolation, batch, sink, observer, .. } = job;
        let (band, budget) = series_budget(self.plan, self.band, job.budget);
        let radius = self.leaves.iter().map(|tile| tile.radius).fold(0.0, f64::max);
        let whole = interval(self.plan, source.instrument(), self.points, radius);
        let compressed =
            VolumeTones::compress((source, weights), &mut kept, (whole, budget.tones), observer)?;
        let instrument = source.instrument();
        let leaves = Leaves::new(self.plan, instrument, band, &compressed, (whole, radius), budget.tones);
        let error = self.plan.error + self.plan.growth * budget.error(&leaves.slabs);
        let error_bound = interpolation.with(error) * compressed.modulus;
        let at_once = self.plan.at_once.min(grid.z.count);
        let rows_of_nodes: u64 =
            self.frames.iter().map(|frames| self.tree.rows(frames.iter().map(Vec::len))).sum();
        let for_slab = rows_of_nodes + (self.leaves.len() * leaves.slabs.len()) as u64;
        let slabs = grid.z.count.div_ceil(self.plan.slab) as u64;
        let driver = SlabDriver::even(grid, at_once, |_| grid.y.count as u64, observer);
        let driver = SlabDriver { other_work: slabs * for_slab, ..driver };
        let info = ReconstructionInfo::plain(Method::Backprojection, error_bound);
        // Slabs whose nodes are summed, or not needed since a run resumes after them.
        let (mut done, mut nodes) = (0, Vec::<HeldNodes>::new());
        driver.run(info, sink, |_, depths, planes| {
            let slab = depths.start / self.plan.slab;
            if slab >= done {
                advance(observer, for_slab * (slab - done) as u64)?;
                done = slab + 1;
                nodes.clear();
                let depths = self.depths(slab);
                let each = self.leaves.len() / self.frames.len();
                for (frames, tiles) in self.frames.iter().zip(self.leaves.chunks_exact(each)) {
                    let (needed, above) = self.tree.needs(frames, &depths);
                    let summed = leaves.summed(tiles, needed, batch, observer)?;
                    nodes.push(self.tree.merged(summed, above, batch, |rows| advance(observer, rows))?);
                }
            }
            let places = DepthColumns(depths.clone().map(|z| self.points.at(2, z)).collect());
            let filled: Vec<FilledNodes<'_>> = nodes.iter().flat_map(HeldNodes::filled).collect();
            let width = grid.x.count;
            // Of every plane the same rows.
            let mut of_rows: Vec<Vec<&mut [Complex32]>> =
                (0..grid.y.count).step_by(ROWS).map(|_| Vec::with_capacity(depths.len())).collect();
            for plane in planes.chunks_exact_mut(grid.plane_len()) {
                of_rows.iter_mut().zip(plane.chunks_mut(ROWS * width)).for_each(|(all, rows)| all.push(rows));
            }
            let least = batch.least_run(of_rows.len());
            let of_rows = of_rows.into_par_iter().with_min_len(least).with_max_len(1).enumerate();
            of_rows.try_for_each(|(i, mut rows)| {
                let first = i * ROWS;
                let ys = first..(first + ROWS).min(grid.y.count);
                let count = ys.len() as u64;
                let store = |[x, y]: [usize; 2], re: &[f32], im: &[f32]| {
                    let at = (y - first) * width + x;
                    for (row, (re, im)) in rows.iter_mut().zip(re.iter().zip(im)) {
                        row[at] = Complex32::new(*re, *im);
                    }
                };
                self.tree.with_buffers(|buffers| {
                    self.tree.voxels().rows(&filled, &places, ys, buffers, store);
                    advance(observer, count)
                })
            })
        })
    }
}
