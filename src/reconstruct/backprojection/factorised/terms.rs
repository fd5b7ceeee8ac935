//! The terms that a job can have, sampled, and how the tiles of an array see a grid.

use super::frame::{Frame, some};
use crate::acquisition::{Instrument, Tile};
use crate::grid::{Axis, Grid};
use crate::reconstruct::numerics::{Around, GridPlaces, IntervalNodes, known_at, wave_error};
use crate::wave::interval::greater;
use glam::DVec3;

/// Terms of one frequency and one microphone each, in the coordinates of its tile.
pub(crate) struct Terms<'a> {
    pub(crate) instrument: &'a Instrument,
    pub(crate) points: &'a GridPlaces,
    pub(crate) tiles: &'a [Tile],
    /// The least range of the places that are looked at, m.
    pub(crate) from: f64,
}

/// How many samples are taken of what terms depend on.
pub(crate) struct Density {
    tiles: usize,
    /// Along the axis that is tried, and along the others.
    places: [usize; 2],
    /// Every so many corners of a tile.
    corners: usize,
}

/// What pitches are chosen by.
pub(crate) const FEW: Density = Density { tiles: 2, places: [9, 2], corners: 3 };

/// What errors are measured at.
pub(crate) const MANY: Density = Density { tiles: 5, places: [12, 4], corners: 1 };

impl Terms<'_> {
    /// A place, or the one above the same (x, y) that has the least range; `None` where none has.
    pub(crate) fn far_enough(&self, frame: &Frame, p: DVec3) -> Option<DVec3> {
        if frame.range(p) < self.from { frame.point(p.x, p.y, self.from) } else { Some(p) }
    }

    /// The largest error of voxels made of nodes along one axis (x, y, ρ) for any sampled term, and the largest sum of
    /// the weights' moduli; `None` where no point has a node's range, and as soon as the error is more than `most`.
    pub(crate) fn error(
        &self,
        axis: usize,
        around: &dyn Fn(f64) -> Around,
        density: &Density,
        most: f64,
    ) -> Option<[f64; 2]> {
        let Self { instrument, points, tiles, .. } = self;
        let grid = points.evened();
        let carrier = instrument.sweep.centre();
        let frequencies = instrument.sweep.frequencies();
        let frequencies = [frequencies[0], frequencies[frequencies.len() - 1]];
        let (mut worst, mut moduli) = (0.0f64, 1.0f64);
        // Along x and y all tiles are interpolated alike, in the same few places.
        let mut known: Vec<(f64, Around)> = Vec::new();
        let (mut lengths, mut cycles, mut waves) = (Vec::new(), Vec::new(), Vec::new());
        for tile in some(tiles, density.tiles) {
            let frame = Frame::new(&instrument.geometry, tile.centre);
            let [along, across] = density.places;
            for p in grid.sampled(std::array::from_fn(|of| if of == axis { along } else { across })) {
                let p = self.far_enough(&frame, p)?;
                let range = frame.range(p);
                let place = if axis < 2 { p[axis] } else { range };
                let (places, weights) = known_at(place, &mut known, around);
                let node = |place: &f64| match axis {
                    0 => frame.point(*place, p.y, range).map(|q| (q, range)),
                    1 => frame.point(p.x, *place, range).map(|q| (q, range)),
                    _ => frame.point(p.x, p.y, *place).map(|q| (q, *place)),
                };
                let mut nodes: Vec<(DVec3, f64)> = places.iter().map(node).collect::<Option<_>>()?;
                nodes.push((p, range));
                moduli = moduli.max(weights.iter().map(|w| w.abs()).sum());
                for r in tile.corners().into_iter().step_by(density.corners) {
                    lengths.clear();
                    lengths.extend(nodes.iter().map(|(q, _)| instrument.geometry.path_length(*q, r)));
                    for f in frequencies {
                        let of_node = |((_, range), length): (&(DVec3, f64), &f64)| {
                            (carrier * range - f * length) / instrument.sound_speed
                        };
                        cycles.clear();
                        cycles.extend(nodes.iter().zip(&lengths).map(of_node));
                        worst = greater(worst, wave_error(weights, &cycles, &mut waves));
                        if worst.is_nan() || worst > most {
                            return None;
                        }
                    }
                }
            }
        }
        Some([worst, moduli])
    }
}

/// How tiles see a grid.
pub(crate) struct TileDistances {
    grid: Grid,
    frames: Vec<Frame>,
    pub(crate) tiles: usize,
    /// Of the widest tile, m.
    pub(crate) radius: f64,
    /// The least range of a voxel, the greatest, and that of the middle one, m.
    pub(crate) shortest: f64,
    pub(crate) longest: f64,
    pub(crate) typical: f64,
    /// By how much the depth of one range changes along x and along y: as a rule, and at most.
    pub(crate) tilts: [[f64; 2]; 2],
}

