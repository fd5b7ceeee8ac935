//! Back-projection: each microphone's range profile, evaluated at every voxel's path length; any array, any grid.
//!
//! `Σ_f w m(f, r) e^{−i2πf·path/c} = e^{−i2πf_c·path/c} · g_r(path)`, where the demodulated range profile g_r is
//! band-limited to B. About the centre of a small block of voxels only a short stretch of it is distances, and there it is a
//! Chebyshev series of few terms ([`profile`]). So the sum over frequencies costs a dozen terms instead of hundreds,
//! whatever their number.
//!
//! 1. The sweep is compressed to virtual tones for all path lengths, and these to skeleton tones for each slab of depths.
//! 2. For each block and each group of 16 microphones: tones to series coefficients, on the half-width of delays that
//!    the block has ([`blocks`]).
//! 3. For each of these microphones and each voxel of the block: path, series, carrier, sum.
//!
//! Where the array and the volume are apart, this is done level by level, as fast factorised back-projection of radar
//! images is (Ulander, Hellsten, Stenström 2003): first for small tiles of the array, each on few nodes of coordinates in
//! which its image hardly changes sideways; then the nodes of larger tiles from those of the smaller that they are made
//! of; last the voxels from the nodes of the largest. So the cost grows with voxels times the logarithm of microphones.
//!
//! The microphones of a lattice are summed line by line instead, where that takes fewer operations ([`lines`]).
//!
//! Errors, relative to `Σ|w m| / Σw`: cutting off the series, bounded by the coefficients left out; and the skeletons'
//! measured error, which the series can amplify by no more than its Lebesgue constant. Interpolation amplifies both by the
//! sum of its weights' moduli, and adds its own measured error.

mod blocks;
mod division;
mod factorised;
mod lines;
mod pairs;
mod profile;

use crate::acquisition::Instrument;
use crate::blocks::runs;
use crate::error::Result;
use crate::grid::Grid;
use crate::progress::advance;
use crate::reconstruct::compress::{CompressionCost, SlabTones, VolumeTones};
use crate::reconstruct::error_budget::ErrorBudget;
use crate::reconstruct::job::Job;
use crate::reconstruct::numerics::GridPlaces;
use crate::reconstruct::plan::cost::{COMPLEX, Cost};
use crate::reconstruct::volume::{Batch, Slab, SlabDriver};
use crate::reconstruct::{Method, ReconstructionInfo};
use crate::wave::Geometry;
use crate::wave::interval::{PathInterval, greater};
use crate::wave::simd::{LANES, LaneProfiles, LaneTones, Points, RangeScale, back_project, range_profiles};
use blocks::{Block, Group, HalfWidths, greatest_half};
use division::{Division, interval};
use factorised::{TileLevels, TileSearch, Tiled};
use glam::DVec3;
use lines::LinesPlan;
use num_complex::Complex32;
use profile::{Band, Ladder, lebesgue};
use rayon::prelude::*;

/// Bytes per microphone of its place in a group, and of the indices from which groups and tiles are cut.
const GROUP_BYTES: u64 = 64;

/// Groups of microphones whose f32 sums are kept apart from those of the others, so that rounding does not add up.
const GROUPS_PER_SUM: usize = 16;

/// Below this many operations no lines are tried, which takes about as long as a tenth of them.
const LEAST_FOR_LINES: f64 = 1e10;

/// How one job is divided.
#[derive(Debug, Clone)]
pub(super) struct BackprojectionPlan {
    /// The voxels, or nodes.
    points: GridPlaces,
    budget: ErrorBudget,
    /// For the voxels themselves.
    fine: Division,
    way: Way,
    /// Operations of lines that were priced only, because another method takes fewer; infinite where there are none.
    untried: f64,
}

/// From what voxels are summed: what takes the fewest operations.
#[derive(Debug, Clone)]
enum Way {
    Microphones,
    /// The lines of a lattice.
    Lines(Box<LinesPlan>),
    /// The nodes of tiles.
    Tiles(Box<TileLevels>),
}

