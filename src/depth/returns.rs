//! Several surfaces per pixel: peaks of smoothed power, front to back (PHYSICS Q6).
//!
//! Speckle breaks a single column's amplitude into false peaks; a little smoothing of the power mends that, at the
//! price of resolution.

use super::{DepthOptions, column_maxima, is_peak, parabola, percentile_99};
use crate::grid::{Grid, Surface};
use rayon::prelude::*;

/// Up to `options.returns` surfaces per pixel; surface k holds each pixel's k-th from the front.
pub(super) fn find(amplitude: &[f32], grid: &Grid, options: &DepthOptions) -> Vec<Surface> {
    let plane = grid.plane_len();
    let power = smooth(amplitude.iter().map(|a| a * a).collect(), grid, options.smoothing);
    let maxima = column_maxima(&power, plane);
    let decibels = |db: f64| 10f64.powf(db / 10.0) as f32;
    let floor = percentile_99(&maxima) * decibels(options.return_threshold_db);
    let gate = decibels(options.return_gate_db);
    let least = options.separation * options.range_resolution;
    let found: Vec<Vec<(f64, f32)>> = (0..plane)
        .into_par_iter()
        .map_init(Vec::new, |column: &mut Vec<f32>, pixel| {
            column.clear();
            column.extend(power.iter().skip(pixel).step_by(plane));
            let enough = floor.max(maxima[pixel] * gate);
            let mut peaks: Vec<usize> = (0..column.len())
                .filter(|&i| column[i] > 0.0 && column[i] >= enough && is_peak(column, i))
                .collect();
            // Strongest first, so that a sidelobe never displaces the surface that made it.
            peaks.sort_by(|a, b| column[*b].total_cmp(&column[*a]).then(a.cmp(b)));
            let mut kept: Vec<(f64, f32)> = Vec::new();
            for peak in peaks {
                let depth = grid.z.first + grid.z.pitch * (peak as f64 + parabola(column, peak));
                if kept.len() < options.returns && kept.iter().all(|(z, _)| (z - depth).abs() >= least) {
                    kept.push((depth, column[peak].sqrt()));
                }
            }
            kept.sort_by(|a, b| a.0.total_cmp(&b.0));
            kept
        })
        .collect();
    (0..options.returns)
        .map(|k| {
            let mut surface = Surface::empty(plane);
            for (pixel, found) in found.iter().enumerate() {
                if let Some((depth, strength)) = found.get(k) {
                    surface.depth[pixel] = *depth as f32;
                    surface.strength[pixel] = *strength;
                }
            }
            surface
        })
        .collect()
}

/// Separable Gaussian smoothing with σ in m along x, y, z; the kernel ends at 4σ and is renormalised at the edges.
fn smooth(mut power: Vec<f32>, grid: &Grid, sigma: [f64; 3]) -> Vec<f32> {
    let (n_x, plane) = (grid.x.count, grid.plane_len());
    let axes = [(grid.x, sigma[0], 1), (grid.y, sigma[1], n_x), (grid.z, sigma[2], plane)];
    for (axis, sigma, stride) in axes {
        let cells = sigma / axis.pitch;
        let reach = (4.0 * cells).ceil().min(axis.count as f64) as usize;
        if axis.count == 1 || cells < 0.05 || reach == 0 {
            continue;
        }
        let kernel: Vec<f32> =
            (0..=reach).map(|k| (-0.5 * (k as f64 / cells).powi(2)).exp() as f32).collect();
        let source = power.clone();
        power.par_iter_mut().enumerate().for_each(|(index, value)| {
            let place = index / stride % axis.count;
            let (mut sum, mut weight) = (kernel[0] * source[index], kernel[0]);
            for (k, w) in kernel.iter().enumerate().skip(1) {
                if k <= place {
                    sum += w * source[index - k * stride];
                    weight += w;
                }
                if place + k < axis.count {
                    sum += w * source[index + k * stride];
                    weight += w;
                }
            }
            *value = sum / weight;
        });
    }
    power
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Axis;

    fn grid() -> Grid {
        let axis = |pitch, count| Axis { first: 1.0, pitch, count };
        Grid { x: axis(0.02, 7), y: axis(0.02, 6), z: axis(0.008, 80) }
    }

    fn amplitude(echoes: &[(f64, f64)]) -> Vec<f32> {
        let grid = grid();
        grid.z
            .positions()
            .flat_map(|z| {
                let a: f64 = echoes.iter().map(|(d, a)| a * (-((z - d) / 0.012f64).powi(2)).exp()).sum();
                vec![a as f32; grid.plane_len()]
            })
            .collect()
    }

    #[test]
    fn two_surfaces_come_back_in_order_with_their_strengths() {
        let surfaces = find(&amplitude(&[(1.40, 1.0), (1.15, 0.5)]), &grid(), &DepthOptions::new(0.017));
        for (surface, expected) in surfaces.iter().zip([1.15, 1.40]) {
            for z in &surface.depth {
                assert!((f64::from(*z) - expected).abs() < 5e-4, "{z}");
            }
        }
        let ratio = surfaces[0].strength[10] / surfaces[1].strength[10];
        assert!((ratio - 0.5).abs() < 0.01, "{ratio}");
    }

    #[test]
    fn a_weak_or_near_second_peak_is_not_a_surface() {
        for echoes in [[(1.2, 1.0), (1.4, 0.2)], [(1.2, 1.0), (1.22, 0.9)]] {
            let surfaces = find(&amplitude(&echoes), &grid(), &DepthOptions::new(0.017));
            assert!(surfaces[0].depth.iter().all(|z| !z.is_nan()));
            assert!(surfaces[1].depth.iter().all(|z| z.is_nan()), "{echoes:?}");
        }
    }

    #[test]
    fn smoothing_keeps_a_constant_and_spreads_a_spike() {
        let grid = grid();
        let flat = smooth(vec![2.0; grid.voxel_count() as usize], &grid, [0.02, 0.03, 0.01]);
        assert!(flat.iter().all(|p| (p - 2.0).abs() < 1e-5));
        let mut spike = vec![0.0; grid.voxel_count() as usize];
        let centre = 40 * grid.plane_len() + 3 * 7 + 3;
        spike[centre] = 1.0;
        let spread = smooth(spike, &grid, [0.02, 0.02, 0.008]);
        assert!(spread[centre] < 0.1 && spread[centre + 1] > 0.02);
        assert!((spread[centre + 1] / spread[centre] - (-0.5f32).exp()).abs() < 0.01);
    }
}
