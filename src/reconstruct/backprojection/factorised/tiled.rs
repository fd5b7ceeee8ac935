//! Back-projection in two steps: every tile of the array onto a few nodes of its own, and those onto the voxels.

use super::frame::{Frame, halved};
use super::nodes::{TileLattice, USUAL_GROWTH};
use super::patches::Patch;
use super::voxels::{Interpolation, RowBuffers, TileNodes, hull};
use crate::acquisition::{Instrument, Tile};
use crate::alloc::try_zeroed;
use crate::error::Result;
use crate::grid::Grid;
use crate::progress::{Observer, advance};
use crate::reconstruct::backprojection::blocks::Group;
use crate::reconstruct::backprojection::profile::Band;
use crate::reconstruct::backprojection::{MOST_SLABS, SeriesBudget, SlabProfiles, share};
use crate::reconstruct::compress::{SlabTones, VolumeTones, slabs_of};
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::job::Job;
use crate::reconstruct::numerics::BEYOND;
use crate::reconstruct::volume::{Batch, SlabDriver};
use crate::reconstruct::{Method, ReconstructionInfo, no_room_for};
use crate::wave::interval::{PathInterval, greater};
use crate::wave::simd::{LANES, phasors};
use num_complex::Complex32;
use rayon::prelude::*;
use std::ops::Range;

/// Depths whose voxels are worked on at a time.
pub(crate) const DEPTHS: usize = 32;

/// The budget of nodes that is assumed when work is estimated.
pub(crate) fn usual_budget(budget: ErrorBudget) -> ErrorBudget {
    budget.before_interpolation(USUAL_GROWTH)
}

/// The band of nodes' range profiles and the budget of its series, for half-widths of up to `half` m: what interpolation
/// leaves of the budget, divided by how much it amplifies errors of the nodes.
fn series_budget(lattice: &TileLattice, band: Band, half: f64, budget: ErrorBudget) -> (Band, SeriesBudget) {
    let budget = budget.after(lattice.error).before(lattice.growth);
    let band = Band { tolerance: budget.series(), ..band };
    (band, SeriesBudget::new(&band, half, budget))
}

/// About all path lengths at which profiles of nodes are expanded, and what the two compressions may err by.
pub(crate) fn compression(
    lattice: &TileLattice,
    instrument: &Instrument,
    grid: &Grid,
    band: Band,
    budget: ErrorBudget,
) -> (PathInterval, ErrorBudget) {
    let paths = instrument.path_interval(grid, 0..grid.z.count);
    let (shortest, longest) = (paths.shortest - lattice.half, paths.longest + lattice.half);
    let (_, budget) = series_budget(lattice, band, lattice.half, budget);
    (PathInterval { shortest, longest, ..paths }, budget.tones)
}

/// Bytes that a thread needs for a row of voxels, about: their partial sums, and nodes along ρ in their columns.
pub(crate) fn row_bytes(grid: &Grid) -> u64 {
    (grid.x.count as u64).saturating_mul((DEPTHS * 2 * size_of::<[f32; LANES]>() + 3 * DEPTHS * 8) as u64)
}

/// What one job needs of its nodes, all places known.
pub(crate) struct Tiled<'a> {
    lattice: &'a TileLattice,
    interpolation: Interpolation<'a>,
    band: Band,
    tiles: Vec<Tile>,
    nodes: Vec<TileNodes>,
    /// Nodes along ρ that are summed with the same tones, as multiples of the pitch, with their patches.
    shells: Vec<(Range<usize>, Vec<Patch>)>,
    /// By how much a path length differs from that of its patch's centre at most, m.
    greatest: f64,
}

