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
        let gap = |a: &Axis, b: &Axis| (a.first - b.last()).max(b.first - a.last()).max(0.0);
        let height = |z: f64| (z - view.height).abs();
        let depths = [view.depths.first, view.depths.last()];
        let crosses = (depths[0] - view.height) * (depths[1] - view.height) < 0.0;
        let nearest = if crosses { 0.0 } else { height(depths[0]).min(height(depths[1])) };
        let farthest =
            (view.rows.last() - view.lines.first).abs().max((view.lines.last() - view.rows.first).abs());
        let rho = [
            gap(&view.rows, &view.lines).hypot(nearest),
            farthest.hypot(height(depths[0]).max(height(depths[1]))),
        ];
        let outward = view.source.map_or(0.0, |[x, y, z]| {
            let off = |axis: &Axis, place: f64| (axis.first - place).max(place - axis.last()).max(0.0);
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
