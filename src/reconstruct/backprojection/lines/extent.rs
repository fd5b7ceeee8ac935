//! Where voxels are as seen from lines.

use super::view::LineView;
use crate::grid::Axis;

/// Equal ranges of ρ into which the voxels of a column are sorted.
const BINS: usize = 24;

/// Rings of nodes whose extents are counted.
const RINGS: usize = 16;

/// Voxels of one column as seen from one line.
pub(crate) struct SeenVoxels {
    /// The least ρ, and how far it extends, m.
    first: f64,
    pub(crate) across: f64,
    /// The least and the most outward length in each range of ρ, m; none of an empty one.
    outward: Vec<Option<[f64; 2]>>,
}

/// Some nodes of one ρ.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RingExtent {
    pub(crate) rho: f64,
    /// The least and the most outward length, m.
    pub(crate) outward: [f64; 2],
}

/// Where voxels are as seen from lines.
pub(crate) struct Extent {
    /// Of all ρ, m.
    pub(crate) rho: [f64; 2],
    /// The least outward length, m.
    pub(crate) outward: f64,
    /// For a few lines and columns.
    pub(crate) sampled: Vec<SeenVoxels>,
}

impl Extent {
    pub(crate) fn of(view: &LineView, at_once: usize) -> Self {
        let (lines, height) = (ends(&view.lines), [view.height; 2]);
        let across = apart(ends(&view.rows), lines);
        let upwards = apart(ends(&view.depths), height);
        let rho = [0, 1].map(|end| across[end].hypot(upwards[end]));
        let outward = view.source.map_or(0.0, |[x, y, z]| {
            let off = |axis: &Axis, place: f64| apart(ends(axis), [place; 2])[0];
            off(&view.columns, x).hypot(off(&view.rows, y)).hypot(off(&view.depths, z))
        });
        let middle = (view.depths.count - at_once) / 2;
        let depths: Vec<f64> = spread(at_once, 24).map(|iz| view.depths.position(middle + iz)).collect();
        let rows: Vec<f64> = spread(view.rows.count, 24).map(|iy| view.rows.position(iy)).collect();
        let mut sampled = Vec::new();
        for column in spread(view.columns.count, 3) {
            let column = view.columns.position(column);
            for line in spread(view.lines.count, 5) {
                let line = view.lines.position(line);
                let places: Vec<[f64; 2]> = rows
                    .iter()
                    .flat_map(|y| depths.iter().map(move |z| (*y, *z)))
                    .map(|(y, z)| {
                        let across = view.source.map_or(0.0, |[x, ..]| column - x);
                        [view.rho(line, y, z), view.over_source(y, z).sqrt().hypot(across)]
                    })
                    .collect();
                sampled.push(SeenVoxels::of(&places));
            }
        }
        Self { rho, outward, sampled }
    }
}

/// Where an axis begins and ends, m.
fn ends(axis: &Axis) -> [f64; 2] {
    [axis.first, axis.last()]
}

/// How far places of two stretches are apart, the least and the most.
fn apart(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [(a[0] - b[1]).max(b[0] - a[1]).max(0.0), (a[1] - b[0]).max(b[1] - a[0])]
}

impl SeenVoxels {
    /// Of places by their ρ and outward length.
    fn of(places: &[[f64; 2]]) -> Self {
        let rhos = || places.iter().map(|[rho, _]| *rho);
        let first = rhos().fold(f64::INFINITY, f64::min);
        let across = rhos().fold(0.0, f64::max) - first;
        let mut outward = vec![None; BINS];
        for [rho, length] in places {
            let bin = ((rho - first) / across.max(f64::MIN_POSITIVE) * BINS as f64) as usize;
            let [low, high] = outward[bin.min(BINS - 1)].get_or_insert([*length; 2]);
            (*low, *high) = (low.min(*length), high.max(*length));
        }
        Self { first, across, outward }
    }

    /// Rings all over the voxels, each of which makes up voxels within half of `reach` m; `back` is the carrier's way back,
    /// which with the outward length is the path of a node.
    pub(crate) fn rings(
        &self,
        reach: f64,
        back: impl Fn(f64) -> f64 + Copy,
    ) -> impl Iterator<Item = RingExtent> {
        let bin = self.across / BINS as f64;
        let middle = move |k: usize| self.first + (k as f64 + 0.5) * bin;
        let paths: [_; BINS] = std::array::from_fn(|k| {
            let back = back(middle(k));
            self.outward[k].map(|[low, high]| [low + back, high + back])
        });
        (0..RINGS).filter_map(move |ring| {
            let share = (ring as f64 + 0.5) / RINGS as f64;
            let rho = self.first - 0.5 * reach + share * (self.across + reach);
            let near = |k: &usize| (middle(*k) - rho).abs() <= 0.5 * (reach + bin);
            let near = (0..BINS).filter(near).filter_map(|k| paths[k]);
            let [low, high] = near.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])?;
            Some(RingExtent { rho, outward: [low - back(rho), high - back(rho)] })
        })
    }
}

/// Up to `most` of `count` indices, from the first to the last.
pub(crate) fn spread(count: usize, most: usize) -> impl Iterator<Item = usize> + Clone {
    let taken = count.min(most);
    (0..taken).map(move |k| if taken > 1 { k * (count - 1) / (taken - 1) } else { count / 2 })
}
