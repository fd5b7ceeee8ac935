//! How sharp an image is, as one number.

use crate::choice::choice;
use crate::grid::Volume;
use rayon::prelude::*;

choice! {
    /// What is called sharp.
    #[derive(Default)]
    pub enum FocusMeasure: "measure" {
        /// `N Σ I² / (Σ I)²` over the powers I of N voxels: 1 of an even image, 2 of speckle, N of a single bright voxel.
        #[default]
        Sharpness = "sharpness",
        /// Tamura's coefficient `√(σ/μ)` of the lengths of the amplitude's gradient, from their mean μ and standard deviation
        /// σ: large where few places have edges.
        Gradient = "gradient",
        /// The largest amplitude.
        Peak = "peak",
    }
}

impl FocusMeasure {
    /// A measure as if the resolution cells were `cells` times as large as they are: smaller ones make any image sharper.
    pub(super) fn of_cells(self, measure: f64, cells: f64) -> f64 {
        match self {
            Self::Sharpness => measure * cells,
            // Of few bright places σ/μ is the root of the empty voxels for each bright one.
            Self::Gradient => measure * cells.powf(0.25),
            Self::Peak => measure,
        }
    }

    /// Measures a volume; 0 if nothing is in it. Cost: one pass over the voxels, whose sums do not depend on threads.
    pub fn of(self, volume: &Volume) -> f64 {
        let n = volume.samples.len() as f64;
        match self {
            Self::Sharpness => {
                let [sum, squares] = moments(volume, |i| f64::from(volume.samples[i].norm_sqr()));
                ratio(n * squares, sum * sum)
            }
            Self::Gradient => {
                let [sum, squares] = moments(volume, |i| gradient(volume, i));
                let mean = sum / n;
                ratio((squares / n - mean * mean).max(0.0).sqrt(), mean).sqrt()
            }
            Self::Peak => f64::from(volume.peak()),
        }
    }
}

/// Sum and sum of squares of a quantity of each voxel: plane by plane, and of these in order.
fn moments(volume: &Volume, quantity: impl Fn(usize) -> f64 + Sync) -> [f64; 2] {
    let plane = volume.grid.plane_len();
    let of_plane = |z: usize| {
        (z * plane..(z + 1) * plane).fold([0.0, 0.0], |[sum, squares], i| {
            let value = quantity(i);
            [sum + value, squares + value * value]
        })
    };
    let planes: Vec<[f64; 2]> = (0..volume.grid.z.count).into_par_iter().map(of_plane).collect();
    planes.into_iter().fold([0.0, 0.0], |[sum, squares], [a, b]| [sum + a, squares + b])
}

/// Length of the amplitude's gradient at a voxel, per voxel, by differences to the next along each axis.
fn gradient(volume: &Volume, index: usize) -> f64 {
    let amplitude = |i: usize| f64::from(volume.samples[i].norm());
    let (n_x, n_y, plane) = (volume.grid.x.count, volume.grid.y.count, volume.grid.plane_len());
    let (x, y, z) = (index % n_x, index / n_x % n_y, index / plane);
    let ahead = [(x + 1 < n_x, 1), (y + 1 < n_y, n_x), (z + 1 < volume.grid.z.count, plane)];
    let steps = ahead.into_iter().filter(|(inside, _)| *inside);
    steps.map(|(_, step)| (amplitude(index + step) - amplitude(index)).powi(2)).sum::<f64>().sqrt()
}

/// 0 over 0 is 0: nothing is not sharp.
fn ratio(numerator: f64, denominator: f64) -> f64 {
    if denominator > 0.0 { numerator / denominator } else { 0.0 }
}