impl<'a> Tiled<'a> {
    /// Places all nodes; `None` if one that is needed would be where no point has its range.
    pub(crate) fn new(
        lattice: &'a TileLattice,
        instrument: &Instrument,
        grid: &'a Grid,
        band: Band,
    ) -> Result<Option<Self>> {
        let tiles = halved(instrument.array.positions(), lattice.times);
        let interpolation = Interpolation::new(lattice, grid, band.carrier / band.sound_speed);
        let needs = |tile: &Tile| {
            let frame = Frame::new(&instrument.geometry, tile.centre);
            let needed = interpolation.needed(&frame);
            let held = needed.iter().cloned().fold(0..0, hull);
            TileNodes { frame, held, needed, values: [Vec::new(), Vec::new()] }
        };
        let mut nodes: Vec<TileNodes> = tiles.par_iter().map(needs).collect();
        for nodes in &mut nodes {
            let room = nodes.needed.len() * nodes.held.len() + BEYOND;
            for part in &mut nodes.values {
                part.try_reserve_exact(room).map_err(|_| no_room_for(grid))?;
                part.resize(room, 0.0);
            }
        }
        let all = nodes.iter().map(|tile| tile.held.clone()).fold(0..0, hull);
        let blocks = all.len().div_ceil(lattice.block[2]);
        let thickness = lattice.block[2];
        let patches = |shell: usize| {
            let start = all.start + shell * thickness;
            let shell = start..(start + thickness).min(all.end);
            let each = tiles.iter().zip(&nodes).enumerate().map(|(index, (tile, nodes))| {
                Patch::of(lattice, &instrument.geometry, shell.clone(), (index, tile, nodes))
            });
            let each: Option<Vec<Vec<Patch>>> = each.collect();
            each.map(|patches| (shell, patches.concat()))
        };
        let shells: Option<Vec<_>> = (0..blocks).into_par_iter().map(patches).collect();
        Ok(shells.map(|shells: Vec<(Range<usize>, Vec<Patch>)>| {
            let halves = shells.iter().flat_map(|(_, patches)| patches.iter().map(|patch| patch.half));
            let greatest = halves.fold(0.0, greater);
            Self { lattice, interpolation, band, tiles, nodes, shells, greatest }
        }))
    }

    /// Path lengths at which profiles of some nodes along ρ are expanded.
    fn interval(&self, instrument: &Instrument, range: &Range<usize>) -> PathInterval {
        let radius = self.tiles.iter().map(|tile| tile.radius).fold(0.0, greater);
        let margin = instrument.geometry.return_legs() * radius + self.greatest;
        let at = |node: usize| self.lattice.pitch * node as f64;
        PathInterval {
            shortest: at(range.start) - margin,
            longest: at(range.end - 1) + margin,
            sound_speed: instrument.sound_speed,
        }
    }