/// Ranges of what is made of the columns of nodes of a tile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ranges {
    /// The mean length that a column needs, m.
    pub(crate) mean: f64,
    /// The length of all together, m.
    pub(crate) all: f64,
}

impl TileDistances {
    /// As tiles see it that stand for all.
    pub(crate) fn of(terms: &Terms<'_>) -> Self {
        Self::of_some(terms, 7)
    }

    /// As all tiles see it.
    pub(crate) fn of_all(terms: &Terms<'_>) -> Self {
        Self::of_some(terms, usize::MAX)
    }

    fn of_some(terms: &Terms<'_>, most: usize) -> Self {
        let Terms { instrument, points, tiles, .. } = *terms;
        let grid = points.evened();
        let frame = |tile: &Tile| Frame::new(&instrument.geometry, tile.centre);
        let (low, high) = instrument.array.bounds();
        let (first, last) = grid.bounds();
        let [shortest, longest] = instrument.geometry.path_bounds((first, last), (low, high));
        let frames: Vec<Frame> = some(tiles, most).map(frame).collect();
        let (mut sum, mut steepest, mut count) = ([0.0; 2], [0.0f64; 2], 0.0);
        for frame in some(&frames, 7) {
            for p in grid.sampled([3, 3, 2]) {
                let slope = frame.slope(p);
                for (axis, across) in [slope.x, slope.y].into_iter().enumerate() {
                    let tilt = (across / slope.z).abs();
                    sum[axis] += tilt;
                    steepest[axis] = steepest[axis].max(tilt);
                }
                count += 1.0;
            }
        }
        Self {
            grid,
            frames,
            tilts: [sum.map(|sum| sum / count), steepest],
            tiles: tiles.len(),
            radius: tiles.iter().map(|tile| tile.radius).fold(0.0, f64::max),
            shortest,
            longest,
            typical: instrument.geometry.path_length(first.midpoint(last), low.midpoint(high)),
        }
    }

    /// The depth of the nearest node that is needed for places at depth `near`, sampled; `None` where one has no place.
    pub(crate) fn nearest(&self, nodes: [&IntervalNodes; 2], near: f64, margin: f64) -> Option<f64> {
        let mut nearest = near;
        for frame in &self.frames {
            for ([x, y], made_of) in self.columns(nodes) {
                let ranges = made_of.map(|[x, y]| frame.range(DVec3::new(x, y, near)));
                let least = ranges.into_iter().fold(f64::INFINITY, f64::min) - margin;
                nearest = nearest.min(frame.point(x, y, least)?.z);
            }
        }
        Some(nearest)
    }

    /// Some columns of nodes, and places of what is made of each.
    fn columns(&self, [x, y]: [&IntervalNodes; 2]) -> Vec<([f64; 2], [[f64; 2]; 9])> {
        let few = |nodes: &IntervalNodes| (0..5).map(|k| k * (nodes.len() - 1) / 4).collect::<Vec<_>>();
        let ends = |axis: &Axis| [axis.first, axis.last()];
        let part = |[first, last]: [f64; 2], step: usize| first + 0.5 * (last - first) * step as f64;
        let (few_x, few_y) = (few(x), few(y));
        let column = |i: usize, j: usize| {
            let [of_x, of_y] = [x.made_of(i, ends(&self.grid.x)), y.made_of(j, ends(&self.grid.y))];
            let made_of = std::array::from_fn(|k| [part(of_x, k % 3), part(of_y, k / 3)]);
            ([x.places()[i], y.places()[j]], made_of)
        };
        few_y.iter().flat_map(|j| few_x.iter().map(|i| column(*i, *j))).collect()
    }

    /// What these nodes need of their first `depths` depths, sampled.
    pub(crate) fn ranges(&self, nodes: [&IntervalNodes; 2], depths: usize) -> Ranges {
        let grid = self.grid;
        let far = grid.z.position(depths.min(grid.z.count) - 1);
        let (mut sum, mut count, mut all) = (0.0, 0.0, 0.0f64);
        for frame in &self.frames {
            let (mut nearest, mut farthest) = (f64::INFINITY, 0.0f64);
            for (_, made_of) in self.columns(nodes) {
                let (mut low, mut high) = (f64::INFINITY, 0.0f64);
                for [x, y] in made_of {
                    low = low.min(frame.range(DVec3::new(x, y, grid.z.first)));
                    high = high.max(frame.range(DVec3::new(x, y, far)));
                }
                (nearest, farthest) = (nearest.min(low), farthest.max(high));
                sum += high - low;
                count += 1.0;
            }
            all = all.max(farthest - nearest);
        }
        Ranges { mean: sum / count, all }
    }
}
