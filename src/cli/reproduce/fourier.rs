//! Eq. 9 as used for the paper's tables: one plain two-dimensional discrete Fourier transform.
//!
//! `F[k, n] = 1/(N_r N_f) Σ_j Σ_q m[q, j] e^{+i2πjk/N_r} e^{−i2πqn/N_f}`, without padding; a pixel is |F| of the nearest
//! bin. The lateral bin belongs to the band's middle frequency f_c, where [`crate::reconstruct`]'s `linear`
//! scales the angle with each f (`k = f·p̂₂/c`): Eq. 9 drops that factor, and so the last row of Table I is blurred.

use super::scene::grid;
use crate::acquisition::{DataCube, Instrument};
use num_complex::Complex64;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Roots of unity `e^{i2πj/n}`.
fn roots(n: usize) -> Vec<Complex64> {
    (0..n).map(|j| Complex64::cis(TAU * j as f64 / n as f64)).collect()
}

/// The image on the paper's pixels, `[z, x]`, on the absolute scale of the transform.
///
/// Only the bins of pixels are computed, directly as the sum above, so that the lengths need no small factors.
pub(super) fn image(cube: &DataCube) -> Vec<f32> {
    let Instrument { sweep, array, geometry, sound_speed: c, .. } = &cube.instrument;
    let (n_f, n_r, centre) = (sweep.len(), array.len(), sweep.centre());
    let step = sweep.step().unwrap_or(0.0);
    let pitch = array.lattice().map_or(0.0, |lattice| lattice.x.pitch);
    let grid = grid();
    let bins: Vec<[usize; 2]> = (0..grid.z.count * grid.x.count)
        .map(|pixel| {
            let p = grid.position(pixel % grid.x.count, 0, pixel / grid.x.count);
            let far = geometry.far_direction(p).x;
            let k = (n_r as f64 * pitch * centre * far / c).round() as isize;
            let n = (2.0 * p.length() * n_f as f64 * step / c).round() as usize;
            [n % n_f, k.rem_euclid(n_r as isize) as usize]
        })
        .collect();
    let mut wanted: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for (pixel, [n, _]) in bins.iter().enumerate() {
        wanted.entry(*n).or_default().push(pixel);
    }
    let (along_f, along_r) = (roots(n_f), roots(n_r));
    let scale = 1.0 / (n_r * n_f) as f64;
    let mut image = vec![0.0; bins.len()];
    let found: Vec<Vec<(usize, f32)>> = wanted
        .into_par_iter()
        .map(|(n, pixels)| {
            let mut profile = vec![Complex64::ZERO; n_r];
            for q in 0..n_f {
                let root = along_f[q * n % n_f].conj();
                for (sum, m) in profile.iter_mut().zip(cube.frequency(q)) {
                    *sum += root * f64::from(m.re);
                }
            }
            let at = |k: usize| -> f32 {
                let sum: Complex64 = profile.iter().enumerate().map(|(j, m)| m * along_r[j * k % n_r]).sum();
                (sum.norm() * scale) as f32
            };
            pixels.into_iter().map(|pixel| (pixel, at(bins[pixel][1]))).collect()
        })
        .collect();
    for (pixel, value) in found.into_iter().flatten() {
        image[pixel] = value;
    }
    image
}
