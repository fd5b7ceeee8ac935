//! Back-projection: each microphone's range profile, looked at along every voxel's path; any array, any grid.
//!
//! `Σ_f w m(f, r) e^{−i2πf·path/c} = e^{−i2πf_c·path/c} · g_r(path)`, where the demodulated range profile g_r is
//! band-limited to B. About the centre of a small block of voxels only a short stretch of it is seen, and there it is a
//! Chebyshev series of few terms ([`profile`]). So the sum over frequencies costs a dozen terms instead of hundreds,
//! whatever their number.
//!
//! Voxels closer together than the image changes are interpolated from fewer nodes ([`coarse`]); what follows is then
//! done for those.
//!
//! 1. The sweep is compressed to skeleton tones for all path lengths, and again for each slab of depths.
//! 2. For each block and each group of 16 microphones: tones to series coefficients, on the half-width of delays that
//!    the block has ([`blocks`]).
//! 3. For each of these microphones and each voxel of the block: path, series, carrier, sum.
//!
//! Errors, relative to `Σ|w m| / Σw`: cutting off the series, bounded by the coefficients left out; and the skeletons'
//! measured error, which the series can amplify by no more than its Lebesgue constant. Interpolation amplifies both by the
//! sum of its weights' moduli, and adds its own measured error.

mod blocks;
mod coarse;
mod profile;
mod terms;

use super::tones::VolumeTones;
use super::weights::Weights;
use super::{Made, Method, VolumeSink, no_room_for};
use crate::acquisition::{CubeSource, Setup};
use crate::error::Result;
use crate::grid::{Grid, zeros};
use crate::progress::{Observer, advance, stage};
use crate::wave::Geometry;
use crate::wave::interval::{PathInterval, greater};
use crate::wave::simd::{LANES, LaneProfiles, LaneTones, RangeScale, back_project, range_profiles};
use blocks::{Block, Group, Shape, greatest_half, half_width};
use coarse::Lattice;
use glam::DVec3;
use num_complex::Complex32;
use profile::{Band, Rung, lebesgue};
use rayon::prelude::*;
use std::ops::Range;

/// The share of the tolerance that cutting off the series may use.
const SERIES_SHARE: f64 = 0.6;

/// The share of what is left to the skeletons that the first of the two compressions may use.
const FIRST_SHARE: f64 = 0.3;

/// The most slabs that depths are dealt out to; each has a decomposition of its own.
const MOST_SLABS: usize = 32;

/// Groups of microphones whose f32 sums are kept apart from those of the others, so that rounding does not add up.
const GROUPS_PER_SUM: usize = 16;

/// Below so many operations no coarser lattice is looked for.
const LEAST_FOR_LATTICE: f64 = 1e9;

/// How one job is divided.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    /// The voxels.
    grid: Grid,
    /// For the voxels themselves.
    fine: Division,
    /// For nodes that the voxels are interpolated from, where that takes fewer operations.
    coarse: Option<(Lattice, Division)>,
    /// Operations of the job by a fixed model.
    operations: f64,
}

/// How the points of one grid are divided.
#[derive(Debug, Clone)]
struct Division {
    grid: Grid,
    geometry: Geometry,
    band: Band,
    shape: Shape,
    /// Depths per slab, a multiple of the blocks'.
    thickness: usize,
    operations: f64,
}

impl Plan {
    /// Divides a job by a fixed operation count, so that the same job is always divided alike.
    pub(super) fn new(setup: &Setup, grid: &Grid, tolerance: f64) -> Self {
        let fine = Division::new(setup, grid, tolerance);
        let coarse = (fine.operations > LEAST_FOR_LATTICE)
            .then(|| Lattice::find(setup, grid, tolerance))
            .flatten()
            .map(|lattice| {
                let accuracy = (1.0 - coarse::SHARE) * tolerance / coarse::USUAL_AMPLIFICATION;
                let mut division = Division::new(setup, &lattice.grid(grid), accuracy);
                division.operations += lattice.operations(grid);
                (lattice, division)
            })
            .filter(|(_, coarse)| coarse.operations < fine.operations);
        let operations = coarse.as_ref().map_or(fine.operations, |(_, coarse)| coarse.operations);
        Self { grid: *grid, fine, coarse, operations }
    }

    /// Voxels of a slab.
    pub(super) fn slab_voxels(&self) -> u64 {
        let thickness = |division: &Division| division.thickness.min(self.grid.z.count) as u64;
        let coarse = self.coarse.as_ref().map_or(0, |(_, division)| thickness(division));
        let plane = (self.grid.x.count as u64).saturating_mul(self.grid.y.count as u64);
        thickness(&self.fine).max(2 * coarse).saturating_mul(plane)
    }

