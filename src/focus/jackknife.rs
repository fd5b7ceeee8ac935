//! The top of a curve, and how sure it is: the band is divided, and the top is found again without each part.
//!
//! Parts of the band have different noise and different speckle, but the same instrument. The spread of the tops without one
//! part each is the jackknife's estimate of the standard error; it costs no more tones than one image, since images add up.

use super::measure::FocusMeasure;
use crate::acquisition::{DataCube, Sweep};
use crate::alloc::try_zeroed;
use crate::error::Result;
use crate::grid::{Grid, Volume, no_room_for};
use crate::linalg::{LeastSquares, Matrix};
use crate::progress::Observer;
use crate::reconstruct::{ReconstructOptions, reconstruct_with};
use crate::wave::Motion;

/// Parts of the band.
pub(super) const PARTS: usize = 6;

/// Volumes that are in memory at a time.
pub(crate) const VOLUMES: u64 = PARTS as u64 + 2;

/// The measure of a whole image, and without each part of the band.
#[derive(Debug, Clone)]
pub(super) struct PartMeasures {
    pub(super) whole: f64,
    pub(super) without: Vec<f64>,
}

/// The tones of a cube in parts of neighbours, all of one size or two.
pub(super) fn parts(tones: usize) -> Vec<std::ops::Range<usize>> {
    let count = PARTS.min(tones);
    (0..count).map(|i| i * tones / count..(i + 1) * tones / count).collect()
}

/// Images a cube part by part of its band, and measures the sums.
///
/// # Errors
/// Those of [`reconstruct_with`]; volumes that do not fit in memory.
pub(super) fn measure(
    cube: &DataCube,
    grid: &Grid,
    options: &ReconstructOptions,
    measure: FocusMeasure,
    observer: &dyn Observer,
) -> Result<PartMeasures> {
    let (f, n_mic) = (cube.instrument.sweep.frequencies(), cube.instrument.array.len());
    let parts = parts(f.len());
    let mut images = Vec::with_capacity(parts.len());
    for part in &parts {
        let sweep = Sweep::from_frequencies(f[part.clone()].to_vec())?;
        let of_speakers = cube.samples.chunks_exact(f.len() * n_mic);
        let samples = of_speakers.flat_map(|samples| &samples[part.start * n_mic..part.end * n_mic]);
        let samples = samples.copied().collect();
        let cube = DataCube::new(cube.instrument.clone().with_sweep(sweep), samples)?;
        // A part is played when its tones were.
        let motion = options.motion.map(|motion| Motion { start: motion.time(part.start as f64), ..motion });
        let options = options.with_motion(motion);
        let mut image = reconstruct_with(&cube, grid, &options, observer)?.volume;
        // An image is a mean over tones; sums add up.
        let weight = part.len() as f32 / f.len() as f32;
        image.samples.iter_mut().for_each(|a| *a *= weight);
        images.push(image.samples);
    }
    let room = || try_zeroed(grid.voxel_count()).ok_or_else(|| no_room_for(grid));
    let mut whole = Volume { grid: *grid, samples: room()? };
    for image in &images {
        whole.samples.iter_mut().zip(image).for_each(|(sum, a)| *sum += a);
    }
    let mut rest = Volume { grid: *grid, samples: room()? };
    let without = images.iter().map(|image| {
        for ((rest, sum), a) in rest.samples.iter_mut().zip(&whole.samples).zip(image) {
            *rest = sum - a;
        }
        measure.of(&rest)
    });
    let without = without.collect();
    Ok(PartMeasures { whole: measure.of(&whole), without })
}

/// The top of the parabola through a curve, by least squares, its value, and how it falls with the square of the distance; `None` where it has no top within `reach` times
/// the half of the range of the places about its middle.
pub(super) fn top(places: &[f64], values: &[f64], reach: f64) -> Option<[f64; 3]> {
    let (first, last) = (places[0], places[places.len() - 1]);
    let (middle, half) = (f64::midpoint(first, last), 0.5 * (last - first));
    let t: Vec<f64> = places.iter().map(|x| (x - middle) / half).collect();
    let basis = Matrix::from_fn(t.len(), 3, |i, power| t[i].powi(power as i32));
    let fit = LeastSquares::new(&basis).solve(&Matrix::from_fn(t.len(), 1, |i, _| values[i]));
    let [a, b, c] = [0, 1, 2].map(|power| fit[(power, 0)]);
    let at = -0.5 * b / c;
    (c < 0.0 && at.abs() <= reach).then_some([middle + half * at, a + 0.5 * b * at, -c / (half * half)])
}

/// The standard error of the top, from curves without each part; `None` if one of them has no top, or with too few parts.
pub(super) fn standard_error(places: &[f64], curves: &[PartMeasures], reach: f64) -> Option<f64> {
    let count = curves.first()?.without.len();
    if count < 3 {
        return None;
    }
    let of_part = |part: usize| {
        let values: Vec<f64> = curves.iter().map(|curve| curve.without[part]).collect();
        top(places, &values, reach).map(|[at, ..]| at)
    };
    let tops: Vec<f64> = (0..count).map(of_part).collect::<Option<_>>()?;
    let n = count as f64;
    let mean = tops.iter().sum::<f64>() / n;
    Some(((n - 1.0) / n * tops.iter().map(|top| (top - mean).powi(2)).sum::<f64>()).sqrt())
}
