//! What all interpolations err by together: sampled terms are led through them and compared with what they should be.

use super::frame::{Frame, some};
use super::held::{FilledNodes, HeldNodes, PlaceColumns, TileNodes};
use super::merge::RowBuffers;
use super::nodes::TileLattice;
use super::terms::Terms;
use super::tree::Tree;
use crate::acquisition::{Instrument, Tile};
use crate::error::Result;
use crate::reconstruct::numerics::GridPlaces;
use crate::reconstruct::volume::Batch;
use crate::wave::interval::greater;
use crate::wave::simd::double::phasors_f64;
use glam::DVec3;
use num_complex::Complex64;
use rayon::prelude::*;

/// Tiles of the smallest size whose terms are tried: with the halves in order, the first and the last are at an array's
/// corners.
const TILES: usize = 3;

/// Voxels along x and y, as parts of the way from the first to the last.
const VOXELS: [f64; 3] = [0.0, 0.37, 1.0];

/// Voxels along z, among so many of the nearest, where terms change fastest.
const NEAR: usize = 4;
const NEAREST: usize = 24;

/// Voxels where a zone of ranges begins, by nodes along ρ from there on and parts of those that a voxel is made of: one that is
/// mostly made of nodes of the zone before, and the first that is made of its own alone.
const ZONE: [[f64; 2]; 2] = [[2.5, 0.0], [0.5, 0.5]];

/// Between the terms and voxels that are tried, errors are a little larger; by a fifth where that was looked for.
const BETWEEN: f64 = 1.3;

/// Bytes of nodes above which nothing is led through them: the bound of each interpolation by itself has to serve.
const MOST_BYTES: f64 = 67_108_864.0;

/// The error of voxels made of these levels' tiles, relative to one; `None` where a node would have no place.
pub(crate) fn error(
    levels: &[TileLattice],
    tiles: &[&[Tile]],
    instrument: &Instrument,
    points: &GridPlaces,
) -> Result<Option<f64>> {
    let few = |axis: usize| {
        let all = points.along(axis);
        let mut places: Vec<f64> =
            VOXELS.iter().map(|part| all[(part * (all.len() - 1) as f64) as usize]).collect();
        places.dedup();
        places
    };
    let depths = points.along(2);
    let mut depths: Vec<f64> =
        (0..NEAR).map(|k| depths[k * (depths.len().min(NEAREST) - 1) / (NEAR - 1)]).collect();
    depths.dedup();
    let top = &levels[levels.len() - 1];
    let length = 2.0 * (depths[depths.len() - 1] - depths[0]) + 4.0 * top.margin();
    if top.columns() as f64 * (length / top.pitch) * 8.0 > MOST_BYTES {
        return Ok(bound(levels, tiles, instrument, points));
    }
    let columns = [few(0), few(1)];
    let per_metre = instrument.sweep.centre() / instrument.sound_speed;
    let tree = Tree::new(levels, columns.clone(), per_metre);
    let leaves: Vec<usize> = (0..tiles[0].len()).collect();
    let frequencies = instrument.sweep.frequencies();
    let ends = [frequencies[0], frequencies[frequencies.len() - 1]];
    // Fitted alike, zones farther away are tried with the fastest terms of one tile.
    let of_zone = |zone: usize| if zone == 0 { (TILES, &ends[..]) } else { (1, &ends[1..]) };
    let terms: Vec<(usize, f64, usize)> = (0..levels[0].zones.len())
        .flat_map(|zone| some(&leaves, of_zone(zone).0).map(move |leaf| (*leaf, zone)))
        .flat_map(|(leaf, zone)| {
            of_zone(zone).1.iter().map(move |f| (leaf, f / instrument.sound_speed, zone))
        })
        .collect();
    let of = |(leaf, own_per_metre, zone): &(usize, f64, usize)| -> Result<f64> {
        let own = levels.iter().zip(tiles).map(|(lattice, tiles)| {
            let halvings = levels[0].times - lattice.times;
            vec![Frame::new(&instrument.geometry, tiles[leaf >> halvings].centre)]
        });
        let frames: Vec<Vec<Frame>> = own.collect();
        // The corner of the tile that is farthest from the array's middle.
        let (low, high) = instrument.array.bounds();
        let away = |r: &DVec3| r.distance_squared(low.midpoint(high));
        let corners = tiles[0][*leaf].corners();
        let r = corners.into_iter().max_by(|a, b| away(a).total_cmp(&away(b))).unwrap_or_default();
        let term =
            Term { heard: Frame::new(&instrument.geometry, r), per_metre, own_per_metre: *own_per_metre };
        let voxels = if *zone == 0 {
            FewVoxels {
                depths: vec![depths.clone(); columns[0].len() * columns[1].len()],
                width: columns[0].len(),
            }
        } else {
            FewVoxels::about_zone(*zone, &levels[0], &frames[0][0], &columns, points)
        };
        let (leaves, above) = tree.needs(&frames, &voxels);
        let mut leaves = HeldNodes::zeros(leaves)?;
        for (leaf, values) in leaves.filling() {
            fill((leaf, values), &levels[0], &term);
        }
        let nodes =
            tree.merged(leaves, above, Batch::of_threads(rayon::current_num_threads()), |_| Ok(()))?;
        let nodes: Vec<FilledNodes<'_>> = nodes.filled().collect();
        let (mut worst, mut wanted, mut buffers) = (0.0, TermColumn::default(), RowBuffers::default());
        let rows = 0..columns[1].len();
        tree.voxels().rows(&nodes, &voxels, rows, &mut buffers, |[x, y], re, im| {
            // Of voxels as they are, not turned.
            let depths = voxels.column(x, y);
            term.along([columns[0][x], columns[1][y]], depths, &vec![0.0; depths.len()], &mut wanted);
            for (k, wanted) in wanted.values.iter().enumerate() {
                let found = Complex64::new(f64::from(re[k]), f64::from(im[k]));
                worst = greater(worst, (found - wanted).norm());
            }
        });
        Ok(worst)
    };
    let worst: Vec<f64> = terms.par_iter().map(of).collect::<Result<_>>()?;
    Ok(Some(BETWEEN * worst.into_iter().fold(0.0, greater)))
}