    /// Operations of the job, comparable with those of [`super::direct`].
    pub(super) fn operations(&self) -> f64 {
        self.operations
    }
}

impl Division {
    /// The division of fewest operations.
    fn new(setup: &Setup, grid: &Grid, tolerance: f64) -> Self {
        let band = Band {
            carrier: setup.sweep.centre(),
            bandwidth: setup.sweep.bandwidth(),
            sound_speed: setup.sound_speed,
            tolerance: SERIES_SHARE * tolerance,
        };
        let places = setup.array.positions();
        let step = places.len().div_ceil(24);
        let sample: Vec<DVec3> = places.iter().copied().skip(step / 2).step_by(step).collect();
        let thickness = |shape: Shape| -> usize {
            let depths = shape.0[2];
            depths * grid.z.count.div_ceil(MOST_SLABS).div_ceil(depths)
        };
        let cost = |shape: Shape| {
            let last = thickness(shape).min(grid.z.count);
            let interval = interval(setup, grid, shape, grid.z.count - last..grid.z.count);
            let tones = (band.bandwidth * interval.duration() + 10.0).min(setup.sweep.len() as f64);
            shape.operations(grid, &setup.geometry, &sample, &band, tones).map(|cost| (shape, cost))
        };
        let (shape, cost) = Shape::candidates(grid)
            .filter_map(cost)
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap_or((Shape([1; 3]), f64::INFINITY));
        let terms = grid.voxel_count() as f64 * places.len() as f64;
        let thickness = thickness(shape);
        Self { grid: *grid, geometry: setup.geometry, band, shape, thickness, operations: terms * cost }
    }
}

/// All delays at which profiles of these depths are expanded: the path lengths, and a half-width to both sides.
fn interval(setup: &Setup, grid: &Grid, shape: Shape, depths: Range<usize>) -> PathInterval {
    let paths = setup.path_interval(grid, depths);
    let margin = greatest_half(shape.half(grid));
    PathInterval { shortest: paths.shortest - margin, longest: paths.longest + margin, ..paths }
}

/// Gives the volume to `sink`.
///
/// Cost: some 130 operations per voxel and microphone for a tolerance of 10⁻⁴ and voxels that sample the image well;
/// memory for the skeleton tones of all microphones.
pub(super) fn backprojection(
    source: &mut dyn CubeSource,
    weights: &Weights,
    plan: &Plan,
    tolerance: f64,
    sink: &mut dyn VolumeSink,
    observer: &dyn Observer,
) -> Result<Made> {
    let depths = plan.grid.z.count;
    let coarse = plan.coarse.as_ref().and_then(|(lattice, division)| {
        lattice.interpolation(&plan.grid, tolerance).map(|interpolation| (interpolation, division.clone()))
    });
    let (interpolation, mut division) = coarse.map_or((None, plan.fine.clone()), |(i, d)| (Some(i), d));
    // What interpolation leaves of the tolerance, and by how much it amplifies errors of the nodes.
    let (inexact, growth) = interpolation.as_ref().map_or((0.0, 1.0), |i| (i.error, i.amplification));
    let tolerance = (tolerance - inexact) / growth;
    division.band.tolerance = SERIES_SHARE * tolerance;
    let Division { grid, shape, thickness, .. } = division;
    let greatest = greatest_half(shape.half(&grid));
    let (terms, series_error) = division.band.terms(greatest);
    let amplification = lebesgue(terms);
    let allowed = (tolerance - series_error) / amplification;
    let whole = interval(&source.setup(), &grid, shape, 0..depths);
    let compressed = VolumeTones::compress(source, weights, whole, FIRST_SHARE * allowed, observer)?;
    let setup = source.setup();
    let slabs = compressed.slabs(depths, thickness, |depths| interval(&setup, &grid, shape, depths), allowed);
    let skeletons = slabs.iter().map(|slab| slab.error).fold(0.0, greater);
    let relative = inexact + growth * (series_error + amplification * skeletons);
    let made = Made { method: Method::Backprojection, error_bound: relative * compressed.modulus };
    sink.begin(&made)?;
    let groups = Group::all(setup.array.positions());
    let width = setup.array.len();
    let total = slabs.iter().map(|slab| Block::of(&grid, shape, slab.planes.clone()).len() as u64).sum();
    let room = |grid: &Grid| {
        let count = (thickness.min(depths) as u64).saturating_mul(grid.plane_len() as u64);
        zeros(count).ok_or_else(|| no_room_for(grid))
    };
    let mut planes = room(&grid)?;
    let mut finer = if interpolation.is_some() { room(&plan.grid)? } else { Vec::new() };
    stage(observer, "reconstructing", total, || {
        for slab_tones in &slabs {
            let depths = slab_tones.planes.clone();
            if depths.end <= sink.done() {
                advance(observer, Block::of(&grid, shape, depths).len() as u64)?;
                continue;
            }
            let tones = slab_tones.of(&compressed.tones, width);
            let frequencies: Vec<f64> = tones.per_metre.iter().map(|k| -k * setup.sound_speed).collect();
            let slab = Slab {
                division: &division,
                ladder: division.band.ladder(greatest, &frequencies),
                per_metre: &tones.per_metre,
                groups: groups.iter().map(|g| (g, g.tones(&tones, width))).collect(),
            };
            let blocks = Block::of(&grid, shape, depths.clone());
            let images: Vec<[Vec<f32>; 2]> = blocks
                .par_iter()
                .map(|block| {
                    let image = slab.image(block);
                    advance(observer, 1).map(|()| image)
                })
                .collect::<Result<_>>()?;
            let planes = &mut planes[..depths.len() * grid.plane_len()];
            for (block, image) in blocks.iter().zip(&images) {
                place(block, image, &grid, depths.start, planes);
            }
            let Some(interpolation) = &interpolation else {
                sink.take(depths.start, planes)?;
                continue;
            };
            let finer = &mut finer[..depths.len() * plan.grid.plane_len()];
            let pairs = planes.par_chunks_exact_mut(grid.plane_len());
            let pairs = pairs.zip(finer.par_chunks_exact_mut(plan.grid.plane_len())).enumerate();
            pairs.for_each(|(z, (nodes, voxels))| {
                interpolation.plane(nodes, &plan.grid, grid.z.position(depths.start + z), voxels);
            });
            sink.take(depths.start, finer)?;
        }
        Ok(())
    })?;
    Ok(made)
}