impl BackprojectionPlan {
    /// Divides a job by a fixed operation count, so that the same job is always divided alike: by lines if that takes fewer
    /// operations than `most`, or else by single microphones; uneven points by these alone.
    pub(super) fn new(instrument: &Instrument, points: GridPlaces, budget: ErrorBudget, most: f64) -> Self {
        let fine = Division::new(instrument, &points, budget);
        let most = fine.operations.min(most);
        let found = if most > LEAST_FOR_LINES && points.are_even() {
            LinesPlan::find(instrument, points.grid(), budget, most)
        } else {
            Err(f64::INFINITY)
        };
        let (way, untried) = match found {
            Ok(lines) => (Way::Lines(Box::new(lines)), f64::INFINITY),
            Err(untried) => (Way::Microphones, untried),
        };
        Self { points, budget, fine, way, untried }
    }

    /// The same by tiles, if these take fewer operations than `most`, which takes time to find out; without the memory to try
    /// them there are none.
    pub(super) fn with_tiles(&self, instrument: &Instrument, most: f64) -> Option<Self> {
        let band = Band { tolerance: factorised::usual_budget(self.budget).series(), ..self.fine.band };
        let tiles = TileSearch::new(instrument, &self.points, band).find(self.budget, most).ok().flatten()?;
        Some(Self { way: Way::Tiles(Box::new(tiles)), ..self.clone() })
    }

    /// Those of single microphones.
    pub(super) fn operations_by_microphones(&self) -> f64 {
        self.fine.operations
    }

    /// Without those of compression.
    pub(super) fn operations(&self) -> f64 {
        match &self.way {
            Way::Microphones => self.fine.operations.min(self.untried),
            Way::Lines(lines) => lines.operations,
            Way::Tiles(levels) => levels.operations,
        }
    }

    /// All path lengths at which range profiles are expanded, and what the two compressions may err by.
    fn compression(&self, instrument: &Instrument) -> (PathInterval, ErrorBudget) {
        let Division { band, shape, .. } = self.fine;
        match &self.way {
            Way::Microphones => {
                let budget =
                    SeriesBudget::new(&band, greatest_half(shape.half(self.points.grid())), self.budget);
                (interval(instrument, &self.points, shape, 0..self.points.grid().z.count), budget.tones)
            }
            Way::Lines(lines) => lines.compression(instrument, self.points.grid(), self.budget),
            Way::Tiles(levels) => {
                factorised::compression(levels, instrument, &self.points, band, self.budget)
            }
        }
    }

    /// With the memory of a batch for this many threads.
    pub(super) fn cost(&self, instrument: &Instrument, threads: usize) -> Cost<'static> {
        let (interval, budget) = self.compression(instrument);
        let compression = CompressionCost::new(instrument, &interval, budget);
        let grid = self.points.grid();
        let (plane, depths) = (grid.plane_len() as u64, grid.z.count);
        // Depths at a time, and how many of them are out of order as they are summed; bytes of nodes, and of a thread's row.
        let (at_once, out_of_order, nodes, row) = match &self.way {
            Way::Microphones => (self.fine.thickness, self.fine.thickness, 0, 0),
            Way::Lines(lines) => (lines.at_once, 0, lines.bytes, 0),
            Way::Tiles(levels) => (levels.at_once, 0, levels.bytes as u64, levels.row_bytes as u64),
        };
        let summed = (out_of_order.min(depths) as u64).saturating_mul(plane);
        let focusing = (COMPLEX.saturating_mul(summed))
            .saturating_add(nodes)
            .saturating_add(SlabDriver::bytes(plane, at_once, depths))
            .saturating_add(compression.samples.saturating_mul(2));
        let worker = row.saturating_add(1 << 20);
        // The last slab's interval is the longest where the voxels are before the array.
        let skeletons = if let Way::Microphones = self.way {
            let slabs = depths.div_ceil(self.fine.thickness);
            let last = (slabs - 1) * self.fine.thickness..depths;
            let first = 0..self.fine.thickness.min(depths);
            let of_slab = |planes| {
                compression.skeleton_bytes(&self::interval(instrument, &self.points, self.fine.shape, planes))
            };
            of_slab(last).max(of_slab(first)).saturating_mul(threads.clamp(1, slabs) as u64)
        } else {
            0
        };
        let groups = GROUP_BYTES.saturating_mul(instrument.array.len() as u64);
        Cost {
            operations: self.operations() + compression.operations,
            usual: Batch::of_threads(threads),
            bytes: Box::new(move |batch| {
                let focusing = focusing.saturating_add(worker.saturating_mul(batch.workers as u64));
                compression
                    .peak
                    .max(focusing)
                    .max(compression.samples.saturating_add(skeletons))
                    .saturating_add(groups)
            }),
        }
    }
}