    /// Gives the volume to the job's sink.
    pub(crate) fn image(mut self, job: Job<'_>) -> Result<ReconstructionInfo> {
        let Job { source, weights, grid, interpolation, batch, sink, observer, .. } = job;
        let TileLattice { error: inexact, growth, .. } = *self.lattice;
        let budget;
        (self.band, budget) = series_budget(self.lattice, self.band, self.greatest, job.budget);
        let whole = self.shells[0].0.start..self.shells[self.shells.len() - 1].0.end;
        let whole = self.interval(source.instrument(), &whole);
        let compressed = VolumeTones::compress(source, weights, whole, budget.tones, observer)?;
        let instrument = source.instrument();
        let interval = |shells: Range<usize>| {
            let (first, last) = (&self.shells[shells.start].0, &self.shells[shells.end - 1].0);
            self.interval(instrument, &(first.start..last.end))
        };
        let together = self.shells.len().div_ceil(MOST_SLABS);
        let slabs = compressed.slabs(slabs_of(self.shells.len(), together), interval, share, budget.tones);
        let error = inexact + growth * budget.error(&slabs);
        let error_bound = interpolation.with(error) * compressed.modulus;
        let groups: Vec<Vec<Group>> = self
            .tiles
            .iter()
            .map(|tile| Group::of(instrument.array.positions(), tile.microphones.clone()))
            .collect();
        let count = (DEPTHS.min(grid.z.count) as u64).saturating_mul(grid.plane_len() as u64);
        let mut rows = try_zeroed(count).ok_or_else(|| no_room_for(grid))?;
        let patches = self.shells.iter().map(|(_, patches)| patches.len() as u64).sum();
        let driver = SlabDriver::even(grid, DEPTHS, |_| grid.y.count as u64, observer);
        let driver = SlabDriver { other_work: patches, ..driver };
        let info = ReconstructionInfo { method: Method::Backprojection, error_bound };
        // Slabs of shells whose nodes are summed, or not needed.
        let mut done = 0;
        driver.run(info, sink, |_, depths, planes| {
            let needed = self.nodes.par_iter().map(|tile| self.interpolation.needed_at(&tile.frame, &depths));
            let needed = needed.reduce(|| 0..0, hull);
            for slab in &slabs {
                let shells = slab.planes.clone();
                let (first, last) = (&self.shells[shells.start].0, &self.shells[shells.end - 1].0);
                if shells.start < done || first.start >= needed.end {
                    continue;
                }
                done = shells.end;
                if last.end > needed.start {
                    self.sum(instrument, slab, &compressed, &groups, batch, observer)?;
                } else {
                    // A run that resumes after its first depths needs nothing nearer.
                    let patches = self.shells[shells].iter().map(|(_, patches)| patches.len());
                    advance(observer, patches.sum::<usize>() as u64)?;
                }
            }
            let rows = &mut rows[..depths.len() * grid.plane_len()];
            let each = depths.len() * grid.x.count;
            rows.par_chunks_exact_mut(each)
                .with_min_len(batch.least_run(grid.y.count))
                .enumerate()
                .try_for_each_init(RowBuffers::default, |buffers, (y, row)| {
                    buffers.clear(row.len());
                    for tile in &self.nodes {
                        self.interpolation.add(tile, y, &depths, buffers);
                    }
                    row.iter_mut().zip(buffers.voxels()).for_each(|(to, voxel)| *to = voxel);
                    advance(observer, 1)
                })?;
            for (z, plane) in planes.chunks_exact_mut(grid.plane_len()).enumerate() {
                for (row, all) in plane.chunks_exact_mut(grid.x.count).zip(rows.chunks_exact(each)) {
                    row.copy_from_slice(&all[z * grid.x.count..][..grid.x.count]);
                }
            }
            Ok(())
        })
    }

    /// Sums the nodes of some shells over the microphones of each tile.
    fn sum(
        &mut self,
        instrument: &Instrument,
        slab: &SlabTones,
        compressed: &VolumeTones,
        groups: &[Vec<Group>],
        batch: Batch,
        observer: &dyn Observer,
    ) -> Result<()> {
        let width = instrument.array.len();
        let tones = slab.of(compressed, width)?;
        let profiles = SlabProfiles::new(instrument, self.band, self.greatest, &tones);
        let split: Vec<Vec<_>> = groups
            .iter()
            .map(|groups| groups.iter().map(|g| (g, g.tones(&tones, width))).collect())
            .collect();
        let per_metre = self.band.carrier / self.band.sound_speed;
        for (shell, patches) in &self.shells[slab.planes.clone()] {
            let lengths: Vec<f64> = shell.clone().map(|k| self.lattice.pitch * k as f64).collect();
            let mut turns = vec![Complex32::ZERO; lengths.len()];
            phasors(per_metre, &lengths, &mut turns);
            let image = |patch: &Patch| {
                let Some(placed) = patch.placed(self.lattice, &self.nodes[patch.tile]) else {
                    unreachable!("the same nodes were placed before")
                };
                let points = placed.points(&instrument.geometry);
                let image = profiles.image(placed.centre, &points, &split[patch.tile], |_| patch.half);
                advance(observer, 1).map(|()| image)
            };
            let images: Vec<[Vec<f32>; 2]> = patches
                .par_iter()
                .with_min_len(batch.least_run(patches.len()))
                .map(image)
                .collect::<Result<_>>()?;
            for (patch, image) in patches.iter().zip(&images) {
                patch.store(self.lattice, image, &turns, &mut self.nodes[patch.tile]);
            }
        }
        Ok(())
    }
}