/// Voxels in a few columns, each with depths of its own, `[y, x]`.
struct FewVoxels {
    depths: Vec<Vec<f64>>,
    width: usize,
}

impl FewVoxels {
    /// Those about where a zone of one tile begins, if it does so among the voxels, or else those that are nearest to that.
    fn about_zone(
        zone: usize,
        lattice: &TileLattice,
        frame: &Frame,
        [xs, ys]: &[Vec<f64>; 2],
        points: &GridPlaces,
    ) -> Self {
        let ends = [points.at(2, 0), points.at(2, points.grid().z.count - 1)];
        let column = |[x, y]: [f64; 2]| {
            let depth = |[nodes, taps]: [f64; 2]| {
                let nodes = lattice.zones[zone].from as f64 + nodes + taps * lattice.taps.count() as f64;
                frame.point(x, y, lattice.pitch * nodes).map_or(ends[0], |p| p.z.clamp(ends[0], ends[1]))
            };
            let mut depths = ZONE.map(depth).to_vec();
            depths.dedup();
            depths
        };
        let at = ys.iter().flat_map(|y| xs.iter().map(move |x| [*x, *y]));
        Self { depths: at.map(column).collect(), width: xs.len() }
    }

    fn column(&self, x: usize, y: usize) -> &[f64] {
        &self.depths[y * self.width + x]
    }
}

impl PlaceColumns for FewVoxels {
    fn ends(&self, x: usize, y: usize) -> Option<[f64; 2]> {
        let depths = self.column(x, y);
        Some([*depths.first()?, *depths.last()?])
    }

    fn fill(&self, x: usize, y: usize, depths: &mut Vec<f64>, ranges: &mut Vec<f64>) {
        depths.clear();
        depths.extend(self.column(x, y));
        ranges.clear();
    }
}

/// One frequency of one microphone.
struct Term {
    /// The microphone's own.
    heard: Frame,
    /// Cycles of the carrier and of the frequency for each metre.
    per_metre: f64,
    own_per_metre: f64,
}

impl Term {
    /// Its values at some depths of a column, turned by what the carrier has in these ranges.
    fn along(&self, at: [f64; 2], depths: &[f64], ranges: &[f64], values: &mut TermColumn) {
        let TermColumn { cycles, values } = values;
        cycles.resize(depths.len(), 0.0);
        values.resize(depths.len(), Complex64::ZERO);
        self.heard.ranges(at, depths, cycles);
        for (cycles, range) in cycles.iter_mut().zip(ranges) {
            *cycles = self.per_metre * range - self.own_per_metre * *cycles;
        }
        phasors_f64(cycles, values);
    }
}

/// The values of a column, and their phases.
#[derive(Default)]
struct TermColumn {
    cycles: Vec<f64>,
    values: Vec<Complex64>,
}

/// Puts one term in the place of all that a tile hears.
fn fill((leaf, [re, im]): (&TileNodes, [&mut [f32]; 2]), lattice: &TileLattice, term: &Term) {
    let [x, y] = &lattice.zones[leaf.zone].nodes;
    let (mut ranges, mut depths, mut column_values) = (Vec::new(), Vec::new(), TermColumn::default());
    for (column, needed) in leaf.needed.iter().enumerate().filter(|(_, needed)| !needed.is_empty()) {
        let at = [x.places()[column % x.len()], y.places()[column / x.len()]];
        ranges.clear();
        ranges.extend(needed.clone().map(|k| lattice.pitch * k as f64));
        depths.resize(ranges.len(), 0.0);
        leaf.frame.depths(at, &ranges, &mut depths);
        term.along(at, &depths, &ranges, &mut column_values);
        let first = column * leaf.held.len() + (needed.start - leaf.held.start);
        for (index, value) in (first..).zip(&column_values.values) {
            (re[index], im[index]) = (value.re as f32, value.im as f32);
        }
    }
}

/// A bound from the errors of each interpolation by itself, each amplified by all that come after it.
fn bound(
    levels: &[TileLattice],
    tiles: &[&[Tile]],
    instrument: &Instrument,
    points: &GridPlaces,
) -> Option<f64> {
    levels.iter().zip(tiles).try_fold(0.0, |before, (lattice, tiles)| {
        let [error, growth] = lattice.measured(&Terms { instrument, points, tiles, from: 0.0 })?;
        Some(error + growth * before)
    })
}