/// Whether a slab takes the tones of another, a little longer: where they are hardly more than its own, which would have
/// to be found.
fn share(longer: f64, own: f64, _: usize) -> bool {
    (0.0..=0.5).contains(&(longer - own))
}

/// Gives the volume to the job's sink.
///
/// Cost: some 100 operations per voxel and microphone for a tolerance of 10⁻⁴ and voxels that sample the image well, by
/// tiles ten times fewer or less; memory for the virtual tones of all microphones, and for the nodes.
pub(super) fn backprojection(job: Job<'_>, plan: &BackprojectionPlan) -> Result<ReconstructionInfo> {
    match &plan.way {
        Way::Microphones => by_microphones(job, &plan.points, plan.fine),
        Way::Lines(lines) => lines::image(lines, job),
        Way::Tiles(levels) => {
            Tiled::new(levels, job.source.instrument(), &plan.points, plan.fine.band).image(job)
        }
    }
}

/// The same microphone by microphone.
fn by_microphones(job: Job<'_>, points: &GridPlaces, division: Division) -> Result<ReconstructionInfo> {
    let Job { source, mut kept, weights, grid, budget, interpolation, batch, sink, observer } = job;
    let Division { band, shape, thickness, .. } = division;
    let greatest = greatest_half(shape.half(grid));
    let budget = SeriesBudget::new(&band, greatest, budget);
    let whole = interval(source.instrument(), points, shape, 0..grid.z.count);
    let compressed = VolumeTones::compress((source, weights), &mut kept, (whole, budget.tones), observer)?;
    let instrument = source.instrument();
    let interval = |depths| interval(instrument, points, shape, depths);
    let slabs = compressed.sweep.slabs(runs(grid.z.count, thickness), interval, share, budget.tones);
    let error_bound = interpolation.with(budget.error(&slabs)) * compressed.modulus;
    let groups = Group::of(instrument.array.positions(), (0..instrument.array.len()).collect());
    let width = instrument.array.len();
    let of_driver = |slab: &SlabTones| {
        let depths = slab.planes.clone();
        Slab { work: Block::of(grid, shape, depths.clone()).len() as u64, depths }
    };
    let driver = SlabDriver::new(grid, slabs.iter().map(of_driver).collect(), observer);
    let info = ReconstructionInfo::plain(Method::Backprojection, error_bound);
    driver.run(info, sink, |part, depths, planes| {
        let tones = slabs[part.start].of(&compressed, width)?;
        let profiles = SlabProfiles::new(instrument, band, greatest, tones.per_metre.clone());
        let groups: Vec<_> = groups.iter().map(|g| (g, g.tones(&tones, width))).collect();
        let blocks = Block::of(grid, shape, depths.clone());
        let images: Vec<[Vec<f32>; 2]> = blocks
            .par_iter()
            .with_min_len(batch.least_run(blocks.len()))
            .map(|block| {
                let (centre, half) = block.centre_and_half(points);
                let image = if let Geometry::Pair { .. } = instrument.geometry {
                    let geometry_of = |microphone: usize| instrument.geometry_of(microphone);
                    let width_of =
                        |(i, r): (&usize, &DVec3)| HalfWidths::new(&geometry_of(*i), centre, half).of(*r);
                    let widest = |group: &Group| {
                        group.members.iter().zip(&group.positions).map(width_of).fold(0.0, greater)
                    };
                    profiles.image_of_pairs(centre, &block.places(points), geometry_of, &groups, widest)
                } else {
                    let widths = HalfWidths::new(&instrument.geometry, centre, half);
                    let widest = |group: &Group| widths.of_group(group);
                    profiles.image(centre, &block.points(points, &instrument.geometry), &groups, widest)
                };
                advance(observer, 1).map(|()| image)
            })
            .collect::<Result<_>>()?;
        for (block, image) in blocks.iter().zip(&images) {
            place(block, image, grid, depths.start, planes);
        }
        Ok(())
    })
}

/// What cutting off the series errs by, and what that leaves to the tones.
struct SeriesBudget {
    /// Of cutting off the series.
    series: f64,
    /// By how much a series amplifies errors of its tones.
    amplification: f64,
    /// What the two compressions of the sweep may err by.
    tones: ErrorBudget,
}

impl SeriesBudget {
    /// For profiles up to `greatest` m to both sides of a centre.
    fn new(band: &Band, greatest: f64, budget: ErrorBudget) -> Self {
        let (terms, series) = band.terms(greatest);
        let amplification = lebesgue(terms);
        Self { series, amplification, tones: budget.after(series).before(amplification) }
    }