/// What all blocks of a slab share.
struct Slab<'a> {
    division: &'a Division,
    ladder: Vec<Rung>,
    per_metre: &'a [f64],
    groups: Vec<(&'a Group, LaneTones)>,
}

impl Slab<'_> {
    /// The sums over all microphones at the voxels of a block, real and imaginary parts.
    fn image(&self, block: &Block) -> [Vec<f32>; 2] {
        let Division { grid, geometry, band, .. } = self.division;
        let (centre, half) = (block.centre(grid), Shape(block.count).half(grid));
        let out = geometry.outward_length(centre);
        let points = block.points(grid, geometry);
        let zeros = || [vec![0.0f32; points.padded_len()], vec![0.0f32; points.padded_len()]];
        let (mut totals, mut profiles) = (zeros(), LaneProfiles::default());
        for groups in self.groups.chunks(GROUPS_PER_SUM) {
            let mut sums = zeros();
            for (group, tones) in groups {
                let (mut lengths, mut widest) = ([0.0; LANES], 0.0f64);
                for (length, r) in lengths.iter_mut().zip(group.positions) {
                    *length = out + geometry.return_legs() * centre.distance(r);
                    widest = widest.max(half_width(geometry, centre, half, r));
                }
                let rung = self.ladder.partition_point(|rung| rung.half < widest).min(self.ladder.len() - 1);
                let rung = &self.ladder[rung];
                profiles.re.resize(rung.columns, [0.0; LANES]);
                profiles.im.resize(rung.columns, [0.0; LANES]);
                range_profiles(tones, self.per_metre, &lengths, &rung.expansion, &mut profiles);
                let offsets = group.positions.map(|r| (centre - r).as_vec3().to_array());
                let scale = RangeScale {
                    legs: geometry.return_legs() as f32,
                    carrier: (-band.carrier / band.sound_speed) as f32,
                    inverse_half: if rung.half > 0.0 { (1.0 / rung.half) as f32 } else { 0.0 },
                    terms: rung.terms,
                    powers: rung.powers,
                };
                let [re, im] = &mut sums;
                back_project(&points, &offsets[..group.members.len()], &profiles, scale, [re, im]);
            }
            for (total, sum) in totals.iter_mut().flatten().zip(sums.iter().flatten()) {
                *total += sum;
            }
        }
        totals
    }
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
