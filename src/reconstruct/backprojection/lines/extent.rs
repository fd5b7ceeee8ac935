//! Where voxels are as seen from lines.

use super::view::LineView;
use crate::grid::Axis;

/// Where voxels are as seen from lines.
pub(crate) struct Extent {
    /// Of all ρ, m.
    pub(crate) rho: [f64; 2],
    /// The least outward length, m.
    pub(crate) outward: f64,
    /// For a few lines and columns: how far ρ extends, and the paths at one ρ on average, m.
    pub(crate) sampled: Vec<[f64; 2]>,
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
                sampled.push(widths(&places));
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

/// How far the first coordinate of places extends, and the second on average at one value of the first.
fn widths(places: &[[f64; 2]]) -> [f64; 2] {
    const BINS: usize = 12;
    let first = places.iter().map(|[rho, _]| *rho).fold(f64::INFINITY, f64::min);
    let extent = places.iter().map(|[rho, _]| *rho).fold(0.0, f64::max) - first;
    let mut bins = [[f64::INFINITY, f64::NEG_INFINITY]; BINS];
    for [rho, path] in places {
        let bin = (((rho - first) / extent.max(f64::MIN_POSITIVE) * BINS as f64) as usize).min(BINS - 1);
        bins[bin] = [bins[bin][0].min(*path), bins[bin][1].max(*path)];
    }
    let filled: Vec<f64> =
        bins.iter().filter(|[low, high]| low <= high).map(|[low, high]| high - low).collect();
    [extent, filled.iter().sum::<f64>() / filled.len().max(1) as f64]
}

/// Up to `most` of `count` indices, from the first to the last.
pub(crate) fn spread(count: usize, most: usize) -> impl Iterator<Item = usize> + Clone {
    let taken = count.min(most);
    (0..taken).map(move |k| if taken > 1 { k * (count - 1) / (taken - 1) } else { count / 2 })
}
