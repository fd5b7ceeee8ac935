//! The normals of a depth map's surfaces, from each pixel's neighbours.

use crate::grid::DepthMap;

/// Maximum slope between neighbours on one surface: 63°.
const STEEPEST: f64 = 2.0;

/// One unit normal per pixel with n_z < 0; undefined where the map has no depth.
///
/// It is (a, b, −1), normalised, of the least-squares plane z = a x + b y + c through the pixel and those of its eight
/// neighbours whose depth differs by at most [`STEEPEST`] times their lateral distance.
pub(super) fn normals(map: &DepthMap) -> Vec<[f32; 3]> {
    (0..map.len()).map(|i| normal(map, i % map.x.count, i / map.x.count)).collect()
}

fn normal(map: &DepthMap, column: usize, row: usize) -> [f32; 3] {
    let here = map.point(row * map.x.count + column);
    let mut points = Vec::with_capacity(9);
    for y in row.saturating_sub(1)..=(row + 1).min(map.y.count - 1) {
        for x in column.saturating_sub(1)..=(column + 1).min(map.x.count - 1) {
            let [u, v, w] = (map.point(y * map.x.count + x) - here).to_array();
            // False for NaN.
            if w.abs() <= STEEPEST * u.hypot(v) {
                points.push([u, v, w]);
            }
        }
    }
    let n = points.len() as f64;
    let mean = [0, 1, 2].map(|k: usize| points.iter().map(|p| p[k]).sum::<f64>() / n);
    let product =
        |j: usize, k: usize| points.iter().map(|p| (p[j] - mean[j]) * (p[k] - mean[k])).sum::<f64>();
    let (uu, uv, vv) = (product(0, 0), product(0, 1), product(1, 1));
    let determinant = uu * vv - uv * uv;
    // Fewer than three pixels, or pixels in a line, do not determine a plane.
    if points.len() < 3 || determinant <= 1e-9 * uu * vv {
        return [0.0, 0.0, -1.0];
    }
    let (uw, vw) = (product(0, 2), product(1, 2));
    let (a, b) = ((uw * vv - vw * uv) / determinant, (vw * uu - uw * uv) / determinant);
    let length = (a * a + b * b + 1.0).sqrt();
    [(a / length) as f32, (b / length) as f32, (-1.0 / length) as f32]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{Axis, DepthLayer, Raster, View};

    fn map(depth: impl Fn(f64, f64) -> f64) -> DepthMap {
        let (x, y) =
            (Axis { first: -0.2, pitch: 0.04, count: 11 }, Axis { first: -0.1, pitch: 0.03, count: 8 });
        let depth = (0..88).map(|i| depth(x.position(i % 11), y.position(i / 11)) as f32).collect();
        let picked = DepthLayer { depth, ..DepthLayer::empty(88).expect("room") };
        DepthMap::new(Raster { view: View::Orthographic, x, y }, picked)
    }

    #[test]
    fn a_plane_has_one_normal_everywhere_even_at_a_step() {
        let (a, b) = (0.7, -0.4);
        let length = f64::sqrt(a * a + b * b + 1.0);
        let expected = [a / length, b / length, -1.0 / length];
        for step in [0.0, 0.5] {
            let map = map(|x, y| 2.0 + a * x + b * y + if x > 0.01 { step } else { 0.0 });
            for normal in normals(&map) {
                assert!(
                    normal.iter().zip(expected).all(|(n, e)| (f64::from(*n) - e).abs() < 1e-4),
                    "{normal:?}"
                );
            }
        }
    }

    #[test]
    fn the_normals_of_a_sphere_point_outwards() {
        let found = normals(&map(|x, y| 2.0 - (0.25 - x * x - y * y).sqrt()));
        // At the pixel (x, y) = (0.04, 0.02): outwards from the centre (0, 0, 2).
        let expected = [0.08, 0.04, -f64::sqrt(0.25 - 0.002) / 0.5];
        let normal = found[4 * 11 + 6];
        assert!(normal.iter().zip(expected).all(|(n, e)| (f64::from(*n) - e).abs() < 0.01), "{normal:?}");
    }
}
