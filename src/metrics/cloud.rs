//! A depth map as a point cloud, compared with the true one as reconstructions are in the literature.

use super::{depths, harmonic_mean, surfaces_of};
use crate::grid::DepthMap;
use rayon::prelude::*;
use rstar::RTree;

/// How two clouds of points agree.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct CloudScores {
    /// Harmonic means of the share of points within Δd, and within 2 Δd, of a true one, and of the share of true points so
    /// near to one that was found.
    pub(super) f_scores: [Option<f64>; 2],
    /// Mean distance from a point of one cloud to the nearest of the other, over both directions, m.
    pub(super) chamfer: Option<f64>,
}

/// Compares all returns of a result with all surfaces of the truth.
///
/// Cost: O(log n) per point.
pub(super) fn cloud_scores(result: &DepthMap, truth: &DepthMap, range: f64) -> CloudScores {
    let points = |map: &DepthMap| {
        let (raster, layers) = (map.raster(), surfaces_of(map));
        let of_pixel = |pixel| depths(layers, pixel).map(move |(_, z)| raster.point(pixel, z).to_array());
        (0..map.len()).flat_map(of_pixel).collect::<Vec<[f64; 3]>>()
    };
    let clouds = [result, truth].map(points);
    let distances = [nearest(&clouds[0], &clouds[1]), nearest(&clouds[1], &clouds[0])];
    let [Some(to_truth), Some(to_found)] = &distances else {
        // Of two empty clouds there is nothing to say; one that misses all of the other scores 0.
        let missed = clouds.iter().any(|cloud| !cloud.is_empty());
        return CloudScores { f_scores: [missed.then_some(0.0); 2], chamfer: None };
    };
    let f_score = |within: f64| {
        let share = |of: &[f64]| of.iter().filter(|d| **d < within).count() as f64 / of.len() as f64;
        harmonic_mean(share(to_truth), share(to_found))
    };
    let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len() as f64;
    CloudScores {
        f_scores: [range, 2.0 * range].map(|within| Some(f_score(within))),
        chamfer: Some(0.5 * (mean(to_truth) + mean(to_found))),
    }
}

/// The distance of each point from the nearest of the others; `None` where either cloud is empty.
fn nearest(points: &[[f64; 3]], others: &[[f64; 3]]) -> Option<Vec<f64>> {
    let tree = RTree::bulk_load(others.to_vec());
    let distance = |point: &[f64; 3]| {
        let other = tree.nearest_neighbor(*point)?;
        Some(point.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt())
    };
    points.par_iter().map(distance).collect::<Option<Vec<f64>>>().filter(|distances| !distances.is_empty())
}

#[cfg(test)]
mod tests {
    use super::super::tests::map;
    use super::*;

    const N: f32 = f32::NAN;

    #[test]
    fn clouds_agree_as_counted_by_hand() {
        // Pixels are 3 cm apart. Of two true points one is met to 1 cm, the other missed; a third was found in the air,
        // 3 cm from the first true one's column and 4 cm behind it.
        let truth = map(&[1.0, N, N, N, 1.0], &[]);
        let result = map(&[1.01, 1.04, N, N, N], &[]);
        let scores = cloud_scores(&result, &truth, 0.02);
        let near = |a: Option<f64>, b: f64| assert!((a.expect("measured") - b).abs() < 1e-6, "{a:?} {b}");
        near(scores.f_scores[0], 0.5);
        near(scores.f_scores[1], 0.5);
        // From the found: 1 cm, 5 cm. From the true: 1 cm, and to the second found one 9 cm across and 4 cm in depth.
        near(scores.chamfer, 0.5 * (0.03 + 0.5 * (0.01 + (0.09f64.powi(2) + 0.04f64.powi(2)).sqrt())));
        // Within 6 cm the found are all near a true one, of the true ones half are.
        near(cloud_scores(&result, &truth, 0.03).f_scores[1], 2.0 * 0.5 / 1.5);
    }

    #[test]
    fn every_return_counts_and_nothing_is_no_number() {
        let truth = map(&[1.0], &[&[1.0], &[1.5]]);
        let both = map(&[1.0], &[&[1.0], &[1.5]]);
        assert_eq!(cloud_scores(&both, &truth, 0.01).f_scores, [Some(1.0); 2]);
        assert_eq!(cloud_scores(&both, &truth, 0.01).chamfer, Some(0.0));
        let front = map(&[1.0], &[&[1.0]]);
        assert_eq!(cloud_scores(&front, &truth, 0.01).f_scores, [Some(2.0 / 3.0); 2]);
        let empty = map(&[N], &[]);
        assert_eq!(cloud_scores(&empty, &truth, 0.01).f_scores, [Some(0.0); 2]);
        assert_eq!(cloud_scores(&empty, &empty, 0.01), CloudScores::default());
    }

    #[test]
    fn the_nearest_point_is_that_of_a_search_through_all() {
        let places = |seed: u32| (0..200).map(move |i| f64::from((i * 7919 + seed) % 997) / 997.0);
        let cloud = |seed| {
            let all: Vec<f64> = places(seed).collect();
            all.windows(3).map(|w| [w[0], w[1], w[2]]).collect::<Vec<_>>()
        };
        let (a, b) = (cloud(1), cloud(501));
        let literal = |p: &[f64; 3]| {
            b.iter()
                .map(|q| p.iter().zip(q).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt())
                .fold(9.0, f64::min)
        };
        for (fast, p) in nearest(&a, &b).expect("points").iter().zip(&a) {
            assert_eq!(*fast, literal(p));
        }
    }
}