    /// The error of all steps with the skeletons that were found.
    fn error(&self, slabs: &[SlabTones]) -> f64 {
        self.series + self.amplification * SlabTones::error(slabs)
    }
}

/// What blocks share that are summed from the same tones.
struct SlabProfiles {
    geometry: Geometry,
    band: Band,
    ladder: Ladder,
    per_metre: Vec<f64>,
}

impl SlabProfiles {
    /// For tones whose profiles reach up to `greatest` m to both sides of a centre.
    fn new(instrument: &Instrument, band: Band, greatest: f64, per_metre: Vec<f64>) -> Self {
        let frequencies = per_metre.iter().map(|k| -k * instrument.sound_speed).collect();
        let ladder = band.ladder(greatest, frequencies);
        Self { geometry: instrument.geometry, band, ladder, per_metre }
    }

    /// The sums over microphones at points about a centre, real and imaginary parts. `widest` bounds how much a path
    /// length of a group differs from that of the centre, m.
    fn image(
        &self,
        centre: DVec3,
        points: &Points,
        groups: &[(&Group, LaneTones)],
        widest: impl Fn(&Group) -> f64,
    ) -> [Vec<f32>; 2] {
        let geometry = &self.geometry;
        let out = geometry.outward_length(centre);
        let mut profiles = LaneProfiles::default();
        in_sums(groups, points.padded_len(), |group, tones, sums| {
            let lengths = group.positions.map(|r| out + geometry.return_legs() * centre.distance(r));
            let scale = self.expand(tones, &lengths, widest(group), &mut profiles);
            let offsets = group.positions.map(|r| (centre - r).as_vec3().to_array());
            let [re, im] = sums;
            back_project(points, &offsets[..group.members.len()], &profiles, scale, [re, im]);
        })
    }

    /// Expands the profiles of a group about path lengths, up to `widest` m to both sides; how they are read.
    fn expand(
        &self,
        tones: &LaneTones,
        lengths: &[f64; LANES],
        widest: f64,
        profiles: &mut LaneProfiles,
    ) -> RangeScale {
        let (geometry, band) = (&self.geometry, &self.band);
        let rung = self.ladder.rung(widest);
        profiles.re.resize(rung.columns, [0.0; LANES]);
        profiles.im.resize(rung.columns, [0.0; LANES]);
        range_profiles(tones, &self.per_metre, lengths, &rung.expansion, profiles);
        RangeScale {
            legs: geometry.return_legs() as f32,
            carrier: (-band.carrier / band.sound_speed) as f32,
            inverse_half: if rung.half > 0.0 { (1.0 / rung.half) as f32 } else { 0.0 },
            terms: rung.terms,
            powers: rung.powers,
        }
    }
}

/// The sum of what `add` adds for every group, of some groups at a time by themselves.
fn in_sums(
    groups: &[(&Group, LaneTones)],
    padded: usize,
    mut add: impl FnMut(&Group, &LaneTones, &mut [Vec<f32>; 2]),
) -> [Vec<f32>; 2] {
    let zeros = || [vec![0.0f32; padded], vec![0.0f32; padded]];
    let mut parts = groups.chunks(GROUPS_PER_SUM).map(|groups| {
        let mut sums = zeros();
        for (group, tones) in groups {
            add(group, tones, &mut sums);
        }
        sums
    });
    let mut totals = parts.next().unwrap_or_else(zeros);
    for sums in parts {
        for (total, sum) in totals.iter_mut().flatten().zip(sums.iter().flatten()) {
            *total += sum;
        }
    }
    totals
}

/// Puts a block's image into its place among the planes from depth `from` on.
fn place(block: &Block, [re, im]: &[Vec<f32>; 2], grid: &Grid, from: usize, planes: &mut [Complex32]) {
    let [x, y, z] = block.first;
    let [n_x, n_y, n_z] = block.count;
    for row in 0..n_y * n_z {
        let first = ((z - from + row / n_y) * grid.y.count + y + row % n_y) * grid.x.count + x;
        let values = re[row * n_x..].iter().zip(&im[row * n_x..]);
        for (voxel, (re, im)) in planes[first..first + n_x].iter_mut().zip(values) {
            *voxel = Complex32::new(*re, *im);
        }
    }
}

#[cfg(test)]
mod tests;
